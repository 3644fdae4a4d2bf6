"""The common part of the writers of networks."""

from __future__ import annotations

from pgm.cpds import TableCPD
from pgm.errors import ModelError
from pgm.networks import BayesianNetwork


def tables(network: BayesianNetwork) -> list[TableCPD]:
    """The CPDs of a network of tables; refuses any other network, and variables at steps."""
    if not isinstance(network, BayesianNetwork):
        raise ModelError(f"what is written is a BayesianNetwork, not {type(network).__name__}")
    found = [cpd for cpd in network.cpds if isinstance(cpd, TableCPD)]
    if len(found) < len(network.cpds):
        odd = next(cpd for cpd in network.cpds if not isinstance(cpd, TableCPD))
        raise ModelError(f"{odd!r}: these files hold tables of discrete variables alone", cpd=odd)
    for cpd in found:
        if cpd.child.step is not None:
            raise ModelError(
                f"{cpd.child!r} is of a step, for which these files have no place; write a network "
                f"with a variable of another name, like '{cpd.child.name}_{cpd.child.step}'",
                variable=cpd.child,
                cpd=cpd,
            )
    return found


def rows(cpd: TableCPD) -> list[list[float]]:
    """The rows of a table, the last parent's state moving fastest."""
    found: list[list[float]] = cpd.table.reshape(-1, cpd.child.size).tolist()
    return found
