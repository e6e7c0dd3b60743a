"""Studies: questions that are answered by rows instead of trained cases."""
