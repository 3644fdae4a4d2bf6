"""Experiments: one module a question; `python -m experiments` lists and runs them."""
