"""The arithmetic of the Gaussian family in machine code."""
