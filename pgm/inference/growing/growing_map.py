"""A map to which variables and CPDs are added while a robot drives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from importlib.util import find_spec
from typing import Any, Never

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_mapping, is_number, is_whole
from pgm.compile.machine import Choice, as_choice
from pgm.cpds import CPD
from pgm.display import Shown, Summary
from pgm.errors import EvidenceError, ModelError, NumericalError
from pgm.evidence import Evidence, UnknownVariable
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, as_scope, listed, unknown_name
from pgm.immutable import Immutable
from pgm.inference.growing.added import Added, Contents
from pgm.inference.growing.association import Association, BySighting
from pgm.inference.growing.clique_tree import CliqueTree
from pgm.inference.growing.covariances import Covariances
from pgm.inference.growing.factors import Factor, linearised
from pgm.inference.growing.growth import Growth
from pgm.inference.growing.means import Means, everywhere
from pgm.inference.growing.sightings import OpenSightings
from pgm.inference.growing.tree import Change, Point, Tree, Undetermined, update
from pgm.kernels.arrays import Array, deviation
from pgm.linearisers import TAYLOR, Lineariser, Taylor
from pgm.networks import BayesianNetwork
from pgm.posteriors.posterior import alike, require_one_list
from pgm.resources import uncollected
from pgm.schedules.starting_points import Start
from pgm.variables import Discrete, Variable

# Cliques that NumPy has eliminated, from which on machine code pays, which takes a second to make,
ENOUGH = 5000
# and cliques that are eliminated at once, from which on a call of it does.
SEVERAL = 3
# Attributes that a map has of the one before.
_KEPT = "lineariser", "threshold", "every", "tolerance", "compiled", "associations"


@public
class GrowingMap(Shown, Immutable):
    """The belief in a network without time that grows by a few variables and CPDs at once.

    An addition costs what it changes, not what there is. Variables stand in a tree of cliques
    (Kaess et al., 2012, iSAM2): a new CPD touches the cliques on the way from its variables to the
    root, which are eliminated anew, by Householder's reflections; what hangs below keeps its rows.
    Means are found where they are asked for, and all of them at each twentieth addition: variables
    that have moved by more than `threshold` since their CPDs were linearised have these linearised
    anew then, which touches every clique that holds one. Below what hardly moves means stay. So the
    belief is that of Gauss–Newton's last step, or of an earlier one for variables within the
    threshold; `settled` goes on to the end.

    Maps are values: `add` returns another one, which shares with this one all that did not change.

    Parameters
    ----------
    lineariser : Taylor
        Rules that take more of a belief than its mean are refused.
    threshold : float
        How far the mean of any component may be from where CPDs are linearised, in the component's
        own units (metres, radians), 0 or more. It matters for variables in which some CPD is not
        linear.
    every : int
        At each so many additions variables beyond the threshold are linearised anew, by the means
        before it. 1 or more.
    tolerance : float
        How far the separators of a clique may move, as a vector, without that its means are found
        anew: by about so much means lag behind, also of linear CPDs. 0 or more.
    compiled : bool, optional
        Whether rows are made triangular by machine code (llvmlite), which is made in a second, once
        a process. If not given, after the first thousands of cliques.

    Attributes
    ----------
    touched, relinearised : tuple of Variable
        The hidden variables that the last addition eliminated anew, new ones among them; and those
        whose CPDs it linearised again, as they had moved.
    status : Growth
        How large the map is, and how much of it the last addition touched.
    associations : mapping of Variable to Association
        By sighting of the last addition that left open which landmark it was of, the landmark that
        it was taken for.

    Raises
    ------
    ModelError
        If an argument is of a wrong kind.
    ImportError
        If ``compiled=True`` and llvmlite is missing.

    Examples
    --------
    >>> here, there, seen = pgm.variables("here there seen")
    >>> grown = pgm.GrowingMap()
    >>> grown = grown.add([pgm.GaussianCPD(here, 0.0, 1.0)])
    >>> first = grown.add([pgm.LinearGaussianCPD(there, given={here: 1.0}, cov=3.0)])
    >>> grown = first.add([pgm.LinearGaussianCPD(seen, given={there: 1.0}, cov=4.0)], {seen: 2.0})
    >>> grown[there].mean, first[there].mean
    (array([1.]), array([0.]))
    """

    lineariser: Lineariser
    threshold: float
    every: int
    tolerance: float
    compiled: Choice
    touched: Scope
    relinearised: Scope
    status: Growth
    associations: Mapping[Variable, Association]
    _tree: Tree
    _contents: Contents
    _by_numpy: int
    # How many additions ago variables were linearised anew.
    _turn: int

    def __init__(
        self,
        lineariser: Lineariser = TAYLOR,
        threshold: float = 0.1,
        *,
        every: int = 20,
        tolerance: float = 1e-3,
        compiled: bool | None = None,
    ) -> None:
        if not isinstance(lineariser, Taylor):
            raise ModelError(
                f"GrowingMap linearises at means, by pgm.Taylor(); found {lineariser!r}: add all, "
                "then give `network` and `evidence` to pgm.infer with it"
            )
        for name, value in (("threshold", threshold), ("tolerance", tolerance)):
            if not is_number(value) or not value >= 0.0:
                raise ModelError(
                    f"GrowingMap: {name}={value!r}; a number was due, 0 or more, in the units of "
                    "the variables' components"
                )
        if not is_whole(every) or every < 1:
            raise ModelError(f"GrowingMap: every={every!r}; a whole number was due, from 1 on")
        self._set(
            lineariser=lineariser,
            threshold=float(threshold),
            every=int(every),
            tolerance=float(tolerance),
            compiled=as_choice(compiled, f"GrowingMap(compiled={compiled!r})"),
            _turn=0,
            associations=BySighting({}),
        )
        self._put(Change(Tree(), (), 0), Contents.empty(), (), 0)

    def _put(
        self, change: Change, contents: Contents, relinearised: Sequence[int], by_numpy: int
    ) -> None:
        named = contents.variables
        self._set(
            touched=tuple(named.some(change.touched)),
            relinearised=tuple(named.some(relinearised)),
            status=Growth(
                len(contents.numbers),
                len(contents.cpds),
                change.tree.cliques,
                len(change.touched),
                len(relinearised),
                change.fronts,
            ),
            _tree=change.tree,
            _contents=contents,
            _by_numpy=by_numpy,
        )

    def add(
        self,
        cpds: CPD | Iterable[CPD],
        evidence: Evidence | None = None,
        *,
        start: Start | None = None,
    ) -> GrowingMap:
        """The map with more CPDs, and so their children.

        Parameters
        ----------
        cpds : CPD or iterable of CPD
            In any order: priors of new variables, flat ones (``cov=np.inf``) too, motions given
            variables of before, and measurements. Gaussian, with noise in each direction.
        evidence : mapping of Variable to array_like, optional
            Values (d,) of children of these CPDs, and of parents that no CPD explains; these are
            kept for CPDs to come. NaN is a component that was not measured. A parent m of sensors'
            CPDs may be left open, ``{m: pgm.unknown([l0, l1, ...], gate=0.999)}``: see below.
        start : mapping of Variable to array_like, optional
            Means (d,) of new hidden variables, at which CPDs are linearised first. Without, it is
            the prior's mean, or the CPD's value at the means of its parents.

        Returns
        -------
        GrowingMap

        Notes
        -----
        Each CPD with an open parent m is one sighting of one of the candidates, hidden variables of
        the map. All other CPDs are added first. A sighting z of p, such as a pose, is then given
        the likeliest candidate l_k, by ln w_k + ln N(ν_k; 0, S_k): ν_k is z less the CPD's value at
        the means of p and l_k, and S_k = H P Hᵀ + R takes the joint covariance P of (p, l_k); gate,
        weights, spurious and new sightings are as of `unknown`. With ``association="joint"`` all
        sightings that leave m open are decided together, no landmark being given twice, by the
        joint covariance of all of them. Sightings are added with m replaced by their landmark, as
        if it had been named; m itself is no variable of the map. A sighting of no candidate is not
        added, so that it may be, with a landmark of its own. `associations` tells of each.
        Several open parents are decided one after the other, as their order in `evidence` is. P is
        of CPDs linearised at their points: with a smaller `threshold`, and ``every=1``, candidates
        are judged better.

        Raises
        ------
        ModelError, EvidenceError
            If a CPD's child was added before, a CPD has a kind or noise that a growing map has no
            use for, or evidence is missing or does not fit; if candidates are no hidden variables
            of the map, are to be summed out, or fit in too many ways.
        LinearisationError
            If a function's values are not finite.
        NumericalError
            If what was added leaves a variable open, or candidates cannot be compared.

        References
        ----------
        Neira & Tardós, Data association in stochastic mapping using the joint compatibility test,
        2001; Kaess & Dellaert, Covariance recovery from a square root information matrix for data
        association, 2009.

        Examples
        --------
        >>> x, z = pgm.variables("x z")
        >>> seen = pgm.NonlinearGaussianCPD(z, given=x, function=lambda x: x**2, cov=0.1)
        >>> grown = pgm.GrowingMap(threshold=0.01)
        >>> grown = grown.add([pgm.GaussianCPD(x, 0, np.inf), seen], {z: 4.0}, start={x: 3.0})
        >>> grown[x].mean.round(3), grown.settled()[x].mean.round(3)
        (array([2.167]), array([2.]))
        """
        added = Added.checked(self._contents, cpds, as_mapping(evidence, "evidence"))
        starts = added.starts(self._means, start, self.lineariser)
        turn = (self._turn + 1) % self.every
        tree, moved = (self._tree, {}) if turn else everywhere(self._tree, self.tolerance)
        found = self._grown(added.named, starts, tree, moved, turn)
        found._set(associations=BySighting({}))
        for parent, unknown in added.opened.items():
            found = found._identified(added, parent, unknown)
        return found

    def _grown(
        self,
        added: Added,
        starts: Sequence[Array],
        tree: Tree,
        moved: Mapping[int, Array],
        turn: int,
    ) -> GrowingMap:
        """The map with CPDs whose parents all have names; see `_updated`."""
        new = range(len(tree.points), len(tree.points) + len(added.hidden))
        numbers = dict(zip(added.hidden, new, strict=True))
        factors = added.factors(self._contents, numbers)
        bent = {v for f in factors if f.given.bends for v in f.scope[-len(f.given.parents) :]}
        points = {v: Point(at, v in bent) for v, at in zip(new, starts, strict=True)}
        for v in bent.difference(new):
            if not tree.points[v].bends:
                points[v] = Point(tree.points[v].at, True)
        tree = replace(tree, points=tree.points.replaced(points))
        contents = added.contents(self._contents, numbers)
        return self._updated(tree, contents, new, factors, moved, turn)

    def _identified(self, added: Added, parent: Variable, unknown: UnknownVariable) -> GrowingMap:
        """The map with the sightings that leave one parent open, by what they are taken for."""
        contents, given = self._contents, added.sightings(parent)
        open_ = parent, unknown, given, added.taken, contents.numbers, self._means
        known = added.every
        open_sightings = OpenSightings(*open_, self._covariances)
        taken = open_sightings.associated(known, contents.plates, self.lineariser)
        named = [
            each.naming(parent, landmark)
            for each in given
            if (landmark := taken[each.cpd.child].variable) is not None
        ]
        found = self
        if named:
            found = self._grown(added.part(named, contents), (), self._tree, {}, self._turn)
            touched = tuple(dict.fromkeys((*self.touched, *found.touched)))
            status = found.status._after(self.status, len(touched))
            found._set(touched=touched, relinearised=self.relinearised, status=status)
        found._set(associations=BySighting({**self.associations, **taken}))
        return found

    @public
    def settled(self, iterations: int = 100, tolerance: float = 1e-10) -> GrowingMap:
        """The map with all CPDs linearised anew, again and again, until means stay.

        These are Gauss–Newton's steps over the whole map, each of which costs as much as adding all
        of it. The belief is then what `infer` finds of `network` and `evidence`.

        Parameters
        ----------
        iterations : int
            The most of them.
        tolerance : float
            How far the mean of any component may move in the last of them, in the component's own
            units.

        Returns
        -------
        GrowingMap

        Raises
        ------
        NumericalError
            If means still move after the last step.
        """
        found, every = self, range(len(self._tree.points))
        if not every:
            return self
        moves = dict(zip(every, self._means.distances(every), strict=True))
        most = np.inf
        for _ in range(iterations):
            found = found._updated(found._tree, found._contents, (), (), moves)
            moves = dict(zip(every, found._means.distances(every), strict=True))
            bent = [v for v in every if found._tree.points[v].bends]
            most = max((np.abs(moves[v]).max() for v in bent), default=0.0)
            if most <= tolerance:
                return found
        raise NumericalError(
            f"after {iterations} steps a mean still moves by {most:.3g}; give more "
            "iterations, a larger tolerance, or infer the network with "
            "damping=pgm.LevenbergMarquardt()"
        )

    def _updated(
        self,
        tree: Tree,
        contents: Contents,
        new: Sequence[int],
        more: Sequence[Factor],
        moved: Mapping[int, Array],
        turn: int = 0,
    ) -> GrowingMap:
        """The map after an update of the tree.

        `moved` are the variables to linearise anew, each so far from its point.
        """
        first = new[0] if new else len(tree.points)
        last = {v for factor in more for v in factor.scope}
        seeds = [tree.homes[v] for v in last if v < first]
        touched = tree.upwards([*seeds, *tree.holding(moved)])
        again, kept = list(more), []
        if moved:
            before = zip(moved.items(), tree.points.some(moved), strict=True)
            points = {v: Point(p.at + distance, p.bends) for (v, distance), p in before}
            tree = replace(tree, points=tree.points.replaced(points))
        apart = moved.keys().isdisjoint
        for clique in touched.values():
            if not moved:
                kept += clique.factors
                continue
            for pair in clique.factors:
                if apart(pair[0].scope):
                    kept.append(pair)
                else:
                    again.append(pair[0])
        scope = list(dict.fromkeys(v for factor in again for v in factor.scope))
        at = {v: p.at for v, p in zip(scope, tree.points.some(scope), strict=True)}
        rows = linearised(again, at, contents.known, contents.plates, self.lineariser)
        kept += zip(again, rows, strict=True)
        found: GrowingMap = object.__new__(type(self))
        found._set(**{name: getattr(self, name) for name in _KEPT}, _turn=turn)
        if not touched and not new:
            found._put(Change(tree, (), 0), contents, (), self._by_numpy)
            return found
        machine = self._machine and len(touched) + len(new) >= SEVERAL
        try:
            with uncollected(len(kept)):
                change = update(tree, touched, new, kept, last, self.threshold, machine=machine)
        except Undetermined as open_:
            raise _undetermined(contents.variables.some(open_.variables)) from None
        by_numpy = self._by_numpy + (0 if machine else change.fronts)
        found._put(change, contents, tuple(moved), by_numpy)
        return found

    @property
    def _machine(self) -> bool:
        if self.compiled is not None:
            return bool(self.compiled)
        return self._by_numpy >= ENOUGH and find_spec("llvmlite") is not None

    def __contains__(self, variable: object) -> bool:
        """Whether a variable is a hidden one of the map."""
        return isinstance(variable, Variable) and variable in self._contents.numbers

    __iter__ = None  # else Python would go through places until one is refused

    @property
    def variables(self) -> Scope:
        """The hidden variables, in the order in which they were added."""
        return tuple(self._contents.variables)

    def __getitem__(self, variable: Variable) -> Gaussian:
        """The belief in a hidden variable."""
        number = self._number(variable)
        return Gaussian._make((variable,), self._means.of(number), self._covariances.of(number))

    def means(self, variables: Iterable[Variable], *more: Never) -> Array:
        """The means of several variables of d components each, stacked, (k, d)."""
        require_one_list("means", variables, more)
        numbers = [self._number(v) for v in alike(variables)]
        return np.array(self._means.some(numbers))

    def covs(self, variables: Iterable[Variable], *more: Never) -> Array:
        """The covariances of several variables, each by itself, (k, d, d); see `means`."""
        require_one_list("covs", variables, more)
        return np.array([self._covariances.of(self._number(v)) for v in alike(variables)])

    def stds(self, variables: Iterable[Variable], *more: Never) -> Array:
        """The standard deviations of several variables, (k, d); see `means`."""
        require_one_list("stds", variables, more)
        return deviation(self.covs(variables))

    def joint(self, *variables: Variable) -> Gaussian:
        """The joint belief in some hidden variables, in the order given."""
        scope = as_scope(variables)
        if not scope:
            raise EvidenceError("a joint is of one or more variables; there is none")
        numbers = [self._number(v) for v in scope]
        mean = np.concatenate(self._means.some(numbers))
        return Gaussian._make(scope, mean, self._covariances.joint(numbers))

    def _number(self, variable: Variable) -> int:
        found = self._contents.numbers.get(variable) if isinstance(variable, Variable) else None
        if found is None:
            raise _not_hidden(self._contents, variable)
        return found

    @cached_property
    def _means(self) -> Means:
        return Means(self._tree, self.tolerance)

    @cached_property
    def _covariances(self) -> Covariances:
        return Covariances(self._tree)

    @cached_property
    def cliques(self) -> CliqueTree:
        """The tree of cliques: their variables and CPDs, potentials, messages and beliefs."""
        return CliqueTree(self._means, self._covariances, self._contents, self.touched)

    @property
    def network(self) -> BayesianNetwork:
        """All CPDs so far as a network, to be handed to `compile` and `infer`."""
        return BayesianNetwork(self._contents.cpds)

    @property
    def evidence(self) -> dict[Variable, Array]:
        """All evidence so far, as it was given, (d,) each."""
        return dict(self._contents.evidence)

    @property
    def points(self) -> dict[Variable, Array]:
        """Where the CPDs of each hidden variable are linearised, (d,), as for ``start=``."""
        every = zip(self._contents.variables, self._tree.points, strict=True)
        return {variable: point.at.copy() for variable, point in every}

    @property
    def _title(self) -> str:
        return self.status._title.replace("Growth", type(self).__name__)

    def _summary(self) -> Summary:
        return Summary(self._title, [self.status._last] if self.status.cpds else [])

    def __getstate__(self) -> dict[str, Any]:
        found = super().__getstate__().items()
        return {k: v for k, v in found if k not in ("_means", "_covariances", "cliques")}


def _not_hidden(contents: Contents, variable: Any) -> EvidenceError:
    if isinstance(variable, Variable) and variable in contents.known:
        return EvidenceError(f"{variable!r} has evidence: it is no result", variable=variable)
    if not isinstance(variable, Variable) or isinstance(variable, Discrete):
        return EvidenceError(
            f"results are asked for by variable, not by {variable!r}: grown[x]; of several ask "
            "for grown.joint(a, b)"
        )
    return EvidenceError(
        f"a belief in {variable!r}, {unknown_name(variable, list(contents.variables), 'the map')}",
        variable=variable,
    )


def _undetermined(variables: Sequence[Variable]) -> NumericalError:
    names = listed(variables)
    return NumericalError(
        f"what has been added leaves some direction of {names} open, given the variables that "
        "leave after: add them together with measurements that determine them, or with a prior of "
        "finite variance",
        variable=variables[0],
    )
