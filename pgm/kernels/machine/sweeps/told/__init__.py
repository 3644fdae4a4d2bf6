"""A chain as machine code is told of it: the form that decides the code, and places of numbers.

A chain is told in two parts. What stands here is known before the code is made, and is the key of
what was made before: sizes, places, the users' functions, how arrays lie. All else comes with each
call, in a *table* of integers: addresses, lengths, and the distances between numbers. A chain of
other values, or of other lengths, is swept by the same code.

A *row* of a CPD is a step of a transition, or a sighting of a sensor; *runs* are the simulations or
robots that are swept together.
"""

from pgm.kernels.machine.sweeps.told.chains import (
    Backward,
    Forward,
    Linearised,
    Mixture,
    Windows,
)
from pgm.kernels.machine.sweeps.told.kept import as_kept, chosen, kept_sensor
from pgm.kernels.machine.sweeps.told.rows import Called, Lines, Motion, Points, Row, Rows
from pgm.kernels.machine.sweeps.told.sensors import Candidates, Gate, Loss, Sensor
from pgm.kernels.machine.sweeps.told.table import (
    ACROSS,
    AFTER,
    ASKED,
    CELL,
    COUNT,
    DOWN,
    ENDED,
    FIRST,
    ITERATIONS,
    LAG,
    LAST,
    PLACE,
    RESIDUALS,
    ROW,
    RUNS,
    SETTINGS,
    STEP,
    SURE,
    WHAT,
    Array,
)

__all__ = [
    "ACROSS",
    "AFTER",
    "ASKED",
    "CELL",
    "COUNT",
    "DOWN",
    "ENDED",
    "FIRST",
    "ITERATIONS",
    "LAG",
    "LAST",
    "PLACE",
    "RESIDUALS",
    "ROW",
    "RUNS",
    "SETTINGS",
    "STEP",
    "SURE",
    "WHAT",
    "Array",
    "Backward",
    "Called",
    "Candidates",
    "Forward",
    "Gate",
    "Linearised",
    "Lines",
    "Loss",
    "Mixture",
    "Motion",
    "Points",
    "Row",
    "Rows",
    "Sensor",
    "Windows",
    "as_kept",
    "chosen",
    "kept_sensor",
]
