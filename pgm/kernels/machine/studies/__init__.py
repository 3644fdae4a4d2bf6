"""Simulation studies in machine code: errors of beliefs, and their sums over runs."""
