"""The result of an audit: a Gaussian answer beside the importance sampling that checks it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from pgm.display import Listing, Shown, Summary, number
from pgm.factors import Gaussian, Table
from pgm.immutable import Immutable
from pgm.inference.audit.compared import Compared
from pgm.inference.audit.corrected import ComparedMoments
from pgm.inference.audit.innovation_checks import InnovationCheck
from pgm.inference.audit.mixture import Mixture
from pgm.inference.audit.modes import Modes
from pgm.kernels.arrays import Array, Integers, Mask, frozen
from pgm.kernels.sampled import Spread
from pgm.posteriors.summaries import spread
from pgm.variables import Variable

# Above this Pareto shape of the weights' tail no estimate made of them is to be trusted.
UNTRUSTED = 0.7
# An answer is suspect if its moments are SUSPECT nats from the exact ones, or its log-evidence is
# SUSPECT nats off beyond ERRORS standard errors; an estimate to be trusted has ENOUGH effective
# draws.
SUSPECT, ERRORS, ENOUGH = 0.5, 3.0, 10.0


# The part of the mass that modes not drawn from may have where an audit is to be trusted.
MISSED = 0.01


def _is_trusted(mixture: Mixture, modes: Modes) -> Mask:
    """Whether each run's estimates can be used, (runs,).

    They can if the Pareto shape of the weights' tail is at most 0.7, ten draws or more are
    effective, and no more than a hundredth of the mass is in modes that are not drawn from.

    mixture: The estimates from the weighted draws.
    modes: The modes beside the answer's.
    """
    draws = (mixture.pareto_k <= UNTRUSTED) & (mixture.effective_draws >= ENOUGH)
    return np.asarray(draws & (modes.missed <= MISSED))


def _is_suspect(
    mixture: Mixture,
    compared: Sequence[Compared],
    correction: Array,
    trusted: Mask,
) -> Mask:
    """Whether the Gaussian answer's moments or log-evidence are off in each run, (runs,).

    They are if a belief's moments are more than 0.5 nats further from the estimated exact ones than
    chance explains, or if the correction is larger than three standard errors by more than 0.5
    nats.

    mixture: The estimates from the weighted draws.
    compared: For each belief the estimated exact moments, and the Gaussian's divergence from them.
    correction: The estimated log-evidence less the Gaussian's, (runs,).
    trusted: The mask of runs whose estimates can be used, (runs,). A negative correction counts in
        these alone: a mean of weights is t nats too high with a probability of e^−t at most
        (Markov's inequality), but may be too low by any number of nats.
    """
    beyond = np.abs(correction) - ERRORS * mixture.evidence.standard_error
    found: Mask = (trusted | (correction > 0.0)) & (beyond > SUSPECT)
    for each in compared:
        found = found | (each.excess(mixture.effective_draws) > SUSPECT)
    return found


class Audit(Shown, Immutable):
    """The distance of a Gaussian answer from the exact one, by importance sampling; (...) are runs.

    S draws x_s from the Gaussian answer q have the weights w_s = p(x_s, z) / q(x_s), with the
    density p of the model and the measurements z. As many draws come from a defensive density d of
    wider tails, and all 2S draws are weighed by the mixture r = (q + d)/2: p(x_s, z) / r(x_s). Of a
    switching model x_s are paths of its discrete variables, and q is a Markov chain that has the
    answer's probabilities of each two successive steps.

    Attributes
    ----------
    log_evidence : ndarray
        (...): the corrected ln p(z), from all draws: ln of the mean weight p/r, with q/r as its
        control variate, whose mean is one.
    standard_error : ndarray
        (...): of `log_evidence` (the delta method).
    effective_sample_size : ndarray
        (...): (Σ w)² / Σ w² of the Gaussian's own draws, from 1 to S: the worth of q as a proposal.
    effective_draws : ndarray
        (...): the effective number of all draws, by their weights p/r; the estimates are made of
        them.
    gaussian_log_evidence : ndarray
        (...): the log-evidence of the posterior that was audited.
    divergence, divergence_error : ndarray
        (...): KL(q ‖ p(x | z)) of all variables in nats, and its standard error. A Gaussian that
        fits one of two modes and has lost the other is ln 2 away, if both weigh the same, and
        less, if it fits the heavier one.
    inclusive_divergence, inclusive_error : ndarray
        (...): KL(p(x | z) ‖ q) of all variables in nats, and its standard error: large where q has
        lost a mode.
    moment_divergence : mapping of Variable to ndarray
        For each variable alone, KL(N(exact moments) ‖ N(moments of the answer)) in nats, of a
        discrete one KL(exact probabilities ‖ the answer's), (..., steps) of a chain, (...) of a
        network without time; infinite where too few draws leave no covariance.
    corrected : mapping of Variable to Gaussian or Table
        The exact posterior's mean and covariance of each hidden variable, estimated; of a discrete
        one the probabilities of its states.
    suspect : ndarray of bool
        (...): whether some belief, of a variable or of a cluster's variables together, is further
        than 0.5 nats from the exact moments, beyond the error that so few effective draws may leave
        by chance, or `correction` is larger than three standard errors by more than 0.5 nats. Only
        beliefs given all measurements count, of a filter the last; and a negative correction counts
        only where `trusted`, since few draws give too low an evidence.
    trusted : ndarray of bool
        (...): whether ten draws or more are effective, the tail of their weights allows estimates,
        and no more than a hundredth is `missed`. Where it is False, nothing follows from `suspect`
        being False. It is so where other modes were not looked for, `missed` being NaN. A mode that
        no start has led to is not known of: see `audit`.
    pareto_k : ndarray
        (...): the shape of the tail of the weights p/r at the Gaussian's draws. Below 0.5 their
        variance is finite; above about 0.7 neither the standard error nor the effective sample
        sizes are to be trusted. −∞ where all w are equal, NaN for fewer than 25 draws.
    undefined : ndarray
        (...): the part of defensive draws at which a function was NaN or infinite; these draws
        count as impossible.
    modes : ndarray of int
        (...): the number of modes beside the answer's that smoothers from other starts have found,
        and that a part of the defensive draws comes from.
    missed : ndarray
        (...): the part of the evidence of all modes found, by Laplace's method, that belongs to
        modes not drawn from: beyond the likeliest eight, or beside a sensor without noise. NaN
        where no smoother arrived, or of a Markov network no affine factors say where to start, so
        that others may be there.
    log_weights : ndarray
        (..., S): ln w of the Gaussian's own draws.
    innovations : mapping of Variable to InnovationCheck
        For each sensor that a chain has read, whether its innovations fit the model; empty of
        switching models and of networks without time. All other
        numbers take the model as declared, and do not tell whether it is wrong.

    References
    ----------
    Owen, Monte Carlo theory, methods and examples, 2013, chapter 9; Hesterberg, Weighted average
    importance sampling and defensive mixture distributions, 1995; Owen & Zhou, Safe and effective
    importance sampling, 2000; Vehtari, Simpson, Gelman, Yao & Gabry, Pareto smoothed importance
    sampling, 2024.

    Examples
    --------
    >>> from pgm.examples import square, x, y
    >>> posterior = pgm.infer(pgm.compile(square), {y: [9.0]})
    >>> found = pgm.audit(posterior, rng=0)
    >>> bool(found.trusted), bool(found.suspect)
    (True, False)
    >>> found.corrected[x].mean.round(1)
    array([3.])
    """

    log_evidence: Array
    standard_error: Array
    effective_sample_size: Array
    effective_draws: Array
    gaussian_log_evidence: Array
    divergence: Array
    divergence_error: Array
    inclusive_divergence: Array
    inclusive_error: Array
    moment_divergence: Mapping[Variable, Array]
    corrected: Mapping[Variable, Gaussian | Table]
    suspect: Mask
    trusted: Mask
    pareto_k: Array
    undefined: Array
    modes: Integers
    missed: Array
    log_weights: Array
    innovations: Mapping[Variable, InnovationCheck]
    # By variable, the parts that groups of draws have in the errors of its corrected moments,
    # (G, ..., steps); of variables whose errors are kept.
    _spreads: Mapping[Variable, Spread]
    _furthest: tuple[float, str]
    _unknown: str

    def __init__(
        self,
        mixture: Mixture,
        gaussian_log_evidence: Array,
        compared: Sequence[Compared] = (),
        innovations: Mapping[Variable, InnovationCheck] = MappingProxyType({}),
        modes: Modes | None = None,
    ) -> None:
        known = np.array(gaussian_log_evidence, dtype=float)
        lead = known.shape
        modes = modes or Modes.none(known.size)
        trusted = _is_trusted(mixture, modes)
        correction = mixture.evidence.log - known.reshape(-1)
        found = {
            "log_evidence": mixture.evidence.log,
            "standard_error": mixture.evidence.standard_error,
            "effective_sample_size": mixture.effective_sample_size,
            "effective_draws": mixture.effective_draws,
            "divergence": mixture.divergence.value,
            "divergence_error": mixture.divergence.error,
            "inclusive_divergence": mixture.inclusive.value,
            "inclusive_error": mixture.inclusive.error,
            "pareto_k": mixture.pareto_k,
            "undefined": mixture.undefined,
            "log_weights": mixture.weighed.plain,
            "modes": (modes.shares > 0.0).sum(axis=0),
            "missed": modes.missed,
            "suspect": _is_suspect(mixture, compared, correction, trusted),
            "trusted": trusted,
        }
        reshaped = {
            name: frozen(value.reshape((*lead, *value.shape[1:]))) for name, value in found.items()
        }
        alone = {each.scope[0]: each for each in compared if len(each.scope) == 1}
        self._set(
            **reshaped,
            gaussian_log_evidence=frozen(known),
            corrected=MappingProxyType({v: each.belief(lead) for v, each in alone.items()}),
            moment_divergence=MappingProxyType(
                {v: each.divergences(lead) for v, each in alone.items()}
            ),
            innovations=MappingProxyType(dict(innovations)),
            _spreads=MappingProxyType(
                {
                    v: each.errors(each.spread, lead)
                    for v, each in alone.items()
                    if isinstance(each, ComparedMoments) and each.spread is not None
                }
            ),
            _unknown=modes.reason,
            _furthest=max((each.furthest(lead) for each in compared), default=(0.0, "")),
        )

    @property
    def samples(self) -> int:
        """S, the number of draws from the Gaussian in each run; there are S defensive ones, too."""
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
        trust = "" if self.trusted.all() else ": these estimates are not to be trusted"
        if trust and self.trusted.any():
            trust = f"{trust} in {(~self.trusted).sum()} runs"
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
                "The answer against the exact posterior of the same model:",
                *self._verdict(),
                Listing(("", ""), rows),
                f"Pareto shape {k:.2g} (to be below {UNTRUSTED}){trust}",
                *self._others(),
                *self._gaps(),
                "The model against its data:" + " not seen by this audit" * (not seen),
                *seen,
            ],
        )

    def _verdict(self) -> list[str]:
        """A line on how far the worst belief and the log-evidence are off; [] without beliefs."""
        divergence, where = self._furthest
        if not where:
            return []
        off = float(np.abs(self.correction).max())
        told = (
            f"the belief of {where} is {divergence:.3g} nats from the exact moments; log-evidence "
            f"is {'up to ' if self.suspect.ndim else ''}{off:.3g} nats off"
        )
        if not self.suspect.any():
            return [told]
        runs = f" in {self.suspect.sum()} of {self.suspect.size} runs" if self.suspect.ndim else ""
        return [f"SUSPECT{runs}: {told}"]

    def _others(self) -> list[str]:
        """Lines about other modes: their number, the mass not drawn from, and a failed search."""
        found, missed = int(self.modes.max(initial=0)), float(np.nanmax(self.missed, initial=0.0))
        told = [f"other modes found: {found}{' at the most' * (self.modes.ndim > 0)}"] * (found > 0)
        if missed > MISSED:
            told.append(f"modes with {missed:.2g} of the mass were found, and not drawn from")
        if np.isnan(self.missed).any():
            told.append(f"whether there are other modes is not known: {self._unknown}")
        return told

    def _gaps(self) -> list[str]:
        """A line on defensive draws at which a function was not finite, if there are any."""
        share = float(self.undefined.max(initial=0.0))
        return [
            f"a function was NaN or infinite at {share:.2g} of the defensive draws, which count as "
            "impossible"
        ] * (share > 0.0)
