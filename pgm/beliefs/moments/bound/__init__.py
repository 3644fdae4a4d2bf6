"""Filters and smoothers bound to memory: what a call in machine code needs, found once for many."""
