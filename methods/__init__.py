"""The methods and the optimised layer they are built of."""
