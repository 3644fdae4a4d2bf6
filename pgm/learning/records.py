"""Learning of networks without time, from records: a row of evidence for each.

The E step asks one posterior of all records for the joint of each CPD's family, its child and
parents. Records in which a family is observed need none of it, and those that tell nothing of a
CPD, as neither its child nor what depends on that was observed, are left out. Records of tables
that are alike are solved once.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.boundary import as_floats
from pgm.compile import compile
from pgm.cpds import CPD, SwitchingCPD, TableCPD
from pgm.errors import EvidenceError, ModelError, PgmError
from pgm.evidence import Evidence
from pgm.evidence.rows import as_log_weights, as_rows, no_evidence_for
from pgm.evidence.values import Constant, Soft
from pgm.factors.arrays import common_runs, flat
from pgm.factors.axes import as_indices
from pgm.factors.scope import Scope
from pgm.inference.engine import send
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.learning.model import Learner, Point
from pgm.learning.places import NETWORK, Place
from pgm.learning.residuals import lines
from pgm.linearisation.family import Family
from pgm.linearisation.weights import Weights
from pgm.networks import BayesianNetwork
from pgm.posteriors.expectations import Expectations, FamilyBelief, Learnable, RobustWeights
from pgm.schedules.options import Call
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False)
class Records:
    """Evidence of N records, some of them alike, and their weights (N,).

    `states` (N,) are of discrete variables, −1 where hidden, `values` (N, d) of others, NaN where
    hidden. `soft` (N, K) are the logarithms of the weights that soft evidence gives to the K states
    of a variable, which stays hidden. `told` says of each CPD's child, (N,), whether it or anything
    that depends on it was observed. `given` is the evidence as it was given, of runs `lead`.
    """

    given: Evidence
    lead: tuple[int, ...]
    weights: Array
    states: Mapping[Any, Integers]
    values: Mapping[Variable, Array]
    soft: Mapping[Discrete, Array]
    told: Mapping[Variable, Mask]

    @classmethod
    def of(cls, model: BayesianNetwork, evidence: Evidence, weights: Any) -> Records:
        """The records of a network's evidence, checked."""
        states: dict[Discrete, Integers] = {}
        values: dict[Variable, Array] = {}
        soft: dict[Discrete, Array] = {}
        for variable, value in evidence.items():
            if variable not in model.variables:
                raise no_evidence_for(variable, frozenset(model.variables))
            if isinstance(variable, Discrete) and isinstance(value, Soft):
                soft[variable] = as_log_weights(variable, value)
            elif isinstance(variable, Discrete):
                states[variable] = as_indices(variable, value)
            else:
                given = value.value if isinstance(value, Constant) else value
                values[variable] = as_rows(variable, given, None)
        shapes: list[tuple[Variable, tuple[int, ...]]] = [(v, a.shape) for v, a in states.items()]
        shapes += [(v, a.shape[:-1]) for v, a in (*values.items(), *soft.items())]
        lead = common_runs(shapes)
        count = int(np.prod(lead, dtype=int))
        own = _weights(weights, lead)
        wide = {v: np.broadcast_to(flat(a, lead, 0), count) for v, a in states.items()}
        logs = {v: np.broadcast_to(flat(a, lead, 1), (count, v.size)) for v, a in soft.items()}
        if model.discrete and (wide or logs):
            cells = [*(a[:, None] for a in wide.values()), *logs.values()]
            _, first, place = np.unique(
                np.concatenate(cells, axis=1), axis=0, return_index=True, return_inverse=True
            )
            wide = {v: a[first] for v, a in wide.items()}
            logs = {v: a[first] for v, a in logs.items()}
            count = len(first)
            own = np.asarray(np.bincount(place.ravel(), own, count), dtype=np.float64)
        rows = {
            v: np.broadcast_to(flat(a, lead, 1), (count, v.dimension)) for v, a in values.items()
        }
        known: dict[Variable, Mask] = {v: a >= 0 for v, a in wide.items()}
        known |= {v: (a != a[:, :1]).any(axis=1) for v, a in logs.items()}
        known |= {v: ~np.isnan(a).all(axis=1) for v, a in rows.items()}
        told: dict[Variable, Mask] = {}
        none = np.zeros(count, dtype=bool)
        for cpd in reversed(model.cpds):
            told[cpd.child] = told.get(cpd.child, none) | known.get(cpd.child, none)
            for parent in cpd.parents:
                told[parent] = told.get(parent, none) | told[cpd.child]
        return cls(evidence, lead, own, wide, rows, logs, told)

    @property
    def evidence(self) -> dict[Variable, Any]:
        """The evidence, records that are alike being one."""
        soft = {v: Soft(logs, log=True) for v, logs in self.soft.items()}
        return {**self.states, **self.values, **soft}

    def hidden(self, variables: Scope) -> Mask:
        """Whether any part of some variables is hidden, (N,)."""
        found = np.zeros(len(self.weights), dtype=bool)
        for variable in variables:
            if variable in self.states:
                found |= self.states[variable] < 0
            elif variable in self.values:
                found |= np.isnan(self.values[variable]).any(axis=1)
            else:
                found[:] = True
        return found


def _weights(weights: Any, lead: tuple[int, ...]) -> Array:
    """The weights of records, flattened."""
    if weights is None:
        return np.ones(int(np.prod(lead, dtype=int)))
    found = as_floats(weights, "weights=", EvidenceError)
    if found.shape != lead:
        raise EvidenceError(f"weights= has shape {found.shape}; {lead} was due, one of each record")
    if not np.isfinite(found).all() or (found < 0.0).any() or not found.any():
        raise EvidenceError("weights= are finite, 0 or more, and not all zero")
    return np.ravel(found)


class RecordLearner(Learner):
    """The parts of a network without time that are learnt, and the records."""

    roles = (NETWORK,)

    def __init__(
        self,
        model: BayesianNetwork,
        recordings: Sequence[Evidence],
        weights: Sequence[Any],
        *settings: Any,
        single: bool,
    ) -> None:
        self.weights = weights
        super().__init__(model, recordings, *settings, single=single)
        self.closed = self._is_closed()

    def _records(self, point: Point) -> list[Records]:
        return [
            Records.of(point.model, evidence, weights)
            for evidence, weights in zip(self.evidence(point), self.weights, strict=True)
        ]

    def _require_told(self) -> None:
        self.records = self._records(self.start)
        for place in self.places:
            cpd = place.of(self.start.model).cpd
            if not any(each.weights[each.told[cpd.child]].any() for each in self.records):
                raise EvidenceError(
                    f"nothing in the evidence tells of {cpd!r}, which is to be learnt: neither its "
                    "child nor anything that depends on it was observed",
                    variable=cpd.child,
                    cpd=cpd,
                )
            for each in self.records:
                self._require_observed(cpd, each)

    def _require_observed(self, cpd: CPD, records: Records) -> None:
        """Refuse a family with hidden continuous variables where discrete ones are hidden too."""
        model = self.start.model
        family = tuple(v for v in (*cpd.parents, cpd.child) if not isinstance(v, Discrete))
        told = records.told[cpd.child]
        if model.mixed and (records.hidden(family) & told).any():
            raise ModelError(
                f"{cpd!r}: some of ({', '.join(map(repr, family))}) are hidden in some records, of "
                "a network that has discrete variables too; learn it from records in which they "
                "are observed",
                variable=cpd.child,
                cpd=cpd,
            )

    def _is_closed(self) -> bool:
        """Whether each learnt family is observed wherever anything tells of it."""
        if self.parameters:
            return False
        for part in self._learnable(self.start):
            if getattr(part.own, "noise", None) is not None:
                return False
            family = (*part.cpd.parents, part.cpd.child)
            if any((r.hidden(family) & r.told[part.cpd.child]).any() for r in self.records):
                return False
        return True

    def _place_of(self, model: BayesianNetwork, variable: Any) -> Place:
        if isinstance(variable, Variable):
            for number, cpd in enumerate(model.cpds):
                if cpd.child == variable:
                    return Place(NETWORK, number)
        raise ModelError(f"learn of {variable!r}: the network has no CPD of it")

    def _hidden(self, model: BayesianNetwork, cpd: Any) -> Scope:
        known = {*model.inputs, *cpd.noise_given}
        return tuple(p for p in cpd.given if p not in known)

    def _solved(self, point: Point) -> tuple[list[Any], list[Any], float]:
        graph, posteriors, total = compile(point.model), [], 0.0
        records = self._records(point) if self.parameters else self.records
        for each in records:
            posterior = self._posterior(graph, each)
            posteriors.append(posterior)
            total += float(each.weights @ np.reshape(posterior.log_evidence, -1))
        return posteriors, self._expectations(point, records, posteriors), total

    def _posterior(self, graph: Any, records: Records) -> Any:
        call = Call(self.schedule, self.lineariser)
        try:
            return send(graph, records.evidence, call)
        except PgmError:
            if self.parameters:
                raise
            send(graph, records.given, call)  # whose error names the record
            raise

    def again(self, point: Point) -> list[Any]:
        """The expectations at another point, where all learnt families are observed."""
        return self._expectations(point, self.records, [None] * len(self.records))

    def _expectations(
        self, point: Point, records: Sequence[Records], posteriors: Sequence[Any]
    ) -> list[Any]:
        hidden = {part: self._hidden(point.model, part.own) for part in self._gaussian(point)}

        def make(own: Records, posterior: Any) -> Any:
            def expect(parts: Sequence[Learnable]) -> Expectations:
                counts, families = {}, {}
                for part in parts:
                    if isinstance(part.cpd, TableCPD):
                        counts[part] = _counts(own, posterior, part.cpd)
                    else:
                        families[part] = _belief(
                            own, posterior, part, hidden[part], self.lineariser
                        )
                return Expectations(counts, families)

            return expect

        return [make(*each) for each in zip(records, posteriors, strict=True)]

    def _gaussian(self, point: Point) -> Iterator[Learnable]:
        """The CPDs of continuous variables of which anything is learnt, parameters too."""
        for part in (*self._learnable(point), *self._of_parameters(point.model)):
            if not isinstance(part.cpd, TableCPD):
                yield part

    def results(self, point: Point, posteriors: list[Any]) -> list[Any]:
        """The posterior of each table of records, of as many runs as were given."""
        graph, call = compile(point.model), Call(self.schedule, self.lineariser)
        return [
            posterior
            if len(each.lead) == 1 and not point.model.discrete  # no records were joined
            else send(graph, evidence, call)
            for posterior, each, evidence in zip(
                posteriors, self.records, self.evidence(point), strict=True
            )
        ]


def _shares(records: Records, posterior: Any, variables: Sequence[Discrete]) -> Array:
    """The probabilities (N, sizes...) of discrete variables together, of each record."""
    scope = tuple(variables)
    count, sizes = len(records.weights), tuple(v.size for v in scope)
    hidden = tuple(v for v in scope if records.hidden((v,)).any())
    if not hidden:
        found = np.zeros((count, *sizes))
        found[(np.arange(count), *(records.states[v] for v in scope))] = 1.0
        return found
    part = posterior.joint(*hidden).probabilities.reshape(count, *(v.size for v in hidden))
    observed = tuple(v for v in scope if v not in hidden)
    found = np.zeros((count, *(v.size for v in (*observed, *hidden))))
    found[(np.arange(count), *(records.states[v] for v in observed))] = part
    order = [(*observed, *hidden).index(v) + 1 for v in scope]
    return found.transpose(0, *order)


def _counts(records: Records, posterior: Any, cpd: TableCPD) -> Array:
    """The expected counts of a table, (parents..., child)."""
    family: Any = (*cpd.given, cpd.child)
    counts = np.zeros(tuple(v.size for v in family))
    told = records.told[cpd.child] & (records.weights > 0.0)
    hidden = records.hidden(family)
    whole = told & ~hidden
    if whole.any():
        states = tuple(records.states[v][whole] for v in family)
        np.add.at(counts, states, records.weights[whole])
    some = told & hidden
    if some.any():
        shares = _shares(records, posterior, family)[some]
        counts += np.tensordot(records.weights[some], shares, axes=1)
    return counts


def _belief(
    records: Records, posterior: Any, part: Learnable, hidden: Scope, lineariser: Any
) -> FamilyBelief:
    """The belief of a Gaussian CPD's family in the records that tell of it."""
    own: Any = part.own
    weights = records.weights
    if isinstance(part.cpd, SwitchingCPD):
        assert part.case is not None
        shares = _shares(records, posterior, part.cpd.switches)
        for state in reversed(part.case):
            shares = shares[..., state]
        weights = weights * shares
    rows = np.flatnonzero(records.told[part.cpd.child] & (weights > 0.0))
    family = (*hidden, own.child)
    starts = np.cumsum([0, *(v.dimension for v in family)])
    places = {v: np.arange(*starts[k : k + 2]) for k, v in enumerate(family)}
    mean = np.zeros((len(rows), int(starts[-1])))
    cov = np.zeros((len(rows), int(starts[-1]), int(starts[-1])))
    for variable in family:
        if variable in records.values:
            mean[:, places[variable]] = records.values[variable][rows]
    weighed = own.noise is not None and not isinstance(part.cpd, SwitchingCPD)
    if weighed:  # what was measured of the child is told apart, and none of it is hidden
        family = hidden
    unknown = tuple(v for v in family if records.hidden((v,)).any())
    if records.hidden(family)[rows].any():
        joint = posterior.joint(*unknown)
        chosen = np.concatenate([places[v] for v in unknown])
        size = len(chosen)
        mean[:, chosen] = joint.mean.reshape(-1, size)[rows]
        cov[:, chosen[:, None], chosen] = joint.cov.reshape(-1, size, size)[rows]
    inputs = {
        p: records.values[p][rows][None] for p in (*own.given, *own.noise_given) if p not in hidden
    }
    made = Family.make(
        own, hidden, np.zeros(1, dtype=np.intp), inputs, lineariser, (len(rows),), timed=False
    )
    found = FamilyBelief(made, mean[None], cov[None], None, None, weights[rows][None])
    return _weighed(found, records.values[own.child][rows]) if weighed else found


def _weighed(belief: FamilyBelief, values: Array) -> FamilyBelief:
    """The belief over the parents of a CPD of robust noise, its measurements (N, d), and weights.

    Weights are those at the squares that the belief expects, which raise the bound once more.
    """
    cpd = belief.family.cpd
    assert cpd.noise is not None
    known = ~np.isnan(values)[None]
    taken = None if known.all() else known
    measured, (value, matrix, error) = np.where(known, values, 0.0), lines(belief, {})
    residual = nearest_branch(measured, value, cpd.child.angle_mask) - value
    weights = Weights.of(cpd, belief.family.own_noise, taken, residual.shape[:2])
    if belief.family.expects:
        cov = belief.cov[..., : matrix.shape[-1], : matrix.shape[-1]]
        matrix = np.broadcast_to(matrix, (*residual.shape, matrix.shape[-1]))
        square = weights.squares(residual, matrix, cov, error)
    else:
        square = weights.squares(residual)
    weight = cpd.noise.weight(square, weights.count)
    size = belief.family.shape[-1]
    return belief._replace(
        mean=belief.mean[..., :size],
        cov=belief.cov[..., :size, :size],
        values=measured,
        taken=taken,
        robust=RobustWeights(weight, square, weights.count),
    )
