"""Starts of which some or all components are known, linearised in machine code by sigma points."""

from functools import partial

import numpy as np
import pytest
from crossed import crossed
from robots import LANDMARKS, P0, SENSORS, drive_cpd, m, moves, network, sighted, u, x
from test_called_back import branching
from test_compiled import assert_posterior, both
from textbooks import assert_beliefs, assert_log, run_filter, run_smoother, unscented
from zoo import SPREADS, STARTS, plain, recording

import pgm
from pgm.beliefs.moments.compiled import sweep

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")

SIGHT, UNSCENTED = SENSORS["range_bearing"], pgm.Unscented()


def known(*components, spread=P0):
    """A prior that knows some components."""
    cov = np.array(spread)
    cov[..., components, :] = cov[..., :, components] = 0.0
    return cov


def start(*components):
    return pgm.GaussianCPD(x, np.zeros(3), known(*components))


def assert_compiled(infer, model, evidence, **options):
    found, due = both(infer, model, evidence, **options)
    assert_posterior(found, due)
    assert found.status.compilation == "compiled"


@crossed(("components", "runs"), [(0, 1, 2), (0, 2), (1,)], [None, 9])
def test_against_the_textbook(components, runs):
    """Its unscented filter needs no inverse of a covariance."""
    evidence = sighted(runs)
    evidence[SIGHT.z] = pgm.sightings(  # at step 0 too
        np.concatenate([evidence[SIGHT.z].values[..., :1, :], evidence[SIGHT.z].values], axis=-2),
        step=np.append(0, evidence[SIGHT.z].step),
        given={m: np.vstack([LANDMARKS[0], evidence[SIGHT.z].given[m]])},
    )
    read = evidence[SIGHT.z]
    model = network(SIGHT.cpd(), prior=start(*components))
    found = pgm.smooth(model, evidence, lineariser=UNSCENTED, compiled=True)
    assert found.status.compilation == "compiled"
    for run in [()] if runs is None else range(runs):
        by_step = dict(
            zip(read.step, zip(read.values[run], read.given[m], strict=True), strict=True)
        )
        rows = [SIGHT.seen(*by_step[k]) if k in by_step else None for k in range(13)]
        due = run_filter(unscented, np.zeros(3), known(*components), moves(evidence[u]), rows)
        assert_beliefs(found.filtered[x].run(run) if runs else found.filtered[x], due.filtered)
        assert_beliefs(found[x].run(run) if runs else found[x], run_smoother(due))
        assert_log(found.log_evidence[run], due.log_evidence)


@pytest.mark.parametrize("rule", [pgm.Cubature(), pgm.GaussHermite(3), pgm.Unscented(0.5)])
def test_other_rules(rule):
    model = network(SIGHT.cpd(), prior=start(0, 2))
    assert_compiled(pgm.smooth, model, sighted(9), lineariser=rule)


@crossed(("infer", "runs"), [pgm.filter, pgm.smooth], [None, 9])
def test_iterations(infer, runs):
    options = {"iterations": 3, "tolerance": 0.0, "lineariser": UNSCENTED}
    assert_compiled(infer, network(SIGHT.cpd(), prior=start(1)), sighted(runs), **options)


def test_a_lag():
    def infer(model, evidence, compiled):
        graph = pgm.compile(model, 12, compiled=compiled)
        return pgm.infer(graph, evidence, schedule=pgm.FixedLag(3), lineariser=UNSCENTED)

    assert_compiled(infer, network(SIGHT.cpd(), prior=start(0, 1, 2)), sighted(9))


def test_runs_that_know_other_components():
    spreads = np.array(SPREADS)
    spreads[0], spreads[2] = known(0, spread=SPREADS[0]), known(0, 1, 2, spread=SPREADS[2])
    which = np.arange(9) % 3
    model = network(SIGHT.cpd(), prior=pgm.GaussianCPD(x, STARTS[which], spreads[which]))
    assert_compiled(pgm.smooth, model, sighted(9), lineariser=UNSCENTED)


def test_sightings_in_groups():
    model = plain(sensor=SIGHT.cpd(grouped=True), prior=start(0, 2))
    assert_compiled(pgm.smooth, model, recording("grouped"), lineariser=UNSCENTED)


def test_a_function_that_is_called():
    motion = drive_cpd(function=branching, jacobian=None)
    model = network(SIGHT.cpd(), transition=motion, prior=start(0, 1, 2))
    found, due = both(pgm.filter, model, sighted(), lineariser=UNSCENTED)
    assert_posterior(found, due, smooth=False)
    assert "singular" not in found.status.compilation


@pytest.mark.parametrize("runs", [None, 9])
def test_in_loops(runs, monkeypatch):
    monkeypatch.setattr(sweep.sweeps, "made", partial(sweep.sweeps.made, loops=True))
    model = network(SIGHT.cpd(), prior=start(0, 2))
    assert_compiled(pgm.filter, model, sighted(runs), lineariser=UNSCENTED)


def test_a_start_on_a_slope_is_left_to_numpy():
    """Known along a direction that is no axis."""
    along = np.array([1.0, 1.0, 0.0])
    model = network(SIGHT.cpd(), prior=pgm.GaussianCPD(x, np.zeros(3), np.outer(along, along)))
    found, due = both(pgm.filter, model, sighted(9), lineariser=UNSCENTED)
    assert_posterior(found, due, smooth=False)
    assert "a covariance is singular" in found.status.compilation
