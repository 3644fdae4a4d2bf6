"""The audit of a Gaussian posterior: the call that measures its distance from the exact one."""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_generator, is_whole
from pgm.cpds.base import naming_factors
from pgm.errors import ModelError
from pgm.inference.audit.batches import estimate
from pgm.inference.audit.chain import ChainDraws
from pgm.inference.audit.innovation_checks import checks
from pgm.inference.audit.result import Audit
from pgm.inference.audit.switching import SwitchingDraws
from pgm.inference.audit.tree import TreeDraws
from pgm.posteriors.outcome import (
    BALANCED,
    BY_PATTERN,
    CHAIN,
    MIXTURES,
    NETWORK,
    SLICES,
    SWITCHING,
    TABLES,
)
from pgm.posteriors.posterior import Posterior
from pgm.progress import Progress, reporting
from pgm.schedules.limits import require_runs

# Draws from the answer unless a call asks for others; of a chain of more steps than LONG.
SAMPLES, FEW, LONG = 1000, 100, 1000
# The draws from beliefs of each form.
_DRAWS: dict[str, Any] = {
    CHAIN: ChainDraws,
    BALANCED: ChainDraws,
    NETWORK: TreeDraws,
    SWITCHING: SwitchingDraws,
}


@public
def audit(
    posterior: Posterior[Any],
    *,
    samples: int | None = None,
    rng: np.random.Generator | int,
    progress: Progress = False,
) -> Audit:
    """Estimate the distance of a Gaussian answer from the exact one, by importance sampling.

    The exact answer is the posterior of the model as declared, even if the model is wrong; whether
    the model fits its data is told by the result's `innovations`.

    Trajectories x_s are drawn from the smoothed joint Gaussian q of the linearised model and
    weighed with the model as it was declared,

        w_s = p(x_s, z) / q(x_s),    ln p(z) ≈ ln (1/S) Σ w_s,

    p(x, z) being the product of all CPDs with their own noise: priors, transitions, hidden
    controls and every measurement taken. For a linear model all weights are p(z). Where a CPD
    without noise determines components, q proposes the others, and these follow from the model.
    After filtering, q is the smoothed joint of the filter's linearisation.

    If q has lost a mode, its own draws do not show that. As many draws therefore come from a
    defensive density d; log-evidence, divergences and exact moments are estimated from all draws,
    weighed by the mixture r of both, with q/r as a control variate of slope β:

        r = (q + d)/2,    Z = mean of p/r − β (mean of q/r − 1).

    Other modes are looked for first, by some twenty short smoothers that start elsewhere: at mirror
    images 2ρ − μ of the answer's means μ about the motion ρ of the prior's mean (all components, or
    one of them, from step 0 or from the middle on), and at drives of the model from points of the
    prior. Where they arrive at fixed points further than a standard deviation from the answer and
    from one another, half of d's draws come from the Gaussians there. The masses of modes need not
    be known for this: all draws are weighed by the exact density.

    Of a network without time starts are points of the prior. Where variables have none of finite
    variance, as in a `MarkovNetwork` those that no CPD explains, the Gaussian that all affine
    factors with Gaussian noise make together takes its place: of canonical forms, linear CPDs, and
    residuals of affine functions. Where that is not proper, nothing tells where other modes could
    be. Draws are then from the answer and from one with four times its deviations, `missed` is NaN,
    and the audit is not `trusted`.

    The other draws of d leave q for one excursion: from some slice on and for some slices they
    follow the model's own CPDs, or q's conditionals, with Student's t₅ for the noise in either
    case. In a network without time they are all from the prior, or from q, with Student's t₅. The
    control q/r has mean one, and for a linear model leaves no error. A result whose beliefs or
    log-evidence are off is `suspect`.

    An audit does not know of a mode that none of its starts leads to: a mode that differs from the
    answer in most of many symmetric choices at once, each at another time or in another part of a
    network; or a mode in a region that the prior hardly reaches and no mirror image hits. Beside
    sensors without noise other modes are found and not drawn from: the audit is then not `trusted`.

    Of a switching model, whose answer is a mixture of Gaussians, paths of its discrete variables
    are drawn: q is a Markov chain that has the smoothed probabilities of each two successive steps,
    and d draws paths by the model's probabilities, their roots, or uniformly, so that rare ones are
    met. Where CPDs are linear given a path, p(path, z) is what a Kalman filter finds, trajectories
    are drawn exactly, and the divergences are those of paths. With nonlinear CPDs trajectories are
    drawn from the smoother of the path, and weighed by the exact density. Sightings that leave open
    of which candidate they are, and robust noise, are refused.

    Of a Markov network p(x, z) is the product of its factors with their constants, and its integral
    is Z. An angle that wrapped residuals alone tell of is a point of the circle: the integral is
    over one turn.

    Residuals of measurements of angles are wrapped, and an angle that a function wraps is taken on
    the branch of the linearisation, so that wrapping it or not gives the same.

    Parameters
    ----------
    posterior : Posterior
        The posterior of a filter or smoother, or of a tree: of Gaussian beliefs, or of mixtures of
        Gaussians over time.
    samples : int, optional
        S, the number of draws from q for each run, 2 or more; there are as many defensive draws.
        1,000 without; 100 of a chain of more than 1,000 steps.
        The result keeps a number for each draw, and the draws are made in batches of bounded size.
    rng : numpy.random.Generator or int
        The generator of draws, or its seed.
    progress : bool or callable
        Whether bars show how many batches of draws are done, on a terminal or in a notebook; or a
        function, ``progress(done, total)``, called at the start and after each batch.

    Raises
    ------
    ModelError
        If the posterior is of another kind, the prior of a chain has an infinite variance, a
        switching model has sightings that leave open what was seen, robust noise, or hidden
        controls beside nonlinear CPDs, or another argument is of a wrong kind or out of its range.
    GraphError
        If the graph has loops, or the weights of all runs would not fit.
    NumericalError
        If nothing can be drawn: a nonlinear sensor with singular noise was read, nonlinear CPDs
        with singular noise stand beside linear sensors with it, or paths of a switching model make
        measurements certain, or states beside nonlinear CPDs.
    LinearisationError
        If a function is NaN or infinite at a draw of q; defensive draws at which it is are counted
        in `undefined`.

    References
    ----------
    See `Audit`; Särkkä & Svensson, Bayesian Filtering and Smoothing, 2nd edition, 2023, chapter
    11.

    Examples
    --------
    >>> from pgm.examples import square, y
    >>> found = audit(pgm.infer(pgm.compile(square), {y: [9.0]}), rng=0)
    >>> found.correction.round(2), found.standard_error.round(3)
    (np.float64(0.01), np.float64(0.002))
    """
    if samples is not None and (not is_whole(samples) or samples < 2):
        raise ModelError(f"samples is the number of draws, 2 or more; not {samples!r}")
    generator = as_generator(rng)
    outcome = posterior._outcome if isinstance(posterior, Posterior) else None
    if outcome is None or outcome.form not in _DRAWS:
        raise ModelError(_advice(posterior))
    graph = outcome.graph
    for cpd in () if outcome.form == NETWORK else graph.model.prior:
        cpd.require_proper("an audit draws from the posterior, and weighs with the prior")
    known = posterior.log_evidence
    if samples is None:
        steps = 0 if outcome.form == NETWORK else outcome.graph.steps
        samples = FEW if steps > LONG else SAMPLES
    require_runs(8 * samples, known.size, "the weights of an audit")
    with naming_factors():
        draws: ChainDraws | TreeDraws | SwitchingDraws = _DRAWS[outcome.form].make(outcome)
        with reporting(progress):
            mixture, compared = estimate(draws, known.size, samples, generator)
    seen = {} if outcome.form in (NETWORK, SWITCHING) else checks(posterior.innovations)
    return Audit(mixture, known, compared, seen, draws.modes)


def _advice(posterior: Any) -> str:
    """The text of the error for an argument that is no Gaussian posterior with all its beliefs."""
    if isinstance(posterior, Posterior) and posterior._outcome.form in (SLICES, TABLES):
        return f"{posterior._title} is of a discrete network; of a tree its log-evidence is exact"
    if isinstance(posterior, Posterior) and posterior._outcome.form == MIXTURES:
        return f"{posterior._title} is of a mixed network, which no audit draws from"
    if isinstance(posterior, Posterior) and posterior._outcome.form == BY_PATTERN:
        return (
            f"{posterior._title} is of runs with different gaps; an audit draws from one network: "
            "give runs of one pattern of gaps to a call"
        )
    if isinstance(posterior, Posterior) and posterior.log_evidence_kind in ("modes", "draws"):
        return (
            f"{posterior._title} has several modes, which no audit draws from. Draws have judged "
            "them already, if it is of pgm.estimate: posterior.verdict tells how well; and draws= "
            "of pgm.Gaussians(count, starts=..., draws=...) weighs modes"
        )
    if isinstance(posterior, Posterior):
        return (
            f"{posterior._title} has kept marginals alone; leave keep= out, and belief=, to have "
            "what is audited"
        )
    return (
        f"audit takes a posterior of pgm.filter, pgm.smooth or pgm.infer, not "
        f"{type(posterior).__name__}"
    )
