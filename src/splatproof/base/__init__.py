"""Plumbing that every room may use and that imports no room: errors, files, names, processes."""
