r"""Robust noise: densities of residuals with heavier tails than the Gaussian's.

A residual r with the covariance R has the Mahalanobis square s = rᵀ R⁻¹ r; a robust noise has the
density c |R|^{−1/2} exp(−ρ(s)) with a concave loss ρ. The tangent of ρ at a square is that of a
Gaussian of covariance R / w, with the weight w(s) = 2 ρ′(s), and lies nowhere below ρ.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from pgm.cpds.radius import Radius, kept
from pgm.display import ByAttributes
from pgm.errors import ModelError
from pgm.kernels.arrays import LOG_2PI, Array

# A weight is no smaller, so that the covariance R / w exists.
LEAST = 1e-150


class RobustNoise(ByAttributes, ABC):
    r"""A noise whose residuals count the less the larger they are; base for one of your own.

    .. math:: p(r) = c\, |R|^{-1/2} \exp(-\rho(s)), \quad s = r^\top R^{-1} r

    A noise of your own is a subclass with the loss ρ of a square s, concave in s, and its slope
    2 ρ′(s), the weight of a residual. The scale c, and draws, are found from the loss by
    integrals along the radius √s, unless the subclass has its own. A density without a finite
    integral says so by `is_proper`.

    Attributes
    ----------
    graduated : bool
        Whether the loss is approached by stages, from a convex one on: `first_stage`,
        `next_stage`, `staged` and `staged_loss`. A stage is a number of your own for each run,
        infinite where the loss is the one asked for. Measurements of a weight below ½ then count
        as rejected for ``posterior.lost``; ``posterior.rejected`` has the decisions of gates alone.
    distribution : bool
        Whether the density is meant as the distribution of all residuals, so that the R that
        `pgm.fit` learns is the likeliest one. Else it spares a Gaussian from outliers, and R is
        learnt as the covariance of that Gaussian.

    Examples
    --------
    The pseudo-Huber loss, √(1 + s/δ²) − 1 times δ²:

    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class PseudoHuber(pgm.RobustNoise):
    ...     delta: float
    ...
    ...     def loss(self, square, count):
    ...         return self.delta**2 * (np.sqrt(1.0 + square / self.delta**2) - 1.0)
    ...
    ...     def slope(self, square, count):
    ...         return 1.0 / np.sqrt(1.0 + square / self.delta**2)
    >>> from pgm.examples import x
    >>> z = pgm.Variable("z")
    >>> sensor = pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1.0, noise=PseudoHuber(2.0))
    >>> sensor.noise.weight(np.array([0.0, 12.0]), 1)
    array([1. , 0.5])
    """

    graduated: ClassVar[bool] = False
    distribution: ClassVar[bool] = False

    @abstractmethod
    def loss(self, square: Array, count: npt.ArrayLike) -> Array:
        """The loss ρ(s) of squares, zero at zero.

        Parameters
        ----------
        square : ndarray
            (...): s = νᵀR⁻¹ν of residuals ν.
        count : array_like of int
            How many components were measured, of the shape of `square` or broadcast to it.

        Returns
        -------
        ndarray
            (...).
        """

    @abstractmethod
    def slope(self, square: Array, count: npt.ArrayLike) -> Array:
        """The weight 2 ρ′(s), 1 for a residual that counts as a Gaussian's; arguments as of `loss`.

        It is finite, at a square of zero too: a residual of no length has no infinite weight.

        Parameters
        ----------
        square : ndarray
        count : array_like of int

        Returns
        -------
        ndarray
            (...).
        """

    def weight(self, square: Array, count: npt.ArrayLike) -> Array:
        """The weights w(s) = 2 ρ′(s) at squares of `count` components; 1 where there are none.

        They are at least 10⁻¹⁵⁰, so that R / w exists.
        """
        found = np.maximum(self.slope(square, count), LEAST)
        return np.where(np.asarray(count) > 0, found, 1.0)

    def is_proper(self, size: int) -> bool:
        """Whether the density of this many components has a finite integral: yes, unless told.

        Parameters
        ----------
        size : int

        Returns
        -------
        bool
        """
        return True

    def log_scale(self, count: npt.ArrayLike) -> Array:
        """The value ln c of the density c e^{−ρ}; for an improper one, the Gaussian's."""
        sizes = np.asarray(count)
        if sizes.size == 1:
            return np.full(sizes.shape, _log_scale(self, int(sizes.item())))
        found = np.zeros(sizes.shape)
        for size in np.unique(sizes).tolist():
            found[sizes == size] = _log_scale(self, size)
        return found

    def _log_scale(self, size: int) -> float:
        """The value ln c of a proper density c e^{−ρ(s)} of a residual r with `size` components.

        R is I, so that s = rᵀr and c = 1 / ∫ e^{−ρ(rᵀr)} dr, an integral over the radius.
        """
        return -Radius.of(self, size).log_integral

    def surplus(self, square: Array, count: npt.ArrayLike, weight: Array) -> Array:
        """The log-density of the tangent N(0, R/w) with its offset, less ln N(0, R/w)."""
        sizes = np.asarray(count)
        offset = self.loss(square, sizes) - 0.5 * weight * square
        found = self.log_scale(sizes) - offset - 0.5 * sizes * (np.log(weight) - LOG_2PI)
        return np.where(sizes > 0, found, 0.0)

    def scales(self, size: int) -> tuple[Array, Array] | None:
        """The noise as a mixture of Gaussians of covariances v R, by which hypotheses are weighed.

        Parameters
        ----------
        size : int
            How many components a residual has; the same mixture holds for any of them alone.

        Returns
        -------
        tuple of ndarray, or None
            (K,): weights of sum one, and (K,): factors v. None where the density is no such
            mixture, as of a loss that has a kink: unless the subclass knows better.
        """
        return None

    def _checked_scales(self, size: int) -> tuple[Array, Array] | None:
        """The mixture of `scales`; a ModelError if its density is not that of the loss.

        They are compared at squares from 10⁻³ to 10⁴, to a relative error of 10⁻³.
        """
        found = self.scales(size)
        if found is None:
            return None
        what = f"{self!r}: scales({size})"
        try:
            weights, factors = (np.array(part, dtype=np.float64) for part in found)
        except (TypeError, ValueError):
            raise ModelError(
                f"{what} returns weights and factors, an array each, or None; found {found!r}"
            ) from None
        fine = weights.ndim == 1 and weights.size > 0 and weights.shape == factors.shape
        if not fine or not (np.isfinite(factors) & (factors > 0.0) & (weights > 0.0)).all():
            raise ModelError(
                f"{what} returns as many positive factors as positive weights; found {weights!r} "
                f"and {factors!r}"
            )
        squares = np.concatenate([[0.0], np.logspace(-3.0, 4.0, 15)])
        logs = np.log(weights) - 0.5 * size * (np.log(factors) + LOG_2PI)
        mixed = np.logaddexp.reduce(logs - 0.5 * squares[:, None] / factors, axis=1)
        due = self.log_scale(np.array(size)) - self.loss(squares, np.full(squares.shape, size))
        wrong = np.abs(mixed - due)
        if not (wrong < 1e-3).all():
            k = int(np.nanargmax(np.where(np.isnan(wrong), np.inf, wrong)))
            raise ModelError(
                f"{what}: at a square of {squares[k]:.3g} the mixture has the log-density "
                f"{mixed[k]:.6g}, where that of the loss is {due[k]:.6g}"
            )
        return weights, factors

    def require_sound(self, size: int) -> None:
        """Refuse, by a ModelError, a loss and a slope that do not fit each other.

        They are tried at squares from 10⁻³ to 10⁴: numbers of the squares' shape, the loss zero at
        zero, the slope its derivative times two, not negative, and falling. A kink may lie at one.
        """
        squares = np.concatenate([[0.0], 1.37 * np.logspace(-3.0, 4.0, 15)])
        squares.flags.writeable = False
        count = np.full(squares.shape, size)
        count.flags.writeable = False

        def told(name: str, at: Array) -> Array:
            """The values of the loss, or of the slope, at squares."""
            try:
                with np.errstate(all="ignore"):
                    found = np.asarray(getattr(self, name)(at, count), dtype=np.float64)
            except Exception as error:
                raise ModelError(
                    f"{self!r}: {name}(square, count) failed: {type(error).__name__}: {error}; it "
                    "takes arrays of squares, which are read-only, and returns as many numbers"
                ) from error
            if found.shape != at.shape:
                raise ModelError(
                    f"{self!r}: {name}(square, count) returns shape {found.shape} for squares of "
                    f"shape {at.shape}; a number each was due"
                )
            if not np.isfinite(found).all():
                k = int(np.isfinite(found).argmin())
                raise ModelError(
                    f"{self!r}: the {name} of a square of {at[k]:.3g} is {found[k]}, which is not "
                    "finite; bound it there"
                )
            return found

        lacking = [name for name in _STAGES if getattr(type(self), name) is _STAGES[name]]
        if self.graduated and lacking:
            raise ModelError(
                f"{self!r} is graduated, approached by stages: define {', '.join(lacking)}"
            )

        loss, slope = told("loss", squares), told("slope", squares)
        if abs(loss[0]) > 1e-9:
            raise ModelError(f"{self!r}: the loss of a square of 0 is {loss[0]:g}; 0 was due")
        if (slope < 0.0).any() or (np.diff(slope) > 1e-9 * np.abs(slope[1:])).any():
            raise ModelError(
                f"{self!r}: the slope, 2 ρ′(s), is negative or grows with s; a loss concave in the "
                "square was due, of which larger residuals weigh less"
            )
        step = 1e-4 * squares[1:]
        ahead, back = (told("loss", np.append(0.0, squares[1:] + s * step))[1:] for s in (1, -1))
        due = (ahead - back) / step
        wrong = np.abs(due - slope[1:]) > 1e-3 * np.maximum(np.abs(due), slope[1:]) + 1e-6
        if wrong.sum() > 1:
            k = int(wrong.argmax())
            raise ModelError(
                f"{self!r}: at a square of {squares[1 + k]:.3g} the slope is {slope[1 + k]:.6g}; "
                f"twice the derivative of the loss is {due[k]:.6g}"
            )

    def require_proper(self, size: int, cpd: object) -> None:
        """Refuse a density without an integral."""
        if not self.is_proper(size):
            raise ModelError(
                f"{cpd!r}: {self!r} of {size} components is improper, its integral is infinite: "
                f"there is no density to evaluate or draw from; {self._instead()}"
            )

    def _instead(self) -> str:
        return "take pgm.StudentT(dof), or a pgm.MixtureCPD with a wide Gaussian"

    def draw(self, white: Array, rng: np.random.Generator) -> Array:
        """Draws with covariance parameter I, (..., d), made from standard normal ones.

        Each is moved along its direction, to the radius that as much of the density lies within.

        Parameters
        ----------
        white : ndarray
            (..., d).
        rng : numpy.random.Generator
            For noise that needs further draws; not used here.

        Returns
        -------
        ndarray
            (..., d).
        """
        size = white.shape[-1]
        radius = np.linalg.norm(white, axis=-1, keepdims=True)
        found: Array = white * (Radius.of(self, size).moved(radius) / np.maximum(radius, 1e-300))
        return found

    def first_stage(self, largest: Array) -> Array:
        """The stage to begin with, whose loss is convex or nearly so; of a graduated loss.

        Parameters
        ----------
        largest : ndarray
            (runs,): the largest square of each run at its first linearisation.

        Returns
        -------
        ndarray
            (runs,): a number for each run, as you count stages; infinite if none is needed.
        """
        raise NotImplementedError(f"{self!r} is graduated: it needs first_stage(largest)")

    def next_stage(self, stage: Array) -> Array:
        """The stage of the next linearisation; infinite where the loss is the one asked for.

        Parameters
        ----------
        stage : ndarray
            (runs,).

        Returns
        -------
        ndarray
            (runs,).
        """
        raise NotImplementedError(f"{self!r} is graduated: it needs next_stage(stage)")

    def staged(self, square: Array, stage: Array) -> Array:
        """The weights of squares at a stage, as `slope` has them of the loss asked for.

        Parameters
        ----------
        square, stage : ndarray
            They broadcast; a stage may be infinite, and is never NaN here.

        Returns
        -------
        ndarray
        """
        raise NotImplementedError(f"{self!r} is graduated: it needs staged(square, stage)")

    def staged_loss(self, square: Array, stage: Array) -> Array:
        """The loss of squares at a stage.

        Parameters
        ----------
        square, stage : ndarray
            They broadcast. A stage may be infinite, and NaN before the first one, where the loss
            is a Gaussian's, s / 2.

        Returns
        -------
        ndarray
        """
        raise NotImplementedError(f"{self!r} is graduated: it needs staged_loss(square, stage)")


@kept
def _log_scale(noise: RobustNoise, size: int) -> float:
    """The value ln c, the normalising constant for this many components."""
    if not size:
        return 0.0
    return noise._log_scale(size) if noise.is_proper(size) else -0.5 * size * LOG_2PI


# What a graduated noise has to say for itself, as a noise that says nothing has it.
_STAGES = {
    name: getattr(RobustNoise, name)
    for name in ("first_stage", "next_stage", "staged", "staged_loss")
}
