"""Native kernels and their thin torch wrappers."""
