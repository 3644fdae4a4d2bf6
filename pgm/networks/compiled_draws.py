"""Draws of many runs in machine code: the numbers of `sampling` to rounding, for chains of CPDs.

Noise is drawn for all rows of a CPD at once, by counters (`counted`); states follow from step to
step, and readings from the states, by the traces of the CPDs' functions. Traces are judged as those
of inference are: the functions are called at some of the points that were drawn, and where one has
another value all is drawn anew without machine code.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pgm.cpds.conditional import ConditionalGaussian, Noise
from pgm.cpds.gaussian import LinearGaussianCPD, NonlinearGaussianCPD
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.rows import Rows
from pgm.kernels.arrays import Array, Integers
from pgm.networks.sampling import Drawn, Source, drawn_by_arrays, places_of, prior_drawn
from pgm.tracing.judging import LARGE, Answers
from pgm.tracing.program import Program
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.kernels.machine.studies.rows import Child, Placed, Resident
    from pgm.networks.dynamic import DynamicBayesianNetwork

# Operations of a CPD from which on its code is longer than it is worth.
_MOST = 3000
# About so many points of a CPD's draws are judged.
_JUDGED = 1024


def drawn_compiled(model: DynamicBayesianNetwork, bound: BoundEvidence, source: Source) -> Drawn:
    """States at all steps, and readings, by machine code where that can draw all of them."""
    try:
        return _Draws(model, bound, source).drawn()
    except Left:
        return drawn_by_arrays(model, bound, source)


class Left(Exception):
    """A model that machine code cannot draw, or draws that were wrong."""


class _Used(NamedTuple):
    """A trace that was used: of which CPD, and at which values of its parents."""

    cpd: NonlinearGaussianCPD
    trace: Program
    given: Sequence[Placed]
    rows: int


class _Draws:
    def __init__(self, model: DynamicBayesianNetwork, bound: BoundEvidence, source: Source) -> None:
        self.model, self.bound, self.source = model, bound, source
        self.place, self.runs = places_of(model), bound.runs
        self.used: list[_Used] = []

    def drawn(self) -> Drawn:
        """States at all steps, and readings."""
        from pgm.kernels.machine.studies import rows, sums

        if self.runs < sums.LANES:
            raise Left
        hidden = (*self.model.states, *self.model.controls)
        path = {v: self._room(self.bound.steps + 1, v.dimension) for v in hidden}
        prior_drawn(self.model, self.bound, self.source, path)
        ahead = np.arange(1, self.bound.steps + 1)
        pairs = zip(self.model.transition, self.bound.transition, strict=True)
        children = [
            self._child(cpd, known, path, {v: ahead - v.lag for v in cpd.given}, ahead, None)
            for cpd, known in (pairs if self.bound.steps else ())
        ]
        if children:
            rows.draw(children, self.runs)
        readings = {}
        for reading in self.bound.readings:
            found = self._room(reading.step.size, reading.cpd.child.dimension)
            if reading.step.size:
                rows.draw([self._read(reading, path, found)], self.runs)
            readings[reading.cpd.child] = found
        finite = (np.isfinite(each.sum()) for each in (*self._known(path), *readings.values()))
        if not all(finite) or not all(
            is_right(each.cpd, each.trace, points_of(each.given, each.rows, self.runs))
            for each in self.used
        ):
            raise Left
        return Drawn(path, readings)

    def _room(self, rows: int, size: int) -> Array:
        return np.empty((rows, size, self.runs)).transpose(0, 2, 1)

    def _known(self, path: Mapping[Variable, Array]) -> Iterator[Array]:
        """The states at all steps, and controls from step 1 on."""
        for variable, values in path.items():
            yield values if variable in self.model.states else values[1:]

    def _read(self, reading: Reading, path: Mapping[Variable, Array], out: Array) -> Child:
        steps = dict.fromkeys(reading.cpd.given, reading.step)
        return self._child(reading.cpd, reading.inputs, path, steps, reading.order, out)

    def _child(
        self,
        cpd: Any,
        inputs: Mapping[Variable, Rows],
        path: Mapping[Variable, Array],
        steps: Mapping[Variable, Integers],
        order: Integers,
        out: Array | None,
    ) -> Child:
        """A CPD's child at rows, whose noise has the counters `order`, where values are put.

        Without `out` they are put into the path, at `steps` of which are the hidden parents.
        """
        from pgm.kernels.machine.studies.rows import Placed

        trace = known_form(cpd)
        count = len(order)
        given = list[Placed]()
        for parent in cpd.given:
            values = inputs.get(parent)
            if values is None:
                given.append(Placed(path[parent.template], steps[parent]))
            else:
                given.append(Placed(values, np.arange(count) if len(values) > 1 else _zeros(count)))
        into = Placed(path[cpd.child] if out is None else out, order)
        child = child_of(cpd, trace, given, self._white(cpd, order), into)
        if trace is not None:
            self.used.append(_Used(cpd, trace, given, count))
        return child

    def _white(self, cpd: ConditionalGaussian, order: Integers) -> Array:
        """The noise of all rows at unit scale, (rows, runs, d)."""
        draws = self.source(self.place[cpd.child], order)
        white: Array = draws.standard_normal((len(order), self.runs, cpd.child.dimension))
        if cpd.noise is not None:
            cpd.noise.require_proper(cpd.child.dimension, cpd)
            white = cpd.noise.draw(white, draws)
        return white


def _zeros(count: int) -> Integers:
    return np.zeros(count, dtype=np.intp)


def child_of(
    cpd: Any,
    trace: Program | None,
    given: Sequence[Placed | Resident],
    white: Array | None,
    out: Placed | Resident,
) -> Child:
    """A CPD's child, of its trace or affine; one whose code is longer than it is worth is left."""
    from pgm.kernels.machine.studies.rows import Child

    child = Child(
        None if trace is None else function_of(trace),
        given,
        () if trace is not None else [cpd.matrices[parent] for parent in cpd.given],
        np.zeros(0) if trace is not None else cpd.offset,
        cpd._lower,
        white,
        out,
    )
    if child.form.operations > _MOST:
        raise Left(f"the code of {cpd!r} is longer than it is worth")
    return child


def known_form(cpd: Any) -> Program | None:
    """The trace of a CPD's function, None of an affine one; other CPDs are left."""
    if isinstance(getattr(cpd, "cov", None), Noise) or getattr(cpd, "steps", None) is not None:
        raise Left(f"{cpd!r} has numbers by step or a noise of inputs")
    if type(cpd) is LinearGaussianCPD:
        return None
    if type(cpd) is not NonlinearGaussianCPD:
        raise Left(f"{cpd!r} is of a kind of its own")
    found = cpd._tracer.traced()
    if isinstance(found, str):
        raise Left(f"{cpd!r}: {found}")
    return found


def function_of(trace: Program) -> Any:
    """A trace as machine code is told of it, with all of its arguments observed."""
    from pgm.kernels.machine.emitter.functions import Function

    columns = tuple((a, i) for a, width in enumerate(trace.widths) for i in range(width))
    operations = tuple(trace.graph.operations)
    return Function(operations, tuple(trace.value), (), (), columns)


def points_of(given: Sequence[Placed], count: int, runs: int) -> list[Array]:
    """Points at so many rows of so many runs, or some of very many, (k, width) of each argument."""
    every = 1 if count * runs < LARGE else count * runs // _JUDGED
    row, run = np.divmod(np.arange(every // 2, count * runs, every), runs)
    return [each.array[each.places[row], run if each.array.shape[1] > 1 else 0] for each in given]


def is_right(cpd: NonlinearGaussianCPD, trace: Program, points: Sequence[Array]) -> bool:
    """Whether a CPD's function has the values of its trace at points of its parents."""
    tracer = cpd._tracer
    if tracer.trace is not trace:
        return False
    answers = Answers(tracer, (), (), cpd._template(cpd.given).variances)
    answers.judge(points, None)
    answers.close()
    if answers.fault is not None:
        tracer.doubt(trace, answers.fault, moved=answers.moved)
        return False
    if answers.used:
        tracer.prove(trace)
    return True
