"""The forward pass of a mixed chain: pairs of a Gaussian and a regime, merged into a few Gaussians.

A *component* is one of the K Gaussians that a step's belief is kept as; it belongs to one memory,
the states of the discrete variables that the next slice depends on. A *pair* is a component and one
of the S regimes of the next step: a hypothesis, which is predicted, and takes the measurements in,
as a run of a chain without discrete variables. Arrays have the n components of a slice first, then
hypotheses, then the runs: (n, K, runs) of components, (n, K, S, runs) of pairs. Hypotheses of
log-weight −∞ are dead.

Sightings that leave open what was seen are taken in after all others, one after another: each
component of those so far is tried with each candidate, and what comes of it is merged again, into
some more components than are kept in the end. So a step is one *stage* or more, each of members
that are merged into components: pairs first, then components with a candidate each.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from pgm.beliefs.hypotheses.cases import Choices, Given
from pgm.beliefs.hypotheses.counts import Counts, best_of, leading
from pgm.beliefs.hypotheses.records import (
    Belief,
    Kept,
    Members,
    Mixing,
    Pairs,
    Settings,
    Stage,
    State,
)
from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.beliefs.hypotheses.roles import Roles
from pgm.beliefs.hypotheses.sightings import OpenSensor
from pgm.beliefs.hypotheses.trials import Trials
from pgm.beliefs.modes.points import cut
from pgm.beliefs.moments.steps.chain import largest
from pgm.beliefs.moments.steps.readings import Moments
from pgm.cpds.caused import FAR
from pgm.errors import ModelError, NumericalError
from pgm.kernels import merging, roots
from pgm.kernels.arrays import (
    Array,
    Integers,
    Mask,
    components_last,
    holds,
    sandwich,
    symmetric,
)
from pgm.kernels.moments import Conditional
from pgm.kernels.semirings import log_sum

# Members further apart than this, by their KL divergence, may begin a component each.
APART = 0.05
# So many components are kept between the open sightings of a step, where they differ; beside robust
# noise, where a first reading may be an outlier that the next ones tell, so many of each regime.
_BETWEEN = 16
# And so many at the most where no candidate is seen twice in a step.
_ASSIGNMENTS = 2**12


class HypothesisChain:
    """The forward pass: `start`, `predict` and `take` of a sweep.

    Attributes
    ----------
    kept : list of Kept
        By step, if beliefs are to flow back.
    regime_logs : list of ndarray
        By step the log-probabilities of the regimes, (S, runs).
    associations : mapping of OpenSensor to list of ndarray
        By sighting the probabilities of its alternatives, (k + 1, runs).
    chosen : list of ndarray of int
        By step, if components are pruned, the member that each of them is, (K, runs).
    left_out : ndarray of bool
        (runs,): whether any possible member was left out.
    by_memory : bool
        Whether motions are chosen by states of the step before.
    """

    def __init__(
        self,
        given: Given,
        regimes: Regimes,
        roles: Roles,
        settings: Settings,
    ) -> None:
        self.given, self.regimes, self.settings = given, regimes, settings
        self.roles = roles
        self.angles = np.flatnonzero(np.concatenate([v.angle_mask for v in given.hidden]))
        self.runs = given.bound.runs
        self.size = sum(v.dimension for v in given.hidden)
        self._trials = Trials(given, regimes, roles, mix=settings.mix, back=settings.back)
        # Of each memory the choice in each regime; one row where the memory makes no difference.
        of = self._trials.moving.of
        self.by_memory = bool((of != of[:1]).any())
        # Whether each regime has a choice by itself, in the order of regimes.
        self._own_choices = np.array_equal(of[0], np.arange(self._trials.moving.count))
        # Whether a component is kept of each regime, in the order of regimes.
        self._each_regime = settings.count == regimes.memories == regimes.size
        if settings.mix and self.by_memory:
            raise ModelError(
                "mix=True mixes the Gaussians of all states of the step before, and motions are "
                "chosen by these (.previous): leave mix out"
            )
        self._open = [OpenSensor(given, regimes, reading, self.angles) for reading in roles.open]
        self._exclusive = any(sensor.exclusive for sensor in self._open)
        self.kept: list[Kept] = []
        self.associations: dict[OpenSensor, list[Array]] = {}
        self.regime_logs: list[Array] = []
        self.chosen: list[Integers] = []
        self.left_out: Mask = np.zeros(self.runs, dtype=bool)

    @property
    def choices(self) -> tuple[Choices, Choices]:
        """The choices of the motion, and those of the sensors."""
        return self._trials.moving, self._trials.seeing

    def start(self) -> State:
        """The pairs of step 0: the prior's Gaussian in each regime, or its pieces."""
        regimes, size = self.regimes, self.size
        mean, cov = self._trials.start()
        logs = np.broadcast_to(regimes.prior(), (regimes.size, self.runs))[None]
        pieces = self.settings.pieces
        if 1 < pieces < 2 * (size + 1):
            raise ModelError(
                f"starts={pieces} is too few to cut a prior of {size} components into, which takes "
                f"{2 * (size + 1)} pieces or more"
            )
        if pieces > 1:
            first = components_last(cov[:, :, 0], 2)
            means, lower = cut(components_last(mean[:, 0], 1), roots.root(first), pieces)
            mean = np.moveaxis(means, -1, 0)
            spread = np.moveaxis(symmetric(sandwich(lower, np.eye(size))), (-2, -1), (0, 1))
            cov = np.repeat(spread[:, :, None], pieces, axis=2)
            logs = np.repeat(logs - np.log(pieces), pieces, axis=0)
        return Pairs(logs, 0, mean, cov)

    def predict(self, step: int, belief: State) -> State:
        """The pairs of a step: each component predicted by the motion of each regime."""
        assert isinstance(belief, Belief)
        logs = belief.logs[:, None] + self.regimes.given(step, belief.memory)
        counts = belief.counts
        if isinstance(counts, np.ndarray):
            counts = np.broadcast_to(counts[:, None], logs.shape)
        if self.settings.mix:
            return self._mixed(step, belief, logs, counts)
        count, of = len(belief.logs), self._trials.moving.of
        before = Moments(belief.mean[:, :, None], belief.cov[:, :, :, None])
        moved = self._trials.moved(step, *before, count)
        mean, cov = moved
        if self._trials.moving.count == 1:
            shape = (count, self.regimes.size, self.runs)
            choice = np.zeros((1, self.regimes.size, 1), dtype=np.intp)
            mean = np.broadcast_to(mean, (len(mean), *shape))
            cov = np.broadcast_to(cov, (*cov.shape[:2], *shape))
        elif not self.by_memory:
            choice = of[:1, :, None]
            if not self._own_choices:
                mean, cov = mean[:, :, of[0]], cov[:, :, :, of[0]]
        else:
            choice = np.moveaxis(of[belief.memory], -1, 1)
            mean = np.take_along_axis(mean, choice[None], axis=2)
            cov = np.take_along_axis(cov, choice[None, None], axis=3)
        pairs = Pairs(logs, counts, mean, cov, choice, moved if self.settings.back else None)
        return self._trials.proper(step, pairs, before)

    def _mixed(self, step: int, belief: Belief, logs: Array, counts: Counts) -> Pairs:
        """The pairs of one Gaussian and each regime, mixed of all components beforehand."""
        mean, cov = belief.mean[:, :, None], belief.cov[:, :, :, None]
        logs, counts = best_of(logs, counts, None, 1)
        found = merging.merged(logs, None, 1, mean, cov, self.angles)
        before = Mixing(logs, mean, found.members, cov, found.mean, found.cov)
        after = self._trials.moved(step, found.mean, found.cov, 1)
        choice = self._trials.moving.of[:1, :, None]
        pairs = Pairs(found.logs, counts, *after, choice, after, before)
        return self._trials.proper(step, pairs, Moments(found.mean, found.cov))

    def take(self, step: int, pairs: State) -> tuple[State, Array]:
        """The components given the measurements of a step, and their log-density, (runs,)."""
        assert isinstance(pairs, Pairs)
        stages, members, total = self._all_taken(step, pairs)
        shares: Array | None = None
        if self._in_pieces(step, members):
            known = self._as_they_are(members)
        elif self.settings.prune:
            known = self._pruned(members)
        else:
            known, stage = self._closed(members)
            if self.settings.back:
                self.kept.append(Kept([*stages, stage], pairs, known))
            if self._each_regime:
                shares = known.shares
        if shares is None:
            shares = self.by_regime(leading(members.logs, members.counts, 0), members)
        self.regime_logs.append(shares)
        return known, total

    def observe(self, step: int, pairs: Pairs) -> tuple[Pairs, Array]:
        """The pairs given some measurements of a step, to which others may be added."""
        _, members, total = self._all_taken(step, pairs)
        count = self.regimes.size
        if not self._open:
            shape = -1, count, self.runs
            counts = members.counts
            if isinstance(counts, np.ndarray):
                counts = counts.reshape(shape)
            mean = members.mean.reshape(self.size, *shape)
            cov = members.cov.reshape(self.size, self.size, *shape)
            return Pairs(members.logs.reshape(shape), counts, mean, cov), total
        # Components of each regime by itself, so many of each.
        each = []
        for regime in range(count):
            logs = np.where(members.regime == regime, members.logs, -np.inf)
            each.append(self._closed(members._replace(logs=logs), self._most)[0])
        logs, mean, cov = (
            np.stack([getattr(part, name) for part in each], axis=axis)
            for name, axis in (("logs", 1), ("mean", 2), ("cov", 3))
        )
        counts = 0
        if isinstance(members.counts, np.ndarray):
            counts = np.stack([np.asarray(part.counts) for part in each], axis=1)
        return Pairs(logs, counts, mean, cov), total

    def merged(self, step: int, pairs: Pairs) -> Belief:
        """The pairs of a step, merged into components."""
        members = self._flat(*pairs[:4])
        if self._in_pieces(step, members):
            return self._as_they_are(members)
        return self._closed(members)[0]

    def _in_pieces(self, step: int, members: Members) -> bool:
        """Whether members are pieces of the prior, each of which is moved by itself."""
        first = not step and not self.given.first
        return first and self.settings.pieces > 1 and len(members.logs) > self.settings.count

    def _as_they_are(self, members: Members) -> Belief:
        """All members as components."""
        memory = self.regimes.memory[members.regime]
        return Belief(members.logs, memory, members.counts, members.mean, members.cov)

    @property
    def _most(self) -> int:
        """How many components are kept between the open sightings of a step, at the most."""
        scaled = any(sensor.scaled for sensor in self._open)
        between = _BETWEEN * (self.regimes.size if scaled else 1)
        return max(self.settings.count, self.regimes.size, between)

    def _all_taken(self, step: int, pairs: Pairs) -> tuple[list[Stage], Members, Array]:
        """The stages of a step but the last one, whose members are given all measurements.

        And the log-density of the measurements, (runs,).
        """
        members, total = self.informed(step, pairs).scaled()
        stages: list[Stage] = []
        told: list[OpenSensor] = []
        for sensor in self._open:
            used: Integers | None = None
            for row, _ in enumerate(sensor.rows(step)):
                known, stage = self._closed(members, self._between(sensor, step, members))
                if sensor.exclusive:
                    used = sensor.used(members.logs, len(known.logs), used)
                stages.append(stage)
                members, more = self._tried(sensor, step, row, known, used).scaled()
                total = total + more
                told.append(sensor)
        if not holds(total > -np.inf):
            self._refuse(step, total)
        if stages:
            self._tell(told, stages, members)
        return stages, members, total

    def informed(self, step: int, pairs: Pairs) -> Members:
        """The pairs as members of a stage, given all measurements but open sightings."""
        found = self._trials.taken(step, pairs)
        logs, counts, mean, cov = pairs[:4]
        if found is not None:
            mean, cov = found.mean, found.cov
            logs, counts = logs + found.density, counts + found.certain
        likelihood = self.regimes.likelihood(step)
        if likelihood is not None:
            logs = logs + likelihood
        return self._flat(logs, counts, mean, cov)

    def _flat(self, logs: Array, counts: Counts, mean: Array, cov: Array) -> Members:
        """Pairs (K, S, runs) as members of a stage."""
        copies, count, runs = logs.shape
        shape, size = (copies * count, runs), len(mean)
        regime = _numbers(count, copies, runs)
        if isinstance(counts, np.ndarray):
            counts = counts.reshape(shape)
        moments = mean.reshape(size, *shape), cov.reshape(size, size, *shape)
        return Members(logs.reshape(shape), counts, regime, *moments, count, paired=True)

    def _between(self, sensor: OpenSensor, step: int, members: Members) -> int:
        """How many components are kept of a step's members before an open sighting."""
        most = self._most
        if step + self.given.first <= 1:  # pieces of the prior are to be weighed by what is seen
            most = max(most, self.settings.pieces * self.regimes.size)
        if sensor.exclusive:  # what was seen so far may differ, and is not forgotten
            most = int((members.logs > -np.inf).sum(axis=0).max())
            if most > _ASSIGNMENTS:
                sensor.refuse(step, most)
        return min(len(members.logs), most)

    def _tried(
        self,
        sensor: OpenSensor,
        step: int,
        row: int,
        known: Belief,
        used: Integers | None,
    ) -> Members:
        """The components so far, each with each alternative of an open sighting.

        `used` are the candidates that each component has given already; see `OpenSensor.tried`.
        """
        size = self.size
        found = sensor.tried(step, row, known, used)
        sources, alternatives, runs = found.logs.shape
        shape = sources * alternatives, runs
        logs = known.logs[:, None] + found.logs
        if found.beyond is not None:
            far = log_sum(known.logs + found.beyond, 0) > log_sum(logs, (0, 1)) + np.log(FAR)
            if far.any():
                sensor.refuse_far(step, far)
        counts = found.counts
        if isinstance(known.counts, np.ndarray):
            counts = known.counts[:, None] + counts
        if isinstance(counts, np.ndarray):
            counts = np.broadcast_to(counts, logs.shape).reshape(shape)
        moments = found.mean.reshape(size, *shape), found.cov.reshape(size, size, *shape)
        regime = np.repeat(known.memory, alternatives, axis=0)
        return Members(logs.reshape(shape), counts, regime, *moments, alternatives)

    def _pruned(self, members: Members) -> Belief:
        """The likeliest members as components, those of higher counts first."""
        logs, counts = members.logs, members.counts
        alive = logs > -np.inf
        ranks = np.where(alive, counts, -1)
        order = np.lexsort((-logs, -ranks), axis=0)
        count = min(self.settings.count, len(order))
        self.left_out |= alive.sum(axis=0) > count
        some = order[:count]
        self.chosen.append(some)
        if isinstance(counts, np.ndarray):
            counts = np.take_along_axis(counts, some, axis=0)
        return Belief(
            np.take_along_axis(logs, some, axis=0),
            self.regimes.memory[np.take_along_axis(members.regime, some, axis=0)],
            counts,
            np.take_along_axis(members.mean, some[None], axis=1),
            np.take_along_axis(members.cov, some[None, None], axis=2),
        )

    def reduced(self, known: Belief) -> Belief:
        """The belief of pieces of the prior, merged into as many components as others have."""
        if len(known.logs) <= self.settings.count:
            return known
        logs, memory, counts, mean, cov = known
        regime = self.regimes.example[memory]
        return self._closed(Members(logs, counts, regime, mean, cov, 1))[0]

    def _closed(self, members: Members, between: int | None = None) -> tuple[Belief, Stage]:
        """Members merged into components of one memory each, and the stage.

        With `between`, before an open sighting, they are merged into so many components of one
        regime each, which is then what the belief has for memories.
        """
        regimes, (logs, counts, regime, mean, cov, *_) = self.regimes, members
        if between is None:
            count, kinds = self.settings.count, regimes.memories
        else:
            count, kinds = between, regimes.size
        by_kind = count == kinds and not (between is not None and self._exclusive)
        if by_kind and members.paired and kinds == regimes.size:
            return self._of_regimes(members)
        kind = regimes.memory[regime] if between is None else regime
        if by_kind:
            owner, memory = kind, _numbers(count, 1, self.runs)
        else:
            ranked = logs
            if isinstance(counts, np.ndarray) and ((logs > -np.inf).sum(axis=0) > count).any():
                ranked, _ = best_of(logs, counts, kind, kinds)
            owner, memory = merging.seeded(ranked, kind, mean, cov, count, APART, self.angles)
        logs, counts = best_of(logs, counts, owner, count)
        found = merging.merged(logs, owner, count, mean, cov, self.angles)
        stage = Stage(members, owner, logs, found)
        return Belief(found.logs, memory, counts, found.mean, found.cov), stage

    def _of_regimes(self, members: Members) -> tuple[Belief, Stage]:
        """Pairs merged into a component of each regime, and the stage."""
        count, size, runs = self.regimes.size, self.size, self.runs
        shape = -1, count, runs
        counts = members.counts
        if isinstance(counts, np.ndarray):
            counts = counts.reshape(shape)
        logs, counts = best_of(members.logs.reshape(shape), counts, None, 1)
        mean, cov = members.mean.reshape(size, *shape), members.cov.reshape(size, size, *shape)
        found = merging.merged(logs, None, 1, mean, cov, self.angles)
        if isinstance(counts, np.ndarray):
            counts = counts[0]
        stage = Stage(members, members.regime, logs, found)
        each = found.mean[:, 0], found.cov[:, :, 0]
        return Belief(found.logs[0], _numbers(count, 1, runs), counts, *each), stage

    def by_regime(self, shares: Array, members: Members) -> Array:
        """The log-probabilities of the regimes, (S, runs), by those of members."""
        count = self.regimes.size
        if members.paired:
            each = shares.reshape(-1, count, self.runs)
            return each[0] if len(each) == 1 else log_sum(each, 0)
        own = members.regime == np.arange(count)[:, None, None]
        return log_sum(np.where(own, shares, -np.inf), 1)

    def _tell(
        self, sensors: Sequence[OpenSensor], stages: Sequence[Stage], members: Members
    ) -> None:
        """Keep the probabilities of what a step's open sightings are of, given all of the step.

        `members` are the last sighting's; `stages` were before each of them, and what they say is
        passed on to those before by the weights of their components.
        """
        shares, copies = np.exp(leading(members.logs, members.counts, 0)), members.copies
        found: list[Array] = []
        for stage in reversed(stages):
            each = shares.reshape(-1, copies, self.runs)
            found.append(each.sum(axis=0))
            known, before = each.sum(axis=1), stage.members
            logs = merging.within(stage.logs, stage.owner, len(known))
            shares = np.exp(logs) * np.take_along_axis(known, stage.owner, axis=0)
            copies = before.copies
        for sensor, each in zip(sensors, reversed(found), strict=True):
            self.associations.setdefault(sensor, []).append(each)

    def settled(self) -> tuple[list[Array], Mask]:
        """The largest moves at each relinearisation, (runs,), and whether a run settled."""
        residuals, converged = self._trials.settled()
        for sensor in self._open:
            moved, own = sensor.settled()
            residuals, converged = largest(residuals, moved), converged & own
        return residuals, converged

    def reversed(self, step: int, pairs: Pairs, known: Moments) -> Conditional:
        """The motion to a step, reversed; as of `Trials`."""
        return self._trials.reversed(step, pairs, known)

    def motion(self, step: int, pairs: Pairs, known: Moments) -> Conditional:
        """The motion to a step as it was linearised; as of `Trials`."""
        return self._trials.motion(step, pairs, known)

    def _refuse(self, step: int, total: Array) -> None:
        """Raise the NumericalError for measurements that every hypothesis excludes."""
        run = self.given.bound.first_run + int((total == -np.inf).argmax())
        step += self.given.first
        raise NumericalError(
            f"the measurements at step {step}, run {run}, have probability zero, whatever the "
            "discrete variables are: each of their states is impossible, contradicts an exact "
            "model, or expects readings too far from these; let the tables allow more, or give the "
            "CPDs of some case noise",
            step=step,
            run=run,
        )


@lru_cache(maxsize=64)
def _numbers(count: int, copies: int, runs: int) -> Integers:
    """The numbers of the things that each copy has, (copies · count, runs)."""
    return np.broadcast_to(np.tile(np.arange(count), copies)[:, None], (copies * count, runs))
