"""What came out: MLflow, leaderboards, pages. Reads results only."""
