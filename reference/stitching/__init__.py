"""How trained blocks become one model."""
