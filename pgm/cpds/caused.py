"""A mixture of CPDs as a CPD that a hidden discrete variable chooses: its *cause*."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pgm.cpds.base import CPD
from pgm.cpds.mixture import MixtureCPD
from pgm.cpds.switching import SwitchingCPD
from pgm.cpds.table import TableCPD
from pgm.variables import Discrete


def caused(cpd: MixtureCPD, names: set[str]) -> tuple[TableCPD, SwitchingCPD]:
    """The table of a mixture's cause, which component a value is of, and the CPD that it chooses.

    The cause is "component of x" of a mixture of x, and has its weights, whatever else is so.
    `names` are those that are taken, to which the cause's is added.
    """
    parts = list(flat(cpd))
    name = f"component of {cpd.child.name}"
    while name in names:
        name += "'"
    names.add(name)
    cause = Discrete(name, states=tuple(str(k) for k in range(len(parts))))
    table = TableCPD(cause, table=np.array([weight for _, weight in parts]))
    return table, SwitchingCPD(cpd.child, cause, {k: part for k, (part, _) in enumerate(parts)})


def has_mixtures(cpds: Iterable[CPD]) -> bool:
    """Whether some CPD is a mixture."""
    return any(isinstance(cpd, MixtureCPD) for cpd in cpds)


def flat(cpd: MixtureCPD) -> Iterable[tuple[CPD, float]]:
    """The components of a mixture with their weights; mixtures of mixtures are one mixture."""
    for part, weight in zip(cpd.parts, cpd.weights.tolist(), strict=True):
        if isinstance(part, MixtureCPD):
            yield from ((own, weight * share) for own, share in flat(part))
        else:
            yield part, weight
