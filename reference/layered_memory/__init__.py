"""StratoSplat: layered depth memory, depth adaptation and neural multi-plane Gaussians."""
