"""An ensemble Kalman filter of a user's own goes wherever beliefs go."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.examples import walk, x, z
from tests.beliefs.own.ensemble import EnsembleKalman
from tests.beliefs.own.robot import ROBOT, M, R, S, U, driven

READINGS = np.array([[4.0], [3.0], [np.nan], [4.4]])
FEW = EnsembleKalman(40, seed=3)


def test_it_is_the_kalman_filter_of_a_linear_model():
    found = pgm.filter(walk, {z: READINGS}, belief=EnsembleKalman(20_000))
    due = pgm.filter(walk, {z: READINGS})
    assert_allclose(found[x].mean, due[x].mean, atol=0.04)
    assert_allclose(found[x].std, due[x].std, rtol=0.03)
    assert_allclose(found.log_evidence, due.log_evidence, atol=0.08)
    assert (found.kind, found.log_evidence_kind) == (pgm.Kind(0), "own")
    assert isinstance(found[x], pgm.results.ParticleBelief)
    assert_array_equal(found[x.at(2)].mean, found[x].mean[2])


@pytest.mark.parametrize("lag", [None, 0, 1, 3])
def test_it_is_the_smoother_of_a_linear_model(lag):
    found = pgm.smooth(walk, {z: READINGS}, lag=lag, belief=EnsembleKalman(20_000))
    due = pgm.smooth(walk, {z: READINGS}, lag=lag)
    assert_allclose(found[x].mean, due[x].mean, atol=0.04)
    assert_allclose(found[x].std, due[x].std, rtol=0.03)
    assert found.kind == due.kind
    assert_allclose(found.filtered[x].mean, due.filtered[x].mean, atol=0.04)
    assert_allclose(found.predicted[x].std, due.predicted[x].std, rtol=0.03)


def test_it_localises_a_robot_as_an_unscented_filter_does():
    drawn = driven()
    found = pgm.smooth(ROBOT, drawn.evidence, belief=EnsembleKalman(4000))
    due = pgm.smooth(ROBOT, drawn.evidence, lineariser=pgm.Unscented())
    for one, other in ((found, due), (found.filtered, due.filtered)):
        gaussian = one[S].gaussian()
        off = gaussian.mean - other[S].mean
        off[..., 2] = (off[..., 2] + np.pi) % (2.0 * np.pi) - np.pi
        assert np.abs(off / other[S].std).max() < 0.25


def test_runs_are_as_each_by_itself():
    """Random numbers are of the seed, the run and the step."""
    drawn = driven(runs=(2, 2))
    whole = pgm.filter(ROBOT, drawn.evidence, belief=FEW)
    assert whole[S].mean.shape == (2, 2, 13, 3)
    first = {v: pgm.sightings(e.values[0, 0], step=e.step, given=e.given) if v == R else e
             for v, e in drawn.evidence.items()}  # fmt: skip
    one = pgm.filter(ROBOT, first, belief=FEW)
    assert_allclose(one[S].mean, whole[S].mean[0, 0], rtol=1e-12)
    assert_allclose(one.log_evidence, whole.log_evidence[0, 0], rtol=1e-12)


@pytest.mark.parametrize("runs", [(), (3,)])
def test_online_it_is_as_over_recorded_data(runs):
    drawn = driven(runs)
    seen = drawn.evidence[R]
    robot = pgm.OnlineFilter(ROBOT, belief=FEW)
    belief = robot.initial()
    due = pgm.filter(ROBOT, drawn.evidence, belief=FEW)
    for step in range(1, 13):
        belief = robot.predict(belief, {U: np.tile([0.5, 0.1], (*runs, 1))})
        rows = np.flatnonzero(seen.step == step)
        now = pgm.sightings(seen.values[..., rows, :], given={M: seen.given[M][rows]})
        belief = robot.update(belief, {R: now})
        if step == 1:
            assert belief.lead == runs
        assert_allclose(belief[S].mean, due[S].mean[..., step, :], rtol=1e-12)
    assert_allclose(belief.log_evidence, due.log_evidence, rtol=1e-12)
    assert belief.kind == pgm.Kind(0)
    assert "EnsembleKalman(n=40, seed=3)" in repr(belief)
    assert belief[S.at(12)].states.shape == (*runs, 40, 3)


def test_it_is_compared_and_compares():
    found = pgm.compare(
        walk,
        {z: READINGS},
        linearisers={"ensemble": EnsembleKalman(2000), "Taylor": pgm.Taylor()},
        oracle=pgm.Grid({"x": (-8.0, 12.0, 400)}),
    )
    assert found["ensemble", "filter"].kl < 0.01
    assert found["Taylor", "smoother"].kl < 1e-3
    judged = pgm.compare(walk, {z: READINGS}, oracle=EnsembleKalman(2000))
    assert judged["Taylor", "filter"].kl < 0.01
    assert any("oracle: EnsembleKalman" in line for line in str(judged).splitlines()[1:])


def test_a_family_that_only_filters_is_a_row_beside_the_others():
    class Forward(EnsembleKalman):
        back = pgm.BeliefFamily.back

    methods = {"forward": Forward(2000), "Taylor": pgm.Taylor()}
    found = pgm.compare(walk, {z: READINGS}, linearisers=methods, truth={x: np.zeros((5, 1))})
    assert found["forward", "filter"].error == ""
    assert "says not how its beliefs flow back" in found["forward", "smoother"].error
    assert found["Taylor", "smoother"].error == ""


@pytest.mark.parametrize("draw", [pgm.plot.trajectory, pgm.plot.errors, pgm.plot.particles])
def test_it_is_drawn(draw):
    posterior = pgm.filter(ROBOT, driven().evidence, belief=FEW)
    belief = posterior[S]
    plt.subplots()
    truth = {"truth": np.zeros((13, 3))} if draw is pgm.plot.errors else {}
    draw(belief[3] if draw is pgm.plot.particles else belief.gaussian(), **truth)
    assert "over [s], EnsembleKalman(n=40, seed=3), 13 steps" in repr(posterior)


def test_what_it_has_not_is_refused_in_words():
    posterior = pgm.filter(walk, {z: READINGS}, belief=FEW)
    for name in ("innovations", "lost", "rejected", "weights", "associations"):
        with pytest.raises(pgm.EvidenceError, match="ensembles have none"):
            getattr(posterior, name)
    for name in ("belief", "potential"):
        with pytest.raises(pgm.GraphError, match="ensembles have none"):
            getattr(posterior, name)(0)
    with pytest.raises(pgm.GraphError, match="messages: ensembles have none"):
        posterior.message(0, 1)
    with pytest.raises(pgm.EvidenceError, match="of one step"):
        posterior.joint(x.at(0), x.at(1))
    with pytest.raises(AttributeError, match="no attribute 'cells'"):
        posterior.cells  # noqa: B018


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"lineariser": pgm.Unscented()}, "lineariser= is for beliefs that are Gaussian"),
        ({"keep": x}, "keep= is for beliefs that are Gaussian"),
        ({"gate": 0.9}, "gate= is for beliefs that are Gaussian"),
        ({"iterations": 3}, "ensembles need no linearising"),
        ({"impossible": "allow"}, "impossible= is for runs of networks without time"),
    ],
)
def test_options_that_it_has_no_use_for_are_refused(options, text):
    with pytest.raises(pgm.PgmError, match=text):
        pgm.filter(walk, {z: READINGS}, belief=FEW, **options)


def test_its_numbers_are_in_the_status_and_warn():
    with pytest.warns(pgm.BeliefWarning, match=r"EnsembleKalman\(n=1, seed=0\): members is 1"):
        posterior = pgm.filter(walk, {}, steps=2, belief=EnsembleKalman(1))
    assert_array_equal(posterior.status.members, [1.0, 1.0, 1.0])
    assert_array_equal(posterior.status.numbers["members"], [1.0, 1.0, 1.0])
    assert "members 1" in repr(posterior.status)
