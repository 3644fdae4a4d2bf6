"""A network's tables, and its continuous factors as CPDs whose discrete parents choose them.

A Bayesian network has CPDs. Of a Markov network the continuous factors are CPDs and measurements of
flat priors, as of a Gaussian one (`pgm.beliefs.gaussian.undirected`); one that discrete variables
choose is a measurement that they choose. A mixture is a CPD that a variable of its own chooses, its
cause.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from pgm.beliefs.gaussian.undirected import flat_level, measured
from pgm.clustergraph import ClusterGraph
from pgm.compile.methods import JunctionTree
from pgm.cpds import CPD
from pgm.cpds.caused import caused, components, in_scales, is_mixture
from pgm.display import Shown
from pgm.factors import Table
from pgm.factors.scope import Scope
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork, MarkovNetwork
from pgm.networks.markov import Factor
from pgm.schedules.argument_checks import require_gaussian
from pgm.variables import Discrete, Variable


@dataclass(frozen=True, eq=False)
class Split:
    """The factors of a mixed network by kind.

    Attributes
    ----------
    variables : tuple of Variable
        Those of the network, and causes before what they choose.
    tables : sequence of factors
        Those over discrete variables; each of these has one.
    continuous : sequence of CPD
        Parents first.
    needed : tuple of Variable
        Those that must have evidence.
    values : mapping of Variable to ndarray
        Of the observed residuals of a Markov network's factors, (d,).
    flat : frozenset of Variable
        Those of a Markov network that no CPD is left for.
    level : float
        The logarithm of the product of all factors, less that of tables, CPDs and the levels of
        flat priors.
    lost : float
        See `pgm.beliefs.gaussian.undirected.Measured`.
    """

    variables: Scope
    tables: Sequence[Factor]
    continuous: Sequence[CPD]
    needed: Scope
    values: Mapping[Variable, Array] = field(default_factory=dict)
    flat: frozenset[Variable] = frozenset()
    level: float = 0.0
    lost: float = 0.0

    @cached_property
    def graph(self) -> ClusterGraph:
        """The graph of the tables alone."""
        return JunctionTree()(MarkovNetwork(self.tables))

    def inside(self, observed: Collection[Variable]) -> tuple[Sequence[CPD], float]:
        """The continuous CPDs, and the level, where the `observed` variables are known whole.

        The flat prior of a variable that is known is the number that its level takes away.
        """
        known = self.flat.intersection(observed)
        level = self.level + flat_level(self.flat - known)
        return [cpd for cpd in self.continuous if cpd.child not in known], level

    def in_scales(self, robust: Collection[CPD]) -> Split:
        """The same, some CPDs' robust noise being a mixture of several scales."""
        why = "by whose densities states of discrete variables are weighed"
        cpds = [
            _of(in_scales(cpd, why), cpd._of) if cpd in robust else cpd for cpd in self.continuous
        ]
        return replace(self, continuous=cpds)._with_causes()

    def _with_causes(self) -> Split:
        """The same, mixtures being chosen by causes, which are tables."""
        names = {v.name for v in (*self.variables, *(cpd.child for cpd in self.continuous))}
        variables, tables, cpds = list(self.variables), list(self.tables), list[CPD]()
        for cpd in self.continuous:
            if not is_mixture(cpd):
                cpds.append(cpd)
                continue
            table, chosen = caused(cpd, names)
            at = variables.index(cpd.child) if cpd.child in variables else len(variables)
            variables.insert(at, table.child)
            tables.append(table)
            cpds.append(_of(chosen, cpd._of))
        if len(tables) == len(self.tables):
            return self
        return replace(self, variables=tuple(variables), tables=tables, continuous=cpds)


def split_of(graph: ClusterGraph) -> Split:
    """The factors of a graph's network by kind."""
    network = graph.network
    for cpd in network.cpds:
        if not cpd.discrete:
            require_gaussian(components(cpd), "the Gaussian beliefs of a mixed network")
    found = _directed(network) if isinstance(network, BayesianNetwork) else _undirected(network)
    return found._with_causes()


def _directed(network: BayesianNetwork) -> Split:
    continuous = [cpd for cpd in network.cpds if not cpd.discrete]
    tables = [cpd for cpd in network.cpds if cpd.discrete]
    needed = tuple(dict.fromkeys([*network.inputs, *_known(continuous)]))
    return Split(network.variables, tables, continuous, needed)


def _undirected(network: MarkovNetwork) -> Split:
    tables: list[Factor] = []
    others: list[Factor] = []
    for factor in network.factors:
        of_table = factor.discrete if isinstance(factor, CPD) else isinstance(factor, Table)
        (tables if of_table else others).append(factor)
    discrete = [v for v in network.variables if isinstance(v, Discrete)]
    continuous = [v for v in network.variables if not isinstance(v, Discrete)]
    tabled = {v for factor in tables for v in factor.scope}
    tables += [Table.vacuous(v) for v in discrete if v not in tabled]  # those that choose alone
    made = measured(others, continuous, {v.name for v in discrete})
    return Split(
        network.variables,
        tables,
        made.cpds,
        tuple(dict.fromkeys(_known(made.cpds))),
        made.values,
        frozenset(made.flat),
        float(made.levels.sum()),
        made.lost,
    )


def _known(cpds: Sequence[CPD]) -> Scope:
    """The variables on which noise depends."""
    return tuple(v for cpd in cpds for v in cpd.noise_given)


def _of(cpd: CPD, factor: Shown | None) -> CPD:
    """A CPD that stands for a factor's residual, whose name messages have; for none as it is."""
    if factor is not None:
        for each in (cpd, *components(cpd)):
            each.__dict__["_of"] = factor
    return cpd
