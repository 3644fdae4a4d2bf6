"""Matrices in the memory of machine code, with loops of known lengths: a function each shape."""
