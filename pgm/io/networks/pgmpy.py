"""Networks from and to those of pgmpy."""

from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.cpds import TableCPD
from pgm.errors import ModelError
from pgm.io.networks.writers import tables
from pgm.networks import BayesianNetwork
from pgm.resources import optional
from pgm.variables import Discrete


@public
def from_pgmpy(network: Any) -> BayesianNetwork:
    """The network that a pgmpy network declares.

    Parameters
    ----------
    network : pgmpy.models.DiscreteBayesianNetwork
        With a TabularCPD for each variable. Names of variables and of states that are not text
        become text, by `str`.

    Returns
    -------
    BayesianNetwork
        Its tables hold the same doubles, the child's axis last.

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


@public
def to_pgmpy(network: BayesianNetwork) -> Any:
    """A network as pgmpy's own class, with its names, states and doubles.

    Parameters
    ----------
    network : BayesianNetwork
        Of discrete variables without steps.

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
