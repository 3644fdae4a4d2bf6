"""An oracle's belief of a state over all steps, as rows are judged by it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from pgm.factors import Gaussian
from pgm.kernels.arrays import Array
from pgm.kernels.sampled import Spread


class Reference(NamedTuple):
    """The oracle's belief of a state over steps 0..T.

    gaussian: Of its mean and covariance, (*runs, T+1, d).
    from_gaussian: (T+1,), in nats, the mean over runs: KL from that Gaussian; NaN of beliefs that
        tell none, as particles.
    spread: The parts of groups of draws in the errors of the Gaussian's moments, (G, *runs, T+1,
        ...); None of an oracle that is not made of groups.
    error: The Monte Carlo error without groups: 0 without draws, NaN where it is not known.
    doubt: Why the errors cannot be trusted, in words; empty where they can.
    within: (*runs,), in nats: the bound that an estimate's verdict puts on its error; None of an
        oracle without a verdict.
    seconds: Of the oracle's calls; NaN if it was given.
    log_evidence: The mean over runs; NaN if the oracle has none.
    status: The figures of its family of beliefs, such as a grid, in words; empty without any.
    """

    gaussian: Gaussian
    from_gaussian: Array
    spread: Spread | None = None
    error: float = 0.0
    doubt: str = ""
    within: Array | None = None
    seconds: float = np.nan
    log_evidence: float = np.nan
    log_evidence_kind: str = ""
    status: str = ""

    @property
    def factor(self) -> float:
        """The factor that a standard error of few groups needs for ±1.96 of it to cover 95 %.

        It is the quantile of Student's t with G − 1 degrees of freedom, over 1.96.
        """
        groups = 2 if self.spread is None else len(self.spread.mean)
        return float(stdtrit(groups - 1, 0.975)) / 1.96
