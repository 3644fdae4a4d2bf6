"""Expectation-maximisation with safeguarded acceleration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pgm.boundary import is_number, is_whole
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError, PgmError
from pgm.evidence import Evidence
from pgm.inference import Smoothing
from pgm.inference.checks import require_lineariser
from pgm.kernels.arrays import Array
from pgm.learning.acceleration import Anderson
from pgm.learning.declared import Learn
from pgm.learning.model import Expected, Learner, Point
from pgm.learning.result import Fit, FitStatus
from pgm.linearisers import TAYLOR, Lineariser
from pgm.networks import DynamicBayesianNetwork
from pgm.progress import Progress, counted, reporting

_HALVINGS = 5
_MEMORY = 10
# The part of a log-evidence that its rounding may be.
_ROUNDING = 1e-13


def fit(
    model: DynamicBayesianNetwork,
    evidence: Evidence | Sequence[Evidence],
    *,
    learn: Learn,
    lineariser: Lineariser = TAYLOR,
    schedule: Smoothing = Smoothing(),  # noqa: B008, a value
    steps: int | Sequence[int] | None = None,
    iterations: int = 200,
    tolerance: float = 1e-6,
    accelerate: bool = True,
    progress: Progress = False,
) -> Fit:
    """Learn."""
    recordings = list(evidence) if isinstance(evidence, list | tuple) else [evidence]
    every = list(steps) if isinstance(steps, list | tuple) else [steps] * len(recordings)
    learner = Learner(model, recordings, learn, lineariser, schedule, every)
    with reporting(progress):
        return _Search(learner, iterations, tolerance, accelerate).run()


class _Search:
    """The working place of `fit`."""

    def __init__(self, learner: Learner, iterations: int, tolerance: float, accelerate: bool):
        self.learner, self.iterations, self.tolerance = learner, iterations, tolerance
        self.accelerate = accelerate
        self.e_steps = self.accepted = self.refused = self.halved = 0
        self.anderson = Anderson(_MEMORY)
        self.reason = ""

    def run(self) -> Fit:
        learner = self.learner
        here = self._expected(learner.start)
        trace, converged = [here.log_evidence], False
        for _ in counted(range(self.iterations), "EM"):
            image = learner.maximised(here)
            x, y = learner.vector(here.point), learner.vector(image)
            there = self._accelerated(here, x, y) if self.accelerate else None
            if there is None:
                there = self._plain(here, image, x, y)
            if there is None:
                converged = not self.reason
                break
            gain = there.objective - here.objective
            moved = np.abs(y - x) / (1.0 + np.abs(x))
            here = there
            trace.append(here.log_evidence)
            if gain <= self.tolerance and moved.max(initial=0.0) <= self.tolerance**0.5:
                converged = True
                break
        status = FitStatus(
            len(trace) - 1,
            self.e_steps,
            self.accepted,
            self.refused,
            self.halved,
            converged,
            self.reason,
        )
        return Fit(
            here.point.model, learner.found(here.point), np.array(trace), here.posteriors, status
        )

    def _expected(self, point: Point) -> Expected:
        self.e_steps += 1
        return self.learner.expected(point)

    def _tried(self, here: Expected, vector: Array) -> Expected | None:
        try:
            with np.errstate(all="ignore"):
                point = self.learner.at(here.point, vector)
            found = self._expected(point)
        except PgmError:
            return None
        return found if found.objective > here.objective else None

    def _accelerated(self, here: Expected, x: Array, y: Array) -> Expected | None:
        proposed = self.anderson.proposed(x, y)
        if proposed is None:
            return None
        found = self._tried(here, proposed)
        if found is None:
            self.refused += 1
            self.anderson.forget()
        else:
            self.accepted += 1
        return found

    def _plain(self, here: Expected, image: Point, x: Array, y: Array) -> Expected | None:
        try:
            found = self._expected(image)
        except PgmError:
            found = None
        rounding = _ROUNDING * abs(here.objective)
        if found is not None:
            if found.objective > here.objective:
                return found
            if found.objective >= here.objective - rounding:
                return None
        for k in range(1, _HALVINGS + 1):
            self.halved += 1
            half = self._tried(here, x + (y - x) * 0.5**k)
            if half is not None:
                return half
        self.reason = "no part of the step raises the log-evidence"
        return None
