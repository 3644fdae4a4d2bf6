"""Draws of many runs on a card, a thread a run: the numbers of `compiled_draws`, which stay there.

Counters have NumPy's words bit for bit, and so have uniform numbers; normal ones, and all that
follows from them, are those of the processor to rounding, as elementary functions are another
library's. Traces are judged at some points of a few runs, which come home.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgm.cpds.conditional import ConditionalGaussian
from pgm.cpds.gaussian import GaussianCPD
from pgm.evidence import BoundEvidence
from pgm.kernels import philox
from pgm.kernels.arrays import Array, Integers
from pgm.kernels.machine.emitter.arena import Arena
from pgm.kernels.machine.emitter.driver import Device
from pgm.kernels.machine.emitter.memory import Runs
from pgm.kernels.machine.studies import card as kernels
from pgm.kernels.machine.studies.rows import Placed, Resident
from pgm.kernels.machine.studies.sums import Cells
from pgm.networks.compiled_draws import Left, child_of, is_right, known_form, points_of
from pgm.networks.dynamic import DynamicBayesianNetwork
from pgm.networks.sampling import places_of
from pgm.tracing.program import Program
from pgm.variables import Variable

# The kept runs of an array (places, kept runs, d) on a card, given how many places it has.
Bring = Callable[[Cells, int, int], Array]


class _Given(NamedTuple):
    """A parent of a CPD's rows: its values, or the variable whose path or readings has them."""

    values: Array | Variable
    places: Integers


class _Row(NamedTuple):
    """A CPD that is drawn: its trace, its parents, the counters of its rows, and where it goes."""

    cpd: Any
    trace: Program | None
    given: Sequence[_Given]
    order: Integers
    places: Integers


class CardDraws:
    """Draws of a model on a card: states at all steps, and readings, sorted by their steps.

    It raises a `Left` where machine code cannot draw the model, or its noise is not Gaussian.
    """

    def __init__(self, model: DynamicBayesianNetwork, bound: BoundEvidence, seed: int) -> None:
        self.model, self.bound, self._seed = model, bound, seed
        for cpd in model.cpds:
            if not isinstance(cpd, ConditionalGaussian):
                raise Left(f"{cpd!r} is not Gaussian")
        hidden = (*model.states, *model.controls)
        self.rows = {v: (bound.steps + 1, v.dimension) for v in hidden}
        self.rows |= {r.cpd.child: (len(r.step), r.cpd.child.dimension) for r in bound.readings}
        one, ahead = np.zeros(1, dtype=np.intp), np.arange(1, bound.steps + 1)
        self._prior = [
            self._row(cpd, {}, dict.fromkeys(cpd.given, one), one, one) for cpd in model.prior
        ]
        pairs = zip(model.transition, bound.transition, strict=True)
        self._transition = [
            self._row(cpd, inputs, {v: ahead - v.lag for v in cpd.given}, ahead, ahead)
            for cpd, inputs in (pairs if bound.steps else ())
        ]
        self._sensors = [
            self._row(
                each.cpd,
                each.inputs,
                dict.fromkeys(each.cpd.given, each.step),
                each.order,
                np.arange(len(each.step)),
            )
            for each in bound.readings
            if each.step.size
        ]

    def _row(
        self,
        cpd: Any,
        inputs: Mapping[Variable, Array],
        steps: Mapping[Variable, Integers],
        order: Integers,
        places: Integers,
    ) -> _Row:
        if cpd.noise is not None:
            raise Left(f"the noise of {cpd.child!r} is {cpd.noise!r}")
        trace = None if type(cpd) is GaussianCPD else known_form(cpd)
        given = []
        for parent in cpd.given:
            values, count = inputs.get(parent), len(order)
            if values is None:
                given.append(_Given(parent.template, steps[parent]))
            elif values.shape[1] > 1:
                raise Left(f"values of {parent!r} depend on the run")
            else:
                several = np.arange(count) if len(values) > 1 else np.zeros(count, dtype=np.intp)
                given.append(_Given(values, several))
        return _Row(cpd, trace, given, order, places)

    def lie(self, fixed: Arena, loose: Arena, stride: int) -> LaidDraws:
        """The draws with their arrays on a card; copies, which stay, are in the `fixed` arena."""
        return LaidDraws(self, fixed, loose, stride)


class LaidDraws:
    """Draws whose arrays lie on a card.

    Attributes
    ----------
    cells : mapping
        Of each variable its values, (steps or readings, d), as `Cells`.
    """

    def __init__(self, draws: CardDraws, fixed: Arena, loose: Arena, stride: int) -> None:
        self._draws, self._loose = draws, loose
        self.cells = {
            v: Cells(loose.floats(count * d * stride), 1, d * stride, stride)
            for v, (count, d) in draws.rows.items()
        }
        self._sums = loose.floats(stride)
        place, parts = places_of(draws.model), (draws._prior, draws._transition, draws._sensors)
        drawn = [[self._drawn(row, fixed, place[row.cpd.child]) for row in rows] for rows in parts]
        self._form = kernels.Drawing(*(tuple(each.child.form for each in rows) for rows in drawn))
        numbers = [number for rows in drawn for each in rows for number in each.numbers]
        key = philox.Philox(draws._seed).key.view(np.int64).tolist()
        self._table = kernels.table(fixed, *key, self._sums, *numbers)

    def _drawn(self, row: _Row, fixed: Arena, variable: int) -> kernels.Drawn:
        given = [self._resident(each, fixed) for each in row.given]
        child = row.cpd.child
        out = Resident(self.cells[child], child.dimension, Runs.BESIDE, row.places)
        made = child_of(row.cpd, row.trace, given, None, out)
        return kernels.Drawn(made, variable, np.ascontiguousarray(row.order, dtype=np.int64))

    def _resident(self, given: _Given, fixed: Arena) -> Resident:
        values = given.values
        if isinstance(values, Variable):
            return Resident(self.cells[values], values.dimension, Runs.BESIDE, given.places)
        width = values.shape[-1]
        cells = Cells(fixed.put(values[:, 0]), 0, width, 1)
        return Resident(cells, width, Runs.SAME, given.places)

    def draw(self, device: Device, first: int, runs: int) -> bool:
        """Draw so many runs from one on; whether all of their numbers are finite."""
        kernel = kernels.loaded(kernels.drawing, kernels.DRAW, device, self._form)
        device.launch(kernel, runs, (self._table, first, first + runs), kernels.KINDS)
        return bool(np.isfinite(self._loose.get(self._sums, (runs,))).all())

    def require_right(self, bring: Bring) -> None:
        """Judge traces at the kept runs, as many of them as there are; a `Left` if one is wrong."""
        draws, found = self._draws, dict[Variable, Array]()
        for row in (*draws._prior, *draws._transition, *draws._sensors):
            if row.trace is None:
                continue
            given = []
            for values, places in row.given:
                if isinstance(values, Variable):
                    if values not in found:
                        found[values] = bring(self.cells[values], *draws.rows[values])
                    values = found[values]
                given.append(Placed(values, places))
            runs = max((each.array.shape[1] for each in given), default=1)
            if not is_right(row.cpd, row.trace, points_of(given, len(row.order), runs)):
                raise Left(f"the function of {row.cpd.child!r} has other values than its trace")
