"""Method pvg: Gaussians that swing and fade (Chen et al. 2023)."""
