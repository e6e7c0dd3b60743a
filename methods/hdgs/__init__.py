"""Hierarchical dynamic Gaussians: few moving anchors, refined layer by layer into what one moment shows."""
