"""Results of inference in a mixed network: tables, and mixtures of Gaussians."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from pgm.beliefs.discrete.outcome import DiscreteOutcome
from pgm.beliefs.gaussian.outcome import GaussianOutcome
from pgm.beliefs.gaussian.undirected import BEYOND, NEARLY_FLAT
from pgm.beliefs.mixed.configurations import FEW
from pgm.beliefs.mixed.draws import draws
from pgm.beliefs.mixed.weighing import Weighed
from pgm.clustergraph import ClusterGraph
from pgm.display import Summary
from pgm.errors import EvidenceError, GraphError, NumericalError
from pgm.factors import Gaussian, GaussianMixture, Table
from pgm.factors.scope import Scope, as_scope, dimension, namesake, positions
from pgm.kernels.arrays import Array, Integers, Mask, frozen
from pgm.posteriors.outcome import MIXTURES, Outcome
from pgm.posteriors.posterior import require_variable
from pgm.posteriors.status import ENOUGH_DIGITS, FAR_APART, Status
from pgm.posteriors.summaries import of_network
from pgm.resources import require_memory
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False, repr=False)
class MixedOutcome(Outcome[Any]):
    """The beliefs of a network of discrete and continuous variables; leading axes are runs.

    ``posterior[v]`` is a `Table` of a discrete variable, and a `GaussianMixture` of a continuous
    one, with a Gaussian for each configuration of the discrete variables that it depends on.
    """

    beliefs: ClassVar[str] = "mixtures of a mixed network"
    form: ClassVar[str] = MIXTURES

    kind: ClassVar[None] = None
    graph: ClusterGraph
    _variables: Scope
    _tables: DiscreteOutcome
    _parts: Sequence[Weighed]
    _choices: Sequence[Discrete | None]
    _observed: Collection[Variable]
    _lead: tuple[int, ...]
    _total: Array
    _lost: float

    def __getitem__(self, variable: Variable) -> Table | GaussianMixture:
        """The marginal of a variable without evidence."""
        if isinstance(self._require_hidden(variable), Discrete):
            return self._tables[variable]
        return self._mixture((variable,))

    def joint(self, *variables: Variable) -> Table | GaussianMixture:
        """The joint of discrete variables, or of continuous ones, in the order given."""
        scope = as_scope(variables)
        if not scope:
            raise EvidenceError("joint takes one or more variables")
        kinds = {isinstance(self._require_hidden(v), Discrete) for v in scope}
        if len(kinds) > 1:
            raise EvidenceError(
                f"a joint of discrete and continuous variables, {list(scope)}, is neither a table "
                "nor a mixture; ask for each kind by itself, or give the discrete ones evidence"
            )
        return self._tables.joint(*scope) if kinds.pop() else self._mixture(scope)

    def sample(self, count: int, rng: np.random.Generator) -> dict[Variable, Any]:
        """So many draws for each run: (count, *runs, d), or (count, *runs) of state indices."""
        shape = count, *self._lead
        return {
            v: values.reshape((*shape, *values.shape[2:]))
            for v, values in draws(self, count, rng).items()
        }

    @property
    def _runs(self) -> int:
        return math.prod(self._lead)

    def _require_hidden(self, variable: Variable) -> Variable:
        if require_variable(variable) not in self._variables:
            raise EvidenceError(
                f"{variable!r} is not in the network; its variables are {list(self._variables)}"
                f"{namesake(variable, self._variables)}",
                variable=variable,
            )
        known = self._observed
        if not isinstance(variable, Discrete) and variable not in (*self._homes, *known):
            raise GraphError(
                f"{variable!r} was left out, since nothing known depends on it, and it joins so "
                f"many discrete variables that its belief would be over more than {FEW:,} "
                "configurations; give some of them evidence",
                variable=variable,
            )
        if variable in known:
            raise EvidenceError(
                f"{variable!r} is observed: its value is its evidence; for a belief about it give "
                "it no evidence",
                variable=variable,
            )
        return variable

    @cached_property
    def _homes(self) -> dict[Variable, int]:
        """The part that has each hidden continuous variable."""
        return {v: k for k, each in enumerate(self._parts) for v in each.part.hidden}

    def _mixture(self, scope: Scope) -> GaussianMixture:
        """The joint of continuous variables: Gaussians by the configurations of their parts."""
        homes = tuple(dict.fromkeys(self._homes[v] for v in scope))
        size, runs = dimension(scope), math.prod(self._lead)
        counts = [len(self._parts[k].configurations) for k in homes]
        require_memory(
            math.prod(counts) * runs * size * (size + 1),
            f"the joint of {list(scope)}, of {math.prod(counts):,} Gaussians",
            "ask for fewer variables at a time",
            error=GraphError,
        )
        weights = self._weights(homes).reshape(runs, *counts)
        mean = np.zeros((runs, *counts, size))
        cov = np.zeros((runs, *counts, size, size))
        for axis, home in enumerate(homes):
            own = tuple(v for v in scope if self._homes[v] == home)
            places = np.arange(size)[positions(scope, own)]
            shape = [1] * len(counts)
            shape[axis] = counts[axis]
            means, covs = (part.swapaxes(0, 1) for part in self._parts[home].moments(own))
            mean[..., places] = means.reshape(runs, *shape, -1)
            block = covs.reshape(runs, *shape, len(places), len(places))
            cov[..., places[:, None], places] = block
        weights = weights.reshape(runs, -1)
        some = (weights > 0.0).any(axis=0)
        weights = weights[:, some]
        found = Gaussian._make(
            scope,
            mean.reshape(runs, -1, size)[:, some].reshape(*self._lead, -1, size),
            cov.reshape(runs, -1, size, size)[:, some].reshape(*self._lead, -1, size, size),
        )
        return GaussianMixture._make(weights.reshape(*self._lead, -1), found)

    def _weights(self, homes: Sequence[int]) -> Array:
        """The probabilities of the configurations of some parts together, (runs, ...)."""
        choices = [choice for k in homes if (choice := self._choices[k]) is not None]
        runs = math.prod(self._lead)
        if not choices:
            return np.ones((runs, 1))
        count = math.prod(v.size for v in choices)
        found = self._tables.joint(*choices).probabilities.reshape(-1, count)
        return np.broadcast_to(found, (runs, count))

    @property
    def _hidden(self) -> Scope:
        tables = frozenset(self._tables._hidden)
        return tuple(v for v in self._variables if v in self._homes or v in tables)

    @property
    def log_evidence(self) -> Array:
        """The value ln p(evidence), (...), in nats; of a Markov network ln Z.

        Where a configuration makes evidence certain it is that of those which make the most
        certain, as a density of the rest.
        """
        if not np.isfinite(self._total).all():
            raise NumericalError(BEYOND)
        return frozen(self._total.reshape(self._lead))

    @property
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`: that of the Gaussian beliefs in all configurations."""
        kinds = {
            belief.log_evidence_kind for each in self._parts for *_, belief in each.beliefs
        } - {"exact"}
        if not kinds:
            return "exact"
        return kinds.pop() if len(kinds) == 1 else "linearised"

    @cached_property
    def status(self) -> Status:
        """How linearisations went: for each run the worst of configurations of a probability."""
        every: list[tuple[Mask, Integers, Integers, GaussianOutcome]] = []
        for k, each in enumerate(self._parts):
            if each.beliefs:
                possible = self._weights([k]).T > 0.0
                every += [
                    (possible[which][:, own], which, own, b) for which, own, b in each.beliefs
                ]
        runs = math.prod(self._lead)
        most = max((belief.status.iterations for *_, belief in every), default=1)
        converged, digits = np.ones(runs, dtype=bool), np.full(runs, np.inf)
        residuals = np.zeros((most - 1, runs))
        cause = FAR_APART
        for counts, which, own, belief in every:
            status, shape = belief.status, (which.size, own.size)
            went = _by_run(np.ravel(status.converged), shape)
            converged[own] &= (went | ~counts).all(axis=0)
            if status.digits is not None:
                left = _by_run(np.ravel(status.digits), shape)
                left = np.where(counts, left, np.inf).min(axis=0)
                cause = status._cause if (left < digits[own]).any() else cause
                digits[own] = np.minimum(digits[own], left)
            if count := len(status.residuals):
                moves = _by_run(status.residuals.reshape(count, -1), shape)
                worst = np.where(counts, moves, 0.0).max(axis=1)
                residuals[:count, own] = np.maximum(residuals[:count, own], worst)
        told = digits.reshape(self._lead) if np.isfinite(digits).any() else None
        record = residuals.reshape(most - 1, *self._lead)
        status = Status(most, record, converged.reshape(self._lead), digits=told, _cause=cause)
        if self._lost > 10.0**-ENOUGH_DIGITS:
            status = status._losing(np.full(runs, self._lost), NEARLY_FLAT)
        return status

    @property
    def _title(self) -> str:
        runs = f", runs {self._lead}" if self._lead else ""
        return f"Posterior({self.graph._title}{runs})"

    def _summary(self) -> Summary:
        return of_network(self._title, self, self._hidden, self._lead)


def _by_run(values: Any, shape: tuple[int, int]) -> Any:
    """Values (..., configurations · runs or 1) as (..., configurations, runs)."""
    whole = np.broadcast_to(values, (*values.shape[:-1], math.prod(shape)))
    return whole.reshape(*values.shape[:-1], *shape)
