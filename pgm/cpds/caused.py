"""A mixture of CPDs as a CPD that a hidden discrete variable chooses: its *cause*."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pgm.cpds.base import CPD
from pgm.cpds.mixture import MixtureCPD
from pgm.cpds.switching import SwitchingCPD
from pgm.cpds.table import TableCPD
from pgm.variables import Discrete, Variable


def caused(
    cpd: MixtureCPD, names: set[str], child: Variable | None = None
) -> tuple[TableCPD, SwitchingCPD]:
    """The table of a mixture's cause, which component a value is of, and the CPD that it chooses.

    The cause has the mixture's weights, whatever else is so; mixtures of mixtures are one mixture.
    `names` are those that are taken, to which the cause's is added. With a `child` the CPD is of
    this in place of the mixture's own.
    """
    own = child or cpd.child
    parts = list(_flat(cpd))
    states = tuple(str(k) for k in range(len(parts)))
    cause = Discrete(unused(f"component of {own.name}", names), states=states)

    def moved(variable: Variable) -> Variable:
        return own if variable == cpd.child else variable

    cases = {k: part._copy(moved) for k, (part, _) in enumerate(parts)}
    table = TableCPD(cause, table=np.array([weight for _, weight in parts]))
    return table, SwitchingCPD(own, cause, cases)


def unused(name: str, names: set[str]) -> str:
    """A name that is not taken, added to those that are."""
    while name in names:
        name += "'"
    names.add(name)
    return name


def _flat(cpd: MixtureCPD) -> Iterable[tuple[CPD, float]]:
    """The components of a mixture of mixtures, with their weights."""
    for part, weight in zip(cpd.parts, cpd.weights.tolist(), strict=True):
        if isinstance(part, MixtureCPD):
            yield from ((own, weight * share) for own, share in _flat(part))
        else:
            yield part, weight
