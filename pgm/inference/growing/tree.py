"""The tree of cliques of a map, and a tree in which some of them were eliminated anew."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg.lapack import dtrtrs

from pgm.inference.growing.cliques import Clique, Front, columns, ordered, spread
from pgm.inference.growing.eliminating import Found, Posed, eliminated
from pgm.inference.growing.factors import Factor, Rows
from pgm.inference.growing.vectors import Vector
from pgm.kernels.arrays import Array, Integers


class Undetermined(Exception):
    """A front that has no proper belief: the numbers of its variables."""

    def __init__(self, variables: Sequence[int]) -> None:
        super().__init__(variables)
        self.variables = variables


@dataclass(frozen=True, slots=True)
class Tree:
    """The cliques of a map, all of which are shared by the trees that it grows to.

    Variables and factors have numbers, in the order in which they came. A clique is known by the
    number of its first pivot, its *lead*.

    Attributes
    ----------
    sizes, bends : Vector
        Of each variable how many components it has, and whether some CPD is not linear in it.
    points : Vector
        Of each variable its point, (d,), where CPDs of it are linearised.
    homes : Vector
        The clique that eliminates each variable.
    parents : Vector
        By their leads, the leads of the cliques above cliques; −1 of a root.
    means : Vector
        By their leads, the means of cliques, their pivots' and then their separators', by which
        the pivots' were found: distances from the points, (size,).
    factors, rows : Vector
        The factors, and their rows as linearised last.
    moved : tuple of int
        The variables that are farther from their points than their limits.
    cliques : int
        How many cliques there are.
    """

    sizes: Vector[int] = field(default_factory=Vector)
    bends: Vector[bool] = field(default_factory=Vector)
    points: Vector[Array] = field(default_factory=Vector)
    homes: Vector[Clique] = field(default_factory=Vector)
    parents: Vector[int] = field(default_factory=Vector)
    means: Vector[Array] = field(default_factory=Vector)
    factors: Vector[Factor] = field(default_factory=Vector)
    rows: Vector[Rows] = field(default_factory=Vector)
    moved: tuple[int, ...] = ()
    cliques: int = 0

    def distance(self, variable: int) -> Array:
        """The mean of a variable, counted from its point, (d,)."""
        clique = self.homes[variable]
        begin = clique.first[clique.pivots.index(variable)]
        return self.means[clique.lead][begin : begin + self.sizes[variable]]

    def mean(self, variable: int) -> Array:
        """The mean of a variable, (d,)."""
        found: Array = self.points[variable] + self.distance(variable)
        return found

    def holding(self, variables: Iterable[int]) -> list[Clique]:
        """The cliques that hold any of some variables."""
        found: dict[int, Clique] = {}
        for variable in variables:
            waiting = [self.homes[variable]]
            while waiting:
                clique = waiting.pop()
                found[clique.lead] = clique
                waiting += [child for child, _ in clique.children if variable in child.separators]
        return list(found.values())

    def upwards(self, cliques: Iterable[Clique]) -> dict[int, Clique]:
        """Some cliques, and all above them, by their leads."""
        found: dict[int, Clique] = {}
        for clique in cliques:
            lead = clique.lead
            while lead not in found:
                found[lead] = self.homes[lead]
                lead = self.parents[lead]
                if lead < 0:
                    break
        return found

    @property
    def leads(self) -> list[int]:
        """The leads of all cliques, each after the one above it."""
        every = {clique.lead: clique for clique in self.homes}
        found = [lead for lead in every if self.parents[lead] < 0]
        for lead in found:
            found += [child.lead for child, _ in every[lead].children]
        return found


@dataclass(frozen=True)
class Change:
    """What an update has made: the tree, and what it touched.

    Attributes
    ----------
    tree : Tree
    touched : tuple of int
        The variables that were eliminated anew.
    fronts : int
        The number of cliques that they are in now.
    solved : int
        The number of cliques whose means were found anew.
    """

    tree: Tree
    touched: tuple[int, ...]
    fronts: int
    solved: int


def update(
    tree: Tree,
    touched: Mapping[int, Clique],
    new: Sequence[int],
    more: Sequence[int],
    rows: Mapping[int, Rows],
    last: set[int],
    limit: float,
    tolerance: float,
    machine: bool,
) -> Change:
    """The tree with some cliques eliminated anew, together with new variables and factors.

    Parameters
    ----------
    tree : Tree
        Already with the points, sizes and factors that are new, or have changed.
    touched : mapping of int to Clique
        The cliques, and all above them.
    new, more : sequence of int
        The numbers of variables and of factors that no clique has so far.
    rows : mapping of int to Rows
        Rows of factors that were linearised anew.
    last : set of int
        Variables to leave last.
    limit : float
        How far a component may be from the point of a variable in which a CPD is not linear.
    tolerance : float
        How far separators may move without that it is told below.
    machine : bool
        Whether machine code makes rows triangular.
    """
    variables = [*(v for clique in touched.values() for v in clique.pivots), *new]
    factors = [*(f for clique in touched.values() for f in clique.factors), *more]
    hanging = [
        child
        for clique in touched.values()
        for child, _ in clique.children
        if child.lead not in touched
    ]
    kept = tree.rows.replaced(rows)
    size = dict(zip(variables, tree.sizes.some(variables), strict=True))
    scopes = [factor.scope for factor in tree.factors.some(factors)]
    every = [*scopes, *(child.separators for child in hanging)]
    fronts = ordered(variables, list(size.values()), every, last)
    posed = _Posed(fronts, size)
    posed.place(factors, scopes, kept, hanging)
    found = eliminated(posed.fronts, machine=machine)
    if isinstance(found, int):
        raise Undetermined(fronts[found].pivots)
    bends = dict(zip(variables, tree.bends.some(variables), strict=True))
    cliques = [
        _clique(front, one, posed.columns[k], posed.factors[k], size, bends, limit)
        for k, (front, one) in enumerate(zip(fronts, found, strict=True))
    ]
    parents, homes = {}, {}
    for k, (front, clique) in enumerate(zip(fronts, cliques, strict=True)):
        for variable in front.pivots:
            homes[variable] = clique
        if front.parent >= 0:
            above = cliques[front.parent]
            above.children.append((clique, _indices(posed.fronts[k].above)))
            parents[clique.lead] = above.lead
        else:
            parents[clique.lead] = -1
    for child, (front_number, above_columns) in zip(hanging, posed.hung, strict=True):
        cliques[front_number].children.append((child, _indices(above_columns)))
        parents[child.lead] = cliques[front_number].lead
    roots = [clique for front, clique in zip(fronts, cliques, strict=True) if front.parent < 0]
    fresh = {clique.lead for clique in cliques}
    means, moved = _solved(tree, roots, fresh, tolerance)
    grown = replace(
        tree,
        homes=tree.homes.replaced(homes),
        parents=tree.parents.replaced(parents),
        means=tree.means.replaced(means),
        rows=kept,
        moved=tuple(moved),
        cliques=tree.cliques - len(touched) + len(cliques),
    )
    return Change(grown, tuple(variables), len(cliques), len(means))


class _Posed:
    """Fronts as they are eliminated, with the rows that each of them has."""

    def __init__(self, fronts: Sequence[Front], size: dict[int, int]) -> None:
        self.size = size
        self.columns = [columns(front.pivots, front.separators, size) for front in fronts]
        self.front = {v: k for k, front in enumerate(fronts) for v in front.pivots}
        self.factors: list[list[int]] = [[] for _ in fronts]
        self.hung: list[tuple[int, list[int]]] = []
        self.fronts = []
        for k, (pivots, separators, parent) in enumerate(fronts):
            own = sum(size[v] for v in pivots)
            shared = sum(size[v] for v in separators)
            above = spread(separators, self.columns[parent], size) if parent >= 0 else []
            self.fronts.append(Posed(own, own + shared, [], parent, above))

    def place(
        self,
        factors: Sequence[int],
        scopes: Sequence[Sequence[int]],
        rows: Vector[Rows],
        hanging: Sequence[Clique],
    ) -> None:
        """Put rows of factors, and what cliques have left, where their first variable leaves."""
        for factor, scope, own in zip(factors, scopes, rows.some(factors), strict=True):
            k = min(self.front[v] for v in scope)
            self.factors[k].append(factor)
            self.fronts[k].blocks.append((spread(scope, self.columns[k], self.size), own))
        for child in hanging:
            k = min(self.front[v] for v in child.separators)
            where = spread(child.separators, self.columns[k], self.size)
            self.hung.append((k, where))
            if child.left.right.size:
                self.fronts[k].blocks.append((where, child.left))


def _clique(
    front: Front,
    found: Found,
    column: dict[int, int],
    factors: Sequence[int],
    size: dict[int, int],
    bends: dict[int, bool],
    limit: float,
) -> Clique:
    own = len(found.triangle)
    solved, _ = dtrtrs(found.triangle[:, :own], found.triangle[:, own:])
    solved[:, :-1] *= -1.0
    limits = [limit if bends[v] else np.inf for v in front.pivots for _ in range(size[v])]
    return Clique(
        tuple(front.pivots),
        tuple(front.separators),
        tuple(column[v] for v in front.pivots),
        tuple(factors),
        found.triangle,
        np.ascontiguousarray(solved),
        found.left,
        np.array(limits),
    )


def _solved(
    tree: Tree, roots: Iterable[Clique], fresh: set[int], tolerance: float
) -> tuple[dict[int, Array], list[int]]:
    """The means of cliques from the roots down, by lead, and the variables beyond their limits.

    Cliques that are not `fresh` have their means found again where a separator has moved by more
    than `tolerance` since they were found last.
    """
    none = np.zeros(0, dtype=np.intp)
    found: dict[int, Array] = {}
    moved: list[int] = []
    waiting = [(root, np.zeros(0), none) for root in roots]
    while waiting:
        clique, parent, above = waiting.pop()
        known = parent[above]
        own, lead = len(clique.triangle), clique.lead
        if lead not in fresh:
            before = tree.means[lead][own:]
            if abs(known - before).max() <= tolerance:
                continue
        solved = clique.solved
        pivots = solved[:, -1] + solved[:, :-1] @ known
        mean = found[lead] = np.concatenate([pivots, known])
        if (abs(pivots) > clique.limits).any():
            moved += _beyond(clique, pivots)
        waiting += [(child, mean, at) for child, at in clique.children]
    return found, moved


def _beyond(clique: Clique, pivots: Array) -> list[int]:
    far = np.flatnonzero(np.abs(pivots) > clique.limits)
    which = np.searchsorted(clique.first, far, side="right") - 1
    return [clique.pivots[k] for k in dict.fromkeys(which.tolist())]


def _indices(found: list[int]) -> Integers:
    return np.array(found, dtype=np.intp)
