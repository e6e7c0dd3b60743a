"""What baselines of few views add to Gaussian Splatting, one short module each."""
