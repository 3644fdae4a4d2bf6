"""Fronts of sparse least-squares problems in machine code; see `plan`."""
