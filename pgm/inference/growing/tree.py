"""The tree of cliques of a map, and a tree in which some of them were eliminated anew."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np

from pgm.inference.growing.cliques import Clique, Front, columns, ordered, spread
from pgm.inference.growing.eliminating import Found, Posed, eliminated
from pgm.inference.growing.factors import Factor
from pgm.inference.growing.vectors import Vector
from pgm.kernels.arrays import Array


class Undetermined(Exception):
    """A front that has no proper belief: the numbers of its variables."""

    def __init__(self, variables: Sequence[int]) -> None:
        super().__init__(variables)
        self.variables = variables


class Point(NamedTuple):
    """Where CPDs of a variable are linearised, (d,), and whether some CPD is not linear in it."""

    at: Array
    bends: bool


class Mean(NamedTuple):
    """The mean of a clique, its pivots' and then its separators', counted from their points.

    The pivots' were found by those of the separators, (size,). `offset` is the clique's, by which
    it is known: a mean outlives its clique, which would keep all below it alive.
    """

    offset: Array
    value: Array


@dataclass(frozen=True, slots=True)
class Tree:
    """The cliques of a map, all of which are shared by the trees that it grows to.

    Variables and factors have numbers, in the order in which they came. A clique is known by the
    number of its first pivot, its *lead*.

    Attributes
    ----------
    points : Vector
        The point of each variable.
    homes : Vector
        The clique that eliminates each variable.
    parents : Vector
        By their leads, the leads of the cliques above cliques; −1 of a root.
    means : Vector
        By their leads, the means of cliques as they were found last; see `solved`. Of a clique
        that has been eliminated since it is another clique's.
    renewed : frozenset of int
        The roots that have been eliminated since.
    cliques : int
        How many cliques there are.
    """

    points: Vector[Point] = field(default_factory=Vector)
    homes: Vector[Clique] = field(default_factory=Vector)
    parents: Vector[int] = field(default_factory=Vector)
    means: Vector[Mean] = field(default_factory=Vector)
    renewed: frozenset[int] = frozenset()
    cliques: int = 0

    def size(self, variable: int) -> int:
        """How many components a variable has."""
        return len(self.points[variable].at)

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

    # Cliques that hold those below them would be pickled one inside the other, to any depth.
    def __getstate__(self) -> dict[str, Any]:
        state = {each.name: getattr(self, each.name) for each in fields(self)}
        cliques = {clique.lead: clique for clique in state.pop("homes")}
        below = {
            lead: [(child.lead, above) for child, above in clique.children]
            for lead, clique in cliques.items()
        }
        means = {lead: self.means.get(lead) for lead in cliques}
        state["means"] = {
            lead: mean.value
            for lead, mean in means.items()
            if mean is not None and mean.offset is cliques[lead].offset
        }
        apart = [replace(clique, children=[]) for clique in cliques.values()]
        return state | {"apart": apart, "below": below}

    def __setstate__(self, state: dict[str, Any]) -> None:
        apart, below = state.pop("apart"), state.pop("below")
        cliques = {clique.lead: clique for clique in apart}
        for lead, children in below.items():
            cliques[lead].children += [(cliques[child], above) for child, above in children]
        homes = {variable: clique for clique in apart for variable in clique.pivots}
        means = {lead: Mean(cliques[lead].offset, value) for lead, value in state["means"].items()}
        state["homes"] = Vector[Clique]().replaced(homes)
        state["means"] = Vector[Mean]().replaced(means)
        for name, value in state.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Change:
    """An update of a map: the tree that it made, and the cliques that it touched.

    Attributes
    ----------
    tree : Tree
    touched : tuple of int
        The variables that were eliminated anew.
    fronts : int
        The number of cliques that they are in now.
    """

    tree: Tree
    touched: tuple[int, ...]
    fronts: int


def update(
    tree: Tree,
    touched: Mapping[int, Clique],
    new: Iterable[int],
    factors: Sequence[tuple[Factor, Array]],
    last: set[int],
    limit: float,
    *,
    machine: bool,
) -> Change:
    """The tree with some cliques eliminated anew, together with new variables and factors.

    Parameters
    ----------
    tree : Tree
        Already with the points that are new, or have changed.
    touched : mapping of int to Clique
        The cliques, and all above them.
    new : iterable of int
        The variables that no clique has so far.
    factors : sequence of pairs
        All factors of the cliques, and new ones, with their rows.
    last : set of int
        Variables to leave last.
    limit : float
        How far a component may be from the point of a variable in which a CPD is not linear.
    machine : bool
        Whether machine code makes rows triangular.
    """
    variables = [v for clique in touched.values() for v in clique.pivots]
    variables += new
    hanging = [
        child
        for clique in touched.values()
        for child, _ in clique.children
        if child.pivots[0] not in touched
    ]
    points = tree.points.some(variables)
    sizes = [len(point.at) for point in points]
    scopes = [factor.scope for factor, _ in factors]
    scopes += [child.separators for child in hanging]
    fronts = ordered(variables, sizes, scopes, last)
    posed = _Posed(fronts, dict(zip(variables, sizes, strict=True)))
    posed.place(factors, hanging)
    found = eliminated(posed.fronts, machine=machine)
    if isinstance(found, int):
        raise Undetermined(fronts[found].pivots)
    limits = {
        v: limit if point.bends else np.inf for v, point in zip(variables, points, strict=True)
    }
    cliques = posed.cliques(found, limits)
    parents, homes = {}, {}
    for front, one, clique in zip(fronts, posed.fronts, cliques, strict=True):
        lead = clique.pivots[0]
        for variable in clique.pivots:
            homes[variable] = clique
        if front.parent >= 0:
            above = cliques[front.parent]
            above.children.append((clique, np.array(one.above)))
            parents[lead] = above.pivots[0]
        else:
            parents[lead] = -1
    for child, (k, columns_above) in zip(hanging, posed.hung, strict=True):
        cliques[k].children.append((child, np.array(columns_above)))
        parents[child.pivots[0]] = cliques[k].pivots[0]
    roots = {clique.lead for front, clique in zip(fronts, cliques, strict=True) if front.parent < 0}
    grown = replace(
        tree,
        homes=tree.homes.replaced(homes),
        parents=tree.parents.replaced(parents),
        renewed=tree.renewed.difference(touched) | roots,
        cliques=tree.cliques - len(touched) + len(cliques),
    )
    return Change(grown, tuple(variables), len(cliques))


class _Posed:
    """Fronts as they are eliminated, with the rows that each of them has."""

    def __init__(self, named: Sequence[Front], size: dict[int, int]) -> None:
        self.named, self.size = named, size
        self.columns = [columns(front.pivots, front.separators, size) for front in named]
        self.front = {v: k for k, front in enumerate(named) for v in front.pivots}
        self.factors: list[list[tuple[Factor, Array]]] = [[] for _ in named]
        self.hung: list[tuple[int, list[int]]] = []
        self.fronts = []
        for front in named:
            own = sum(map(size.__getitem__, front.pivots))
            shared = sum(map(size.__getitem__, front.separators))
            above = []
            if front.parent >= 0:
                above = spread(front.separators, self.columns[front.parent])
            self.fronts.append(Posed(own, own + shared, [], front.parent, above))

    def place(self, factors: Sequence[tuple[Factor, Array]], hanging: Sequence[Clique]) -> None:
        """Put rows of factors, and what cliques have left, where their first variable leaves."""
        front, every = self.front.__getitem__, self.columns
        for pair in factors:
            scope = pair[0].scope
            k = min(map(front, scope))
            self.factors[k].append(pair)
            self.fronts[k].blocks.append((spread(scope, every[k]), pair[1]))
        for child in hanging:
            k = min(map(front, child.separators))
            where = spread(child.separators, every[k])
            self.hung.append((k, where))
            if child.left.size:
                self.fronts[k].blocks.append((where, child.left))

    def cliques(self, found: Sequence[Found], limits: Mapping[int, float]) -> list[Clique]:
        """The cliques that the fronts have become."""
        from scipy.linalg.lapack import dtrtrs  # here, since it is slow to import

        pivots = [v for front in self.named for v in front.pivots]
        counts = [self.size[v] for v in pivots]
        owners = np.repeat(pivots, counts)
        limit = np.repeat([limits[v] for v in pivots], counts)
        made, begin = [], 0
        for front, column, factors, (triangle, left) in zip(
            self.named, self.columns, self.factors, found, strict=True
        ):
            own = len(triangle)
            solved, _ = dtrtrs(triangle[:, :own], triangle[:, own:])
            end = begin + own
            made.append(
                Clique(
                    tuple(front.pivots),
                    tuple(front.separators),
                    tuple(column[v].start for v in front.pivots),
                    factors,
                    triangle,
                    -solved[:, :-1],
                    solved[:, -1].copy(),
                    left,
                    limit[begin:end].copy(),
                    owners[begin:end].copy(),
                )
            )
            begin = end
        return made
