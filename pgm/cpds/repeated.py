"""Plates as users declare them: a CPD, or factor, repeated for many rows of variables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from types import MappingProxyType
from typing import Any, TypeVar, cast

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_floats, as_mapping, as_tuple, is_unordered
from pgm.cpds.base import CPD, naming_factors
from pgm.cpds.conditional import ConditionalGaussian, Noise
from pgm.cpds.gaussian import AffineCPD, GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD
from pgm.cpds.residual import NonlinearGaussianFactor, free_name
from pgm.display import titled
from pgm.errors import ModelError
from pgm.factors.arrays import Shape, as_covariance, covariance_fault, diagonal, symmetrised
from pgm.factors.scope import as_value, described, is_alike, listed, namesake
from pgm.kernels import roots
from pgm.kernels.arrays import Array, frozen
from pgm.resources import uncollected
from pgm.variables import Variable

C = TypeVar("C", bound=ConditionalGaussian | NonlinearGaussianFactor)
K = TypeVar("K", bound=ConditionalGaussian)


@public
def plate(
    cpd: C,
    over: Mapping[Variable, Any],
    *,
    mean: npt.ArrayLike | None = None,
    cov: npt.ArrayLike | None = None,
    offset: npt.ArrayLike | None = None,
    given: Mapping[Variable, npt.ArrayLike] | None = None,
    value: npt.ArrayLike | None = None,
) -> tuple[C, ...]:
    """Many CPDs of one kind, or factors of one function, a row of variables each: a plate.

    They are those that are declared one by one, in about a tenth of the time: the covariances are
    checked as one stack, and nothing is done row by row but to put variables in their places.

    Parameters
    ----------
    cpd : GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD or NonlinearGaussianFactor
        That of any row. Its variables stand for those of the rows, and may be strangers to the
        network.
    over : mapping of Variable to array_like of Variable
        Of the child, and of parents, or of a factor's variables, those of the rows that stand in
        their places: arrays or lists of one shape, (*rows). They have the same components and
        angles. One variable alone, or one other than the child that is left out, is the same in all
        rows; but ``x.previous`` follows x.
    mean, cov, offset : array_like, optional
        Numbers of each row, in place of those of `cpd`: what its kind takes, after the axes of
        the rows. So `cov` is (*rows,), a variance for all components of the row; (*rows, d),
        variances; or (*rows, d, d). What all rows share stands in `cpd`.
    given : mapping of Variable to array_like, optional
        Matrices of each row by parents of `cpd`: (*rows, d, n), or (*rows,) for multiples of I.
    value : array_like, optional
        The value of each row's factor: (*rows, d), or (*rows,) of one component.

    Returns
    -------
    tuple of CPD, or of NonlinearGaussianFactor
        In the order of the rows, the last axis fastest.

    Raises
    ------
    ModelError
        If a variable or a number does not fit, naming the row's CPD.

    References
    ----------
    Buntine (1994), Operations for learning with graphical models, section 2.3; Koller and Friedman
    (2009), Probabilistic Graphical Models, section 6.4.1.

    Examples
    --------
    A field of 100 × 100 pixels, with readings of the difference of neighbours in each row of it:

    >>> names = [f"x{row}_{column}" for row in range(100) for column in range(100)]
    >>> x = np.reshape(pgm.variables(names), (100, 100))
    >>> z = np.reshape(pgm.variables(f"z{k}" for k in range(9900)), (100, 99))
    >>> a, b, d = pgm.variables("a b d")
    >>> pixels = pgm.plate(pgm.GaussianCPD(a, mean=0.0, cov=1.0), {a: x})
    >>> difference = pgm.LinearGaussianCPD(d, given={a: -1.0, b: 1.0}, cov=0.1)
    >>> readings = pgm.plate(difference, {d: z, a: x[:, :-1], b: x[:, 1:]})
    >>> readings[0], readings[-1]
    (LinearGaussianCPD(z0 | x0_0, x0_1), LinearGaussianCPD(z9899 | x99_98, x99_99))
    """
    numbers = {"mean": mean, "cov": cov, "offset": offset, "matrices": given, "values": value}
    told = {name: each for name, each in numbers.items() if each is not None}
    if isinstance(cpd, NonlinearGaussianFactor):
        return cast("tuple[C, ...]", _factors(cpd, over, told))
    known: tuple[type[CPD], ...] = AffineCPD, NonlinearGaussianCPD
    if not isinstance(cpd, known):
        raise ModelError(
            "a plate is of a GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD or "
            f"NonlinearGaussianFactor, not of {titled(cpd)}; declare others one by one"
        )
    if cpd.steps is not None:
        raise ModelError(
            f"a plate stands in a network without time, and {titled(cpd)} has numbers of its own "
            f"at each of the steps 1..{cpd.steps}; give each its matrix, offset= or cov=",
            variable=cpd.child,
            cpd=cpd,
        )
    shape, rows = _rows(cpd, over)
    _Numbers(cpd, shape, rows).take(told)
    return tuple(rows)


def _factors(
    factor: NonlinearGaussianFactor, over: Any, told: Mapping[str, Any]
) -> tuple[NonlinearGaussianFactor, ...]:
    """The factors of a plate: as the CPDs of their residuals, whose messages name the factors."""
    with naming_factors():
        cpd = factor._cpd._copy(lambda variable: variable, _of=factor)
        shape, rows = _rows(cpd, over)
        made = [NonlinearGaussianFactor._made(row, factor.value) for row in rows]
        for row, own in zip(rows, made, strict=True):
            row.__dict__["_of"] = own
        numbers = _Numbers(cpd, shape, rows)
        numbers.take(told)
    for row in rows:  # which a factor holds, and not the other way round
        row.__dict__["_of"] = None
    for own, value in zip(made, numbers.factors, strict=bool(numbers.factors)):
        own.__dict__["value"] = value
    return tuple(made)


def _rows(cpd: K, over: Any) -> tuple[Shape, list[K]]:
    """The shape of a plate's rows, and their CPDs, all with the numbers of the plate's."""
    shape, columns = _columns(cpd, over)
    bare = object.__new__(type(cpd))
    bare.__dict__.update(cpd._bare(), _origin=None)
    scope = cpd.scope
    families = zip(*columns, strict=True)
    with uncollected(len(columns[0])):
        rows = [bare._copy(dict(zip(scope, each, strict=True)).__getitem__) for each in families]
    _require_families(rows, columns)
    return shape, rows


def _columns(cpd: ConditionalGaussian, over: Any) -> tuple[Shape, list[Sequence[Variable]]]:
    """The shape of the rows, and their variables in place of each of the CPD's scope."""
    what = f"plate of {cpd!r}"
    found = as_mapping(over, f"{what}: over", ModelError, cpd=cpd)
    factor = cpd._of is not None  # whose residual no user knows
    family = cpd.parents if factor else cpd.scope
    for key in found:
        if key not in family:
            variable = key if isinstance(key, Variable) else None
            raise ModelError(
                f"{what}: {key!r} is none of its variables ({listed(family)})"
                f"{namesake(key, family)}",
                variable=variable,
                cpd=cpd,
            )
    single = {v: other for v, other in found.items() if isinstance(other, Variable)}
    arrays = {v: _array(cpd, v, each) for v, each in found.items() if v not in single}
    leading = next(iter(arrays), family[0]) if factor else cpd.child
    if leading not in arrays:
        lacks = "variables" if factor else "a child"
        raise ModelError(
            f"{what}: no row has {lacks} of its own; give over={{{leading!r}: [...]}}, a "
            "variable for each row",
            variable=leading,
            cpd=cpd,
        )
    shape = arrays[leading].shape
    for variable, array in arrays.items():
        if array.shape != shape:
            raise ModelError(
                f"{what}: the variables for {variable!r} have shape {array.shape}, and those for "
                f"{leading!r} {shape}; give each the same rows, or one variable for all",
                variable=variable,
                cpd=cpd,
            )
    count = arrays[leading].size
    columns: dict[Variable, Sequence[Variable]] = {v: a.ravel().tolist() for v, a in arrays.items()}
    columns |= {variable: (other,) * count for variable, other in single.items()}
    for variable, column in columns.items():
        _require_alike(cpd, variable, column)
    if factor:
        taken = {v.name for column in columns.values() for v in column}
        own = cpd.child._with(name=free_name(cpd.child.name, taken))
        columns[cpd.child] = (own,) * count
    return shape, [_column(v, columns, count) for v in cpd.scope]


def _array(cpd: ConditionalGaussian, variable: Variable, value: Any) -> npt.NDArray[np.object_]:
    found = value if isinstance(value, np.ndarray) else as_tuple(value)
    if found is None or is_unordered(value):
        raise ModelError(
            f"plate of {cpd!r}: over maps {variable!r} to a list or array of variables, in order, "
            f"or to one variable, not to {value!r}",
            variable=variable,
            cpd=cpd,
        )
    return np.array(found, dtype=object)


def _column(
    variable: Variable, columns: Mapping[Variable, Sequence[Variable]], count: int
) -> Sequence[Variable]:
    """The variables of all rows in place of one of the CPD's."""
    if variable in columns:
        return columns[variable]
    before: Sequence[Variable] = columns.get(variable.template, ()) if variable.lag else ()
    for _ in range(variable.lag if before else 0):
        before = [other.previous for other in before]
    return before or (variable,) * count


def _require_alike(
    cpd: ConditionalGaussian, variable: Variable, column: Sequence[Variable]
) -> None:
    """Refuse variables of other components or angles than those of the CPD's variable."""
    odd = [v for v in column if not isinstance(v, Variable) or not is_alike(v, variable)]
    if not odd:
        return
    first = odd[0]
    what = f"plate of {cpd!r}: in place of {variable!r}, with {described(variable)}, stands"
    if not isinstance(first, Variable):
        raise ModelError(
            f"{what} {first!r}, which is no variable; give variables", variable=variable, cpd=cpd
        )
    raise ModelError(
        f"{what} {first!r}, with {described(first)}; give variables of one kind",
        variable=first,
        cpd=cpd,
    )


def _require_families(
    rows: Sequence[ConditionalGaussian], columns: Sequence[Sequence[Variable]]
) -> None:
    """Refuse rows whose variables are none of a CPD: twice the same, two of one name, or lags."""
    names = [np.array([hash(variable.name) for variable in column]) for column in columns]
    suspect = np.array([child.lag > 0 for child in columns[0]], dtype=bool)
    for one, other in combinations(names, 2):
        suspect |= one == other
    for k in np.flatnonzero(suspect).tolist():
        rows[k]._set_scope(rows[k].child, rows[k].given, rows[k].noise_given)


class _Numbers:
    """The numbers of the rows of a plate, put into its CPDs."""

    def __init__(
        self, cpd: ConditionalGaussian, shape: Shape, rows: Sequence[ConditionalGaussian]
    ) -> None:
        self.cpd, self.shape, self.rows = cpd, shape, rows
        # Values of factors, (d,) each; empty where all have that of the plate's.
        self.factors: Sequence[Array] = ()

    def take(self, told: Mapping[str, Any]) -> None:
        """Take the numbers that are told, by the name of their method."""
        for name, value in told.items():
            getattr(self, name)(value)

    def mean(self, value: npt.ArrayLike) -> None:
        """Take means, (*rows, ..., d)."""
        self._require(GaussianCPD, "mean")
        array = self._array(value, "mean", self.cpd.child.components)
        if array.ndim == 1 and self._size == 1:
            array = array[:, None]
        if array.ndim == 1 or array.shape[-1] != self._size:
            raise self._unfit("mean", array.shape[1:], f"(..., {self._size})")
        if not np.isfinite(array).all():
            for row, each in zip(self.rows, array, strict=True):
                as_value(row.child, each, "mean", cpd=row)
        self._put("offset", array)
        self._require_runs()

    def cov(self, value: npt.ArrayLike) -> None:
        """Take covariances, (*rows), (*rows, d) or (*rows, ..., d, d)."""
        cpd, size = self.cpd, self.cpd.child.dimension
        if isinstance(cpd.cov, Noise):
            raise ModelError(
                f"plate of {cpd!r}: its noise is a function, and cov gives numbers for each row; "
                "leave one of them out",
                variable=cpd.child,
                cpd=cpd,
            )
        prior = isinstance(cpd, GaussianCPD)
        array = self._array(value, "cov")
        own = array.shape[1:]
        if array.ndim == 1:
            array = np.broadcast_to(array[:, None], (len(array), size))
        if array.ndim == 2:
            array = diagonal(array)
        if array.shape[-2:] != (size, size) or (array.ndim > 3 and not prior):
            raise self._unfit("cov", own, f"(), ({size},) or ({size}, {size})")
        array = symmetrised(array)
        covs: Sequence[Array] | Array = array
        if covariance_fault(array):  # or infinite variances, which a prior may have
            covs = [
                as_covariance(
                    (row.child,),
                    each,
                    f"the covariance of {row!r}",
                    runs=prior,
                    flat=prior,
                    variable=row.child,
                    cpd=row,
                )
                for row, each in zip(self.rows, array, strict=True)
            ]
        self._put("cov", covs)
        self._require_runs()
        if cpd.noise is not None and not (roots.root(array).diagonal(0, -2, -1) > 0.0).all():
            for row in self.rows:
                row._set_noise(row.noise)

    def offset(self, value: npt.ArrayLike) -> None:
        """Take offsets, (*rows) or (*rows, d)."""
        self._require(LinearGaussianCPD, "offset")
        array, size = self._array(value, "offset", self.cpd.child.components), self._size
        if array.ndim == 1:
            array = np.broadcast_to(array[:, None], (len(array), size))
        if array.shape[1:] != (size,):
            raise self._unfit("offset", array.shape[1:], f"() or ({size},)")
        self._require_finite(array, "offset")
        self._put("offset", array)

    def matrices(self, given: Any) -> None:
        """Take matrices of parents, (*rows) or (*rows, d, n)."""
        cpd = self.cpd
        self._require(LinearGaussianCPD, "given")
        assert isinstance(cpd, LinearGaussianCPD)
        found = as_mapping(given, f"plate of {cpd!r}: given", ModelError, cpd=cpd)
        for parent in found:
            if parent not in cpd.given:
                raise ModelError(
                    f"plate of {cpd!r}: given has a matrix of {parent!r}, which is none of its "
                    f"parents ({listed(cpd.given)}){namesake(parent, cpd.given)}",
                    variable=parent if isinstance(parent, Variable) else None,
                    cpd=cpd,
                )
        stacks: list[Any] = []
        for parent in cpd.given:
            if parent not in found:
                stacks.append((cpd.matrices[parent],) * len(self.rows))
                continue
            due = self._size, parent.dimension
            what = f"matrix of {parent!r}"
            array = self._array(found[parent], what)
            if array.ndim == 1 and due[0] == due[1]:
                array = diagonal(np.broadcast_to(array[:, None], (len(array), due[0])))
            if array.shape[1:] != due:
                raise self._unfit(what, array.shape[1:], f"{'() or ' * (due[0] == due[1])}{due}")
            self._require_finite(array, what)
            stacks.append(frozen(array))
        with uncollected(len(self.rows)):
            for row, *each in zip(self.rows, *stacks, strict=True):
                matrices = dict(zip(row.given, each, strict=True))
                row.__dict__["matrices"] = MappingProxyType(matrices)

    def values(self, value: npt.ArrayLike) -> None:
        """Take values of factors, (*rows) or (*rows, d)."""
        if self.cpd._of is None:
            raise ModelError(
                f"plate of {self.cpd!r}: value is of a NonlinearGaussianFactor; the child of a CPD "
                "has evidence, in infer",
                variable=self.cpd.child,
                cpd=self.cpd,
            )
        array, size = self._array(value, "value"), self._size
        if array.ndim == 1 and size == 1:
            array = array[:, None]
        if array.shape[1:] != (size,):
            raise self._unfit("value", array.shape[1:], f"{'() or ' * (size == 1)}({size},)")
        self._require_finite(array, "value")
        self.factors = [*frozen(array)]

    @property
    def _size(self) -> int:
        return self.cpd.child.dimension

    def _require(self, kind: type[ConditionalGaussian], what: str) -> None:
        if not isinstance(self.cpd, kind):
            raise ModelError(
                f"plate of {self.cpd!r}: {what} is a number of a {kind.__name__}, and this is "
                f"none; leave it out",
                cpd=self.cpd,
            )

    def _array(self, value: Any, what: str, labels: Sequence[str] = ()) -> Array:
        """A copy of numbers of the rows, (count, ...)."""
        about: dict[str, Any] = {"variable": self.cpd.child, "cpd": self.cpd}
        array = as_floats(value, f"plate of {self.cpd!r}: {what}", labels=labels, **about)
        axes = len(self.shape)
        if array.shape[:axes] != self.shape:
            raise ModelError(
                f"plate of {self.cpd!r}: {what} has shape {array.shape}; its first axes are those "
                f"of the rows, {self.shape}: what all rows share stands in the CPD itself",
                **about,
            )
        return array.reshape(len(self.rows), *array.shape[axes:]).copy()

    def _unfit(self, what: str, own: Shape, due: str) -> ModelError:
        return ModelError(
            f"plate of {self.cpd!r}: {what} has shape {self.shape + own}; behind the axes of the "
            f"rows, {self.shape}, it needs {due}",
            variable=self.cpd.child,
            cpd=self.cpd,
        )

    def _require_finite(self, array: Array, what: str) -> None:
        bad = ~np.isfinite(array).all(axis=tuple(range(1, array.ndim)))
        if bad.any():
            row = self.rows[int(bad.argmax())]
            raise ModelError(
                f"{row!r}: the {what} has entries that are NaN or infinite",
                variable=row.child,
                cpd=row,
            )

    def _require_runs(self) -> None:
        if self.rows:
            try:
                self.rows[0]._lead()
            except ValueError:
                raise ModelError(
                    f"plate of {self.cpd!r}: the axes of runs of the means and of the covariances "
                    "do not broadcast",
                    variable=self.cpd.child,
                    cpd=self.cpd,
                ) from None

    def _put(self, name: str, values: Sequence[Array] | Array) -> None:
        each = frozen(values) if isinstance(values, np.ndarray) else map(frozen, values)
        with uncollected(len(self.rows)):
            for row, value in zip(self.rows, each, strict=True):
                row.__dict__[name] = value
