"""Results say which readings they know, and that they were not iterated."""

import math
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from dense import unrolled
from numpy.testing import assert_allclose

import pgm
from pgm.beliefs.moments.passes.backward import Beliefs

T, LAG = 5, 2
place, fix, shift = pgm.variables("place fix shift")
linear = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(place, 1.0, 2.0)],
    transition=[pgm.LinearGaussianCPD(place, given={place.previous: 0.9}, cov=0.5)],
    observation=[pgm.LinearGaussianCPD(fix, given={place: 1.0}, cov=0.3)],
)
bent = linear.replace(
    observation=[
        pgm.NonlinearGaussianCPD(fix, given=(place,), function=lambda x: x + 0.05 * x**3, cov=0.3)
    ]
)
moved = linear.replace(
    transition=[
        pgm.NonlinearGaussianCPD(
            place, given=(place.previous,), function=lambda x: np.sin(x), cov=0.5
        )
    ]
)
VALUES = np.random.default_rng(3).normal(size=(T + 1, 1))
EVIDENCE = {fix: pgm.sightings(VALUES, step=np.arange(T + 1))}
filtered, smoothed = partial(pgm.filter, steps=T), partial(pgm.smooth, steps=T)


def title(value):
    """The first line of a value as it is printed."""
    return repr(value).splitlines()[0]


def dense(*steps, until):
    """Mean, covariance and ln p of some places given the readings up to a step, from the joint."""
    joint = unrolled(linear, T, sightings=[(fix, step, {}) for step in range(T + 1)])
    after, log_density = joint.given({(fix, step): VALUES[step] for step in range(until + 1)})
    return *after.marginal(*(place.at(step) for step in steps)), log_density


def fixed_lag(method=None):
    """A result of a lag, made of dense beliefs."""
    graph = pgm.compile(linear, T) if method is None else pgm.compile(linear, T, method=method)
    ahead = pgm.infer(graph, EVIDENCE, schedule=pgm.Filtering())
    found = [dense(step, until=min(step + LAG, T)) for step in range(T + 1)]
    mean, cov = (np.array([each[k] for each in found])[:, None] for k in (0, 1))
    return pgm.results.Posterior(
        replace(ahead._outcome, kind=pgm.Kind(LAG), _smoothed=Beliefs(mean, cov))
    )


def test_a_kind_is_a_value_with_a_name():
    kinds = [pgm.Kind(lag) for lag in (-1, 0, 1, 5, math.inf)]
    assert [str(kind) for kind in kinds] == [
        "predicted",
        "filtered",
        "fixed-lag (1)",
        "fixed-lag (5)",
        "smoothed",
    ]
    assert kinds[3].name == "fixed-lag"
    assert [kind.last(3, 6) for kind in kinds] == [2, 3, 4, 6, 6]
    assert len({*kinds, *pickle.loads(pickle.dumps(kinds))}) == 5
    with pytest.raises(AttributeError):
        kinds[0].lag = 3


@pytest.mark.parametrize("odd", [-2, 1.5, math.nan, -math.inf, True, "5", None])
def test_a_lag_is_a_number_of_steps(odd):
    with pytest.raises(pgm.ModelError, match=r"a lag is a whole number of steps from -1 on, or"):
        pgm.Kind(odd)


@pytest.mark.parametrize("model", [linear, bent], ids=["linear", "bent"])
@pytest.mark.parametrize("schedule", [pgm.Filtering(), pgm.Smoothing()], ids=str)
def test_results_say_their_kind(model, schedule):
    due = "filtered" if isinstance(schedule, pgm.Filtering) else "smoothed"
    graph = pgm.compile(model, T)
    posterior = pgm.infer(graph, EVIDENCE, schedule=schedule)
    assert (str(posterior.kind), title(posterior)) == (due, f"Posterior({due}, steps 0..5)")
    assert title(posterior.filtered) == "Marginals(filtered, steps 0..5)"
    assert title(posterior.predicted) == "Marginals(predicted, steps 0..5)"
    runs = {fix: pgm.sightings(np.tile(VALUES, (3, 1, 1)), step=np.arange(T + 1))}
    for keep in (None, [place]):
        method = filtered if due == "filtered" else smoothed
        with ThreadPoolExecutor(2) as pool:
            for executor in (None, pool):
                found = method(model, runs, keep=keep, executor=executor)
                assert found.kind == posterior.kind
                assert repr(found).startswith(f"Posterior({due}, ")
    assert repr(found.kind) == repr(posterior.kind)


def test_a_balanced_tree_says_its_kind():
    graph = pgm.compile(linear, T, method=pgm.Balanced())
    for schedule, due in ((pgm.Filtering(), "filtered"), (pgm.Smoothing(), "smoothed")):
        posterior = pgm.infer(graph, EVIDENCE, schedule=schedule)
        assert title(posterior) == f"Posterior({due}, steps 0..5)"


@pytest.mark.parametrize("noise", [0.3, 0.0], ids=["noise", "twice the digits"])
@pytest.mark.parametrize("lead", [(), (2,)], ids=["alone", "two"])
def test_online_beliefs_say_their_kind(noise, lead):
    sensor = pgm.LinearGaussianCPD(fix, given={place: 1.0}, cov=noise)
    robot = pgm.OnlineFilter(linear.replace(observation=[sensor]))
    belief = robot.initial()
    assert title(belief) == "OnlineBelief(predicted, step 0, over [place])"
    belief = robot.predict(belief)
    assert title(belief) == "OnlineBelief(predicted, step 1, over [place])"
    belief = robot.update(belief, {fix: np.ones((*lead, 1))})
    assert title(belief) == "OnlineBelief(filtered, step 1, over [place])"
    assert title(robot.update(belief, {})) == "OnlineBelief(filtered, step 1, over [place])"
    assert str(robot.predict(belief).kind) == "predicted"


@pytest.mark.parametrize("method", [None, pgm.Balanced()], ids=["slices", "balanced"])
def test_a_lag_s_joints_and_beliefs_know_the_readings_of_their_latest_variable(method):
    posterior = fixed_lag(method)
    assert title(posterior) == "Posterior(fixed-lag (2), steps 0..5)"
    for steps in ((2,), (1, 3), (4, 0, 2), (3, 5)):
        mean, cov, _ = dense(*steps, until=min(max(steps) + LAG, T))
        found = posterior.joint(*(place.at(step) for step in steps))
        assert_allclose(found.mean, mean, rtol=1e-12, atol=1e-12)
        assert_allclose(found.cov, cov, rtol=1e-12, atol=1e-12)
    for cluster in range(len(posterior.graph)):
        found = posterior.belief(cluster)
        steps = [variable.step for variable in found.scope]
        mean, _, log_density = dense(*steps, until=min(max(steps) + LAG, T))
        assert_allclose(found.log_integral, log_density, rtol=1e-12)
        assert_allclose(found.gaussian().mean, mean, rtol=1e-10)


def test_in_twice_the_digits_a_joint_knows_the_same():
    """After a prior that says nothing: the normal equations of transitions and readings alone."""
    flat = linear.replace(prior=[pgm.GaussianCPD(place, 1.0, cov=np.inf)])
    posterior = pgm.results.Posterior(
        replace(filtered(flat, EVIDENCE)._outcome, kind=pgm.Kind(LAG))
    )
    assert posterior._outcome._careful is not None
    steps = np.diff(np.eye(T + 1), axis=0) + 0.1 * np.eye(T + 1)[:-1]  # x[t + 1] - 0.9 x[t]
    for i, j in ((1, 2), (0, 4)):
        read = np.arange(T + 1) <= j + LAG
        cov = np.linalg.inv(steps.T @ steps / 0.5 + np.diag(read / 0.3))
        mean = cov @ (read * VALUES[:, 0]) / 0.3
        found = posterior.joint(place.at(i), place.at(j))
        assert_allclose(found.mean, mean[[i, j]], rtol=1e-12)
        assert_allclose(found.cov, cov[np.ix_([i, j], [i, j])], rtol=1e-12)


def test_what_was_not_sent_names_the_kind():
    for posterior, name in (
        (filtered(linear, EVIDENCE), "filtered"),
        (fixed_lag(), r"fixed-lag \(2\)"),
    ):
        assert posterior.message(2, 3).scope == (place.at(2),)
        with pytest.raises(
            pgm.GraphError,
            match=f"^the message from cluster 3 to 2 was not sent, since the posterior is {name}: "
            r"smoothing sends it; use pgm.smooth, or schedule=pgm.Smoothing\(\)$",
        ) as caught:
            posterior.message(3, 2)
        assert caught.value.cluster == 3


def test_a_balanced_tree_sends_down_what_its_kind_has():
    graph = pgm.compile(linear, T, method=pgm.Balanced())
    ahead = pgm.infer(graph, EVIDENCE, schedule=pgm.Filtering())
    child = next(k for k in range(1, len(graph)) if graph.parent(k) is not None)
    parent = graph.parent(child)
    ahead.message(parent, child)
    with pytest.raises(pgm.GraphError, match=r"to 0 was not sent, since .* is filtered: smooth"):
        ahead.message(graph.parent(0), 0)
    lagging = fixed_lag(pgm.Balanced())
    lagging.message(child, parent)
    for target in (0, child):
        with pytest.raises(pgm.GraphError, match=r"the posterior is fixed-lag \(2\): smoothing"):
            lagging.message(graph.parent(target), target)


def test_what_was_not_kept_names_the_kind():
    for method, where in ((filtered, r"posterior\[x\] here"), (smoothed, r"kept by pgm\.filter")):
        kept = method(linear, EVIDENCE, keep=[place])
        with pytest.raises(
            pgm.EvidenceError,
            match=rf"keeps {kept.kind} marginals, log-evidence and status alone.* are {where}",
        ):
            _ = kept.filtered
        with pytest.raises(pgm.EvidenceError, match=f"^joints: not kept, .* keeps {kept.kind} m"):
            kept.joint(place.at(1), place.at(2))
        with pytest.raises(pgm.GraphError, match=f"^messages: not kept, .* keeps {kept.kind} m"):
            kept.message(1, 2)


@pytest.mark.parametrize("method", [filtered, smoothed], ids=["filter", "smooth"])
def test_a_status_says_whether_it_was_iterated(method):
    exact = method(linear, EVIDENCE, iterations=5).status
    assert (repr(exact), bool(exact.converged)) == ("Status(nothing to iterate)", True)
    once = method(bent, EVIDENCE).status
    assert (repr(once), bool(once.converged)) == ("Status(linearised once, not iterated)", False)
    again = method(bent, EVIDENCE, iterations=50).status
    assert repr(again).startswith(f"Status({again.iterations} iterations, 1 of 1 runs converged, ")
    short = method(bent, EVIDENCE, iterations=2, tolerance=0.0).status
    assert repr(short).startswith("Status(2 iterations, 0 of 1 runs converged, last residual ")


def test_a_filter_does_not_iterate_a_motion():
    """It is linearised at the belief before, however often sensors are; a smoother goes on."""
    for iterations in (1, 5):
        status = filtered(moved, EVIDENCE, iterations=iterations).status
        assert repr(status) == "Status(nothing to iterate)"
    assert repr(smoothed(moved, EVIDENCE).status) == "Status(linearised once, not iterated)"


@pytest.mark.parametrize("lead", [(), (2,)], ids=["alone", "two"])
def test_an_online_status_says_whether_it_was_iterated(lead):
    reading = {fix: np.ones((*lead, 1))}
    for model, due in (
        (linear, "Status(nothing to iterate)"),
        (bent, "Status(linearised once, not iterated)"),
    ):
        robot = pgm.OnlineFilter(model)
        belief = robot.predict(robot.initial())
        assert repr(belief.status) == "Status(nothing to iterate)"
        assert repr(robot.update(belief, reading).status) == due
    again = pgm.OnlineFilter(bent, schedule=pgm.Filtering(iterations=20))
    status = again.update(again.initial(), reading).status
    runs = math.prod(lead)
    assert f" iterations, {runs} of {runs} runs converged, last residual " in repr(status)


def test_networks_without_time_say_it_too():
    a, b = pgm.variables("a b")
    prior = pgm.GaussianCPD(a, 0.0, 1.0)
    square = pgm.NonlinearGaussianCPD(b, given=(a,), function=lambda a: a + a**2, cov=1.0)
    line = pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=1.0)
    for cpd, due in ((line, "nothing to iterate"), (square, "linearised once, not iterated")):
        found = pgm.infer(pgm.compile(pgm.BayesianNetwork([prior, cpd])), {b: 1.0})
        assert repr(found.status) == f"Status({due})"
