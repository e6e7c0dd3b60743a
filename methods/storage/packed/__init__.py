"""The packed file: gated, coded, ordered and compressed Gaussians, streamed both ways."""
