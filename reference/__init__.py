"""Small, readable, checked implementations: pure functions on tensors and the shared types."""
