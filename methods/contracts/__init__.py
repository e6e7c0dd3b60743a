"""What a method is written against: run, backend, model, density strategy, reconstruction, method."""
