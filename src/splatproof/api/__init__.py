"""What `import splatproof` offers: the same roads as the command line, as functions."""
