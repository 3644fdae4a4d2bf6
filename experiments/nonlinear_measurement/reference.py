"""An earlier, independent implementation's mean KL, one seed of 1000 simulations."""

from __future__ import annotations

import numpy as np

from experiments.nonlinear_measurement.scores import Score
from experiments.nonlinear_measurement.study import Scores

RUNS = 1000
HEADINGS = (0.3, 0.6)

Against = dict[str, dict[str, dict[str, dict[str, float]]]]  # by sensor, s and rule

# By rule and sensor, at s = 0.3 and 0.6.
KL: dict[str, dict[str, tuple[float, float]]] = {
    "Taylor": {
        "far": (0.064, 0.465),
        "near": (1.87, 6.81),
        "two_ranges": (0.076, 0.499),
        "collinear": (0.087, 0.665),
        "position": (0.031, 0.369),
    },
    "Unscented": {
        "far": (0.060, 0.415),
        "near": (0.96, 1.93),
        "two_ranges": (0.072, 0.497),
        "collinear": (0.081, 0.405),
        "position": (0.027, 0.255),
    },
    "Cubature": {
        "far": (0.053, 0.283),
        "near": (0.86, 1.63),
        "two_ranges": (0.067, 0.384),
        "collinear": (0.079, 0.319),
        "position": (0.026, 0.200),
    },
    "GaussHermite5": {
        "far": (0.051, 0.258),
        "near": (0.79, 1.40),
        "two_ranges": (0.066, 0.368),
        "collinear": (0.078, 0.316),
        "position": (0.026, 0.198),
    },
    "MonteCarlo10": {
        "far": (0.115, 0.721),
        "near": (1.72, 3.80),
        "two_ranges": (0.121, 0.826),
        "collinear": (0.145, 0.875),
        "position": (0.046, 0.430),
    },
    "MonteCarlo100": {
        "far": (0.057, 0.292),
        "near": (0.85, 1.53),
        "two_ranges": (0.073, 0.415),
        "collinear": (0.087, 0.367),
        "position": (0.027, 0.219),
    },
    "Antithetic10": {
        "far": (0.069, 0.468),
        "near": (1.2, 2.8),
        "two_ranges": (0.079, 0.541),
        "collinear": (0.084, 0.456),
        "position": (0.029, 0.281),
    },
    "IteratedCubature": {
        "far": (0.015, 0.153),
        "near": (0.021, 0.162),
        "two_ranges": (0.028, 0.219),
        "collinear": (0.158, 1.87),
        "position": (0.026, 0.200),
    },
}


def compare(scores: Scores, runs: int) -> Against:
    """Our mean KL less the reference's, and in standard errors of the difference.

    The reference's own error is not known: it is taken to be ours at its number of simulations.
    """
    return {
        sensor: {
            str(heading_std): {
                rule: _difference(cases[str(heading_std)][rule], due[sensor][k], runs)
                for rule, due in KL.items()
            }
            for k, heading_std in enumerate(HEADINGS)
        }
        for sensor, cases in scores.items()
    }


def largest(against: Against) -> tuple[float, str]:
    """The z of the largest size, and where it is."""
    every = [
        (found["z"], f"{rule}, {sensor}, s = {s}")
        for sensor, cases in against.items()
        for s, rules in cases.items()
        for rule, found in rules.items()
    ]
    return max(every, key=lambda each: abs(each[0]))


def _difference(score: Score, due: float, runs: int) -> dict[str, float]:
    error = score.kl_se * np.sqrt(1.0 + runs / RUNS)
    return {"reference": due, "difference": score.kl - due, "z": float((score.kl - due) / error)}
