"""Depth priors of training views: what something else than their own geometry says of their depth."""
