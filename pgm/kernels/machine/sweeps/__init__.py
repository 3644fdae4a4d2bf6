"""Sweeps of chains in machine code, forward and back, and the steps of a filter online."""
