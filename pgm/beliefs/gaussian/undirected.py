r"""A Gaussian Markov network as a Bayesian one: its factors as measurements of flat priors.

A factor is a *residual*: r = A x − y that is observed to be zero, N(0; r, R), or a function f(x)
that is observed to be a value z, N(z; f(x), R). A CPD stays one where its child has no other and no
cycle arises; each variable that no CPD is left for has a flat prior. A canonical form is, with
K = AᵀA and h = Aᵀ y,

    exp(−½ xᵀK x + hᵀx + g) = N(0; A x − y, I) exp(g + ½ yᵀy + r/2 ln 2π),

r being the rank of K. A flat prior stands for the factor (2π)^(−1/2) a component, as log-densities
have it. So each factor, and each variable, has a *level*: what its numbers here lack of its
logarithm.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from itertools import count
from typing import Any

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import (
    CPD,
    AffineCPD,
    ConditionalGaussian,
    GaussianCPD,
    LinearGaussianCPD,
    MixtureCPD,
    NonlinearGaussianCPD,
    SwitchingCPD,
)
from pgm.cpds.caused import components
from pgm.cpds.plates import plate
from pgm.cpds.residual import NonlinearGaussianFactor
from pgm.errors import ModelError
from pgm.factors import CanonicalForm
from pgm.factors.scope import dimension, names
from pgm.kernels import canonical
from pgm.kernels.arrays import LOG_2PI, Array
from pgm.networks import BayesianNetwork, checks
from pgm.networks.markov import Factor
from pgm.resources import uncollected
from pgm.variables import Variable

# Why digits are few, for a warning.
NEARLY_FLAT = (
    "a canonical form is nearly flat along a direction, and its entries hold few digits of what it "
    "knows there; give it as Gaussian CPDs, or as residuals, which keep them"
)
BEYOND = (
    "ln Z is beyond the range of float64: a factor is more than 1e150 deviations from zero; give "
    "forms nearer the origin"
)


@dataclass(frozen=True, eq=False)
class Measured:
    """Factors of continuous variables as CPDs, some of them residuals that are observed.

    Attributes
    ----------
    cpds : sequence of CPD
        Flat priors, the factors that stay CPDs, parents first, and residuals.
    by_factor : sequence of CPD or None
        By number of the factor the CPD in its place; None of a mere number.
    residuals : dict of Variable
        Those that are observed, with the factors that they are of.
    values : dict of Variable
        The values (d,) of the residuals: zero, but of factors that have a value.
    flat : sequence of Variable
        Those of which no CPD is left: their priors are flat.
    levels : ndarray
        By factor, (factors,).
    lost : float
        The part of a canonical form's least information that rounding of its entries may have
        changed, the largest of all forms.
    """

    cpds: Sequence[CPD]
    by_factor: Sequence[CPD | None]
    residuals: dict[Variable, Factor]
    values: dict[Variable, Array]
    flat: Sequence[Variable]
    levels: Array
    lost: float


@dataclass(frozen=True, eq=False)
class Directed:
    """A Markov network's graph with measurements in the place of its factors.

    Attributes
    ----------
    graph : ClusterGraph
        Its clusters are those of the network's graph, each with the residuals of its factors too.
    measured : Measured
        The CPDs in the place of the factors.
    levels : ndarray
        By cluster, (clusters,): those of its factors and flat priors.
    """

    graph: ClusterGraph
    measured: Measured
    levels: Array


def flat_level(variables: Iterable[Variable]) -> float:
    """The level of the flat priors of some variables."""
    return 0.5 * LOG_2PI * dimension(variables)


def directed(graph: ClusterGraph) -> Directed:
    """The Bayesian network of a Markov network's graph."""
    network = graph.network
    with uncollected(len(network.factors)):
        made = measured(network.factors, network.variables)
        # Of each cluster the children of its CPDs, and its level.
        children = [list[Variable]() for _ in graph._members]
        levels = np.zeros(len(graph._members))
        for k, assigned in enumerate(graph._assigned):
            levels[k] = made.levels[list(assigned)].sum()
            children[k] += [cpd.child for n in assigned if (cpd := made.by_factor[n]) is not None]
        homes: dict[int, int] = {}
        for k, members in enumerate(graph._members):
            for place in members:
                homes.setdefault(place, k)
        for variable in made.flat:
            home = homes[network._places[variable]]
            children[home].append(variable)
            levels[home] += flat_level((variable,))
        return Directed(_widened(graph, BayesianNetwork._made(made.cpds), children), made, levels)


def measured(
    factors: Sequence[Factor], variables: Iterable[Variable], taken: Collection[str] = ()
) -> Measured:
    """The CPDs in the place of factors of continuous variables.

    `taken` are names that no residual may have, besides those of the `variables`.
    """
    variables = tuple(variables)
    names_taken = {v.name for v in variables}.union(taken)
    names_left = (name for k in count(1) if (name := f"residual {k}") not in names_taken)
    kept = _directed(factors)
    by_factor: list[CPD | None] = []
    residuals: dict[Variable, Factor] = {}
    values: dict[Variable, Array] = {}
    alike: dict[Hashable, NonlinearGaussianCPD] = {}
    levels, lost = np.zeros(len(factors)), 0.0
    for number, factor in enumerate(factors):
        if number in kept:
            assert isinstance(factor, CPD)
            by_factor.append(factor)
            continue
        cpd, levels[number], uncertain = _measurement(factor, next(names_left), alike)
        lost = max(lost, uncertain)
        by_factor.append(cpd)
        if cpd is None:
            continue
        for part in (cpd, *components(cpd)):
            part.__dict__["_of"] = factor
        residuals[cpd.child] = factor
        values[cpd.child] = _value(factor, cpd)
    own = [cpd for k in sorted(kept) if (cpd := by_factor[k]) is not None]
    explained = {each.child for each in own}
    unexplained = [v for v in variables if v not in explained]
    priors: dict[int, GaussianCPD] = {}
    cpds: list[CPD] = [_anywhere(variable, priors) for variable in unexplained]
    cpds += checks.in_order(own, lambda cpd: cpd.parents)
    cpds += [cpd for k, cpd in enumerate(by_factor) if cpd is not None and k not in kept]
    return Measured(cpds, by_factor, residuals, values, unexplained, levels, lost)


def _value(factor: Factor, cpd: CPD) -> Array:
    """The observed value of a factor's residual, (d,)."""
    if isinstance(factor, NonlinearGaussianFactor):
        return factor.value
    return np.zeros(cpd.child.dimension)


def _anywhere(variable: Variable, flat: dict[int, GaussianCPD]) -> GaussianCPD:
    """A flat prior of a variable, with the numbers of another's of as many components."""
    size = variable.dimension
    if size not in flat:
        flat[size] = GaussianCPD(variable, np.zeros(size), np.full(size, np.inf))
    return flat[size]._with_child(variable)


def _widened(
    graph: ClusterGraph, network: BayesianNetwork, children: Sequence[Sequence[Variable]]
) -> ClusterGraph:
    """A graph's clusters and sepsets, with residuals too, and the CPDs of these children each."""
    place, variables = network._places, graph.network.variables
    moved = [place[v] for v in variables]
    members = [
        tuple(sorted({*(moved[k] for k in held), *map(place.__getitem__, own)}))
        for held, own in zip(graph._members, children, strict=True)
    ]
    shared = {e: tuple(sorted(moved[k] for k in held)) for e, held in graph._shared.items()}
    return graph._with(network, members, shared, [[place[v] for v in own] for own in children])


def _directed(factors: Sequence[Factor]) -> set[int]:
    """The numbers of the CPDs that may stay: one a child, and none on a cycle.

    One of robust noise does not: as a measurement it may weigh a child without evidence.
    """
    first: dict[Variable, int] = {}
    for number, cpd in enumerate(factors):
        if isinstance(cpd, CPD) and not _is_robust(cpd):
            first.setdefault(cpd.child, number)
    above = {child: factors[number].scope[1:] for child, number in first.items()}
    order = TopologicalSorter({v: [p for p in above[v] if p in above] for v in above})
    with suppress(CycleError):
        order.prepare()
        return set(first.values())
    kept: dict[Variable, int] = {}
    for child, number in first.items():
        waiting, seen = [*above[child]], set(above[child])
        while waiting:
            at = waiting.pop()
            new = [v for v in above[at] if v not in seen] if at in kept else []
            seen.update(new)
            waiting += new
        if child not in seen:
            kept[child] = number
    return set(kept.values())


def _is_robust(cpd: CPD) -> bool:
    """Whether a CPD has robust noise, in one of its cases or components."""
    if isinstance(cpd, ConditionalGaussian):
        return cpd.noise is not None
    return any(isinstance(c, ConditionalGaussian) and c.noise is not None for c in components(cpd))


def _measurement(
    factor: Factor, name: str, alike: dict[Hashable, NonlinearGaussianCPD]
) -> tuple[CPD | None, float, float]:
    """A factor as a CPD of a residual of some name, None of a mere number; its level; what is lost.

    See `Measured`. `alike` has the first residual of each plate of nonlinear CPDs, and gets others.
    """
    if isinstance(factor, NonlinearGaussianFactor):
        child = factor._cpd.child._with(name=name)
        return factor._cpd._with_child(child), 0.0, 0.0
    if isinstance(factor, CanonicalForm):
        return _of_form(factor, name)
    assert isinstance(factor, CPD)
    y = factor.child
    return _of_cpd(factor, Variable(name, y.components, y.angles), alike), 0.0, 0.0


def _of_form(form: CanonicalForm, name: str) -> tuple[CPD | None, float, float]:
    """A canonical form as a linear measurement; a ModelError if it has no root, or a slope."""
    square = canonical.squares(form.K, form.h)
    if square is None:
        raise ModelError(
            f"the canonical form over {names(form.scope)} has a precision that is not positive "
            "semidefinite: it grows without bound; multiply it into another factor that bounds "
            "it, and give their product"
        )
    rows, target, slope, lost = square
    if slope.any():
        raise ModelError(
            f"the canonical form over {names(form.scope)} has a slope, {np.abs(slope).max():.3g}, "
            "along a direction of no information, where it grows without bound; multiply it into "
            "another factor that bounds it, and give their product"
        )
    if not form.scope:
        return None, float(form.g), lost
    if not len(rows):  # of which a reading of nothing is left, so that its variables are in use
        rows, target = np.zeros((1, rows.shape[1])), np.zeros(1)
    rank = len(rows)
    level = float(form.g) + 0.5 * float(target @ target) + 0.5 * rank * LOG_2PI
    parts = np.split(rows, np.cumsum([v.dimension for v in form.scope])[:-1], axis=1)
    child = Variable(name, tuple(f"r{k}" for k in range(rank)) if rank > 1 else ())
    given = dict(zip(form.scope, parts, strict=True))
    return LinearGaussianCPD(child, given, offset=-target, cov=np.eye(rank)), level, lost


def _of_cpd(cpd: CPD, child: Variable, alike: dict[Hashable, NonlinearGaussianCPD]) -> CPD:
    """A CPD as a measurement of its child less its mean; `child` is the residual, of its kind.

    Of one that discrete variables choose, or of a mixture, so is each case, or component.
    """
    if isinstance(cpd, SwitchingCPD):
        cases = {case: _of_cpd(own, child, alike) for case, own in cpd.cases.items()}
        return SwitchingCPD(child, cpd.switches, cases)
    if isinstance(cpd, MixtureCPD):
        return MixtureCPD([_of_cpd(part, child, alike) for part in cpd.parts], cpd.weights)
    assert isinstance(cpd, ConditionalGaussian)
    flat = isinstance(cpd.cov, np.ndarray) and not np.isfinite(cpd.cov).all()
    if cpd._lead() or flat:
        raise ModelError(
            f"{cpd!r} differs by run, or has an infinite variance, and another CPD of "
            f"{cpd.child!r} is a factor too, or its parents depend on it: give one run's numbers",
            variable=cpd.child,
            cpd=cpd,
        )
    y = cpd.child
    if isinstance(cpd, AffineCPD):
        given = {y: np.eye(y.dimension)} | {p: -matrix for p, matrix in cpd.matrices.items()}
        return LinearGaussianCPD(child, given, offset=-cpd.offset, cov=cpd.cov, noise=cpd.noise)
    assert isinstance(cpd, NonlinearGaussianCPD)
    key = plate(cpd)
    if key in alike:  # of one function, so that they are linearised in one call
        places = dict(zip(alike[key].scope, (child, y, *cpd.parents), strict=True))
        return alike[key]._copy(places.__getitem__, cov=cpd.cov)
    own = _Less(cpd)
    jacobian = {p: _Negative(derivative) for p, derivative in cpd.jacobian.items()}
    alike[key] = NonlinearGaussianCPD(
        child,
        (y, *cpd.given),
        own,
        cov=cpd.cov,
        jacobian={y: own.by_child, **jacobian} if jacobian else None,
        lineariser=cpd.lineariser,
        noise=cpd.noise,
    )
    return alike[key]


class _Less:
    """The residual of a nonlinear CPD: its child less its function."""

    def __init__(self, cpd: NonlinearGaussianCPD) -> None:
        self._function, self._size = cpd.function, cpd.child.dimension

    def __call__(self, child: Array, *given: Array) -> Any:
        value = self._function(*given)
        # One of another shape is refused by those who called, and not spread over the child here.
        if np.shape(value)[-1:] != (self._size,):
            return value
        return child - value

    def by_child(self, child: Array, *_: Array) -> Array:
        """The derivative by the child."""
        return np.broadcast_to(np.eye(self._size), (*child.shape, self._size))


class _Negative:
    """The derivative of a residual by a parent."""

    def __init__(self, derivative: Callable[..., Any]) -> None:
        self._derivative = derivative

    def __call__(self, child: Array, *given: Array) -> Any:
        return -np.asarray(self._derivative(*given))


def side(graph: ClusterGraph, source: int, target: int) -> Sequence[int]:
    """The clusters on the source's side of the edge to a target, of a tree."""
    found, waiting = {source}, [source]
    while waiting:
        at = waiting.pop()
        for other in graph._neighbours[at]:
            if other not in found and not (at == source and other == target):
                found.add(other)
                waiting.append(other)
    return sorted(found)
