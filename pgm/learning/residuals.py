r"""Expected second moments of a CPD's residuals, given all measurements.

With w the hidden parents and the child of a family, Gaussian given all measurements with mean m and
covariance C, the residual r = y − f(p) is a line in them, r = A (w − m) + e + ε, exactly for affine
CPDs. Others are linearised at the smoothed belief of their parents, by their lineariser, whose
error ε has the covariance Ω. The sums over rows of

    E[r rᵀ] = e eᵀ + A C Aᵀ + Ω,    E[r gᵀ] = e ḡᵀ + A C G,    E[g gᵀ] = ḡ ḡᵀ + Gᵀ C G,

g being the parents and a one, are all that M steps need. Rows have weights where a belief is of
several Gaussians, or a CPD may not hold. Moments of a measurement with robust noise, which counts
with the covariance R / w, enter with its weight w. Of a measurement with missing components these
are expected too, given those that are there.

Kokkala, Solin & Särkkä (2015) have expectations over the joint, which are equal where integrals are
exact: these are over the parents alone (Stein's lemma).
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from pgm.cpds import AffineCPD
from pgm.kernels.angles import nearest_branch
from pgm.kernels.arrays import (
    Array,
    Mask,
    apply,
    components_last,
    independent,
    quiet,
    symmetric,
    transpose,
)
from pgm.kernels.moments import predict
from pgm.kernels.solving import regression
from pgm.learning.robust import of_noise
from pgm.linearisation.family import Family
from pgm.posteriors.expectations import FamilyBelief
from pgm.variables import Variable

Known = Mapping[Variable, Array]
_EPS = 2.0**-52


@dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of a CPD at rows and runs that have a measurement, N in all, flattened.

    The mean e (N, d), the line A (1 or N, d, n), the covariance C (N, n, n), the error Ω with what
    missing components add (1 or N, d, d), the regressors ḡ (N, k), of which the components of
    `hidden` parents stand first, and the CPD's own noise (1 or N, d, d). The `weight` (N,) is what
    a row counts for, the probability that it is of the CPD; its moments enter with the
    `factor` (N,), which is also of the weight of robust noise. None where all are one. `scale` has
    the weight and the factor that rows have in the covariance of a loss, None if they are these.
    """

    mean: Array
    line: Array
    cov: Array
    error: Array
    regressors: Array
    noise: Array
    hidden: int
    weight: Array | None = None
    factor: Array | None = None
    scale: tuple[Array, Array] | None = None

    @property
    def of_noise(self) -> Residuals:
        """The residuals as they enter the covariance of the noise."""
        if self.scale is None:
            return self
        weight, factor = self.scale
        return replace(self, weight=weight, factor=factor, scale=None)

    @property
    def count(self) -> float:
        """The number of rows, N, or the sum of their weights."""
        return len(self.mean) if self.weight is None else float(self.weight.sum())

    def weighted(self, values: Array) -> Array:
        """Values (N, ...), or (1, ...), of rows times their factors."""
        return _times(self.factor, values)

    def counted(self, values: Array) -> Array:
        """Values (N, ...), or (1, ...), of rows times their weights."""
        return _times(self.weight, values)

    def rows(self) -> tuple[Array, Array, Array]:
        """The moments E[r rᵀ], E[r gᵀ] and E[g gᵀ] of each row."""
        hidden = self.hidden
        across = self.line @ self.cov
        own = self.mean[:, :, None] * self.mean[:, None, :] + across @ transpose(self.line)
        cross = self.mean[:, :, None] * self.regressors[:, None, :]
        cross[..., :hidden] += across[..., :hidden]
        gram = self.regressors[:, :, None] * self.regressors[:, None, :]
        gram[:, :hidden, :hidden] += self.cov[:, :hidden, :hidden]
        own = symmetric(own + self.error)
        return self.weighted(own), self.weighted(cross), self.weighted(gram)

    def sums(self, reference: Array | float = 0.0) -> tuple[Array, Array, Array]:
        """The sums of these over the rows, the regressors counted from a reference point."""
        hidden, g = self.hidden, self.regressors - reference
        cov, mean = self.weighted(self.cov), self.weighted(self.mean)
        if len(self.line) == 1:
            spread = cov.sum(axis=0)
            across = self.line[0] @ spread
            around = across @ self.line[0].T
        else:
            every = self.line @ cov
            across = every.sum(axis=0)
            around = np.einsum("rin,rjn->ij", every, self.line)
            spread = cov[:, :hidden, :hidden].sum(axis=0)
        one = len(self.error) == 1
        total = len(self.mean) if self.factor is None else float(self.factor.sum())
        error = total * self.error[0] if one else self.weighted(self.error).sum(axis=0)
        own = mean.T @ self.mean + around + error
        cross, gram = mean.T @ g, self.weighted(g).T @ g
        cross[:, :hidden] += across[:, :hidden]
        gram[:hidden, :hidden] += spread[:hidden, :hidden]
        return symmetric(own), cross, symmetric(gram)


def _times(factor: Array | None, values: Array) -> Array:
    """Values (N, ...), or (1, ...), times a factor (N,) of each row, None for one."""
    if factor is None:
        return values
    found: Array = factor.reshape(-1, *(1,) * (values.ndim - 1)) * values
    return found


def at_values(family: Family, known: Known) -> Family:
    """A family with other values of some observed parents."""
    changed = {
        parent: np.broadcast_to(known[parent], values.shape)
        for parent, values in family.inputs.items()
        if parent in known
    }
    if not changed:
        return family
    other = copy(family)
    for name in ("_known", "_by_row"):
        other.__dict__.pop(name, None)
    other.inputs = {**family.inputs, **changed}
    return other


def lines(belief: FamilyBelief, known: Known) -> tuple[Array, Array, Array | None]:
    """The CPD at the belief of its hidden parents: values (rows, runs, d), F, and its error."""
    family = at_values(belief.family, known)
    size = family.shape[-1]
    mean, cov = belief.mean[..., :size], belief.cov[..., :size, :size]
    if isinstance(family.cpd, AffineCPD):
        matrix, shift = family.affine
        if family is not belief.family:
            step = family.step[:, None]
            matrix, shift = family.cpd._affine(family.hidden, family.inputs, step)
        value = apply(matrix, mean) if matrix.ndim > 2 else mean @ matrix.T
        return value + shift, matrix, None
    line = family.checked(family.bound(slice(None), 2, mean.shape[:-1]), mean, cov)
    error = None if line.error is None else components_last(line.error, 2)
    return components_last(line.value, 1), components_last(line.matrix, 2), error


@quiet()
def residuals(belief: FamilyBelief, known: Known) -> Residuals:
    """The residuals of a family, at some values of parameters."""
    family, (value, matrix, error) = belief.family, lines(belief, known)
    rows, runs, height, hidden = family.shape
    child = belief.mean[..., hidden:] if belief.values is None else belief.values
    child = np.broadcast_to(child, (rows, runs, height))
    mean = nearest_branch(child, value, family.cpd.child.angle_mask) - value
    width = belief.mean.shape[-1]
    line = np.zeros((*matrix.shape[:-1], width))
    line[..., :hidden] = -matrix
    if belief.values is None:
        line[..., hidden:] = np.eye(height)
    inputs = [family.inputs[p] for p in family.cpd.given if p not in family.hidden]
    seen = [np.broadcast_to(v, (rows, runs, v.shape[-1])) for v in inputs]
    flat = rows * runs
    if belief.cut is not None:
        error = belief.cut if error is None else error + belief.cut
    g = np.concatenate([belief.mean[..., :hidden], *seen, np.ones((rows, runs, 1))], axis=-1)
    zero = np.zeros((1, height, height))
    shares = None if belief.weights is None else belief.weights.reshape(flat)
    found = Residuals(
        mean.reshape(flat, height),
        _flat(line, rows, runs),
        belief.cov.reshape(flat, width, width),
        zero if error is None else _flat(error, rows, runs),
        g.reshape(flat, g.shape[-1]),
        _flat(family.own_noise, rows, runs),
        hidden,
        shares,
        shares,
    )
    if belief.robust is not None:
        found = _robust(found, belief)
    if belief.taken is None:
        return found
    taken = np.broadcast_to(belief.taken, (rows, runs, height)).reshape(flat, height)
    return _expected(found, taken)


@quiet()
def rounded(belief: FamilyBelief, known: Known) -> Array:
    """The deviations (d,) that rounding alone gives to residuals y − f: ε (max |y| + max |f|)."""
    value, *_ = lines(belief, known)
    hidden = belief.family.shape[-1]
    child = belief.mean[..., hidden:] if belief.values is None else belief.values
    child = child if belief.taken is None else np.where(belief.taken, child, 0.0)
    largest: Array = sum(np.abs(each).max(axis=(0, 1), initial=0.0) for each in (child, value))
    return _EPS * largest


def _robust(found: Residuals, belief: FamilyBelief) -> Residuals:
    """The residuals of robust noise, whose moments are weighed."""
    noise, robust = belief.family.cpd.noise, belief.robust
    assert noise is not None
    assert robust is not None
    weight = robust.weight.reshape(-1)
    factor = _times(found.weight, weight)
    if noise.distribution:
        if robust.information is None:
            return replace(found, factor=factor)
        # Its moments enter times w, and so the covariances by score times the information.
        share = robust.information / weight
        return replace(found, factor=factor, cov=found.cov * share[:, None, None])
    spread, own = predict(found.cov, found.line, found.error), found.noise
    if belief.taken is not None:
        taken = np.broadcast_to(belief.taken, (*robust.weight.shape, spread.shape[-1]))
        taken = taken.reshape(spread.shape[:-1])
        both = taken[:, :, None] & taken[:, None, :]
        spread, own = np.where(both, spread, 0.0), independent(np.where(both, own, 0.0), taken)
    share = np.trace(regression(spread, own), axis1=-2, axis2=-1).reshape(robust.weight.shape)
    share = np.clip(share / np.maximum(robust.components, 1), 0.0, 1.0)
    counted, scaled = (
        _times(found.weight, each.ravel()) for each in of_noise(noise, robust, share)
    )
    return replace(found, factor=factor, scale=(counted, scaled))


def _flat(array: Array, rows: int, runs: int) -> Array:
    """Matrices (rows or 1, runs or 1, ...) as (rows · runs or 1, ...)."""
    if array.ndim == 2:
        return array[None]
    if array.shape[:2] == (1, 1):
        single: Array = array[0]
        return single
    wide = np.broadcast_to(array, (rows, runs, *array.shape[2:]))
    found: Array = wide.reshape(rows * runs, *array.shape[2:])
    return found


def _expected(found: Residuals, taken: Mask) -> Residuals:
    """The residuals of measurements of which some components are missing.

    A missing one is, given those there, K r + n, K = R_mo R_oo⁻¹, n of covariance R_mm − K R_om,
    divided by its weight where noise is robust: so that in a covariance it counts for itself.
    """
    there: Mask = np.asarray(taken.any(axis=-1))
    if not there.all():
        found = _at(found, there)
        taken = taken[there]
    if taken.all():
        return found
    count, height = found.mean.shape
    change = np.empty((count, height, height))
    added = np.zeros((count, height, height))
    noise = np.broadcast_to(found.noise, (count, height, height))
    for pattern in np.unique(taken, axis=0):
        rows, seen = (taken == pattern).all(axis=-1), np.flatnonzero(pattern)
        lost = np.flatnonzero(~pattern)
        own = noise[rows]
        gain = regression(own[:, lost[:, None], seen], own[:, seen[:, None], seen])
        keep = np.zeros((len(own), height, height))
        keep[:, seen, seen] = 1.0
        keep[:, lost[:, None], seen] = gain
        change[rows] = keep
        rest = np.zeros_like(keep)
        rest[:, lost[:, None], lost] = (
            own[:, lost[:, None], lost] - gain @ own[:, seen[:, None], lost]
        )
        added[rows] = symmetric(rest)
    own = found.of_noise
    if own.factor is not None:
        some = np.where(own.factor > 0.0, own.factor, 1.0)
        added = own.counted(added) / some[:, None, None]
    return replace(
        found,
        mean=(change @ found.mean[..., None])[..., 0],
        line=change @ found.line,
        error=predict(found.error, change, added),
    )


def _at(found: Residuals, rows: Mask) -> Residuals:
    def part(array: Array) -> Array:
        return array if len(array) == 1 and len(rows) != 1 else array[rows]

    return Residuals(
        found.mean[rows],
        part(found.line),
        found.cov[rows],
        part(found.error),
        found.regressors[rows],
        part(found.noise),
        found.hidden,
        None if found.weight is None else found.weight[rows],
        None if found.factor is None else found.factor[rows],
        None if found.scale is None else (found.scale[0][rows], found.scale[1][rows]),
    )
