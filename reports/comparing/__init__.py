"""Two sides of results compared: what got better, equal or worse, and what cannot be said."""
