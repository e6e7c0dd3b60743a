"""Method scaffold-gs: anchors and decoders (Lu et al. 2024)."""
