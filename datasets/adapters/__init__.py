"""Adapters: each reads one public layout of files and turns it into our conventions."""
