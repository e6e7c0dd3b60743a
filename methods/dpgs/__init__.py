"""Method dpgs on one model: matched points at the start, side views in the second half."""
