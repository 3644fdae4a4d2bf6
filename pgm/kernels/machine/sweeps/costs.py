"""The cost of a trajectory, by which a step control of smoothers judges its steps.

It is that of `LevenbergMarquardt`, without the prior's.
"""

from __future__ import annotations

from typing import Any

from pgm.kernels import step
from pgm.kernels.machine.emitter.numbers import Number
from pgm.kernels.machine.emitter.wholes import Whole
from pgm.kernels.machine.sweeps.control import cost, expected
from pgm.kernels.machine.sweeps.cpd import REGULAR, on_branch
from pgm.kernels.machine.sweeps.relinearising import Beliefs, pair_at
from pgm.kernels.machine.sweeps.told import Linearised, Motion
from pgm.kernels.machine.sweeps.writer import Writer
from pgm.kernels.step import AnyMatrix


def written(w: Writer, chain: Linearised) -> Number:
    """Write the cost of the runs at hand; whether it is right, so far as can be told."""
    code, beliefs = w.code, Beliefs(*chain.point)
    total, sure = code.varying(0.0), code.varying(True)

    def add(found: tuple[Any, Number]) -> None:
        total.set(total.get() + found[0])
        sure.set(sure.get() & found[1])

    with code.loop(w.last + 1) as at, w.matrices.scratch():
        with code.when(at > 0), w.matrices.scratch():
            for motion, mean, cov, child in pair_at(w, chain, beliefs, at - 1):
                add(_moved(w, motion, at - 1, mean, cov, child))
        for sensor in chain.sensors:
            with w.each_sighting(sensor, at) as row:
                cov = None if beliefs.cov is None else w.symmetric(beliefs.cov, at)
                add(cost(w, sensor, row, w.column(beliefs.mean, at), cov))
    assert chain.cost is not None
    w.at(chain.cost).store(0, total.get())
    return sure.get()


def _moved(
    w: Writer, motion: Motion, at: Whole, x: AnyMatrix, cov: AnyMatrix, child: AnyMatrix
) -> tuple[Any, Number]:
    """The cost of a CPD of a transition at a row, and whether it is right, so far as is told."""
    value, sure = expected(w, motion, at, x, cov)
    noise = w.symmetric(motion.kept or motion.noise, at)
    left, root = on_branch(w, child, value, motion.angles) - value, noise.root()
    return step.whitened(left, root).square, sure & (root.share > REGULAR)
