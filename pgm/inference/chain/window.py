"""A window of a chain: its CPDs are linearised at its own smoothed beliefs until that settles.

A window begins with the belief at its first step given the readings up to there, or with the prior.
Each iteration smooths it anew from where it begins, so that no reading counts twice. It is solved
in float64, and where that has too few digits in twice as many.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pgm.errors import NumericalError
from pgm.inference.chain import careful, certificate, forward
from pgm.inference.chain.adjoint import CarefulSmoothed
from pgm.inference.chain.backward import Beliefs
from pgm.inference.chain.careful import Begin
from pgm.inference.chain.forward import Forward
from pgm.inference.chain.iteration import Anchor, Iterated, iterate
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.readings import Moments
from pgm.inference.chain.smoother import Chain, Either, swept
from pgm.inference.chain.taking import Belief
from pgm.inference.schedule import ONCE, FixedLag
from pgm.kernels.arrays import Array, Mask
from pgm.kernels.twofold import Twofold


class Beginning(NamedTuple):
    """Where a window begins: a belief given the readings up to its step.

    Attributes
    ----------
    mean, cov : ndarray
        (runs, n) and (runs, n, n).
    careful : Begin or None
        The same in twice the digits, where float64 cannot carry it.
    """

    mean: Array
    cov: Array
    careful: Begin | None = None

    def over(self, runs: int) -> Beginning:
        """The same for so many runs, where it is of one."""
        if len(self.mean) == runs:
            return self

        def wide(part: Any) -> Any:
            if isinstance(part, np.ndarray):
                return np.broadcast_to(part, (runs, *part.shape[1:]))
            if isinstance(part, Twofold):
                return Twofold(wide(part.hi), wide(part.lo))
            return None if part is None else type(part)(*map(wide, part))

        found: Beginning = wide(self)
        return found

    def cut(self, plan: ChainPlan, first: int, last: int) -> ChainPlan:
        """The plan of a window of steps that begins here."""
        begin = self.over(plan.runs)
        mean, cov, _ = Moments.of(plan, begin.mean, begin.cov)
        return plan.window(first, last, (mean, cov))

    @property
    def in_digits(self) -> Begin:
        """In twice the digits."""
        if self.careful is not None:
            return self.careful
        return Begin(Belief.of(self.mean, self.cov), Twofold.zeros((len(self.mean), 1, 1)))


@dataclass(frozen=True, eq=False)
class Window:
    """A window after its last iteration.

    Attributes
    ----------
    plan : ChainPlan
        With its last linearisations.
    ahead : Forward
        The forward pass.
    beliefs : Beliefs
        Smoothed; their means, where they were held back, are those that the step control kept.
    moved : ndarray
        (steps, runs, n): how far it held them back.
    residuals : list of ndarray
        (runs,) for each relinearisation.
    converged : ndarray of bool
        (runs,).
    careful : CarefulSmoothed or None
        The solution in twice the digits, where float64 had too few.
    """

    plan: ChainPlan
    ahead: Forward
    beliefs: Beliefs
    moved: Array
    residuals: list[Array]
    converged: Mask
    careful: CarefulSmoothed | None

    def at(self, row: int) -> Beginning:
        """The belief at a row given the readings there, for another window to begin with.

        A mean that the step control held back is held back here as much.
        """
        mean, cov = self.ahead.mean[row] + self.moved[row], self.ahead.cov[row]
        if self.careful is None or certificate.is_ordinary(mean, cov):
            return Beginning(mean, cov)
        step = self.careful.careful.steps[row]
        return Beginning(mean, cov, Begin(step.known.shifted(self.moved[row]), step.information))


class Alone(NamedTuple):
    """A step alone, its CPDs linearised at the beliefs before it.

    Attributes
    ----------
    plan : ChainPlan
    ahead : Forward
    error : ndarray or None
        (runs,): of the means, where it took twice the digits.
    """

    plan: ChainPlan
    ahead: Forward
    error: Array | None


def newest(plan: ChainPlan, step: int, begin: Beginning | None) -> Alone:
    """A step alone, linearised as a filter does."""
    first = max(step - 1, 0)
    alone, begin = _cut(plan, first, step, begin)
    if _is_plain(alone, begin):
        try:
            ahead, _ = forward.run(alone, ONCE)
            if certificate.suffices(alone, ahead):
                return Alone(alone, ahead, None)
        except NumericalError:
            pass  # with twice the digits there may be an answer; if not, the same is refused
        alone, begin = _cut(plan, first, step, begin)
    swept, _ = careful.sweep(alone, ONCE, begin=None if begin is None else begin.in_digits)
    return Alone(alone, swept.forward, swept.error)


def settled(
    plan: ChainPlan, first: int, last: int, begin: Beginning | None, schedule: FixedLag
) -> Window:
    """Iterate on a window of steps, all of whose CPDs have been linearised."""
    part, begin = _cut(plan, first, last, begin)
    if _is_plain(part, begin):
        try:
            found = _settled(Chain(part, swept), schedule)
            ahead = found.solution.forward
            assert isinstance(ahead, Forward)
            if certificate.suffices(part, ahead, found.solution.beliefs.cov):
                return _window(part, ahead, found, None)
        except NumericalError:
            pass
        part, begin = _cut(plan, first, last, begin)
    start = None if begin is None else begin.in_digits

    def solve(plan: ChainPlan, reference: Array, anchor: Anchor | None) -> CarefulSmoothed:
        return CarefulSmoothed.of(plan, careful.sweep(plan, None, anchor, start)[0])

    precise = _settled(Chain(part, solve), schedule)
    return _window(part, precise.solution.careful.forward, precise, precise.solution)


def _cut(
    plan: ChainPlan, first: int, last: int, begin: Beginning | None
) -> tuple[ChainPlan, Beginning | None]:
    """The plan of a window of steps, and where it begins, or None for the prior."""
    if begin is None:
        return plan.window(first, last), None
    return begin.cut(plan, first, last), begin.over(plan.runs)


def _is_plain(plan: ChainPlan, begin: Beginning | None) -> bool:
    """Whether float64 may have digits enough."""
    return not certificate.is_flat(plan) and (begin is None or begin.careful is None)


def _settled(chain: Chain[Either], schedule: FixedLag) -> Iterated[Either]:
    plan = chain.plan
    linear = all(family.exact for family in plan.families if family.step.size)
    nothing = np.full(plan.runs, linear)
    return iterate(chain, chain.solve(), schedule.smoothing, nothing)


def _window(
    plan: ChainPlan, ahead: Forward, found: Iterated[Either], careful: CarefulSmoothed | None
) -> Window:
    solved = found.solution
    beliefs, moved = Beliefs(found.mean, solved.beliefs.cov), found.mean - solved.means
    return Window(plan, ahead, beliefs, moved, found.residuals, found.converged, careful)
