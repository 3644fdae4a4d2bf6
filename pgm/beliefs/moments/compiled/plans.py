"""Plans of chains, as machine code is told of them: what decides their code, and their table."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from itertools import pairwise
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.compiled.called import Call, Calls, Lines
from pgm.beliefs.moments.compiled.functions import function_of, loss_of, points_of
from pgm.beliefs.moments.compiled.groups import (
    Group,
    GroupCall,
    GroupLines,
    Stored,
    together,
    widened,
)
from pgm.beliefs.moments.steps import gate as gates
from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan, Link
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.compile.machine import MOST
from pgm.evidence.values import JOINT
from pgm.kernels.arrays import Array, Index, address
from pgm.kernels.machine.emitter.memory import Runs
from pgm.kernels.machine.sweeps import told
from pgm.linearisation.family import Family
from pgm.linearisers import Taylor
from pgm.schedules.gates import gate_of
from pgm.variables import Variable

# Components of which differences are worth their code.
_FEW = 12

Integers64 = npt.NDArray[np.int64]
# By name the arrays that a sweep fills or reads beside those of CPDs and sensors.
Record = dict[str, Array]
# What decides how a CPD is linearised whose function is called.
CALLED = "called"
# How an array's owner, a CPD, a sensor or a record, is asked for it.
Get = Callable[[Any], Any]


class Uncompiled(Exception):
    """A plan that machine code cannot sweep, and why."""


class Table:
    """A table that is filled, and the arrays that it tells of, which stay in memory as it does.

    `lanes` is how many runs are swept together, `record` the arrays that no CPD and no sensor owns;
    `calls` are the functions that are called, None where none may be.
    """

    def __init__(self, plan: ChainPlan, lanes: int, calls: Calls | None = None) -> None:
        self.lanes, self.calls, self._account = lanes, calls, plan.account
        self.numbers = [0] * told.FIRST
        self.numbers[told.LAST], self.numbers[told.RUNS] = plan.steps, plan.runs
        self.record: Record = {}
        self._kept: list[object] = []

    def put(self, place: int, array: npt.NDArray[Any]) -> None:
        """Put the address of an array into the table."""
        self._kept.append(array)
        self.numbers[place] = address(array)

    def at(self, array: npt.NDArray[Any]) -> int:
        """The place in the table of the address of an array."""
        self.numbers.append(0)
        self.put(len(self.numbers) - 1, array)
        return len(self.numbers) - 1

    def array(self, array: Array) -> told.Array:
        """An array (rows or 1, runs or 1, own axes), told."""
        array = readable(array)
        inner = [(k, n) for k, n in zip(array.strides[2:], array.shape[2:], strict=True) if n > 1]
        down, across = (
            0 if n == 1 else k // 8 for k, n in zip(array.strides, array.shape[:2], strict=False)
        )
        cell = inner[-1][0] // 8 if inner else 1
        place = self.at(array)
        self.numbers += [down, across, cell]
        runs = Runs.BESIDE
        if self.lanes > 1 and across != 1:
            runs = Runs.APART if across else Runs.SAME
        return told.Array(place, array.shape[2:], runs, cell == 1)

    def of(self, owner: Any, get: Get) -> told.Array:
        """An array that an owner has, told."""
        return self.array(get(owner))

    def at_of(self, owner: Any, get: Get) -> int:
        """The place in the table of the address of an array that an owner has."""
        return self.at(get(owner))

    def by_runs(self, cells: Array) -> told.Array:
        """An array (rows, own axes, runs), told."""
        return self.array(np.moveaxis(cells, -1, 1))

    def called(self, call: Call, lines: told.Lines, why: str) -> told.Called:
        """A function that is called, and why."""
        if self.calls is None:
            raise Uncompiled(f"{call.family.cpd!r}: {why}")
        self._account.call_back(call.family.cpd.child.name, why)
        self.calls.each.append(call)
        places = self.by_runs(call.points[None]), self.by_runs(call.told)
        return told.Called(len(self.calls.each) - 1, *places, lines)

    def count(self, number: int) -> int:
        """The place in the table of a number."""
        self.numbers.append(number)
        return len(self.numbers) - 1

    @property
    def whole(self) -> Integers64:
        """The table."""
        return np.array(self.numbers, dtype=np.int64)


def readable(array: Array) -> Array:
    """The array, or a copy, in which components of a row are at even distances."""
    if not array.size:  # which is never read, and has no distances
        return np.zeros((1, *array.shape[1:]))
    inner = [(k, n) for k, n in zip(array.strides[2:], array.shape[2:], strict=True) if n > 1]
    if any(outer != stride * size for (outer, _), (stride, size) in pairwise(inner)):
        return np.ascontiguousarray(array)
    return array


def places(index: Index, size: int) -> tuple[int, ...]:
    """The places that an index says."""
    return tuple(np.arange(size)[index].tolist())


def unknown(plan: ChainPlan, groups: Sequence[Group] = ()) -> str | None:
    """Why machine code does not know a plan, but for functions that are not linearised yet.

    The sightings of `groups` are swept as one vector.
    """
    vectors = [group.sensor for group in groups]
    for sensor in plan.read:
        if sensor.robust and sensor.weights.noise.graduated:
            return f"{sensor.family.cpd!r} has graduated noise"
        if isinstance(sensor, OpenSensor):
            why = _open_unknown(sensor)
            if why is not None:
                return f"{sensor.family.cpd!r}: {why}"
        if sensor.exact:
            return f"{sensor.family.cpd!r} has a singular noise"
        if sensor.is_correlated and sensor not in vectors:
            rule = sensor.family.lineariser
            return f"{sensor.family.cpd!r} has several sightings in a group, linearised by {rule!r}"
    for family in plan.families:
        if max(family.cpd.child.dimension, family.shape[3]) > MOST:
            return f"{family.cpd!r} has more than {MOST} components"
    return None


def groups_of(
    plan: ChainPlan, gate: gates.Asked | None, *, stored: bool, controlled: bool
) -> list[Group]:
    """The sensors whose sightings of a step have correlated errors, to be swept as one vector.

    Of others the sightings are weighed, gated, or judged, one by one.
    """
    return [
        Group(sensor)
        for sensor in plan.read
        if sensor.is_correlated
        and not isinstance(sensor, OpenSensor)
        and sensor.family.hidden
        and not (sensor.robust or controlled or _gate(sensor, gate, stored=stored) is not None)
        and max(np.diff(sensor.bounds)) * sensor.height <= MOST
    ]


def _open_unknown(sensor: OpenSensor) -> str | None:
    """Why machine code does not compare a sensor's sightings with candidates."""
    if sensor.unknown.association == JOINT:
        return "its sightings of a step are associated together"
    if sensor.robust:
        return "it has robust noise, and its sightings are to be associated"
    if getattr(sensor.family.lineariser, "fresh_per_run", False):
        return "points are drawn anew for each candidate"
    return None


def require_affine_prior(plan: ChainPlan) -> None:
    """Refuse a plan whose prior would be linearised again."""
    for link in plan.prior:
        if not link.family.exact:
            raise Uncompiled(f"{link.family.cpd!r} is a prior that is linearised again")


def needed(
    motions: Sequence[told.Motion], sensors: Sequence[told.Sensor], front: int
) -> tuple[bool, bool]:
    """Whether CPDs are linearised by covariances of slices, and by those of pairs.

    `front` is how many components the states have.
    """
    pairs = any(
        motion.points is not None and max(motion.parents, default=0) >= front for motion in motions
    )
    expects = any(sensor.loss is not None and sensor.loss.expects for sensor in sensors)
    return pairs or expects or any(row.points is not None for row in (*motions, *sensors)), pairs


def decisive(
    plan: ChainPlan, *, stored: bool, keep: bool, gate: gates.Asked | None
) -> tuple[Hashable, ...]:
    """The key of a forward sweep's code, beside the places of its CPDs.

    Functions are traced, if they were not, and CPDs made ready to keep errors of linearisations.
    """
    rows: list[Hashable] = [
        (_function(link.family, stored=stored, keep=keep), len(link.turning))
        for link in plan.transition
    ]
    rows += [
        (
            _function(sensor.family, stored=stored, keep=keep),
            sensor.family.cpd,
            _gate(sensor, gate, stored=stored),
            _missing(sensor, gate, stored=stored),
            *_sightings(sensor),
            _group(sensor),
            sensor.form if isinstance(sensor, OpenSensor) else None,
        )
        for sensor in plan.read
    ]
    return (*rows, stored, keep)


def _function(family: Family, *, stored: bool, keep: bool) -> Hashable:
    """The key of a CPD's linearisation."""
    bare = family.bare if family.noisy else None
    weighed = family.cpd.noise is not None
    if stored or family.template is None:
        if keep and weighed and not stored:
            family.keep_errors()
        return bare
    rule = family.lineariser
    if _has_points(family) and isinstance(points_of(family), str):
        return CALLED
    answers = family.trace_whole()
    if isinstance(answers, str):
        return CALLED
    if keep and keeps_errors(family):
        family.keep_errors()
    return answers.trace, rule, bare


def keeps_errors(family: Family) -> bool:
    """Whether a sweep that keeps linearisations adds something to the noise of a CPD."""
    return family.cpd.noise is not None or _has_points(family)


def _has_points(family: Family) -> bool:
    by_rule = family.template is not None and bool(family.hidden)
    return by_rule and type(family.lineariser) is not Taylor


def _gate(sensor: Sensor, gate: gates.Asked | None, *, stored: bool) -> float | None:
    return None if gate is None or stored else gate_of(gate, sensor.variable)


def _missing(sensor: Sensor, gate: gates.Asked | None, *, stored: bool) -> bool:
    taken = sensor.taken
    if _gate(sensor, gate, stored=stored) is not None:
        assert sensor.gated is not None
        taken = sensor.gated.given
    return taken is not None and not taken.all()


def _group(sensor: Sensor) -> Hashable:
    """The key of a sensor as one vector of the sightings of a step."""
    counts = np.diff(sensor.bounds)
    return (int(counts.max()), bool(counts.all())) if sensor.is_correlated else None


def _sightings(sensor: Sensor) -> tuple[bool, bool]:
    """Whether each step has one sighting; and of robust noise, whether none has more."""
    return _single(sensor.edges), sensor.robust and _lone(sensor)


def _single(edges: Integers64) -> bool:
    return bool((np.diff(edges) == 1).all())


def _lone(sensor: Sensor) -> bool:
    return bool((np.diff(sensor.edges) <= 1).all())


def motion_of(
    plan: ChainPlan, link: Link, table: Table, *, stored: bool, keep: bool
) -> told.Motion:
    """A CPD of the transition."""
    layout, family = plan.layout, link.family
    size = layout.state_size + layout.slice_size
    turning: tuple[tuple[int, int, int], ...] = ()
    if link.turning and not stored:
        own = places(link.parents, size)
        if any(before not in own for before in link.before.tolist()):
            raise Uncompiled(f"{family.cpd!r} turns an angle of which its function does not know")
        turning = tuple((new, before, own.index(before)) for new, before in link.turning)
    return told.Motion(
        **row_of(family, places(link.parents, size), table, stored=stored, keep=keep),
        bare=family.bare,
        unsure=not family.semidefinite,
        turning=turning,
    )


def sensor_of(
    plan: ChainPlan,
    sensor: Sensor,
    table: Table,
    *,
    stored: bool,
    keep: bool,
    gate: gates.Asked | None = None,
    controlled: bool = False,
) -> told.Sensor:
    """A sensor with its measurements, and with its gate if gates decide anew.

    `controlled` says that a cost judges where it is linearised.
    """
    family, size = sensor.family, plan.layout.slice_size
    probability = _gate(sensor, gate, stored=stored)
    missing = _missing(sensor, gate, stored=stored)
    readings = "moved_marked" if stored else "marked" if probability is None else "given_marked"
    kept = keep and not stored and bool(sensor.variable.angles)
    loss = None
    if sensor.robust:
        flags = {"missing": missing, "found": stored, "controlled": controlled}
        loss = robust_noise_of(sensor, table, **flags)
    held = max(1, *np.diff(sensor.bounds).tolist())
    if isinstance(sensor, OpenSensor):
        held = sensor.form[0]  # the candidates of one sighting
    return told.Sensor(
        **row_of(family, places(sensor.parents, size), table, stored=stored, keep=keep, held=held),
        readings=table.of(sensor, attrgetter(readings)),
        moved=table.of(sensor, attrgetter("moved")) if kept else None,
        missing=missing,
        bounds=None if _single(sensor.edges) else table.at_of(sensor, attrgetter("edges")),
        gate=None if probability is None else _gate_of(probability, sensor, table),
        loss=loss,
        candidates=_candidates_of(sensor, table) if isinstance(sensor, OpenSensor) else None,
    )


def _candidates_of(sensor: OpenSensor, table: Table) -> told.Candidates:
    """The candidates of a sensor's sightings, and where what is found of them goes."""
    count, gated, rejects = sensor.form

    def array(name: str) -> told.Array:
        return table.of(sensor, attrgetter(name))

    return told.Candidates(
        count=count,
        shares=array("shares"),
        others=array("others"),
        limits=array("limits") if gated else None,
        alike=array("alike"),
        terms=array("terms"),
        matrix=array("chosen.matrix"),
        offset=array("chosen.offset"),
        noise=array("chosen.noise"),
        values=array("chosen.values") if rejects else None,
        point=(array("point.mean"), array("point.cov")),
    )


def vector_of(
    plan: ChainPlan, group: Group, table: Table, *, stored: bool, keep: bool
) -> told.Sensor:
    """A sensor whose sightings of a step are one vector, with its measurements."""

    def array(name: str) -> told.Array:
        return table.of(group, attrgetter(name))

    sensor, whole = group.sensor, _single(group.edges)
    found: dict[str, Any]
    if stored:
        found = {name: array(f"known.{name}") for name in Stored._fields}
    else:
        own = np.flatnonzero(sensor.variable.angle_mask).tolist()
        found = _group_curve(group, table)
        found["angles"] = tuple(k * sensor.height + i for k in range(group.most) for i in own)
        found["noise"], found["readings"] = array("own_noise"), array("readings")
        if keep:
            found["matrix"], found["offset"] = array("matrix"), array("offset")
            found["kept"] = array("noise")
            found["moved"] = array("moved") if own else None
    return told.Sensor(
        parents=places(sensor.parents, plan.layout.slice_size),
        height=group.height,
        missing=True,
        bounds=None if whole else table.at_of(group, attrgetter("edges")),
        **found,
    )


def _group_curve(group: Group, table: Table) -> dict[str, Any]:
    """How the sightings of a step are linearised together, as of `_curve`."""
    family, template = group.family, group.family.template
    assert template is not None
    rule, answers = points_of(family), family.compiled or family.trace_whole()
    if isinstance(rule, str):
        return {"called": _by_numpy(GroupLines(group), table, rule)}
    assert rule is not None
    points = widened(rule, group.most)
    if not isinstance(answers, str):
        function = function_of(template, answers.trace)
        inputs = tuple(
            table.of(group, _inputs(parent))
            for parent, place in zip(template.given, template.places, strict=True)
            if place is None
        )
        function = together(function, answers.trace.widths, group.most)
        return {"function": function, "points": points, "inputs": inputs}
    if template.size > _FEW:
        return {"called": _by_numpy(GroupLines(group), table, answers)}
    call = GroupCall(group, _most_points(family, rule))
    return {"called": _by_values(call, rule, table, 1, answers), "points": points}


def _gate_of(probability: float, sensor: Sensor, table: Table) -> told.Gate:
    """A sensor's gate, whose decisions are gathered in the record; see `decided`."""
    limits = gates.limits(probability, sensor.height)[None, None]
    return told.Gate(
        table.of(sensor, lambda _: limits),
        table.of(sensor, attrgetter("gated.square")),
        table.of(table.record, itemgetter(rejected_by(sensor))),
    )


def robust_noise_of(
    sensor: Sensor, table: Table, *, missing: bool, found: bool, controlled: bool
) -> told.Loss:
    """A sensor's robust noise, with the weights of its sightings; `found` as of `told.Loss`.

    `missing` says that components may be missing.
    """
    family, weights = sensor.family, sensor.weights
    counts = range(0 if missing else sensor.height, sensor.height + 1)
    functions = [loss_of(weights.noise, count) for count in counts]
    for each in functions:
        if isinstance(each, str):
            raise Uncompiled(f"{family.cpd!r}: its noise: {each}")
    if controlled and family.expects and family.template is not None:
        raise Uncompiled(f"{family.cpd!r} has robust noise, whose expected losses judge steps")
    weight, surplus, cost = zip(*functions, strict=True)
    kept, squares = (
        table.of(sensor, attrgetter(f"weights.{name}")) for name in ("weight", "square")
    )
    trial = trials_of(sensor) if controlled else ()
    return told.Loss(
        weight,
        surplus,
        cost,
        kept,
        squares,
        expects=family.expects,
        lone=_lone(sensor),
        found=found,
        trial=tuple(table.of(table.record, itemgetter(name)) for name in trial),
    )


def trials_of(sensor: Sensor) -> tuple[str, str]:
    """The names in a record of the weights, and their squares, that a step control tries."""
    return f"tried weight {sensor.variable.name}", f"tried square {sensor.variable.name}"


def untried(plan: ChainPlan) -> Record:
    """Room for the weights of robust noise that a step control tries."""
    robust = [sensor for sensor in plan.read if sensor.robust]
    names = [name for sensor in robust for name in trials_of(sensor)]
    shapes = [sensor.shape for sensor in robust for _ in range(2)]
    return {name: np.empty(shape) for name, shape in zip(names, shapes, strict=True)}


def rejected_by(sensor: Sensor) -> str:
    """The name in a record of a gate's decisions."""
    return f"rejected {sensor.variable.name}"


def undecided(plan: ChainPlan, gate: gates.Asked | None, *, stored: bool) -> Record:
    """Room for what gates decide in a sweep: 1 of a sighting that is rejected, else 0."""
    return {
        rejected_by(sensor): np.zeros(sensor.shape)
        for sensor in plan.read
        if _gate(sensor, gate, stored=stored) is not None
    }


def decided(plan: ChainPlan, record: Record) -> None:
    """Record what gates have decided in a sweep."""
    for sensor in plan.read:
        rejected = record.get(rejected_by(sensor))
        if rejected is not None:
            assert sensor.gated is not None
            assert sensor.taken is not None
            sensor.gated.rejected[...] = rejected != 0.0
            sensor.taken[...] = sensor.gated.given & ~sensor.gated.rejected[..., None]


def row_of(
    family: Family,
    parents: tuple[int, ...],
    table: Table,
    *,
    stored: bool,
    keep: bool,
    held: int = 1,
) -> dict[str, Any]:
    """The attributes of a CPD's `told.Row`, of whatever kind it is.

    Where its function is called, up to `held` rows of a step are linearised together.
    """

    def array(name: str) -> told.Array:
        return table.of(family, attrgetter(name))

    weighed = family.cpd.noise is not None and not stored
    found: dict[str, Any] = {"parents": parents, "height": family.shape[2]}
    if not stored:
        found["angles"] = tuple(np.flatnonzero(family.cpd.child.angle_mask).tolist())
    if stored or family.template is None:
        found["matrix"], found["offset"] = array("matrix"), array("offset")
        found["noise"] = array("own_noise" if weighed else "noise")
        if weighed and keep:
            family.keep_errors()
            found["kept"] = array("noise")
        return found
    found["noise"] = array("own_noise")
    curve = _curve(family, table, held)
    found |= curve
    if keep:
        found["matrix"], found["offset"] = array("matrix"), array("offset")
        called, rule = curve.get("called"), curve.get("points")
        exact = rule is None if called is None else called.lines.error is None
        if not exact or weighed:
            family.keep_errors()
            found["kept"] = array("noise")
    return found


def _curve(family: Family, table: Table, held: int) -> dict[str, Any]:
    """How a CPD is linearised: by its traced function, by values at points, or by NumPy."""
    rule, template = points_of(family), family.template
    assert template is not None
    if isinstance(rule, str):
        return {"called": _by_numpy(Lines(family, held), table, rule)}
    answers = family.compiled or family.trace_whole()
    if not isinstance(answers, str):
        inputs = tuple(
            table.of(family, _input(parent))
            for parent, place in zip(template.given, template.places, strict=True)
            if place is None
        )
        function = function_of(template, answers.trace)
        return {"function": function, "points": rule, "inputs": inputs}
    few = template.size <= _FEW and (rule is not None or len(template.numerical) == template.size)
    if not few:
        return {"called": _by_numpy(Lines(family, held), table, answers)}
    call = Call(family, _most_points(family, rule), held)
    return {"called": _by_values(call, rule, table, held, answers), "points": rule}


def _by_numpy(call: Lines, table: Table, why: str) -> told.Called:
    """A CPD that is linearised by NumPy, and why."""
    cov, value, matrix = map(table.by_runs, (call.cov, call.value, call.matrix))
    error = None if call.error is None else table.by_runs(call.error)
    lines = told.Lines(cov, value, matrix, error, table.array(np.ones((1, 1, 1))))
    return table.called(call, lines, why)


def _by_values(
    call: Call, rule: told.Points | None, table: Table, held: int, why: str
) -> told.Called:
    """A CPD that is linearised by values of its function at points, and why."""
    height, size, runs = call.told.shape[2], *call.points.shape[1:]
    own = (height,), (height, size), (height, height), (1,)
    cells = [table.by_runs(np.zeros((held, *each, runs))) for each in own]
    value, matrix, error, sure = cells
    lines = told.Lines(None, value, matrix, None if rule is None else error, sure)
    return table.called(call, lines, why)


def _most_points(family: Family, rule: told.Points | None) -> int:
    """At how many points a function is called at most, to be linearised by a rule.

    Differences are of four points for each component, beside the mean, which stands before those of
    a rule too.
    """
    return max(4 * family.shape[3], 0 if rule is None else len(rule.points)) + 1


def _input(parent: Variable) -> Get:
    return lambda family: family.inputs[parent]


def _inputs(parent: Variable) -> Get:
    return lambda group: group.inputs(parent)
