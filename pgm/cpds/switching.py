"""CPDs of a continuous child that discrete parents choose."""

from __future__ import annotations

import copy
import math
from collections.abc import Hashable, Iterable, Mapping
from itertools import product
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_tuple
from pgm.cpds import by_step
from pgm.cpds.base import CPD, Known, Moved, Values, of_case
from pgm.display import Listing, few
from pgm.errors import ModelError
from pgm.factors.axes import States
from pgm.factors.scope import Scope, as_scope, listed
from pgm.kernels.arrays import Array, Integers
from pgm.variables import Discrete, Variable

# States of the discrete parents, in their order, by index.
Case = tuple[int, ...]


@public
class SwitchingCPD(CPD):
    r"""A CPD for each state of discrete parents: p(y | s, x) = p_s(y | x_s).

    .. math:: p(y \mid s, x) = p_s(y \mid x_s)

    - s: the states of the discrete parents;
    - p_s: the CPD of y in these states, its *case*, with continuous parents x_s of its own.

    A group that one belongs to and a height, a mode and a motion, a fault and a reading. In
    networks without time `pgm.infer` sums over all states that the tables and the evidence leave
    possible. In a `DynamicBayesianNetwork` it is a prior, a transition or a sensor: as a sensor of
    states that are all discrete it makes a hidden Markov model that reads numbers, which is exact;
    with continuous states beside them beliefs are mixtures of Gaussians, `pgm.Gaussians`.

    Parameters
    ----------
    child : Variable
        y, continuous.
    given : Discrete or sequence of Discrete
        The discrete parents.
    cases : mapping
        By state of the parent, its name or index, the CPD of that case; of several parents by
        tuples of states. Each is a CPD of the same child, with continuous parents of its own: also
        a `MixtureCPD`, or one of robust noise.

    Attributes
    ----------
    given : tuple of Variable
        The discrete parents, then the continuous parents of all cases.
    switches : tuple of Discrete
        The discrete parents.
    cases : mapping of tuple of int to CPD
        By indices of states, in the order of the parents.

    Raises
    ------
    ModelError
        If a case is missing, is named twice or is of no states, is a CPD of another child, or has
        runs of its own.

    References
    ----------
    Lauritzen, Propagation of probabilities, means and variances in mixed graphical association
    models, 1992.

    Examples
    --------
    >>> group, height = pgm.Discrete("group", states=("f", "m")), pgm.Variable("height")
    >>> cpd = pgm.SwitchingCPD(
    ...     height,
    ...     given=group,
    ...     cases={"f": pgm.GaussianCPD(height, 162, 40), "m": pgm.GaussianCPD(height, 176, 50)},
    ... )
    >>> cpd
    SwitchingCPD(height | group)
    >>> cpd.log_density([[170.0]], {group: ["f", "m"]}).round(3)
    array([-3.563, -3.235])
    """

    switches: States
    cases: Mapping[Case, CPD]

    def __init__(
        self, child: Variable, given: Discrete | Iterable[Discrete], cases: Mapping[Any, CPD]
    ) -> None:
        found: list[Discrete] = []
        for variable in as_scope(given, f"SwitchingCPD of {child!r}: given"):
            if not isinstance(variable, Discrete):
                raise ModelError(
                    f"SwitchingCPD of {child!r}: given holds the discrete parents, and "
                    f"{variable!r} is continuous; give it to the cases' CPDs",
                    variable=variable,
                )
            found.append(variable)
        switches = tuple(found)
        if not switches:
            raise ModelError(f"SwitchingCPD of {child!r}: given holds no discrete parent")
        if isinstance(child, Discrete):
            raise ModelError(
                f"SwitchingCPD of {child!r}: the child is discrete; give it a TableCPD of discrete "
                "parents",
                variable=child,
            )
        by_case = _by_indices(child, switches, cases)
        parts = tuple(by_case.values())
        own = dict.fromkeys(v for part in parts for v in part.given)
        noise = tuple(dict.fromkeys(v for part in parts for v in part.noise_given))
        self._set_scope(child, (*switches, *own), noise)
        self._set(switches=switches, cases=MappingProxyType(by_case))
        self._set(partial=all(part.partial for part in parts))
        changing = by_step.among(parts)
        if changing is not None:
            self._set(steps=changing.steps)

    def _require_kinds(self, scope: Scope) -> None:
        """All kinds: the discrete parents choose, and the others are those of cases."""

    @property
    def noise_given(self) -> Scope:
        """The parents that a noise covariance depends on."""
        return tuple(dict.fromkeys(v for part in self.cases.values() for v in part.noise_given))

    def require_proper(self, what: str) -> None:
        """Refuse an infinite variance in any case."""
        for part in self.cases.values():
            part.require_proper(what)

    def _log_density(self, child: Values, known: Known) -> Array:
        lead = np.broadcast_shapes(child.shape[:-1], known.lead)
        size = child.shape[-1]
        values = np.broadcast_to(child, (*lead, size)).reshape(math.prod(lead), size)
        found = np.empty(len(values))
        for part, rows, own in self._parted(known, known.lead, lead):
            found[rows] = part._log_density(values[rows], own)
        return found.reshape(lead)

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Values:
        shape = (*size, *known.shape)
        drawn = np.empty((math.prod(shape), self.child.dimension))
        numbers = {part: k for k, part in enumerate(self.cases.values())}
        for part, rows, own in self._parted(known, known.shape, shape):
            drawn[rows] = part._draw(own, of_case(rng, numbers[part], rows))
        return drawn.reshape(*shape, self.child.dimension)

    def _parted(
        self, known: Known, shape: tuple[int, ...], lead: tuple[int, ...]
    ) -> Iterable[tuple[CPD, Integers, Known]]:
        """The cases that hold somewhere: their CPDs, at which rows, and the parents' values there.

        `known` has values of the `shape`, which are broadcast to `lead`, whose rows are counted.
        """

        def rows_of(values: Values, width: tuple[int, ...]) -> Values:
            whole = np.broadcast_to(values, (*known.shape, *width)).reshape((*shape, *width))
            return np.broadcast_to(whole, (*lead, *width)).reshape((math.prod(lead), *width))

        states = [rows_of(known.values[v], ()) for v in self.switches]
        for case, part in self.cases.items():
            pairs = zip(states, case, strict=True)
            rows = np.flatnonzero(np.logical_and.reduce([own == k for own, k in pairs]))
            if not rows.size:
                continue
            own = {v: rows_of(known.values[v], (v.dimension,))[rows] for v in part.parents}
            step = known.step
            if step is not None and np.ndim(step):
                step = rows_of(np.asarray(step), ())[rows]
            yield part, rows, Known(own, rows.shape, rows.shape, step)

    def _over(self, moved: Moved) -> dict[str, Any]:
        cases = {k: part._copy(moved, _origin=part.origin) for k, part in self.cases.items()}
        switches = tuple(map(moved, self.switches))
        return super()._over(moved) | {"switches": switches, "cases": MappingProxyType(cases)}

    def _held(self, step: int) -> Self:
        if self.steps is None:
            return self
        cases = {k: part._held(step) for k, part in self.cases.items()}
        found = copy.copy(self)
        found._set(cases=MappingProxyType(cases), steps=None, _origin=self.origin)
        return found

    def _parts(self) -> list[str | Listing]:
        rows = [(self.named(case), part._title) for case, part in self.cases.items()]
        shown = [None if k is None else rows[k] for k in few(len(rows))]
        return [Listing((listed(self.switches), "case"), shown)]

    def case_of(self, states: Hashable) -> Case:
        """The case of some states, by name or index; of several parents a tuple of them."""
        return _indices(f"{self!r}", self.switches, states)

    def named(self, case: Case) -> str:
        """The states of a case by name."""
        return ", ".join(v.states[k] for v, k in zip(self.switches, case, strict=True))


def _by_indices(child: Variable, switches: States, cases: Any) -> dict[Case, CPD]:
    """The cases by indices of states, each of them there once, in order; else a ModelError."""
    what = f"SwitchingCPD of {child!r}"
    if not isinstance(cases, Mapping):
        raise ModelError(
            f"{what}: cases map states of ({listed(switches)}) to CPDs; found {cases!r}",
            variable=child,
        )
    found: dict[Case, CPD] = {}
    for states, part in cases.items():
        case = _indices(what, switches, states)
        if case in found:
            raise ModelError(f"{what}: the case {states!r} is given twice", variable=child)
        if not isinstance(part, CPD) or part.discrete or isinstance(part, SwitchingCPD):
            raise ModelError(
                f"{what}: the case {states!r} is {part!r}; a CPD of {child!r} with continuous "
                "parents was due, and all discrete ones in given",
                variable=child,
            )
        if part.child != child:
            raise ModelError(
                f"{what}: the case {states!r} is {part!r}, a CPD of {part.child!r}",
                variable=part.child,
                cpd=part,
            )
        if part._lead():
            raise ModelError(
                f"{what}: the case {states!r}, {part!r}, has axes of runs {part._lead()}; a case "
                "is of one run",
                variable=child,
                cpd=part,
            )
        part.require_proper(
            "states of its parents are weighed by densities, and a flat one has none"
        )
        found[case] = part
    every = list(product(*(range(v.size) for v in switches)))
    missing = next((case for case in every if case not in found), None)
    if missing is not None:
        names = tuple(v.states[k] for v, k in zip(switches, missing, strict=True))
        raise ModelError(
            f"{what}: there is no case {names[0] if len(names) == 1 else names!r}, one of "
            f"{len(every)} states of ({listed(switches)}); give each one",
            variable=child,
        )
    return {case: found[case] for case in every}


def _indices(what: str, switches: States, states: Hashable) -> Case:
    """The indices of the states of a case."""
    each = (states,) if len(switches) == 1 and not isinstance(states, tuple) else as_tuple(states)
    if each is None or len(each) != len(switches):
        raise ModelError(
            f"{what}: the case {states!r} is of no states of ({listed(switches)}); a name or index "
            "of a state was due" + ", one of each, as a tuple" * (len(switches) > 1)
        )
    return tuple(v.index(state) for v, state in zip(switches, each, strict=True))
