"""Conversion of networks from and to pyAgrum, which reads files of Hugin and GeNIe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.cpds import TableCPD
from pgm.errors import ModelError
from pgm.factors import Table
from pgm.io.networks.writers import tables
from pgm.kernels.arrays import Array
from pgm.networks import BayesianNetwork, MarkovNetwork
from pgm.resources import FILES, optional
from pgm.variables import Discrete


@public
def from_pyagrum(network: Any) -> BayesianNetwork | MarkovNetwork:
    """The network that a pyAgrum network declares.

    With pyAgrum's readers that is the way to files of Hugin (NET), GeNIe (DSL, and others by
    saving them as NET there) and O3PRM: ``pgm.from_pyagrum(pyagrum.loadBN("network.net"))``. Of
    GeNIe's XDSL pyAgrum 3.3 turns the order of several parents round.

    Parameters
    ----------
    network : pyagrum.BayesNet or pyagrum.MarkovRandomField
        Its variables may be of any kind. All become `Discrete`, and the states are called by their
        labels: of an integer or range variable the numbers (``"-2"``), of a discretised one the
        intervals (``"[0;1.5["``).

    Returns
    -------
    BayesianNetwork or MarkovNetwork
        Its tables hold the same doubles: of a CPT the parents' axes in pyAgrum's order, the child's
        axis last; of a factor the axes in its own order. A variable of a Markov random field that
        is in no factor gets one of ones.

    Raises
    ------
    ModelError
        If it is another model, such as an influence diagram, or a path; a CPT does not sum to one,
        or has not been filled; a factor is zero throughout, or has negative entries.

    Examples
    --------
    The last two lines need pyAgrum: ``pip install 'sepset[files]'``.

    >>> from pgm.examples import coin
    >>> theirs = pgm.to_pyagrum(coin)  # doctest: +SKIP
    >>> pgm.from_pyagrum(theirs).cpds[0].table  # doctest: +SKIP
    array([0.25, 0.75])
    """
    if hasattr(network, "utility"):
        raise ModelError(
            "an influence diagram of pyAgrum has decisions and utilities, for which a network of "
            "probabilities has no place; give a BayesNet of its chance nodes"
        )
    directed, undirected = hasattr(network, "cpt"), hasattr(network, "addFactor")
    if not directed and not undirected:
        # Some of its values cannot be shown.
        found = f"a value of type {type(network).__name__}"
        if isinstance(network, str | Path):
            found = f"a path; load it, pgm.from_pyagrum(pyagrum.loadBN({str(network)!r}))"
        raise ModelError(f"a BayesNet or a MarkovRandomField of pyAgrum is due; found {found}")
    # Their numbers are in the order of declaration.
    nodes = sorted(network.nodes())
    theirs = [network.variable(node) for node in nodes]
    variables = {each.name(): Discrete(each.name(), each.labels()) for each in theirs}
    if directed:
        return BayesianNetwork(_cpd(network.cpt(node), variables) for node in nodes)
    factors = [_factor(network.factor(scope), variables) for scope in network.factors()]
    told = {variable for factor in factors for variable in factor.scope}
    alone = [Table.vacuous(v) for v in variables.values() if v not in told]
    return MarkovNetwork([*factors, *alone])


def _cpd(table: Any, variables: dict[str, Discrete]) -> TableCPD:
    names = list(table.names)
    if strange := [name for name in names if name not in variables]:
        raise ModelError(
            f"the CPT of {names[0]!r} has the parent {strange[0]!r}, which the pyAgrum network "
            "does not have; give the whole network"
        )
    child, *given = (variables[name] for name in names)
    values = _values(table)
    if not values.any():
        raise ModelError(
            f"the CPT of {child!r} is zero throughout: it has not been filled; fill it, "
            f"cpt({child.name!r}).fillWith([...])",
            variable=child,
        )
    try:
        return TableCPD(child, given, table=np.moveaxis(values, 0, -1))
    except ModelError as error:
        raise ModelError(
            f"{error}; in pyAgrum that is cpt({child.name!r}).normalizeAsCPT()", variable=child
        ) from None


def _factor(table: Any, variables: dict[str, Discrete]) -> Table:
    scope, values = [variables[name] for name in table.names], _values(table)
    if not values.any():
        raise ModelError(
            f"the factor over {list(table.names)} is zero throughout: it has not been filled, or "
            "excludes everything; fill it, factor(...).fillWith([...])",
            variable=scope[0],
        )
    return Table(scope, values)


def _values(table: Any) -> Array:
    """The values of a pyAgrum tensor, with the axes of its variables in the order of its names.

    Arrays of pyAgrum have the axes in reverse. They are taken of a rearranged copy, since those of
    a CPT that is kept as a function, such as a noisy-or, are not filled by all versions.
    """
    filled = table.reorganize(list(table.names)[::-1])
    return np.array(filled.toarray(), dtype=np.float64)


@public
def to_pyagrum(network: BayesianNetwork) -> Any:
    """A network as pyAgrum's own class, with its names, states and doubles.

    Parameters
    ----------
    network : BayesianNetwork
        A static network of discrete variables, of two states or more.

    Returns
    -------
    pyagrum.BayesNet

    Raises
    ------
    ModelError
        If the network is not of tables, or a variable is of a step or of a single state.
    ImportError
        If pyAgrum is not installed.

    Examples
    --------
    The last line needs pyAgrum: ``pip install 'sepset[files]'``.

    >>> from pgm.examples import coin
    >>> pgm.to_pyagrum(coin).cpt("side").toarray()  # doctest: +SKIP
    array([0.25, 0.75])
    """
    cpds = tables(network)
    for cpd in cpds:
        if cpd.child.size == 1:
            raise ModelError(
                f"{cpd.child!r} has the single state {cpd.child.states[0]!r}, and pyAgrum has no "
                "such variables; leave it out",
                variable=cpd.child,
                cpd=cpd,
            )
    pyagrum = optional("pyagrum", "to_pyagrum()", FILES)
    found = pyagrum.BayesNet()
    for cpd in cpds:
        found.add(pyagrum.LabelizedVariable(cpd.child.name, "", list(cpd.child.states)))
    for cpd in cpds:
        for parent in cpd.given:
            found.addArc(parent.name, cpd.child.name)
        own, axes = found.cpt(cpd.child.name), [v.name for v in (*cpd.given, cpd.child)]
        order = [axes.index(name) for name in reversed(own.names)]
        own[:] = np.ascontiguousarray(cpd.table.transpose(order))
    return found
