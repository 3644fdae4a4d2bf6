"""CPDs as rows: v = e + ξ_y − F ξ_p, whitened by the CPD's noise.

The coordinates ξ of a variable are its distance from its *point*, where CPDs of it are linearised,
in its own units. Of a child y = F p + b + v at the points of p, the residual e is y − (F p + b) at
y's point, or at the measured y: its factor is exp(−½ ‖W (e + ξ_y − F ξ_p)‖²), with a root W of the
noise's information.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pgm.cpds import AffineCPD, ConditionalGaussian, NonlinearGaussianCPD
from pgm.cpds.plates import plate
from pgm.errors import ModelError, NumericalError
from pgm.factors.scope import Scope
from pgm.kernels import roots, solving
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import Array, Mask, independent, transpose
from pgm.kernels.rows import pivoted
from pgm.linearisation.family import Family
from pgm.linearisers import BoundFunction, Lineariser
from pgm.linearisers.function import Source
from pgm.linearisers.numbering import COUNTED
from pgm.variables import Variable

# Shares of variances, given the components before, from which on their order is left as it is: the
# root of the information keeps twelve digits.
PLAIN = 1e-4
# Values of the variables with evidence, (d,) each.
Known = Mapping[Variable, Array]
# By their keys, the first CPDs that have come of each.
Plates = Mapping[Hashable, "Given"]


class Given(NamedTuple):
    """A CPD with what is known of its variables.

    Attributes
    ----------
    cpd : ConditionalGaussian
    key : hashable
        What CPDs have in common that are linearised together.
    parents : tuple of Variable
        The hidden parents, in the order of the function's arguments.
    reading : ndarray or None
        The value of the child, (d,), zero where it was not measured; None of a hidden child.
    """

    cpd: ConditionalGaussian
    key: Hashable
    parents: Scope
    reading: Array | None

    @classmethod
    def of(cls, cpd: ConditionalGaussian, known: Known, reading: Array | None) -> Given:
        """The CPD, with its hidden parents: those that have no value."""
        return cls._of(cpd, tuple(v for v in cpd.given if v not in known), reading)

    @classmethod
    def _of(cls, cpd: ConditionalGaussian, parents: Scope, reading: Array | None) -> Given:
        key = plate(cpd), tuple(v in parents for v in cpd.given), reading is None
        return cls(cpd, key, parents, reading)

    def __reduce__(self) -> tuple[Any, ...]:
        # Keys are of objects of this process.
        return Given._of, (self.cpd, self.parents, self.reading)

    def naming(self, parent: Variable, name: Variable) -> Given:
        """The CPD with a hidden parent replaced by a variable of its kind."""
        cpd = self.cpd._copy(lambda v: name if v == parent else v, _origin=None)
        return Given._of(cpd, tuple(name if v == parent else v for v in self.parents), self.reading)

    @property
    def flat(self) -> bool:
        """Whether it is a prior of infinite variances alone, which says nothing."""
        cov = self.cpd.cov
        return isinstance(cov, np.ndarray) and not np.isfinite(cov.diagonal()).any()

    @property
    def bends(self) -> bool:
        """Whether its rows depend on where its parents are."""
        return bool(self.parents) and not isinstance(self.cpd, AffineCPD)


class Factor(NamedTuple):
    """A CPD with noise, over hidden variables.

    Attributes
    ----------
    given : Given
    scope : tuple of int
        The numbers of its hidden variables: the child's, if that is hidden, then the parents'.
    white : ndarray
        A root of the information of its noise, (d, d), with a row of zeros for each component that
        says nothing: of a prior that is flat in it, or not measured.
    """

    given: Given
    scope: tuple[int, ...]
    white: Array


def whitened(given: Sequence[Given], taken: Sequence[Mask | None], known: Known) -> Array:
    """The roots W of the information of CPDs of one key, (CPDs, d, d).

    `taken` marks the components that were measured, None for all. A singular noise is refused.
    """
    noise = noises(given, known)
    seen = np.isfinite(np.diagonal(noise, axis1=-2, axis2=-1))
    if any(mask is not None for mask in taken):
        seen = seen & measured(given, taken)
    if seen.all():
        return _roots(given, noise)
    return np.where(seen[:, None, :], _roots(given, independent(noise, seen)), 0.0)


def noises(given: Sequence[Given], known: Known) -> Array:
    """The covariances of the noise of CPDs of one key, (CPDs, d, d)."""
    if isinstance(given[0].cpd.cov, np.ndarray):
        return np.array([each.cpd.cov for each in given])
    return _family(given, known).own_noise[:, 0]


def measured(given: Sequence[Given], taken: Sequence[Mask | None]) -> Mask:
    """The masks of components that were measured, (CPDs, d), of which None are all."""
    whole = np.ones(given[0].cpd.child.dimension, bool)
    return np.array([whole if mask is None else mask for mask in taken])


def _roots(given: Sequence[Given], noise: Array) -> Array:
    variance = np.diagonal(noise, axis1=-2, axis2=-1)
    try:
        lower = np.linalg.cholesky(noise)
        if (np.diagonal(lower, axis1=-2, axis2=-1) ** 2 > PLAIN * variance).all():
            return np.asarray(np.linalg.inv(lower))
    except np.linalg.LinAlgError:
        pass
    unit, order, _, lower = pivoted(noise)
    for row, own in enumerate(lower):
        cpd = given[row].cpd
        if not roots.is_proper(own):
            raise NumericalError(
                f"the covariance of {cpd!r} is indefinite", variable=cpd.child, cpd=cpd
            )
        if roots.determined(own).any():
            raise ModelError(
                f"{cpd!r} has no noise in some direction; a growing map keeps rows with noise: "
                "give it a small variance, or give what is known exactly as evidence",
                variable=cpd.child,
                cpd=cpd,
            )
    picked = np.take_along_axis(np.broadcast_to(np.eye(lower.shape[-1]), lower.shape), order, -2)
    return np.asarray(solving.solve_lower(lower, picked) / transpose(unit))


def linearised(
    factors: Sequence[Factor],
    points: Mapping[int, Array],
    known: Known,
    plates: Plates,
    lineariser: Lineariser,
) -> list[Array]:
    """The rows [A b] of factors, linearised at the points of their variables, by number.

    All factors of one key are linearised in one call, by the template of the first of that key.
    """
    alike: dict[Hashable, list[int]] = {}
    for k, factor in enumerate(factors):
        alike.setdefault(factor.given.key, []).append(k)
    found: list[Array | None] = [None] * len(factors)
    for places in alike.values():
        own = [factors[k] for k in places]
        for k, rows in zip(
            places, _linearised(own, points, known, plates, lineariser), strict=True
        ):
            found[k] = rows
    return [rows for rows in found if rows is not None]


def predicted(given: Given, at: Array, known: Known, lineariser: Lineariser) -> Array:
    """The value of a CPD, (d,), with its hidden parents at a place, (n,)."""
    family = _family([given], known, lineariser)
    mean = at[None, None]
    family.linearise(slice(None), mean, np.zeros((*mean.shape, mean.shape[-1])))
    found: Array = family.value(slice(None), mean)[0, 0]
    return found


def probe(given: Given, known: Known, lineariser: Lineariser) -> None:
    """Call a CPD's function on trial; see `Family.probe`."""
    _family([given], known, lineariser).probe({})


def _family(given: Sequence[Given], known: Known, lineariser: Lineariser | None = None) -> Family:
    """CPDs of one key as one family, a row each."""
    cpds = [each.cpd for each in given]
    first = cpds[0]
    inputs = {
        parent: np.array([known[cpd.parents[k]] for cpd in cpds])[:, None]
        for k, parent in enumerate(first.parents)
        if parent in known
    }
    timed = first.child.step is not None
    steps = np.array([cpd.child.step or 0 for cpd in cpds], dtype=np.intp)
    parts = first, given[0].parents, steps, inputs, lineariser, ()
    family = Family.make(*parts, timed=timed, plate=cpds)  # type: ignore[arg-type]
    if lineariser is not None:
        family.trace({}, None)
    return family


def innovations(
    given: Sequence[Given], at: Array, known: Known, plates: Plates, lineariser: Lineariser
) -> tuple[Array, Array]:
    """Readings less the values of their CPDs at places (CPDs, n), and the slopes there.

    The CPDs are of one key. Angles are read at the branch nearest to the value.
    """
    value, slope = _line(given, at, known, plates, lineariser)
    reading = np.array([each.reading for each in given])
    return nearest_branch(reading, value, given[0].cpd.child.angle_mask) - value, slope


def _line(
    given: Sequence[Given], at: Array, known: Known, plates: Plates, lineariser: Lineariser
) -> tuple[Array, Array]:
    """Values and slopes of CPDs of one key at places, (CPDs, n)."""
    leading = plates.get(given[0].key, given[0])
    found = _tangent(leading, given, at, known)
    return _line_of_any(given, at, known, lineariser) if found is None else found


def _tangent(
    leading: Given, given: Sequence[Given], at: Array, known: Known
) -> tuple[Array, Array] | None:
    """Values and slopes of CPDs at places, where all derivatives were given; else None.

    So it is where they fail or are not finite: `_line_of_any` tells of that.
    """
    cpd = leading.cpd
    if not isinstance(cpd, NonlinearGaussianCPD) or not at.size or cpd.child.step is not None:
        return None
    template = cpd._template(leading.parents)
    if template.missing:
        return None
    inputs = [
        np.array([known[each.cpd.given[k]] for each in given])[:, None] if place is None else None
        for k, place in enumerate(template.places)
    ]
    function = BoundFunction(template, inputs, 2, 0, source=Source(cpd, False, COUNTED))
    try:
        with np.errstate(all="ignore"):
            value, slope = function.tangent(at[:, None])
    except Exception:
        return None
    if not (np.isfinite(value).all() and np.isfinite(slope).all()):
        return None
    return value[:, 0], slope[:, 0]


def _line_of_any(
    given: Sequence[Given], at: Array, known: Known, lineariser: Lineariser
) -> tuple[Array, Array]:
    """Values and slopes of any CPDs at places, (CPDs, n)."""
    family, mean = _family(given, known, lineariser), at[:, None]
    family.linearise(slice(None), mean, np.zeros((*mean.shape, at.shape[1])))
    return family.value(slice(None), mean)[:, 0], family.matrix[:, 0]


def _linearised(
    factors: Sequence[Factor],
    points: Mapping[int, Array],
    known: Known,
    plates: Plates,
    lineariser: Lineariser,
) -> list[Array]:
    given = [factor.given for factor in factors]
    first = given[0]
    hidden = first.reading is None
    begin = 1 if hidden else 0
    each = [[points[f.scope[k]] for f in factors] for k in range(begin, len(factors[0].scope))]
    at = np.concatenate(each, axis=1) if each else np.zeros((len(factors), 0))
    if first.reading is not None:
        away, slope = innovations(given, at, known, plates, lineariser)
        matrix = -slope
    else:
        value, slope = _line(given, at, known, plates, lineariser)
        angles = first.cpd.child.angle_mask
        child = np.array([points[factor.scope[0]] for factor in factors])
        if not isinstance(first.cpd, AffineCPD):
            value = nearest_branch(value, child, angles)
        away = child - value
        one = np.broadcast_to(np.eye(len(angles)), (len(factors), len(angles), len(angles)))
        matrix = np.concatenate([one, -slope], axis=2)
    white = np.array([factor.white for factor in factors])
    # Copies, as a view would keep the rows of all others.
    return [rows.copy() for rows in white @ np.concatenate([matrix, -away[..., None]], axis=2)]
