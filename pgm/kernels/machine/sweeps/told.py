"""A chain as machine code is told of it: what decides the code, and where its numbers will stand.

A chain is told in two parts. What stands here is known before the code is made, and is the key of
what was made before: sizes, places, the users' functions, how arrays lie. All else comes with each
call, in a *table* of integers: addresses, lengths, and the distances between numbers. A chain of
other values, or of other lengths, is swept by the same code.

A *row* of a CPD is a step of a transition, or a sighting of a sensor; *runs* are the simulations or
robots that are swept together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

from pgm.kernels.machine.emitter.functions import Function
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


Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Points:
    """The points of a rule for N(0, I), (N, n), and its regression on them.

    `mean` (1, N), `slope` (n, N), `rest` (K, N) and `signs` (K,), empty for ones, are as of
    `step.Rule`. `centred` says that the first point is the origin; `rounding` is that of a value
    beside its summands, and `variances` (d,) are the least of the CPD's own noise.
    """

    points: Rows
    mean: Rows
    slope: Rows
    rest: Rows
    signs: tuple[float, ...]
    centred: bool
    rounding: float
    variances: tuple[float, ...]


@dataclass(frozen=True)
class Lines:
    """Linearisations that are read from memory, of all rows of a step.

    Attributes
    ----------
    cov : Array or None
        Where the program, which linearises, finds the belief's covariance (n, n), its mean being
        the first of the points; None where machine code linearises, by values at points.
    value, matrix : Array
        The value at the mean, (d,), and F (d, n).
    error : Array or None
        The covariance (d, d) of the linearisation's error; None where there is none.
    sure : Array
        Whether all of it is right, (1,).
    """

    cov: Array | None
    value: Array
    matrix: Array
    error: Array | None
    sure: Array


@dataclass(frozen=True)
class Called:
    """A function that cannot be compiled: machine code waits until its program has called it.

    Attributes
    ----------
    number : int
        Of the function, among those of the chain that are called.
    points, values : Array
        Where it is called, (N, n), and what it gives there at each row of a step, (N, d).
    lines : Lines
        Its linearisations.
    """

    number: int
    points: Array
    values: Array
    lines: Lines


@dataclass(frozen=True, kw_only=True)
class Row:
    """A CPD at its rows: y = F x + b + e of its parents x, or a function that is linearised.

    Attributes
    ----------
    parents : tuple of int
        The places of x in a slice, or in the pair of the states before and a slice.
    height : int
        The number of components of y.
    noise : Array
        The covariance (d, d) of e, but for errors of linearisations.
    matrix, offset : Array or None
        F (d, n) and b (d,) of an affine CPD, and else where they are kept, if they are.
    function : Function or None
        Of a CPD that is linearised in machine code.
    called : Called or None
        Of one whose function the program calls.
    points : Points or None
        Of the rule by which it is linearised; None of `Taylor`.
    inputs : tuple of Array
        The observed arguments, (m,) each, in the order of the function's.
    shifts : tuple of Array
        Of an affine CPD whose inputs come later, their matrices B (d, m): b + B u + ... is its
        offset.
    kept : Array or None
        Where the covariance of e with the error is kept.
    angles : tuple of int
        The components of y that are angles.
    """

    parents: tuple[int, ...]
    height: int
    noise: Array
    matrix: Array | None = None
    offset: Array | None = None
    function: Function | None = None
    called: Called | None = None
    points: Points | None = None
    inputs: tuple[Array, ...] = ()
    shifts: tuple[Array, ...] = ()
    kept: Array | None = None
    angles: tuple[int, ...] = ()

    @property
    def curved(self) -> bool:
        """Whether it has to be linearised."""
        return self.function is not None or self.called is not None


@dataclass(frozen=True, kw_only=True)
class Motion(Row):
    """A CPD of a transition, a row a step.

    Attributes
    ----------
    bare : tuple of int
        The components of y without noise of their own.
    unsure : bool
        Whether its errors may be indefinite.
    turning : tuple of (int, int, int)
        An angle of y, its place in the pair a step before, and that among the parents.
    """

    bare: tuple[int, ...] = ()
    unsure: bool = False
    turning: tuple[tuple[int, int, int], ...] = ()


@dataclass(frozen=True)
class Gate:
    """A gate, which rejects sightings that are far from their prediction.

    `limits` (height + 1,) are the largest squares by how many components were measured; `squares`
    are kept by row, and `rejected` are 1 of a sighting that is rejected, else 0.
    """

    limits: Array
    squares: Array
    rejected: Array


@dataclass(frozen=True)
class Loss:
    """A robust noise: sightings count with R / w, and the weight w is a function of a square.

    `weight(s)` and `surplus(s, w)`, the log-density less that of N(0, R / w), are traces by how
    many components were measured; of just the last where none may be missing. Weights and the
    squares that they are of are kept by row, those of a step control's trials in `trial`. `cost(s)`
    is twice the loss. `expects` says that squares are expected under the belief; `lone` that no
    step has two sightings; `found` that weights are as kept, and only the surplus is due.
    """

    weight: tuple[Function, ...]
    surplus: tuple[Function, ...]
    cost: tuple[Function, ...]
    weights: Array
    squares: Array
    expects: bool
    lone: bool
    found: bool
    trial: tuple[Array, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Candidates:
    """The candidates of a sensor whose sightings are each of one of them, or of none.

    Attributes
    ----------
    count : int
        How many there are, k. The CPD has a row for each with each sighting: sighting s and
        candidate j are at row s k + j.
    shares : Array
        By candidate, the logarithm of its prior probability, (1,).
    others : Array
        The log-densities of what is of none, each with its probability, (2,).
    limits : Array or None
        The largest squares (height + 1,) by how many components were measured; None without a gate.
    alike : Array
        By candidate, the number of the first one that is the same, (1,).
    terms : Array
        Where the log-density of a sighting with each candidate is put, with its probability, (k,).
    matrix, offset, noise : Array
        Where the linearisation with the candidate that was chosen last is put.
    values : Array or None
        Where a sighting's values are put, NaN of one of none; None if there can be no such.
    point : tuple of Array
        Where, by step, means and covariances are put at which sightings are linearised.
    """

    count: int
    shares: Array
    others: Array
    limits: Array | None
    alike: Array
    terms: Array
    matrix: Array
    offset: Array
    noise: Array
    values: Array | None
    point: tuple[Array, Array]


@dataclass(frozen=True, kw_only=True)
class Sensor(Row):
    """A sensor, a row a sighting, or several: one for each of some `candidates`.

    Attributes
    ----------
    readings : Array
        The values (d,); NaN is missing, where `missing` says that some may be.
    moved : Array or None
        Where values are kept, with their angles on the branch of the linearisation.
    bounds : int or None
        The place in the table of the address of the first sighting of each step, and one more;
        None if each step has one.
    gate : Gate or None
        Of a sweep that rejects sightings.
    loss : Loss or None
        Of robust noise.
    candidates : Candidates or None
        Of sightings that leave open of what they are.
    """

    readings: Array
    moved: Array | None = None
    missing: bool = False
    bounds: int | None = None
    gate: Gate | None = None
    loss: Loss | None = None
    candidates: Candidates | None = None

    @property
    def weighs(self) -> bool:
        """Whether weights of robust noise are to be found."""
        return self.loss is not None and not self.loss.found


@dataclass(frozen=True, kw_only=True)
class Forward:
    """A forward sweep: the slices of a chain predicted, and given the measurements of their steps.

    Attributes
    ----------
    size : int
        The components of a slice.
    states : tuple of int
        The places of the states in a slice, which alone act on the next one.
    single : bool
        Whether one CPD makes all of a slice of all of the one before.
    begin, predicted, known : tuple of Array
        Means and covariances: of the belief to begin with, before each step's measurements, if that
        is kept, and given them.
    density : Array
        The log-densities of each step's measurements.
    iterated, controlled : bool
        Whether measurements are linearised again, and whether a cost judges where.
    anchor : tuple of Array
        Means and deviations by step, and weights, of an anchor; empty if there is none.
    asked : Array or None
        For what a sweep waits whose functions are called, (`ASKED`,): see `WHAT`.
    """

    size: int
    states: tuple[int, ...]
    single: bool
    motions: tuple[Motion, ...]
    sensors: tuple[Sensor, ...]
    begin: tuple[Array, Array]
    predicted: tuple[Array, ...]
    known: tuple[Array, Array]
    density: Array
    iterated: bool
    controlled: bool = False
    anchor: tuple[Array, ...] = ()
    asked: Array | None = None

    @property
    def alone(self) -> Sensor | None:
        """The sensor of robust noise of which a step has one sighting, or none, weighed by itself.

        Nothing else moves a belief within a step, and no gate asks for the square of a weight 1.
        """
        if len(self.sensors) != 1 or self.anchor:
            return None
        (sensor,) = self.sensors
        loss = sensor.loss
        lone = loss is not None and loss.lone and not loss.found
        return sensor if lone and sensor.gate is None else None


@dataclass(frozen=True, kw_only=True)
class Windows:
    """The windows of a fixed lag that slide along a chain.

    Attributes
    ----------
    ahead : Forward
        The chain as each step is linearised first; its arrays of beliefs but `begin` are not used.
    predicted, known, density, smoothed : tuple of Array, or Array
        By step, means and covariances, and log-densities, of the last window of it.
    newest, log_evidence : tuple of Array, and Array
        The last beliefs of the window that ends at a step, and ln p of all measurements up to it.
    point : tuple of Array
        By row of a window, where CPDs are linearised: means, covariances and those of pairs of the
        states and the next slice, so far as CPDs need them.
    joint : Array or None
        The covariances of pairs that are found.
    """

    ahead: Forward
    predicted: tuple[Array, Array]
    known: tuple[Array, Array]
    density: Array
    smoothed: tuple[Array, Array]
    newest: tuple[Array, Array]
    log_evidence: Array
    point: tuple[Array, ...]
    joint: Array | None = None

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors of the chain."""
        return self.ahead.sensors


@dataclass(frozen=True, kw_only=True)
class Linearised:
    """A chain that is linearised at beliefs over all steps, or the costs of their means.

    Attributes
    ----------
    states, motions, sensors
        As of `Forward`.
    point : tuple of Array
        Means of the slices, their covariances, and those of pairs of the states and the next slice,
        so far as CPDs need them.
    cost : Array or None
        Where the cost of each run is put, without the prior's; None linearises.
    """

    states: tuple[int, ...]
    motions: tuple[Motion, ...]
    sensors: tuple[Sensor, ...]
    point: tuple[Array, ...]
    cost: Array | None = None


def kept_motion(motion: Motion) -> Motion:
    """A CPD of a transition as it was linearised last."""
    return replace(_affine(motion), noise=motion.kept or motion.noise, turning=())


def kept_sensor(sensor: Sensor, *, weighed: bool) -> Sensor:
    """A sensor as it was linearised last; its noise is `weighed`, or still to be."""
    noise, loss = sensor.noise, sensor.loss
    if sensor.kept is not None and (weighed or loss is None):
        noise = sensor.kept
    return replace(
        _affine(sensor),
        noise=noise,
        readings=sensor.moved or sensor.readings,
        moved=None,
        loss=None if loss is None else replace(loss, found=weighed),
    )


def chosen(sensor: Sensor) -> Sensor:
    """A sensor as its sightings are read with the candidate that was chosen last."""
    of = sensor.candidates
    assert of is not None
    return replace(
        _affine(sensor),
        matrix=of.matrix,
        offset=of.offset,
        noise=of.noise,
        inputs=(),
        shifts=(),
        angles=sensor.angles,
        readings=of.values or sensor.readings,
        missing=sensor.missing or of.values is not None,
        candidates=None,
    )


Kind = TypeVar("Kind", bound=Row)


def _affine(row: Kind) -> Kind:
    """A CPD as it was linearised last, but for its noise."""
    inputs = () if row.curved else row.inputs
    affine = replace(row, function=None, called=None, points=None, inputs=inputs)
    return replace(affine, kept=None, angles=())


def as_kept(chain: Forward) -> Forward:
    """A chain as its CPDs were linearised, and sightings weighed, last."""
    motions = tuple(map(kept_motion, chain.motions))
    sensors = tuple(kept_sensor(sensor, weighed=True) for sensor in chain.sensors)
    return replace(chain, motions=motions, sensors=sensors)


@dataclass(frozen=True, kw_only=True)
class Backward:
    """A sweep back: transitions reversed, and the last belief sent through what they have become.

    Attributes
    ----------
    size, states
        As of `Forward`.
    known, predicted, motion : tuple of Array
        What a forward sweep has left, and the transition's matrix and noise.
    reversed : tuple of Array
        The gain, offset and covariance of p(states | next slice); empty if they are not wanted.
    smoothed : tuple of Array
        The moments given all measurements; empty if they are not wanted.
    controls : tuple of Array
        The gain, offset and covariance of p(slice | its states); empty without controls.
    """

    size: int
    states: tuple[int, ...]
    known: tuple[Array, Array]
    predicted: tuple[Array, Array]
    motion: tuple[Array, Array]
    reversed: tuple[Array, ...] = ()
    smoothed: tuple[Array, ...] = ()
    controls: tuple[Array, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Squares(Row):
    """A CPD as squares of a least-squares problem, of which some rows are linearised together.

    Rows take the place of runs in its arrays, and runs that of rows. `noise` is the inverse of the
    covariance, zero where nothing is measured, and `parents` are places in a slice, those of the
    next one behind.

    Attributes
    ----------
    child : tuple of int
        The places of a transition's child in the slices; empty of a measurement.
    lanes : int
        How many rows are linearised together; there are as many at least.
    count : int
        The place in the table of the number of rows.
    readings, moved, missing, bounds
        As of `Sensor`.
    steps : int or None
        The place in the table of the address of each row's step; None if each step has one row.
    """

    child: tuple[int, ...]
    lanes: int
    count: int
    readings: Array | None = None
    moved: Array | None = None
    missing: bool = False
    bounds: int | None = None
    steps: int | None = None


@dataclass(frozen=True, kw_only=True)
class Newton:
    """A Gauss–Newton step of all steps of a chain.

    Attributes
    ----------
    size : int
        The components of a slice.
    rows : tuple of Squares
    active : Array
        Whether a run is worked on, (1,).
    begin : Array
        The first slice's equations by the prior, as an `equations.Layout` has them.
    reference, found, variance : Array
        The trajectory at which CPDs are linearised, the one that is found, and the variances of its
        components.
    """

    size: int
    rows: tuple[Squares, ...]
    active: Array
    begin: Array
    reference: Array
    found: Array
    variance: Array
