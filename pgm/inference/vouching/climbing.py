"""The answer that is sought: modes from several starts, then draws, until it can be vouched for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Self

import numpy as np

from pgm.beliefs.modes.adapted import moved
from pgm.beliefs.modes.arrivals import heights
from pgm.beliefs.modes.laws import Laws
from pgm.beliefs.modes.outcome import Part
from pgm.beliefs.modes.pool import BLOCKS, Pool, Weighed
from pgm.beliefs.modes.search import Search
from pgm.errors import PgmError
from pgm.inference.vouching.judging import Judged, Marginal, judge
from pgm.inference.vouching.recombining import PASSES, Recombined, apart, per_call, recombined
from pgm.kernels.arrays import Array, Integers, Mask, quiet
from pgm.posteriors.verdict import ENOUGH, HEAVY
from pgm.schedules.damping import LevenbergMarquardt

# Starts of the first search, and of the last; modes that are kept; nats of log-evidence below the
# best from which on a mode has no mass that counts.
STARTS, MOST_STARTS, MODES, NEGLIGIBLE = 32, 64, 16, 10.0
# Starts agree if this part of them has settled, since one that has not may be near a mode of its
# own, and if modes that were found once have no more of the mass, which estimates the mass of modes
# that were not found (Good, 1953): half of what the verdict allows for these.
SETTLED, UNSEEN = 0.9, 0.005
# Linearisations, their tolerance and damping: of the first search, and of more careful ones.
PLAIN = 25, 1e-4, 0.0
CAREFUL = 50, 1e-4, LevenbergMarquardt(tries=3)
# Those by another rule, whose steps are held back, and the number of its starts.
HELD, HALF = (25, 1e-3, 0.3), 8
# Draws of the first round; of a chain of more steps than LONG of the first and only one, and only
# the first search is made.
FIRST, FEW, LONG = 1000, 200, 1000
# An answer is vouched for within so many nats; one by recombined trajectories within half, since
# two passes that are near each other by chance may both be further from the truth.
WITHIN, HALF_WITHIN = 0.1, 0.05
# Numbers of all draws that are held at once.
ROOM = 2**24


@dataclass(frozen=True, eq=False)
class ByRun:
    """Laws, and figures of each run, (runs,)."""

    laws: Laws

    def put(self, runs: Integers, other: Self) -> Self:
        """The laws and figures of all runs, those of some replaced by others."""
        count = max(len(self.laws.weights), len(other.laws.weights))
        laws = self.laws.padded(count).put(runs, other.laws)
        return type(self)(laws, *(_put(*pair) for pair in self._pairs(runs, other)))

    def some(self, places: Integers) -> Self:
        """The laws and figures of some runs."""
        rest = (getattr(self, field.name)[places] for field in fields(self)[1:])
        return type(self)(self.laws.of(places), *rest)

    def _pairs(self, runs: Integers, other: Self) -> Iterator[tuple[Any, Integers, Any]]:
        for field in fields(self)[1:]:
            yield getattr(self, field.name), runs, getattr(other, field.name)


def _put(values: Any, runs: Integers, new: Any) -> Any:
    """Values with those of some runs replaced."""
    found = values.copy()
    found[runs] = new
    return found


@dataclass(frozen=True, eq=False)
class Sought(ByRun):
    """The modes that starts have found.

    log_evidence: Laplace's approximation.
    agreed: Whether nine in ten starts are done, and modes that were found once have little mass.
        A start is done where it settled, or stopped so far below the best mode, in nats, that what
        it gained of late would not bring it near.
    starts, settled: How many starts there were, and how many settled.
    resumed: How often a start went on from where it had stopped.
    otherwise: How many of the starts were by another rule.
    several: Whether they settled at several points, however little their mass.
    """

    log_evidence: Array
    agreed: Mask
    starts: Integers
    settled: Integers
    resumed: Integers
    otherwise: Integers
    several: Mask

    @property
    def modes(self) -> Integers:
        """The number of modes."""
        found: Integers = (self.laws.weights > 0.0).sum(axis=0)
        return found


@dataclass(frozen=True, eq=False)
class Answer(ByRun):
    """A mixture, and what draws say of it.

    within: A bound on the divergence of the worst marginal [nats].
    of: What it bounds: 0 nothing, 1 the density, 2 moments.
    sound: Whether enough draws count, and the tail of their weights allows estimates.
    usable: Whether the tail has a mean at least, so that estimates may serve if none is sound.
    recombined: Whether it is by trajectories recombined from draws of each step.
    otherwise: Whether its modes are by another rule.
    unlikely: Whether noises are larger, by the draws, than they are once in a million.
    """

    log_evidence: Array
    within: Array
    of: Integers
    sound: Mask
    usable: Mask
    draws: Integers
    effective: Array
    pareto_k: Array
    recombined: Mask
    otherwise: Mask
    unlikely: Mask

    @classmethod
    def nothing(cls, laws: Laws) -> Answer:
        """The laws, of which no draws say anything."""
        runs = laws.weights.shape[1]
        none, unknown, no = np.zeros(runs, np.intp), np.full(runs, np.nan), np.full(runs, False)
        figures = np.zeros(runs), unknown, no, no, no
        return cls(laws, unknown, unknown, none, no, no, none, *figures)

    @property
    def rank(self) -> Array:
        """How much can be said of each run: whether it is vouched for, then by what draws."""
        grade = 1.0 * (self.of > 0) + self.sound + self.usable
        return np.asarray(grade + self.effective / (1.0 + self.draws))


@quiet()
def seek(search: Search) -> Sought:
    """The modes of all runs, from 32 starts and from none.

    Twice as many are tried where starts do not agree; of a long chain no more.
    """
    every = np.arange(search.runs)
    paths = _paths(search, every, 0, STARTS)
    asked = np.full(search.runs, STARTS + 1)
    found = _sought(search, paths, asked)
    if search.steps <= LONG and not found.agreed.all():
        runs = _asked(search, np.flatnonzero(~found.agreed))
        paths = paths.with_others(_paths(search, runs, STARTS, MOST_STARTS))
        asked[runs] += MOST_STARTS - STARTS
        found = _sought(search, paths, asked)
    return found


class Paths(NamedTuple):
    """Starts, and where they stopped: at first, and where some went on, at last more carefully."""

    first: list[Part]
    further: list[Part]
    careful: list[Part]

    @property
    def plain(self) -> list[Part]:
        """The beliefs before any went on more carefully."""
        return [*self.first, *self.further]

    @property
    def resumed(self) -> list[Part]:
        """The beliefs of starts that went on from where they had stopped."""
        return [*self.further, *self.careful]

    @property
    def parts(self) -> list[Part]:
        """All beliefs, the last of a start that counts after those before."""
        return [*self.first, *self.further, *self.careful]

    def with_others(self, other: Paths) -> Paths:
        """The paths of these starts and of others."""
        return Paths(*([*own, *more] for own, more in zip(self, other, strict=True)))

    def within(self, runs: Integers) -> Paths:
        """The paths of a search in some runs, as those of the whole search."""
        return Paths(*([part.within(runs) for part in own] for own in self))


def _paths(search: Search, runs: Integers, before: int, starts: int) -> Paths:
    """The paths of so many starts, less a number `before` of them, in some runs.

    They are by Gauss–Newton; those that have not settled go on by it, and then by
    Levenberg–Marquardt.
    """
    part = search.of(runs)
    plain = part.by(*PLAIN)
    first = plain.arrived(starts, before)
    if not before:
        first += plain.unled()
    paths = Paths(first, [], [])
    if part.steps <= LONG:
        paths = paths._replace(further=plain.resumed(paths.plain))
        paths = paths._replace(careful=part.by(*CAREFUL).resumed(paths.plain))
    return paths if part is search else paths.within(runs)


def _counts(parts: Sequence[Part], runs: int) -> Integers:
    """How many starts of parts each run has, (runs,)."""
    every = np.arange(runs)
    each = (np.tile(every, len(part.starts)) if part.runs is None else part.runs for part in parts)
    return np.bincount(np.concatenate([every[:0], *each]), minlength=runs)


def _asked(search: Search, runs: Integers) -> Integers:
    """The runs to ask so that some are answered."""
    return np.arange(search.runs) if search.together else runs


def _sought(search: Search, paths: Paths, asked: Integers) -> Sought:
    """The modes of all runs at which starts have arrived, of so many that were `asked`, (runs,).

    Those that ended in an error in some run are of none; more than half must be left.
    """
    found = search.chosen(paths.parts, MODES)
    laws, runs = search.laws(found), search.runs
    near = laws.weights > np.exp(-NEGLIGIBLE) * laws.weights.max(axis=0)
    weights = np.where(near, laws.weights, 0.0)
    unseen = np.where(found.hits == 1, laws.weights, 0.0).sum(axis=0)
    before, (logs, settled) = heights(paths.plain, search.lead), heights(paths.parts, search.lead)
    starts = (~np.isnan(logs)).sum(axis=0)
    best = np.where(settled, logs, -np.inf).max(axis=0)
    gained = logs - before.log_evidence
    far = best - logs > NEGLIGIBLE + np.maximum(gained, 0.0)
    done = settled | (far & (gained != 0.0))  # else it did not go on, and may be on its way
    enough = (done.sum(axis=0) >= SETTLED * starts) & (2 * starts > asked)
    return Sought(
        laws._replace(weights=weights / weights.sum(axis=0)),
        np.reshape(found.log_evidence, runs),
        (unseen <= UNSEEN) & enough,
        starts,
        settled.sum(axis=0),
        _counts(paths.resumed, runs),
        np.zeros_like(starts),
        (found.hits > 0).sum(axis=0) > 1,
    )


@quiet()
def climb(search: Search, effort: int, rng: np.random.Generator) -> tuple[Sought, Answer]:
    """The modes of all runs, and their answers.

    Runs that draws of these modes do not vouch for have modes by another rule as well, and the
    answer of whose draws more can be said. Those that are still not vouched for by the density have
    trajectories recombined from draws of each step. Starts and draws of all count.
    """
    sought = seek(search)
    answer = weigh(search, sought.laws, effort, rng)
    if answer.draws.max() > FEW:
        for another, kinds in ((_otherwise, (0,)), (_recombined, (0, 2))):
            left = np.flatnonzero(np.isin(answer.of, kinds))
            if left.size:
                sought, answer = _tried(another, search, sought, answer, left, effort, rng)
    return sought, answer


# A way to other answers of some runs: its arguments are those of `_otherwise`.
Way = Callable[[Search, Sought, Answer, Integers, int, np.random.Generator], tuple[Sought, Answer]]


def _tried(
    way: Way,
    search: Search,
    sought: Sought,
    answer: Answer,
    left: Integers,
    effort: int,
    rng: np.random.Generator,
) -> tuple[Sought, Answer]:
    """The answers by a way, but those of runs that it refuses, which stay as they are.

    It refuses some where a rule asks a function for values that it does not have, or a law has no
    density. Runs that are asked together are refused together.
    """
    try:
        return way(search, sought, answer, left, effort, rng)
    except PgmError:
        if left.size == 1 or search.together:
            return sought, answer
    for half in np.array_split(left, 2):
        sought, answer = _tried(way, search, sought, answer, half, effort, rng)
    return sought, answer


def _otherwise(
    search: Search,
    sought: Sought,
    answer: Answer,
    left: Integers,
    effort: int,
    rng: np.random.Generator,
) -> tuple[Sought, Answer]:
    """The answers with those by another rule where more can be said of these, of some runs.

    Never one of fewer modes, whose draws might not meet a mode that is known.
    """
    runs = _asked(search, left)
    part, places = search.of(runs).otherwise().by(*HELD), np.searchsorted(runs, left)
    found = part.chosen([*part.unled(), *part.arrived(HALF)], MODES)
    other = weigh(part, part.laws(found), effort, rng).some(places)
    count = np.reshape(found.status.modes, -1)[places]
    starts, settled, others = (
        each.copy() for each in (sought.starts, sought.settled, sought.otherwise)
    )
    starts[left] += HALF + 1
    others[left] += HALF + 1
    settled[left] += np.reshape(found.status.arrived, -1)[places]
    sought = replace(sought, starts=starts, settled=settled, otherwise=others)
    other = replace(other, otherwise=np.full(left.size, True))
    preferred = (other.rank > answer.rank[left]) & (count >= sought.modes[left])
    return sought, _with(answer, left, other, preferred)


def _recombined(
    search: Search,
    sought: Sought,
    answer: Answer,
    left: Integers,
    effort: int,
    rng: np.random.Generator,
) -> tuple[Sought, Answer]:
    """The answers with those of recombined trajectories where more can be said of these.

    And where the others' moments are further from theirs than the bounds of both allow: draws of
    many steps that are of modes do not meet what is beside these.
    """
    most, runs = per_call(sought.laws), _asked(search, left)
    if effort < sum(PASSES) or (search.together and search.runs > most):
        return sought, answer

    old = other = answer.some(runs)
    for part in _parts(runs.size, most):
        laws = sought.laws.of(runs[part])
        found = recombined(search.of(runs[part]).target(laws), laws, rng)
        if found is None:
            return sought, answer
        other = other.put(part, _of_recombined(found))
    off = apart(search.of(runs).target(other.laws), other.laws, old.laws)
    refuted = other.sound & (off > old.within + other.within)
    other = replace(other, unlikely=old.unlikely)
    places = np.searchsorted(runs, left)
    preferred = (other.rank > old.rank) | refuted
    return sought, _with(answer, left, other.some(places), preferred[places])


def _of_recombined(found: Recombined) -> Answer:
    """The answers by recombined trajectories, whose moments are vouched for."""
    usable = (found.effective > ENOUGH) & (found.pareto_k < 1.0)
    sound = usable & (found.pareto_k < HEAVY)
    of = np.where(sound & (found.within < HALF_WITHIN), 2, 0)
    draws = np.full(of.shape, sum(PASSES))
    known = np.full(of.shape, True)
    rest = draws, found.effective, found.pareto_k, known, ~known, ~known
    return Answer(found.laws, found.log_evidence, found.within, of, sound, usable, *rest)


def _with(answer: Answer, runs: Integers, other: Answer, preferred: Mask) -> Answer:
    """The answers with others of some runs where these are preferred. The draws of both count."""
    better = np.flatnonzero(preferred)
    draws = _put(answer.draws, runs, answer.draws[runs] + other.draws)
    return replace(answer.put(runs[better], other.some(better)), draws=draws)


@quiet()
def weigh(search: Search, laws: Laws, effort: int, rng: np.random.Generator) -> Answer:
    """The answers of all runs: draws of the modes, and more where they do not vouch for it.

    A run whose draws are refused has its modes, of which nothing is said; the error is raised if
    there is no other run.
    """
    size = laws.first.shape[-1] + laws.mean.shape[1] * laws.mean.shape[-1]
    most = search.runs if search.together else max(1, ROOM // (effort * max(size, 1)))
    parts, whole = _parts(search.runs, most), Answer.nothing(laws)
    refused: PgmError | None = None
    answered = False
    while parts:
        runs = parts.pop(0)
        try:
            found = _weighed(search.of(runs), laws.of(runs), effort, rng)
        except PgmError as error:
            refused = refused or error
            if runs.size > 1 and not search.together:
                parts = [*np.array_split(runs, 2), *parts]
            continue
        whole, answered = whole.put(runs, found), True
    if refused is not None and not answered:
        raise refused
    return whole


def _parts(runs: int, most: int) -> list[Integers]:
    """The numbers of so many runs in parts."""
    return [np.arange(first, min(first + most, runs)) for first in range(0, runs, most)]


def _weighed(search: Search, laws: Laws, effort: int, rng: np.random.Generator) -> Answer:
    """The answers of some runs, whose draws fit into memory."""
    long = laws.mean.shape[1] > LONG
    count = min(FEW if long else FIRST, effort)
    count = max(count // BLOCKS, 2) * BLOCKS
    pool, runs, part = Pool(search.target(laws)), np.arange(search.runs), search
    pool.draw(laws, count, rng)
    judged = judge(pool, laws, None)
    found = own = _answer(judged, pool)
    while not long:
        left = np.flatnonzero(found.of[runs] == 0)
        more = 2 * pool.rounds[-1].count
        if not left.size or pool.count + more > effort:
            break
        left = _asked(part, left)
        runs, part = runs[left], part.of(left)
        laws = moved(pool, laws, Weighed(pool, laws)).of(left)
        before = [Marginal(each.mean[:, left], each.cov[:, left]) for each in judged.marginals]
        pool = pool.of(part.target(laws), left)
        pool.draw(laws, more, rng)
        judged = judge(pool, laws, before)
        own = _answer(judged, pool)
        unanswered = np.flatnonzero(found.of[runs] == 0)
        found = _better(found, own.some(unanswered), runs[unanswered])
    return found


def _better(found: Answer, own: Answer, runs: Integers) -> Answer:
    """The answers of all runs, those of some with what more draws say of them.

    Laws stay as they were where these draws are of no use, and those before were.
    """
    keep = np.flatnonzero(np.floor(found.rank[runs]) > np.floor(own.rank))
    laws = own.laws.padded(max(len(own.laws.weights), len(found.laws.weights)))
    kept = found.laws.padded(len(laws.weights)).of(runs[keep])
    return found.put(runs, Answer(laws.put(keep, kept), *_figures(own)))


def _figures(answer: Answer) -> list[Any]:
    return [getattr(answer, field.name) for field in fields(answer)[1:]]


def _answer(judged: Judged, pool: Pool) -> Answer:
    """The answers of all runs of a pool, by its draws.

    Moments are vouched for once the mixture was adapted.
    """
    usable = (judged.effective > ENOUGH) & (judged.pareto_k < 1.0)
    sound = usable & (judged.pareto_k < HEAVY)
    density = sound & (judged.density < WITHIN)
    moments = sound & (judged.moments < WITHIN) & (len(pool.rounds) > 1)
    of = np.where(density, 1, np.where(moments, 2, 0))
    within = np.where(density, judged.density, judged.moments)
    count = np.full(of.shape, pool.count)
    no = np.full(of.shape, False)
    rest = judged.effective, judged.pareto_k, no, no, judged.unlikely
    laws = judged.laws
    lost = np.flatnonzero(~usable)
    if lost.size:  # estimates of no use leave the modes as they are
        laws = laws.put(lost, pool.rounds[0].laws.of(lost))
    return Answer(laws, judged.log_evidence, within, of, sound, usable, count, *rest)
