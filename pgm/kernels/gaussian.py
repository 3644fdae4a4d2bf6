"""Gaussians in moment form, one or a batch: mean (n, *batch), covariance (n, n, *batch).

A measurement of d components of a belief N(m, P) is z = H x + v, v ~ N(0, R); S = H P Hᵀ + R is the
covariance of its residual z − H m. A component of a prediction F x + b + w, with the noise w, is
*bare* if w is zero in it, so that the component is that of F x + b.

The arithmetic is that of `step`; each function chooses the fastest kind of matrices: for one small
Gaussian, and for updates of a dozen or up to some thousand small ones, lines of Python for their
size (`written`); for a larger one, or a few, LAPACK, for a batch rows of runs (`dense`). Where S is
nearly singular, all updates are left to `moments`, which tells singular covariances from rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import log, sqrt
from typing import Any, NamedTuple

import numpy as np

from pgm.kernels import moments, roots, step, written
from pgm.kernels.arrays import (
    LOG_2PI,
    Array,
    Index,
    Integers,
    components_first,
    components_last,
    quiet,
    symmetric,
)
from pgm.kernels.dense import (
    Dense,
    DenseRoot,
    RegularRoot,
    Runs,
    RunsRoot,
    Stack,
    first,
    scratch,
)
from pgm.kernels.moments import ROUNDING
from pgm.kernels.numbers import Matrix, Number

# A pivot of S below this part of its diagonal entry costs too many digits: S is nearly singular.
NEARLY_SINGULAR = 1e-6
# The same part for a covariance, below which its root is left to `roots`, which tells zeros from
# rounding.
_REGULAR = 1e-11
# Of n components and d others, beyond n d (n + d) of this size LAPACK is quicker than Python.
_MOST = 90
# The largest factor by which a mild measurement shrinks a variance.
_MILD = 1e3
# Of a batch lines of Python are quicker than products of arrays up to n d (n + d) of this size, and
# so many runs.
_FEW, _SHORT = 54, 2000
# But beyond this size and up to so many runs LAPACK is quickest, run by run. Parts of 32
# runs have the bits of the whole.
_BRIEF, _STACKED = 16, 31
# And of the fewest each is updated by itself, by lines of Python on floats.
_FEWEST = 12


def deviations(cov: Array) -> Array:
    """The standard deviations (n, *batch) of covariances (n, n, *batch).

    A variance that rounding has left negative counts as zero.
    """
    found: Array = np.sqrt(np.maximum(np.einsum("ii...->i...", cov), 0.0))
    return found


def lengths(cov: Array) -> Array:
    """The length of each component over which a function may vary, (n, *batch), by P = `cov`.

    `cov` is (n, n, *batch). A length is the standard deviation √P_jj, or, if less, ten times what
    is left of it given the component that says most of it: 10 √(P_jj (1 − ρ²)), ρ being the
    largest correlation of j with another component; at least √P_jj / 1000. A function of the
    difference of two components, either of which is known far less than it, varies over such.
    """
    std = deviations(cov)
    unit = np.where(std > 0.0, std, 1.0)
    shared = (cov / unit / unit[:, None]) ** 2
    np.einsum("ii...->i...", shared)[...] = 0.0
    left = np.sqrt(np.maximum(1.0 - shared.max(axis=1, initial=0.0), 0.0))
    found: Array = std * np.clip(10.0 * left, 1e-3, 1.0)
    return found


def root(cov: Array) -> DenseRoot | RunsRoot | None:
    """The root of covariances P (n, n, *batch); None if any is not clearly regular.

    P is not clearly regular if a pivot L_jj² of its root is at most 10⁻¹¹ P_jj.
    """
    if cov.ndim == 2:
        one = Dense(cov).root()
        return one if one.share > _REGULAR else None
    with np.errstate(invalid="ignore", divide="ignore"):  # such a pivot may have no root
        many = Runs(cov).root()
    return many if (many.share > _REGULAR).all() else None


def is_moderate(mean: Array, cov: Array, before: Array, least: float, far: float) -> bool:
    """Whether N(mean, cov) is well conditioned, and not far narrower than the covariance `before`.

    `mean` is (n, *batch), `cov` and `before` (n, n, *batch). In the whole batch each component is
    to have a variance given the earlier components of more than `least` times its variance, a
    variance of at least `least` times that in `before`, and a finite mean whose square is at most
    `far` times its variance. A component without a variance passes if it has none in `before` and
    its mean is finite.
    """
    if cov.ndim == 2:
        quick = _checking(len(cov), least, far)
        if quick is not None and quick(mean, cov, before):
            return True
    variances = np.einsum("ii...->i...", cov)
    fell = variances < least * np.einsum("ii...->i...", before)
    off = (mean * mean > far * variances) & (variances > 0.0) | ~np.isfinite(mean)
    return not (fell | off).any() and roots.is_regular(components_last(cov, 2), least)


def predict(cov: Array, matrix: Array, noise: Array, bare: tuple[int, ...] = ()) -> Array:
    """The covariance F P Fᵀ + noise of a prediction, (d, d, *batch).

    `cov` P (n, n, *batch) is exactly symmetric; of `matrix` F (d, n, *batch) and `noise`
    (d, d, *batch) the batch may be of length one. `bare` are the places in the prediction of its
    bare components: where the variance of such a component is no more than rounding, its variance
    and covariances become zero.
    """
    quick = _predicting(len(noise), len(cov)) if cov.ndim == 2 else None
    if quick is not None:
        spread: Array = quick(cov, matrix, noise)
    elif cov.ndim == 2:
        spread = symmetric(step.predict(Dense(cov), Dense(matrix), Dense(noise)).array)
    elif cov.ndim == 3 and cov.shape[-1] <= _STACKED:
        belief, slope, error = (Stack(components_last(each, 2)) for each in (cov, matrix, noise))
        spread = components_first(step.predict(belief, slope, error).array, 2)
    else:
        with scratch():
            spread = step.predict(Runs(cov, True), Runs(matrix), Runs(noise)).array
    return _certain(spread, cov, matrix, bare) if bare else spread


def _certain(spread: Array, cov: Array, matrix: Array, bare: tuple[int, ...]) -> Array:
    """The covariance `spread` of a prediction, with zeros for bare components that are certain.

    `spread` is F P Fᵀ + noise, (d, d, *batch), F = `matrix` (d, n, *batch), P = `cov`
    (n, n, *batch). The row and column of each of the components `bare` become zero where its
    variance is only rounding: at most 10⁻¹⁴ of its entry of the diagonal of |F| |P| |F|ᵀ, the sizes
    of the terms that the variance is summed from.
    """
    variances = np.einsum("ii...->i...", cov)
    if cov.ndim == 2:
        std = [sqrt(max(v, 0.0)) for v in variances.tolist()]
        rows = (matrix[list(bare)]).tolist()
        # |F| σ bounds what is summed up.
        most = (sum(abs(f) * s for f, s in zip(row, std, strict=True)) for row in rows)
        if all(spread.item(i, i) > ROUNDING * m * m for i, m in zip(bare, most, strict=True)):
            return spread
    else:
        std = np.sqrt(np.maximum(variances, 0.0))
        for i in bare:
            most = np.einsum("jr,jr->r", np.abs(matrix[i]), std)
            if not (spread[i, i] > ROUNDING * most * most).all():
                break
        else:
            return spread
    size = np.abs(matrix)
    summed = np.einsum("ij...,jk...,ik...->i...", size, np.abs(cov), size)
    open_ = np.einsum("ii...->i...", spread) > ROUNDING * summed
    open_[[i for i in range(len(matrix)) if i not in bare]] = True
    return np.where(open_[:, None] & open_[None], spread, 0.0)


def extend(
    mean: Array,
    cov: Array,
    child: slice,
    parents: Index,
    matrix: Array,
    value: Array,
    noise: Array,
    bare: tuple[int, ...] = (),
) -> None:
    """Write the moments of a child y = F x + b + w into those of a joint that has room for it.

    `mean` (m, *batch) and `cov` (m, m, *batch) of the joint are changed in place at the components
    `child`; x is at the components `parents`. `value` (d, *batch) is the mean F E[x] + b of y,
    `matrix` F (d, number of parents, *batch) and `noise` (d, d, *batch) the covariance of w. `bare`
    are the places in y of its bare components: where the variance of such a component is no more
    than rounding, its variance and covariances become zero.
    """
    mean[child] = value
    if not matrix.shape[1]:
        cov[child, child] = noise
        return
    rows = cov[parents]
    before = rows[:, parents]
    with scratch():
        cross, own = _joined(rows, before, matrix, noise)
        if bare:
            own = _certain(own, before, matrix, bare)
        if any(not own[i, i].all() for i in bare):
            cross = cross.copy()
            for i in bare:
                cross[i] = np.where(own[i, i] > 0.0, cross[i], 0.0)
        cov[child] = cross
        cov[:, child] = cross.swapaxes(0, 1)
    cov[child, child] = own


def _joined(rows: Array, cov: Array, matrix: Array, noise: Array) -> tuple[Array, Array]:
    """The covariance of a child y with all of a joint, (d, m, *batch), and its own, (d, d, *batch).

    `rows` (p, m, *batch) are the parents' rows of the joint's covariance, `cov` (p, p, *batch)
    their own. Of a batch the first is in memory of `scratch`.
    """
    quick = _joining(len(matrix), *rows.shape) if rows.ndim == 2 else None
    if quick is not None:
        found: tuple[Array, Array] = quick(rows, cov, matrix, noise)
        return found
    parts = first(rows), first(cov, symmetric=True), first(matrix), first(noise)
    cross, own = (each.array for each in step.joined(*parts))
    return cross, own if rows.ndim > 2 else symmetric(own)


class Update(NamedTuple):
    """A belief N(mean, cov) given a measurement, and the measurement's log-density.

    mean: (n, *batch).
    cov: (n, n, *batch).
    log_density: (*batch); a measured component that the components before it determine adds
        nothing to it.
    square: νᵀS⁻¹ν of the residual ν = z − H mean, (*batch).
    regular: Whether S is not nearly singular: each of its pivots is at least 10⁻⁶ of its diagonal
        entry. A batch always counts as regular if `update` was given a smaller limit, `least`, and
        all pivots are above it.
    left: The distance of each measured component that those before it determine from the value
        determined, and zero for all other components, (d, *batch); None if none is determined.
    certain: How many measured components those before them determine, (*batch); 0 if none.
    """

    mean: Array
    cov: Array
    log_density: Array | float
    square: Array | float
    regular: bool
    left: Array | None
    certain: Integers | int = 0


def update(
    mean: Array,
    cov: Array,
    matrix: Array,
    residual: Array,
    noise: Array,
    *,
    exact: bool = False,
    least: float = NEARLY_SINGULAR,
) -> Update:
    """Condition N(mean, cov) on a measurement z = H x + v, v ~ N(0, noise), of residual z − H mean.

    The mean is m + G (z − H m), and the covariance (I − GH) P (I − GH)ᵀ + G noise Gᵀ, a sum of
    semidefinite terms, with the gain G = P Hᵀ S⁺ and S = H P Hᵀ + noise. `mean` is m (n, *batch),
    `cov` P (n, n, *batch), exactly symmetric, `residual` (d, *batch); of `matrix` H (d, n, *batch)
    and `noise` (d, d, *batch) the batch may be of length one.

    `exact` says that the noise may be singular: `moments` then computes the update, and tells zeros
    from rounding. `moments` also takes over where a pivot of S is at most 10⁻⁶ times its diagonal
    entry, or, for a batch, at most `least` times.
    """
    if not exact:
        arguments = mean, cov, matrix, residual, noise
        found = update_one(*arguments) if cov.ndim == 2 else _update_many(*arguments, least)
        if found is not None:
            return Update(found[0], found[1], found[2], found[3], True, None)
    parts = components_last(mean, 1), components_last(cov, 2), components_last(matrix, 2)
    careful = moments.update(
        *parts, components_last(residual, 1), components_last(noise, 2), exact=exact
    )
    left = None if careful.left is None else components_first(careful.left, 1)
    after = components_first(careful.mean, 1), components_first(careful.cov, 2)
    regular = roots.smallest_pivot(careful.lower) >= NEARLY_SINGULAR
    density: Array | float = careful.log_density
    square: Array | float = careful.square
    if cov.ndim == 2:
        density, square = float(density), float(square)
    certain = 0 if left is None else roots.determined(careful.lower).sum(axis=-1)
    return Update(*after, density, square, regular, left, certain)


def update_one(
    mean: Array, cov: Array, matrix: Array, residual: Array, noise: Array
) -> tuple[Array, Array, float, float] | None:
    """Condition one Gaussian on a measurement: mean, covariance, log-density, and square νᵀS⁻¹ν.

    They are (n,), (n, n) and two numbers. `mean` is m (n,), `cov` P (n, n), `matrix` H (d, n),
    `residual` z − H m (d,) and `noise` R (d, d). None if a pivot of S is at most 10⁻⁶ of its
    diagonal entry.
    """
    quick = _updating(len(mean), len(residual))
    if quick is not None:
        found: tuple[Array, Array, float, float] | None
        found = quick(mean, cov, matrix, residual, noise)
        return found
    vectors = Dense(mean[:, None]), Dense(residual[:, None])
    after = step.update(vectors[0], Dense(cov), Dense(matrix), vectors[1], Dense(noise))
    if not after.share > NEARLY_SINGULAR:
        return None
    told: tuple[float, float] = _likely(after, len(residual))
    return after.mean.array[:, 0], symmetric(after.cov.array), *told


def _update_many(
    mean: Array, cov: Array, matrix: Array, residual: Array, noise: Array, least: float
) -> tuple[Array, Array, Array, Array] | None:
    """The means, covariances, log-densities and squares of `update` for a batch of runs.

    None if a pivot of S is at most `least` times its diagonal entry, in any run.
    """
    found: tuple[Array, Array, Array, Array] | None
    width, height, runs = len(mean), len(residual), cov.shape[-1] if cov.ndim == 3 else _SHORT + 1
    for function in _updating_each(width, height) if runs <= _FEWEST else ():
        found = function(mean, cov, matrix, residual, noise)
        if found is not None:
            return found
    if width * height * (width + height) > _BRIEF and runs <= _STACKED:
        return _update_stack(mean, cov, matrix, residual, noise, least)
    quick = _updating_rows(width, height, least) if runs <= _SHORT else ()
    with quiet():  # of what is not regular
        for function in quick:
            found = function(mean, cov, matrix, residual, noise)
            if found is not None:
                return found
    if quick:
        return None
    belief, slope, error = Runs(cov, True), Runs(matrix), Runs(noise, True)
    before, off = Runs(mean[:, None]), Runs(residual[:, None])
    with scratch():
        cross, spread = step.crossed(belief, slope, error)
        root = spread.root()
        if not (root.share > least).all():
            return None
        if _is_mild(noise, root, least):
            after = step.lessened(before, belief, off, root, cross)
        else:
            gain = step.gain(root, cross)
            after = step.given(before, belief, slope, off, error, root, gain)
        return after.mean.array[:, 0], after.cov.array, *_likely(after, len(residual))


def _update_stack(
    mean: Array, cov: Array, matrix: Array, residual: Array, noise: Array, least: float
) -> tuple[Array, Array, Array, Array] | None:
    """The result of `_update_many` by LAPACK, of few runs."""
    belief, slope = Stack(components_last(cov, 2), True), Stack(components_last(matrix, 2))
    before, off = (Stack.column(components_last(each, 1)) for each in (mean, residual))
    error = Stack(components_last(noise, 2), True)
    cross, spread = step.crossed(belief, slope, error)
    try:
        root = RegularRoot(spread)
    except np.linalg.LinAlgError:
        return None
    if not (root.share > least).all():
        return None
    after = step.given(before, belief, slope, off, error, root, step.gain(root, cross))
    moments_ = components_first(after.mean.vector, 1), components_first(after.cov.array, 2)
    return *moments_, *_likely(after, len(residual))


def _is_mild(noise: Array, root: RunsRoot, least: float) -> bool:
    """Whether it is known that measurements shrink no variance more than a thousand times.

    So it is where det S < 1000 det R, R being the `noise` and `root` that of S: as S ≥ R, S is then
    at most 1000 R in every direction.
    """
    if noise.shape[-1] > 1:
        many = Runs(noise).root()
        regular, further = many.share.min() > _MILD * least, root.volume - many.volume
    else:
        one = Dense(noise[..., 0]).root()
        regular, further = one.share > _MILD * least, root.volume - one.volume
    return bool(regular and further.max() < 0.5 * log(_MILD))


def _likely(after: step.Updated, size: int) -> tuple[Number, Number]:
    """How likely a measurement of d = `size` components is: its log-density, and rᵀ S⁻¹ r.

    The log-density is −(rᵀ S⁻¹ r + d ln 2π) / 2 − ln |S| / 2.
    """
    return -0.5 * (after.square + size * LOG_2PI) - after.volume, after.square


def _is_small(size: int, height: int) -> bool:
    """Whether lines of Python are quicker than LAPACK, for n = `size` and d = `height`."""
    return 0 < size * height * (size + height) <= _MOST


@lru_cache(maxsize=64)
def _updating(size: int, height: int) -> Callable[..., Any] | None:
    """The function `update_one` of n components and d measurements; None where they are many."""
    if not _is_small(size, height):
        return None

    def body(*moments: Matrix) -> tuple[list[Any], Any]:
        after = step.update(*moments)
        arrays = written.array(after.mean, size), written.array(after.cov, size, size)
        return [*arrays, *_likely(after, height)], after.share > NEARLY_SINGULAR

    return written.function(_shapes(size, height), body)


@lru_cache(maxsize=64)
def _updating_each(size: int, height: int) -> tuple[Callable[..., Any], ...]:
    """The functions `_update_many` of several runs, one by one: of mild ones, and of any.

    There is none where n components and d measurements are many.
    """
    if not _is_small(size, height):
        return ()

    def told(after: step.Updated, truth: Any) -> tuple[list[Any], Any]:
        return [after.mean.columns[0], after.cov, *_likely(after, height)], truth

    shapes, bodies = _shapes(size, height), _bodies(NEARLY_SINGULAR, told)
    return tuple(written.each(shapes, body) for body in bodies)


@lru_cache(maxsize=64)
def _updating_rows(size: int, height: int, least: float) -> tuple[Callable[..., Any], ...]:
    """The functions `_update_many` of rows of runs: of mild measurements, and of any.

    There is none where n components and d measurements are many.
    """
    if not 0 < size * height * (size + height) <= _FEW:
        return ()

    def told(after: step.Updated, truth: Any) -> tuple[list[Any], Any]:
        arrays = written.rows(after.mean, size), written.rows(after.cov, size, size)
        return [*arrays, *_likely(after, height)], written.Written("({}).all()", truth)

    shapes, bodies = _shapes(size, height), _bodies(least, told)
    return tuple(written.function(shapes, body, along_runs=True) for body in bodies)


def _bodies(
    least: float, told: Callable[[step.Updated, Any], tuple[list[Any], Any]]
) -> tuple[written.Body, written.Body]:
    """The updates of mild measurements, and of any, and whether they are that: as they are told.

    None is where a pivot of S is at most `least` times its diagonal entry; see `_is_mild`.
    """

    def mild(
        mean: Matrix, cov: Matrix, matrix: Matrix, residual: Matrix, noise: Matrix
    ) -> tuple[list[Any], Any]:
        cross, spread = step.crossed(cov, matrix, noise)
        own, root = noise.root(), spread.root()
        regular = (root.share > least) & (own.share > _MILD * least)
        return told(
            step.lessened(mean, cov, residual, root, cross),
            regular & (root.volume - own.volume < 0.5 * log(_MILD)),
        )

    def every(*moments: Matrix) -> tuple[list[Any], Any]:
        after = step.update(*moments)
        return told(after, after.share > least)

    return mild, every


def _shapes(size: int, height: int) -> dict[str, tuple[int, ...]]:
    """The shapes of what `update` takes, of n components and d measurements."""
    shapes = {"mean": (size,), "cov": (size, size), "matrix": (height, size)}
    return {**shapes, "residual": (height,), "noise": (height, height)}


@lru_cache(maxsize=64)
def _predicting(height: int, size: int) -> Callable[..., Any] | None:
    """The function `predict` of d components from n; None where they are many."""
    if not _is_small(size, height):
        return None

    def body(*matrices: Matrix) -> tuple[list[Any], Any]:
        return [written.array(step.predict(*matrices), height, height)], True

    shapes = {"cov": (size, size), "matrix": (height, size), "noise": (height, height)}
    return written.function(shapes, body)


@lru_cache(maxsize=64)
def _joining(height: int, parents: int, size: int) -> Callable[..., Any] | None:
    """The function `_joined` of d components from p of m; None where they are many."""
    if not _is_small(parents, height) or height * parents * size > _MOST:
        return None

    def body(*matrices: Matrix) -> tuple[list[Any], Any]:
        across, own = step.joined(*matrices)
        return [written.array(across, height, size), written.array(own, height, height)], True

    shapes = {"rows": (parents, size), "cov": (parents, parents)}
    shapes |= {"matrix": (height, parents), "noise": (height, height)}
    return written.function(shapes, body)


@lru_cache(maxsize=64)
def _checking(size: int, least: float, far: float) -> Callable[..., Any] | None:
    """The function `is_moderate` of n components, each with a variance; None where n is large."""
    if not 0 < size**3 <= _MOST:
        return None

    def body(mean: Matrix, cov: Matrix, before: Matrix) -> tuple[list[Any], Any]:
        truth = cov.root().share > least
        for k in range(size):
            m, variance = mean[k, 0], cov[k, k]
            truth = truth & (variance > least * before[k, k]) & (far * variance > m * m)
        return [True], truth

    shapes = {"mean": (size,), "cov": (size, size), "before": (size, size)}
    return written.function(shapes, body)
