"""Bayesian networks without time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from itertools import combinations
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_generator, as_mapping
from pgm.cpds import CPD
from pgm.cpds.base import Values
from pgm.display import Drawn, Summary
from pgm.errors import ModelError
from pgm.evidence import Evidence
from pgm.factors.scope import Scope, as_scope, listed, one_name_each, unknown_name
from pgm.immutable import Immutable
from pgm.networks import checks, sampling
from pgm.resources import uncollected
from pgm.variables import Discrete, Variable

if TYPE_CHECKING:
    import networkx as nx

# Up to how many CPDs a network shows by their densities.
FEW = 12


@public
class BayesianNetwork(Drawn, Immutable):
    """A joint density as a product of CPDs, one for each variable.

    Its variables are continuous (Gaussian CPDs, linear or not), `Discrete` (`TableCPD`), or both:
    discrete parents choose among the CPDs of a continuous child by a `SwitchingCPD`.

    Parameters
    ----------
    cpds : iterable of CPD
        In any order, one a child, without cycles. A continuous parent that is no CPD's child is an
        input: it must have evidence. Discrete ones, and those of the step before (``x.previous``),
        are refused.

    Attributes
    ----------
    cpds : tuple of CPD
        Parents before children.
    variables : tuple of Variable
        All variables: the CPDs' children in their order, then the inputs.
    inputs : tuple of Variable
        Parents that no CPD explains.
    discrete, mixed : bool
        Whether all variables are discrete; whether some are discrete and some continuous.

    Examples
    --------
    >>> from pgm import GaussianCPD, LinearGaussianCPD
    >>> a, b = pgm.variables("a b")
    >>> BayesianNetwork([GaussianCPD(a, 0.0, 1.0), LinearGaussianCPD(b, given={a: 2.0}, cov=0.5)])
    BayesianNetwork(p(a)  p(b | a))
    """

    cpds: tuple[CPD, ...]
    variables: Scope
    inputs: Scope
    discrete: bool
    mixed: bool
    _by_child: Mapping[Variable, CPD]

    def __init__(self, cpds: Iterable[CPD]) -> None:
        found = checks.as_cpds(cpds, "a network")
        if not found:
            raise ModelError("a network needs at least one CPD")
        with uncollected(len(found)):
            self._set(**self._checked(found))

    @staticmethod
    def _checked(found: tuple[CPD, ...]) -> dict[str, Any]:
        """The attributes of a network of some CPDs, checked."""
        one_name_each(v for cpd in found for v in cpd.scope)
        checks.one_cpd_each(found)
        kinds = {cpd.discrete for cpd in found}
        checks.runs(found)
        checks.no_step_before(found)
        ordered = checks.in_order(found, lambda cpd: cpd.parents)
        by_child = {cpd.child: cpd for cpd in ordered}
        parents = dict.fromkeys(v for cpd in ordered for v in cpd.parents)
        inputs = tuple(v for v in parents if v not in by_child)
        for cpd in ordered if True in kinds or any(isinstance(v, Discrete) for v in inputs) else ():
            for parent in cpd.parents:
                if parent not in by_child and (cpd.discrete or isinstance(parent, Discrete)):
                    raise ModelError(
                        f"{cpd!r}: its parent {parent!r} has no CPD; add one",
                        variable=parent,
                        cpd=cpd,
                    )
        return {
            "cpds": ordered,
            "variables": (*by_child, *inputs),
            "inputs": inputs,
            "discrete": kinds == {True},
            "mixed": len(kinds) > 1,
            "_by_child": MappingProxyType(by_child),
        }

    # Graphs of the network are made and used by place: numbers are compared sooner than variables.
    @cached_property
    def _places(self) -> dict[Variable, int]:
        return {variable: k for k, variable in enumerate(self.variables)}

    @cached_property
    def _families(self) -> Sequence[tuple[int, ...]]:
        place = self._places.__getitem__
        with uncollected(len(self.cpds)):
            return [tuple(map(place, (cpd.child, *cpd.parents))) for cpd in self.cpds]

    @cached_property
    def lead(self) -> tuple[int, ...]:
        """The axes of runs of the model itself, where a `GaussianCPD` differs by run."""
        return checks.runs(self.cpds)

    def cpd(self, variable: Variable) -> CPD:
        """The CPD of a variable; inputs have none."""
        if not isinstance(variable, Variable) or variable not in self._by_child:
            if variable in self.inputs:
                why = "since it is an input, which no CPD explains"
            else:
                why = unknown_name(variable, self.variables)
            raise ModelError(f"no CPD of {variable!r}, {why}", variable=variable)
        return self._by_child[variable]

    def replace(self, *cpds: CPD) -> BayesianNetwork:
        """A variant with other CPDs, each in place of the one of its child."""
        new = checks.as_cpds(cpds, "replace")
        checks.one_cpd_each(new)
        for cpd in new:
            self.cpd(cpd.child)
        by_child = {**self._by_child, **{cpd.child: cpd for cpd in new}}
        return BayesianNetwork(by_child.values())

    @public
    def sample(
        self,
        n: int | tuple[int, ...] | None = None,
        *,
        inputs: Evidence | None = None,
        rng: np.random.Generator | int,
    ) -> dict[Variable, Values]:
        """Draw all variables from the network, parents before children.

        Parameters
        ----------
        n : int or tuple of int, optional
            Leading axes of independent draws; a single one without such an axis if not given.
        inputs : mapping of Variable to array_like, optional
            Values (..., d) of all inputs; leading axes are runs, which broadcast with those of
            the draws: ``n=(1000, 1)`` draws a thousand for each.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Returns
        -------
        dict
            For each variable with a CPD: (*n, d) values, or (*n,) indices of states of a discrete
            one; both can be given as evidence.

        Examples
        --------
        >>> from pgm.examples import coin, side
        >>> coin.sample(1000, rng=0)[side].mean().round(1)
        np.float64(0.8)
        """
        return sampling.draw(
            self, () if n is None else n, as_mapping(inputs, "inputs"), as_generator(rng)
        )

    def to_networkx(self) -> nx.DiGraph:
        """The network as a graph, for pictures and questions of structure.

        Nodes are variables with the attribute ``kind`` (variable or input); edges go from parents
        to children.
        """
        import networkx as nx  # here, since it is slow to import

        graph = nx.DiGraph()
        graph.add_nodes_from(self._by_child, kind="variable")
        graph.add_nodes_from(self.inputs, kind="input")
        graph.add_edges_from((parent, cpd.child) for cpd in self.cpds for parent in cpd.parents)
        return graph

    @public
    def d_separated(
        self,
        a: Variable | Iterable[Variable],
        b: Variable | Iterable[Variable],
        given: Variable | Iterable[Variable] = (),
    ) -> bool:
        """Whether the graph implies that two sets are independent given a third (d-separation).

        No trail between the two is active: each has an arrow out of a given variable
        (``→ g →``, ``← g →``) or a collision (``→ c ←``) without a given variable at or below it.
        Inputs are variables like others here: they belong into `given` where they have evidence.

        Sets must be disjoint (Koller and Friedman, 2009, section 3.3).

        Examples
        --------
        >>> a, b, c = pgm.variables("a b c")
        >>> net = pgm.BayesianNetwork([
        ...     pgm.GaussianCPD(a, 0.0, 1.0),
        ...     pgm.GaussianCPD(b, 0.0, 1.0),
        ...     pgm.LinearGaussianCPD(c, given={a: 1.0, b: 1.0}, cov=0.1),
        ... ])
        >>> net.d_separated(a, b), net.d_separated(a, b, given=c)
        (True, False)
        """
        members = {"a": a, "b": b, "given": given}
        sets = [
            set(as_scope(found, f"d_separated: {name}", ordered=False))
            for name, found in members.items()
        ]
        for variable in set().union(*sets).difference(self.variables):
            why = unknown_name(variable, self.variables)
            raise ModelError(f"d_separated of {variable!r}, {why}", variable=variable)
        for one, other in combinations(sets, 2):
            for variable in one & other:
                raise ModelError(
                    f"{variable!r} stands in two of the sets a, b and given; they must be disjoint",
                    variable=variable,
                )
        import networkx as nx  # here, since it is slow to import

        # networkx renamed it in 3.3.
        separated = nx.is_d_separator if hasattr(nx, "is_d_separator") else nx.d_separated
        return bool(separated(self.to_networkx(), *sets))

    @property
    def _title(self) -> str:
        if len(self.cpds) <= FEW:
            return f"BayesianNetwork({'  '.join(map(density, self.cpds))})"
        return f"BayesianNetwork({len(self.cpds)} CPDs, {self._kind})"

    @property
    def _kind(self) -> str:
        return "mixed" if self.mixed else "discrete" if self.discrete else "continuous"

    def _summary(self) -> Summary:
        few = len(self.cpds) <= FEW
        return Summary(self._title, [] if few else [factors(self.cpds)])


def factors(cpds: Sequence[CPD]) -> str:
    """The first CPDs as factors of the joint density."""
    more = f"  ... {len(cpds)} in all" if len(cpds) > FEW else ""
    return "  ".join(map(density, cpds[:FEW])) + more


def density(cpd: CPD) -> str:
    """A CPD as a factor of the joint density, like ``p(b | a)``."""
    parents = listed(cpd.parents)
    return f"p({cpd.child!r}{' | ' if parents else ''}{parents})"
