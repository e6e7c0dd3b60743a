"""Claims of papers, a file a page, as data."""
