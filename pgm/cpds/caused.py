"""Mixtures of CPDs as CPDs that a hidden discrete variable chooses: their *cause*.

Robust noise whose density is a mixture of Gaussians of several scales makes its CPD such a mixture.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from pgm.cpds.base import CPD
from pgm.cpds.conditional import ConditionalGaussian
from pgm.cpds.mixture import MixtureCPD
from pgm.cpds.switching import SwitchingCPD
from pgm.cpds.table import TableCPD
from pgm.errors import ModelError
from pgm.factors.axes import sizes
from pgm.variables import Discrete


def caused(cpd: CPD, names: set[str]) -> tuple[TableCPD, SwitchingCPD]:
    """The table of a mixture's cause, which component a value is of, and the CPD that it chooses.

    The cause is "component of x" of a mixture of x, and has its weights, whatever else is so; where
    discrete variables choose among mixtures, it has those of their case. `names` are those that
    are taken, to which the cause's is added.
    """
    switches = cpd.switches if isinstance(cpd, SwitchingCPD) else ()
    mixtures = {case: list(flat(own)) for case, own in cases_of(cpd).items()}
    name = f"component of {cpd.child.name}"
    while name in names:
        name += "'"
    names.add(name)
    count = max(len(parts) for parts in mixtures.values())
    cause = Discrete(name, states=tuple(str(k) for k in range(count)))
    table = np.zeros((*sizes(switches), count))
    cases: dict[tuple[int, ...], CPD] = {}
    for case, parts in mixtures.items():
        table[case][: len(parts)] = [weight for _, weight in parts]
        for k in range(count):  # of which those beyond the last are impossible
            cases[*case, k], _ = parts[min(k, len(parts) - 1)]
    chosen = SwitchingCPD(cpd.child, (*switches, cause), cases)
    return TableCPD(cause, given=switches, table=table), chosen


def cases_of(cpd: CPD) -> dict[tuple[int, ...], CPD]:
    """The cases of a CPD that discrete variables choose; one, of no states, of another."""
    return dict(cpd.cases) if isinstance(cpd, SwitchingCPD) else {(): cpd}


def is_mixture(cpd: CPD) -> bool:
    """Whether a CPD is a mixture, or discrete variables choose one."""
    return any(isinstance(case, MixtureCPD) for case in cases_of(cpd).values())


def has_mixtures(cpds: Iterable[CPD]) -> bool:
    """Whether some CPD is a mixture, or discrete variables choose one."""
    return any(map(is_mixture, cpds))


def flat(cpd: CPD) -> Iterable[tuple[CPD, float]]:
    """The components of a mixture with their weights; mixtures of mixtures are one mixture."""
    if not isinstance(cpd, MixtureCPD):
        yield cpd, 1.0
        return
    for part, weight in zip(cpd.parts, cpd.weights.tolist(), strict=True):
        yield from ((own, weight * share) for own, share in flat(part))


def components(cpd: CPD) -> Sequence[CPD]:
    """The components of a CPD, or of its cases; the CPD where it is neither mixture nor chosen."""
    return [part for case in cases_of(cpd).values() for part, _ in flat(case)]


def in_scales(cpd: CPD, why: str) -> CPD:
    """A CPD whose robust noise is a mixture of scales; a ModelError, for the reason, if it is none.

    CPDs of Gaussian noise alone are as they were.
    """
    if isinstance(cpd, SwitchingCPD):
        cases = {case: in_scales(own, why) for case, own in cpd.cases.items()}
        same = all(cases[case] is own for case, own in cpd.cases.items())
        return cpd if same else SwitchingCPD(cpd.child, cpd.switches, cases)
    if isinstance(cpd, MixtureCPD):
        parts = [in_scales(part, why) for part in cpd.parts]
        same = all(own is part for own, part in zip(parts, cpd.parts, strict=True))
        return cpd if same else MixtureCPD(parts, cpd.weights)
    if not isinstance(cpd, ConditionalGaussian) or cpd.noise is None:
        return cpd
    scales = cpd.noise.scales(cpd.child.dimension)
    if scales is None:
        raise ModelError(
            f"{cpd!r} has robust noise, {cpd.noise!r}, which is no mixture of Gaussians of several "
            f"scales, {why}: take pgm.StudentT(dof) of ½ to 30 degrees of freedom, or make "
            "outliers a state of a discrete variable, with a case of larger noise",
            variable=cpd.child,
            cpd=cpd,
        )
    weights, factors = scales
    return MixtureCPD([cpd._scaled(factor) for factor in factors.tolist()], weights)
