"""The density of sightings of which nobody said what was seen."""

from __future__ import annotations

import numpy as np

from pgm.cpds.base import CPD
from pgm.cpds.conditional import ConditionalGaussian
from pgm.cpds.noise import Noise
from pgm.cpds.values import Known, Values
from pgm.errors import ModelError
from pgm.factors.runs import unflat
from pgm.kernels import normal, roots
from pgm.kernels.arrays import Array
from pgm.kernels.semirings import log_sum
from pgm.variables import Variable


class UnidentifiedCPD(CPD):
    """A sensor's CPD without one of its parents, which is one of some candidates, or none.

    `candidates` are (k, d), `log_shares` (k,) their log-probabilities; `log_outliers` (2,) the
    log-densities of spurious and of new sightings, with their probabilities. Without `summed` the
    likeliest term alone counts.
    """

    sensor: CPD
    parent: Variable
    candidates: Array
    log_shares: Array
    log_outliers: Array
    gate: float | None
    summed: bool

    def __init__(
        self,
        sensor: CPD,
        parent: Variable,
        candidates: Array,
        log_shares: Array,
        log_outliers: Array,
        gate: float | None,
        summed: bool,
    ) -> None:
        self._set_scope(sensor.child, [v for v in sensor.parents if v != parent])
        if gate is not None and not isinstance(sensor, ConditionalGaussian):
            raise ModelError(
                f"{sensor!r} is no Gaussian CPD, whose residuals have no χ² distribution: leave "
                "gate= of pgm.unknown(...) out",
                variable=sensor.child,
                cpd=sensor,
            )
        gaussian = sensor if isinstance(sensor, ConditionalGaussian) else None
        constant = gaussian is not None and not isinstance(gaussian.cov, Noise)
        if gaussian is not None and constant and roots.determined(gaussian._lower).any():
            raise ModelError(
                f"{sensor!r} has no noise in a component, or two that are one: no particle and no "
                "cell need agree with its measurement; give it some",
                variable=sensor.child,
                cpd=sensor,
            )
        self._set(
            sensor=sensor,
            parent=parent,
            candidates=candidates,
            log_shares=log_shares,
            log_outliers=log_outliers,
            gate=gate,
            summed=summed,
            partial=sensor.partial,
        )

    def _log_density(self, child: Values, known: Known) -> Array:
        terms = self.terms(child, known)
        found = np.logaddexp.reduce(terms, axis=0) if self.summed else terms.max(axis=0)
        return np.where(np.isnan(child).all(axis=-1), 0.0, found)

    def responsibilities(self, child: Values, known: Known) -> Array:
        """The probability of each candidate, of a spurious sighting and of a new one, (k + 2, ...).

        NaN where the sighting is impossible.
        """
        terms = self.terms(child, known)
        with np.errstate(invalid="ignore"):
            return np.asarray(np.exp(terms - log_sum(terms, 0)))

    def terms(self, child: Values, known: Known) -> Array:
        """The logarithms of the density's terms: candidates, spurious, new, (k + 2, ...).

        Those beyond the gate are −∞.
        """
        lead = np.broadcast_shapes(child.shape[:-1], known.lead)
        found = np.empty((len(self.candidates) + 2, *lead))
        for k, candidate in enumerate(self.candidates):
            own = np.broadcast_to(candidate, (*known.shape, candidate.size))
            each = Known({**known.values, self.parent: own}, known.lead, known.shape, known.step)
            density = self.sensor._log_density(child, each)
            if self.gate is not None:
                density = self._gated(density, child, each, self.gate)
            found[k] = density + self.log_shares[k]
        found[-2:] = self.log_outliers.reshape(-1, *[1] * len(lead))
        return found

    def _gated(self, density: Array, child: Values, known: Known, gate: float) -> Array:
        assert isinstance(self.sensor, ConditionalGaussian)
        mean, _ = self.sensor._law(known)
        seen = ~np.isnan(child)
        middle = np.where(seen, unflat(mean, known.lead, 1), np.nan)
        square = 2.0 * (self.sensor._log_density(middle, known) - density)
        limit = normal.square_within(gate, np.maximum(seen.sum(axis=-1), 1))
        return np.where(square > limit, -np.inf, density)

    def __repr__(self) -> str:
        return f"{self.sensor!r}, {self.parent!r} being one of {len(self.candidates):,}"
