"""Method 3dgs: 3D Gaussian Splatting (Kerbl et al. 2023)."""
