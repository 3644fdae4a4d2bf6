"""The call that chooses by itself: the best answer that can be vouched for, and its verdict."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from pgm.arguments import public
from pgm.beliefs.gaussian.layout import robust
from pgm.beliefs.modes.chain import ChainSearch
from pgm.beliefs.modes.laws import Laws
from pgm.beliefs.modes.network import NetworkSearch
from pgm.beliefs.modes.outcome import Found, ModeFigures, ModesOutcome, Part
from pgm.beliefs.modes.search import Search
from pgm.boundary import as_generator, is_whole
from pgm.compile import compile
from pgm.cpds.base import naming_factors
from pgm.display import titled
from pgm.errors import ModelError, PgmError, PrecisionWarning
from pgm.evidence import Evidence
from pgm.inference.dynamic import over_time
from pgm.inference.engine import infer
from pgm.inference.families import answered, family_of
from pgm.inference.vouching.climbing import PLAIN, Answer, Sought, climb
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork, MarkovNetwork
from pgm.posteriors.posterior import Posterior
from pgm.posteriors.status import Status
from pgm.posteriors.verdict import KINDS, Verdict
from pgm.schedules.convergence import told
from pgm.schedules.damping import LevenbergMarquardt
from pgm.schedules.options import Call
from pgm.schedules.schedule import Calibration, Smoothing

# Draws of a run at the most, unless a call asks for others, and the least that it can ask for.
EFFORT, LEAST = 8000, 40
# Linearisations, their tolerance and damping, of an answer that no draws judge.
CAREFUL = 50, 1e-4, LevenbergMarquardt()
HYPOTHESES = "several hypotheses at each step are not weighed; pgm.audit judges switching models"


@public
def estimate(
    model: DynamicBayesianNetwork | BayesianNetwork | MarkovNetwork,
    evidence: Evidence,
    *,
    effort: int = EFFORT,
    steps: int | None = None,
    rng: np.random.Generator | int = 0,
) -> Posterior:
    r"""The best answer that can be vouched for, and its verdict: everything is chosen for you.

    .. math:: p(x_t \mid \text{all measurements})

    1. Iterated smoothers start from the filter's linearisation and from 32 points of the prior, as
       runs of one call (of a network without time, iterated calibrations), by Gauss–Newton. Those
       that have not settled go on from where they stopped, at last by Levenberg–Marquardt. Where
       the starts do not agree on the modes 32 more are tried. The points where they settle are the
       modes, weighed by their evidence.
    2. Draws of the mixture of the modes, 1,000 a run, and some of the model alone, are weighed by
       the exact density. If they tell that the mixture q is within .1 nats of the exact posterior
       p, of all variables together, it is kept. Else it is adapted by the draws, and twice as many
       are drawn, until q is near, or the moments of each belief are known within .1 nats, or the
       `effort` is spent.
    3. Means and covariances are those of the weighed draws, with each mode as a control variate.
    4. What this does not vouch for is tried by another rule. What is then not vouched for by the
       density is tried, of a chain of up to 6 components a step, all with noise, by draws of each
       step alone, 256 and 512, any of which may follow any of the step before. So a chain has a
       belief that is ambiguous at many steps, each apart from the others. It is the answer where
       more can be said of it, or where it refutes the one before, and is vouched for within .05.

    The result says in ``posterior.verdict`` whether it is vouched for, within how much, and what it
    took; so does ``print(posterior)``. Nothing is vouched for if starts do not agree on the modes,
    settle at several points none of which the measurements fit, too few draws count, or their
    weights have a heavy tail: then it is the answer that was got, not wrong for certain. Exact
    beliefs, of tables and of linear Gaussian models, are found as by `smooth` and `infer`, and are
    vouched for.

    It is of whole records. In a robot's loop `OnlineFilter` does not choose; there is no
    ``online=``.

    Parameters
    ----------
    model : DynamicBayesianNetwork, BayesianNetwork or MarkovNetwork
    evidence : mapping of Variable
        As of `smooth` over time, else as of `infer`. Leading axes are runs.
    effort : int
        The most draws of a run by each rule, 40 or more. Draws of each step alone come on top, if
        it is 768 or more. A chain of more than 1,000 steps has 200 in all.
    steps : int, optional
        T, the last step; see `smooth`.
    rng : numpy.random.Generator or int
        The generator of draws, or its seed.

    Returns
    -------
    Posterior
        ``posterior[x]`` is a `GaussianMixture` of the modes; a `Gaussian` or `Table` where that is
        exact, or where nothing could be weighed, as of models with flat priors, exact sensors,
        discrete variables or sightings of unknown things, whose verdict has the reason.
        ``log_evidence`` is of the draws, where enough count, else Laplace's approximation.

    Raises
    ------
    PgmError
        For the same reasons as `smooth` and `infer`.

    References
    ----------
    See `Audit`; Cappé, Douc, Guillin, Marin & Robert, Adaptive importance sampling in general
    mixture classes, 2008; Good, The population frequencies of species, 1953; Neal, Beal & Roweis,
    Inferring state sequences for non-linear systems with embedded hidden Markov models, 2003.

    Examples
    --------
    >>> from pgm.examples import square, x, y
    >>> posterior = pgm.estimate(square, {y: [9.0]})
    >>> posterior.verdict
    Verdict(vouched for: the density of every belief within 0.0071 nats)
      tried: 33 starts, 33 of which settled, at 1 mode
      chosen: one Gaussian, with moments of the draws
      judged by: 1000 draws, worth 832, of tail -1.32 (to be below 0.7)
      cost: 33 iterated answers in one batch, 1000 draws
    >>> posterior[x].mean.round(2)
    array([2.99])
    """
    if not is_whole(effort) or effort < LEAST:
        raise ModelError(f"effort is a number of draws, {LEAST} or more; not {effort!r}")
    generator = as_generator(rng)
    if isinstance(model, DynamicBayesianNetwork):
        posed = _over_time(model, evidence, steps)
    elif isinstance(model, BayesianNetwork | MarkovNetwork):
        posed = _without_time(model, evidence, steps)
    else:
        raise ModelError(
            f"estimate takes a network, a DynamicBayesianNetwork or one without time, not "
            f"{titled(model)}"
        )
    lead = np.shape(posed.plain.log_evidence)
    if posed.plain.log_evidence_kind == "exact":
        return posed.plain._judged(Verdict.exact(lead))
    if not posed.continuous:
        return posed.plain._judged(Verdict.unknown(lead, HYPOTHESES))
    try:
        with naming_factors(), warnings.catch_warnings():
            warnings.simplefilter("ignore", PrecisionWarning)  # of starts that go astray
            search = posed.search()
            sought, answer = climb(search, effort, generator)
            outcome = _outcome(search, sought, answer)
    except PgmError as error:
        return posed.unweighed()._judged(Verdict.unknown(lead, f"nothing is weighed: {error}"))
    return Posterior(outcome)._judged(_verdict(lead, sought, answer))


class Posed(NamedTuple):
    """A question to estimate: its answer by one linearisation, and the ways to better ones.

    plain: The answer by one linearisation.
    continuous: Whether it is of continuous variables alone, without hypotheses.
    search: Makes the search for modes.
    careful: Makes the answer by Levenberg–Marquardt.
    """

    plain: Posterior
    continuous: bool
    search: Callable[[], Search]
    careful: Callable[[], Posterior]

    def unweighed(self) -> Posterior:
        """The answer by Levenberg–Marquardt; by one linearisation where it cannot control steps."""
        try:
            return self.careful()
        except PgmError:  # as of exact sensors
            return self.plain


def _over_time(model: DynamicBayesianNetwork, evidence: Evidence, steps: int | None) -> Posed:
    """The question of a chain."""
    family, (graph, bound, call) = over_time(model, evidence, Call(Smoothing()), steps)
    schedule = Smoothing(*CAREFUL)

    def answer(call: Call) -> Posterior:
        return answered(family, family.infer(graph, bound, call))

    return Posed(
        answer(call),
        family.by_modes,
        lambda: ChainSearch.make(graph, bound, call),
        lambda: told(answer(call._replace(schedule=schedule)), schedule),
    )


def _without_time(
    model: BayesianNetwork | MarkovNetwork, evidence: Evidence, steps: int | None
) -> Posed:
    """The question of a network without time."""
    if steps is not None:
        raise ModelError(f"a network without time has no steps; leave steps={steps!r} out")
    graph = compile(model)
    schedule = Calibration(*CAREFUL)
    call = Call(schedule)
    return Posed(
        infer(graph, evidence, schedule=schedule if robust(graph) else None),
        family_of(model).by_modes,
        lambda: NetworkSearch.make(graph, evidence, call),
        lambda: infer(graph, evidence, schedule=schedule),
    )


def _outcome(search: Search, sought: Sought, answer: Answer) -> ModesOutcome:
    """The mixtures of an answer."""
    lead = search.lead
    laws = Laws(*(each[answer.laws.weights.any(axis=1)] for each in answer.laws))
    figures = ModeFigures(
        int(sought.starts.max()),
        sought.settled.reshape(lead),
        (laws.weights > 0.0).sum(axis=0).reshape(lead),
        answer.effective.reshape(lead),
    )
    some = np.reshape(sought.settled > 0, lead)
    status = Status(PLAIN[0], np.zeros((0, *lead)), some, _figures=figures)
    evidence = np.where(answer.sound, answer.log_evidence, sought.log_evidence).reshape(lead)
    modes = np.arange(len(laws.weights))
    index = np.tile(modes[:, None], (1, search.runs))
    parts = [Part(modes, search.beliefs(laws))]
    return search.outcome(Found(status, evidence, parts, index, laws.weights, index))


def _verdict(lead: tuple[int, ...], sought: Sought, answer: Answer) -> Verdict:
    """The verdict on the answers of all runs."""
    vouched = sought.agreed & (answer.of > 0) & ~(answer.unlikely & sought.several)
    return Verdict(
        lead,
        vouched=vouched,
        within=np.where(answer.sound, answer.within, np.nan),
        of=np.array(KINDS)[np.where(vouched, answer.of, 0)],
        starts=sought.starts,
        settled=sought.settled,
        resumed=sought.resumed,
        modes=sought.modes,
        agreed=sought.agreed,
        draws=answer.draws,
        effective=answer.effective,
        pareto_k=answer.pareto_k,
        recombined=answer.recombined,
        tried_otherwise=sought.otherwise,
        otherwise=answer.otherwise,
        unlikely=answer.unlikely,
    )
