"""A kind of step of an online filter, and its machine code.

Steps are of a *kind* if the same variables are given, in the same form: rows, or sightings, of any
number. A kind is laid out from the plan of its first step: what the plan takes from the evidence
comes with each call, all else is bound to the step as constants. A *trace* is a user's function
recorded as a graph of scalar operations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pgm.beliefs.moments.compiled.robust_noise import robust_noise_of
from pgm.beliefs.moments.compiled.rows import motion_of, places
from pgm.beliefs.moments.compiled.sensors import sensor_of
from pgm.beliefs.moments.compiled.sweep import settings
from pgm.beliefs.moments.compiled.table import Table
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, unknown
from pgm.beliefs.moments.digits.close_points import families, largest
from pgm.beliefs.moments.online.records import Form, Records
from pgm.beliefs.moments.steps import gate as gates
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.sensor import Sensor
from pgm.cpds import AffineCPD
from pgm.evidence import Sightings
from pgm.factors import Gaussian
from pgm.kernels.arrays import Array
from pgm.kernels.machine.emitter import python
from pgm.kernels.machine.emitter.arrays import are_known
from pgm.kernels.machine.emitter.memory import Runs
from pgm.kernels.machine.emitter.python import place_of_slot
from pgm.kernels.machine.sweeps import marginal, online, told
from pgm.kernels.machine.sweeps.evidence import Evidence, Slots
from pgm.kernels.machine.sweeps.writer import arrays
from pgm.linearisation.family import Family
from pgm.posteriors.belief_kind import FILTERED, PREDICTED
from pgm.posteriors.status import Status
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.schedule import Filtering
from pgm.schedules.step_evidence import Values
from pgm.tracing import Judge
from pgm.variables import Variable

# From a belief and values to the next belief; see `kernels.machine.sweeps.online`.
Made = Callable[[Any, Any], Any]
# Steps that are made both ways.
TRIALS = 5
# By the sensor with whose sightings an array is given, or None, and the array's variable.
Where = dict[tuple[Variable | None, Variable], told.Array]


class Questions(NamedTuple):
    """Questions that steps answer beside those of beliefs.

    `schedule` says how updates linearise, and has the gates. `watched` says that beliefs have a
    watch, `reverses` that predictions are reversed.
    """

    schedule: Filtering
    watched: bool = False
    reverses: bool = False


class Kind:
    """A kind of step, made from the plan and the values of its first one.

    `step` is the machine code, a function of a belief and values; None where there is none, for the
    reason `why`. `belief` is the class of beliefs, and the filter's steps that they have. The
    `records` are read from what it leaves; `status` is that of a belief after a step that settles
    nothing. The `judge` compares the functions' traces with the functions;
    `trials` is how many more steps are made in NumPy, too, before machine code is trusted.
    """

    step: Made | None = None
    why: str = ""
    trials: int = TRIALS

    def __init__(
        self,
        plan: ChainPlan,
        values: Values,
        status: Status,
        asked: Questions,
        belief: tuple[type, object],
    ) -> None:
        self.judge, self._asked, self._belief = Judge(), asked, belief
        self.records = Records(plan, asked.schedule, status)
        try:
            self.step = self._made(plan, values)
        except Uncompiled as error:
            self.why = str(error)

    def _made(self, plan: ChainPlan, values: Values) -> Made:
        why = unknown(plan)
        if why is None and largest(families(plan)):
            why = "its sigma points lie close together, and lost digits are to be told"
        if why is None and not are_known():
            why = "NumPy's arrays lie here in memory in a way of their own"
        if why is not None:
            raise Uncompiled(why)
        if self.records.iterated and isinstance(self._asked.schedule.damping, LevenbergMarquardt):
            raise Uncompiled("steps are controlled (damping=LevenbergMarquardt(...))")
        table, layout = _Constants(plan), plan.layout
        given = {place: table.room(width) for place, width in _widths(values)}
        cpds = {"stored": False, "keep": False}
        for family in plan.families:
            family.judge = self.judge
        motions = tuple(
            replace(motion_of(plan, link, table, **cpds), **_fed(link.family, None, given, table))
            for link in plan.transition
        )
        if self._asked.reverses:
            motions = tuple(_kept(motion, table) for motion in motions)
        bounds: dict[Variable, int] = {}
        sensors = []
        for sensor in plan.read:
            variable = sensor.variable
            if isinstance(values[variable], Sightings) and not sensor.correlates:
                bounds[variable] = table.at(np.empty(0))
            sensors.append(
                replace(
                    sensor_of(plan, sensor, table, **cpds),
                    readings=given[None, variable],
                    missing=True,
                    bounds=bounds.get(variable),
                    gate=self._gate_of(sensor, table),
                    loss=_loss_of(sensor, table, lone=variable not in bounds),
                    **_fed(sensor.family, sensor, given, table),
                )
            )
        for family in plan.families:
            if family.compiled is not None and family.compiled.trace.cast:
                _require_followed(family)
        size = layout.slice_size
        chain = told.Forward(
            size=size,
            states=places(layout.state_places, size),
            single=bool(layout.single),
            motions=motions,
            sensors=tuple(sensors),
            begin=(table.room(size), table.room(size, size)),
            predicted=(),
            known=(table.room(size), table.room(size, size)),
            density=table.room(),
            iterated=self.records.iterated,
        )
        used = set(arrays(chain))
        if not used.issuperset(given.values()):
            raise Uncompiled("something that is given is read by no function")
        constants = {array: each for array, each in table.constants.items() if array in used}
        read = {sensor.variable for sensor in plan.read}
        evidence = _evidence(values, given, bounds, read)
        moves = bool(plan.transition)
        schedule, watched = self._asked.schedule, self._asked.watched
        iterations = schedule.iterations if self.records.iterated else 1
        slots = _slots(self._belief[0])
        step = online.Step(chain, moves, tuple(constants), evidence, slots, watched, iterations)
        machine = online.made(step)
        numbers = b"".join(each.tobytes() for each in (*constants.values(), settings(schedule)))
        # As of `evidence.VARIABLES` and before.
        self.records.motions, self.records.evidence = motions, _forms(values)
        known = PREDICTED if moves else FILTERED
        own = numbers, np.ndarray, Sightings, *self._belief, known, self.records
        return python.bound(machine, online.STEP, (*own, *(variable for _, variable in given)))

    def _gate_of(self, sensor: Sensor, table: _Constants) -> told.Gate | None:
        gate = self.records.gates.get(sensor.variable)
        if gate is None:
            return None
        limits = table.array(gates.limits(gate, sensor.height)[None, None])
        return told.Gate(limits, table.room(1), table.room(1))


def _slots(belief: type) -> Slots:
    """The places of slots of sightings, and of a class of beliefs."""
    sighted = (place_of_slot(Sightings, name) for name in ("values", "step", "_given"))
    names = "_steps", "_number", "_numbers", "_kind", "_records", "_behind", "_before"
    return Slots(*sighted, *(place_of_slot(belief, name) for name in names))


def marginal_of(variable: Variable) -> Callable[[bytes], Gaussian]:
    """The machine code of a belief's Gaussian over its single variable, from its numbers."""
    mean, cov, scope, steps = (
        place_of_slot(Gaussian, name) for name in ("mean", "cov", "scope", "steps")
    )
    machine = marginal.made(variable.dimension, (mean, cov, scope, steps))
    own = np.ndarray, np.dtype(float), Gaussian, (variable,)
    return python.bound(machine, marginal.MARGINAL, own)


def _loss_of(sensor: Sensor, table: _Constants, *, lone: bool) -> told.Loss | None:
    """The robust noise of a sensor, whose weights are found anew at each step."""
    if not sensor.robust:
        return None
    loss = robust_noise_of(sensor, table, missing=True, found=False, controlled=False)
    return replace(loss, lone=lone, weights=table.room(1), squares=table.room(1))


def _kept(motion: told.Motion, table: _Constants) -> told.Motion:
    """A CPD of a transition whose linearisation is kept."""
    if not motion.curved:
        return motion
    height, width = motion.height, len(motion.parents)
    room = table.room(height, height) if motion.points is not None else None
    return replace(motion, matrix=table.room(height, width), offset=table.room(height), kept=room)


class _Constants(Table):
    """A table whose arrays are constants of a step, or come with each of its calls."""

    def __init__(self, plan: ChainPlan) -> None:
        super().__init__(plan, 1)
        self.constants: dict[told.Array, Array] = {}

    def array(self, array: Array) -> told.Array:
        """An array (rows, runs, own axes), the same at all rows, as constants."""
        own = array[0, 0]
        found = self.room(*own.shape)
        self.constants[found] = own
        return found

    def room(self, *shape: int) -> told.Array:
        """An array whose memory is told of when the step is made."""
        place = len(self.numbers)
        self.numbers += [0] * (1 + told.CELL)
        return told.Array(place, shape, Runs.BESIDE, near=True)


def _widths(values: Values) -> Iterable[tuple[tuple[Variable | None, Variable], int]]:
    """The variables given at a step, in their order, and the width of the rows of each."""
    for variable, value in values.items():
        if not isinstance(value, Sightings):
            yield (None, variable), len(value)
            continue
        yield (None, variable), value.values.shape[1]
        for parent, each in value.given.items():
            yield (variable, parent), each.shape[1]


def _forms(values: Values) -> tuple[Form, ...]:
    """How the values of a step lie behind its numbers."""
    found = []
    for variable, value in values.items():
        parents = tuple(value.given) if isinstance(value, Sightings) else None
        found.append(Form(variable, parents))
    return tuple(found)


def _evidence(
    values: Values, given: Where, bounds: dict[Variable, int], read: set[Variable]
) -> tuple[Evidence, ...]:
    found = []
    for variable, value in values.items():
        parents = None
        if isinstance(value, Sightings):
            parents = tuple(given[variable, parent] for parent in value.given)
        place = given[None, variable]
        found.append(Evidence(place, variable in read, parents, bounds.get(variable)))
    return tuple(found)


def _fed(family: Family, sensor: Sensor | None, given: Where, table: _Constants) -> dict[str, Any]:
    """The inputs of a CPD as they are given at each step."""
    if family.cpd.steps is not None:
        raise Uncompiled(f"{family.cpd!r} has numbers of its own at each step")
    if family.noisy:
        raise Uncompiled(f"{family.cpd!r} has a noise that depends on inputs")
    own = None if sensor is None else sensor.variable
    known = [parent for parent in family.cpd.given if parent in family.inputs]
    inputs = tuple(given.get((own, parent)) or given[None, parent] for parent in known)
    cpd = family.cpd
    if not (isinstance(cpd, AffineCPD) and known):
        return {"inputs": inputs}
    shifts = tuple(table.array(cpd.matrices[parent][None, None]) for parent in known)
    return {
        "inputs": inputs,
        "shifts": shifts,
        "offset": table.array(cpd.offset[None, None]),
    }


def _require_followed(family: Family) -> None:
    """Refuse, by `Uncompiled`, a function that calls float() on its input or has no trace.

    Its branches may change later, and a trace has those that were taken when it was made. Jacobians
    may call float(): most do so by writing into np.zeros, which they return.
    """
    assert family.template is not None
    assert family.template.tracer is not None
    alone = family.template.tracer.traced()
    if isinstance(alone, str) or alone.cast:
        raise Uncompiled(
            f"{family.cpd!r}: its function makes floats of its input, by which it may decide "
            "otherwise in a later step: np.asarray(x) without a dtype, np.zeros_like in place of "
            "np.zeros"
        )
