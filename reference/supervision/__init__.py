"""Losses, depth terms, dense matches and side views that training is supervised by."""
