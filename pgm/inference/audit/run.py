"""Auditing a posterior: estimates of draws that are made in batches."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Protocol

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_generator, is_whole
from pgm.errors import ModelError
from pgm.inference.audit.draws import Draws
from pgm.inference.audit.estimates import Compared, Mixture, Sums, weigh
from pgm.inference.audit.joints import ChainDraws, TreeDraws
from pgm.inference.audit.result import Audit, checks
from pgm.inference.chain.kept_posterior import KeptPosterior
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.gaussian.posterior import GaussianPosterior
from pgm.inference.limits import require_runs
from pgm.inference.posterior import Posterior
from pgm.kernels.arrays import quiet
from pgm.progress import Progress, counted, reporting


@public
def audit(
    posterior: Posterior,
    *,
    samples: int = 1000,
    rng: np.random.Generator | int,
    progress: Progress = False,
) -> Audit:
    """Estimate the distance of a Gaussian answer from the exact one, by importance sampling.

    Exact is the posterior of the model as declared, be it wrong; whether it fits its data the
    result's `innovations` tell.

    Trajectories x_s are drawn from the smoothed joint Gaussian q of the linearised model and
    weighed with the model as it was declared,

        w_s = p(x_s, z) / q(x_s),    ln p(z) ≈ ln (1/S) Σ w_s,

    p(x, z) being the product of all CPDs with their own noise: priors, transitions, hidden
    controls and every measurement taken. For a linear model all weights are p(z). Where a CPD
    without noise determines components, q proposes the others, and these follow from the model.
    After filtering, q is the smoothed joint of the filter's linearisation.

    Where q has lost a mode its own draws do not tell. As many draws come from a defensive d, and
    log-evidence, divergences and exact moments from all of them, weighed by the mixture:

        r = (q + d)/2,    Z = mean of p/r − β (mean of q/r − 1).

    A draw of d leaves q for one excursion: from some slice on and for some slices it follows the
    model's own CPDs, with Student's t₅ for their noise, or q's conditionals with such tails. In a
    network without time it is all from the prior, or q with tails. The control q/r has mean one,
    and for a linear model leaves no error. A result whose beliefs or log-evidence are off is
    `suspect`.

    A mode that draws of the prediction hardly reach, or that is told from the other only by many
    steps of readings, or in a network of many variables, may escape it.

    Residuals of measurements of angles are wrapped, and an angle that a function wraps is taken on
    the branch of the linearisation, so that wrapping it or not gives the same.

    Parameters
    ----------
    posterior : ChainPosterior or GaussianPosterior
        Of a filter or smoother, or of a tree.
    samples : int
        S, 2 or more draws for each run; each is drawn by itself. The result keeps a number for
        each draw, and the draws are made in batches of bounded size.
    rng : numpy.random.Generator or int
        The generator of draws, or its seed.
    progress : bool or callable
        As for `infer`, of batches of draws.


    Raises
    ------
    ModelError
        If the posterior is none of these, the prior of a chain has an infinite variance, or an
        argument is no such number.
    GraphError
        If the graph has loops, or the weights of all runs would not fit.
    NumericalError
        If nothing can be drawn: a nonlinear sensor with singular noise was read, or nonlinear CPDs
        with singular noise stand beside linear sensors with it.
    LinearisationError
        If a function is NaN or infinite at a draw of q; defensive ones are counted, `undefined`.

    References
    ----------
    As of `Audit`; Särkkä & Svensson, Bayesian Filtering and Smoothing, 2nd edition, 2023, chapter
    11.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> found = audit(pgm.infer(pgm.compile(square), {y: [9.0]}), rng=0)
    >>> found.correction.round(2), found.standard_error.round(3)
    (np.float64(0.01), np.float64(0.002))
    """
    draws: ChainDraws | TreeDraws
    if not is_whole(samples) or samples < 2:
        raise ModelError(f"samples is the number of draws, 2 or more; not {samples!r}")
    generator = as_generator(rng)
    if isinstance(posterior, ChainPosterior):
        for cpd in posterior.graph.model.prior:
            cpd.require_proper("an audit draws from the posterior, and weighs with the prior")
        draws = ChainDraws.make(posterior)
    elif isinstance(posterior, GaussianPosterior):
        draws = TreeDraws.make(posterior)
    else:
        raise ModelError(_advice(posterior))
    known = posterior.log_evidence
    require_runs(8 * samples, known.size, "the weights of an audit")
    with reporting(progress):
        mixture, compared = estimate(draws, known.size, samples, generator)
    seen = checks(posterior.innovations) if isinstance(posterior, ChainPosterior) else {}
    return Audit(mixture, known, compared, seen)


def _advice(posterior: Any) -> str:
    if isinstance(posterior, KeptPosterior):
        return (
            f"{posterior._title} has kept marginals alone; leave keep= out to have what is audited"
        )
    if isinstance(posterior, Posterior):
        return f"{posterior._title} is of a discrete network; of a tree its log-evidence is exact"
    return (
        f"audit takes a posterior of pgm.filter, pgm.smooth or pgm.infer, not "
        f"{type(posterior).__name__}"
    )


# Numbers drawn at once: what stays near the processor, and what whole draws may take.
BATCH, ROOM = 2**18, 2**24


class Drawing(Protocol):
    """The source of draws: a chain, or a tree."""

    @property
    def width(self) -> int:
        """Numbers that one draw of one run takes at a time."""

    @property
    def length(self) -> int:
        """Numbers of a whole draw."""

    def draw(self, count: int, rng: np.random.Generator, *, defensive: bool) -> Draws:
        """So many new draws a run."""

    def sums(self) -> list[Sums]:
        """Empty sums, one a hidden variable and one a cluster of several."""


def estimate(
    drawing: Drawing, runs: int, samples: int, rng: np.random.Generator
) -> tuple[Mixture, list[Compared]]:
    """Draw so often from the Gaussian, and as often defensively, and sum up, batch by batch."""
    size = max(
        1, min(BATCH // max(drawing.width, 1), ROOM // max(drawing.length, 1)) // max(runs, 1)
    )
    shape = (runs, 2 * samples)
    log_weights, control, log_ratio = np.empty(shape), np.empty(shape), np.empty(shape)
    lost, peak = np.zeros(runs), np.full(runs, -np.inf)
    sums = drawing.sums()
    for part, defensive in counted(list(_parts(samples, size)), "batches of draws"):
        with quiet():  # a residual too large to be squared has no weight
            drawn = drawing.draw(part.stop - part.start, rng, defensive=defensive)
            logs, share = weigh(drawn)
        log_weights[:, part], control[:, part] = logs, share
        log_ratio[:, part] = drawn.target - drawn.gaussian
        lost += np.isnan(drawn.target).sum(axis=-1)
        before, peak = peak, np.maximum(peak, logs.max(axis=-1))
        level = np.where(np.isfinite(peak), peak, 0.0)
        fading = np.exp(np.where(np.isfinite(before), before - level, 0.0))
        pair = np.stack([np.exp(logs - level[:, None]), share])
        for each in sums:
            each.add(drawn.values, pair, fading)
    mixture = Mixture.make(log_weights, control, log_ratio, lost / samples)
    return mixture, [each.compared(mixture) for each in sums]


def _parts(samples: int, size: int) -> Iterator[tuple[slice, bool]]:
    for defensive in (False, True):
        for first in range(0, samples, size):
            last = min(first + size, samples)
            yield slice(first + defensive * samples, last + defensive * samples), defensive
