"""Simulated runs of a model, and what counts as an error in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm


@dataclass(frozen=True, eq=False)
class Case:
    """Simulated runs of a model, and what counts as an error in them.

    Attributes
    ----------
    model : DynamicBayesianNetwork
    evidence : mapping
        What is known in all runs.
    variable : Variable
        The state.
    truth : ndarray
        (runs, steps, n).
    components : int
        The first ones are a distance, whose mean square is taken.
    first : int
        The first step that counts.
    lost : float
        A run whose RMSE is above this has lost its way.
    """

    model: pgm.DynamicBayesianNetwork
    evidence: Mapping[pgm.Variable, Any]
    variable: pgm.Variable
    truth: npt.NDArray[np.float64]
    components: int
    first: int
    lost: float
