"""The beliefs of runs with different gaps, in the order of the runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.display import Summary, count
from pgm.errors import EvidenceError, GraphError, PgmError
from pgm.evidence.cells import Cells, Pattern, observed
from pgm.factors import Gaussian, GaussianMixture, Table
from pgm.factors.axes import sizes
from pgm.factors.scope import Scope, as_scope, dimension, namesake, positions
from pgm.kernels.arrays import Array, Integers, frozen
from pgm.posteriors.outcome import BY_PATTERN, Outcome
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.status import FAR_APART, Status
from pgm.posteriors.summaries import of_network
from pgm.resources import require_memory
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False)
class Group:
    """Runs of one pattern of gaps, with their beliefs.

    Attributes
    ----------
    runs : ndarray
        Their numbers, (n,), of all runs as one axis.
    pattern : Pattern
        Of which these are all runs, or those that are possible, or those that are not.
    outcome : Outcome or None
        Their beliefs, with one axis of runs or, where all have the same, none; None of runs whose
        evidence is impossible.
    readings : mapping of Variable to Variable
        By variable observed in part, the exact reading of its observed components.
    """

    runs: Integers
    pattern: Pattern
    outcome: Outcome[Any] | None
    readings: Mapping[Variable, Variable]

    def is_plain(self, lead: tuple[int, ...]) -> bool:
        """Whether the beliefs are all there is to say of runs with these axes."""
        return (
            self.outcome is not None
            and not self.pattern.parts
            and np.shape(self.outcome.log_evidence) == lead
        )

    def each(self, values: Any, own: int) -> Any:
        """Values (*runs, ...) with so many own axes, which all runs may share, as (n, ...)."""
        found = np.asarray(values)
        lead, rest = found.shape[: found.ndim - own], found.shape[found.ndim - own :]
        flat = found.reshape(math.prod(lead), *rest)
        return np.broadcast_to(flat, (self.runs.size, *rest))


@dataclass(frozen=True, eq=False, repr=False)
class OutcomeByPattern(Outcome[Any]):
    """The beliefs of a network whose runs have gaps at different cells; leading axes are runs.

    ``posterior[v]`` is the belief of a variable that some runs do not observe, or observe in part.
    An observed component has its value, with covariance zero, and an observed state has
    probability one. Runs whose evidence is impossible have beliefs of NaN, and ln p = −∞.
    """

    beliefs: ClassVar[str] = "beliefs of runs with different gaps"
    form: ClassVar[str] = BY_PATTERN

    kind: ClassVar[None] = None
    graph: ClusterGraph
    _cells: Cells
    _groups: tuple[Group, ...]

    @property
    def _solved(self) -> list[tuple[Group, Outcome[Any]]]:
        """The groups that have beliefs, with these."""
        return [(group, group.outcome) for group in self._groups if group.outcome is not None]

    def _spread(self, own: Sequence[int], fill: Any, part: Callable[[Group], Any]) -> Any:
        """An array of all runs, (*runs, *own), from that of each group, (n, *own)."""
        found = np.full((self._cells.runs, *own), fill)
        for group, _ in self._solved:
            found[group.runs] = part(group)
        return found.reshape((*self._cells.lead, *own))

    def __getitem__(self, variable: Variable) -> Gaussian | GaussianMixture | Table:
        """The marginal of a variable that is not observed in all runs."""
        return self.joint(require_variable(variable))

    def joint(self, *variables: Variable) -> Gaussian | GaussianMixture | Table:
        """The joint of variables that are not observed in all runs, in the order given."""
        scope = as_scope(variables)
        if not scope:
            raise EvidenceError("joint takes one or more variables")
        for variable in scope:
            self._require_hidden(variable)
        kinds = {isinstance(v, Discrete) for v in scope}
        if len(kinds) > 1:
            raise EvidenceError(
                f"a joint of discrete and continuous variables, {list(scope)}, is neither a table "
                "nor a mixture; ask for each kind by itself"
            )
        return self._table(scope) if kinds.pop() else self._gaussians(scope)

    @cached_property
    def _variables(self) -> Scope:
        """The variables of the network, and the causes of its mixtures, which beliefs have too."""
        inside = (v for _, outcome in self._solved for v in outcome._hidden)
        return tuple(dict.fromkeys([*self.graph.network.variables, *inside]))

    def _require_hidden(self, variable: Variable) -> None:
        known = self._variables
        if variable not in known:
            raise EvidenceError(
                f"{variable!r} is not in the network; its variables are {list(known)}"
                f"{namesake(variable, known)}",
                variable=variable,
            )
        if self._is_observed(variable):
            raise EvidenceError(
                f"{variable!r} is observed in all runs: its value is its evidence; for a belief "
                "about it give it no evidence",
                variable=variable,
            )

    def _is_observed(self, variable: Variable) -> bool:
        if isinstance(variable, Discrete):
            states = self._cells.states.get(variable)
            return states is not None and observed(states)
        return all(variable in group.pattern.whole for group in self._groups)

    @cached_property
    def _hidden(self) -> Scope:
        found = {v for group, outcome in self._solved for v in outcome._hidden}
        found |= {v for group in self._groups for v in group.readings}
        every = found if self._solved else frozenset(self._variables)
        return tuple(v for v in self._variables if v in every and not self._is_observed(v))

    def _gaussians(self, scope: Scope) -> Gaussian | GaussianMixture:
        """The joint of continuous variables, of as many Gaussians as the group with the most."""
        size, runs, lead = dimension(scope), self._cells.runs, self._cells.lead
        found = [(group, self._of_group(group, outcome, scope)) for group, outcome in self._solved]
        most = max((mean.shape[1] for _, (_, mean, _) in found), default=1)
        require_memory(
            runs * most * size * (size + 1),
            f"the joint of {list(scope)} in {runs:,} runs",
            "ask for fewer variables, or give fewer runs, at a time",
            error=GraphError,
        )
        weights = np.full((runs, most), np.nan)
        means = np.full((runs, most, size), np.nan)
        covs = np.full((runs, most, size, size), np.nan)
        for group, (weight, mean, cov) in found:
            own = mean.shape[1]
            weights[group.runs, :own] = 1.0 if weight is None else weight
            weights[group.runs, own:] = 0.0
            means[group.runs, :own], means[group.runs, own:] = mean, mean[:, :1]
            covs[group.runs, :own], covs[group.runs, own:] = cov, cov[:, :1]
        if all(weight is None for _, (weight, _, _) in found):
            return Gaussian._make(
                scope, means.reshape((*lead, size)), covs.reshape((*lead, size, size))
            )
        parts = Gaussian._make(
            scope, means.reshape((*lead, most, size)), covs.reshape((*lead, most, size, size))
        )
        return GaussianMixture._make(weights.reshape((*lead, most)), parts)

    def _of_group(
        self, group: Group, outcome: Outcome[Any], scope: Scope
    ) -> tuple[Array | None, Array, Array]:
        """The joint of a group as weights (n, K), means (n, K, size) and covariances.

        Weights are None of one Gaussian. What was observed has its value, without variance.
        """
        size, every = dimension(scope), np.arange(dimension(scope))
        hidden = tuple(v for v in scope if v not in group.pattern.whole)
        weights, mean, cov = None, np.zeros((1, 1, 0)), np.zeros((1, 1, 0, 0))
        if hidden:
            belief = _asked(outcome, hidden)
            if isinstance(belief, GaussianMixture):
                weights = group.each(belief.weights, 1)
                mean, cov = belief.components.mean, belief.components.cov
            else:
                mean, cov = belief.mean[..., None, :], belief.cov[..., None, :, :]
        own = every[positions(scope, hidden)]
        shape = group.runs.size, mean.shape[-2], size
        means, covs = np.zeros(shape), np.zeros((*shape, size))
        means[..., own] = group.each(mean, 2)
        covs[..., own[:, None], own] = group.each(cov, 3)
        for variable in scope:
            if variable in self._cells.values:
                values = self._cells.rows(variable, group.runs)
                known = np.flatnonzero(~np.isnan(values[0]))
                at = every[positions(scope, [variable])][known]
                means[..., at] = values[:, None, known]
                covs[..., at, :] = covs[..., at] = 0.0
        return weights, means, covs

    def _table(self, scope: Scope) -> Table:
        """The joint of discrete variables."""
        states = tuple(v for v in scope if isinstance(v, Discrete))
        require_memory(
            self._cells.runs * math.prod(sizes(states)),
            f"the joint of {list(scope)} in {self._cells.runs:,} runs",
            "ask for fewer variables, or give fewer runs, at a time",
            error=GraphError,
        )

        def part(group: Group) -> Array:
            known = {v: rows for v in states if (rows := self._seen(v, group)) is not None}
            hidden = [v for v in states if v not in known]
            found = np.ones((group.runs.size, *(1,) * len(states)))
            if hidden:
                assert group.outcome is not None
                own = group.each(_asked(group.outcome, hidden).probabilities, len(hidden))
                found = own.reshape(-1, *(1 if v in known else v.size for v in states))
            for k, v in enumerate(states):
                if v in known:
                    each = (known[v][:, None] == np.arange(v.size)).astype(np.float64)
                    found = found * each.reshape(
                        -1, *(v.size if j == k else 1 for j in range(len(states)))
                    )
            return found

        return Table._plain(states, frozen(self._spread(sizes(states), np.nan, part)))

    def _seen(self, variable: Discrete, group: Group) -> Integers | None:
        """The states of a variable that was observed in all runs of a group, (n or 1,)."""
        if variable not in self._cells.states:
            return None
        states: Integers = self._cells.rows(variable, group.runs)
        return states if observed(states) else None

    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Any]:
        """So many draws for each run: (count, *runs, d), or (count, *runs) of state indices.

        Of runs whose evidence is impossible they are NaN, and −1.
        """
        runs, lead = self._cells.runs, self._cells.lead
        found: dict[Variable, Any] = {
            v: np.full((count, runs), -1, dtype=np.intp)
            if isinstance(v, Discrete)
            else np.full((count, runs, v.dimension), np.nan)
            for v in self._hidden
        }
        for group, outcome in self._solved:
            n = group.runs.size
            # Runs that share their beliefs have draws of their own.
            times = n if np.size(outcome.log_evidence) < n else 1
            drawn = outcome.sample(count * times, rng)  # type: ignore[attr-defined]
            for variable, array in found.items():
                if variable in drawn:
                    array[:, group.runs] = drawn[variable].reshape(count, n, *array.shape[2:])
                if isinstance(variable, Discrete):
                    states = self._seen(variable, group)
                    if states is not None:
                        array[:, group.runs] = states
                elif variable in self._cells.values:
                    values = self._cells.rows(variable, group.runs)
                    known = np.flatnonzero(~np.isnan(values[0]))
                    array[:, group.runs[:, None], known] = values[:, known]
        return {v: array.reshape((count, *lead, *array.shape[2:])) for v, array in found.items()}

    @cached_property
    def log_evidence(self) -> Array:
        """The value ln p(evidence), (*runs), in nats; −∞ of runs whose evidence is impossible."""
        return frozen(self._spread((), -np.inf, lambda g: g.each(_solution(g).log_evidence, 0)))

    @property
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`: of all patterns, or of the one that says least."""
        kinds = {outcome.log_evidence_kind for _, outcome in self._solved}
        return next((kind for kind in _LEAST if kind in kinds), "exact")

    @cached_property
    def status(self) -> Status:
        """How inference went in each run: that of its pattern, and nothing where impossible."""
        each = [outcome.status for _, outcome in self._solved]
        most = max((len(status.residuals) for status in each), default=0)

        def residuals(group: Group) -> Any:
            own = _solution(group).status.residuals
            if len(own) < most:  # the last one stays
                last = own[-1:] if len(own) else np.zeros((1, *own.shape[1:]))
                own = np.concatenate([own, np.repeat(last, most - len(own), axis=0)])
            return group.each(np.moveaxis(own, 0, -1), 1)

        def left(group: Group) -> Any:
            own = _solution(group).status.digits
            return group.each(np.inf if own is None else own, 0)

        measured = {float(s.digits.min()): s._cause for s in each if s.digits is not None}
        compilations = {status.compilation for status in each}
        return Status(
            max((status.iterations for status in each), default=1),
            np.moveaxis(self._spread((most,), 0.0, residuals), -1, 0),
            self._spread((), True, lambda g: g.each(_solution(g).status.converged, 0)),
            digits=self._spread((), np.inf, left) if measured else None,
            compilation=compilations.pop() if len(compilations) == 1 else "",
            _cause=measured[min(measured)] if measured else FAR_APART,
        )

    @cached_property
    def weights(self) -> Mapping[Any, Array]:
        """By sensor, or factor, (*runs): the weight of its measurement, NaN where there is none."""
        found: dict[Group, dict[Any, Array]] = {}
        kind: Any = dict
        for group, outcome in self._solved:
            if not hasattr(outcome, "weights"):
                raise outcome.refusal("weights")
            kind, found[group] = type(outcome.weights), dict(outcome.weights)
        readings = {v for group in found for v in group.readings.values()}
        keys = [key for each in found.values() for key in each if key not in readings]

        def part(key: Any) -> Callable[[Group], Any]:
            return lambda group: group.each(found[group].get(key, np.nan), 0)

        made = {key: self._spread((), np.nan, part(key)) for key in dict.fromkeys(keys)}
        shown: Mapping[Any, Array] = kind(made)
        return shown

    def entered(self, run: int) -> dict[Variable, Any]:
        """The evidence of a run, by variable: values (d,), NaN where there are gaps, or states."""
        found: dict[Variable, Any] = {}
        at = np.array([run])
        for variable in self._cells.states:
            state = int(self._cells.rows(variable, at)[0])
            found[variable] = variable.states[state] if state >= 0 else None
        return found | {v: self._cells.rows(v, at)[0] for v in self._cells.values}

    def refusal(self, question: str) -> PgmError:
        """The error for what beliefs of several patterns have no answer to."""
        if question in ("message", "belief", "potential"):
            return GraphError(
                f"{question}: the clusters of runs with different gaps are over different "
                "variables; give runs of one pattern of gaps to a call"
            )
        return super().refusal(question)

    @property
    def _title(self) -> str:
        lead = self._cells.lead
        gaps = count(len({id(group.pattern) for group in self._groups}), "pattern")
        return f"Posterior({self.graph._title}{f', runs {lead}' if lead else ''}, {gaps} of gaps)"

    def _summary(self) -> Summary:
        return of_network(self._title, self, self._hidden, self._cells.lead)


# Kinds of log-evidence, the one that says least first.
_LEAST = ("unnormalised", "bethe", "linearised bound", "bound", "linearised", "laplace", "exact")


def _solution(group: Group) -> Outcome[Any]:
    assert group.outcome is not None
    return group.outcome


def _asked(outcome: Outcome[Any], scope: Sequence[Variable]) -> Any:
    """The marginal of one variable, or the joint of several."""
    return outcome[scope[0]] if len(scope) == 1 else outcome.joint(*scope)  # type: ignore[attr-defined]
