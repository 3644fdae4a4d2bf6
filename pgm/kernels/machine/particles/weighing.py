"""Particles weighed by the readings of a step: w_t ∝ w_{t−1} p(z_t | x_t), as logarithms.

A reading z has the log-density c − ½ |W (z − f(x))|², with angles of z − f(x) within half a turn of
zero. Of a covariance R = L Lᵀ, W is L⁻¹, and of the components that were measured alone, with zeros
for the others; c is the log-density at z = f(x). Of Student-t noise the log-density is
c − e ln(1 + |W (z − f(x))|² / ν), with e = (ν + d) / 2 of the d components that were measured.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import inf, nan
from typing import Any

from pgm.kernels.machine.emitter.memory import Memory
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.particles.blocks import KINDS, each_block, each_pack_once
from pgm.kernels.machine.particles.laws import ByRow, LawForm, LawWriter
from pgm.kernels.machine.studies.sums import LANES, Given, each_pack, together
from pgm.kernels.numbers import log, most, where
from pgm.kernels.step import turns


@lru_cache(maxsize=32)
def weighing(sensors: tuple[LawForm, ...]) -> Callable[..., None]:
    """The function that adds the log-densities of readings to the log-weights of particles.

    Its numbers are the blocks; the number of particles; the states (d, particles); the log-weights
    before and after, (particles,); of each block, the largest log-weight and a check, (blocks, 2),
    which is NaN where a function's value is not finite or a weight is NaN, else 0; and of each
    sensor those of its law, the first of its rows and how many they are, and z, W and c by row and
    run; of Student-t noise c, e and ν.
    """
    code = Module().function("weighed", KINDS, lanes=LANES)
    given = Given(code, code.arguments[0])
    shares, width = given.address(), given.whole()
    states, before, after, found = (given.address() for _ in range(4))
    writers = [_SensorWriter(form, given) for form in sensors]
    with each_block(code, shares) as block:
        top, check = code.varying(-inf), code.varying(0.0)
        with each_pack(code, block.size) as first:
            place = block.first + first
            now = Memory(code, states + place, step=width)
            total = code.variable(Memory(code, before + place).load(0))
            for writer in writers:
                with code.loop(writer.count) as k:
                    log_density, sound = writer.log_density(k, block.run, now)
                    total.set(total.get() + log_density)
                    check.set(check.get() + sound)
            log_weight = total.get()
            check.set(check.get() + where(log_weight < inf, 0.0, nan))
            Memory(code, after + place).store(0, log_weight)
            top.set(most(top.get(), log_weight))
        told = Memory(code, found, lanes=1)
        told.store(block.number * 2, largest(top.get()))
        told.store(block.number * 2 + 1, together(check.get()))
    return code.module.compile().callable("weighed")


class _SensorWriter:
    """A sensor that is being written."""

    def __init__(self, form: LawForm, given: Given) -> None:
        self._form, self._law = form, LawWriter(form, given)
        self._first, self.count = given.whole(), given.whole()
        self._readings, self._whitener, self._told = (ByRow(given) for _ in range(3))

    def log_density(self, k: Whole, run: Whole, now: Memory) -> tuple[Any, Any]:
        """The log-density of reading k of the step, and 0, or NaN where f(x) is not finite."""
        row, form = self._first + k, self._form
        mean = self._law.child.mean(self._law.parents(row, run, now, now))
        readings, whitener = self._readings.at(row, run), self._whitener.at(row, run)
        sound: Any = 0.0
        residuals = []
        for i, (value, angle) in enumerate(zip(mean, form.angles, strict=True)):
            residual = readings.load(i) - value
            residuals.append(residual - turns(residual) if angle else residual)
            sound = value * 0.0 + sound
        square: Any = 0.0
        for i in range(form.height):
            white: Any = 0.0
            for j in range(i + 1):
                white = white + whitener.load(i * form.height + j) * residuals[j]
            square = square + white * white
        told = self._told.at(row, run)
        loss = 0.5 * square
        if form.tails:
            loss = told.load(1) * log(1.0 + square / told.load(2))
        return told.load(0) - loss, sound


def largest(pack: Number) -> Number:
    """The largest of the lanes of a pack."""
    found = pack.lane(0)
    for lane in range(1, pack.lanes):
        found = most(found, pack.lane(lane))
    return found


@lru_cache(maxsize=1)
def summing() -> Callable[..., None]:
    """The function that sums weights by block, each relative to the largest of its run.

    Its numbers are the blocks, the log-weights, the largest of each run, and the sums.
    """
    code = Module().function("summed", KINDS, lanes=LANES)
    given = Given(code, code.arguments[0])
    shares = given.address()
    log_weights, tops, sums = (given.address() for _ in range(3))
    with each_block(code, shares) as block:
        top, total = Memory(code, tops, lanes=1).load(block.run), code.varying(0.0)
        with each_pack_once(code, block.size) as (first, fresh):
            log_weight = Memory(code, log_weights + (block.first + first)).load(0)
            weight = code.applied("exp", log_weight - top)
            total.set(total.get() + where(fresh, weight, 0.0))
        Memory(code, sums, lanes=1).store(block.number, together(total.get()))
    return code.module.compile().callable("summed")


@lru_cache(maxsize=1)
def normalising() -> Callable[..., None]:
    """The function that normalises weights, and sums their squares by block.

    Its numbers are the blocks, the log-weights, the logarithm of their sum in each run; the
    normalised log-weights and weights; and the sums of squares.
    """
    code = Module().function("normalised", KINDS, lanes=LANES)
    given = Given(code, code.arguments[0])
    shares = given.address()
    log_weights, totals, logs, weights, sums = (given.address() for _ in range(5))
    with each_block(code, shares) as block:
        total = Memory(code, totals, lanes=1).load(block.run)
        square = code.varying(0.0)
        with each_pack_once(code, block.size) as (first, fresh):
            place = block.first + first
            log_weight = Memory(code, log_weights + place).load(0) - total
            weight = code.applied("exp", log_weight)
            Memory(code, logs + place).store(0, log_weight)
            Memory(code, weights + place).store(0, weight)
            square.set(square.get() + where(fresh, weight * weight, 0.0))
        Memory(code, sums, lanes=1).store(block.number, together(square.get()))
    return code.module.compile().callable("normalised")
