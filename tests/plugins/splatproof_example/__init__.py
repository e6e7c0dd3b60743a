"""What a third party adds to splatproof without editing it."""
