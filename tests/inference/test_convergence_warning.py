"""Calls whose iterations end before they settle warn, once, of all runs together; others do not."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from crossed import crossed

import pgm
from pgm.examples import squares, walk, x, z

FEW = "had not settled"
# One wide step of a square, and a steeper one: the second takes longer to settle.
READINGS = np.array([[[9.0]], [[1.5]]])
LEVENBERG = pgm.LevenbergMarquardt()


def said(call):
    """Return what a call answers, and the warnings of convergence it issues."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", pgm.LinearisationWarning)
        answer = call()
    assert all(each.category is pgm.ConvergenceWarning for each in caught)
    assert all(each.filename == __file__ for each in caught), "it points at the user's line"
    return answer, [str(each.message) for each in caught]


CALLS = {
    "filter": lambda **more: pgm.filter(squares, {z: READINGS}, steps=1, **more),
    "smooth": lambda **more: pgm.smooth(squares, {z: READINGS}, steps=1, **more),
    "lag": lambda **more: pgm.smooth(squares, {z: READINGS}, steps=1, lag=1, **more),
    "keep": lambda **more: pgm.smooth(squares, {z: READINGS}, steps=1, keep=[x], **more),
    "infer": lambda **more: pgm.infer(
        pgm.compile(squares, steps=1), {z: READINGS}, schedule=pgm.Smoothing(**more)
    ),
    "balanced": lambda **more: pgm.smooth(
        squares, {z: READINGS}, steps=1, method=pgm.Balanced(), **more
    ),
}


@pytest.mark.parametrize("name", CALLS)
def test_iterations_that_are_too_few_are_told(name):
    call = CALLS[name]
    posterior, told = said(lambda: call(iterations=2))
    assert not posterior.status.converged.any()
    assert len(told) == 1
    worst = posterior.status.residuals[-1].max()
    assert f"{FEW} in 2 of 2 runs after 2 linearisations" in told[0]
    assert f"moved a mean by {worst:.3g} of its standard deviations (tolerance 1e-06" in told[0]
    settled, told = said(lambda: call(iterations=60))
    assert settled.status.converged.all()
    assert told == []
    _, told = said(lambda: call(iterations=1))
    assert told == [], "one linearisation is the plain filter or smoother"


def test_what_was_asked_for_is_what_counts():
    """A tolerance that is met is met; and the advice, followed, settles."""
    posterior, told = said(
        lambda: pgm.smooth(squares, {z: READINGS}, steps=1, iterations=3, tolerance=1e4)
    )
    assert posterior.status.converged.all()
    assert told == []
    _, told = said(lambda: pgm.smooth(squares, {z: READINGS}, steps=1, iterations=4))
    advised = int(told[0].split("iterations=")[1].split()[0])
    assert 4 < advised < 40
    assert (
        said(lambda: pgm.smooth(squares, {z: READINGS}, steps=1, iterations=advised + 3))[1] == []
    )


@pytest.mark.parametrize("name", CALLS)
def test_a_tolerance_of_zero_asks_for_a_number_of_iterations(name):
    posterior, told = said(lambda: CALLS[name](iterations=3, tolerance=0))
    assert posterior.status.iterations == 3
    assert not posterior.status.converged.any()
    assert told == []


def test_linear_models_have_nothing_to_settle():
    for call in (pgm.filter, pgm.smooth):
        assert said(lambda call=call: call(walk, {z: [[4.0], [2.0]]}, iterations=5))[1] == []
    readings = {z: [[np.nan], [np.nan]]}
    assert said(lambda: pgm.filter(squares, readings, iterations=5))[1] == []


def test_only_the_runs_that_did_not_settle_are_counted():
    exact = np.array([[[9.0]], [[0.0]]])
    posterior, told = said(lambda: pgm.filter(squares, {z: exact}, steps=1, iterations=4))
    open_ = int((~posterior.status.converged).sum())
    assert f"in {open_} of 2 runs" in told[0]


def test_parts_of_the_runs_warn_once():
    many = {z: np.full((40, 1, 1), 9.0)}
    with ThreadPoolExecutor(2) as pool:
        posterior, told = said(
            lambda: pgm.smooth(squares, many, steps=1, iterations=2, keep=[x], executor=pool)
        )
    assert len(told) == 1
    assert "in 40 of 40 runs" in told[0]
    assert posterior.status.converged.shape == (40,)


def test_advice_depends_on_the_damping():
    _, plain = said(lambda: pgm.smooth(squares, {z: READINGS}, steps=1, iterations=2))
    assert "damping=0.5, or damping=pgm.LevenbergMarquardt(), or a start=" in plain[0]
    _, damped = said(lambda: pgm.filter(squares, {z: READINGS}, steps=1, iterations=2, damping=0.5))
    assert "damping=0.75" in damped[0]
    assert "start=" not in damped[0], "a filter takes none"
    _, held = said(
        lambda: pgm.smooth(squares, {z: READINGS}, steps=1, iterations=2, damping=LEVENBERG)
    )
    assert "a number as damping" in held[0]


def test_a_static_network():
    a, b = pgm.variables("a b")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, 1.0, 1.0), pgm.NonlinearGaussianCPD(b, a, np.exp, 0.01)]
    )
    graph = pgm.compile(net)
    posterior, told = said(
        lambda: pgm.infer(graph, {b: 9.0}, schedule=pgm.Calibration(iterations=2))
    )
    assert not posterior.status.converged
    assert "after 2 linearisations" in told[0]
    assert "damping=pgm.LevenbergMarquardt()" in told[0]
    assert (
        said(lambda: pgm.infer(graph, {b: 9.0}, schedule=pgm.Calibration(iterations=30)))[1] == []
    )
    assert said(lambda: pgm.infer(graph, {b: 9.0}))[1] == []


def test_online_the_words_are_the_same_at_each_step():
    """So that by default Python shows them once, and not at each step of a robot's loop."""
    for schedule in (pgm.Filtering(iterations=2), pgm.FixedLag(2, iterations=2)):
        robot = pgm.OnlineFilter(squares, schedule=schedule)

        def drive(robot=robot):
            belief = robot.initial()
            for value in (9.0, 30.0, 60.0):
                belief = robot.update(robot.predict(belief), {z: [value]})
            return belief

        belief, told = said(drive)
        assert not belief.status.converged
        assert len(told) == 3
        assert len(set(told)) == 1
        assert "its 2 linearisations" in told[0]
    settled = pgm.OnlineFilter(squares, schedule=pgm.Filtering(iterations=60))
    assert said(lambda: settled.update(settled.initial(), {z: [9.0]}))[1] == []
    once = pgm.OnlineFilter(squares)
    assert said(lambda: once.update(once.initial(), {z: [9.0]}))[1] == []


def test_comparisons_tell_in_their_rows():
    schedules = {"two": pgm.Smoothing(iterations=2), "many": pgm.Smoothing(iterations=60)}
    found, told = said(
        lambda: pgm.compare(
            squares, {z: READINGS}, steps=1, linearisers=[pgm.Taylor()], schedules=schedules
        )
    )
    assert told == []
    assert found["Taylor", "two"].converged == 0.0
    assert found["Taylor", "many"].converged == 1.0


def test_a_search_for_parameters():
    recording = walk.sample(steps=60, rng=1).evidence
    learn = {z: pgm.learning.Covariance()}
    found, told = said(lambda: pgm.fit(walk, recording, learn=learn, iterations=1))
    assert not found.status.converged
    assert len(told) == 1
    assert "after the 1 iterations that were asked for" in told[0]
    found, told = said(lambda: pgm.fit(walk, recording, learn=learn))
    assert found.status.converged
    assert told == []
    found, told = said(lambda: pgm.fit(walk, recording, learn=learn, iterations=2, tolerance=0))
    assert not found.status.converged
    assert told == [], "just so many were asked for"


def test_a_search_tells_of_its_smoothers_once():
    recording = squares.sample(steps=30, rng=1).evidence
    learn = {z: pgm.learning.Covariance()}
    found, told = said(
        lambda: pgm.fit(squares, recording, learn=learn, schedule=pgm.Smoothing(iterations=2))
    )
    assert len(told) == 1
    twice = pgm.Smoothing(iterations=2, tolerance=0)
    _, few = said(lambda: pgm.fit(squares, recording, learn=learn, schedule=twice))
    assert not any("smoothers of its last step" in each for each in few)
    words = "smoothers of its last step" if found.status.converged else "ended unconverged"
    assert words in told[0]


# ---- at the optimum


PLACE = pgm.Variable("place", components=("east", "north"))
MARK = pgm.Variable("mark", components=("east", "north"))
FAR = pgm.Variable("far")


def ranges(shift, std):
    """Return a standing robot that hears four beacons, all moved by `shift` metres."""
    rng = np.random.default_rng(0)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(PLACE, [shift, shift], 4.0)],
        transition=[pgm.LinearGaussianCPD(PLACE, given={PLACE.previous: 1.0}, cov=0.01)],
        observation=[
            pgm.NonlinearGaussianCPD(
                FAR,
                (PLACE, MARK),
                lambda place, mark: np.linalg.norm(mark - place, axis=-1, keepdims=True),
                std**2,
            )
        ],
    )
    marks = np.array([[10.0, 0.0], [0.0, 12.0], [-9.0, 1.0], [2.0, -11.0]])[np.arange(20) % 4]
    heard = np.linalg.norm(marks - [0.5, -0.7], axis=1) + std * rng.normal(size=20)
    return model, {FAR: heard[:, None], MARK: shift + marks}


@crossed(("shift", "compiled"), [0.0, 1e6, 1e8], [False, True])
def test_rounding_of_far_coordinates_is_no_move(shift, compiled):
    """At 10⁸ m float64 has steps of 1.5e-8 m, which are 1e-5 deviations; nothing moves less.

    That these are too coarse a `PrecisionWarning` tells, once a call.
    """
    model, evidence = ranges(shift, 1e-3)
    for call in (pgm.filter, pgm.smooth):
        for tolerance in (1e-6, 0.0):
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                warnings.simplefilter("ignore", pgm.LinearisationWarning)
                posterior = call(
                    model, evidence, iterations=40, tolerance=tolerance, compiled=compiled
                )
            assert posterior.status.converged.all()
            coarse = [pgm.PrecisionWarning] if shift == 1e8 else []
            assert [each.category for each in told] == coarse


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Cubature()], ids=["taylor", "cubature"])
def test_converged_is_close_to_the_fixed_point(rule):
    """By the default tolerance, against many linearisations more."""
    model, evidence = ranges(0.0, 0.3)
    for call in (pgm.filter, pgm.smooth):
        found = call(model, evidence, iterations=40, lineariser=rule)
        due = call(model, evidence, iterations=200, tolerance=1e-13, lineariser=rule)
        assert found.status.converged
        assert found.status.iterations < due.status.iterations
        assert (np.abs(found[PLACE].mean - due[PLACE].mean) / due[PLACE].std).max() < 1e-5
