"""What to run: suites of cases, the runner and the result record."""
