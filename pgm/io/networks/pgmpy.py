"""Conversion of networks from and to pgmpy."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.cpds import TableCPD
from pgm.errors import ModelError
from pgm.io.networks.writers import tables
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.resources import optional
from pgm.variables import Discrete, Variable


@public
def from_pgmpy(network: Any) -> BayesianNetwork | DynamicBayesianNetwork:
    """The network that a pgmpy network declares.

    Parameters
    ----------
    network : pgmpy.models.DiscreteBayesianNetwork or DynamicBayesianNetwork
        With a TabularCPD for each variable. Names of variables and of states that are not text
        become text, by `str`.

    Returns
    -------
    BayesianNetwork or DynamicBayesianNetwork
        Its tables hold the same doubles, the child's axis last. A dynamic network's variables are
        called without their slices: CPDs of slice 0 are the prior, those of slice 1 hold for all
        later steps, and a variable without children whose CPD is the same in both is a sensor.
        If a variable has one CPD, given variables of its own slice, it holds for both slices.

    Raises
    ------
    ModelError
        If it is no such network, a variable has no CPD, or names are equal once they are text.

    Examples
    --------
    The last two lines need pgmpy.

    >>> from pgm.examples import coin
    >>> theirs = pgm.to_pgmpy(coin)  # doctest: +SKIP
    >>> pgm.from_pgmpy(theirs).cpds[0].table  # doctest: +SKIP
    array([0.25, 0.75])
    """
    if hasattr(network, "get_interface_nodes"):
        return _dynamic(network)
    cpds: list[Any] = getattr(network, "get_cpds", list)()
    if not cpds or not all(hasattr(cpd, "state_names") for cpd in cpds):
        raise ModelError(
            f"a DiscreteBayesianNetwork of pgmpy with TabularCPDs is due, not {network!r}"
        )
    variables = {
        cpd.variable: Discrete(str(cpd.variable), map(str, cpd.state_names[cpd.variable]))
        for cpd in cpds
    }
    for node in network.nodes:
        if node not in variables:
            raise ModelError(f"the pgmpy network has no CPD of {node!r}; add it with add_cpds")
    return BayesianNetwork(_converted(cpd, variables) for cpd in cpds)


def _converted(cpd: Any, variables: dict[Any, Discrete]) -> TableCPD:
    child, *given = (variables[name] for name in cpd.variables)
    for variable, name in zip((child, *given), cpd.variables, strict=True):
        if tuple(map(str, cpd.state_names[name])) != variable.states:
            raise ModelError(
                f"the CPD of {child!r} names the states of {variable!r} in another order than the "
                "CPD of that variable; name them in one order",
                variable=variable,
            )
    return TableCPD(child, given, table=np.moveaxis(np.asarray(cpd.values), 0, -1))


# A variable's name, and its slice.
_Node = tuple[Hashable, int]


@dataclass(frozen=True, slots=True)
class _Family:
    """A CPD of a slice of a dynamic network: child, parents, states by node, and table."""

    child: _Node
    given: Sequence[_Node]
    states: Mapping[_Node, tuple[str, ...]]
    table: Array

    def moved(self, step: int) -> "_Family":
        """The same CPD in the other time slice, if its parents stand in its own slice."""
        return _Family(
            (self.child[0], step),
            [(name, step) for name, _ in self.given],
            {(name, step): states for (name, _), states in self.states.items()},
            self.table,
        )

    def alike(self, other: "_Family") -> bool:
        """Whether two CPDs are one, but for their slices."""
        return (
            self.moved(0).given == other.moved(0).given
            and self.moved(0).states == other.moved(0).states
            and np.array_equal(self.table, other.table)
        )


def _dynamic(network: Any) -> DynamicBayesianNetwork:
    """The dynamic network of two slices, which pgmpy tells by names and slices."""
    families = {each.child: each for each in map(_family, network.get_cpds())}
    nodes = dict.fromkeys(map(_node, network.nodes))
    names = list(dict.fromkeys(name for name, _ in nodes))
    later = {_node(child) for parent, child in network.edges if parent[1] != child[1]}
    if odd := [node for node in (*nodes, *families) if node[1] not in (0, 1)]:
        raise ModelError(f"the pgmpy network has {odd[0]!r}; slices 0 and 1 make a dynamic network")
    both = {name: _both(name, families, later) for name in names}
    everything = [each for pair in both.values() for each in pair]
    variables = {name: Discrete(str(name), pair[0].states[name, 0]) for name, pair in both.items()}
    for each in everything:
        for (name, step), states in each.states.items():
            if states != variables[name].states:
                raise ModelError(
                    f"the CPD of {each.child!r} names the states of {(name, step)!r} as "
                    f"{states}, and that of {(name, 0)!r} as {variables[name].states}; name them "
                    "in one order",
                    variable=variables[name],
                )
    parents = {name for each in everything for name, _ in each.given}
    sensors = [
        name
        for name, (first, second) in both.items()
        if name not in parents and first.given and first.alike(second)
    ]

    def cpd(family: _Family) -> TableCPD:
        given: list[Variable] = [
            variables[name].previous if step < family.child[1] else variables[name]
            for name, step in family.given
        ]
        return TableCPD(variables[family.child[0]], given, table=family.table)

    hidden = [pair for name, pair in both.items() if name not in sensors]
    return DynamicBayesianNetwork(
        prior=[cpd(first) for first, _ in hidden],
        transition=[cpd(second) for _, second in hidden],
        observation=[cpd(both[name][0]) for name in sensors],
    )


def _node(node: Any) -> _Node:
    name, step = node
    return name, int(step)


def _family(cpd: Any) -> _Family:
    child, *given = map(_node, cpd.variables)
    named = {_node(node): tuple(map(str, states)) for node, states in cpd.state_names.items()}
    states = {node: named[node] for node in (child, *given)}
    table = np.moveaxis(np.asarray(cpd.values, dtype=float), 0, -1)
    return _Family(child, given, states, table)


def _both(
    name: Hashable, families: Mapping[_Node, _Family], later: set[_Node]
) -> tuple[_Family, _Family]:
    """A variable's CPDs in slices 0 and 1; one alone, of its own slice, is both."""
    found = [families.get((name, step)) for step in (0, 1)]
    for step, other in ((0, 1), (1, 0)):
        one = found[other]
        still = one is not None and all(at == other for _, at in one.given)
        if found[step] is None and one is not None and still and (name, step) not in later:
            found[step] = one.moved(step)
    first, second = found
    if first is None or second is None:
        lost = (name, 0 if first is None else 1)
        raise ModelError(f"the pgmpy network has no CPD of {lost!r}; add it with add_cpds")
    if any(step != 0 for _, step in first.given):
        raise ModelError(f"the CPD of {(name, 0)!r} is given {list(first.given)}, of a later slice")
    return first, second


@public
def to_pgmpy(network: BayesianNetwork) -> Any:
    """A network as pgmpy's own class, with its names, states and doubles.

    Parameters
    ----------
    network : BayesianNetwork
        A static network of discrete variables.

    Raises
    ------
    ModelError
        If the network is not of tables, or a variable is of a step.
    ImportError
        If pgmpy is not installed.

    Examples
    --------
    The last line needs pgmpy.

    >>> from pgm.examples import coin
    >>> pgm.to_pgmpy(coin).get_cpds("side").values  # doctest: +SKIP
    array([0.25, 0.75])
    """
    cpds = tables(network)
    factors, models = (
        optional(f"pgmpy.{module}", "to_pgmpy()", "pgmpy>=1.0")
        for module in ("factors.discrete", "models")
    )
    found = models.DiscreteBayesianNetwork()
    found.add_nodes_from(cpd.child.name for cpd in cpds)
    found.add_edges_from((v.name, cpd.child.name) for cpd in cpds for v in cpd.given)
    for cpd in cpds:
        found.add_cpds(
            factors.TabularCPD(
                cpd.child.name,
                cpd.child.size,
                cpd.table.reshape(-1, cpd.child.size).T,
                evidence=[v.name for v in cpd.given] or None,
                evidence_card=[v.size for v in cpd.given] or None,
                state_names={v.name: list(v.states) for v in cpd.scope if isinstance(v, Discrete)},
            )
        )
    return found
