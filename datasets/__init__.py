"""Scenes: adapters for data sets and photos, procedural scenes with known truth, the registry."""
