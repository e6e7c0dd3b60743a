"""Baselines of few views: fsgs, dropgaussian, cor-gs."""
