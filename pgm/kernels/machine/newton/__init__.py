"""Gauss–Newton steps of chains in machine code, by normal equations."""
