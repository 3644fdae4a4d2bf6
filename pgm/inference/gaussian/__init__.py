"""Inference in static Gaussian networks, on cluster graphs that are trees or have loops.

`run` sends the messages of a schedule and returns the posterior. A factor is kept as the *rows* A
and r of exp(−½ ‖A ξ − r‖²), of which A is a root of the information matrix AᵀA.
"""

from pgm.inference.gaussian.run import run

__all__ = ["run"]
