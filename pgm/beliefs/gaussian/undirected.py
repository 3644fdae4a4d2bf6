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

from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from itertools import count
from typing import Any

import numpy as np

from pgm.clustergraph import ClusterGraph
from pgm.cpds import CPD, AffineCPD, GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD
from pgm.cpds.conditional import ConditionalGaussian
from pgm.cpds.plates import plate
from pgm.cpds.residual import NonlinearGaussianFactor
from pgm.errors import ModelError
from pgm.factors import CanonicalForm
from pgm.factors.scope import names
from pgm.kernels import canonical
from pgm.kernels.arrays import LOG_2PI, Array
from pgm.networks import BayesianNetwork, MarkovNetwork, checks
from pgm.networks.markov import Factor
from pgm.resources import uncollected
from pgm.variables import Variable


@dataclass(frozen=True, eq=False)
class Directed:
    """A Markov network's graph with measurements in the place of its factors.

    Attributes
    ----------
    graph : ClusterGraph
        Its clusters are those of the network's graph, each with the residuals of its factors too.
    residuals : dict of Variable
        Those that are observed, with the factors that they are of.
    values : dict of Variable
        The values (d,) of the residuals: zero, but of factors that have a value.
    levels : ndarray
        By cluster, (clusters,).
    lost : float
        The part of a canonical form's least information that rounding of its entries may have
        changed, the largest of all forms.
    """

    graph: ClusterGraph
    residuals: dict[Variable, Factor]
    values: dict[Variable, Array]
    levels: Array
    lost: float


def directed(graph: ClusterGraph) -> Directed:
    """The Bayesian network of a Markov network's graph."""
    with uncollected(len(graph.network.factors)):
        return _measured(graph)


def _measured(graph: ClusterGraph) -> Directed:
    network = graph.network
    taken = {v.name for v in network.variables}
    names_left = (name for k in count(1) if (name := f"residual {k}") not in taken)
    kept = _directed(network)
    measured: list[CPD] = []
    residuals: dict[Variable, Factor] = {}
    values: dict[Variable, Array] = {}
    alike: dict[Hashable, NonlinearGaussianCPD] = {}
    # Of each cluster the children of its CPDs, and its level.
    children = [list[Variable]() for _ in graph._members]
    levels, lost = np.zeros(len(graph._members)), 0.0
    for k, assigned in enumerate(graph._assigned):
        for number in assigned:
            factor = network.factors[number]
            if number in kept:
                assert isinstance(factor, CPD)
                children[k].append(factor.child)
                continue
            cpd, level, uncertain = _measurement(factor, next(names_left), alike)
            levels[k] += level
            lost = max(lost, uncertain)
            if cpd is None:
                continue
            cpd.__dict__["_of"] = factor
            measured.append(cpd)
            children[k].append(cpd.child)
            residuals[cpd.child] = factor
            values[cpd.child] = _value(factor, cpd)
    own = [each for k in sorted(kept) if isinstance(each := network.factors[k], CPD)]
    explained = {each.child for each in own}
    cpds: list[CPD] = []
    flat: dict[int, GaussianCPD] = {}
    homes: dict[int, int] = {}
    for k, members in enumerate(graph._members):
        for place in members:
            homes.setdefault(place, k)
    for place, variable in enumerate(network.variables):
        if variable not in explained:
            cpds.append(_anywhere(variable, flat))
            children[homes[place]].append(variable)
            levels[homes[place]] += 0.5 * LOG_2PI * variable.dimension
    cpds += checks.in_order(own, lambda cpd: cpd.parents)
    made = _widened(graph, BayesianNetwork._made([*cpds, *measured]), children)
    return Directed(made, residuals, values, levels, lost)


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


def _directed(network: MarkovNetwork) -> set[int]:
    """The numbers of the CPDs that may stay: one a child, and none on a cycle.

    One of robust noise does not: as a measurement it may weigh a child without evidence.
    """
    first: dict[Variable, int] = {}
    for number, cpd in enumerate(network.factors):
        if isinstance(cpd, ConditionalGaussian) and cpd.noise is None:
            first.setdefault(cpd.child, number)
    above = {child: network.factors[number].scope[1:] for child, number in first.items()}
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


def _measurement(
    factor: Factor, name: str, alike: dict[Hashable, NonlinearGaussianCPD]
) -> tuple[CPD | None, float, float]:
    """A factor as a CPD of a residual of some name, None of a mere number; its level; what is lost.

    See `Directed`. `alike` has the first residual of each plate of nonlinear CPDs, and gets others.
    """
    if isinstance(factor, NonlinearGaussianFactor):
        child = factor._cpd.child._with(name=name)
        return factor._cpd._with_child(child), 0.0, 0.0
    if isinstance(factor, CanonicalForm):
        return _of_form(factor, name)
    assert isinstance(factor, ConditionalGaussian)
    return _of_cpd(factor, name, alike), 0.0, 0.0


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
    rank = len(rows)
    level = float(form.g) + 0.5 * float(target @ target) + 0.5 * rank * LOG_2PI
    if not rank:
        return None, level, lost
    parts = np.split(rows, np.cumsum([v.dimension for v in form.scope])[:-1], axis=1)
    child = Variable(name, tuple(f"r{k}" for k in range(rank)) if rank > 1 else ())
    given = dict(zip(form.scope, parts, strict=True))
    return LinearGaussianCPD(child, given, offset=-target, cov=np.eye(rank)), level, lost


def _of_cpd(
    cpd: ConditionalGaussian, name: str, alike: dict[Hashable, NonlinearGaussianCPD]
) -> CPD:
    """A CPD as a measurement of its child less its mean, whose residual is of the child's kind."""
    flat = isinstance(cpd.cov, np.ndarray) and not np.isfinite(cpd.cov).all()
    if cpd._lead() or flat:
        raise ModelError(
            f"{cpd!r} differs by run, or has an infinite variance, and another CPD of "
            f"{cpd.child!r} is a factor too, or its parents depend on it: give one run's numbers",
            variable=cpd.child,
            cpd=cpd,
        )
    y = cpd.child
    child = Variable(name, y.components, y.angles)
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
