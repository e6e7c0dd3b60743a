"""The image that Gaussians define, step by step."""
