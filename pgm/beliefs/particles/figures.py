"""The status of particles: how many are effective, and where measurements were impossible."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.errors import ParticleWarning, levels_to_user
from pgm.kernels.arrays import Array, Integers, Mask
from pgm.posteriors.figures import Figures

# The effective number of particles below which the user is warned, and by how much rounding may
# leave that of equal particles below their number.
FEW = 10.0
_ROUNDING = 1e-9


class ParticleFigures(Figures):
    """The status of a particle filter's or smoother's answer.

    Attributes
    ----------
    effective : ndarray
        (*runs, T+1): the effective number of particles given each step's measurements, 1 / Σ w²:
        as many particles of equal weight would serve as well. Below ten a `ParticleWarning` was
        given: means of so few particles are hardly better than a guess.
    number : ndarray of int
        (*runs, T+1): the number of particles.
    resampled : ndarray of bool
        (*runs, T+1): whether the particles were drawn anew on the way to the step.
    injected : ndarray of int
        (*runs, T+1): how many particles an `Injection` put elsewhere, given the step's
        measurements.
    ignored, restarted : ndarray of bool
        (*runs, T+1): whether no particle explained the step's measurements, so that these were
        ignored, or the run was restarted from the prior; the log-evidence is −∞ then.
    unmoved : ndarray or None
        (*runs, T): of a smoother, by step the share of trajectories whose particle is still the
        ancestor that the filter gave it, unmoved by backward simulation; None of a filter.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> status = pgm.filter(walk, {z: [[4.0]]}, belief=pgm.Particles(10_000, seed=0)).status
    >>> status.number
    array([10000, 10000])
    >>> bool((status.effective > 1000).all())
    True
    """

    effective: Array
    number: Integers
    resampled: Mask
    injected: Integers
    ignored: Mask
    restarted: Mask
    unmoved: Array | None

    def __init__(
        self,
        effective: Array,
        number: Integers,
        resampled: Mask,
        injected: Integers,
        ignored: Mask,
        restarted: Mask,
        unmoved: Array | None = None,
    ) -> None:
        found: dict[str, npt.NDArray[Any] | None] = {
            "effective": effective,
            "number": number,
            "resampled": resampled,
            "injected": injected,
            "ignored": ignored,
            "restarted": restarted,
            "unmoved": unmoved,
        }
        for array in found.values():
            if array is not None:
                array.flags.writeable = False
        self._set(**found)

    def at(self, step: int) -> ParticleFigures:
        """The status of one step alone, in arrays (*runs, 1), without `unmoved`."""
        names = "effective", "number", "resampled", "injected", "ignored", "restarted"
        return ParticleFigures(*(getattr(self, name)[..., step : step + 1] for name in names))

    @property
    def few(self) -> bool:
        """Whether, at some step of a run, the effective number is below ten and below `number`."""
        return bool(self._few.any())

    @property
    def _few(self) -> Mask:
        """The mask (*runs, steps) of effective numbers below ten and below the number of particles.

        Equally weighted particles are not marked, even if they are fewer than ten.
        """
        found: Mask = self.effective < np.minimum(FEW, self.number) * (1.0 - _ROUNDING)
        return found

    @property
    def impossible(self) -> bool:
        """Whether, at some step of a run, no particle explained the measurements."""
        return bool(self.ignored.any() or self.restarted.any())

    def warn(self) -> None:
        """Warn of few effective particles, and of impossible measurements, by `ParticleWarning`s.

        Their texts are the same of all calls, so that Python shows them once a place and not once a
        call or step; how many and where stands in the status.
        """
        if self.few:
            message = (
                f"the weights of the particles are worth fewer than {FEW:g} of them at some step "
                "(print(posterior.status) says where): give more particles, or the sensor more "
                "noise"
            )
            warnings.warn(message, ParticleWarning, stacklevel=levels_to_user())
        if self.impossible:
            message = (
                "no particle explains the measurements of some step (status.ignored, "
                "status.restarted): beliefs go on as they were asked to, and the log-evidence is "
                "minus infinity"
            )
            warnings.warn(message, ParticleWarning, stacklevel=levels_to_user())

    @property
    def phrases(self) -> list[str]:
        """The effective numbers, how often particles were drawn anew, and what went wrong."""
        steps = self.effective.shape[-1]
        parts = [
            f"effective {self.effective.min():.3g} to {self.effective.max():.3g} of "
            f"{self.number.max():,}",
            f"drawn anew at {int(self.resampled.sum())} of {self.resampled.size} steps",
        ]
        if self.few and steps > 1:
            share = np.where(self._few, self.effective, np.inf)
            least = np.unravel_index(int(share.argmin()), share.shape)
            few = self._few.any(axis=-1)
            parts.append(
                f"worth {share[least]:.2g} at step {int(least[-1])}, below {FEW:g} in "
                f"{int(few.sum())} of {few.size} runs"
            )
        if self.injected.any():
            parts.append(f"{int(self.injected.sum()):,} put elsewhere")
        for name in ("ignored", "restarted"):
            count = int(getattr(self, name).sum())
            if count:
                parts.append(f"impossible measurements {name} at {count} steps")
        if self.unmoved is not None and steps > 1:
            parts.append(f"up to {float(self.unmoved.max()):.2g} of the trajectories unmoved")
        return parts
