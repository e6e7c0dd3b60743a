"""Named, seeded hard cases of every component, and what is expected of each."""
