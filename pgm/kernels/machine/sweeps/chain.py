"""Sweeps of a chain in machine code, forward and back, written for it and compiled once."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import lru_cache, partial
from typing import Any

import numpy as np

from pgm.kernels import step
from pgm.kernels.arrays import Integers
from pgm.kernels.machine.emitter.kinds import ADDRESS, WHOLE
from pgm.kernels.machine.emitter.module import Module
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.matrices.in_memory.frame import Frame
from pgm.kernels.machine.matrices.lines import Lines
from pgm.kernels.machine.matrices.loops import Loops
from pgm.kernels.machine.sweeps import costs, lost, mixture, relinearising, windows
from pgm.kernels.machine.sweeps.associating import associated, is_open
from pgm.kernels.machine.sweeps.extent import is_long
from pgm.kernels.machine.sweeps.motion import predicted
from pgm.kernels.machine.sweeps.reading import taken
from pgm.kernels.machine.sweeps.rounding import Rounding, is_far
from pgm.kernels.machine.sweeps.told import Backward, Forward, Linearised, Mixture, Windows
from pgm.kernels.machine.sweeps.watch import Watch
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.numbers import where
from pgm.kernels.step import AnyMatrix

# Runs that are swept together, as the lanes of packs.
LANES = 8
# What a sweep tells of each run: whether it is left to be swept with more care, the least share of
# a variance, whether a mean is far from zero, whether weights have not settled, and whether the
# belief was ever lost; of a sweep back whether it is left, and whether smoothed numbers surely have
# the digits that are promised.
LEFT, CLOSEST, FAR, MOVING, LOST = range(5)
KEPT = 1
TOLD = 5
# A number from which on little or nothing can be told.
_LARGEST = 1e150
# The least share of a root on the way back, as of `backward`.
_CORRELATED = 3e-5

Sweep = Callable[[int, int, int], None]
Chain = Forward | Backward | Mixture | Windows | Linearised


@lru_cache(maxsize=128)
def made(chain: Chain, lanes: int, loops: bool | None = None) -> Sweep:
    """The sweep of a chain, of single runs or of packs: ``sweep(table, first, last)``.

    It sweeps the runs from `first` to below `last`, of which there are as many as lanes at least.
    `loops` says whether it is written in loops or in straight lines; by default its size decides.
    """
    module = Module()
    code = module.function("sweep", (ADDRESS, WHOLE, WHOLE, ADDRESS), lanes=lanes)
    table, first, last, room = code.arguments
    frame = Frame(code, room)
    looped = is_long(chain, lanes) if loops is None else loops
    w = Writer(code, table, chain, Loops(code, frame) if looped else Lines(code))
    with each_run(w, first, last):
        swept(w, chain)
    # Of straight lines all of LLVM's passes make faster code; of loops they only take longer.
    function = module.compile(1 if looped else 2).callable("sweep")
    return frame.with_room(function) if looped else partial(_without_room, function)


def swept(w: Writer, chain: Chain) -> None:
    """Write the sweep of the runs at hand."""
    if isinstance(chain, Forward):
        forward(w, chain)
    elif isinstance(chain, Windows):
        _tell(w, LEFT, where(windows.written(w, chain), 0.0, 1.0))
    elif isinstance(chain, Mixture):
        _tell(w, LEFT, where(mixture.written(w, chain), 0.0, 1.0))
    elif isinstance(chain, Linearised):
        written = relinearising.written if chain.cost is None else costs.written
        _tell(w, LEFT, where(written(w, chain), 0.0, 1.0))
    else:
        _backward(w, chain)


def _without_room(function: Callable[..., None], table: int, first: int, last: int) -> None:
    function(table, first, last, None)


@contextmanager
def each_run(w: Writer, first: Whole, last: Whole) -> Iterator[None]:
    """The runs of a call, one after another, or pack by pack: the last may share runs."""
    code = w.code
    with code.loop((last - first + (code.lanes - 1)) // code.lanes) as k:
        run = code.variable(first + k * code.lanes)
        with code.when(run.get() > last - code.lanes):
            run.set(last - code.lanes)
        w.run = run.get()
        yield


def forward(w: Writer, chain: Forward) -> None:
    """Write the forward sweep of the runs at hand."""
    code, last = w.code, w.last
    begin = w.column(chain.begin[0]), w.symmetric(chain.begin[1])
    belief = w.matrices.carried(*begin)
    sure, settled = code.varying(True), code.varying(True)
    watch = Watch(w, chain.size)
    tests = lost.Tests(w, gated=any(sensor.gate is not None for sensor in chain.sensors))
    with code.loop(last + 1) as at, w.matrices.scratch():
        w.reach(at.number(), sure.get())
        with code.when(at > 0), w.matrices.scratch():
            moved = predicted(w, chain, at - 1, belief.mean, belief.cov)
            belief.set(moved.mean, moved.cov)
            sure.set(sure.get() & moved.sure)
            w.reach(at.number(), sure.get())
        mean, cov = belief.mean, belief.cov
        if chain.predicted:
            _keep_predicted(w, chain, at, mean, cov)
        found = (associated if is_open(chain) else taken)(w, chain, at, mean, cov)
        known, spread = found.moments.mean, found.moments.cov
        numbers = [abs(x) for vector in (mean, known) for x in w.matrices.beside(vector)]
        numbers += [x for matrix in (cov, spread) for x in w.matrices.diagonal(matrix)]
        total = found.density + w.sum(numbers)
        sure.set(sure.get() & found.sure & (abs(total) < _LARGEST))
        settled.set(settled.get() & found.settled)
        w.keep(chain.known[0], known, at)
        w.keep(chain.known[1], spread, at)
        w.at(chain.density, at).store(0, found.density)
        for array, square in zip(chain.squares, found.squares, strict=True):
            w.at(array, at).store(0, square.get())
        watch.look(at, last, known, cov, spread)
        tests.take(found.counts)
        belief.set(known, spread)
        code.leave_unless(code.some(sure.get()))
    w.reach(float("inf"), sure.get())
    _tell(w, LEFT, where(sure.get(), 0.0, 1.0))
    _tell(w, CLOSEST, watch.closest)
    _tell(w, FAR, where(watch.far, 1.0, 0.0))
    _tell(w, MOVING, where(settled.get(), 0.0, 1.0))
    _tell(w, LOST, where(tests.lost, 1.0, 0.0))


def _keep_predicted(w: Writer, chain: Forward, at: Whole, mean: AnyMatrix, cov: AnyMatrix) -> None:
    """Keep a step's predicted belief, in one of so many packs of runs; see `kept_runs`."""
    run = w.run
    with (
        w.code.when(run % (w.code.lanes * chain.thinned) == 0)
        if chain.thinned > 1
        else nullcontext()
    ):
        w.run = run // chain.thinned
        for array, part in zip(chain.predicted, (mean, cov), strict=True):
            w.keep(array, part, at)
        w.run = run


def kept_runs(runs: int, thinned: int) -> Integers:
    """The runs whose predicted beliefs are kept by one of so many packs, in their order."""
    first = np.arange(0, runs - LANES + 1, LANES * thinned)
    found: Integers = (first[:, None] + np.arange(LANES)).ravel()
    return found


def _backward(w: Writer, chain: Backward) -> None:
    """Write the sweep back of the runs at hand."""
    code, last = w.code, w.last
    final = w.column(chain.known[0], last), w.symmetric(chain.known[1], last)
    later = w.matrices.carried(*final)
    for array, part in zip(chain.smoothed, final, strict=False):
        w.keep(array, part, last)
    sure = code.varying(True)
    kept, rounding = code.varying(bool(chain.smoothed)), Rounding(w)
    with code.loop(last, down=True) as at, w.matrices.scratch():
        states = chain.states
        own = w.column(chain.known[0], at), w.symmetric(chain.known[1], at)
        moved = w.matrix(chain.motion[0], at), w.symmetric(chain.motion[1], at)
        after = w.column(chain.predicted[0], at + 1), w.symmetric(chain.predicted[1], at + 1)
        front = own[0].part(states, (0,)), own[1].part(states, states)
        if chain.reversed:
            back = step.reverse(*front, *moved, *after)
            root, shown = back.root, back.offset
            for array, part in zip(chain.reversed, back[:3], strict=True):
                w.keep(array, part, at)
        if chain.smoothed:
            if chain.reversed:
                moments = step.push(later.mean, later.cov, *back[:3])
            else:
                found = step.back(*front, *moved, after, (later.mean, later.cov))
                moments, root = found[:2], found.root
            if chain.controls:
                matrix, offset, noise = chain.controls
                own_part = w.matrix(matrix, at), w.column(offset, at), w.symmetric(noise, at)
                moments = step.push(*moments, *own_part)
            for array, part in zip(chain.smoothed, moments, strict=True):
                w.keep(array, part, at)
            # Of the rest of a covariance its root, or the squares that it is the sum of, tell.
            numbers = [abs(x) for x in w.matrices.beside(moments[0])]
            for each in (own[1], moments[1]):
                numbers += w.matrices.diagonal(each)
            fine = rounding.counts_not(own[1], after[1], root, moments[1])
            fine = fine & (w.sum(numbers) < _LARGEST) & ~is_far(w, *moments)
            kept.set(kept.get() & fine)
            later.set(*moments)
            shown = moments[0]
        shift = w.sum([abs(x) for x in w.matrices.beside(shown)])
        sure.set(sure.get() & (root.share > _CORRELATED) & (shift < _LARGEST))
        code.leave_unless(code.some(sure.get()))
    _tell(w, LEFT, where(sure.get(), 0.0, 1.0))
    _tell(w, KEPT, where(kept.get(), 1.0, 0.0))


def _tell(w: Writer, what: int, number: Any) -> None:
    """Tell something of each of the runs at hand."""
    w.ended(what).store(0, number)
