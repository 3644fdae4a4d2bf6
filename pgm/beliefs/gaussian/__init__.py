"""Inference in static Gaussian networks, on cluster graphs that are trees or have loops.

`run` sends the messages of a schedule and returns the posterior, of any factors as `run_factors`;
`linearised_factors` solves nothing. A factor is kept in square-root form, exp(−½ ‖A ξ − r‖²), over
coordinates ξ of the hidden variables: their distances from the prior's means, in the prior's
standard deviations. The matrix A is a root of the factor's information matrix, AᵀA. The rows of A
and r together are the factor's *rows*.
"""

from pgm.beliefs.gaussian.markov import linearised_factors, run_factors
from pgm.beliefs.gaussian.run import run

__all__ = ["linearised_factors", "run", "run_factors"]
