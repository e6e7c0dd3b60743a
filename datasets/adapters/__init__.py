"""Doors: public data sets in their own layouts, each turned into our conventions where it enters."""
