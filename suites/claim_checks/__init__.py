"""What this project claims of itself, measured: speed, bits, bytes, errors, and what its metrics see."""
