"""Sweeps of packs of eight runs against the general kernels."""

import numpy as np
import pytest
from crossed import combinations, crossed, slow_after
from robots import SENSORS, network, sighted, u, x
from test_compiled import assert_posterior, both
from zoo import MODELS, RULES, model_of, of_run, recording

import pgm
from pgm.beliefs.moments.passes import forward

# Two packs, of which the last shares runs with the first; neighbours differ.
WHICH = np.arange(11) % 3


OTHER_RULES = [rule for rule in RULES if rule not in ("taylor", "unscented")]


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        # the rules in turn otherwise than where runs are few
        *combinations(list(MODELS), ["unscented", "taylor"]),
        *slow_after(0, [("everything", rule) for rule in OTHER_RULES]),
    ],
)
def test_runs_of_all_kinds(name, rule):
    model, evidence = model_of(name, WHICH), of_run(recording(name), WHICH)
    found = both(pgm.smooth, model, evidence, lineariser=RULES[rule])
    assert_posterior(*found)


@crossed(
    ("name", "options"),
    ["plain", "everything"],
    [{}, {"damping": 0.3}, {"lineariser": pgm.Unscented()}],
)
def test_runs_of_a_pack_settle_by_themselves(name, options):
    model, evidence = model_of(name, WHICH), of_run(recording(name), WHICH)
    found = both(pgm.filter, model, evidence, iterations=20, tolerance=1e-3, **options)
    assert_posterior(*found, smooth=False)


def test_a_run_is_left_without_the_others_of_its_pack(monkeypatch):
    """Its covariance has no root from which points could be drawn."""
    stepwise, left = forward._stepwise, []

    def watched(plan, *arguments, **options):
        left.append(plan.runs)
        return stepwise(plan, *arguments, **options)

    monkeypatch.setattr(forward, "_stepwise", watched)

    def moved(state, command):
        return np.where(command[..., :1] > 5.0, state[..., :1], state + np.sin(command[..., :1]))

    def noise(command):
        return np.where(command[..., :1, None] > 5.0, 1e-18, 1e-2) * np.eye(3)

    drive = pgm.NonlinearGaussianCPD(x, (x.previous, u), moved, pgm.noise(noise, given=u))
    model = network(SENSORS["range_bearing"].cpd(), transition=drive)
    evidence = dict(sighted(11))
    evidence[u] = np.tile(evidence[u], (11, 1, 1))
    evidence[u][4] += 10.0
    assert_posterior(*both(pgm.filter, model, evidence, lineariser=pgm.Unscented()), smooth=False)
    assert left[0] == 1


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_the_run_that_fails_is_named():
    def moved(state, command):
        return state + np.sqrt(1.0 - command[..., :1])

    drive = pgm.NonlinearGaussianCPD(x, (x.previous, u), moved, np.eye(3))
    model = network(SENSORS["range_bearing"].cpd(), transition=drive)
    evidence = dict(sighted(11))
    evidence[u] = np.tile(np.minimum(evidence[u], 0.5), (11, 1, 1))
    evidence[u][6, 3, 0] = 2.0
    told = []
    for choice in (True, False):
        with pytest.raises(pgm.PgmError, match="run 6") as refusal:
            pgm.filter(model, evidence, compiled=choice)
        told.append((type(refusal.value), str(refusal.value)))
    assert told[0] == told[1]
