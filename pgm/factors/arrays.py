"""Arrays of factors: vectors, matrices and covariances as users give them, and leading axes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_floats, as_wholes
from pgm.display import Shown
from pgm.errors import EvidenceError, ModelError
from pgm.factors.scope import Scope, dimension, labels, listed, names
from pgm.kernels.arrays import Array, Integers, frozen, transpose

# How far matrices may be from symmetric, relative to the entries' scale: solvers of Lyapunov's
# equation and the like leave some 1e-9.
ASYMMETRY = 1e-8
# Of smaller variances, rounding is not relative.
_TINY = 1e-290
# The fault of a covariance that passes, but has no root (`roots.root`).
IMPROPER = (
    "its covariance is singular but for errors of up to 1e-10 of the variances, too large to be "
    "told from an indefinite one; give it in all digits, or set its negative eigenvalues to 0"
)


def symmetrised(matrix: Array) -> Array:
    """The symmetric part of matrices that are all but symmetric, entries against √|a_ii a_jj|."""
    if is_symmetric(matrix) or not np.isfinite(matrix).all():
        return matrix
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = _scaled(matrix)
        other = transpose(scaled)
        scale = np.maximum(np.maximum(np.abs(scaled), np.abs(other)), 1.0)
        fits = np.abs(scaled - other) <= ASYMMETRY * scale
    return 0.5 * matrix + 0.5 * transpose(matrix) if fits.all() else matrix


def is_symmetric(matrix: Array) -> bool:
    """Whether stacked matrices are symmetric to the last digit."""
    if matrix.ndim == 2 and matrix.tobytes() == matrix.T.tobytes():
        return True  # of a small one this is known in a fraction of the time
    return bool((matrix == transpose(matrix)).all())


def covariance_fault(cov: Array) -> str | None:
    """The fault that keeps stacked matrices, `symmetrised`, from being covariances; or None."""
    if not np.isfinite(cov).all():
        return "has entries that are NaN or infinite"
    variances = np.diagonal(cov, axis1=-2, axis2=-1)
    least = variances.min(initial=np.inf)
    if least < 0.0:
        return f"has the negative variance {least:.3g}"
    if np.count_nonzero(cov) == np.count_nonzero(variances):
        return None  # a diagonal matrix
    if not is_symmetric(cov):
        return "is not symmetric"
    if least > _TINY:
        try:
            # With a factor no scaled eigenvalue is below −n² eps; that takes a third of the time.
            np.linalg.cholesky(cov)
        except np.linalg.LinAlgError:
            pass
        else:
            return None
    with np.errstate(over="ignore"):
        scaled = _scaled(cov)
    if not np.isfinite(scaled).all():
        return "is indefinite: a covariance is far larger than the variances allow"
    smallest = np.linalg.eigvalsh(scaled).min(initial=0.0)
    if smallest < -1e-10:
        return (
            f"is indefinite: scaled to unit variances it has the negative eigenvalue {smallest:.3g}"
        )
    return None


def _scaled(matrix: Array) -> Array:
    size = np.abs(np.diagonal(matrix, axis1=-2, axis2=-1))
    unit = np.sqrt(np.where(size > 0.0, size, 1.0))
    return matrix / unit[..., None] / unit[..., None, :]


def as_vector(scope: Scope, value: Any, what: str) -> Array:
    """A copy of a vector over a scope, (..., n)."""
    array = as_floats(value, what, labels=labels(scope)).copy()
    return array[None] if array.ndim == 0 and dimension(scope) == 1 else array


def as_matrix(scope: Scope, value: Any, what: str, **about: Any) -> Array:
    """A copy of a matrix over a scope, (..., n, n), made symmetric if it all but is."""
    array = as_floats(value, what, **about).copy()
    if array.ndim == 0 and dimension(scope) == 1:
        array = array[None, None]
    square = array.ndim >= 2 and array.shape[-1] == array.shape[-2]
    return symmetrised(array) if square else array


def as_information(
    scope: Scope, K: npt.ArrayLike, h: npt.ArrayLike, g: npt.ArrayLike
) -> tuple[Array, Array, Array]:
    """Checked copies of K, h and g of a canonical form."""
    size = dimension(scope)
    what = f"canonical form over {names(scope)}:"
    K, h = as_matrix(scope, K, f"{what} K"), as_vector(scope, h, f"{what} h")
    g = as_floats(g, f"{what} g").copy()
    if K.shape[-2:] != (size, size) or h.shape[-1:] != (size,):
        raise ModelError(
            f"canonical form over {names(scope)}: K has shape {K.shape} and h {h.shape}; "
            f"they must end in ({size}, {size}) and ({size},)"
        )
    if not all(np.isfinite(part).all() for part in (K, h, g)):
        raise ModelError(f"canonical form over {names(scope)}: K, h and g must be finite")
    if not is_symmetric(K):
        raise ModelError(f"canonical form over {names(scope)}: K is not symmetric")
    return K, h, g


def as_points(scope: Scope, value: Any, lead: tuple[int, ...], what: str) -> Array:
    """Finite values of the variables of a scope, (..., n), at each of some factors."""
    array = as_vector(scope, value, what)
    if array.shape[-1:] != (dimension(scope),):
        raise ModelError(
            f"{what} must be values of its {dimension(scope)} components along the last axis, not "
            f"of shape {array.shape}"
        )
    if not np.isfinite(array).all():
        raise ModelError(f"{what} has entries that are NaN or infinite")
    require_broadcast(array.shape[:-1], lead, what)
    return array


def as_steps(scope: Scope, steps: npt.ArrayLike, lead: tuple[int, ...]) -> Integers:
    """The steps of the last of the leading axes of a Gaussian."""
    array = as_wholes(steps, f"Gaussian over {names(scope)}: its steps")
    if array.shape != lead[-1:]:
        raise ModelError(
            f"Gaussian over {names(scope)}: the steps have shape {array.shape}; the last of the "
            f"leading axes {lead} needs one step for each of its entries"
        )
    return array


def require_broadcast(own: tuple[int, ...], lead: tuple[int, ...], what: str) -> None:
    """Refuse leading axes that do not broadcast to the factors' leading axes."""
    try:
        np.broadcast_shapes(own, lead)
    except ValueError:
        raise ModelError(
            f"{what} has leading axes {own}, which do not broadcast with those of the factors, "
            f"{lead}"
        ) from None


def as_covariance(
    scope: Scope, value: Any, what: str, *, runs: bool = True, flat: bool = False, **about: Any
) -> Array:
    """A copy of a covariance over a scope as matrices, (..., n, n), checked.

    The number of axes says what is given, never their length: none is one variance for every
    component, one holds the variance of each, two or more end in matrices; these have axes of runs
    only with `runs`. With `flat` independent components may have infinite variance.
    """
    # A series of variances is taken by its names, as a series of means is.
    named = labels(scope) if getattr(value, "ndim", 0) == 1 else ()
    given = as_floats(value, what, labels=named, **about)
    size = dimension(scope)
    cov = matrices(given, size).copy()
    if cov.shape[-2:] != (size, size) or (cov.ndim > 2 and not runs):
        due = _due(scope, given.ndim, runs)
        raise ModelError(f"{what} has shape {given.shape}; {due}", **about)
    cov = symmetrised(cov)
    proper = _closed(cov, what, **about) if flat and (cov == np.inf).any() else cov
    if fault := covariance_fault(proper):
        raise ModelError(f"{what} {fault}", **about)
    return cov


def matrices(cov: Array, size: int) -> Array:
    """Diagonal matrices of a variance, or of a vector of variances; matrices as they are."""
    if cov.ndim == 0:
        cov = np.full(size, cov)
    return diagonal(cov) if cov.ndim == 1 else cov


def diagonal(variances: Array) -> Array:
    """Diagonal matrices (..., n, n) of variances (..., n), which may be infinite."""
    *lead, size = variances.shape
    found = np.zeros((*lead, size * size))
    found[..., :: size + 1] = variances
    return found.reshape(*lead, size, size)


def _due(scope: Scope, axes: int, runs: bool) -> str:
    size = dimension(scope)
    due = (
        f"its {size} components ({listed(labels(scope))}) need ({size}, {size}), the "
        f"variances ({size},), or one variance for all of them"
    )
    if runs and axes > 1:
        due += "; variances (..., n) of each run are matrices as cov[..., None] * np.eye(n)"
    return due


def _closed(cov: Array, what: str, **about: Any) -> Array:
    size = cov.shape[-1]
    open_ = np.diagonal(cov, axis1=-2, axis2=-1) == np.inf
    infinite = open_[..., None] & np.eye(size, dtype=bool)
    met = (open_[..., None] | open_[..., None, :]) & ~infinite
    if (cov[met] != 0.0).any():
        raise ModelError(
            f"{what}: a component of infinite variance has a covariance with another one; it must "
            "be 0",
            **about,
        )
    if not (open_ == open_.reshape(-1, size)[0]).all():
        raise ModelError(
            f"{what} is infinite in other components in some runs than in others; give all runs "
            "the same ones",
            **about,
        )
    return np.where(infinite, 1.0, cov)


Shape = tuple[int, ...]


def common_runs(shapes: Iterable[tuple[object, Shape]]) -> Shape:
    """The axes of runs that all evidence broadcasts to; refuses axes that do not, and no runs."""
    found = tuple(shapes)
    try:
        lead = np.broadcast_shapes(*dict.fromkeys(shape for _, shape in found))
    except ValueError:
        raise EvidenceError(
            "the leading axes of the evidence do not broadcast to one set of runs: "
            f"{clash(found)}; give them the same, or 1"
        ) from None
    if 0 in lead:
        owner, shape = next((owner, shape) for owner, shape in found if 0 in shape)
        raise EvidenceError(f"the axes of runs of {owner} are {shape}: there is no run in it")
    return lead


def clash(shapes: Iterable[tuple[object, Shape]]) -> str:
    """The first two of some shapes that do not broadcast, and whose they are."""
    first: dict[Shape, object] = {}
    for owner, shape in shapes:
        first.setdefault(shape, owner)
    one, other = next(pair for pair in combinations(first, 2) if not _fit(*pair))
    return f"{first[one]} {one}, {first[other]} {other}"


def _fit(one: Shape, other: Shape) -> bool:
    pairs = zip(reversed(one), reversed(other), strict=False)
    return all(a == b or 1 in (a, b) for a, b in pairs)


def flat(array: npt.NDArray[Any], lead: Shape, own: int) -> npt.NDArray[Any]:
    """An array with the axes of runs as one; read-only, since users' functions see it."""
    cut = array.ndim - own
    rest = array.shape[cut:]
    runs = math.prod(array.shape[:cut])
    if runs > 1:
        runs = math.prod(lead)
        array = np.broadcast_to(array, (*lead, *rest))
    return frozen(np.ascontiguousarray(array.reshape(runs, *rest)))


def unflat(array: npt.NDArray[Any], lead: Shape, own: int) -> npt.NDArray[Any]:
    """An array (runs or 1, own axes) with its axes of runs."""
    rest = array.shape[array.ndim - own :]
    return np.broadcast_to(array, (math.prod(lead), *rest)).reshape((*lead, *rest))


# What picks from one axis.
Item = int | slice | npt.NDArray[Any]


def lead_index(index: Any, lead: tuple[int, ...], what: Shown) -> Sequence[Item]:
    """An index of leading axes, one item an axis; `what` they are of is named in refusals."""
    parts = index if isinstance(index, tuple) else (index,)
    gaps = [k for k, part in enumerate(parts) if part is Ellipsis]
    missing = len(lead) - len(parts) + len(gaps)
    if missing < 0 or len(gaps) > 1:
        raise ModelError(
            f"{what._title} has {len(lead)} leading axes; [{_shown(parts)}] is of others"
        )
    gap = gaps[0] if gaps else len(parts)
    full = (*parts[:gap], *(slice(None),) * missing, *parts[gap + len(gaps) :])
    return [_item(part, length, what) for part, length in zip(full, lead, strict=True)]


def _item(part: Any, length: int, what: Shown) -> Item:
    try:
        if isinstance(part, slice):
            part.indices(length)
            return part
        places = np.asarray(part)
        kind = "i" if places.size == 0 and places.dtype.kind == "f" else places.dtype.kind
        if places.ndim > 1 or kind not in "iub" or (kind == "b" and places.ndim == 0):
            raise TypeError
        places = places if kind == "b" else places.astype(np.intp)
        np.empty(length, dtype=bool)[places]
    except (TypeError, ValueError):
        raise ModelError(
            f"{what._title}: {part!r} picks nothing; give a number, a slice, or a row of places or "
            "booleans"
        ) from None
    except IndexError as error:
        raise ModelError(f"{what._title}: {error}") from None
    return int(places) if places.ndim == 0 else places


def _shown(parts: tuple[Any, ...]) -> str:
    return ", ".join("..." if part is Ellipsis else repr(part) for part in parts)
