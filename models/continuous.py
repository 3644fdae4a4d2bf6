"""Linear systems in continuous time, discretised exactly over steps of any durations.

A state x of n components moves by

    dx = (A x + B u) dt + dβ,

β being a Brownian motion with the spectral density D (its covariance grows by D a second) and u an
input that is held over each step. Over a step of duration Δt this is

    x' = F x + G u + w,  w ~ N(0, Q),
    F = e^{A Δt},  G = ∫ e^{A s} B ds,  Q = ∫ e^{A s} D e^{Aᵀ s} ds,

the integrals from 0 to Δt. Durations may differ from step to step: of durations (T,) the results
are stacks (T, ...), which a `pgm.LinearGaussianCPD` takes as they are, entry k being of step k + 1.

Sources: Van Loan, Computing integrals involving the matrix exponential, IEEE Transactions on
Automatic Control 23 (1978) 395-404; Särkkä and Solin, Applied Stochastic Differential Equations
(2019), section 6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

Array = npt.NDArray[np.float64]

# Steps are halved until ‖A‖ Δt is no larger than this, where exponentials lose no digits.
_SHORT = 0.5


class Discretised(NamedTuple):
    """A linear system over steps, x' = F x + G u + w, w ~ N(0, Q).

    Attributes
    ----------
    matrix : array, shape (..., n, n)
        F; the leading axes are those of the durations.
    cov : array, shape (..., n, n)
        Q, symmetric; singular where noise does not reach a component.
    control : array, shape (..., n, m)
        G, for an input of m components that is held over each step.
    """

    matrix: Array
    cov: Array
    control: Array


def durations(dt: npt.ArrayLike) -> Array:
    """Durations of steps [s] as an array, checked.

    Raises
    ------
    ValueError
        Where one of them is negative, NaN or infinite.
    """
    found = np.asarray(dt, dtype=float)
    bad = ~(np.isfinite(found) & (found >= 0.0))
    if bad.any():
        where = "" if not found.ndim else f", at {tuple(int(k) for k in np.argwhere(bad)[0])}"
        raise ValueError(
            f"dt is {found[bad].flat[0]}{where}; give the duration of a step, in seconds, finite "
            "and 0 or more: time stamps in order have such differences"
        )
    return found


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """A linear system in continuous time, dx = (A x + B u) dt + dβ.

    Parameters
    ----------
    drift : array_like, shape (n, n)
        A [1/s].
    diffusion : array_like, shape (n, n)
        D, the spectral density of the noise: with noise of density q that enters by L, L q Lᵀ.
    control : array_like, shape (n, m), optional
        B, of inputs that are held over each step; none, if not given.

    Raises
    ------
    ValueError
        Where a shape does not fit, a number is not finite, or ``diffusion`` is not symmetric or has
        a negative eigenvalue.

    Examples
    --------
    A mass on a spring with friction, kicked by white noise:

    >>> spring = LinearSystem(drift=[[0.0, 1.0], [-4.0, -0.5]], diffusion=[[0.0, 0.0], [0.0, 0.2]])
    >>> step = spring.over([0.1, 0.1, 2.5])
    >>> step.matrix.shape, step.cov.shape
    ((3, 2, 2), (3, 2, 2))
    """

    drift: npt.ArrayLike
    diffusion: npt.ArrayLike
    control: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        drift, diffusion = (np.array(a, dtype=float) for a in (self.drift, self.diffusion))
        size = len(drift) if drift.ndim == 2 else 0
        control = np.zeros((size, 0)) if self.control is None else np.array(self.control, float)
        if not size or drift.shape != (size, size):
            raise ValueError(f"LinearSystem: drift has shape {drift.shape}; (n, n) was due")
        if diffusion.shape != (size, size):
            raise ValueError(
                f"LinearSystem: diffusion has shape {diffusion.shape}; ({size}, {size}) was due"
            )
        if control.ndim != 2 or len(control) != size:
            raise ValueError(
                f"LinearSystem: control has shape {control.shape}; ({size}, m) was due"
            )
        for name, array in (("drift", drift), ("diffusion", diffusion), ("control", control)):
            if not np.isfinite(array).all():
                raise ValueError(f"LinearSystem: {name} has entries that are NaN or infinite")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        _require_density(diffusion)

    def over(self, dt: npt.ArrayLike) -> Discretised:
        """The system over steps of some durations.

        Parameters
        ----------
        dt : float or array_like, shape (...)
            Durations of the steps [s], 0 or more; any may repeat, and is then worked out once.

        Returns
        -------
        Discretised
            Stacks (..., n, n), (..., n, n) and (..., n, m).

        Raises
        ------
        ValueError
            Where a duration is negative or not finite, or an unstable system grows beyond float64
            within it.

        Notes
        -----
        Van Loan's exponential of a matrix with −A and Aᵀ on its diagonal overflows where a stable
        system settles fast within a step (‖A‖ Δt large), and so it is taken of a step so short that
        ‖A‖ Δt ≤ 1/2, which is then doubled: Q ← F Q Fᵀ + Q, and F − I ← 2 (F − I) + (F − I)²,
        which keeps the digits of slow motions beside fast ones.
        """
        every = durations(dt)
        steps, place = np.unique(every, return_inverse=True)
        made = (part[place.reshape(every.shape)] for part in self._over(steps))
        return Discretised(*made)

    def _over(self, steps: Array) -> tuple[Array, Array, Array]:
        drift, diffusion, control = map(np.asarray, (self.drift, self.diffusion, self.control))
        size, level = len(drift), float(np.abs(diffusion).max(initial=0.0)) or 1.0
        length = np.linalg.norm(drift, 1) * steps
        with np.errstate(divide="ignore"):
            halvings = np.maximum(np.ceil(np.log2(length / _SHORT)), 0.0).astype(int)
        short = np.ldexp(steps, -halvings)[:, None, None]
        zero, eye = np.zeros((steps.size, size, size)), np.eye(size) + 0.0 * short
        a = drift * short
        # Of short steps: the mean of e^{A s}, and that of e^{A s} D e^{Aᵀ s} by Van Loan's blocks.
        mean = expm(_blocks(a, eye, zero))[:, :size, size:]
        loan = expm(_blocks(-a, diffusion / level + 0.0 * short, a.swapaxes(1, 2)))
        grown = a @ mean  # F − I
        cov = (eye + grown) @ loan[:, :size, size:] * (level * short)
        held = mean * short
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(int(halvings.max(initial=0))):
                on = (halvings > k)[:, None, None]
                twice = cov + grown @ cov
                twice = cov + twice + twice @ grown.swapaxes(1, 2)
                cov = np.where(on, twice, cov)
                held = np.where(on, 2.0 * held + grown @ held, held)
                grown = np.where(on, 2.0 * grown + grown @ grown, grown)
        found = eye + grown, 0.5 * (cov + cov.swapaxes(1, 2)), held @ control
        for part in found:
            bad = ~np.isfinite(part).all(axis=(1, 2))
            if bad.any():
                raise ValueError(
                    f"LinearSystem: over {steps[bad][0]:.6g} s the system, whose drift has the "
                    f"eigenvalue {np.linalg.eigvals(drift).real.max():.6g} 1/s, grows beyond "
                    "float64; give shorter steps"
                )
        return found


def ornstein_uhlenbeck(dt: npt.ArrayLike, time_constant: float, std: float) -> Discretised:
    """An Ornstein–Uhlenbeck process over steps: a value that forgets, as a bias or a wind does.

        dx = (μ − x) dt / τ + dβ:  F = e^{−Δt/τ},  G = 1 − F for μ,  Q = σ² (1 − e^{−2Δt/τ})

    Parameters
    ----------
    dt : float or array_like, shape (...)
        Durations of the steps [s], 0 or more.
    time_constant : float
        τ [s], positive; infinite for a value that stays.
    std : float
        σ, the standard deviation about the level μ in the long run, 0 or more.

    Returns
    -------
    Discretised
        Stacks (..., 1, 1), of a single component.

    Raises
    ------
    ValueError
        Where a duration is negative or not finite, or τ or σ is not as said.

    Notes
    -----
    Uhlenbeck and Ornstein, On the theory of the Brownian motion, Physical Review 36 (1930). Also
    called a first-order Gauss–Markov process.

    Examples
    --------
    >>> step = ornstein_uhlenbeck([0.0, 10.0], time_constant=10.0, std=2.0)
    >>> step.matrix.ravel().round(4).tolist(), step.cov.ravel().round(4).tolist()
    ([1.0, 0.3679], [0.0, 3.4587])
    """
    if not time_constant > 0.0:
        raise ValueError(
            f"ornstein_uhlenbeck: time_constant is {time_constant}; give seconds, more than 0"
        )
    if not (np.isfinite(std) and std >= 0.0):
        raise ValueError(f"ornstein_uhlenbeck: std is {std}; give a finite number, 0 or more")
    share = (durations(dt) / time_constant)[..., None, None]
    return Discretised(np.exp(-share), -(std**2) * np.expm1(-2.0 * share), -np.expm1(-share))


def _blocks(first: Array, beside: Array, second: Array) -> Array:
    """Matrices [[first, beside], [0, second]], stacked."""
    size = first.shape[-1]
    found = np.zeros((*first.shape[:-2], 2 * size, 2 * size))
    found[..., :size, :size], found[..., :size, size:] = first, beside
    found[..., size:, size:] = second
    return found


def _require_density(diffusion: Array) -> None:
    """Refuse what is no spectral density of noise, in units in which variances are one."""
    scale = np.sqrt(np.abs(np.diagonal(diffusion)))
    unit = np.where(scale > 0.0, scale, 1.0)
    alike = diffusion / unit[:, None] / unit
    if np.abs(alike - alike.T).max() > 1e-9:
        raise ValueError("LinearSystem: diffusion is not symmetric; a spectral density is L q Lᵀ")
    least = float(np.linalg.eigvalsh(0.5 * (alike + alike.T)).min())
    if least < -1e-9:
        raise ValueError(
            f"LinearSystem: diffusion has a negative eigenvalue, {least:.3g} in units in which its "
            "variances are 1; a spectral density is L q Lᵀ"
        )
