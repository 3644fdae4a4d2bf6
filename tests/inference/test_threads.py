"""Threads share the runs, and change no result."""

import threading

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from robots import LANDMARKS, SENSORS, controls, drive_along, drive_cpd, m, network, u, x

import pgm
from pgm.inference.chain import parts

RUNS, T = 23, 8
SIGHT = SENSORS["range_bearing"]
z = SIGHT.z


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    """Make parts of five runs, and a last one of three."""
    monkeypatch.setattr(parts, "MOST", 5)


def recording(command=u):
    rng = np.random.default_rng(5)
    commands = controls(rng, T)
    states = drive_along(commands, rng)
    step = np.array([0, 2, 2, 3, 5, 8])
    marks = LANDMARKS[[0, 1, 2, 0, 1, 2]]
    read = SIGHT.draw(np.broadcast_to(states[step], (RUNS, 6, 3)), marks, rng)
    read[:, 1][rng.random(RUNS) < 0.3] = np.nan
    own = commands + 0.01 * rng.normal(size=(RUNS, T, 2))
    return {command: own, z: pgm.sightings(read, step=step, given={m: marks})}


def same(one, other):
    for part in ("predicted", "filtered"):
        assert_allclose(getattr(one, part)[x].mean, getattr(other, part)[x].mean, atol=1e-11)
    assert_allclose(one[x].mean, other[x].mean, atol=1e-11)
    assert_allclose(one[x].cov, other[x].cov, atol=1e-12)
    assert_allclose(one.log_evidence, other.log_evidence, atol=1e-11)
    assert one.log_evidence_kind == other.log_evidence_kind
    assert one.status.iterations == other.status.iterations
    assert_array_equal(one.status.converged, other.status.converged)
    for name in ("residual", "cov", "step", "nis", "dof"):
        ours, theirs = (getattr(each.innovations[z], name) for each in (one, other))
        assert_allclose(ours, theirs, rtol=1e-8, atol=1e-11)
    ours, theirs = one.joint(x.at(7), x.at(2)), other.joint(x.at(7), x.at(2))
    assert_allclose(ours.mean, theirs.mean, atol=1e-11)
    assert_allclose(ours.cov, theirs.cov, atol=1e-12)
    for ask in (
        lambda each: each.message(3, 4),
        lambda each: each.belief(5),
        lambda each: each.message(4, 3),
    ):
        try:
            theirs = ask(other)
        except pgm.GraphError:  # a filter has sent none backward
            with pytest.raises(pgm.GraphError, match="was not sent"):
                ask(one)
            continue
        ours = ask(one)
        for name in ("K", "h", "g"):
            assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-6, atol=1e-6)
    assert_allclose(
        pgm.audit(one, samples=20, rng=1).log_evidence,
        pgm.audit(other, samples=20, rng=1).log_evidence,
        atol=1e-7,
    )


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented(), pgm.MonteCarlo(40)])
@pytest.mark.parametrize("threads", [2, 7])
@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth])
def test_threads_change_nothing(run, threads, rule):
    model, evidence = network(SIGHT.cpd()), recording()
    whole = run(model, evidence, lineariser=rule)
    same(run(model, evidence, lineariser=rule, threads=threads), whole)
    kept = run(model, evidence, lineariser=rule, threads=threads, keep=[x])
    assert_array_equal(kept[x].mean, run(model, evidence, lineariser=rule, keep=[x])[x].mean)


def test_iterations_hidden_controls_and_grouped_sightings():
    command = pgm.Variable("command", components=u.components)
    model = network(SIGHT.cpd(grouped=True)).replace(
        transition=[pgm.LinearGaussianCPD(u, {command: 1.0}, cov=0.01 * np.eye(2)), drive_cpd()]
    )
    evidence = recording(command)
    asked = {"iterations": 3, "lineariser": pgm.Unscented()}
    whole = pgm.smooth(model, evidence, **asked)
    shared = pgm.smooth(model, evidence, **asked, threads=3)
    same(shared, whole)
    assert_allclose(shared[u].cov, whole[u].cov, atol=1e-12)


def test_the_threads_are_there(monkeypatch):
    """Two parts wait for each other, which one thread alone could not bear."""
    monkeypatch.setattr(parts, "MOST", 12)
    meet, seen = threading.Barrier(2, timeout=20), set()

    def function(x, m):
        if threading.get_ident() not in seen and x.shape[-2] in (11, 12):
            seen.add(threading.get_ident())
            meet.wait()
        return SIGHT.function(x, m)

    pgm.filter(network(SIGHT.cpd(function=function)), recording(), threads=2)
    assert len(seen) == 2
    assert threading.get_ident() not in seen


def test_a_single_run_is_no_work_for_threads():
    model, evidence = network(SIGHT.cpd()), recording()
    read = evidence[z].values[0]
    seen = pgm.sightings(read, step=evidence[z].step, given=evidence[z].given)
    one = {u: evidence[u][0], z: seen}
    whole = pgm.smooth(model, one)
    assert_array_equal(pgm.smooth(model, one, threads=4)[x].mean, whole[x].mean)


def test_infer_takes_threads():
    model, evidence = network(SIGHT.cpd()), recording()
    graph = pgm.compile(model, steps=T)
    same(pgm.infer(graph, evidence, threads=2), pgm.infer(graph, evidence))
    assert isinstance(pgm.infer(graph, evidence, keep=[x]), pgm.KeptPosterior)


@pytest.mark.parametrize("threads", [0, -1, 1.0, True, "2", None])
def test_threads_that_are_refused(threads):
    with pytest.raises(pgm.ModelError, match="threads must be a whole number, 1 or more"):
        pgm.filter(network(SIGHT.cpd()), recording(), threads=threads)


def test_networks_without_time_take_none():
    a, b = pgm.variables("a b")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, 1.0), pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0)]
    )
    with pytest.raises(pgm.GraphError, match="threads= are for the runs of dynamic networks"):
        pgm.infer(pgm.compile(net), {b: 1.0}, threads=2)
