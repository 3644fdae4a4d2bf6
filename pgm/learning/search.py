"""The search for the likeliest parameters: plain and accelerated steps, and when it ends."""

from __future__ import annotations

import numpy as np

from pgm.errors import PgmError
from pgm.kernels.arrays import Array
from pgm.learning.model import Expected, Learner, Point
from pgm.learning.values import Fit, FitStatus
from pgm.progress import counted

# The least cosine between a move and the change of the gradient that tells a curvature.
_TOLD = 1e-14


class QuasiNewton:
    r"""Steps that begin as those of EM, and learn the log-evidence's curvature as they go.

    With the gradient g of the log-evidence ℓ, which by Fisher's identity is that of the expected
    log-density at the same point, and the EM step e(θ) = M(θ) − θ, the step is

    .. math:: d = e + S g,

    with S symmetric, zero at first, and after each move Δθ changed by Broyden, Fletcher, Goldfarb
    and Shanno's rule, so that it would have told that move: Δθ = −(Δe + S Δg).

    As long as the log-evidence bends upwards along the moves, so that no curvature can be learnt,
    steps are those of EM, stretched twice as far each time (Jamshidian & Jennrich, 1997).
    """

    def __init__(self, size: int) -> None:
        self.correction = np.zeros((size, size))
        self.last: tuple[Array, Array, Array] | None = None
        self.stretch = 1.0

    def forget(self) -> None:
        """Begin again as EM."""
        self.correction[:] = 0.0
        self.last, self.stretch = None, 1.0

    def step(self, point: Array, gradient: Array, plain: Array) -> Array | None:
        """The step at the next point, given EM's; None where nothing is known beyond that."""
        if self.last is not None:
            move, turned, changed = (
                a - b for a, b in zip((point, gradient, plain), self.last, strict=True)
            )
            self._learn(move, turned, changed)
        self.last = point, gradient, plain
        if not self.correction.any():
            self.stretch *= 2.0
            return self.stretch * plain if self.stretch > 2.0 else None
        step: Array = plain + self.correction @ gradient
        if not np.isfinite(step).all() or step @ gradient <= 0.0:
            self.forget()
            self.last = point, gradient, plain
            return None
        return step

    def _learn(self, move: Array, turned: Array, changed: Array) -> None:
        bend = -float(turned @ move)
        if bend <= _TOLD * float(np.linalg.norm(turned) * np.linalg.norm(move)):
            return
        left = move + changed + self.correction @ turned
        both = np.outer(left, move)
        self.correction += (both + both.T) / bend
        self.correction += float(left @ turned) / bend**2 * np.outer(move, move)


# How often a step is halved: a quasi-Newton one, by a quarter, before a plain one is taken.
_HALVINGS, _QUARTERS = 5, 1
# The part of an objective that may be rounding, and of a coordinate that is no move.
_ROUNDING, _STILL = 1e-13, 1e-3
# The part of what the gradient promises that a quasi-Newton step has to gain.
_PROMISE = 1e-4
# Nats that a step gains although a noise has vanished, where there is no end to it.
_ENDLESS = 1.0


class Search:
    """The working place of `fit`."""

    def __init__(
        self, learner: Learner, iterations: int, tolerance: float, *, accelerate: bool
    ) -> None:
        self.learner, self.iterations, self.tolerance = learner, iterations, tolerance
        size = learner.vector(learner.start).size
        self.newton = QuasiNewton(size) if accelerate else None
        self.e_steps = self.accepted = self.refused = self.halved = 0
        self.stopped = f"after the {iterations} iterations that were asked for"

    def run(self) -> Fit:
        """Go up until nothing is gained."""
        learner, converged = self.learner, False
        here: Expected | None = None
        trace: list[float] = []
        for _ in counted(range(self.iterations + 1), "EM"):
            if here is None:
                here = self._expected(learner.start)
                trace.append(here.log_evidence)
                continue
            before = here
            image, gradient = learner.improved(here)
            x, y = learner.vector(here.point), learner.vector(image)
            there = self._accelerated(here, x, gradient, y - x) or self._plain(here, image, x, y)
            if there is None:
                converged = self.stopped == _ROUNDED
                break
            here = there
            trace.append(here.log_evidence)
            gained = here.objective - before.objective
            if gained > _ENDLESS and (cpd := learner.vanishing(here.point)) is not None:
                self.stopped = (
                    f"the noise of {cpd!r} vanishes, and the log-evidence rises with it without "
                    "end: something is explained exactly; bound it, pgm.learning.Covariance(lower=)"
                )
                break
            moved = np.abs(learner.vector(here.point) - x) / (1.0 + np.abs(x))
            if gained <= self.tolerance and moved.max(initial=0.0) <= _STILL:
                converged = True
                self.stopped = "a step was within the tolerance"
                break
        assert here is not None
        status = FitStatus(
            len(trace) - 1,
            self.e_steps,
            self.accepted,
            self.refused,
            self.halved,
            converged,
            self.stopped,
        )
        return learner.fit(here, trace, status)

    def _expected(self, point: Point) -> Expected:
        self.e_steps += 1
        return self.learner.expected(point)

    def _tried(self, here: Expected, vector: Array, least: float = 0.0) -> Expected | None:
        """A point of some coordinates, if its objective is higher, by more than the least."""
        try:
            with np.errstate(all="ignore"):  # what is not finite is refused
                found = self._expected(self.learner.at(here.point, vector))
        except PgmError:
            return None
        return found if found.objective - here.objective > least else None

    def _accelerated(
        self, here: Expected, x: Array, gradient: Array, plain: Array
    ) -> Expected | None:
        step = None if self.newton is None else self.newton.step(x, gradient, plain)
        if step is None:
            return None
        for k in range(_QUARTERS + 1):
            part = 0.25**k
            least = _PROMISE * part * float(gradient @ step)
            found = self._tried(here, x + part * step, least)
            if found is not None:
                self.accepted += 1
                return found
            self.refused += 1
        assert self.newton is not None
        self.newton.forget()
        return None

    def _plain(self, here: Expected, image: Point, x: Array, y: Array) -> Expected | None:
        """The M step, or the longest of its halves that is higher."""
        rounding = _ROUNDING * max(abs(here.objective), 1.0)
        try:
            found = self._expected(image)
        except PgmError:
            found = None
        if found is not None and found.objective > here.objective:
            return found
        if found is not None and found.objective >= here.objective - rounding:
            self.stopped = _ROUNDED
            return None
        for k in range(1, _HALVINGS + 1):
            self.halved += 1
            half = self._tried(here, x + 0.5**k * (y - x))
            if half is not None:
                return half
        self.stopped = "no part of a plain step raises the log-evidence; it was refused"
        return None


_ROUNDED = "rounding alone was left"
