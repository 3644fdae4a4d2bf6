"""Networks of factors, whose product is a joint density but for a constant."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_tuple
from pgm.cpds import CPD, CausalIndependence, ConditionalGaussian, NonlinearGaussianFactor, TableCPD
from pgm.cpds.caused import components
from pgm.display import Drawn, Summary, titled
from pgm.errors import ModelError
from pgm.factors import CanonicalForm, Table
from pgm.factors.scope import Scope, as_scope, listed, one_name_each, unknown_name
from pgm.immutable import Immutable
from pgm.networks import checks
from pgm.resources import uncollected
from pgm.variables import Discrete, Variable

if TYPE_CHECKING:
    import networkx as nx

# A factor of a network: a table, a canonical form, a residual's, or a CPD.
Factor = Table | CanonicalForm | NonlinearGaussianFactor | CPD
# Up to how many factors a network shows one by one.
FEW = 12


@public
class MarkovNetwork(Drawn, Immutable):
    r"""A joint density as a product of factors, but for a constant.

    .. math:: p(x) = \frac{1}{Z} \prod_k \phi_k(x_k), \qquad Z = \sum_x \prod_k \phi_k(x_k)

    Factors have no direction and need not sum to anything: pairwise potentials, constraints,
    evidence as a table. A CPD is a factor too, and a `BayesianNetwork`, whose factors are CPDs with
    Z = 1, is a Markov network. The log-evidence of a result is ln Z, and with evidence e the
    logarithm of the sum over all x that agree with e.

    Parameters
    ----------
    factors : iterable of factors
        In any order, of discrete variables `Table` and CPDs of tables; of continuous ones
        `CanonicalForm`, `NonlinearGaussianFactor`, Gaussian CPDs and `MixtureCPD`s of these; of
        both `SwitchingCPD`, whose cases discrete variables choose. Several may be over the same
        variables; a table over none is a number. Variables are those of the factors: one that no
        other factor has stands in a `Table.vacuous`. Factors may leave directions open, as long as
        all together leave none, in each state of the discrete variables that is possible: of a
        `CanonicalForm` those of an eigenvalue within 8 n roundings of zero, in units in which its n
        diagonal entries are one.

    Attributes
    ----------
    factors : tuple
    variables : tuple of Variable
        All variables, as they come first in the factors.
    discrete, mixed : bool
        Whether all are discrete; whether some are discrete and some continuous.

    Raises
    ------
    ModelError
        If a factor is none, has axes of runs, is a CPD of other densities, or there is no variable.

    References
    ----------
    Koller & Friedman, Probabilistic Graphical Models, 2009, chapter 4. Lauritzen & Wermuth,
    Graphical models for associations between variables, some of which are qualitative and some
    quantitative, 1989.

    Examples
    --------
    >>> a, b, c = (pgm.Discrete(name, states=("-", "+")) for name in "abc")
    >>> alike = [[2.0, 1.0], [1.0, 2.0]]
    >>> net = pgm.MarkovNetwork([pgm.Table((a, b), alike), pgm.Table((b, c), alike)])
    >>> net
    MarkovNetwork(φ(a, b)  φ(b, c))
    >>> posterior = pgm.infer(pgm.compile(net), {a: "+"})
    >>> posterior[c], posterior.log_evidence.round(6)
    (Table(c: - 0.444, + 0.556), np.float64(2.197225))
    """

    factors: tuple[Factor, ...]
    variables: Scope
    inputs: Scope = ()
    discrete: bool
    mixed: bool

    def __init__(self, factors: Iterable[Factor]) -> None:
        single = isinstance(factors, Factor)
        found = (factors,) if single else as_tuple(factors)
        if found is None:
            raise ModelError(f"a Markov network is a sequence of factors, not {titled(factors)}")
        for factor in found:
            _require_factor(factor)
        cpds = [factor for factor in found if isinstance(factor, CPD)]
        checks.no_steps(cpds, "a network without time has no steps")
        one_name_each(v for factor in found for v in factor.scope)
        variables = tuple(dict.fromkeys(v for factor in found for v in factor.scope))
        if not variables:
            raise ModelError("a Markov network needs a factor over at least one variable")
        for variable in variables:
            if variable.lag:
                raise ModelError(
                    f"{variable!r} is of a step before, which a network without time does not "
                    f"have; name the steps, {variable.name}.at(0)",
                    variable=variable,
                )
        kinds = {isinstance(variable, Discrete) for variable in variables}
        discrete = True in kinds
        found = tuple(factor if factor.scope else _number(factor, discrete) for factor in found)
        both = len(kinds) > 1
        self._set(factors=found, variables=variables, discrete=discrete and not both, mixed=both)

    @cached_property
    def _factorised(self) -> MarkovNetwork:
        """The network that graphs and queries work on: CPDs of independent causes in their factors.

        It is this one where there are none. Its variables are those of this one, in this order, and
        intermediate ones among them.
        """
        return self._in_factors()

    def _in_factors(self, whole: Collection[Factor] = ()) -> MarkovNetwork:
        """The network with its CPDs of independent causes in their factors, but for some."""
        found = list[Factor]()
        taken: set[str] | None = None
        for factor in self.factors:
            if isinstance(factor, CausalIndependence) and factor not in whole:
                taken = {v.name for v in self.variables} if taken is None else taken
                found += factor._factors(taken)
            else:
                found.append(factor)
        return self if len(found) == len(self.factors) else self._of(found)

    def _of(self, factors: Iterable[Factor]) -> MarkovNetwork:
        """A network of this kind, of other factors."""
        return MarkovNetwork(factors)

    # Graphs of the network are made and used by place: numbers are compared sooner than variables.
    @cached_property
    def _places(self) -> dict[Variable, int]:
        return {variable: k for k, variable in enumerate(self.variables)}

    @cached_property
    def _families(self) -> Sequence[tuple[int, ...]]:
        place = self._places.__getitem__
        with uncollected(len(self.factors)):
            return [tuple(map(place, factor.scope)) for factor in self.factors]

    @cached_property
    def lead(self) -> tuple[int, ...]:
        """The axes of runs of the model itself, where a `GaussianCPD` differs by run."""
        return checks.runs(self.cpds)

    @property
    def cpds(self) -> tuple[CPD, ...]:
        """The factors that are CPDs."""
        return tuple(factor for factor in self.factors if isinstance(factor, CPD))

    def to_networkx(self) -> nx.Graph:
        """The network as a graph, for pictures and questions of structure.

        Nodes are variables, and edges join those that a factor has in common.
        """
        import networkx as nx  # here, since it is slow to import

        graph = nx.Graph()
        graph.add_nodes_from(self.variables, kind="variable")
        for factor in self.factors:
            graph.add_edges_from(combinations(factor.scope, 2))
        return graph

    @public
    def separated(
        self,
        a: Variable | Iterable[Variable],
        b: Variable | Iterable[Variable],
        given: Variable | Iterable[Variable] = (),
    ) -> bool:
        """Whether the graph implies that two sets are independent given a third.

        Of a Markov network: whether each path between the two goes through a variable that is
        given. Of a `BayesianNetwork`: whether they are d-separated, no trail between the two being
        active: each has an arrow out of a given variable (``→ g →``, ``← g →``) or a collision
        (``→ c ←``) without a given variable at or below it. Inputs are variables like others here:
        they belong into `given` where they have evidence.

        Sets must be disjoint (Koller and Friedman, 2009, sections 3.3 and 4.3).

        Examples
        --------
        >>> a, b, c = pgm.variables("a b c")
        >>> net = pgm.BayesianNetwork([
        ...     pgm.GaussianCPD(a, 0.0, 1.0),
        ...     pgm.GaussianCPD(b, 0.0, 1.0),
        ...     pgm.LinearGaussianCPD(c, given={a: 1.0, b: 1.0}, cov=0.1),
        ... ])
        >>> net.separated(a, b), net.separated(a, b, given=c)
        (True, False)
        """
        members = {"a": a, "b": b, "given": given}
        sets = [
            set(as_scope(found, f"separated: {name}", ordered=False))
            for name, found in members.items()
        ]
        for variable in set().union(*sets).difference(self.variables):
            why = unknown_name(variable, self.variables)
            raise ModelError(f"separated: {variable!r}, {why}", variable=variable)
        for one, other in combinations(sets, 2):
            for variable in one & other:
                raise ModelError(
                    f"{variable!r} stands in two of the sets a, b and given; they must be disjoint",
                    variable=variable,
                )
        return self._is_separated(*sets)

    def _is_separated(self, a: set[Variable], b: set[Variable], given: set[Variable]) -> bool:
        import networkx as nx  # here, since it is slow to import

        graph = self.to_networkx()
        graph.remove_nodes_from(given)
        return not any(b & part for part in nx.connected_components(graph) if a & part)

    @property
    def _title(self) -> str:
        name = type(self).__name__
        if len(self.factors) <= FEW:
            return f"{name}({'  '.join(map(written, self.factors))})"
        what = "CPDs" if len(self.cpds) == len(self.factors) else "factors"
        return f"{name}({len(self.factors)} {what}, {self._kind})"

    @property
    def _kind(self) -> str:
        return "mixed" if self.mixed else "discrete" if self.discrete else "continuous"

    def _summary(self) -> Summary:
        few = len(self.factors) <= FEW
        return Summary(self._title, [] if few else [product(self.factors)])


def _require_factor(factor: Any) -> None:
    if not isinstance(factor, Factor):
        raise ModelError(
            "a Markov network holds factors: tables, canonical forms, NonlinearGaussianFactors or "
            f"CPDs, not {titled(factor)}"
        )
    lead = {Table: "log_scale", CanonicalForm: "g"}.get(type(factor))
    if lead is not None and (shape := np.shape(getattr(factor, lead))):
        raise ModelError(
            f"{titled(factor)} is a stack of factors, with the axes of runs {shape}; a factor is "
            "one, and evidence has the runs"
        )
    if isinstance(factor, TableCPD) and factor.function is not None:
        raise ModelError(
            f"{factor!r}: its table is a function of inputs, which dynamic networks alone take",
            variable=factor.child,
            cpd=factor,
        )
    if isinstance(factor, CPD) and not isinstance(factor, TableCPD):
        for own in components(factor):
            if not isinstance(own, ConditionalGaussian):
                raise ModelError(
                    f"{own!r}: the CPDs of a Markov network are tables, or Gaussian, or such that "
                    "a SwitchingCPD or a MixtureCPD has; others stand in a dynamic network",
                    variable=factor.child,
                    cpd=factor,
                )


def _number(factor: Factor, discrete: bool) -> Factor:
    """A factor over nothing: a table where there are tables, else a form."""
    if discrete and isinstance(factor, CanonicalForm):
        return Table((), 1.0, factor.g)
    if discrete or not isinstance(factor, Table):
        return factor
    level = float(factor.log_values)
    if level == -np.inf:
        raise ModelError("a factor over no variable is zero, and so is the product of all factors")
    return CanonicalForm((), np.zeros((0, 0)), np.zeros(0), level)


def product(factors: Sequence[Factor]) -> str:
    """The first factors of the joint density."""
    more = f"  ... {len(factors)} in all" if len(factors) > FEW else ""
    return "  ".join(map(written, factors[:FEW])) + more


def written(factor: Factor) -> str:
    """A factor of the joint density, like ``p(b | a)`` of a CPD, or ``φ(a, b)``."""
    if not isinstance(factor, CPD):
        return f"φ({listed(factor.scope)})"
    parents = listed(factor.parents)
    return f"p({factor.child!r}{' | ' if parents else ''}{parents})"
