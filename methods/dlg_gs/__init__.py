"""Method dlg-gs: anchors under a moving light (Li et al. 2026)."""
