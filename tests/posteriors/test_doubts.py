"""Posteriors say what is wrong with them: in print, and by one warning a place."""

import warnings

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


def test_where_it_would_take_as_long_as_the_call_print_alone_tells():
    """Of many runs that are filtered, predictions are not kept; machine code is as fast."""
    readings = RUNS.copy()
    readings[3] += np.array(FAR)
    many = pgm.filter(walk, {z: readings})
    assert "run 3: steps" in repr(many)
    assert "run 3: steps" in repr(pgm.filter(walk, {z: readings}, compiled=True))
    with pytest.warns(pgm.LostWarning):  # a smoother has them
        pgm.smooth(walk, {z: readings})


def test_of_very_many_steps_print_says_that_nothing_was_asked():
    wide = np.zeros((2000, 12, 1))
    assert "are not asked here" in repr(pgm.filter(walk, {z: wide}))


@pytest.mark.parametrize("seed", range(6))
def test_what_log_densities_rule_out_does_not_happen(seed):
    """Where they say that a belief was kept, the test of innovations says so as well."""
    rng = np.random.default_rng(seed)
    sure = 0
    for scale in np.geomspace(0.5, 8.0, 12):
        shape = (5, 30, 1)
        readings = rng.normal(scale=scale, size=shape) + 0.3 * np.arange(30)[:, None] * scale
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pgm.LostWarning)
            outcome = pgm.smooth(walk, {z: readings}, compiled=False)._outcome
        if outcome._surely_kept:
            sure += 1
            assert not outcome.lost
    assert sure


def test_lines_that_cannot_be_right_are_told_of():
    once = pgm.filter(squares, {z: [[9.0], [9.1]]})
    assert "linearised where no line is right: z at 2 of 2; smooth" in repr(once)
    settled = pgm.smooth(squares, {z: [[9.0], [9.1]]}, iterations=30)
    assert "linearised where" not in repr(settled)


def test_a_function_that_fails_over_the_belief_does_not_keep_a_posterior_from_being_shown():
    def root(x):
        if (x < -1.5).any():
            raise ValueError("no root")
        return np.sqrt(2.0 + x)

    sensor = pgm.NonlinearGaussianCPD(z, given=x, function=root, cov=1.0)
    model = pgm.DynamicBayesianNetwork(walk.prior, walk.transition, [sensor])
    posterior = pgm.filter(model, {z: [[1.5]]})
    assert "posterior.nonlinearity: none:" in repr(posterior)
