"""The hidden components of a network, where each of them stands, and the CPDs in groups.

The components of all hidden variables make one vector, (size,), and the *place* of a component is
its index there; its *column* is its index in the scope of a cluster. A *group* is made of the CPDs
of one plate (`pgm.cpds.plates`), or of copies of one at the steps of an unrolled chain, that have
evidence for the same of their variables. The factors of CPDs, with their matrices A, are those of
`assembly`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, groupby
from typing import Any, TypeVar

import numpy as np

from pgm.beliefs.gaussian.assembly import Assembly, Given
from pgm.beliefs.gaussian.blocks import Blocks
from pgm.clustergraph import ClusterGraph
from pgm.cpds import CPD, ConditionalGaussian
from pgm.cpds.plates import plate
from pgm.factors.scope import Scope, dimension
from pgm.kernels.arrays import Integers, Mask
from pgm.linearisation.family import Family
from pgm.schedules.rounds import Directed
from pgm.variables import Variable

T = TypeVar("T")


def knowing(graph: ClusterGraph) -> list[tuple[CPD, list[Variable]]]:
    """The CPDs some of whose parents must have evidence, with these parents, parents first.

    They are inputs of the network, and the parents that a noise depends on.
    """
    return graph.derived(_knowing)


def _knowing(graph: ClusterGraph) -> list[tuple[CPD, list[Variable]]]:
    inputs = set(graph.network.inputs)
    every = ((cpd, cpd.noise_given) for cpd in graph.network.cpds)
    found = ((cpd, [v for v in cpd.parents if v in inputs or v in noisy]) for cpd, noisy in every)
    return [(cpd, known) for cpd, known in found if known]


def robust(graph: ClusterGraph) -> list[ConditionalGaussian]:
    """The CPDs of robust noise."""
    return graph.derived(_robust)


def _robust(graph: ClusterGraph) -> list[ConditionalGaussian]:
    cpds = (cpd for cpd in graph.network.cpds if isinstance(cpd, ConditionalGaussian))
    return [cpd for cpd in cpds if cpd.noise is not None]


def barren(graph: ClusterGraph, evidence: Collection[Variable]) -> frozenset[Variable]:
    """The variables to leave out of inference, because a CPD lacks evidence that it needs.

    A CPD needs evidence of those parents that are inputs, or that its noise depends on; one of
    robust noise, of its child. Without it the CPD's child is left out, unless it is observed; a
    parent is left out too if it is an input that has none. But a variable stays if any variable
    that is not left out, observed or not, depends on it. `evidence` are the variables with
    evidence.
    """
    lacking = {
        cpd.child: missing
        for cpd, known in knowing(graph)
        if (missing := [v for v in known if v not in evidence])
    }
    for weighed in robust(graph):
        if weighed.child not in evidence:
            lacking.setdefault(weighed.child, [])
    if not lacking:
        return frozenset()
    network = graph.network
    inputs = set(network.inputs)
    used = {v for cpd in network.cpds if cpd.child in evidence for v in cpd.parents}
    absent: set[Variable] = set()
    for cpd in reversed(network.cpds):
        if cpd.child in lacking and cpd.child not in evidence and cpd.child not in used:
            absent.add(cpd.child)
            absent.update(v for v in lacking[cpd.child] if v in inputs)
        else:
            used.update(cpd.parents)
    return frozenset(absent - used)


def _plates(graph: ClusterGraph) -> list[tuple[Integers, Integers]]:
    """The plates of a graph's CPDs: their numbers (rows,), and the places of their families.

    A family is the child, then the parents, (rows, 1 + parents), by their places in the network.
    """
    alike: dict[Hashable, list[int]] = {}
    network = graph.network
    for number, cpd in enumerate(network.cpds):
        assert isinstance(cpd, ConditionalGaussian)
        alike.setdefault(plate(cpd), []).append(number)
    return [
        (np.array(numbers), np.array([network._families[number] for number in numbers]))
        for numbers in alike.values()
    ]


@dataclass(frozen=True, eq=False)
class Group:
    """CPDs of one plate in which the same parents are hidden; they are linearised together.

    Each CPD is a row of the arrays. `hidden` are the hidden parents of the first of `cpds`;
    `observed` says whether the children have evidence. `child` (rows, d) has the places of the d
    components of each child, and is (rows, 0) if the children are observed. `parents` (rows, n) has
    the places of the n components of each CPD's hidden parents, `clusters` (rows,) the number of
    the cluster that each CPD is assigned to. `families` is a cache, by axes of runs, of what does
    not depend on evidence.
    """

    cpds: tuple[ConditionalGaussian, ...]
    hidden: Scope
    observed: bool
    child: Integers
    parents: Integers
    clusters: Integers
    families: dict[tuple[int, ...], Family] = field(default_factory=dict, repr=False)

    @property
    def places(self) -> Integers:
        """The places of the columns of each CPD's matrix A: of the child's, then the parents'."""
        return np.concatenate([self.child, self.parents], axis=1)

    @property
    def height(self) -> int:
        """The number of rows of the matrix A of each CPD: the components of its child."""
        return self.cpds[0].child.dimension

    @property
    def width(self) -> int:
        """The number of columns of the matrix A of each CPD.

        They are the components of its hidden parents, and of its child if that is hidden.
        """
        return int(self.child.shape[1] + self.parents.shape[1])

    def shape(self) -> tuple[bool, int, int]:
        """The triple `observed`, `height` and `width`, equal for groups whose factors stack."""
        return self.observed, self.height, self.width


@dataclass(frozen=True, eq=False)
class Layout:
    """The layout of a cluster graph's hidden components: their places, columns, and CPD groups.

    Variables that are `observed`, and those that are `absent` because `barren` leaves them out,
    have no places. A layout is made once for each set of observed variables, and kept with the
    graph. One that is `anchored` has, beside the CPDs' factors, those of an `Anchor`: a measurement
    of each hidden component, by which steps are controlled.
    """

    graph: ClusterGraph
    observed: frozenset[Variable]
    absent: frozenset[Variable]
    anchored: bool = False

    def derived(self, kind: Hashable, make: Callable[[], T], *key: Hashable) -> T:
        """The result of `make`, which hangs on the layout, kind and key alone; made once."""
        if (kind, key) not in self._derived:
            self._derived[kind, key] = make()
        found: T = self._derived[kind, key]
        return found

    @cached_property
    def _derived(self) -> dict[Hashable, Any]:
        return {}

    @cached_property
    def hidden(self) -> Scope:
        """The variables neither observed nor absent, parents before children."""
        return self.without_evidence(self.graph.network.variables)

    @cached_property
    def places(self) -> dict[Variable, Integers]:
        """For each hidden variable the places of its components, (d,)."""
        every = np.arange(self.size)
        return {v: every[a : a + v.dimension] for v, a in self.starts.items()}

    @cached_property
    def starts(self) -> dict[Variable, int]:
        """For each hidden variable the place of its first component."""
        ends = accumulate((v.dimension for v in self.hidden), initial=0)
        return dict(zip(self.hidden, ends, strict=False))

    @cached_property
    def size(self) -> int:
        """Number of hidden components."""
        return dimension(self.hidden)

    def components(self, scope: Scope) -> Integers:
        """The places of some hidden variables' components, one after another, (n,)."""
        if not scope:
            return np.zeros(0, dtype=np.intp)
        return np.concatenate([self.places[v] for v in scope])

    def without_evidence(self, scope: Scope) -> Scope:
        """The hidden variables of a scope, in its order."""
        return tuple(v for v in scope if v not in self.observed and v not in self.absent)

    @cached_property
    def scopes(self) -> list[Scope]:
        """The hidden variables of each cluster."""
        return [self.without_evidence(cluster.scope) for cluster in self.graph.clusters]

    @cached_property
    def blocks(self) -> Blocks:
        """The hidden components of each cluster, in the order of its scope."""
        sizes = np.array([dimension(scope) for scope in self.scopes], dtype=np.intp)
        places = [self.places[v] for scope in self.scopes for v in scope]
        none = np.zeros(0, dtype=np.intp)
        return Blocks(self.size, sizes, np.concatenate([none, *places]))

    @cached_property
    def columns(self) -> list[dict[int, int]]:
        """For each cluster a map from the place of each component that it holds to its column."""
        return [
            {int(place): k for k, place in enumerate(self.components(scope))}
            for scope in self.scopes
        ]

    @cached_property
    def directed(self) -> Directed:
        """The numbered messages of the graph, two for each sepset."""
        return Directed.of(self.graph)

    @cached_property
    def sepsets(self) -> list[Scope]:
        """The hidden variables of each edge's sepset."""
        return [self.without_evidence(scope) for scope in self.graph.sepsets.values()]

    @property
    def _cpds(self) -> Iterator[ConditionalGaussian]:
        """The CPDs of the network, save those of `absent` variables."""
        for cpd in self.graph.network.cpds:
            assert isinstance(cpd, ConditionalGaussian)
            if cpd.child not in self.absent:
                yield cpd

    @cached_property
    def groups(self) -> list[Group]:
        """The groups of CPDs, sorted by the shape of their factors."""
        place = self.graph.network._places
        first, observed, absent = (
            np.zeros(len(place), dtype=np.intp),
            *np.zeros((2, len(place)), bool),
        )
        observed[[place[v] for v in self.observed if v in place]] = True
        absent[[place[v] for v in self.absent]] = True
        first[[place[v] for v in self.hidden]] = list(self.starts.values())
        home = np.zeros(len(self.graph.network.cpds), dtype=np.intp)
        for cluster, own in enumerate(self.graph._assigned):
            home[list(own)] = cluster
        found = []
        for numbers, families in self.graph.derived(_plates):
            numbers, families = (part[~absent[families[:, 0]]] for part in (numbers, families))
            # Rows in which the same variables are observed are one group.
            known = observed[families]
            for row in np.unique(known, axis=0):
                alike = (known == row).all(axis=1)
                found.append(
                    (numbers[alike], self._group(numbers[alike], families[alike], row, first, home))
                )
        found.sort(key=lambda each: (each[1].shape(), each[0][0]))
        return [group for _, group in found]

    def _group(
        self, numbers: Integers, families: Integers, known: Mask, first: Integers, home: Integers
    ) -> Group:
        """The group of some CPDs of a plate, by their numbers in the network.

        `families` are the places, in the network, of each child and its parents, of which those
        that are `known` are observed; `first` has where each hidden variable's components begin,
        and `home` the cluster of each CPD.
        """
        every = self.graph.network.cpds
        cpds = tuple([every[number] for number in numbers.tolist()])
        sizes = [v.dimension for v in (cpds[0].child, *cpds[0].given)]
        columns = [
            first[families[:, k], None] + np.arange(size)
            for k, (size, seen) in enumerate(zip(sizes, known, strict=False))
            if not seen
        ]
        none = np.zeros((len(cpds), 0), dtype=np.intp)
        child, parents = (none, columns) if known[0] else (columns[0], columns[1:])
        return Group(
            cpds,
            self.without_evidence(cpds[0].given),
            bool(known[0]),
            child,
            np.concatenate([none, *parents], axis=1),
            home[numbers],
        )

    @cached_property
    def assembly(self) -> Assembly:
        """The factors of all groups, and those of an anchor after them: one for each place."""
        if not self.anchored:
            return Assembly(self.size, self.groups)
        anchors = Given(np.arange(self.size)[:, None], self.blocks.homes[0])
        return Assembly(self.size, [*self.groups, anchors])

    @cached_property
    def shapes(self) -> list[list[int]]:
        """The indices of all groups, in lists of groups whose factors have the same shape."""
        every = groupby(enumerate(self.groups), lambda item: item[1].shape())
        return [[k for k, _ in alike] for _, alike in every]

    @cached_property
    def order(self) -> list[tuple[int, int]]:
        """All CPDs, parents before children: pairs of a group's number and a copy's row in it.

        They are in the order of a depth-first search from the observed and the childless variables:
        a parent comes just before the child that needs it first, so that few components are needed
        at once.
        """
        where = {
            cpd.child: (g, row)
            for g, group in enumerate(self.groups)
            for row, cpd in enumerate(group.cpds)
        }
        parents = {
            cpd.child: [v for v in cpd.given if v not in self.observed] for cpd in self._cpds
        }
        needed = {v for found in parents.values() for v in found}
        stack = [v for v in reversed(parents) if v in self.observed or v not in needed]
        done: dict[Variable, None] = {}
        while stack:
            waiting = [v for v in parents[stack[-1]] if v not in done]
            if waiting:
                stack.extend(reversed(waiting))
            else:
                done[stack.pop()] = None
        return [where[child] for child in done]
