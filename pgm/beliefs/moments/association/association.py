r"""Associating sightings of unknown identity, for Gaussian beliefs: each with a candidate.

A sighting is one measurement of a sensor, of d components. It is *open* if one parent of the sensor
is unknown: one of k candidates m_j with prior probabilities w_j, say the landmarks of a map. An
open sighting may also be *spurious*, or of a *new* thing that is no candidate. Each of these two
has a prior probability, too, and a uniform density over a volume of measurements; the user gives
the probabilities and the volume.

Let N(μ, P) be the belief over the slice x of a step, the vector of its n hidden components. A
sighting is linearised with candidate m_j as z = ẑ_j + H_j (x − μ) + e, e ~ N(0, R_j). Its
innovation ν_j = z − ẑ_j has the covariance S_j = H_j P H_jᵀ + R_j. The user may give a *candidates'
gate*, a probability: candidates whose ν_jᵀ S_j⁻¹ ν_j exceeds its χ² quantile are ruled out.

How the choice is made, the user says by a sensor's `association`. With "likelihood" each sighting
is decided by itself: of the candidates left the one of largest ln w_j + ln N(ν_j; 0, S_j) is
chosen, unless being spurious or new is likelier. With "joint" the sensor's sightings of a step are
decided together: as many of them as lie within the gate together are given candidates, and none of
these is given twice. "sum", a sum over the candidates, is refused here. The belief is conditioned
first on the step's sightings that are not open, and then on the open ones of one sensor after
another, with the candidates chosen.

There may be a *filter's gate*, too: one probability for all sensors, or a mapping from sensors to
theirs. A sighting whose νᵀS⁻¹ν exceeds the χ² quantile of that is not used; of an open sighting
this is the ν of the candidate chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.beliefs.moments.compiled import sweep
from pgm.beliefs.moments.compiled.sweep import Swept, is_used
from pgm.beliefs.moments.digits import certificate
from pgm.beliefs.moments.steps.account import Account
from pgm.beliefs.moments.steps.chain import MomentChain
from pgm.beliefs.moments.steps.gate import Asked, prepare
from pgm.beliefs.moments.steps.open_sensor import OpenSensor
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.beliefs.moments.steps.readings import Moments
from pgm.beliefs.moments.steps.some_runs import evidence_of, graph_of
from pgm.beliefs.moments.steps.vector import vector
from pgm.compile import DynamicGraph
from pgm.errors import EvidenceError, NumericalError, PgmError
from pgm.evidence import BoundEvidence, Reading
from pgm.evidence.values import JOINT
from pgm.kernels import association, joint_compatibility, moments
from pgm.kernels.arrays import Array, Mask, quiet, vacant
from pgm.linearisers import Lineariser
from pgm.posteriors.associations import Associations, collected
from pgm.progress import counted
from pgm.schedules.schedule import ONCE, Filtering
from pgm.tracing import judged
from pgm.variables import Variable

# How much longer a step takes, with several candidates, than that of a filter.
_TIMES = 8


class Associated(NamedTuple):
    """Evidence in which all open sightings have been decided, and the record of the decisions.

    In `bound` the parent that was unknown has the value of the candidate chosen for the sighting; a
    sighting that is spurious or new counts as not measured. `found` has the probabilities of all
    candidates for each sighting, by the sensor's variable.
    """

    bound: BoundEvidence
    found: dict[Variable, Associations]


@quiet()
def associated(
    graph: DynamicGraph, bound: BoundEvidence, lineariser: Lineariser, gate: Asked | None = None
) -> tuple[Associated, str]:
    """Associate the open sightings of all steps by a filter that linearises each CPD once.

    `bound` is the evidence, open sightings included. `gate` is the filter's gate, for open and
    other sightings; None is no gate. The text tells whether machine code decided, as of
    `Status.compilation`. An EvidenceError refuses a prior of infinite variance, and
    sensors whose `association` is "sum".
    """
    plan = _named(graph, bound, lineariser, probe=False)
    if certificate.is_flat(plan):
        raise EvidenceError(
            "sightings leave open what was seen, and the prior has an infinite variance, under "
            "which every candidate is as likely: give it a finite one"
        )
    pending, account, whole = _pending(bound, gate), plan.account, slice(0, bound.runs)
    left = [whole]
    if is_used(plan, _TIMES):
        account, left = _compiled(graph, bound, lineariser, gate, pending)
    for runs in left:
        if runs != whole:
            own_graph, own = graph_of(graph, bound, runs), evidence_of(bound, runs)
            part = _pending(own, gate)
            with suppress(PgmError):  # the first error may be of other runs
                _by_numpy(own_graph, own, lineariser, gate, part)
                for each, found in zip(pending, part, strict=True):
                    each.put(runs, found)
                continue
        _by_numpy(graph, bound, lineariser, gate, pending)
        break
    return _closed(bound, pending), account.words(bound.runs)


def _named(
    graph: DynamicGraph, bound: BoundEvidence, lineariser: Lineariser, *, probe: bool = True
) -> ChainPlan:
    """The plan of the evidence without its open sightings."""
    named = tuple(reading for reading in bound.readings if reading.unknown is None)
    return ChainPlan.make(graph, replace(bound, readings=named), lineariser, probe=probe)


def _pending(bound: BoundEvidence, gate: Asked | None) -> list[_Pending]:
    """The sensors with open sightings, none of which is decided."""
    return [
        _Pending(reading, bound.runs, gate)
        for reading in bound.readings
        if reading.unknown is not None
    ]


def _compiled(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    gate: Asked | None,
    pending: Sequence[_Pending],
) -> tuple[Account, list[slice]]:
    """Decide about all sightings in one sweep of machine code, but for the runs that it leaves.

    Its account tells why it leaves some.
    """
    swept: Swept | None = None
    for judge in judged():
        with judge:
            plan = ChainPlan.make(graph, bound, lineariser, judge=judge)
            prepare(plan, gate)
            size, shape = plan.layout.slice_size, (plan.steps + 1, plan.runs)
            known = vacant(shape, (size,)), vacant(shape, (size, size)), np.empty(shape)
            swept = sweep.forward(plan, Filtering(gate=gate), known, keep=False, times=_TIMES)
    if swept is None:
        return plan.account, [slice(0, plan.runs)]
    sensors = {sensor.variable: sensor for sensor in plan.sensors}
    for each in pending:
        sensor = sensors[each.reading.cpd.child]
        assert isinstance(sensor, OpenSensor)
        terms = association.with_outliers(sensor.terms, each.unknown.log_outliers)
        each.decide(range(len(sensor.terms)), terms)
    return plan.account, swept.left


def _by_numpy(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    gate: Asked | None,
    pending: Sequence[_Pending],
) -> None:
    """Decide about all sightings, step by step."""
    plan = _named(graph, bound, lineariser)
    for each in pending:
        each.trace(graph, bound, lineariser)
    chain = MomentChain(plan, Filtering(gate=gate), keep=False)
    belief = chain.start()
    for step in counted(range(bound.steps + 1), "associations"):
        if step:
            belief = chain.predict(step, belief)
        belief, _ = chain.take(step, belief)
        for each in pending:
            rows = each.rows(step)
            if len(rows):
                belief = each.associate(graph, bound, lineariser, step, rows, belief)


@quiet()
def associated_at(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    step: int,
    belief: Moments,
    gate: Asked | None = None,
) -> Associated:
    """Associate the open sightings of one step, at its predicted `belief`.

    `bound` has the measurements of that step alone, as its step 0; `step` is the step's number in
    the chain, for CPDs that depend on time and for the texts of errors. `gate` is the filter's
    gate, for open and other sightings; None is no gate. An EvidenceError refuses sensors whose
    `association` is "sum".
    """
    pending = _pending(bound, gate)
    known = tuple(reading for reading in bound.readings if reading.unknown is None)
    for each in pending:
        each.trace(graph, bound, lineariser, step)
    belief = _taken(graph, bound, lineariser, step, known, belief, gate, probe=True)
    for each in pending:
        rows = range(len(each.reading.step))
        if len(rows):
            belief = each.associate(graph, bound, lineariser, step, rows, belief)
    return _closed(bound, pending)


def _closed(bound: BoundEvidence, pending: Sequence[_Pending]) -> Associated:
    """The result of an association: the evidence `bound` with its open sightings decided.

    `pending` are the sensors with open sightings, of which all have been associated.
    """
    closed = {each.reading.cpd.child: each.closed for each in pending}
    readings = tuple(closed.get(r.cpd.child, r) for r in bound.readings)
    found = dict(
        collected(p.reading, p.probability, len(p.unknown.candidates), bound.lead) for p in pending
    )
    return Associated(replace(bound, readings=readings), found)


class _Pending:
    """The open sightings of one sensor, and the associations of those decided so far.

    `reading` has all sightings of the sensor at all steps, one *row* a sighting, sorted by step; it
    names the unknown parent and its candidates. An EvidenceError refuses the association "sum".
    `gate` is the filter's gate, None for no gate.

    The arrays `probability`, `values` and `taken` are of the M sightings, in the order of the rows,
    so far as they are decided. `probability` (M, runs, k + 2) is that of the sighting being of each
    candidate, spurious, or of a new thing. `values` (M, runs, p) is the chosen value of the unknown
    parent, of p components. `taken` (M, runs, d) marks which of the sighting's d components were
    used as measurements.
    """

    def __init__(self, reading: Reading, runs: int, gate: Asked | None) -> None:
        assert reading.unknown is not None
        self.reading, self.gate = reading, gate
        self.parent, self.unknown = reading.unknown
        if self.unknown.is_summed:
            raise EvidenceError(
                f"sightings of {reading.cpd.child!r} leave {self.parent!r} open, to be summed out: "
                "which mixtures of Gaussians do, and other families; give "
                'association="likelihood", or belief=pgm.Gaussians(1), pgm.Particles(...) or '
                "pgm.Grid(...)",
                variable=self.parent,
                cpd=reading.cpd,
            )
        shape = len(reading.step), runs
        self.probability = np.empty((*shape, len(self.unknown.candidates) + 2))
        self.values = np.empty((*shape, self.parent.dimension))
        self.taken: Mask = np.empty((*shape, reading.values.shape[-1]), dtype=bool)

    def put(self, runs: slice, other: _Pending) -> None:
        """Copy what was decided of some runs."""
        for name in ("probability", "values", "taken"):
            getattr(self, name)[:, runs] = getattr(other, name)

    def rows(self, step: int) -> range:
        """The rows of the sensor's sightings at a step, a range that may be empty."""
        first, last = np.searchsorted(self.reading.step, [step, step + 1]).tolist()
        return range(first, last)

    def trace(
        self, graph: DynamicGraph, bound: BoundEvidence, lineariser: Lineariser, first: int = 0
    ) -> None:
        """Probe the sensor's function and have it traced, for all sightings of a call.

        Otherwise the first call of a graph would take derivatives by differences, and later calls
        by the trace that the filter has made. `first` is the number of the evidence's step 0.
        """
        if len(self.reading.step):
            tried = _tried(self._expanded(range(1), bound.runs), bound, 1)
            ChainPlan.make(graph, tried, lineariser, first=first, prior=False)

    def associate(
        self,
        graph: DynamicGraph,
        bound: BoundEvidence,
        lineariser: Lineariser,
        step: int,
        rows: range,
        belief: Moments,
    ) -> Moments:
        """Choose a candidate for each sighting of a step; returns the belief given the sightings.

        `rows` are the sightings' rows in the reading, all of the sensor at `step`; `belief` is
        over that step's slice, given all measurements used so far. The probability of candidate j
        is ∝ w_j N(ν_j; 0, S_j), and zero outside the candidates' gate; that of being spurious, and
        that of being new, is ∝ its prior probability times its uniform density. Where all k + 2 are
        zero the sighting is spurious. The likeliest of the k + 2 is chosen for each sighting by
        itself, or, if the sensor's `association` is "joint", for all sightings together. Spurious
        and new sightings do not change the belief. A NumericalError refuses an S_j that is not
        positive definite, an EvidenceError a joint choice among too many hypotheses.
        """
        runs, unknown = bound.runs, self.unknown
        pairs = _innovations(
            graph, bound, lineariser, step, self._expanded(rows, runs), belief, len(rows)
        )
        terms = association.terms(
            pairs, unknown.log_shares[:-2], unknown.log_outliers, unknown.gate
        )
        if unknown.association == JOINT:
            terms = self._jointly(pairs, terms, belief.by_run[1], step, bound.first_run)
        self.decide(rows, terms)
        return _taken(graph, bound, lineariser, step, (self.part(rows),), belief, self.gate)

    def decide(self, rows: range, terms: Array) -> None:
        """Take the sightings of some rows for what is likeliest, by terms (..., k + 2)."""
        some, candidates = slice(rows.start, rows.stop), self.unknown.candidates
        measured = np.asarray(self.reading.taken[some].any(axis=-1))
        probability = association.probabilities(terms, measured)
        likeliest = association.likeliest(probability)
        seen = likeliest < len(candidates)
        self.probability[some] = probability
        self.values[some] = candidates[np.where(seen, likeliest, 0)]
        self.taken[some] = self.reading.taken[some] & seen[..., None]

    def _jointly(
        self, pairs: association.Pairs, terms: Array, cov: Array, step: int, first_run: int
    ) -> Array:
        """Decide about a step's sightings together; see `association.jointly`.

        A search of too many hypotheses is refused with an EvidenceError, which counts runs from
        `first_run`.
        """
        gate = self.unknown.gate
        assert gate is not None
        try:
            return association.jointly(pairs, terms, cov, self.unknown.log_shares[:-2], gate)
        except joint_compatibility.TooManyError as error:
            cpd, run = self.reading.cpd, first_run + error.args[0]
            raise EvidenceError(
                f"{len(terms)} sightings of {cpd.child!r} at step {step} fit "
                f"{self.unknown!r} in more than {joint_compatibility.NODES:,} ways (run {run}): "
                f"give a narrower gate, a surer belief, or fewer candidates; "
                'association="likelihood" decides about each sighting by itself',
                variable=cpd.child,
                cpd=cpd,
                step=step,
                run=run,
            ) from None

    def _expanded(self, rows: range, runs: int) -> Reading:
        """The sightings at `rows` with every candidate in every run, laid out as runs of a reading.

        `runs` is the number of runs of the evidence. The new reading has len(rows) · runs · k runs,
        one for each sighting, old run and candidate; of these candidates vary fastest and sightings
        slowest. Each new run has its sighting at step 0, and its candidate as the value of the
        unknown parent, so that all are linearised at once.
        """
        reading, candidates = self.reading, self.unknown.candidates
        count, shape = len(candidates), (len(rows), runs, len(candidates))

        def wide(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
            some = values[rows.start : rows.stop]
            each = np.broadcast_to(some[:, :, None], (*shape, some.shape[-1]))
            return each.reshape(1, -1, some.shape[-1])

        own = np.broadcast_to(candidates, (*shape[:2], *candidates.shape))
        return replace(
            reading,
            step=np.zeros(1, dtype=np.intp),
            order=np.zeros(1, dtype=np.intp),
            values=wide(reading.values),
            taken=wide(reading.taken),
            inputs={
                **{v: wide(a) for v, a in reading.inputs.items()},
                self.parent: own.reshape(1, len(rows) * runs * count, -1),
            },
            unknown=None,
        )

    def part(self, rows: range) -> Reading:
        """The sightings at some rows, as if all of step 0, with the candidates chosen for them.

        Candidates must have been chosen for all these sightings before.
        """
        chosen = slice(rows.start, rows.stop)
        return replace(
            self.reading,
            step=np.zeros(len(rows), dtype=np.intp),
            order=np.arange(len(rows)),
            values=self.reading.values[chosen],
            taken=self.taken[chosen],
            inputs={
                **{v: a[chosen] for v, a in self.reading.inputs.items()},
                self.parent: self.values[chosen],
            },
            unknown=None,
        )

    @property
    def closed(self) -> Reading:
        """All sightings at their steps, with the candidates chosen for them as the parent's values.

        Candidates must have been chosen for all sightings before.
        """
        whole = self.part(range(len(self.reading.step)))
        return replace(whole, step=self.reading.step, order=self.reading.order)


def _taken(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    step: int,
    readings: tuple[Reading, ...],
    belief: Moments,
    gate: Asked | None,
    *,
    probe: bool = False,
) -> Moments:
    """The belief over the slice at `step`, conditioned on measurements of that step, `readings`.

    Each reading has its sightings at a step 0; `step` is the step's number in the chain. `gate` is
    the filter's gate, None if all sightings are to be used. The evidence `bound` tells only how
    many runs there are, and how the user lays them out along axes. `probe` is as of
    `ChainPlan.make`, for sensors whose functions have not been traced in this call.
    """
    one = BoundEvidence(0, bound.lead, (), readings, bound.first_run)
    plan = ChainPlan.make(graph, one, lineariser, first=step, prior=False, probe=probe)
    chain = MomentChain(plan, Filtering(gate=gate), keep=False)
    return chain.take(step, belief, chain.readings(0))[0]


def _tried(reading: Reading, bound: BoundEvidence, rows: int) -> BoundEvidence:
    """The evidence of one step with a reading whose sightings are tried with all candidates.

    The `reading` is as of `_innovations`, of so many `rows`; of `bound` the runs are used alone.
    """
    candidates = reading.values.shape[1] // (rows * bound.runs)
    lead = rows, bound.runs, candidates
    return BoundEvidence(0, lead, (), (reading,), bound.first_run, candidates=True)


def _innovations(
    graph: DynamicGraph,
    bound: BoundEvidence,
    lineariser: Lineariser,
    step: int,
    reading: Reading,
    belief: Moments,
    rows: int,
) -> association.Pairs:
    """The innovations of each sighting with each candidate, linearised at the belief of its run.

    `reading` has a run for each sighting, run of `bound` and candidate, with that candidate as the
    value of the unknown parent; of these runs candidates vary fastest and sightings slowest. `rows`
    is the number of sightings. `belief` is over the slice at `step`, in the runs of `bound`; of
    `bound` only the number of runs is used, and that of the first, for the texts of errors. An S
    that is singular, indefinite or not finite is refused with a NumericalError.
    """
    every = reading.values.shape[1]
    one = _tried(reading, bound, rows)
    plan = ChainPlan.make(graph, one, lineariser, first=step, prior=False, probe=False)
    means, covs = belief.by_run
    of = np.tile(np.repeat(np.arange(bound.runs), every // (rows * bound.runs)), rows)
    here = Moments.of(plan, means[of], covs[of])
    parts = MomentChain(plan, ONCE, keep=False).readings(0)
    seen = [part.linearise(here.mean, here.cov) for part in parts]
    for part in parts:
        part.require_finite()
    matrix, residual, noise, _ = vector(seen, here.mean)
    height, size = matrix.shape[:2]
    wide = matrix.reshape(height, size, -1).transpose(2, 0, 1)
    noises = np.broadcast_to(
        noise.reshape(height, height, -1).transpose(2, 0, 1), (every, height, height)
    )
    spread = moments.predict(covs[of], wide, noises)
    left = residual.reshape(height, -1).T
    shape = rows, bound.runs, -1
    found = association.paired(
        np.broadcast_to(wide, (every, height, size)).reshape(*shape, height, size),
        left.reshape(*shape, height),
        noises.reshape(*shape, height, height),
        spread.reshape(*shape, height, height),
        reading.taken[0].sum(axis=-1).reshape(shape),
    )
    if not (found.share > 0.0).all():
        raise NumericalError(
            f"{reading.cpd!r}: at step {step} an innovation has no variance in a component, or two "
            "that are one, so that candidates cannot be compared; give the sensor some noise",
            variable=reading.cpd.child,
            cpd=reading.cpd,
            step=step,
        )
    return found
