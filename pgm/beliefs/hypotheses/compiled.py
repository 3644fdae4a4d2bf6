"""Filters of mixtures in machine code: all pairs of all steps in one call.

It is for affine CPDs, of which a Gaussian is kept for each memory; what it leaves to the passes by
NumPy, the account of the plan tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pgm.beliefs.hypotheses.cases import seen
from pgm.beliefs.hypotheses.chain import HypothesisChain
from pgm.beliefs.hypotheses.records import Pairs, Swept
from pgm.beliefs.moments.compiled import sweep
from pgm.beliefs.moments.compiled.groups import groups_of
from pgm.beliefs.moments.compiled.named_table import NamedTable
from pgm.beliefs.moments.compiled.table import Record
from pgm.beliefs.moments.compiled.uncompiled import Uncompiled, unknown
from pgm.beliefs.moments.steps.plan import ChainPlan
from pgm.compile import compile
from pgm.compile.machine import Choice
from pgm.cpds import AffineCPD
from pgm.kernels.arrays import Array, address, components_last
from pgm.kernels.machine.sweeps import chain as sweeps
from pgm.kernels.machine.sweeps import told

# The most numbers of evidence that are repeated for the hypotheses, and the most regimes.
_EVIDENCE, _REGIMES = 2**24, 32
# A step of the passes by NumPy takes so many times that of a filter of one Gaussian.
_TIMES = 6


def forward(chain: HypothesisChain, choice: Choice) -> tuple[Swept | None, str]:
    """The filter in machine code, None where it is left to NumPy; and the account, in words.

    `choice` is what was asked of machine code.
    """
    if choice is False:
        return None, ""
    other = _other(chain)
    if other is not None:
        return None, "" if choice is None else f"not compiled: {other}"
    plan = _plan(chain, choice)
    runs = chain.runs
    if not sweep.is_used(plan, _TIMES):
        return None, plan.account.words(runs)
    try:
        found = _swept(chain, plan)
    except Uncompiled as error:
        plan.account.leave(str(error))
        return None, plan.account.words(runs)
    if found is None:
        plan.account.leave(sweep.FAR)
        return None, plan.account.words(runs)
    plan.account.compiled += 1
    return found, plan.account.words(runs)


def _other(chain: HypothesisChain) -> str | None:
    """Why a chain is of a kind that is left to NumPy, in words; None if it is of no such kind."""
    settings, regimes, roles = chain.settings, chain.regimes, chain.roles
    evidence = [each.values for each in roles.readings]
    evidence += [values for inputs in roles.inputs for values in inputs.values()]
    repeated = sum(each.size for each in evidence if each.shape[1] > 1)
    curved = next((case for case in roles.cases if not isinstance(case, AffineCPD)), None)
    if settings.back:
        return "machine code filters mixtures, and these are smoothed"
    if settings.prune or settings.pieces > 1 or settings.count != regimes.memories:
        return (
            "machine code keeps one Gaussian for each joint state of the remembered variables, "
            f"{regimes.memories}, and others were asked for"
        )
    if roles.open:
        return f"{roles.open[0].cpd!r} has open sightings, or several components"
    if curved is not None:
        return f"{curved!r} is not affine"
    if roles.robust is not None:
        return f"{roles.robust!r} has robust noise"
    if chain.angles.size:
        return "some component is an angle"
    if chain.by_memory:
        return "motions are chosen by states of the step before"
    if any(len(choices.alike) != 1 for choices in chain.choices):
        return (
            "cases differ in more than their numbers: in their parents, functions of noise, or "
            "arrays by step"
        )
    if regimes.size > _REGIMES:
        return f"there are {regimes.size} joint states, and machine code takes {_REGIMES}"
    if repeated * regimes.memories * regimes.size > _EVIDENCE:
        return "the evidence, repeated for all hypotheses, is too large"
    return None


def _plan(chain: HypothesisChain, choice: Choice) -> ChainPlan:
    """The plan of all pairs of a step, as runs: of Gaussian k and regime s those of the user."""
    given, regimes, roles = chain.given, chain.regimes, chain.roles
    copies = 1 if chain.settings.mix else regimes.memories
    moving, seeing = chain.choices
    cpds = moving.at(moving.of[0], copies, given.bound.lead)
    sensors = seeing.at(seeing.of, copies, given.bound.lead)
    inputs = [seen(cpd, each) for cpd, each in zip(cpds, roles.inputs, strict=True)]
    readings = [
        replace(reading, cpd=cpd, inputs=seen(cpd, reading.inputs))
        for cpd, reading in zip(sensors, roles.readings, strict=True)
    ]
    network = given.network(transition=cpds, observation=sensors)
    graph = compile(network, given.bound.steps, compiled=choice)
    bound = replace(given.bound, transition=tuple(inputs), readings=tuple(readings), form=None)
    own = bound.repeated(copies * regimes.size)
    return ChainPlan.make(graph, replace(own, lead=(own.runs,)), given.lineariser, prior=False)


def _swept(chain: HypothesisChain, plan: ChainPlan) -> Swept | None:
    """The sweep; None where it is not sure to be right."""
    why = unknown(plan)
    if why is not None:
        raise Uncompiled(why)
    groups = groups_of(plan, None, stored=False, controlled=False)
    regimes, runs, size = chain.regimes, chain.runs, chain.size
    steps, count, kept = plan.steps, regimes.size, regimes.memories
    begin = chain.start()
    assert isinstance(begin, Pairs)
    hypotheses = plan.runs
    record: Record = {
        **dict(zip(sweep.BEGIN, _room(1, hypotheses, size), strict=True)),
        **dict(zip(sweep.KNOWN, _room(1, hypotheses, size), strict=False)),
        "density": np.zeros((1, hypotheses)),
    }
    first = count * runs  # the pairs of step 0: one Gaussian in each regime
    mean, cov = components_last(begin.mean, 1), components_last(begin.cov, 2)
    record[sweep.BEGIN[0]][0, :first] = mean.reshape(first, size)
    record[sweep.BEGIN[1]][0, :first] = cov.reshape(first, size, size)
    links = (link.family for link in plan.transition)
    owners = *links, *(sensor.family for sensor in plan.read), *plan.read, record, *groups
    table = NamedTable(plan, 1, owners, record)
    cpds = {"stored": False, "keep": False, "controlled": False}
    ahead = sweep.told_ahead(plan, table, groups, **cpds, gate=None)
    own = *_room(steps + 1, kept * runs, size), np.zeros((steps + 1, kept * runs))
    shares, density = np.zeros((steps + 1, count * runs)), np.zeros((steps + 1, runs))
    mixture = told.Mixture(
        ahead=ahead,
        own_runs=table.count(runs),
        memories=tuple(regimes.memory.tolist()),
        mixed=chain.settings.mix,
        onward=table.array(_onward(chain, steps)),
        likelihood=table.array(_likelihood(chain, steps, begin.logs[0])),
        pairs=table.array(np.zeros((1, hypotheses))),
        mean=table.array(own[0]),
        cov=table.array(own[1]),
        logs=table.array(own[2]),
        regimes=table.array(shares),
        density=table.array(density),
    )
    ended, numbers = np.zeros((sweeps.TOLD, hypotheses)), table.whole
    numbers[told.ENDED] = address(ended)
    sweeps.made(mixture, 1)(address(numbers), 0, runs)
    if ended[sweeps.LEFT, :runs].any():
        return None
    lead = steps + 1, kept, runs
    return Swept(
        own[2].reshape(lead),
        own[0].reshape(*lead, size),
        own[1].reshape(*lead, size, size),
        shares.reshape(steps + 1, count, runs),
        density,
    )


def _room(rows: int, hypotheses: int, size: int) -> tuple[Array, Array]:
    """Arrays for means and covariances."""
    return np.zeros((rows, hypotheses, size)), np.zeros((rows, hypotheses, size, size))


def _onward(chain: HypothesisChain, steps: int) -> Array:
    """Ln p(regime | memory before it), (T or 1, runs or 1, memories · regimes)."""
    regimes = chain.regimes
    some = range(1, 1 + (min(steps, 1) if regimes.is_constant else steps))
    found = [regimes.onward(step) for step in some]
    if not found:
        return np.zeros((1, 1, regimes.memories * regimes.size))
    return _by_run([each.reshape(-1, each.shape[-1]) for each in found])


def _likelihood(chain: HypothesisChain, steps: int, prior: Array) -> Array:
    """Ln p(discrete measurements | regime) of each step, at step 0 with the prior's."""
    regimes = chain.regimes
    none = np.zeros((regimes.size, 1))
    found = [regimes.likelihood(step) for step in range(steps + 1)]
    whole = [none if each is None else each for each in found]
    return _by_run([whole[0] + prior, *whole[1:]])


def _by_run(rows: Sequence[Array]) -> Array:
    """Numbers (own, runs or 1) by step as (steps, runs or 1, own)."""
    runs = max(each.shape[-1] for each in rows)
    whole = [np.broadcast_to(each, (len(each), runs)).T for each in rows]
    return np.ascontiguousarray(np.stack(whole))
