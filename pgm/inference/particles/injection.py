"""Injection: particles put where the measurements are, when these are no longer explained."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.boundary import is_number
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.immutable import Immutable
from pgm.inference.particles.cells import CellProposal
from pgm.kernels.arrays import Array


class Injection(InCode, Immutable):
    r"""A share of particles drawn afresh, when measurements are explained worse than they used to.

    .. math:: \ell_t = \Big( \sum_i w_{t-1}^i \, p(z_t \mid x_t^i) \Big)^{1/b}, \qquad
        s_t = s_{t-1} + α_s (\ell_t - s_{t-1}), \qquad f_t = f_{t-1} + α_f (\ell_t - f_{t-1})

    - ℓ_t: the likelihood of the step's measurements, as its geometric mean over the b components
      that were measured; of a scan b is the beams in use times their weight;
    - s, f: its long-term and short-term averages, begun at the first measurements.

    A share of the particles,

    .. math:: \max(0, 1 - f_t / s_t),

    is replaced by draws of a `CellProposal` once the measurements have been taken; other states
    than its own are those of particles drawn anew. Weights are equal then. This is for a robot that
    was carried elsewhere, which the model does not know of: the log-evidence is that of the belief
    before, and nothing can be smoothed.

    Parameters
    ----------
    cells : CellProposal
        With ``temper=0`` draws are uniform.
    slow, fast : float
        α_s and α_f, 0 < slow < fast <= 1: with a large `fast` one bad scan injects at once, with a
        small one several have to come together.
    most : float
        The largest share, 0 < most <= 1.

    Raises
    ------
    ModelError
        If one of these is no such number, or the cells are none.

    References
    ----------
    Gutmann & Fox, An experimental comparison of localization methods continued, 2002; Thrun,
    Burgard & Fox, Probabilistic Robotics, 2005, section 8.3.5.

    Examples
    --------
    >>> from pgm.variables import Variable
    >>> cells = CellProposal(Variable("x"), [[0.0], [1.0]], widths=[1.0])
    >>> Injection(cells, slow=0.05, fast=0.5)
    Injection(CellProposal(x, 2 cells of x 1), slow 0.05, fast 0.5)
    """

    cells: CellProposal
    slow: float
    fast: float
    most: float

    def __init__(
        self, cells: CellProposal, *, slow: float = 0.01, fast: float = 0.3, most: float = 1.0
    ) -> None:
        if not isinstance(cells, CellProposal):
            raise ModelError(f"an Injection draws from a pgm.CellProposal(...), not {cells!r}")
        numbers: tuple[Any, ...] = slow, fast, most
        if not all(is_number(each) for each in numbers) or not 0.0 < slow < fast <= 1.0:
            raise ModelError(
                f"Injection: slow and fast are numbers, 0 < slow < fast <= 1, not {slow!r} and "
                f"{fast!r}"
            )
        if not 0.0 < most <= 1.0:
            raise ModelError(f"Injection: most is a share, 0 < most <= 1, not {most!r}")
        self._set(cells=cells, slow=float(slow), fast=float(fast), most=float(most))

    def averaged(self, before: Array | None, log_density: Array, measured: Array) -> Array:
        """The logarithms of long-term and short-term averages, (2, runs), with one more step.

        Parameters
        ----------
        before : ndarray or None
            Those of the step before; NaN in runs without any.
        log_density : ndarray
            (runs,): of the step's measurements.
        measured : ndarray
            (runs,): the number of their components; of runs with none the averages stay.
        """
        runs = len(log_density)
        if before is None:
            before = np.full((2, runs), np.nan)
        level = np.where(measured > 0, log_density / np.where(measured > 0, measured, 1.0), np.nan)
        share = np.log([[self.slow], [self.fast]])
        with np.errstate(invalid="ignore", divide="ignore"):
            later = np.logaddexp(np.log1p(-np.exp(share)) + before, share + level)
        later = np.where(np.isnan(before), level, later)
        return np.where(measured > 0, later, before)

    def shares(self, averages: Array) -> Array:
        """The share of particles to be replaced, (runs,)."""
        with np.errstate(invalid="ignore"):
            found = -np.expm1(averages[1] - averages[0])
        return np.clip(np.where(np.isnan(found), 0.0, found), 0.0, self.most)

    def __repr__(self) -> str:
        most = "" if self.most == 1.0 else f", at most {self.most:g}"
        return f"Injection({self.cells!r}, slow {self.slow:g}, fast {self.fast:g}{most})"
