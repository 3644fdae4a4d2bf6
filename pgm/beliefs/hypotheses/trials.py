"""The hypotheses of a mixed chain as runs: the moments to which CPDs in their cases lead.

Each batch of cases that differ in numbers alone is a chain without discrete variables, whose runs
are hypotheses (`cases`). Here the moments of components and pairs, (n, K, S, runs), are handed to
the batches as runs, predicted or updated by them, and put together again; and motions are reversed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pgm.beliefs.hypotheses.cases import Batch, Choices, Given, motions, sensors, settled_of, starts
from pgm.beliefs.hypotheses.counts import Counts
from pgm.beliefs.hypotheses.records import Pairs
from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.beliefs.hypotheses.roles import Roles
from pgm.beliefs.hypotheses.unsound import infinite, replaced, unsound
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.readings import Moments
from pgm.kernels import moments
from pgm.kernels.arrays import Array, Integers, Mask, apply, components_last
from pgm.kernels.moments import Conditional


class Taken(NamedTuple):
    """Pairs with the measurements of a step taken in, and the log-density of these.

    `certain` are how many measured components each pair determined, (copies, regimes, runs); 0 if
    none did.
    """

    mean: Array
    cov: Array
    density: Array
    certain: Counts


class Trials:
    """The prior, the motion and the sensors of a mixed chain, tried on hypotheses.

    Attributes
    ----------
    moving, seeing : Choices
        The choices of the motion, and of the sensors.
    """

    def __init__(
        self, given: Given, regimes: Regimes, roles: Roles, *, mix: bool, back: bool
    ) -> None:
        self.given, self.regimes, self.roles, self.mix, self.back = given, regimes, roles, mix, back
        self.runs = given.bound.runs
        self.size = sum(v.dimension for v in given.hidden)
        self._prior = Choices(regimes, roles.prior)
        self.moving = Choices(regimes, roles.transition, later=True)
        self.seeing = Choices(regimes, roles.observation)
        self._readings = roles.readings
        self._sensors: dict[int, list[Batch]] = {}
        self._moved_by: dict[int, list[Batch]] = {}

    def _motions(self, copies: int) -> list[Batch]:
        """The batches of the transition, for so many components, or for mixtures of them."""
        if copies not in self._moved_by:
            parts = self.given, self.moving, self.roles.inputs, copies
            self._moved_by[copies] = motions(*parts, keep=self.back, mixed=self.mix)
        return self._moved_by[copies]

    def start(self) -> Moments:
        """The prior's moments in each regime, (n, 1, S, runs)."""
        size, regimes = self.size, self.regimes
        mean = np.zeros((size, 1, regimes.size, self.runs))
        cov = np.zeros((size, size, 1, regimes.size, self.runs))
        for which, chain in starts(self.given, self._prior):
            found = chain.start()
            shape = which.size, self.runs
            mean[:, 0, which] = found.mean.reshape(size, *shape)
            cov[:, :, 0, which] = found.cov.reshape(size, size, *shape)
        return Moments(mean, cov)

    def moved(
        self, step: int, mean: Array, cov: Array, copies: int, *, check: bool = False
    ) -> Moments:
        """Moments predicted by each choice of the motion, or mixed ones by that of their regime.

        `mean` is (n, copies, 1, runs), and what is returned has the choices on the axis of length
        one; or (n, 1, regimes, runs), and so is what is returned.
        """
        size, parts = len(mean), self._motions(copies)
        found: list[Moments] = []
        for batch in parts:
            chain, local = batch.at(step)
            own = _as_runs(mean, cov, batch.which, chain)
            chain.check = check
            moved, batch.used = chain.predict(local, own), True
            chain.check = False
            shape = copies, batch.which.size, self.runs
            found.append(
                Moments(moved.mean.reshape(size, *shape), moved.cov.reshape(size, size, *shape))
            )
        if len(found) == 1:
            return found[0]
        total = sum(batch.which.size for batch in parts)
        whole = np.empty((size, copies, total, self.runs))
        spread = np.empty((size, size, copies, total, self.runs))
        for batch, part in zip(parts, found, strict=True):
            whole[:, :, batch.which], spread[:, :, :, batch.which] = part
        return Moments(whole, spread)

    def proper(self, step: int, pairs: Pairs, before: Moments) -> Pairs:
        """The predicted pairs, with any finite moments of those that are impossible.

        Where others have none the error names the CPD whose function has no value at a component of
        `before`, as of `moved`.
        """
        own = Moments(pairs.mean, pairs.cov)
        bad = unsound(own)
        if bad is None:
            return pairs
        alive = bad & (pairs.logs > -np.inf)
        if alive.any():
            self.moved(step, *before, before.mean.shape[1], check=True)
            raise infinite(self.given, "prediction", step, alive)
        mean, cov = replaced(own, bad)
        moved = pairs.moved
        lost = None if moved is None else unsound(moved)
        if moved is not None and lost is not None:
            moved = replaced(moved, lost)
        return pairs._replace(mean=mean, cov=cov, moved=moved)

    def taken(self, step: int, pairs: Pairs) -> Taken | None:
        """All pairs with the measurements of a step taken in; None without any."""
        if not self._readings:
            return None
        copies = len(pairs.logs)
        if copies not in self._sensors:
            self._sensors[copies] = sensors(self.given, self.seeing, self._readings, copies)
        batches = self._sensors[copies]
        every = [(batch.which, self._of_batch(batch, step, pairs)) for batch in batches]
        found = [(which, each) for which, each in every if each is not None]
        if not found:
            return None
        if len(every) == 1:
            return found[0][1]
        shape = pairs.logs.shape
        mean, cov, density = pairs.mean.copy(), pairs.cov.copy(), np.zeros(shape)
        certain = np.zeros(shape, dtype=np.intp)
        for which, each in found:
            mean[:, :, which], cov[:, :, :, which] = each.mean, each.cov
            density[:, which], certain[:, which] = each.density, each.certain
        return Taken(mean, cov, density, certain if certain.any() else 0)

    def _of_batch(self, batch: Batch, step: int, pairs: Pairs) -> Taken | None:
        """The pairs of a batch's regimes, with the measurements of a step; None without any."""
        chain, local = batch.at(step)
        parts = chain.readings(local)
        if not parts:
            return None
        batch.used = True
        copies, size = len(pairs.logs), len(pairs.mean)
        shape = copies, batch.which.size, self.runs
        own = _as_runs(pairs.mean, pairs.cov, batch.which, chain)
        after, density = chain.take(chain.plan.first + local, own, parts)
        density = np.asarray(density).reshape(shape)
        after = Moments(after.mean.reshape(size, *shape), after.cov.reshape(size, size, *shape))
        bad = unsound(after, density)
        if bad is not None:
            alive = bad & (pairs.logs[:, batch.which] > -np.inf)
            if alive.any():
                chain.check = True
                chain.take(chain.plan.first + local, own, parts)
                raise infinite(self.given, "belief", step, alive)
            density = np.where(bad, -np.inf, density)
            after = replaced(after, bad)
        assert chain.certain is not None
        certain = chain.certain.count
        if not isinstance(certain, int):
            certain = np.reshape(certain, shape) if np.any(certain) else 0
        return Taken(after.mean, after.cov, density, certain)

    def settled(self) -> tuple[list[Array], Mask]:
        """The largest moves at each relinearisation, (runs,), and whether a run settled."""
        every = [batch for batches in self._sensors.values() for batch in batches]
        every += [batch for batches in self._moved_by.values() for batch in batches]
        return settled_of(every, self.runs)

    def reversed(self, step: int, pairs: Pairs, known: Moments) -> Conditional:
        """The motion to a step, reversed: its components given each pair, (copies, S, runs, ...).

        `pairs` are those of the step, and `known` the components of the step before, or mixtures of
        them, (n, copies, 1, runs) or (n, 1, S, runs).
        """
        moved, size = pairs.moved, self.size
        assert moved is not None
        shape = moved.mean.shape[1:]
        matrix, noise = self._by_choice(step, shape)
        each = (
            np.broadcast_to(known.mean, (size, *shape)),
            np.broadcast_to(known.cov, (size, size, *shape)),
        )
        back = moments.reverse(
            components_last(each[0], 1),
            components_last(each[1], 2),
            matrix,
            noise,
            components_last(moved.mean, 1),
            components_last(moved.cov, 2),
        )
        return self._by_pair(pairs, back)

    def motion(self, step: int, pairs: Pairs, known: Moments) -> Conditional:
        """The motion to a step as it was linearised, of each pair, (copies, S, runs, ...).

        Arguments are those of `reversed`.
        """
        moved = pairs.moved
        assert moved is not None
        shape = moved.mean.shape[1:]
        matrix, noise = self._by_choice(step, shape)
        mean = components_last(np.broadcast_to(known.mean, (self.size, *shape)), 1)
        offset = components_last(moved.mean, 1) - apply(matrix, mean)
        return self._by_pair(pairs, Conditional(matrix, offset, noise))

    def _by_choice(self, step: int, shape: tuple[int, ...]) -> tuple[Array, Array]:
        """The matrices and noises of the motion to a step, (*shape, n, n), by its choices.

        `shape` is (copies, choices, runs).
        """
        size = self.size
        matrix, noise = np.empty((*shape, size, size)), np.empty((*shape, size, size))
        for batch in self._motions(shape[0]):
            own = shape[0], batch.which.size, self.runs, size, size
            found = batch.motion(step)
            matrix[:, batch.which] = found.matrix.reshape(own)
            noise[:, batch.which] = found.cov.reshape(own)
        return matrix, noise

    def _by_pair(self, pairs: Pairs, each: Conditional) -> Conditional:
        """The conditionals of a motion's choices, (copies, choices, runs, ...), by the pairs."""
        if self.mix:
            return each
        assert pairs.choice is not None
        assert pairs.moved is not None
        shape = pairs.moved.mean.shape[1:]
        index = np.broadcast_to(pairs.choice, (shape[0], *pairs.choice.shape[1:]))
        index = np.broadcast_to(index, (*index.shape[:2], self.runs))
        return Conditional(
            *(
                np.take_along_axis(
                    np.broadcast_to(part, (*shape, *part.shape[3:])),
                    index.reshape(*index.shape, *(1,) * (part.ndim - 3)),
                    axis=1,
                )
                for part in each
            )
        )


def _as_runs(mean: Array, cov: Array, which: Integers, chain: MomentChain) -> Moments:
    """Some of the moments (n, copies, choices or 1, runs) as the runs of a batch."""
    size, batch = len(mean), chain.plan.batch
    if mean.shape[2] == 1:
        mean, cov = mean.repeat(which.size, 2), cov.repeat(which.size, 3)
    elif mean.shape[2] != which.size:
        mean, cov = mean[:, :, which], cov[:, :, :, which]
    return Moments(mean.reshape(size, *batch), cov.reshape(size, size, *batch))
