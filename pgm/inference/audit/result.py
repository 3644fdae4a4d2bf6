"""The result of an audit."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from pgm.display import Listing, Shown, Summary, number
from pgm.errors import NumericalError
from pgm.immutable import Immutable
from pgm.inference.audit.innovations import InnovationCheck
from pgm.inference.audit.tail import pareto_shape
from pgm.inference.summaries import spread
from pgm.kernels.arrays import Array
from pgm.variables import Variable

# Above this shape of the weights' tail no estimate made of them is to be trusted.
UNTRUSTED = 0.7


class Audit(Shown, Immutable):
    """The distance of a Gaussian answer from the exact one, by importance sampling; (...) are runs.

    For draws x_s from the Gaussian answer q and weights w_s = p(x_s, z) / q(x_s).

    Attributes
    ----------
    log_evidence : ndarray
        (...): ln of the mean weight, the corrected ln p(z). The mean weight is unbiased; its
        logarithm is low by about half the square of the standard error.
    standard_error : ndarray
        (...): of `log_evidence`, √((S/n − 1)/(S − 1)) for an effective sample size n (the delta
        method).
    effective_sample_size : ndarray
        (...): n = (Σ w)² / Σ w², from 1 to S.
    gaussian_log_evidence : ndarray
        (...): that of the posterior.
    divergence : ndarray
        (...): KL(q ‖ p(x | z)) in nats, estimated as ln of the mean weight less the mean of ln w:
        never negative, zero where all weights are equal, as in linear models. It is low by as much
        as `log_evidence`, and where draws miss what matters by more: it cannot see more than
        they do.
    pareto_k : ndarray
        (...): the shape of the weights' tail. Below 0.5 their variance is finite; above about 0.7
        neither the standard error nor the effective sample size is to be trusted. −∞ where all
        weights are equal, NaN for fewer than 25 draws.
    log_weights : ndarray
        (..., S): ln w.
    innovations : mapping of Variable to InnovationCheck
        Of each sensor that a chain has read, whether its innovations fit the model; empty for
        networks without time. All the numbers above are about the model as declared, and right
        for a wrong one: these see the model itself.

    References
    ----------
    Owen, Monte Carlo theory, methods and examples, 2013, chapter 9; Vehtari, Simpson, Gelman, Yao &
    Gabry, Pareto smoothed importance sampling, 2024.
    """

    log_evidence: Array
    standard_error: Array
    effective_sample_size: Array
    gaussian_log_evidence: Array
    divergence: Array
    pareto_k: Array
    log_weights: Array
    innovations: Mapping[Variable, InnovationCheck]

    def __init__(
        self,
        log_weights: Array,
        gaussian_log_evidence: Array,
        innovations: Mapping[Variable, InnovationCheck] = MappingProxyType({}),
    ) -> None:
        lead, samples = log_weights.shape[:-1], log_weights.shape[-1]
        largest = log_weights.max(axis=-1)
        if not np.isfinite(largest).all():
            run = int(np.flatnonzero(~np.isfinite(largest))[0])
            raise NumericalError(
                f"run {run}: no draw from the Gaussian answer has a density under the model that "
                "float64 can hold; are its units and noises of a size that fits the data?"
            )
        weights = np.exp(log_weights - largest[..., None])
        # Equal weights give exactly the number of draws.
        size = np.minimum(weights.sum(axis=-1) ** 2 / (weights**2).sum(axis=-1), samples)
        log_evidence = largest + np.log(weights.mean(axis=-1))
        found = {
            "log_evidence": log_evidence,
            "standard_error": np.sqrt((samples / size - 1.0) / (samples - 1)),
            "effective_sample_size": size,
            "gaussian_log_evidence": np.array(gaussian_log_evidence, dtype=float),
            "divergence": np.maximum(log_evidence - log_weights.mean(axis=-1), 0.0),
            "pareto_k": pareto_shape(log_weights.reshape(-1, samples)).reshape(lead),
            "log_weights": log_weights,
        }
        found = {name: np.asarray(value) for name, value in found.items()}
        for value in found.values():
            value.flags.writeable = False
        self._set(**found, innovations=MappingProxyType(dict(innovations)))

    @property
    def samples(self) -> int:
        """S, the number of draws of each run."""
        return int(self.log_weights.shape[-1])

    @property
    def correction(self) -> Array:
        """(...): `log_evidence` less `gaussian_log_evidence`."""
        return self.log_evidence - self.gaussian_log_evidence

    @property
    def _title(self) -> str:
        lead = self.log_evidence.shape
        worst = " in the worst run" if lead else ""
        least = float(self.effective_sample_size.min(initial=np.inf))
        runs = f", runs {lead}" if lead else ""
        return f"Audit({self.samples} samples{runs}, effective {least:.4g}{worst})"

    def _summary(self) -> Summary:
        if not self.log_evidence.size:
            return Summary(self._title)
        k = float(self.pareto_k.max())
        trust = "" if k <= UNTRUSTED else ": these estimates are not to be trusted"
        of = ", most of all runs" if self.log_evidence.ndim else ""
        rows = [
            ("log-evidence", spread(self.log_evidence)),
            ("its standard error", spread(self.standard_error, 3)),
            ("that of the posterior", spread(self.gaussian_log_evidence)),
            (f"divergence [nats]{of}", number(self.divergence.max(), 3)),
        ]
        seen = [f"  {check}" for check in self.innovations.values()]
        return Summary(
            self._title,
            [
                "The Gaussian answer against the exact posterior of the same model:",
                Listing(("", ""), rows),
                f"Pareto shape {k:.2g} (to be below {UNTRUSTED}){trust}",
                "The model against its data:" + " not seen by this audit" * (not seen),
                *seen,
            ],
        )
