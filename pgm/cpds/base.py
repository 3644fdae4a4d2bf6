"""The base of all CPDs, and values of a child and its parents as users give them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_generator, as_lengths, as_mapping
from pgm.display import Listing, Shown, Summary, titled
from pgm.errors import ModelError, PgmError
from pgm.factors.arrays import Shape, clash, flat
from pgm.factors.axes import as_known
from pgm.factors.scope import Scope, as_scope, as_value, listed, namesake, one_name_each
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.resources import require_memory
from pgm.variables import Discrete, Variable

# Values (..., d), or indices of states (...).
Values = npt.NDArray[Any]
# From a variable to the one in its place.
Moved = Callable[[Variable], Variable]


@dataclass(frozen=True, eq=False)
class Known:
    """Values (*shape, d) of all parents of a CPD, or indices of states; they broadcast to it.

    `lead` are the axes of runs, those of the CPD itself too, that are flattened to the last of
    `shape`; `step` is for messages.
    """

    values: Mapping[Variable, Values]
    lead: Shape
    shape: Shape
    step: npt.ArrayLike | None


def of_case(rng: np.random.Generator, number: int, which: Integers) -> np.random.Generator:
    """The generator of a CPD's case, which holds at some of the draws (m,), by their flat places.

    Of draws that are counted (`pgm.networks.counted`) each case has its own.
    """
    if isinstance(rng, np.random.Generator):
        return rng
    found: np.random.Generator = rng.of_case(number, which)
    return found


def as_parents(cpd: CPD, given: Any) -> Known:
    """The values of a CPD's parents, checked: none missing, none of another variable."""
    found = as_mapping(given, f"the second argument, parents, of {cpd!r}", ModelError, cpd=cpd)
    for key in found:
        if key not in cpd.parents:
            why = f"which is none of its parents ({listed(cpd.parents)})"
            why += namesake(key, cpd.parents)
            variable = key if isinstance(key, Variable) else None
            advice = "" if variable else "; give the variable itself"
            raise ModelError(
                f"{cpd!r}: a value of {key!r}, {why}{advice}", variable=variable, cpd=cpd
            )
    for parent in cpd.parents:
        if parent not in found:
            raise ModelError(
                f"{cpd!r}: no value of its parent {parent!r}; give one of each of its parents "
                f"({listed(cpd.parents)})",
                variable=parent,
                cpd=cpd,
            )
    arrays = {parent: as_values(cpd, parent, found[parent]) for parent in cpd.parents}
    shapes = [(parent, shape_of(parent, array)) for parent, array in arrays.items()]
    lead = common(cpd, [*shapes, ("the CPD itself", cpd._lead())])
    values = {v: flat(a, lead, 0 if isinstance(v, Discrete) else 1) for v, a in arrays.items()}
    return Known(values, lead, (math.prod(lead),), cpd.child.step)


def as_values(cpd: CPD, variable: Variable, value: Any) -> Values:
    """Values of a variable of a CPD's family, (..., d), or indices of states (...)."""
    if isinstance(variable, Discrete):
        return as_known(variable, value, f"the value of {variable!r} in {cpd!r}", cpd=cpd)
    missing = cpd.partial and variable == cpd.child
    return as_value(variable, value, f"value in {cpd!r}", missing=missing, cpd=cpd)


def shape_of(variable: Variable, values: Values) -> Shape:
    """The leading axes of values of a variable."""
    return values.shape if isinstance(variable, Discrete) else values.shape[:-1]


def common(cpd: CPD, shapes: Sequence[tuple[object, Shape]]) -> Shape:
    """The leading axes that values broadcast to, from whose axes each are, if they fit."""
    try:
        lead = np.broadcast_shapes(*(shape for _, shape in shapes))
    except ValueError:
        raise ModelError(
            f"{cpd!r}: the leading axes of the values do not broadcast: {clash(shapes)}; "
            "give them the same, or 1",
            cpd=cpd,
        ) from None
    require_memory(
        math.prod(lead) * sum(max(v.dimension, 1) for v in cpd.scope),
        f"{cpd!r} at all of {lead} values",
        "give it fewer at a time",
        cpd=cpd,
    )
    return lead


class CPD(Shown, Immutable):
    """The density of a child given its parents; an immutable value.

    In tuples and messages it stands by its title, like ``LinearGaussianCPD(x | u)``; printed, and
    in notebooks, it shows its numbers.

    Attributes
    ----------
    child : Variable
    given : tuple of Variable
        The parents, in the order of the function's arguments or the table's axes.
    origin : CPD
        The CPD of which this one is a copy at another step (see `at`); itself, if of none.
    """

    child: Variable
    given: Scope
    # What kind of variables a CPD is about.
    discrete: ClassVar[bool] = False
    partial: bool = False
    """Whether its density takes readings in which components are NaN, as not measured."""
    steps: int | None = None
    """T, of a CPD with numbers of its own at each of the steps 1..T (see `LinearGaussianCPD`)."""
    _origin: CPD | None = None
    # Of a factor's residual, as which a Markov network is solved, the factor: messages name it.
    _of: Shown | None = None

    def _set_scope(
        self, child: Variable, given: Variable | Iterable[Variable], noise_given: Scope = ()
    ) -> None:
        if not isinstance(child, Variable):
            raise ModelError(f"a CPD's child is a variable, not {child!r}")
        if child.lag:
            raise ModelError(
                f"the child of a CPD cannot be {child!r}: declare it for {child.template!r}",
                variable=child,
            )
        kind = f"{type(self).__name__} of {child!r}: given"
        given = as_scope(given, kind if self._of is None else f"{titled(self._of)}: scope")
        if child in given:
            raise ModelError(
                f"{child!r} is given as its own parent; did you mean {child.name}.previous?",
                variable=child,
            )
        if child in noise_given:
            raise ModelError(
                f"the noise of the CPD of {child!r} depends on {child!r} itself; it can depend on "
                "observed parents alone",
                variable=child,
            )
        one_name_each((child, *given, *noise_given))
        self._require_kinds((child, *given, *noise_given))
        self._set(child=child, given=given)

    def _require_kinds(self, scope: Scope) -> None:
        """Refuse variables of another kind than the CPD is about."""
        child = scope[0]
        for variable in scope:
            if isinstance(variable, Discrete) != self.discrete:
                found = "continuous" if self.discrete else "discrete"
                advice = "a Gaussian CPD" if self.discrete else "a TableCPD"
                raise ModelError(
                    f"{type(self).__name__} of {child!r}: {variable!r} is {found}; {found} "
                    f"variables take {advice}; a continuous child of discrete parents has a "
                    "SwitchingCPD, and a discrete child of continuous parents has none",
                    variable=variable,
                )

    @property
    def noise_given(self) -> Scope:
        """The parents that the noise covariance depends on."""
        return ()

    @property
    def parents(self) -> Scope:
        """All parents: first the mean's, then the parents of the noise alone."""
        noise = self.noise_given
        return self.given + tuple(v for v in noise if v not in self.given) if noise else self.given

    @property
    def scope(self) -> Scope:
        """The family: the child and its parents."""
        return (self.child, *self.parents)

    @property
    def origin(self) -> CPD:
        """The CPD of which this one is a copy; itself, if of none."""
        return self._origin or self

    def at(self, step: int) -> Self:
        """The copy for a concrete step, of a CPD declared for every step.

        Parameters
        ----------
        step : int

        Returns
        -------
        CPD
            A CPD of the same kind; this one is its `origin`.

        Raises
        ------
        ModelError
            If the step is no whole number, one of the variables would stand before step 0, the CPD
            has numbers by step and none of this one, or it is of a step already.
        """
        if self.child.step is not None:
            raise ModelError(
                f"{self!r} is of step {self.child.step} already; place its origin instead, "
                "cpd.origin.at(...)",
                cpd=self,
            )
        held = self._held(step)
        return held._copy(lambda variable: variable.at(step), _origin=self.origin)

    def _held(self, step: int) -> Self:
        """The CPD with the numbers of a step, if it has others at each; else itself."""
        return self

    @public
    def log_density(
        self, child: npt.ArrayLike, parents: Mapping[Variable, npt.ArrayLike] | None = None
    ) -> Array:
        """The log-density ln p(child | parents) of values, batched.

        - Of a Gaussian CPD, with mean f(parents) and noise covariance R,

              ln N(y; f, R) = −½ (rᵀ R⁻¹ r + ln |2πR|),    r = y − f,

          the residual r of components that are angles wrapped to [−π, π), or as it is where a
          singular R rules the wrapped one out. Where R is singular, it is the density of the
          components that those before them leave free (by their order, then), and −∞ where one of
          the others is not what these make it by more than rounding: 1e-9 of y and f, or 1e-6 of
          its standard deviation. With R = 0 it is 0 at f, −∞ elsewhere.
        - Of a table, its entry's logarithm; −∞ where the entry is zero.
        - Of a `SampledCPD`, what its function gives; of a `MixtureCPD`, ln Σ_k w_k p_k.

        Parameters
        ----------
        child : array_like
            (..., d); of a discrete child names or indices of states, (...). NaN is a component that
            was not measured, of a Gaussian CPD, a mixture of them, or a scan (`partial`).
        parents : mapping of Variable to array_like, optional
            Values (..., d) of all parents, those of the noise too; of discrete ones states (...).
            All leading axes broadcast, those of a `GaussianCPD` itself too. Python numbers are
            values of scalars.

        Returns
        -------
        ndarray
            (...), in nats.

        Raises
        ------
        ModelError
            If a parent is missing, or none of the CPD's, a value has a wrong shape, is NaN,
            infinite or no state, axes do not broadcast, a variance is infinite, or a function
            fails, returns a wrong shape or a noise that is no covariance.
        LinearisationError
            If a function is NaN or infinite.
        NumericalError
            If a covariance is singular but for errors larger than rounding.

        Examples
        --------
        >>> x, y = pgm.variables("x y")
        >>> cpd = pgm.LinearGaussianCPD(y, given={x: 2.0}, cov=1.0)
        >>> cpd.log_density([[6.0], [7.0]], {x: 3.0}).round(3)
        array([-0.919, -1.419])
        """
        values = as_values(self, self.child, child)
        known = as_parents(self, parents)
        leads = ("the child", shape_of(self.child, values)), ("the parents", known.lead)
        common(self, leads)
        return self._log_density(values, known)

    @public
    def sample(
        self,
        parents: Mapping[Variable, npt.ArrayLike] | None = None,
        size: int | tuple[int, ...] = (),
        *,
        rng: np.random.Generator | int,
    ) -> Values:
        """Draws of the child given its parents.

        Angles are drawn on one unwrapped chart. Singular noise moves only what it leaves free, and
        a state of probability zero is never drawn.

        Parameters
        ----------
        parents : mapping of Variable to array_like, optional
            See `log_density`.
        size : int or tuple of int
            How many draws for each value of the parents.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Returns
        -------
        ndarray
            (*size, ..., d), the axes of the parents' values in the middle; of a discrete child
            indices of states, (*size, ...).

        Raises
        ------
        ModelError
            See `log_density`; and if `size` is no number of draws or would not fit into memory,
            or `rng` is neither a generator nor a seed.
        LinearisationError, NumericalError
            See `log_density`.

        Examples
        --------
        >>> x, y = pgm.variables("x y")
        >>> cpd = pgm.LinearGaussianCPD(y, given={x: 2.0}, cov=0.0)
        >>> cpd.sample({x: [[1.0], [2.0]]}, rng=0)
        array([[2.],
               [4.]])
        >>> cpd.sample({x: [[1.0], [2.0]]}, size=1000, rng=0).shape
        (1000, 2, 1)
        """
        extra = as_lengths(size, "for each value of the parents")
        known, generator = as_parents(self, parents), as_generator(rng)
        require_memory(
            math.prod((*extra, *known.lead)) * max(self.child.dimension, 1),
            f"{size} draws from {self!r}",
            "draw fewer at a time",
            cpd=self,
        )
        drawn = self._draw(known, generator, extra)
        return drawn.reshape((*extra, *known.lead, *drawn.shape[len(extra) + 1 :]))

    def require_proper(self, what: str) -> None:
        """Refuse an infinite variance, which few kinds of CPDs can have."""

    def _lead(self) -> tuple[int, ...]:
        """The axes of runs that the CPD itself has."""
        return ()

    def _log_density(self, child: Values, known: Known) -> Array:
        """The log-densities, at checked values whose axes broadcast."""
        raise ModelError(f"{self!r} is of a kind that has no density here", cpd=self)

    def _counted(self, taken: Mask) -> Array:
        """The number of measured components that enter a density, from a mask (..., d)."""
        return np.asarray(taken.sum(axis=-1), dtype=np.float64)

    def _log_peak(self, child: Values) -> Array:
        """The largest log-densities that measurements could have, (...); NaN is not measured."""
        raise ModelError(
            f"{self!r} does not tell how large its density can be, which a number of particles by "
            "likelihood is measured against; give number=pgm.KLDSampling(...), or none",
            variable=self.child,
            cpd=self,
        )

    def _draw(self, known: Known, rng: np.random.Generator, size: tuple[int, ...] = ()) -> Values:
        """Draws of the child, (*size, *known.shape, d) or (*size, *known.shape)."""
        raise ModelError(f"{self!r} is of a kind that cannot be drawn from", cpd=self)

    def _copy(self, moved: Moved, **changed: Any) -> Self:
        """A copy over other variables, all of the same kinds, and with other attributes."""
        found = object.__new__(type(self))
        found.__dict__.update(self.__dict__, **self._over(moved), **changed)
        return found

    def _with_child(self, child: Variable) -> Self:
        """A copy of another child, of as many components and the same angles."""
        found = object.__new__(type(self))
        found.__dict__.update(self.__dict__, child=child)
        return found

    def _bare(self) -> dict[str, Any]:
        """The attributes without what was worked out from them."""
        cls = type(self)
        return {
            name: value
            for name, value in self.__dict__.items()
            if not isinstance(getattr(cls, name, None), cached_property)
        }

    def _over(self, moved: Moved) -> dict[str, Any]:
        """The attributes of a copy over other variables that differ from this one's."""
        return {"child": moved(self.child), "given": tuple(map(moved, self.given))}

    @property
    def _title(self) -> str:
        if self._of is not None:
            return titled(self._of)
        parents = listed(self.parents)
        return f"{type(self).__name__}({self.child!r}{' | ' if parents else ''}{parents})"

    def _summary(self) -> Summary:
        return Summary(self._title, self._parts())

    def _parts(self) -> Sequence[str | Listing]:
        return ()

    def __repr__(self) -> str:
        return self._title

    def __str__(self) -> str:
        return self._summary().text()


@contextmanager
def naming_factors() -> Iterator[None]:
    """Let errors about a factor's residual carry the factor, and a variable of it."""
    try:
        yield
    except PgmError as error:
        factor = getattr(error.cpd, "_of", None)
        if factor is not None:
            error.cpd = factor
            if error.variable not in factor.scope:
                error.variable = factor.scope[0]
        raise
