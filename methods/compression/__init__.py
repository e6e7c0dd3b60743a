"""Smaller models: fewer Gaussians, and training through the steps of a file."""
