"""What the pytest plugin does once a test asks for it; see docs/regression_check.md."""
