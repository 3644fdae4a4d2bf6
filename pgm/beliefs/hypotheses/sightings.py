"""Sightings that leave open what was seen, by `pgm.unknown`: each candidate is a hypothesis.

An open sighting is of one of k *candidates*, values or hidden variables that stand for a parent of
its sensor, or components of a mixture that is its sensor's CPD, or a case of it, or of none of
them: the *alternatives* are the candidates, and then that it is spurious or new, which no belief
learns from.
Arrays have the hypotheses that alternatives are tried on, the alternatives, and the user's runs:
(sources, k + 1, runs).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple, NoReturn

import numpy as np

from pgm.beliefs.hypotheses.cases import Batch, Given, case_numbers, seen, settled_of
from pgm.beliefs.hypotheses.causes import Components
from pgm.beliefs.hypotheses.counts import Counts, best_of
from pgm.beliefs.hypotheses.records import Belief
from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.beliefs.hypotheses.unsound import infinite, replaced, unsound
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.readings import Moments
from pgm.beliefs.moments.steps.readings import Reading as Read
from pgm.beliefs.moments.steps.vector import vector
from pgm.compile import SliceGraph
from pgm.cpds import CPD, SwitchingCPD
from pgm.cpds.by_run import kind_of, stacked
from pgm.cpds.caused import too_far
from pgm.errors import EvidenceError, NumericalError
from pgm.evidence import Reading
from pgm.evidence.values import JOINT, LIKELIHOOD, OneOf, UnknownVariable
from pgm.kernels import mahalanobis, merging
from pgm.kernels.arrays import Array, Integers, Mask, components_first, components_last, sandwich
from pgm.kernels.semirings import log_sum
from pgm.variables import Variable

# Candidates that are used are bits of a whole number.
_BITS = 62


class Tried(NamedTuple):
    """A sighting taken in under each alternative, of sources (sources, k + 1, runs).

    logs: The logarithms of the alternatives' probabilities times their densities.
    counts: How many components an alternative makes certain.
    mean, cov: (n, sources, k + 1, runs) and (n, n, ...).
    beyond: The logarithm of what alternatives of the largest scale of a robust noise have of that,
        (sources, runs); None without any.
    """

    logs: Array
    counts: Counts
    mean: Array
    cov: Array
    beyond: Array | None = None


class OpenSensor:
    """A sensor with its open sightings, and the candidates.

    Attributes
    ----------
    reading : Reading
    unknown : OneOf
        The candidates with their probabilities.
    """

    def __init__(self, given: Given, regimes: Regimes, reading: Reading, angles: Integers) -> None:
        assert reading.unknown is not None
        if reading.unknown[1].count > _BITS and reading.unknown[1].association == JOINT:
            raise EvidenceError(
                f"sightings of {reading.cpd.child!r} have {reading.unknown[1].count} candidates, "
                f"of which none is to be seen twice: give {_BITS} at the most, or "
                'association="sum"',
                variable=reading.cpd.child,
                cpd=reading.cpd,
            )
        self.reading, self._given, self._angles = reading, given, angles
        self.parent: Variable = reading.unknown[0]
        self.unknown: OneOf = reading.unknown[1]
        self._batches: dict[int, list[Batch]] = {}
        # The logarithms of the candidates' probabilities in each regime, (regimes, k).
        shares = self.unknown.log_shares[None, :-2]
        if isinstance(self.unknown, Components) and isinstance(reading.cpd, SwitchingCPD):
            own = case_numbers(regimes, reading.cpd)[:, None] == self.unknown.cases
            shares = np.where(own, self.unknown.log_weights, -np.inf)
        self._log_shares = np.broadcast_to(shares, (regimes.size, self.unknown.count))

    @property
    def exclusive(self) -> bool:
        """Whether no candidate is seen twice in a step."""
        return self.unknown.association == JOINT

    @property
    def scaled(self) -> bool:
        """Whether the sensor has robust noise, whose scales are components."""
        return isinstance(self.unknown, Components) and bool(self.unknown.farthest.any())

    def probabilities(self, rows: Sequence[Array]) -> Iterator[Array]:
        """The probabilities of candidates, of spurious and of new sightings, (runs, k + 2), each.

        `rows` are those of the alternatives, (k + 1, runs). NaN where nothing was measured.
        """
        outliers = self.unknown.log_shares[-2:]
        total = log_sum(outliers, 0)
        split = np.exp(outliers - total) if total > -np.inf else np.array([1.0, 0.0])
        for each, taken in zip(rows, self.reading.taken, strict=True):
            whole = np.concatenate([each[:-1], each[-1] * split[:, None]]).T
            yield np.where(taken.any(axis=-1)[:, None], whole, np.nan)

    def rows(self, step: int) -> range:
        """The sightings of a step, by their rows."""
        ends = np.searchsorted(self.reading.step, [step, step + 1])
        return range(int(ends[0]), int(ends[1]))

    def used(self, logs: Array, count: int, before: Integers | None) -> Integers:
        """The candidates that components have been given in this step, as bits, (count, runs).

        The components are the likeliest of members, of log-weights `logs` (members, runs), each of
        one member. The members are all alternatives of components that were given `before`; None
        of members that were given none.
        """
        if before is None:
            return np.zeros((count, logs.shape[1]), dtype=np.int64)
        bits = np.append(1 << np.arange(self.unknown.count, dtype=np.int64), 0)
        each = (before[:, None] | bits[:, None]).reshape(logs.shape)
        order = np.argsort(-logs, axis=0, kind="stable")[:count]
        return np.take_along_axis(each, order, axis=0)

    def refuse(self, step: int, count: int) -> NoReturn:
        """Raise the EvidenceError for too many assignments of a step's sightings."""
        variable, step = self.reading.cpd.child, self._given.first + step
        raise EvidenceError(
            f"sightings of {variable!r} at step {step} have more than {count:,} assignments to "
            "candidates, none of which is seen twice: give unknown(..., gate=...), or a smaller "
            'one, or association="sum"',
            variable=variable,
            cpd=self.reading.cpd,
            step=step,
        )

    def tried(self, step: int, row: int, known: Belief, used: Integers | None) -> Tried:
        """A sighting under each alternative, of the components so far, its sources.

        What `known` has for memories are regimes.
        `row` counts the sightings of the step. Candidates that are `used`, as bits (sources, runs),
        are none any more. With ``association="likelihood"`` each source takes its likeliest
        alternative alone.
        """
        sources = Moments(known.mean, known.cov)
        (size, copies), count = sources.mean.shape[:2], self.unknown.count
        runs = self._given.bound.runs
        shape = copies, count + 1, runs
        taken = self.reading.taken[self.rows(step).start + row]
        measured = np.broadcast_to(taken.any(axis=-1), (runs,))
        mean = np.broadcast_to(sources.mean[:, :, None], (size, *shape)).copy()
        cov = np.broadcast_to(sources.cov[:, :, :, None], (size, size, *shape)).copy()
        logs = np.empty(shape)
        logs[:, :-1] = np.moveaxis(self._log_shares[known.memory], -1, 1)
        uniform = np.where(measured, log_sum(self.unknown.log_outliers, 0), -np.inf)
        logs[:, -1] = np.where(measured, uniform, log_sum(self.unknown.log_shares[-2:], 0))
        counts = np.zeros(shape, dtype=np.intp)
        for batch in self._of(copies):
            which = batch.which
            own = copies, which.size, runs
            before, part, chain = self._read(batch, step, row, sources)
            after, density = chain.take(self._given.first + step, before, [part])
            assert chain.certain is not None
            after = Moments(after.mean.reshape(size, *own), after.cov.reshape(size, size, *own))
            density = np.broadcast_to(density, chain.plan.batch).reshape(own)
            density = np.where(self._within(part, before).reshape(own), density, -np.inf)
            bad = unsound(after, density)
            if bad is not None:
                alive = bad & (known.logs[:, None] + logs[:, which] > -np.inf)
                if alive.any():
                    chain.check = True
                    chain.take(self._given.first + step, before, [part])
                    raise infinite(self._given, "belief", step, alive)
                density = np.where(bad, -np.inf, density)
                after = replaced(after, bad)
            mean[:, :, which], cov[:, :, :, which] = after
            logs[:, which] += density
            certain = np.broadcast_to(chain.certain.count, chain.plan.batch)
            counts[:, which] = certain.reshape(own)
        if used is not None:
            bits = 1 << np.arange(self.unknown.count, dtype=np.int64)
            logs[:, :-1] = np.where(used[:, None] & bits[:, None], -np.inf, logs[:, :-1])
        if self.unknown.association == LIKELIHOOD:
            best = logs.argmax(axis=1)[:, None] == np.arange(count + 1)[:, None]
            logs = np.where(best, logs, -np.inf)
        # A sighting that nothing explains, where nothing else was declared, is left out.
        if not isinstance(self.unknown, Components):
            lost = (logs == -np.inf).all(axis=(0, 1))
            logs[:, -1] = np.where(lost, 0.0, logs[:, -1])
        found = Tried(logs, counts if counts.any() else 0, mean, cov)
        return self._grouped(found) if self.scaled else found

    def _grouped(self, tried: Tried) -> Tried:
        """A sighting under each group of components, of which each source makes one Gaussian.

        Scales of one order of magnitude are too much alike to be kept as many.
        """
        assert isinstance(self.unknown, Components)
        groups, farthest = self.unknown.groups, self.unknown.farthest
        count = int(groups.max()) + 2  # the last one is of what no component explains
        far = np.append(farthest, np.False_)
        beyond = log_sum(tried.logs[:, far], 1)
        logs, mean, cov = (
            np.moveaxis(part, axis, axis - 1)
            for part, axis in ((tried.logs, 1), (tried.mean, 2), (tried.cov, 3))
        )
        counts = tried.counts
        if isinstance(counts, np.ndarray):
            counts = np.moveaxis(counts, 1, 0)
        owner = np.append(groups, count - 1)[:, None, None]
        owner = np.broadcast_to(owner, logs.shape)
        logs, counts = best_of(logs, counts, owner, count)
        whole = merging.merged(logs, owner, count, mean, cov, self._angles)
        if isinstance(counts, np.ndarray):
            counts = np.moveaxis(counts, 0, 1)
        logs, mean, cov = (
            np.moveaxis(part, axis - 1, axis)
            for part, axis in ((whole.logs, 1), (whole.mean, 2), (whole.cov, 3))
        )
        return Tried(logs, counts, mean, cov, beyond)

    def refuse_far(self, step: int, far: Mask) -> NoReturn:
        """Raise the NumericalError for a reading that is farther off than its robust noise reaches.

        `far` marks the runs.
        """
        run, cpd = self._given.bound.first_run + int(far.argmax()), self.reading.cpd
        step += self._given.first
        raise NumericalError(
            too_far(cpd, f" at step {step}, run {run},"),
            variable=cpd.child,
            cpd=cpd,
            step=step,
            run=run,
        )

    def settled(self) -> tuple[list[Array], Mask]:
        """The largest moves at each relinearisation, (runs,), and whether a run settled."""
        return settled_of(
            [batch for each in self._batches.values() for batch in each], self._given.bound.runs
        )

    def _read(
        self, batch: Batch, step: int, row: int, sources: Moments
    ) -> tuple[Moments, Read, MomentChain]:
        """The sources as a batch's runs, and the sighting with the candidates of the batch."""
        chain, local = batch.at(step)
        batch.used = True
        (size, copies), count = sources.mean.shape[:2], batch.which.size
        shape, flat = (copies, count, self._given.bound.runs), chain.plan.batch
        mean = np.broadcast_to(sources.mean[:, :, None], (size, *shape)).reshape(size, *flat)
        cov = np.broadcast_to(sources.cov[:, :, :, None], (size, size, *shape))
        (sensor,) = chain.plan.sensors
        part = Read(sensor, *sensor.sighting(sensor.rows(local).start + row))
        return Moments(mean, cov.reshape(size, size, *flat)), part, chain

    def _within(self, part: Read, before: Moments) -> Mask:
        """Whether a sighting lies within the candidates' gate, (*batch)."""
        gate = self.unknown.gate
        if gate is None:
            return np.ones(before.mean.shape[1:], dtype=bool)
        matrix, residual, noise, missing = vector([part.seen], before.mean)
        batch = before.mean.shape[1:]
        h = components_last(np.broadcast_to(matrix, (*matrix.shape[:2], *batch)), 2)
        spread = sandwich(h, components_last(before.cov, 2)) + components_last(noise, 2)
        square = mahalanobis.squares(residual, components_first(spread, 2))
        taken = len(residual) - (0 if missing is None else missing)
        limit = mahalanobis.square_within(gate, np.maximum(taken, 1))
        found: Mask = ~(np.asarray(square) > limit)
        return found

    def _of(self, copies: int) -> list[Batch]:
        """The batches of candidates, each tried on so many sources."""
        if copies not in self._batches:
            self._batches[copies] = [self._batch(*each, copies) for each in self._alike()]
        return self._batches[copies]

    def _alike(self) -> list[tuple[Integers, list[CPD]]]:
        """Candidates by number whose CPDs differ in numbers alone, with the CPD of each."""
        cpd, unknown = self.reading.cpd, self.unknown
        if isinstance(unknown, Components):
            own = list(unknown.parts)
        elif isinstance(unknown, UnknownVariable):
            own = [self._with(candidate) for candidate in unknown.candidates]
        else:
            return [(np.arange(unknown.count), [cpd])]
        groups: dict[object, list[tuple[int, CPD]]] = {}
        for k, each in enumerate(own):
            groups.setdefault(kind_of(each), []).append((k, each))
        return [
            (np.array([k for k, _ in group]), [own for _, own in group])
            for group in groups.values()
        ]

    def _with(self, candidate: Variable) -> CPD:
        """The sensor's CPD with a candidate in the place of its parent."""

        def moved(variable: Variable) -> Variable:
            return candidate if variable == self.parent else variable

        return self.reading.cpd._copy(moved)

    def _batch(self, which: Integers, cpds: list[CPD], copies: int) -> Batch:
        given, runs = self._given, self._given.bound.runs
        values: dict[Variable, Array] = {}
        if isinstance(self.unknown, UnknownVariable | Components):
            number = np.tile(np.repeat(np.arange(which.size), runs), copies)
            cpd = cpds[0] if len(cpds) == 1 else stacked(cpds, number)
        else:
            cpd = cpds[0]
            own = np.repeat(self.unknown.candidates, runs, axis=0)  # type: ignore[attr-defined]
            values[self.parent] = np.tile(own, (copies, 1))
        graph = SliceGraph(given.network(observation=[cpd]), given.bound.steps, False)
        inputs = seen(cpd, self.reading.inputs)
        reading = replace(self.reading, cpd=cpd, inputs=inputs, unknown=None)
        return Batch(given, which, copies, graph, (), [reading], values=values)
