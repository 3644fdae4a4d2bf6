"""The table of a chain's numbers: their places, and how the arrays lie that it points to."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.kernels.machine.emitter.memory import Runs

# Of a chain's table: the last step T, how many runs there are, the most linearisations of a step's
# measurements, the addresses of the settings (the tolerance and the damping; of a control the least
# weight, its factor and the most tries), of the residuals of iterations (iterations + 1, runs), and
# of how runs ended and went: (4, runs), see `sweeps`; and a lag.
LAST, RUNS, ITERATIONS, SETTINGS, RESIDUALS, ENDED, LAG, FIRST = range(8)
# Of an array: its address, and the distances in floats between rows, runs, and its own cells.
ADDRESS, DOWN, ACROSS, CELL = range(4)
# What a program is asked for: the number of a function, at how many points, or zero for a
# linearisation, at which rows, of one step, and from which place on the answers are put; the step
# at hand, infinite at the end; and whether a run is right so far.
WHAT, COUNT, ROW, AFTER, PLACE, STEP, SURE, ASKED = range(8)


@dataclass(frozen=True)
class Array:
    """An array (rows or 1, runs or 1, own axes): its place in the table, and how it lies.

    Attributes
    ----------
    place : int
        Of its address in the table; its distances follow.
    shape : tuple of int
        Its own axes.
    runs : Runs
        How its runs lie.
    near : bool
        Whether its own cells are next to each other.
    """

    place: int
    shape: tuple[int, ...]
    runs: Runs
    near: bool
