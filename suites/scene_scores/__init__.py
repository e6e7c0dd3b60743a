"""What a model is scored on beside the pixels of its test views: seams, balance, true geometry."""
