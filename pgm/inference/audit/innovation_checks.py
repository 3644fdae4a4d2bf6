"""The check of a model against its innovations, one sensor at a time.

Innovations are measurements less their predictions. If the model is right, those of a sensor are as
large as their predicted covariances say, and those at different times are uncorrelated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pgm.display import Shown
from pgm.kernels.arrays import Array, frozen
from pgm.posteriors.innovations import Innovations, autocorrelation, whitened
from pgm.variables import Variable

# Standard deviations of a normal within which it is with a probability of 99 %.
BAND = 2.576


@dataclass(frozen=True, eq=False, repr=False)
class InnovationCheck(Shown):
    """Whether one sensor's innovations are as white and as large as a correct model's.

    nis: (*runs): the normalised innovation squared (NIS) per component, the mean over all
        components that were read in a run. 1 is right; it is larger if measurements are further off
        than the model says: outliers, too small a noise, a wrong motion. NaN where nothing was
        read.
    overall: The NIS per component over all runs together.
    autocorrelation: The correlation of whitened innovations one measurement apart; 0 is right. NaN
        if no run has two measurements.
    band, autocorrelation_band: If the model is right, `overall` is within `band` of 1 with a
        probability of 99 %, and `autocorrelation` within `autocorrelation_band` of 0.
    """

    sensor: Variable
    nis: Array
    overall: float
    band: float
    autocorrelation: float
    autocorrelation_band: float

    @classmethod
    def of(cls, sensor: Variable, found: Innovations) -> InnovationCheck:
        """The check of a sensor, from its innovations `found`."""
        squares, dof = np.nansum(found.nis, axis=-1), found.dof.sum(axis=-1)
        read = dof.sum()
        white = whitened(found)
        correlation, deviation = autocorrelation(white[:-1], white[1:])
        return cls(
            sensor,
            frozen(np.where(dof > 0, squares / np.maximum(dof, 1), np.nan)),
            float(squares.sum() / read) if read else np.nan,
            BAND * float(np.sqrt(2.0 / read)) if read else np.nan,
            correlation,
            BAND * deviation,
        )

    @property
    def fits(self) -> bool:
        """Whether `overall` and `autocorrelation` are within their bands; NaN counts as within."""
        apart = abs(self.overall - 1.0) > self.band
        return not apart and not abs(self.autocorrelation) > self.autocorrelation_band

    @property
    def _title(self) -> str:
        return f"InnovationCheck({self})"

    def __str__(self) -> str:
        verdict = "" if self.fits else ", which speaks against the model or its linearisation"
        return (
            f"{self.sensor.name} NIS {self.overall:.3g} a component (right: 1 ± {self.band:.2g}), "
            f"autocorrelation {self.autocorrelation:.2g} (right: 0 ± "
            f"{self.autocorrelation_band:.2g}){verdict}"
        )


def checks(innovations: Mapping[Variable, Innovations]) -> dict[Variable, InnovationCheck]:
    """For each sensor that was read, the check of its innovations."""
    return {
        sensor: InnovationCheck.of(sensor, found)
        for sensor, found in innovations.items()
        if found.dof.any()
    }
