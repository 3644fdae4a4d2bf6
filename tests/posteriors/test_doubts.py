"""Posteriors say what is wrong with them: in print, and by one warning a place."""

import warnings
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest

import pgm
from pgm.examples import squares, walk, x, z

GOOD = [[0.5], [1.0], [0.0], [-1.0], [0.5], [1.5]]
# A target that the walk's noise does not allow for.
FAR = [[30.0 * step] for step in range(1, 13)]
RUNS = np.random.default_rng(0).normal(scale=2.0, size=(10, 12, 1))


@pytest.mark.parametrize("ask", [pgm.filter, pgm.smooth])
def test_a_lost_belief_is_told_in_print_and_by_a_warning(ask):
    with pytest.warns(pgm.LostWarning, match="posterior.lost says where") as told:
        posterior = ask(walk, {z: FAR})
    assert len(told) == 1
    assert told[0].filename == __file__
    found = posterior.lost.stretches[0]
    assert f"lost at {posterior.lost.at.sum()} of 13 steps; steps {found.first}.." in repr(
        posterior
    )
    assert f"NIS {found.value:.3g}"[:6] in repr(posterior)


def test_a_belief_that_holds_is_not_doubted():
    posterior = pgm.filter(walk, {z: GOOD})
    assert not posterior.lost
    assert "lost" not in repr(posterior)
    assert "linearised where" not in repr(posterior)


def test_infer_warns_as_filter_does():
    graph = pgm.compile(walk, steps=12)
    with pytest.warns(pgm.LostWarning):
        pgm.infer(graph, {z: FAR})
    with pytest.warns(pgm.LostWarning):
        pgm.prepare(graph, {z: FAR})({z: FAR})


def test_a_loop_is_warned_once():
    """Python's filter knows a warning by its text, which therefore has no numbers of its own."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("default")
        for scale in (1.0, 2.0, 3.0):
            pgm.filter(walk, {z: scale * np.array(FAR)})
    assert [each.category for each in told] == [pgm.LostWarning]


def test_gates_are_heard_too():
    with pytest.warns(pgm.LostWarning):
        posterior = pgm.filter(walk, {z: [[0.0]] * 20 + [[30.0]] * 20}, gate=0.99)
    assert "rejections, 1 of the sightings rejected" in repr(posterior)


CURVED = pgm.DynamicBayesianNetwork(
    walk.prior,
    walk.transition,
    [pgm.NonlinearGaussianCPD(z, given=x, function=lambda x: x + 0.3 * np.sin(x), cov=2.0)],
)


CURVED_WIDE = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(x, 3.0, 4.0)],
    walk.transition,
    [pgm.NonlinearGaussianCPD(z, given=x, function=np.square, cov=1.0)],
)


def is_lost(posterior):
    """Page's test of innovations by the textbook, run by run, and of a gate's rejections."""
    found, steps = posterior.innovations[z], posterior.graph.steps + 1
    for run in np.ndindex(found.rejected.shape[:-1]):
        sums = np.zeros(2)
        for step in range(1, steps):
            nis, d = np.nan_to_num(found.nis[run][step]), found.dof[run][step]
            r = found.rejected[run][step - 1]
            n = d + r if posterior.rejected else 0
            more = 0.25 * nis - 0.5 * d * np.log(2.0), r * np.log(5.0) - (n - r) * np.log(1.8)
            sums = np.maximum(sums + np.minimum(more, np.log(1e6) / 3.0), 0.0)
            if (sums >= np.log(1e6)).any():
                return True
    return False


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("runs", [1, 9])
@pytest.mark.parametrize("model", [walk, CURVED])
@pytest.mark.parametrize(
    "ask",
    [
        pgm.filter,
        partial(pgm.filter, gate=0.99),
        partial(pgm.filter, keep=[x]),
        pgm.smooth,
        partial(pgm.smooth, iterations=4),
        partial(pgm.smooth, iterations=4, gate=0.99),
        partial(pgm.smooth, lag=2, iterations=4),
    ],
)
def test_every_sweep_warns_where_beliefs_are_lost_and_only_there(ask, model, runs, compiled):
    rng, met = np.random.default_rng(runs), set()
    for scale, drift in ((0.7, 0.0), (2.0, 0.0), (2.0, 30.0)):
        shape = runs, 15, 1
        readings = rng.normal(size=shape).cumsum(axis=1) + rng.normal(scale=scale, size=shape)
        readings += drift * np.arange(15)[:, None]
        readings[rng.random(readings.shape) < 0.1] = np.nan
        readings = readings[0] if runs == 1 else readings
        for _ in range(2):  # the second of which may be bound
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                posterior = ask(model, {z: readings}, compiled=compiled)
            told = [each for each in told if each.category is pgm.LostWarning]
            if "keep" in getattr(ask, "keywords", {}):
                posterior = pgm.filter(model, {z: readings}, compiled=compiled)
                assert all("without keep= posterior.lost" in str(each.message) for each in told)
            assert len(told) == is_lost(posterior) == bool(posterior.lost)
        met.add(is_lost(posterior))
    assert met == {True, False}


def test_workers_tell_of_lost_beliefs():
    readings = RUNS.copy()
    readings[3] += np.array(FAR)
    with ThreadPoolExecutor(2) as pool:
        with pytest.warns(pgm.LostWarning):
            pgm.smooth(walk, {z: readings}, executor=pool)
        with warnings.catch_warnings():
            warnings.simplefilter("error", pgm.LostWarning)
            pgm.smooth(walk, {z: RUNS}, executor=pool)


def test_of_very_many_steps_print_says_that_nothing_was_asked():
    wide = np.zeros((2000, 12, 1))
    assert "are not asked here" in repr(pgm.filter(walk, {z: wide}))


def test_lines_that_cannot_be_right_are_told_of():
    with pytest.warns(pgm.LinearisationWarning, match="posterior.nonlinearity where; smooth with"):
        once = pgm.filter(afresh(squares), {z: [[9.0], [9.1]]})
    assert "linearised where no line is right: z at 2 of 2; smooth" in repr(once)
    settled = pgm.smooth(squares, {z: [[9.0], [9.1]]}, iterations=30)
    assert "linearised where" not in repr(settled)


def afresh(model):
    """The same network, of which no call was made."""
    return model.replace(prior=model.prior)


def doubted(ask, *asked, **how):
    """Whether a call warns that no line is right, once and at this file."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        ask(*asked, **how)
    told = [each for each in told if each.category is pgm.LinearisationWarning]
    assert all(each.filename == __file__ for each in told)
    assert len(told) <= 1
    return bool(told)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("ask", [pgm.filter, pgm.smooth, partial(pgm.smooth, lag=2)])
def test_the_first_call_by_each_rule_warns_of_lines_that_cannot_be_right(ask, compiled):
    model, readings = afresh(squares), {z: [[9.0], [9.1], [9.0]]}
    own = partial(doubted, ask, model, readings, compiled=compiled)
    assert own()
    assert not own()
    assert own(lineariser=pgm.Unscented())
    assert not own(lineariser=pgm.Unscented())
    assert not own(iterations=20)
    assert doubted(ask, afresh(squares), readings, compiled=compiled)


def test_a_narrow_belief_is_not_doubted_and_a_gap_is():
    """The rows with the widest beliefs are looked at, wherever they are."""
    near = pgm.GaussianCPD(x, mean=3.0, cov=1e-4)
    still = pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=1e-4)
    model = squares.replace(prior=[near], transition=[still])
    rows = [[9.0]] * 100
    assert not doubted(pgm.filter, model, {z: rows})
    rows[20:90] = [[np.nan]] * 70
    assert doubted(pgm.filter, afresh(model), {z: rows})
    assert np.flatnonzero(pgm.filter(model, {z: rows}).nonlinearity[z] > 0.5).tolist() == [90]


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("wide", [0, 2, 3])
def test_of_many_runs_more_than_one_in_twenty_are_to_be_wrong(wide, compiled):
    cov = np.where(np.arange(40) < wide, 1.0, 1e-8).reshape(40, 1, 1)
    still = pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=1e-8)
    model = squares.replace(prior=[pgm.GaussianCPD(x, 3.0, cov)], transition=[still])
    readings = {z: np.full((40, 5, 1), 9.0)}
    assert doubted(pgm.smooth, model, readings, compiled=compiled) == (wide == 3)
    wrong = (pgm.filter(model, readings, compiled=compiled).nonlinearity[z] > 0.5).any(axis=1)
    assert wrong.sum() == wide


def test_a_filter_of_many_runs_is_not_swept_again_for_a_warning():
    readings = {z: np.full((40, 3, 1), 9.0)}
    assert not doubted(pgm.filter, afresh(CURVED_WIDE), readings)
    assert doubted(pgm.smooth, afresh(CURVED_WIDE), readings)
    assert "linearised where no line is right" in repr(pgm.filter(CURVED_WIDE, readings))


def test_a_function_that_fails_over_the_belief_does_not_keep_a_posterior_from_being_shown():
    def root(x):
        if (x < -1.5).any():
            raise ValueError("no root")
        return np.sqrt(2.0 + x)

    sensor = pgm.NonlinearGaussianCPD(z, given=x, function=root, cov=1.0)
    model = pgm.DynamicBayesianNetwork(walk.prior, walk.transition, [sensor])
    posterior = pgm.filter(model, {z: [[1.5]]})
    assert "posterior.nonlinearity: none:" in repr(posterior)
