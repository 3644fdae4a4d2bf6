r"""The steps of a Gaussian chain, each written once, over matrices of any numbers.

A belief is N(m, P), a mean m (n × 1) and a covariance P (n × n). A motion is y = F x + b + e,
e ~ N(0, N), and a measurement z = H x + v, v ~ N(0, R), of d components, with the residual
r = z − H m. See `numbers` for what a matrix is here; here are the formulas, and their order of
sums. What counts as rounding, and where to go on with more care, is decided by those who call:
each result tells the *share* of its root, the least part of a diagonal entry that is left to a
pivot.

The Kalman filter is `push`, of which `predict` is the covariance, and `update`. The smoother of
Rauch, Tung and Striebel turns each motion round by `reverse`, and goes back by `push`: the belief
of a step is that of the next one, pushed through the reversed motion.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from pgm.kernels.numbers import Number, inner, nearest_whole, where

TURN = 2.0 * math.pi
# A matrix of numbers of any kind; the kinds have their operations in common, and no class.
AnyMatrix = Any


def predict(cov: AnyMatrix, matrix: AnyMatrix, noise: AnyMatrix) -> AnyMatrix:
    """The covariance F P Fᵀ + N of y = F x + b + e."""
    return crossed(cov, matrix, noise)[1]


def crossed(cov: AnyMatrix, matrix: AnyMatrix, noise: AnyMatrix) -> tuple[AnyMatrix, AnyMatrix]:
    """The covariance F P of y = F x + b + e with x, and its own, F P Fᵀ + N."""
    cross = matrix @ cov
    return cross, cross.times(matrix) + noise


def push(
    mean: AnyMatrix, cov: AnyMatrix, matrix: AnyMatrix, offset: AnyMatrix, noise: AnyMatrix
) -> tuple[AnyMatrix, AnyMatrix]:
    """The mean F m + b and the covariance F P Fᵀ + N of y = F x + b + e."""
    return matrix @ mean + offset, predict(cov, matrix, noise)


def squares(cov: AnyMatrix, gain: AnyMatrix, matrix: AnyMatrix, noise: AnyMatrix) -> AnyMatrix:
    """The covariance (I − G H) P (I − G H)ᵀ + G R Gᵀ of x − G (z − H m), for any gain G.

    It is a sum of squares, which loses no digits (Bucy and Joseph, 1968).
    """
    return squares_by((gain @ matrix).one_minus(), cov, gain, noise)


def squares_by(keep: AnyMatrix, cov: AnyMatrix, gain: AnyMatrix, noise: AnyMatrix) -> AnyMatrix:
    """The `squares`, K P Kᵀ + G R Gᵀ, by the matrix K = I − G H."""
    return (keep @ cov).times(keep) + (gain @ noise).times(gain)


class Updated(NamedTuple):
    """A belief given a measurement, and what tells how likely that was.

    `square` is rᵀ S⁻¹ r and `volume` ln |S| / 2, so that the measurement's log-density is
    −(square + d ln 2π) / 2 − volume; `share` is that of the root of S = H P Hᵀ + R.
    """

    mean: AnyMatrix
    cov: AnyMatrix
    square: Number
    volume: Number
    share: Number


def update(
    mean: AnyMatrix, cov: AnyMatrix, matrix: AnyMatrix, residual: AnyMatrix, noise: AnyMatrix
) -> Updated:
    """Bayes' rule for a measurement: m + G r, with the gain G = P Hᵀ S⁻¹, and P by `squares`."""
    cross, spread = crossed(cov, matrix, noise)
    root = spread.root()
    return given(mean, cov, matrix, residual, noise, root, gain(root, cross))


class Innovation(NamedTuple):
    """How likely a measurement is: `square`, `volume` and `share` as of `Updated`."""

    square: Number
    volume: Number
    share: Number


def innovation(residual: AnyMatrix, spread: AnyMatrix) -> Innovation:
    """How likely a measurement of this residual is, S being `spread`; no belief takes it in."""
    return innovation_by(residual, spread.root())


def innovation_by(residual: AnyMatrix, root: Any) -> Innovation:
    """The `innovation` by the root of S."""
    white = root.solve(residual)
    return Innovation((white.T @ white)[0, 0], root.volume, root.share)


def gain(root: Any, cross: AnyMatrix) -> AnyMatrix:
    """The gain Cᵀ S⁻¹, for C = `cross`, H P or F P, and the root of S."""
    return root.solve_transposed(root.solve(cross)).T


def given(
    mean: AnyMatrix,
    cov: AnyMatrix,
    matrix: AnyMatrix,
    residual: AnyMatrix,
    noise: AnyMatrix,
    root: Any,
    gain: AnyMatrix,
) -> Updated:
    """The belief given a measurement, of which the root of S and the gain G are known."""
    white = root.solve(residual)
    after = squares(cov, gain, matrix, noise)
    return Updated(mean + gain @ residual, after, (white.T @ white)[0, 0], root.volume, root.share)


def lessened(
    mean: AnyMatrix, cov: AnyMatrix, residual: AnyMatrix, root: Any, cross: AnyMatrix
) -> Updated:
    """The belief given a measurement by differences: m + Cᵀ S⁻¹ r and P − Cᵀ S⁻¹ C, C = H P.

    `root` is L of S = L Lᵀ: of W = L⁻¹ [r C] the product Wᵀ W has all that changes. It takes a
    third of the products of `given`, and loses as many digits as a variance, in whatever direction,
    falls by: it is for measurements of which it is known that they are no sharper.
    """
    white = root.solve(residual.beside(cross)).T
    known, first, rest = white.times(white), range(1), range(1, 1 + cross.shape[1])
    change, less = known.part(rest, first), known.part(rest, rest)
    return Updated(mean + change, cov - less, known[0, 0], root.volume, root.share)


def gain_back(cov: AnyMatrix, matrix: AnyMatrix, later: AnyMatrix) -> tuple[AnyMatrix, Any]:
    """The gain G = P Fᵀ Q⁻¹ of the smoother, Q = `later` being F P Fᵀ + N; and the root of Q."""
    root = later.root()
    return gain(root, matrix @ cov), root


class Back(NamedTuple):
    """A belief given all measurements, and the root of Q, the next one's predicted covariance."""

    mean: AnyMatrix
    cov: AnyMatrix
    root: Any


def back(
    mean: AnyMatrix,
    cov: AnyMatrix,
    matrix: AnyMatrix,
    noise: AnyMatrix,
    predicted: tuple[AnyMatrix, AnyMatrix],
    later: tuple[AnyMatrix, AnyMatrix],
) -> Back:
    """The smoother's step back from y = F x + b + e, of which N(q, Q) was predicted.

    Of y's mean s and covariance S given all measurements it is m + G (s − q), and the `squares`
    (I − G F) P (I − G F)ᵀ + G (N + S) Gᵀ.
    """
    gain, root = gain_back(cov, matrix, predicted[1])
    known = mean + gain @ (later[0] - predicted[0])
    return Back(known, squares(cov, gain, matrix, noise + later[1]), root)


class Reversed(NamedTuple):
    """A motion reversed: x = G y + offset + e, e ~ N(0, cov); and the root of Q."""

    gain: AnyMatrix
    offset: AnyMatrix
    cov: AnyMatrix
    root: Any


def reverse(
    mean: AnyMatrix,
    cov: AnyMatrix,
    matrix: AnyMatrix,
    noise: AnyMatrix,
    later_mean: AnyMatrix,
    later_cov: AnyMatrix,
) -> Reversed:
    """The motion y = F x + b + e reversed: p(x | y), from x ~ N(m, P) and y's own prediction."""
    gain, root = gain_back(cov, matrix, later_cov)
    return Reversed(gain, mean - gain @ later_mean, squares(cov, gain, matrix, noise), root)


def extend(
    cov: AnyMatrix, parents: Sequence[int], matrix: AnyMatrix, noise: AnyMatrix
) -> AnyMatrix:
    """The covariance of (x, y) for y = F x[parents] + b + e, from that of x."""
    rows = cov.part(parents, range(cov.shape[0]))
    return cov.bordered(*joined(rows, cov.part(parents, parents), matrix, noise))


def joined(
    rows: AnyMatrix, own: AnyMatrix, matrix: AnyMatrix, noise: AnyMatrix
) -> tuple[AnyMatrix, AnyMatrix]:
    """The covariance of y = F x[parents] + b + e with all of x, and its own.

    `rows` are the parents' rows of the covariance of x, `own` their columns of these.
    """
    return matrix @ rows, predict(own, matrix, noise)


class Seen(NamedTuple):
    """A measurement's residual, H and R, in which missing components say nothing."""

    residual: AnyMatrix
    matrix: AnyMatrix
    noise: AnyMatrix


def seen(known: Any, residual: AnyMatrix, matrix: AnyMatrix, noise: AnyMatrix) -> Seen:
    """A measurement in which components that are not `known` are readings of unit noise alone."""
    return Seen(residual.kept(known), matrix.kept(known), noise.independent(known))


def known_part(cov: AnyMatrix, known: Any) -> AnyMatrix:
    """A covariance with zeros in the rows and columns of components that are not `known`."""
    return cov.kept(known).T.kept(known)


def turns(angle: Number) -> Number:
    """The whole turns in an angle: less these, it is within half a turn of zero."""
    return TURN * nearest_whole(angle / TURN)


def nearest(reading: Number, value: Number) -> Number:
    """An angle's reading on the branch nearest to a value: moved by whole turns, if it is far."""
    off = reading - value
    return where(abs(off) > math.pi, reading - turns(off), reading)


class Rule(NamedTuple):
    """A rule's regression on its N fixed points, as constant matrices of the kind at hand.

    Products with the values Y (N × d) are: `mean` (1 × N) the line's value at the mean; `slope`
    (n × N) its slope along the points; `rest` (K × N) rows R by which the covariance of what the
    line leaves is Rᵀ diag(signs) R, `signs` (K × K) being a diagonal of ±1, or None for I.
    """

    mean: AnyMatrix
    slope: AnyMatrix
    rest: AnyMatrix
    signs: AnyMatrix | None


class Regressed(NamedTuple):
    """The line F (x − m) + value of a statistical linear regression, and its error's covariance.

    `moment` is (F L)ᵀ (n × d), the slope along the points.
    """

    matrix: AnyMatrix
    value: AnyMatrix
    error: AnyMatrix
    moment: AnyMatrix


def regress(root: Any, rule: Rule, values: AnyMatrix) -> Regressed:
    """The regression of a function's values Y (N × d) at the points m + L s, L the root of P."""
    left = (rule.rest @ values).T
    weighed = left if rule.signs is None else left @ rule.signs
    return regressed(root, (rule.mean @ values).T, rule.slope @ values, left, weighed)


def regressed(
    root: Any, value: AnyMatrix, moment: AnyMatrix, left: AnyMatrix, weighed: AnyMatrix
) -> Regressed:
    """The regression whose line over the points s is known, with what it leaves of the values.

    The slope F solves F L = Jᵀ, J = `moment` (n × d) being that along s. What is left is X = `left`
    (d × K), and `weighed` is X W, so that the error's covariance is X W Xᵀ.
    """
    return Regressed(root.solve_transposed(moment).T, value, weighed.times(left), moment)


def open_share(cov: AnyMatrix, varies: Any) -> Number:
    """The least share of a component's variance that the components before it leave open.

    Components count of which `varies` is true, a truth for each: those with a variance. Of what
    is not positive definite the share is zero.
    """
    share = cov.independent(varies).root().share
    return where(share > 0.0, share, 0.0)


def inflation(cov: AnyMatrix, root: Any) -> Number:
    """The sum of the variance inflation factors of a covariance P, tr C⁻¹ of its correlations C.

    The factor of a component is its variance divided by its variance given all others; `root` is
    that of P.
    """
    return inner(cov.diagonal, root.precisions)


class Whitened(NamedTuple):
    """A measurement's residual by a belief, in units of its noise R = L Lᵀ.

    `residual` is y = L⁻¹ r; `spread`, B = L⁻¹ H P Hᵀ L⁻ᵀ, is the covariance that the belief gives
    it, and `error`, E = L⁻¹ Ω L⁻ᵀ, that of the line's error: None for what is zero, or does not
    count.
    """

    residual: AnyMatrix
    spread: AnyMatrix = None
    error: AnyMatrix = None

    @property
    def square(self) -> Number:
        """The square yᵀ y = rᵀ R⁻¹ r, of which robust weights are functions.

        It is the one that is expected where a belief is told: with tr (B + E) besides.
        """
        total = (self.residual.T @ self.residual)[0, 0]
        for part in (self.spread, self.error):
            for variance in () if part is None else part.diagonal:
                total = total + variance
        return total


def whitened(
    residual: AnyMatrix,
    root: Any,
    matrix: AnyMatrix = None,
    cov: AnyMatrix = None,
    error: AnyMatrix = None,
) -> Whitened:
    """The residual of a measurement, and its covariances by P and Ω, in units of its noise.

    `root` is L of the noise R = L Lᵀ. Without H and P the residual is that of a mean alone.
    """
    white = root.solve(residual)
    if cov is None:
        return Whitened(white)
    rows = root.solve(matrix)
    own = None if error is None else root.solve(root.solve(error).T)
    return Whitened(white, (rows @ cov).times(rows), own)


def reweighed(before: Whitened, weight: Number, *, expects: bool) -> Whitened:
    """The residual by the belief that has taken in its measurement with the noise R / w.

    This is the update seen from the measurement, of as many components as that has. For
    M = I + w (B + E) the residual is (I + w E) M⁻¹ y, and B becomes (I + w E) M⁻¹ B: products, in
    place of the update's differences. Covariances count if the square `expects` them.
    """
    spread, error = before.spread, before.error
    whole = spread if error is None else spread + error
    root = whole.scaled(-weight).one_minus().root()

    def after(matrix: AnyMatrix) -> AnyMatrix:
        part = root.solve_transposed(root.solve(matrix))
        return part if error is None else part + error.scaled(weight) @ part

    residual = after(before.residual)
    return Whitened(residual, after(spread), error) if expects else Whitened(residual)
