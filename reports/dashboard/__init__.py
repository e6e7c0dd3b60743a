"""`bench dashboard`: one page over a whole store, served on this machine or written as plain files."""
