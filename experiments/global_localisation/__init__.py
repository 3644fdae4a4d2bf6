"""A robot that knows the house, but not where in it it is."""
