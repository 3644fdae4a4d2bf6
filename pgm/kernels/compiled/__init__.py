"""Sweeps of Gaussian chains in machine code, by Numba, which importing this loads."""
