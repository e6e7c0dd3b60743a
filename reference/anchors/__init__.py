"""Anchors and the networks that decode them: Scaffold-GS, DLG-GS and HDGS."""
