"""Errors of one rule in one case, of very many simulations: a part of a study."""

from __future__ import annotations

from typing import Literal

import numpy as np

import pgm
from experiments.nonlinear_measurement.cases import SENSORS, Array, simulate
from experiments.nonlinear_measurement.rules import rules, settled
from models.networks import pose
from pgm import consistency


def sweep(
    runs: int,
    rng: np.random.Generator,
    *,
    sensor: Literal["far", "near", "two_ranges", "collinear", "position"] = "near",
    rule: Literal[
        "Taylor",
        "Unscented",
        "Cubature",
        "GaussHermite5",
        "MonteCarlo10",
        "MonteCarlo100",
        "Antithetic10",
        "IteratedCubature",
        "IteratedSmoother",
        "IteratedLag",
        "TaylorSmoother",
    ] = "Cubature",
    heading_std: float = 0.3,
) -> dict[str, Array]:
    """Errors of the pose after the step, against the drawn one.

    ``error`` [m] of the position and ``error_heading`` [rad], signed; ``nees``, of which 3 is
    right; ``log_evidence``; and whether iterating came to rest, ``settled``.

    Parameters
    ----------
    heading_std : float
        Standard deviation of the first heading [rad].
    """
    if heading_std <= 0.0:
        raise pgm.ModelError(f"heading_std is above 0 rad; found {heading_std:g}")
    case = simulate(SENSORS[sensor], heading_std, runs, rng)
    found = rules(int(rng.integers(2**32)))[rule].solve(case)
    belief = found[pose.at(1)]
    apart = consistency.error(belief, case.truth)
    return {
        "error": np.hypot(apart[:, 0], apart[:, 1]),
        "error_heading": apart[:, 2],
        "nees": consistency.nees(belief, case.truth),
        "log_evidence": np.asarray(found.log_evidence),
        "settled": np.broadcast_to(settled(found.status), runs).astype(float),
    }
