"""Solvers: each schedule of a chain with Gaussian beliefs, in as many digits as it needs."""
