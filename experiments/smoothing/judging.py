"""The errors of beliefs of a pose against the truth."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from pgm import consistency

Array = npt.NDArray[np.floating]
Beliefs = dict[str, pgm.Gaussian]

KINDS = ("filter", "smoother", "iterated")
PLANE = ("east", "north")
CONFIDENCE = 0.95
# A run is lost if its mean NEES is so many times what it should be.
LOST = 10


def judge(beliefs: dict[str, Beliefs], truth: Array) -> dict[str, dict[str, dict[str, Any]]]:
    """Errors, normalised errors and coverage, by statistic, lineariser and kind of belief."""
    results: dict[str, dict[str, dict[str, Any]]] = {}
    for name, kinds in beliefs.items():
        for kind, belief in kinds.items():
            nees = consistency.anees(belief, truth, confidence=CONFIDENCE)
            by_run = consistency.nees(belief, truth).mean(axis=-1)
            held = consistency.coverage(belief, truth, 0.95, band=CONFIDENCE)
            found = {
                "rmse": consistency.rmse(belief, truth, PLANE),
                "rmse_heading": consistency.rmse(belief, truth, ("heading",)),
                "nees": float(nees.overall().value),
                "steps_inside": float(nees.inside.mean()),
                "lost": float(np.mean(by_run > LOST * belief.mean.shape[-1])),
                "coverage": float(held.actual),
                "coverage_interval": (float(held.low), float(held.high)),
            }
            for key, value in found.items():
                results.setdefault(key, {}).setdefault(name, {})[kind] = value
    return results


def gain(kinds: Beliefs, truth: Array) -> dict[str, tuple[float, float]]:
    """How much each kind's RMSE in the plane differs from that of the kind before it.

    The difference and its standard error over runs. Runs are paired: what they share cancels.
    """
    squares = {
        kind: np.sum(consistency.error(belief, truth)[..., :2] ** 2, axis=-1).mean(axis=-1)
        for kind, belief in kinds.items()
    }
    found = {}
    for before, kind in pairwise(KINDS):
        difference = squares[kind] - squares[before]
        # d√m = dm / 2√m.
        scale = sum(np.sqrt(squares[each].mean()) for each in (kind, before))
        error = difference.std(ddof=1) / np.sqrt(difference.size)
        found[kind] = (float(difference.mean() / scale), float(error / scale))
    return found
