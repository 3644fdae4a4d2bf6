"""The Gaussian beliefs of a part in all configurations, and the log-evidence of each.

A configuration that the evidence contradicts has a log-evidence of −∞. Where a configuration makes
some of the evidence certain that another gives a density, the two are no numbers of one kind: a
point mass outweighs every density. So each configuration is also told how many dimensions of the
evidence it makes certain.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pgm.beliefs.gaussian.outcome import GaussianOutcome
from pgm.beliefs.gaussian.refusals import Contradiction
from pgm.beliefs.gaussian.run import run
from pgm.beliefs.mixed.configurations import Cases, is_noisy
from pgm.beliefs.mixed.parts import Part
from pgm.compile.methods import JunctionTree
from pgm.cpds import CPD, AffineCPD, ConditionalGaussian, Noise
from pgm.cpds.conditional import evaluate
from pgm.errors import GraphError, NumericalError
from pgm.factors.scope import listed
from pgm.kernels import roots
from pgm.kernels.arrays import Array, Integers, independent, variances
from pgm.linearisers import Lineariser
from pgm.networks import BayesianNetwork
from pgm.resources import require_memory
from pgm.schedules.schedule import Schedule
from pgm.variables import Variable

# A direction of the evidence is certain if its deviation is this share of its components'.
CERTAIN = 1e-13
TREE = JunctionTree()


@dataclass(frozen=True)
class Asked:
    """The evidence of continuous variables, and the options of a call.

    Attributes
    ----------
    values : mapping of Variable to ndarray
        (runs or 1, d), NaN where a component is missing.
    start : mapping of Variable to ndarray
        (runs or 1, d): means of hidden variables to begin at.
    lead : tuple of int
        The user's axes of runs, which are flattened to one.
    lineariser, schedule
        As of `infer`.
    """

    values: Mapping[Variable, Array]
    start: Mapping[Variable, Array] | None
    lead: tuple[int, ...]
    lineariser: Lineariser
    schedule: Schedule | None

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return math.prod(self.lead)


@dataclass(frozen=True, eq=False)
class Weighed:
    """A part solved in its configurations.

    Attributes
    ----------
    part : Part
    configurations : ndarray
        (configurations, discrete parents), indices of states.
    log : ndarray
        The log-evidence, (configurations, runs); −∞ where the evidence contradicts one.
    certain : ndarray
        How many dimensions of the evidence a configuration makes certain, (configurations, runs).
    beliefs : sequence of triples
        Numbers of configurations, numbers of runs, and the beliefs of all pairs of them, the runs
        of one configuration after those of another.
    """

    part: Part
    configurations: Integers
    log: Array
    certain: Integers
    beliefs: Sequence[tuple[Integers, Integers, GaussianOutcome]]

    def moments(self, scope: Sequence[Variable]) -> tuple[Array, Array]:
        """The means (configurations, runs, n), and covariances, of hidden variables.

        They are those of N(0, I) where the evidence contradicts a configuration.
        """
        size = sum(v.dimension for v in scope)
        means = np.zeros((*self.log.shape, size))
        covs = np.tile(np.eye(size), (*self.log.shape, 1, 1))
        for which, runs, belief in self.beliefs:
            found = belief[scope[0]] if len(scope) == 1 else belief.joint(*scope)
            shape, at = (which.size, runs.size), np.ix_(which, runs)
            count = math.prod(shape)
            means[at] = np.broadcast_to(found.mean, (count, size)).reshape(*shape, size)
            covs[at] = np.broadcast_to(found.cov, (count, size, size)).reshape(*shape, size, size)
        return means, covs


def weighed(part: Part, configurations: Integers, asked: Asked) -> Weighed:
    """The beliefs and the log-evidence of a part in its possible configurations."""
    size = sum(v.dimension for v in part.hidden)
    require_memory(
        8 * len(configurations) * asked.runs * (size + len(part.cpds)) * max(size, 1),
        f"the beliefs of {len(configurations):,} configurations of ({listed(part.boundary)}) in "
        f"{asked.runs:,} runs",
        "give fewer runs at a time, or evidence that leaves fewer configurations",
        error=GraphError,
    )
    cases = Cases(part, configurations)
    if not part.hidden and cases.proper:
        log = _likelihoods(cases, asked)
        return Weighed(part, configurations, log, _certain(part, cases, asked, log), ())
    log = np.full((len(configurations), asked.runs), -np.inf)
    beliefs: list[tuple[Integers, Integers, GaussianOutcome]] = []
    waiting = [(which, np.arange(asked.runs)) for which in cases.alike(asked.runs)]
    while waiting:
        which, runs = waiting.pop()
        try:
            found = _solved(cases, which, runs, asked)
        except Contradiction as error:
            if which.size > 1:  # of noise that a function makes zero, which is known but now
                waiting += [(own, runs) for own in which[:, None]]
                continue
            left = runs[~np.broadcast_to(error.lost, runs.shape)]
            if left.size:
                waiting.append((which, left))
            continue
        except NumericalError as error:
            raise _placed(error, cases, which, runs, asked) from None
        shape = which.size, runs.size
        value = np.broadcast_to(found.log_evidence.ravel(), (math.prod(shape),))
        log[np.ix_(which, runs)] = value.reshape(shape)
        beliefs.append((which, runs, found))
    _require_possible(part, log, asked)
    return Weighed(part, configurations, log, _certain(part, cases, asked, log), beliefs)


def _likelihoods(cases: Cases, asked: Asked) -> Array:
    """The log-densities of a part without hidden variables, (configurations, runs).

    No tree is solved for them: a long hidden Markov model has a part for each reading.
    """
    part, configurations = cases.part, cases.configurations
    states = {v: configurations[:, [k]] for k, v in enumerate(part.boundary)}
    log = np.zeros((len(configurations), asked.runs))
    for cpd in cases.cpds(np.zeros(1, dtype=np.intp), asked.lead, switched=False):
        known = {v: states[v] if v in states else asked.values[v] for v in cpd.parents}
        log += cpd.log_density(asked.values[cpd.child], known)
    _require_possible(part, log, asked)
    return log


def _require_possible(part: Part, log: Array, asked: Asked) -> None:
    """Refuse evidence that contradicts each configuration of a part, in some runs.

    `log` (configurations, runs) are the log-densities of the evidence.
    """
    lost = ~np.asarray(np.isfinite(log).any(axis=0))
    if not lost.any():
        return
    run = int(lost.argmax())
    error = Contradiction(
        f"evidence contradicts an exact model: {list(part.cpds)} determine a value that is not "
        f"the evidence's{f' in run {run}' if asked.lead else ''}, whatever the discrete variables "
        "are; give one of them some noise",
        run=run if asked.lead else None,
    )
    error.lost = lost
    raise error


def _solved(cases: Cases, which: Integers, runs: Integers, asked: Asked) -> GaussianOutcome:
    """The beliefs of a part in some configurations of one group, times some runs, as runs."""
    cpds = cases.cpds(which, asked.lead, runs)
    scope = {v for cpd in cpds for v in cpd.scope}

    def repeated(values: Mapping[Variable, Array]) -> dict[Variable, Array]:
        found = {}
        for variable, value in values.items():
            if variable in scope:
                alone = len(value) == 1
                found[variable] = value[0] if alone else np.tile(value[runs], (which.size, 1))
        return found

    start = None if asked.start is None else repeated(asked.start)
    graph = TREE(BayesianNetwork(cpds))
    options = asked.schedule, asked.lineariser, start
    return run(graph, repeated(asked.values), *options, warn=False)


def _placed(
    error: NumericalError, cases: Cases, which: Integers, runs: Integers, asked: Asked
) -> NumericalError:
    """The error of one of some configurations that have no beliefs together, with its states."""
    part = cases.part
    if not part.boundary:
        return error
    found = error
    while which.size > 1:
        half = which.size // 2
        try:
            _solved(cases, which[:half], runs, asked)
        except NumericalError as own:
            found, which = own, which[:half]
        else:
            which = which[half:]
    try:
        _solved(cases, which, runs, asked)
    except NumericalError as own:
        found = own
    else:  # it fails beside others alone
        return error
    states = zip(part.boundary, cases.configurations[which[0]].tolist(), strict=True)
    where = ", ".join(f"{variable!r} is {variable.states[k]}" for variable, k in states)
    found.args = (
        f"where {where}, which the tables and some run's evidence leave possible: {found}",
    )
    return found


def _certain(part: Part, cases: Cases, asked: Asked, log: Array) -> Integers:
    """How many components of the evidence each configuration makes certain, (.., runs).

    Evidence that repeats other evidence exactly, which has no density of its own, is refused where
    there are several configurations to be weighed by it, as `log` tells.
    """
    count = len(cases.configurations)
    found = np.zeros((count, asked.runs), dtype=np.intp)
    seen = [cpd.child for cpd in part.cpds if cpd.child in asked.values]
    if not part.boundary or not seen:
        return found
    for case in cases.every:
        _require_noise(case, asked)
    if not cases.exact:
        return found
    taken = np.concatenate(
        [np.broadcast_to(~np.isnan(asked.values[v]), (asked.runs, v.dimension)) for v in seen],
        axis=1,
    )
    patterns, pattern = np.unique(taken, axis=0, return_inverse=True)
    for cpd in part.cpds:
        _require_alike(cpd)
    repeats = np.zeros(found.shape, dtype=bool)
    for k in range(count):
        spread = _spread(cases.cpds(np.array([k]), asked.lead, np.zeros(1, dtype=np.intp)), seen)
        lost = np.array([_lost(spread[own]) for own in patterns]).reshape(-1, 2)[pattern.ravel()]
        found[k], repeats[k] = lost[:, 0], lost[:, 1] > 0
    several = np.isfinite(log) & (np.isfinite(log).sum(axis=0) > 1)
    if (repeats & several).any():
        sources = [cpd for cpd in part.cpds if cpd.child in asked.values]
        named = [cpd.child if cpd._of is None else cpd for cpd in sources]
        raise NumericalError(
            f"evidence for {named} repeats itself exactly, by CPDs without noise, where "
            f"states of ({listed(part.boundary)}) are weighed by its density, of which there is "
            "none; leave out what repeats, or give it some noise",
            variable=seen[0],
            cpd=sources[0],
        )
    return found


def _require_noise(case: CPD, asked: Asked) -> None:
    """Refuse a noise that is a function of inputs and zero in some direction at some of these."""
    if not isinstance(case, ConditionalGaussian) or not isinstance(case.cov, Noise):
        return
    known = {v: asked.values[v] for v in case.cov.given}
    noise = evaluate(case, known, (asked.runs,), None)
    if roots.determined(roots.root(noise)).any():
        raise NumericalError(
            f"{case!r} has a noise that is zero in some direction, where states are weighed by "
            "densities, which a value that is certain outweighs; let its function return some "
            "noise, or give the case a covariance of numbers",
            variable=case.child,
            cpd=case,
        )


def _require_alike(cpd: CPD) -> None:
    """Refuse a prior that has no noise in some direction in some runs, and noise in others."""
    if not cpd._lead() or not isinstance(cpd, ConditionalGaussian):
        return
    cov = np.asarray(cpd.cov)
    fixed = roots.determined(roots.root(independent(cov, np.isfinite(variances(cov)))))
    if (fixed != fixed.reshape(-1, fixed.shape[-1])[0]).any():
        raise NumericalError(
            f"{cpd!r} has no noise in some direction in some runs, and noise in others, where a "
            "value that is certain outweighs a density; give these runs to calls of their own",
            variable=cpd.child,
        )


def _spread(cpds: Sequence[CPD], seen: Sequence[Variable]) -> Array:
    """Rows A of some variables over the sources of noise, of the rank of their covariance."""
    blocks: dict[Variable, Array] = {}
    width, column = sum(cpd.child.dimension for cpd in cpds), 0
    parents = {v for cpd in cpds for v in cpd.parents}
    for cpd in cpds:
        if cpd.child not in parents and is_noisy(cpd):  # by noise that no other variable has
            blocks[cpd.child] = np.eye(cpd.child.dimension, width, column)
            column += cpd.child.dimension
            continue
        if not isinstance(cpd, AffineCPD) or not isinstance(cpd.cov, np.ndarray):
            raise NumericalError(
                f"{cpd!r} stands beside CPDs without noise, among which discrete variables choose; "
                "how a value that is certain weighs against a density is known where all on which "
                "others depend are linear: give each some noise",
                variable=cpd.child,
            )
        size = cpd.child.dimension
        rows = np.zeros((size, width))
        cov = cpd.cov.reshape(-1, size, size)[0]
        flat = ~np.isfinite(np.diagonal(cov))
        # Columns of any length have the same rank.
        root = roots.root(independent(cov, ~flat))
        length = np.sqrt((root * root).sum(axis=0))
        rows[:, column : column + size] = root / np.where(length > 0.0, length, 1.0)
        for parent in cpd.given:
            if parent in blocks:
                rows += cpd.matrices[parent].reshape(-1, size, parent.dimension)[0] @ blocks[parent]
        blocks[cpd.child] = rows
        column += size
    return np.concatenate([blocks[v] for v in seen])


def _lost(rows: Array) -> tuple[int, int]:
    """How many rows are zero, and how many more there are than their rank."""
    length = np.sqrt((rows * rows).sum(axis=1))
    some = length > 0.0
    values = np.linalg.svd(rows[some] / length[some, None], compute_uv=False)
    return int((~some).sum()), int(some.sum() - (values > CERTAIN).sum())
