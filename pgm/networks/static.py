"""Bayesian networks without time."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_generator, as_mapping
from pgm.cpds import CPD, GaussianCPD, TableCPD
from pgm.cpds.base import Values
from pgm.errors import ModelError
from pgm.evidence import Evidence
from pgm.factors.scope import Scope, one_name_each, unknown_name
from pgm.networks import checks, sampling
from pgm.networks.markov import MarkovNetwork
from pgm.resources import uncollected
from pgm.variables import Discrete, Variable

if TYPE_CHECKING:
    import networkx as nx


@public
class BayesianNetwork(MarkovNetwork):
    """A joint density as a product of CPDs, one for each variable.

    It is a `MarkovNetwork` whose factors are CPDs, with Z = 1.

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

    _cpds: tuple[CPD, ...]
    _by_child: Mapping[Variable, CPD]

    def __init__(self, cpds: Iterable[CPD]) -> None:
        found = checks.as_cpds(cpds, "a network")
        if not found:
            raise ModelError("a network needs at least one CPD")
        with uncollected(len(found)):
            self._set(**self._attributes(self._checked(found)))

    @classmethod
    def _made(cls, ordered: Iterable[CPD]) -> Self:
        """The network of CPDs that fit, parents before children, which are not checked."""
        found = object.__new__(cls)
        found._set(**cls._attributes(tuple(ordered)))
        return found

    @staticmethod
    def _checked(found: tuple[CPD, ...]) -> tuple[CPD, ...]:
        """The CPDs of a network, parents before children, checked."""
        one_name_each(v for cpd in found for v in cpd.scope)
        checks.one_cpd_each(found)
        kinds = {cpd.discrete for cpd in found}
        checks.runs(found)
        checks.no_step_before(found)
        ordered = checks.in_order(found, lambda cpd: cpd.parents)
        by_child = {cpd.child: cpd for cpd in ordered}
        inputs = _inputs(ordered, by_child)
        for cpd in ordered if True in kinds or any(isinstance(v, Discrete) for v in inputs) else ():
            for parent in cpd.parents:
                if parent not in by_child and (cpd.discrete or isinstance(parent, Discrete)):
                    raise ModelError(
                        f"{cpd!r}: its parent {parent!r} has no CPD; add one",
                        variable=parent,
                        cpd=cpd,
                    )
        return ordered

    @staticmethod
    def _attributes(ordered: tuple[CPD, ...]) -> dict[str, Any]:
        by_child = {cpd.child: cpd for cpd in ordered}
        inputs, kinds = _inputs(ordered, by_child), {cpd.discrete for cpd in ordered}
        return {
            "factors": ordered,
            "_cpds": ordered,
            "variables": (*by_child, *inputs),
            "inputs": inputs,
            "discrete": kinds == {True},
            "mixed": len(kinds) > 1,
            "_by_child": MappingProxyType(by_child),
        }

    @property
    def cpds(self) -> tuple[CPD, ...]:
        """The CPDs, parents before children."""
        return self._cpds

    def _of(self, factors: Iterable[Any]) -> BayesianNetwork:
        return BayesianNetwork(factors)

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
    def do(self, values: Mapping[Variable, Any]) -> BayesianNetwork:
        r"""The network after an intervention: some variables are set, whatever their parents.

        .. math:: p(x \mid \text{do}(y)) = \prod_{k \notin y} p(x_k \mid \text{parents of } x_k)

        Here y are the variables set, and parents among them have their values. A CPD of a variable
        set has no parents, and one value: the network is *mutilated*. Other than evidence, what is
        set says nothing of its former parents.

        Parameters
        ----------
        values : mapping of Variable
            The name or index of a state; of a continuous variable its value, (d,), or (runs, d).

        Raises
        ------
        ModelError
            If a variable has no CPD here, or cannot have that value.

        References
        ----------
        Pearl, Causality, 2009, section 3.2.

        Examples
        --------
        >>> from pgm.examples import rain, rainy, wet
        >>> pgm.query(rainy, rain, {wet: "yes"})
        Table(rain: no 0.25, yes 0.75)
        >>> pgm.query(rainy.do({wet: "yes"}), rain)
        Table(rain: no 0.5, yes 0.5)
        """
        given = as_mapping(values, "do", ModelError)
        return self.replace(*(_set(self.cpd(v), value) for v, value in given.items()))

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

    def _is_separated(self, a: set[Variable], b: set[Variable], given: set[Variable]) -> bool:
        import networkx as nx  # here, since it is slow to import

        # networkx renamed it in 3.3.
        separated = nx.is_d_separator if hasattr(nx, "is_d_separator") else nx.d_separated
        return bool(separated(self.to_networkx(), a, b, given))


def _inputs(cpds: Iterable[CPD], explained: Collection[Variable]) -> Scope:
    """The parents that no CPD explains, as they come first."""
    parents = dict.fromkeys(v for cpd in cpds for v in cpd.parents)
    return tuple(v for v in parents if v not in explained)


def _set(cpd: CPD, value: Any) -> CPD:
    """The CPD of a variable that is set to a value."""
    child = cpd.child
    if isinstance(child, Discrete):
        return TableCPD(child, table=np.eye(child.size)[child.index(value)])
    return GaussianCPD(child, mean=value, cov=np.zeros((child.dimension, child.dimension)))
