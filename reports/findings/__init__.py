"""What became of claims: verdicts of checks, findings as rows, the page and its charts."""
