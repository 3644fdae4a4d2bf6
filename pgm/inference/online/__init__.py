"""The filter of a running robot: the forward half of a chain, one step at a time."""
