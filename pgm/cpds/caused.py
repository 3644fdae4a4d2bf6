"""Mixtures of CPDs as CPDs that a hidden discrete variable chooses: their *cause*.

Robust noise whose density is a mixture of Gaussians of several scales makes its CPD such a mixture.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from pgm.cpds.base import CPD
from pgm.cpds.conditional import ConditionalGaussian
from pgm.cpds.mixture import MixtureCPD
from pgm.cpds.switching import SwitchingCPD
from pgm.cpds.table import TableCPD
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors.axes import sizes
from pgm.kernels.arrays import Array
from pgm.variables import Discrete


def caused(cpd: CPD, names: set[str]) -> tuple[TableCPD, SwitchingCPD]:
    """The table of a mixture's cause, which component a value is of, and the CPD that it chooses.

    The cause is "component of x" of a mixture of x, and has its weights, whatever else is so; where
    discrete variables choose among mixtures, it has those of their case; of a residual it has the
    factor's name. `names` are those that are taken, to which the cause's is added.
    """
    switches = cpd.switches if isinstance(cpd, SwitchingCPD) else ()
    mixtures = {case: flat(own) for case, own in cases_of(cpd).items()}
    of = cpd if cpd._of is None else cpd._of
    name = f"component of {of.child.name if isinstance(of, CPD) else titled(of)}"
    while name in names:
        name += "'"
    names.add(name)
    count = max(len(parts) for parts in mixtures.values())
    cause = Discrete(name, states=tuple(str(k) for k in range(count)))
    table = np.zeros((*sizes(switches), count))
    cases: dict[tuple[int, ...], CPD] = {}
    for case, parts in mixtures.items():
        table[case][: len(parts)] = [part.weight for part in parts]
        for k in range(count):  # of which those beyond the last are impossible
            cases[*case, k] = parts[min(k, len(parts) - 1)].cpd
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


# From this probability of its largest scale on, a reading is farther off than its noise is known.
FAR = 1e-3


class Component(NamedTuple):
    """A component of a mixture, with its weight.

    group: Components of one group are alike: scales of one robust noise of one order of magnitude.
    """

    cpd: CPD
    weight: float
    group: int


class Scales(MixtureCPD):
    """A CPD of robust noise as a mixture of Gaussians of covariances v R, v being the `factors`."""

    factors: Array

    def __init__(self, cpd: ConditionalGaussian, weights: Array, factors: Array) -> None:
        parts = [cpd._scaled(factor) for factor in factors.tolist()]
        parts[int(factors.argmax())]._set(_farthest=True)
        super().__init__(parts, weights)
        self._set(factors=factors)


def is_farthest(cpd: CPD) -> bool:
    """Whether a CPD is the largest scale of a robust noise."""
    return bool(cpd.__dict__.get("_farthest", False))


def too_far(cpd: CPD, where: str) -> str:
    """The text of the error for a reading that is of the largest scale; `where` tells which."""
    read = cpd.child if cpd._of is None else cpd  # which is titled as the factor
    return (
        f"a reading of {read!r}{where} is more than a million deviations of {cpd!r} from all "
        "that is expected, farther than its robust noise is known: is it a number in other units, "
        "or one that stands for none, as NaN does?"
    )


def flat(cpd: CPD) -> list[Component]:
    """The components of a mixture; mixtures of mixtures are one mixture."""
    if isinstance(cpd, Scales):
        _, groups = np.unique(np.floor(np.log10(cpd.factors)), return_inverse=True)
        each = zip(cpd.parts, cpd.weights.tolist(), groups.tolist(), strict=True)
        return [Component(part, weight, group) for part, weight, group in each]
    if not isinstance(cpd, MixtureCPD):
        return [Component(cpd, 1.0, 0)]
    found: list[Component] = []
    for part, weight in zip(cpd.parts, cpd.weights.tolist(), strict=True):
        first = found[-1].group + 1 if found else 0
        found += [
            own._replace(weight=weight * own.weight, group=first + own.group) for own in flat(part)
        ]
    return found


def components(cpd: CPD) -> Sequence[CPD]:
    """The components of a CPD, or of its cases; the CPD where it is neither mixture nor chosen."""
    return [part.cpd for case in cases_of(cpd).values() for part in flat(case)]


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
    scales = cpd.noise._checked_scales(cpd.child.dimension)
    if scales is None:
        raise ModelError(
            f"{cpd!r} has robust noise, {cpd.noise!r}, which is no mixture of Gaussians of several "
            f"scales, {why}: take pgm.StudentT(dof) of ½ to 30 degrees of freedom, or make "
            "outliers a state of a discrete variable, with a case of larger noise; a noise of your "
            "own may have scales()",
            variable=cpd.child,
            cpd=cpd,
        )
    return Scales(cpd, *scales)
