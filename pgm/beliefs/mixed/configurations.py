"""The configurations of a part's discrete parents, and its CPDs in all of them, as runs."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from functools import cached_property

import numpy as np

from pgm.beliefs.discrete.outcome import DiscreteOutcome
from pgm.beliefs.mixed.parts import Part
from pgm.cpds import CPD, ConditionalGaussian, Noise, SwitchingCPD
from pgm.cpds.by_run import kind_of, repeated, stacked
from pgm.errors import GraphError
from pgm.factors.axes import States, sizes
from pgm.factors.scope import listed
from pgm.kernels import roots
from pgm.kernels.arrays import Integers
from pgm.variables import Variable

# So many configurations are looked through for those that tables and evidence leave possible,
MOST = 2**18
# and so many are solved for beliefs that nothing known depends on.
FEW = 2**13
# From so many of the user's runs on it takes less time to solve configurations one by one, as all
# runs of one have the same matrices.
RUNS = 60


def fits(part: Part, states: Collection[Variable]) -> bool:
    """Whether a part has so few configurations that all its beliefs are found."""
    return math.prod(sizes(tuple(v for v in part.boundary if v not in states))) <= FEW


def possible(boundary: States, tables: DiscreteOutcome, states: Mapping[Variable, int]) -> Integers:
    """The configurations of discrete variables that are possible, (configurations, variables).

    `tables` are the beliefs by the tables, by the `states` that all runs observe and those that
    some run leaves possible. Too many are a GraphError.
    """
    hidden = tuple(v for v in boundary if v not in states)
    total = math.prod(sizes(hidden))
    if total > MOST:
        raise GraphError(
            f"the discrete variables ({listed(boundary)}) choose CPDs of continuous variables that "
            f"hang together, and have {total:,} configurations, each of which would be a Gaussian "
            "network; observe continuous variables between them, which cuts the network, or some "
            "of the discrete ones",
            variable=hidden[0],
        )
    if not hidden:
        return np.array([[states[v] for v in boundary]], dtype=np.intp).reshape(1, -1)
    share = tables.joint(*hidden).probabilities
    places = np.argwhere(share > 0.0)
    found = np.empty((len(places), len(boundary)), dtype=np.intp)
    for column, variable in enumerate(boundary):
        own = variable in states
        found[:, column] = states[variable] if own else places[:, hidden.index(variable)]
    return found


class Cases:
    """A part's CPDs in each of some configurations.

    Attributes
    ----------
    part : Part
    configurations : ndarray
        (configurations, discrete parents), indices of states.
    """

    def __init__(self, part: Part, configurations: Integers) -> None:
        self.part, self.configurations = part, configurations
        column = {v: k for k, v in enumerate(part.boundary)}
        # By switching CPD its cases by number, and the number of that in each configuration.
        self._cases: dict[CPD, tuple[list[CPD], Integers]] = {}
        for cpd in part.cpds:
            if isinstance(cpd, SwitchingCPD):
                places = configurations[:, [column[v] for v in cpd.switches]]
                number = np.ravel_multi_index(tuple(places.T), sizes(cpd.switches))
                self._cases[cpd] = list(cpd.cases.values()), np.asarray(number)

    @property
    def every(self) -> list[CPD]:
        """The CPDs that nothing chooses, and all cases of the others."""
        fixed = [cpd for cpd in self.part.cpds if cpd not in self._cases]
        return fixed + [case for own, _ in self._cases.values() for case in own]

    @cached_property
    def exact(self) -> bool:
        """Whether a CPD has no noise in some direction, in some case."""
        return any(map(_is_exact, self.every))

    def alike(self, runs: int) -> list[Integers]:
        """The configurations, by number, in groups whose CPDs one call takes as runs.

        Affine cases differ in numbers alone, as do those of one function; other cases are each for
        themselves. So are all beside CPDs without noise, where which relations are exact is decided
        for all runs of a call.
        `runs` are how many the user has.
        """
        if self.exact or runs >= RUNS:
            return list(np.arange(len(self.configurations))[:, None])
        keys = np.zeros((len(self.configurations), len(self._cases)), dtype=np.intp)
        for k, (cases, number) in enumerate(self._cases.values()):
            kinds: dict[object, int] = {}
            each = [kinds.setdefault(kind_of(case), len(kinds)) for case in cases]
            keys[:, k] = np.array(each)[number]
        _, group = np.unique(keys, axis=0, return_inverse=True)
        order = np.argsort(group, kind="stable")
        return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)

    @property
    def proper(self) -> bool:
        """Whether no prior is flat."""
        every = (cpd.cov for cpd in self.part.cpds if isinstance(cpd, ConditionalGaussian))
        return all(isinstance(cov, Noise) or bool(np.isfinite(cov).all()) for cov in every)

    def cpds(
        self,
        which: Integers,
        lead: tuple[int, ...] = (),
        runs: Integers | None = None,
        *,
        switched: bool = True,
    ) -> list[CPD]:
        """The CPDs at some configurations of one group and some of the user's runs.

        `lead` are the user's axes of runs, and `runs` numbers of them, all of them without. The
        CPDs' axis of runs is (configurations · runs,). Without `switched` CPDs that discrete
        variables choose stay as they are.
        """
        runs = np.arange(math.prod(lead)) if runs is None else runs
        return [
            self._at(cpd, which, lead, runs) if switched or cpd not in self._cases else cpd
            for cpd in self.part.cpds
        ]

    def _at(self, cpd: CPD, which: Integers, lead: tuple[int, ...], runs: Integers) -> CPD:
        if cpd not in self._cases:
            return repeated(cpd, which.size, lead, runs) if cpd._lead() else cpd
        cases, number = self._cases[cpd]
        own = number[which]
        used, place = np.unique(own, return_inverse=True)
        if used.size == 1:
            return cases[int(used[0])]
        found = stacked([cases[k] for k in used], np.repeat(place, runs.size))
        found.__dict__["_of"] = cpd._of
        return found


def _is_exact(case: CPD) -> bool:
    """Whether a Gaussian CPD has no noise in some direction."""
    if not isinstance(case, ConditionalGaussian) or isinstance(case.cov, Noise):
        return False
    if not np.isfinite(case.cov).all():  # a flat prior
        return False
    return bool(roots.determined(roots.root(case.cov)).any())


def is_noisy(case: CPD) -> bool:
    """Whether a Gaussian CPD has noise in all directions, of finite variance."""
    if not isinstance(case, ConditionalGaussian):
        return False
    if isinstance(case.cov, Noise):  # of which one that is zero somewhere is refused
        return True
    return bool(np.isfinite(case.cov).all()) and not _is_exact(case)
