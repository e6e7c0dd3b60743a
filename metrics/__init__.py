"""Pure metric functions on arrays, their descriptions, and the protocols they are scored under."""
