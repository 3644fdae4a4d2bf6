"""A map to which variables and CPDs are added while a robot drives."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_mapping, is_number, is_whole
from pgm.compile.machine import Choice, as_choice
from pgm.cpds import CPD, AffineCPD, ConditionalGaussian, GaussianCPD, NonlinearGaussianCPD
from pgm.display import Shown, Summary
from pgm.errors import EvidenceError, ModelError, NumericalError
from pgm.evidence.static import bind_values
from pgm.evidence.values import Evidence
from pgm.factors import Gaussian
from pgm.factors.scope import Scope, as_scope, as_value, listed, one_name_each, unknown_name
from pgm.immutable import Immutable
from pgm.inference.growing.covariances import Covariances
from pgm.inference.growing.factors import Factor, Given, linearised, predicted, probe, whitened
from pgm.inference.growing.registers import Register
from pgm.inference.growing.tree import Change, Point, Tree, Undetermined, update
from pgm.inference.growing.vectors import Vector
from pgm.kernels.arrays import Array, Mask, deviation
from pgm.linearisers import TAYLOR, Lineariser, Taylor
from pgm.networks import BayesianNetwork, checks
from pgm.posteriors.posterior import alike
from pgm.schedules.starting_points import Start
from pgm.variables import Discrete, Variable

# Cliques that NumPy has eliminated, from which on machine code pays, which takes a second to make,
ENOUGH = 5000
# and cliques that are eliminated at once, from which on a call of it does.
SEVERAL = 3
# So few variables are linearised anew at once, also where it is not their turn.
AT_ONCE = 5
_SETTINGS = "lineariser", "threshold", "every", "tolerance", "compiled"


class Growth(NamedTuple):
    """How large a map is, and how much of it the last addition touched.

    Attributes
    ----------
    variables, cpds : int
        Hidden variables, and CPDs, in all.
    cliques : int
        Cliques of the tree.
    touched, relinearised : int
        Hidden variables that the last addition eliminated anew, new ones among them, and those
        whose CPDs it linearised again, since they had moved.
    eliminated, solved : int
        Cliques that it eliminated, and cliques whose means it found anew.
    """

    variables: int
    cpds: int
    cliques: int
    touched: int
    relinearised: int
    eliminated: int
    solved: int


class _Contents(NamedTuple):
    """What has been added so far, in stores that are shared with the maps before."""

    numbers: Register[Variable, int]
    names: Register[str, Variable]
    known: Register[Variable, Array]
    evidence: Register[Variable, Array]
    plates: Register[Hashable, Given]
    children: Register[Variable, None]
    cpds: Vector[CPD]
    variables: Vector[Variable]

    @classmethod
    def empty(cls) -> _Contents:
        """Those of a map without anything."""
        made: list[Register[Any, Any]] = [Register() for _ in range(6)]
        return cls(*made, Vector(), Vector())  # type: ignore[call-arg, arg-type]


@public
class GrowingMap(Shown, Immutable):
    """The belief in a network without time that grows by a few variables and CPDs at once.

    An addition costs what it changes, not what there is. Variables stand in a tree of cliques
    (Kaess et al., 2012, iSAM2): a new CPD touches the cliques on the way from its variables to the
    root, which are eliminated anew, by Householder's reflections. Variables that have moved by more
    than `threshold` since their CPDs were linearised have these linearised anew, which touches
    every clique that holds one. What hangs below keeps its rows, and its means as long as those
    above hardly move. So the belief is that of Gauss–Newton's last step, or of an earlier one for
    variables within the threshold; `settled` goes on to the end.

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
        At each so many additions all variables beyond the threshold are linearised anew; in between
        where they are five or fewer. With 1 it is at each addition, of means before it.
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
    _tree: Tree
    _contents: _Contents
    _by_numpy: int
    # How many additions ago variables were linearised anew.
    _turn: int

    def __init__(
        self,
        lineariser: Lineariser = TAYLOR,
        threshold: float = 0.1,
        *,
        every: int = 10,
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
        )
        self._put(Change(Tree(), (), 0, 0), _Contents.empty(), (), 0)

    def _put(
        self, change: Change, contents: _Contents, relinearised: Sequence[int], by_numpy: int
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
                change.solved,
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
            kept for CPDs to come. NaN is a component that was not measured.
        start : mapping of Variable to array_like, optional
            Means (d,) of new hidden variables, at which CPDs are linearised first. Without, it is
            the prior's mean, or the CPD's value at the means of its parents.

        Returns
        -------
        GrowingMap

        Raises
        ------
        ModelError, EvidenceError
            If a CPD's child was added before, a CPD has a kind or noise that a growing map has no
            use for, or evidence is missing or does not fit.
        LinearisationError
            If a function's values are not finite.
        NumericalError
            If what was added leaves a variable open.

        Examples
        --------
        >>> x, z = pgm.variables("x z")
        >>> seen = pgm.NonlinearGaussianCPD(z, given=x, function=lambda x: x**2, cov=0.1)
        >>> grown = pgm.GrowingMap(threshold=0.01)
        >>> grown = grown.add([pgm.GaussianCPD(x, 0, np.inf), seen], {z: 4.0}, start={x: 3.0})
        >>> grown[x].mean.round(3), grown.settled()[x].mean.round(3)
        (array([2.167]), array([2.]))
        """
        added = _Added.checked(self._contents, cpds, as_mapping(evidence, "evidence"))
        starts = added.starts(self._tree, start, self.lineariser)
        tree = self._tree
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
        turn = (self._turn + 1) % self.every
        moved = () if turn and len(tree.moved) > AT_ONCE else tree.moved
        return self._updated(tree, contents, new, factors, moved, self.tolerance, turn)

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
        found = self
        for _ in range(iterations):
            tree = found._tree
            every = range(len(tree.points))
            if not every:
                return found
            found = found._updated(tree, found._contents, (), (), every, 0.0)
            tree = found._tree
            moves = [np.abs(tree.distance(v)).max() for v in every if tree.points[v].bends]
            if max(moves, default=0.0) <= tolerance:
                return found
        raise NumericalError(
            f"after {iterations} steps a mean still moves by {max(moves):.3g}; give more "
            "iterations, a larger tolerance, or infer the network with "
            "damping=pgm.LevenbergMarquardt()"
        )

    def _updated(
        self,
        tree: Tree,
        contents: _Contents,
        new: Sequence[int],
        more: Sequence[Factor],
        moved: Sequence[int],
        tolerance: float,
        turn: int = 0,
    ) -> GrowingMap:
        """The map after an update of the tree; `moved` are variables to linearise anew."""
        first = new[0] if new else len(tree.points)
        last = {v for factor in more for v in factor.scope}
        seeds = [tree.homes[v] for v in last if v < first]
        touched = tree.upwards([*seeds, *tree.holding(moved)])
        again, kept = list(more), []
        if moved:
            moves = {v: Point(tree.mean(v), tree.points[v].bends) for v in moved}
            tree = replace(tree, points=tree.points.replaced(moves))
        apart = set(moved).isdisjoint
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
        points = {v: p.at for v, p in zip(scope, tree.points.some(scope), strict=True)}
        rows = linearised(again, points, contents.known, contents.plates, self.lineariser)
        kept += zip(again, rows, strict=True)
        found: GrowingMap = object.__new__(type(self))
        found._set(**{name: getattr(self, name) for name in _SETTINGS}, _turn=turn)
        if not touched and not new:
            found._put(Change(tree, (), 0, 0), contents, (), self._by_numpy)
            return found
        machine = self._machine and len(touched) + len(new) >= SEVERAL
        limits = self.threshold, tolerance
        try:
            change = update(tree, touched, new, kept, last, *limits, machine=machine)
        except Undetermined as open_:
            raise _undetermined(contents.variables.some(open_.variables)) from None
        by_numpy = self._by_numpy + (0 if machine else change.fronts)
        found._put(change, contents, moved, by_numpy)
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
        return Gaussian._make((variable,), self._tree.mean(number), self._covariances.of(number))

    def means(self, variables: Iterable[Variable]) -> Array:
        """The means of several variables of d components each, stacked, (k, d)."""
        return np.array([self._tree.mean(self._number(v)) for v in alike(variables)])

    def covs(self, variables: Iterable[Variable]) -> Array:
        """The covariances of several variables, each by itself, (k, d, d); see `means`."""
        return np.array([self._covariances.of(self._number(v)) for v in alike(variables)])

    def stds(self, variables: Iterable[Variable]) -> Array:
        """The standard deviations of several variables, (k, d); see `means`."""
        return deviation(self.covs(variables))

    def joint(self, *variables: Variable) -> Gaussian:
        """The joint belief in some hidden variables, in the order given."""
        scope = as_scope(variables)
        if not scope:
            raise EvidenceError("a joint is of one or more variables; there is none")
        numbers = [self._number(v) for v in scope]
        mean = np.concatenate([self._tree.mean(number) for number in numbers])
        return Gaussian._make(scope, mean, self._covariances.joint(numbers))

    def _number(self, variable: Variable) -> int:
        found = self._contents.numbers.get(variable) if isinstance(variable, Variable) else None
        if found is None:
            raise _not_hidden(self._contents, variable)
        return found

    @cached_property
    def _covariances(self) -> Covariances:
        return Covariances(self._tree)

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
        hidden, cpds = len(self._contents.numbers), len(self._contents.cpds)
        return (
            f"GrowingMap({hidden} hidden variable{'s' * (hidden != 1)}, "
            f"{cpds} CPD{'s' * (cpds != 1)}, {self._tree.cliques} cliques)"
        )

    def _summary(self) -> Summary:
        grown = self.status
        if not grown.cpds:
            return Summary(self._title)
        return Summary(
            self._title,
            [
                f"last added: {grown.touched} variables touched, {grown.eliminated} cliques "
                f"eliminated, {grown.relinearised} variables relinearised, means of "
                f"{grown.solved} cliques found anew"
            ],
        )

    def __getstate__(self) -> dict[str, Any]:
        return {k: v for k, v in super().__getstate__().items() if k != "_covariances"}


class _Added(NamedTuple):
    """CPDs that are added, checked, parents first, with their hidden children."""

    cpds: Sequence[ConditionalGaussian]
    evidence: Mapping[Variable, Any]
    known: Mapping[Variable, Array]
    taken: Mapping[Variable, Mask | None]
    given: Sequence[Given]
    hidden: Sequence[Variable]
    before: _Contents

    @classmethod
    def checked(
        cls, contents: _Contents, cpds: CPD | Iterable[CPD], evidence: Mapping[Any, Any]
    ) -> _Added:
        """What is added to a map; what does not fit is refused."""
        found = checks.as_cpds(cpds, "what is added to a growing map")
        checks.one_cpd_each(found)
        checks.no_step_before(found)
        for cpd in found:
            _require_kind(cpd)
            _require_new(contents, cpd)
        scope = dict.fromkeys(v for cpd in found for v in cpd.scope)
        met = (contents.names.get(v.name) for v in scope)
        one_name_each([*(v for v in met if v is not None), *scope])
        children = {cpd.child for cpd in found}
        for variable in evidence:
            _require_open(contents, variable)
        needed = []
        for cpd in found:
            for parent in cpd.parents:
                if parent in evidence or parent in contents.known:
                    continue
                hidden = parent in children or parent in contents.numbers
                if not hidden or parent in cpd.noise_given:
                    needed.append(parent)
        bound = bind_values(found, evidence, needed=needed)
        if bound.lead:
            raise EvidenceError(
                f"a growing map is of one run; evidence has the axes of runs {bound.lead}"
            )
        values = {v: row[0] for v, row in bound.values.items()}
        every = _Both(contents.known, values)
        ordered = checks.in_order(found, lambda cpd: cpd.parents)
        own = [cpd for cpd in ordered if isinstance(cpd, ConditionalGaussian)]
        taken = {v: mask[0] for v, mask in bound.taken.items()}
        given = [Given.of(cpd, every, values.get(cpd.child)) for cpd in own]
        hidden_children = [cpd.child for cpd in own if cpd.child not in values]
        return cls(own, evidence, values, taken, given, hidden_children, contents)

    @property
    def every(self) -> Mapping[Variable, Array]:
        """All values that are known."""
        return _Both(self.before.known, self.known)

    def starts(self, tree: Tree, start: Start | None, lineariser: Lineariser) -> list[Array]:
        """The points of the new hidden variables."""
        told = as_mapping(start, "start")
        for variable in told:
            if variable not in self.hidden:
                raise EvidenceError(
                    f"start has {variable!r}, which is no new hidden variable; "
                    + (f"it takes {listed(self.hidden)}" if self.hidden else "there is none"),
                    variable=variable if isinstance(variable, Variable) else None,
                )
        found: dict[Variable, Array] = {}
        numbers = self.before.numbers
        for each in self.given:
            cpd, child = each.cpd, each.cpd.child
            if each.key not in self.before.plates:
                probe(each, self.every, lineariser)
            if each.reading is not None:
                continue
            if child in told:
                found[child] = _start(child, told[child])
            elif isinstance(cpd, GaussianCPD):
                found[child] = np.array(cpd.mean)
            else:
                at = [found[v] if v in found else tree.mean(numbers[v]) for v in each.parents]
                parents = np.concatenate([np.zeros(0), *at])
                found[child] = predicted(each, parents, self.every, lineariser)
        return [found[variable] for variable in self.hidden]

    def factors(self, contents: _Contents, new: Mapping[Variable, int]) -> list[Factor]:
        """The factors over hidden variables, but for those that say nothing."""
        alike: dict[Hashable, list[Given]] = {}
        for each in self.given:
            if each.parents or each.reading is None:
                alike.setdefault(each.key, []).append(each)
        found = []
        for own in alike.values():
            white = whitened(own, [self.taken.get(each.cpd.child) for each in own], self.every)
            for each, root in zip(own, white, strict=True):
                if root.any():
                    scope = each.parents if each.reading is not None else each.cpd.scope
                    if each.reading is None:
                        scope = (each.cpd.child, *each.parents)
                    numbers = (new[v] if v in new else contents.numbers[v] for v in scope)
                    found.append(Factor(each, tuple(numbers), root))
        return found

    def contents(self, before: _Contents, new: Mapping[Variable, int]) -> _Contents:
        """What the map then contains."""
        scope = dict.fromkeys(v for cpd in self.cpds for v in cpd.scope)
        names = {v.name: v for v in scope if v.name not in before.names}
        plates = {g.key: g for g in reversed(self.given) if g.key not in before.plates}
        kept = {v: np.array(_as_given(value)) for v, value in self.evidence.items()}
        return _Contents(
            before.numbers.extended(new),
            before.names.extended(names),
            before.known.extended(self.known),
            before.evidence.extended(kept),
            before.plates.extended(plates),
            before.children.extended({cpd.child: None for cpd in self.cpds}),
            before.cpds.extended(self.cpds),
            before.variables.extended(new),
        )


class _Both(Mapping[Variable, Array]):
    """The values of a register, and more of them."""

    def __init__(self, before: Register[Variable, Array], more: Mapping[Variable, Array]) -> None:
        self.before, self.more = before, more

    def __getitem__(self, key: Variable) -> Array:
        return self.more[key] if key in self.more else self.before[key]

    def __contains__(self, key: object) -> bool:
        return key in self.more or key in self.before

    def __iter__(self) -> Iterator[Variable]:
        return iter([*self.before, *self.more])

    def __len__(self) -> int:
        return len(self.before) + len(self.more)


def _as_given(value: Any) -> npt.ArrayLike:
    found: npt.ArrayLike = getattr(value, "value", value)
    return found


def _start(variable: Variable, value: npt.ArrayLike) -> Array:
    found = as_value(variable, value, "start")
    if found.ndim > 1:
        raise EvidenceError(
            f"start for {variable!r} has shape {found.shape}; a growing map is of one run, and "
            f"({variable.dimension},) was due",
            variable=variable,
        )
    return np.array(found)


def _require_kind(cpd: CPD) -> None:
    """Refuse a CPD that has no rows of Gaussian noise."""
    if cpd.discrete or not isinstance(cpd, AffineCPD | NonlinearGaussianCPD):
        why = "a growing map takes Gaussian CPDs alone"
    elif cpd.noise is not None:
        why = (
            f"a growing map has no use for its robust noise, {cpd.noise!r}: add it with Gaussian "
            "noise, or infer the network when all is there"
        )
    elif isinstance(cpd, NonlinearGaussianCPD) and not isinstance(cpd.lineariser, Taylor | None):
        why = f"a growing map linearises at means, by pgm.Taylor(), not by {cpd.lineariser!r}"
    elif cpd._lead():
        why = f"it has the axes of runs {cpd._lead()}, and a growing map is of one run"
    else:
        return
    raise ModelError(f"{cpd!r}: {why}", variable=cpd.child, cpd=cpd)


def _require_new(contents: _Contents, cpd: CPD) -> None:
    """Refuse a CPD whose child is there."""
    child = cpd.child
    if child in contents.children:
        raise ModelError(
            f"{cpd!r}: {child!r} was added before, with its CPD; what is read of it now is a "
            "measurement with a name of its own, given it",
            variable=child,
            cpd=cpd,
        )
    if child in contents.known:
        raise ModelError(
            f"{cpd!r}: {child!r} has evidence since before, as a parent; a CPD of it comes with "
            "its evidence or before",
            variable=child,
            cpd=cpd,
        )


def _require_open(contents: _Contents, variable: Variable) -> None:
    """Refuse evidence of a variable that is hidden, or has some."""
    if variable in contents.numbers:
        raise EvidenceError(
            f"evidence for {variable!r}, which was added without: it stays hidden; add a "
            f"measurement of it, LinearGaussianCPD(reading, given={{{variable.name}: 1.0}}, "
            "cov=...)",
            variable=variable,
        )
    if variable in contents.known:
        raise EvidenceError(
            f"evidence for {variable!r}, which has some since before; it is kept", variable=variable
        )


def _not_hidden(contents: _Contents, variable: Any) -> EvidenceError:
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
