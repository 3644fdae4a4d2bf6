"""Answers that can be vouched for: modes, draws of them, and how far their mixture is from exact.

`climbing` looks for modes and draws of them, `judging` says how far their mixture is from the exact
posterior.
"""
