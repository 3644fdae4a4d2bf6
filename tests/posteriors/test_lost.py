"""Lost beliefs: how seldom consistent filters cry, and how soon wrong ones do."""

import pickle

import numpy as np
import pytest
from crossed import crossed
from numpy.testing import assert_array_equal

import pgm
from pgm.kernels.cusum import STEPS
from pgm.posteriors.lost import Lost, Read

x, z, w = pgm.variables("x z w")
MODEL = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
    transition=[pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=0.1)],
    observation=[
        pgm.LinearGaussianCPD(z, given={x: 1.0}, cov=1.0),
        pgm.LinearGaussianCPD(w, given={x: 1.0}, cov=4.0),
    ],
)


def drawn(runs, steps, seed=0):
    rng = np.random.default_rng(seed)
    start = rng.normal(size=(runs, 1))
    states = start + np.cumsum(rng.normal(scale=0.1**0.5, size=(runs, steps)), axis=1)
    return states, states[..., None] + rng.normal(size=(runs, steps, 1)), rng


def of_page(nis, dof):
    """Page's test of one run, as it is written in books: where it first reaches ln 10⁶."""
    level, high = 0.0, np.log(1e6)
    for step, (square, count) in enumerate(zip(nis, dof, strict=True)):
        ratio = -0.5 * (square / 2.0 - square) - 0.5 * count * np.log(2.0)
        level = max(0.0, level + min(ratio, high / 3.0))
        if level >= high:
            return step
    return None


@pytest.mark.parametrize("gate", [None, 0.99])
def test_a_consistent_filter_does_not_cry(gate):
    runs, steps = 300, 1000
    found = pgm.filter(MODEL, {z: drawn(runs, steps)[1]}, gate=gate).lost
    assert len(found.stretches) <= 2  # of 300,000 steps, at 10⁻⁶ a step and test
    assert_array_equal(found.at.shape, (runs, steps + 1))


def test_the_rate_of_false_alarms_is_what_is_said():
    rng, shape = np.random.default_rng(3), (10_000, 200)
    nothing = np.zeros(shape, dtype=int)
    for dof in (1, 2, 8):
        read = Read(rng.chisquare(dof, size=shape), nothing + dof, nothing, nothing)
        assert len(Lost.of(read, (200,)).stretches) <= 9  # two are due, at the most
    outliers = (rng.random(shape) < 0.1).astype(int)
    read = Read(np.zeros(shape), nothing, outliers, nothing + 1)
    assert len(Lost.of(read, (200,)).stretches) <= 9
    assert STEPS == 1e6


def test_it_is_pages_test():
    rng, shape = np.random.default_rng(1), (400, 60)
    dof = rng.integers(0, 4, size=shape)
    nis = np.where(dof > 0, 2.5 * rng.chisquare(np.maximum(dof, 1)), 0.0)
    nothing = np.zeros(shape, dtype=int)
    found = Lost.of(Read(nis, dof, nothing, nothing), (60,))
    for run in range(60):
        due = of_page(nis[:, run], dof[:, run])
        said = np.flatnonzero(found.at[run])
        assert (said[0] if said.size else None) == due
        first = next((s for s in found.stretches if s.run == (run,)), None)
        assert due is None or first.declared == due
        assert first is None or first.first <= first.declared <= first.last


def test_one_outlier_is_not_lost_and_a_wrong_start_is():
    _, readings, _ = drawn(50, 100)
    once = readings.copy()
    once[:, 50] += 1000.0
    # A gate leaves it out; without one the filter is off for as long as it takes to come back.
    assert not pgm.filter(MODEL, {z: once}, gate=0.99).lost
    wrong = MODEL.replace(prior=[pgm.GaussianCPD(x, 30.0, 0.01)])
    for gate in (None, 0.99):
        found = pgm.filter(wrong, {z: readings}, gate=gate).lost
        firsts = {stretch.run: stretch for stretch in reversed(found.stretches)}
        assert len(firsts) == 50
        assert all(each.first <= 2 and each.declared <= 10 for each in firsts.values())
        why = "innovations" if gate is None else "rejections"
        assert {each.why for each in firsts.values()} == {why}


def test_it_recovers_when_the_sensor_does():
    _, readings, _ = drawn(30, 300)
    readings[:, 100:120] += 12.0  # for a while
    found = pgm.filter(MODEL, {z: readings}, gate=0.99).lost
    assert {each.run for each in found.stretches} == {(run,) for run in range(30)}
    for each in found.stretches:
        assert 99 <= each.first <= 104
        assert each.declared <= 114
        assert each.last < 160
        assert each.why == "rejections"
        assert 0.4 < each.value <= 1.0
    assert "rejections" in str(found)
    assert "Rejections(" in str(pgm.filter(MODEL, {z: readings}, gate=0.99))
    assert str(found.stretches[3]).startswith("run 3: steps 101..")


@pytest.mark.parametrize("gate", [None, 0.95])
def test_online_it_is_known_at_each_step_in_constant_room(gate):
    _, one, rng = drawn(4, 80)
    two = one + rng.normal(scale=2.0, size=one.shape)
    one[:, 30:45] += 15.0
    two[:, ::3] = np.nan
    due = pgm.filter(MODEL, {z: one, w: two}, gate=gate).lost
    assert due.at.any()
    robot = pickle.loads(pickle.dumps(pgm.OnlineFilter(MODEL, gate=gate, watch=True)))
    belief, sizes = robot.initial(), []
    assert not belief.lost
    for step in range(80):
        belief = robot.update(robot.predict(belief), {z: one[:, step], w: two[:, step]})
        assert_array_equal(belief.lost, due.at[:, step + 1])
        since = [
            next(
                (
                    s.first
                    for s in due.stretches
                    if s.run == (k,) and s.declared <= step + 1 <= s.last
                ),
                -1,
            )
            for k in range(4)
        ]
        assert_array_equal(belief.lost_since, since)
        sizes.append(len(pickle.dumps(belief)))
    assert max(sizes[5:]) - min(sizes[5:]) < 100


def test_updates_of_a_step_count_together():
    _, readings, _ = drawn(1, 60)
    one = readings[0]
    one[30:] += 9.0
    robot = pgm.OnlineFilter(MODEL, watch=True)
    both, apart, levels = robot.initial(), robot.initial(), []
    for value in one:
        both = robot.update(robot.predict(both), {z: value, w: value + 1.0})
        apart = robot.update(robot.update(robot.predict(apart), {z: value}), {w: value + 1.0})
        np.testing.assert_allclose(both._watched.level, apart._watched.level, atol=1e-9)
        levels.append(both._watched.level.max())
    assert max(levels) > 5.0
    with pytest.raises(pgm.EvidenceError, match="watch=True"):
        bool(pgm.OnlineFilter(MODEL).initial().lost)


PLACE, SPOT = pgm.Variable("place", components=("a", "b")), pgm.Variable("spot", ("a", "b"))
SEEN = pgm.Variable("seen", components=("a", "b"))
SPOTS = np.array([[0.0, 0.0], [30.0, 10.0], [-20.0, 40.0], [50.0, 50.0]])


def wanderer():
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(PLACE, [0.0, 0.0], [0.2, 0.2])],
        transition=[pgm.LinearGaussianCPD(PLACE, {PLACE.previous: np.eye(2)}, cov=[5e-4, 5e-4])],
        observation=[
            pgm.LinearGaussianCPD(SEEN, {PLACE: -np.eye(2), SPOT: np.eye(2)}, cov=[0.1, 0.1])
        ],
    )


def wandered(jump, clutter, steps=60, seed=2):
    """Two sightings a step, of places that nobody names; a jump at half time; some of nothing."""
    rng = np.random.default_rng(seed)
    step = np.repeat(np.arange(1, steps + 1), 2)
    there = np.where(step[:, None] >= steps // 2, jump, 0.0) + np.zeros((2 * steps, 2))
    values = SPOTS[np.concatenate([rng.permutation(4)[:2] for _ in range(steps)])] - there
    values = values + rng.normal(scale=0.3, size=values.shape)
    nothing = rng.random(2 * steps) < clutter
    values[nothing] = rng.uniform(-60.0, 60.0, (nothing.sum(), 2))
    return values, step


@crossed(
    ("options", "gate"),
    [
        {"gate": 0.999},
        {"spurious": 0.1, "volume": 1.44e4},
        {"association": "joint", "gate": 0.999},
    ],
    [None, 0.99],
)
def test_sightings_that_are_of_no_candidate_tell_of_a_kidnapped_robot(options, gate):
    """They are left out, so that neither innovations nor gates say anything."""
    jumped, stayed = (wandered(np.array(way), 0.0) for way in ([7.0, -6.0], [0.0, 0.0]))
    given = {SPOT: pgm.unknown(SPOTS, **({"association": "likelihood"} | options))}
    both = pgm.sightings(np.stack([jumped[0], stayed[0]]), step=jumped[1], given=given)
    found = pgm.filter(wanderer(), {SEEN: both}, steps=60, gate=gate)
    (stretch,) = found.lost.stretches
    assert stretch.run == (0,)
    assert stretch.why == "rejections"
    assert stretch.first == 30
    assert stretch.last == 60
    for schedule in (pgm.Filtering(gate=gate), pgm.FixedLag(3, gate=gate)):
        robot = pgm.OnlineFilter(wanderer(), schedule=schedule, watch=True)
        belief = robot.initial()
        for k in range(1, 61):
            rows = pgm.sightings(jumped[0][jumped[1] == k], given=given)
            belief = robot.update(robot.predict(belief), {SEEN: rows})
            assert belief.lost == found.lost.at[0, k]


def test_clutter_that_was_declared_makes_no_belief_lost():
    values, step = wandered(np.zeros(2), 0.6, steps=200)
    for share, lost in [(0.6, False), (0.05, True)]:
        given = {SPOT: pgm.unknown(SPOTS, spurious=share, volume=1.44e4, association="likelihood")}
        seen = pgm.sightings(values, step=step, given=given)
        found = pgm.filter(wanderer(), {SEEN: seen}, steps=200)
        assert bool(found.lost) is lost
    values, step = wandered(np.array([7.0, -6.0]), 0.6, steps=200)
    given = {SPOT: pgm.unknown(SPOTS, spurious=0.6, volume=1.44e4, association="likelihood")}
    found = pgm.filter(wanderer(), {SEEN: pgm.sightings(values, step=step, given=given)}, steps=200)
    assert found.lost.at[-1]


@pytest.mark.parametrize("gate", [None, 0.9999])
def test_truncated_noise_that_leaves_everything_out_is_lost(gate):
    """Its weights of zero leave innovations of none."""
    rng = np.random.default_rng(0)
    values = rng.normal(scale=0.3, size=(2, 80, 1))
    values[0, 40:] += 50.0
    sensor = pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1, noise=pgm.TruncatedLeastSquares(3.0))
    model = MODEL.replace(observation=[sensor])
    found = pgm.filter(model, {z: values}, gate=gate).lost
    (stretch,) = found.stretches
    assert (stretch.run, stretch.first, stretch.last) == ((0,), 41, 80)
    assert stretch.why == "rejections"
    smoothed = pgm.smooth(model, {z: values}, gate=gate, iterations=60).lost
    assert smoothed.at[0, 60:].all()
    for schedule in (pgm.Filtering(gate=gate), pgm.FixedLag(3, gate=gate)):
        due = pgm.infer(pgm.compile(model, 80), {z: values[0]}, schedule=schedule).lost
        robot = pgm.OnlineFilter(model, schedule=schedule, watch=True)
        belief = robot.initial()
        for k in range(1, 81):
            belief = robot.update(robot.predict(belief), {z: values[0, k - 1]})
            assert belief.lost == due.at[k]


def test_a_watched_belief_is_a_value():
    robot = pgm.OnlineFilter(MODEL, watch=True)
    belief = robot.predict(robot.initial())
    before = dict(belief.__dict__)
    other = belief.judged((), None)
    assert other is not belief
    assert other.watch is None
    assert belief.__dict__ == before
    assert belief.watch is before["watch"]
