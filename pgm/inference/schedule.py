"""Schedules: which messages a chain sends, and how often its CPDs are linearised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pgm.errors import ModelError
from pgm.kernels.arrays import Array, Mask


@dataclass(frozen=True)
class Filtering:
    """Forward messages alone: each belief knows the readings up to its step.

    Each CPD is linearised once: a transition at the incoming message, a sensor at the predicted
    belief. With `Taylor` it is the extended Kalman filter, with `Unscented` the unscented one.
    """


@dataclass(frozen=True)
class Smoothing:
    """Forward and backward messages: each belief knows all readings.

    The first linearisation is that of the filter. Each further one is of every CPD at the smoothed
    belief over its hidden parents, all steps in one call, after which messages are sent again
    from the prior: no reading is counted twice. With `Taylor` that is Gauss–Newton.

    Parameters
    ----------
    iterations : int
        Linearisations at the most; 1 is the (extended, unscented) RTS smoother.
    tolerance : float
        A run stops when no smoothed mean moves by more than this many standard deviations.
    """

    iterations: int = 1
    tolerance: float = 1e-9

    def __post_init__(self) -> None:
        whole = isinstance(self.iterations, int | np.integer)
        if not whole or isinstance(self.iterations, bool) or self.iterations < 1:
            raise ModelError(
                f"Smoothing(iterations={self.iterations!r}): iterations count linearisations and "
                "must be 1 or more"
            )
        if not self.tolerance >= 0.0:
            raise ModelError(
                f"Smoothing(tolerance={self.tolerance!r}): a tolerance must be 0 or more"
            )


Schedule = Filtering | Smoothing


@dataclass(frozen=True, eq=False)
class Status:
    """How a schedule went.

    Attributes
    ----------
    iterations : int
        Linearisations made.
    residuals : ndarray
        (iterations − 1, *runs): the largest move of a smoothed mean at each relinearisation, in
        standard deviations.
    converged : ndarray of bool
        (*runs): whether the last move was within the tolerance, or no CPD needed linearising.
    """

    iterations: int
    residuals: Array
    converged: Mask

    def __post_init__(self) -> None:
        self.residuals.flags.writeable = False
        self.converged.flags.writeable = False

    def __repr__(self) -> str:
        last = f", last move {self.residuals[-1].max():.3g} std" if len(self.residuals) else ""
        share = f"{int(self.converged.sum())} of {self.converged.size} runs converged"
        return f"Status({self.iterations} linearisations, {share}{last})"
