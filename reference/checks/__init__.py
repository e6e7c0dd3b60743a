"""How results are compared: measures of agreement, and where correct results may differ."""
