"""Training: the loop, the optimiser, density control, schedules and what training starts from."""
