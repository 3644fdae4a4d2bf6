"""The density of trajectories and measurements of a switching model, given paths of its regimes.

Functions are taken as they are, not linearised. Trajectories are (T+1, draws, runs, n), with the n
components of all continuous states at a step, and paths (T+1, draws, runs).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from pgm.beliefs.hypotheses.cases import case_numbers
from pgm.beliefs.hypotheses.chain import HypothesisChain
from pgm.beliefs.hypotheses.regimes import Regimes
from pgm.beliefs.points.laws import Law, Some
from pgm.beliefs.points.mixture_law import law
from pgm.beliefs.points.model import Sensor
from pgm.cpds import CPD, SwitchingCPD
from pgm.cpds.mixture import by_run
from pgm.errors import ModelError
from pgm.evidence import Reading
from pgm.evidence.dynamic import Inputs
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.variables import Variable

Own = TypeVar("Own", Law, Sensor)


@dataclass(frozen=True, eq=False)
class Chosen(Generic[Own]):
    """The laws of a CPD's cases, and which of them regimes choose.

    each: The laws, by the number of the case.
    number: The case in a regime given the memory before, (memories or 1, regimes).
    """

    each: list[Own]
    number: Integers

    @classmethod
    def of(cls, regimes: Regimes, cpd: CPD, make: Callable[[CPD], Own]) -> Chosen[Own]:
        """The laws that `make` makes of the cases of a CPD, or of a CPD that nothing chooses."""
        if not isinstance(cpd, SwitchingCPD):
            return cls([make(cpd)], np.zeros((1, regimes.size), dtype=np.intp))
        number = np.atleast_2d(case_numbers(regimes, cpd))
        number = np.broadcast_to(number, (len(number), regimes.size))
        return cls([make(case) for case in cpd.cases.values()], number)

    def parts(self, memory: Integers, regime: Integers) -> Iterator[tuple[Own, Mask]]:
        """The laws, each with the mask of the draws (m,) whose memory and regime choose it."""
        number = self.number[memory if len(self.number) > 1 else 0, regime]
        for k, own in enumerate(self.each):
            some = number == k
            if some.any():
                yield own, some


class TrajectoryDensity:
    """The densities of a chain's CPDs in their cases, with its evidence.

    A chain with hidden controls, which have no value at step 0, is a ModelError.
    """

    def __init__(self, chain: HypothesisChain) -> None:
        given, roles, regimes = chain.given, chain.roles, chain.regimes
        self._regimes, bound = regimes, given.bound
        self._places: dict[Variable, slice] = {}
        end = 0
        for variable in given.hidden:
            if variable not in given.states:
                raise ModelError(
                    f"{variable!r} is a hidden control, and beside nonlinear CPDs no audit of a "
                    "switching model draws these: give it a prior, as a state",
                    variable=variable,
                )
            self._places[variable] = slice(end, end + variable.dimension)
            end += variable.dimension
        about = self._places, np.dtype(float), bound.first_run

        def made(inputs: Inputs, cpd: CPD) -> Law:
            return law(by_run(cpd, bound.lead), inputs, *about)

        def read(reading: Reading, cpd: CPD) -> Sensor:
            own = made(reading.inputs, cpd)
            return Sensor(own, replace(reading, cpd=own.cpd))

        self._prior = [Chosen.of(regimes, cpd, partial(made, {})) for cpd in roles.prior]
        self._motion = [
            Chosen.of(regimes, cpd, partial(made, inputs))
            for cpd, inputs in zip(roles.transition, roles.inputs, strict=True)
        ]
        self._sensors = [
            Chosen.of(regimes, reading.cpd, partial(read, reading)) for reading in roles.readings
        ]

    def log_density(self, values: Array, paths: Integers) -> Array:
        """Ln p(x, z | path) of trajectories x with all measurements z, (draws, runs)."""
        _, draws, runs, size = values.shape
        run = np.tile(np.arange(runs), draws)
        owner = run if runs > 1 else None
        total = np.zeros(draws * runs)
        before = np.zeros((size, draws * runs))
        memory = np.zeros(draws * runs, dtype=np.intp)
        for step, path in enumerate(paths):
            now, regime = values[step].reshape(-1, size).T.copy(), path.ravel()
            some = Some(step, now, before, owner)
            for laws in self._motion if step else self._prior:
                for own, which in laws.parts(memory, regime):
                    part = some.chosen(which)
                    child = part.now[self._places[own.cpd.child]]
                    total[which] += own.log_density(max(step - 1, 0), part, child)
            for sensors in self._sensors:
                for sensor, which in sensors.parts(memory, regime):
                    found = np.zeros(int(which.sum()))
                    for row in sensor.rows(step):
                        sensor.add(row, some.chosen(which), found)
                    total[which] += found
            told = self._regimes.likelihood(step)
            if told is not None:
                total += np.broadcast_to(told, (len(told), runs))[regime, run]
            before, memory = now, self._regimes.memory[regime]
        return total.reshape(draws, runs)
