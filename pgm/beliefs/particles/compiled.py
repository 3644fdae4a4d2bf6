"""Particle filters in machine code, their particles shared by threads.

Particles are moved, weighed and drawn anew block by block, in threads. Noise is drawn by counters
of the particle, the step and the CPD, and sums are joined in the order of blocks: so the particles
are the same for any number of threads. They are other ones than NumPy's, whose generators draw
a step's numbers one after another.

Transitions have to be affine, or functions that can be traced, with Gaussian noise of a fixed
covariance. Sensors that are neither like that nor have Student-t noise are weighed by NumPy, which
draws step 0 and restarts from the prior, too, and has all resampling that is not systematic. Traces
are judged as those of inference are: the functions are called at some of the particles, and where
one has another value all is drawn anew by NumPy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, cast

import numpy as np

from pgm.beliefs.particles.chain import Generators, ParticleChain
from pgm.beliefs.particles.record import Record
from pgm.beliefs.particles.settings import ParticleSettings
from pgm.beliefs.points.cloud import Cloud
from pgm.beliefs.points.laws import Law, Root, Some
from pgm.beliefs.points.model import ParticleModel, Sensor
from pgm.beliefs.points.streams import stream
from pgm.compile import DynamicGraph
from pgm.compile.machine import COMPILED
from pgm.cpds import NonlinearGaussianCPD
from pgm.cpds.losses import StudentT
from pgm.kernels import normal_density
from pgm.kernels.arrays import LOG_2PI, Array, Integers, Mask
from pgm.kernels.machine.particles import choosing, moving, weighing
from pgm.kernels.machine.particles.blocks import blocks, work
from pgm.kernels.machine.particles.laws import BEFORE, INPUT, NOW, LawForm, Parent, cells
from pgm.kernels.machine.studies.rows import constants
from pgm.kernels.machine.studies.sums import LANES
from pgm.kernels.philox import Words
from pgm.kernels.resampling import SYSTEMATIC
from pgm.networks.compiled_draws import Left, function_of, is_right, known_form
from pgm.resources import in_threads
from pgm.variables import Variable

# Operations of a CPD from which on its code is longer than it is worth.
_MOST = 3000
# Particles of a thread: of fewer, a thread takes longer to start than it saves.
_APIECE = 2**14
# About so many particles at which a CPD's function is judged.
_JUDGED = 1024


class CompiledChain(ParticleChain):
    """A particle filter of all runs, whose steps are machine code in threads.

    It raises `Left`, with the reason, for particles or a model that machine code does not have, and
    where a function's value is not finite.

    threads: How many threads there are at the most; few particles have fewer.
    """

    def __init__(
        self,
        graph: DynamicGraph,
        model: ParticleModel,
        particles: ParticleSettings,
        record: Record,
        threads: int,
    ) -> None:
        super().__init__(graph, model, particles, record)
        _require_plain(particles)
        useful = max(1, particles.n * model.bound.runs // _APIECE)
        self._threads = partial(in_threads, threads=min(threads, useful))
        every = 1 + (model.bound.steps + 1) * particles.n * model.bound.runs // _JUDGED
        self._judged = _Judged(every)
        self._laws = [_Compiled(law, model.places) for law in model.transition]
        self._sensors, self._others = list[_CompiledSensor](), list[Sensor]()
        self._why = list[str]()
        for each in model.sensors:
            try:
                self._sensors.append(_CompiledSensor(each, model.places))
            except Left as why:
                self._others.append(each)
                self._why.append(str(why))
        starts = particles.n * np.arange(model.bound.runs + 1)
        self._shares = blocks(starts)
        self._keys = _keys(particles.seed, model.bound.first_run, model.bound.runs)
        self._log_weights = np.empty(int(starts[-1]))  # of a step, not normalised

    @property
    def account(self) -> str:
        """The account of compilation, in words: which sensors NumPy weighs, with the reasons."""
        others = f"; weighed by NumPy: {'; '.join(self._why)}" if self._why else ""
        return f"{COMPILED}{others}"

    def judge(self) -> None:
        """Raise `Left` where a trace has had another value than the function that it is of."""
        for each in (*self._laws, *self._sensors):
            points = self._judged.points.get(each)
            if each.trace is None or points is None:
                continue
            every = [np.concatenate(of) for of in zip(*points, strict=True)]
            cpd = cast(NonlinearGaussianCPD, each.law.cpd)
            if not is_right(cpd, each.trace, every):
                raise Left(f"{cpd!r}: its function has other values than its trace")

    def predict(self, step: int, cloud: Cloud) -> Cloud:
        """The particles of a step, drawn from the transition; see `ParticleChain.predict`."""
        generators = _WhenAsked(self.particles.seed, self.model.bound.first_run, cloud.runs, step)
        source, starts, log_weights = self._drawn_anew(step, cloud, generators)
        states, checks = np.empty_like(cloud.states), np.empty(len(self._shares))
        row, (size, count) = self.model.row(step), states.shape
        self._work(
            moving.moving(size, tuple(each.form for each in self._laws), source is not None),
            *(count, step, row, cloud.states, states),
            *(0 if source is None else source, self._keys, checks),
            *(number for each in self._laws for number in each.numbers),
        )
        if np.isnan(checks).any():
            raise Left(f"the transition to step {step} has states that are not finite")
        found = Cloud(states, log_weights, starts, source, cloud.averages)
        for each in self._laws:
            self._judged.note(each, row, step, found, cloud.states)
        if source is None:
            return found.known(log_weights, cloud.weights, cloud.effective)
        return found

    def _resampled(
        self, cloud: Cloud, due: Mask, generators: Generators
    ) -> tuple[Integers, Integers, Array]:
        if self.particles.resampling != SYSTEMATIC:
            return super()._resampled(cloud, due, generators)
        runs, count = cloud.runs, self.particles.n
        shares, weights = self._shares[due[self._shares[:, 0]]], cloud.weights
        sums = np.empty(len(shares))
        work(choosing.adding(), shares, self._threads, weights, sums)
        # Summed one after another, as the weights of a block are.
        edges = sums.reshape(int(due.sum()), -1).cumsum(axis=1)
        bases = np.concatenate([np.zeros((len(edges), 1)), edges[:, :-1]], axis=1)
        totals, numbers, offsets = np.ones(runs), np.full(runs, float(count)), np.zeros(runs)
        totals[due] = edges[:, -1]
        offsets[due] = [generators[run].random() for run in np.flatnonzero(due).tolist()]
        source, starts = np.arange(len(weights)), np.ascontiguousarray(cloud.starts)
        told = totals, numbers, offsets, starts, source
        work(choosing.choosing(), shares, self._threads, weights, bases, *told)
        log_weights = np.where(cloud.spread(due), -np.log(count), cloud.log_weights)
        return source, cloud.starts, log_weights

    def _weighed(self, step: int, cloud: Cloud) -> tuple[Cloud, Array]:
        before = cloud.log_weights
        if any(each.rows(step) for each in self._others):
            before = before + self._by_numpy(step, cloud)
        tops = self._weigh(step, cloud, before, self._log_weights)
        if np.isneginf(tops).any():
            return super()._weighed(step, cloud)
        sums = np.empty(len(self._shares))
        self._work(weighing.summing(), self._log_weights, tops, sums)
        totals = tops + np.log(self._by_run(sums))
        log_weights, weights = np.empty((2, len(self._log_weights)))
        told = totals, log_weights, weights, sums
        self._work(weighing.normalising(), self._log_weights, *told)
        return cloud.known(log_weights, weights, 1.0 / self._by_run(sums)), totals

    def _log_likelihood(self, step: int, cloud: Cloud) -> Array:
        found = np.empty(len(cloud.log_weights))
        self._weigh(step, cloud, self._by_numpy(step, cloud), found)
        return found

    def _by_numpy(self, step: int, cloud: Cloud) -> Array:
        """The log-density of a step's measurements that machine code does not weigh, (particles,).

        The other measurements of the step are left out.
        """
        found = np.zeros(len(cloud.log_weights))
        for block in cloud.blocks():
            place = slice(block.first, block.last)
            some = self._some(cloud, step, block.first, block.last, cloud.states[:, place])
            for sensor in self._others:
                for row in sensor.rows(step):
                    sensor.add(row, some, found[place])
        return found

    def _weigh(self, step: int, cloud: Cloud, before: Array, after: Array) -> Array:
        """Add a step's log-densities to log-weights; returns the largest of each run, (runs,)."""
        found = np.empty((len(self._shares), 2))
        self._work(
            weighing.weighing(tuple(each.form for each in self._sensors)),
            *(len(before), cloud.states, before, after, found),
            *(number for each in self._sensors for number in each.numbers_at(step)),
        )
        if np.isnan(found).any():
            raise Left(f"a sensor has values that are not finite at step {step}")
        for each in self._sensors:
            rows = each.sensor.rows(step)
            if rows:
                self._judged.note(each, rows[step % len(rows)], step, cloud, cloud.states)
        largest: Array = found[:, 0].reshape(cloud.runs, -1).max(axis=1)
        return largest

    def _by_run(self, sums: Array) -> Array:
        """The sums of blocks, one after another, of each run, (runs,)."""
        found: Array = sums.reshape(self.model.bound.runs, -1).cumsum(axis=1)[:, -1]
        return found

    def _work(self, function: Callable[..., None], *given: Any) -> None:
        work(function, self._shares, self._threads, *given)


class _WhenAsked(Sequence[np.random.Generator]):
    """The generators of a step, one for each run, each made when it is asked for."""

    def __init__(self, seed: int, first: int, runs: int, step: int) -> None:
        self._seed, self._first, self._runs, self._step = seed, first, runs, step

    def __len__(self) -> int:
        return self._runs

    def __getitem__(self, run: Any) -> Any:
        return stream(self._seed, self._first + range(self._runs)[run], self._step)


class _Compiled:
    """A law as machine code is told of it: the form of its code, and the numbers of a call."""

    # The classes of robust noise that have code.
    _noises: ClassVar[tuple[type, ...]] = (type(None),)

    def __init__(self, law: Law, places: Mapping[Variable, slice]) -> None:
        cpd: Any = law.cpd
        self.law, self.trace = law, known_form(cpd)
        if cpd._lead():
            raise Left(f"{cpd!r} has axes of runs")
        if type(cpd.noise) not in self._noises:
            raise Left(f"{cpd!r} has the noise {cpd.noise!r}")
        trace = self.trace
        inputs = {v: np.ascontiguousarray(each) for v, each in law.inputs.items()}
        self._constants = constants(
            () if trace is not None else [cpd.matrices[parent] for parent in cpd.given],
            np.zeros(0) if trace is not None else cpd.offset,
            cpd._lower,
        )
        self._inputs = [inputs[parent] for parent in cpd.given if parent in inputs]
        self.form = LawForm(
            None if trace is None else function_of(trace),
            tuple(_parent(each, each in inputs, places) for each in cpd.given),
            cpd.child.dimension,
            places[cpd.child].start if cpd.child in places else 0,
            tuple(cpd.child.angle_mask.tolist()),
            cpd.noise is not None,
        )
        if self.form.row.operations > _MOST:
            raise Left(f"the code of {cpd!r} is longer than it is worth")

    @property
    def numbers(self) -> list[Any]:
        """The numbers of a call, in the order of `LawWriter`."""
        return [self._constants, *map(cells, self._inputs)]


class _CompiledSensor(_Compiled):
    """A sensor as machine code is told of it."""

    _noises = type(None), StudentT

    def __init__(self, sensor: Sensor, places: Mapping[Variable, slice]) -> None:
        super().__init__(sensor.law, places)
        self.sensor, taken = sensor, sensor.reading.taken
        cpd: Any = sensor.law.cpd
        size, noise, root = self.form.height, cpd.noise, Root(cpd._lower[None], np.float64)
        self._readings = np.where(taken, sensor.values, 0.0)
        patterns, which = np.unique(taken.reshape(-1, size), axis=0, return_inverse=True)
        whiteners, told = np.zeros((len(patterns), size, size)), np.zeros((len(patterns), 3))
        told[:, 2] = 1.0
        for pattern, whitener, numbers in zip(patterns, whiteners, told, strict=True):
            if pattern.any():
                part = root if pattern.all() else root.marginal(pattern)
                whitener[np.ix_(pattern, pattern)] = normal_density.whitener(part.lower[0])
                numbers[0], count = part.constant[0], int(pattern.sum())
                if noise is not None:
                    numbers[0] += 0.5 * count * LOG_2PI + noise._log_scale(count)
                    numbers[1:] = 0.5 * (noise.dof + count), noise.dof
        which = which.reshape(taken.shape[:2])
        self._whiteners = whiteners.reshape(-1, size * size)[which]
        self._told = told[which]

    def numbers_at(self, step: int) -> list[Any]:
        """The numbers of a call for a step's readings."""
        rows = self.sensor.rows(step)
        arrays = map(cells, (self._readings, self._whiteners, self._told))
        return [*self.numbers, rows.start, len(rows), *arrays]


class _Judged:
    """The parents' values of CPDs at some particles, by which traces are judged.

    every: Of so many particles, over all steps and runs, one is taken.
    """

    def __init__(self, every: int) -> None:
        self._every = every
        self.points: dict[_Compiled, list[list[Array]]] = {}

    def note(self, of: _Compiled, row: int, step: int, cloud: Cloud, before: Array) -> None:
        """Note some particles at which a law was evaluated, at a row of its inputs."""
        count = len(cloud.log_weights)
        which = np.arange(-step * count % self._every, count, self._every)
        if of.trace is None or not len(which):
            return
        ancestors = which if cloud.ancestors is None else cloud.ancestors[which]
        owner = None if cloud.runs == 1 else which // (count // cloud.runs)
        some = Some(step, cloud.states[:, which], before[:, ancestors], owner)
        values = of.law.given(row, some)
        self.points.setdefault(of, []).append([values[v].copy() for v in of.law.cpd.given])


def _parent(parent: Variable, known: bool, places: Mapping[Variable, slice]) -> Parent:
    if known:
        return Parent(INPUT, 0, parent.dimension)
    place = places[parent.template]
    return Parent(BEFORE if parent.lag else NOW, place.start, parent.dimension)


def _require_plain(particles: ParticleSettings) -> None:
    """Raise `Left` for particles that machine code does not have."""
    options = ("proposal", "number", "start", "injection")
    given = [f"{name}=" for name in options if getattr(particles, name) is not None]
    if given:
        raise Left(f"particles with {', '.join(given)} are moved by NumPy")
    if particles.dtype is not np.float64:
        raise Left("states are float64 in machine code, and dtype= is another")
    if particles.n < LANES:
        raise Left(f"machine code takes {LANES} particles or more of a run")


def _keys(seed: int, first: int, runs: int) -> Words:
    """The key of each run's counters, (runs, 2)."""
    each = (np.random.SeedSequence(seed, spawn_key=(run,)) for run in range(first, first + runs))
    return np.array([seeds.generate_state(2, np.uint64) for seeds in each])
