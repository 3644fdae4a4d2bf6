"""Modes that symmetric or repeated geometry leaves open, which the answer has lost, are told."""

import numpy as np
import pytest
from crossed import slow_after

import pgm
from pgm.inference.audit import chain_modes
from pgm.inference.audit.chain import ChainDraws
from pgm.inference.audit.modes import APART, SHARE, FixedPoints, Modes, choose
from pgm.inference.audit.tree import TreeDraws

place, control, beacon = (
    pgm.Variable(name, components=("east", "north")) for name in ("place", "control", "beacon")
)
distance = pgm.Variable("distance")
STEPS = 20
ON_A_LINE = [[-3.0, 0.0], [2.0, 0.0]]
IN_THE_PLANE = [[-3.0, 0.0], [2.0, 0.0], [0.0, 3.0]]
CAREFUL = {"iterations": 60, "damping": pgm.LevenbergMarquardt(), "tolerance": 1e-6}


def away(place, beacon):
    return np.linalg.norm(beacon - place, axis=-1, keepdims=True)


def drive(beacons, seed, north=0.3, variance=1.0, runs=(), **sensor):
    """A drive to the east, with the distances to all beacons at each step."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [0.0, north], variance)],
        [pgm.LinearGaussianCPD(place, {place.previous: np.eye(2), control: np.eye(2)}, cov=0.0025)],
        [pgm.NonlinearGaussianCPD(distance, (place, beacon), away, cov=0.01, **sensor)],
    )
    seen = pgm.sightings(
        step=np.repeat(np.arange(1, STEPS + 1), len(beacons)),
        given={beacon: np.tile(beacons, (STEPS, 1))},
    )
    controls = np.broadcast_to([0.05, 0.0], (*runs, STEPS, 2))
    return model, model.sample({control: controls, distance: seen}, rng=seed).evidence


def moments(model, evidence):
    """The exact smoothed moments, on a grid."""
    grid = pgm.Grid({"east": (-4.0, 5.0, 108), "north": (-4.0, 4.0, 96)})
    return pgm.smooth(model, evidence, belief=grid)[place]


def furthest(variable, exact, answer):
    """The largest divergence of a grid's moments from a Gaussian's, over all steps."""

    def of(belief, k):
        return pgm.Gaussian(variable, belief.mean[k], belief.cov[k])

    return max(float(of(exact, k).kl(of(answer, k))) for k in range(STEPS + 1))


@pytest.mark.parametrize("seed", slow_after(1, [3, 5, 12]))
def test_a_mirror_drive_past_two_beacons_is_flagged(seed):
    model, evidence = drive(ON_A_LINE, seed)
    answer = pgm.smooth(model, evidence, **CAREFUL)
    exact, found = moments(model, evidence), pgm.audit(answer, rng=0)
    assert furthest(place, exact, answer[place]) > 50.0
    assert found.suspect
    assert found.modes == 1
    # Not only told: the moments of both modes are estimated.
    np.testing.assert_allclose(found.corrected[place].mean, exact.mean, atol=0.15)


@pytest.mark.parametrize("seed", slow_after(1, [201, 202, 203]))
def test_a_drive_among_beacons_that_are_not_in_line_is_not(seed):
    model, evidence = drive(IN_THE_PLANE, seed)
    answer = pgm.smooth(model, evidence, **CAREFUL)
    found = pgm.audit(answer, rng=0)
    np.testing.assert_allclose(answer[place].mean, moments(model, evidence).mean, atol=0.1)
    assert not found.suspect
    assert found.trusted
    assert found.modes == 0


def test_many_drives_are_judged_one_by_one():
    """Priors on the axis, whose mirror image weighs the same, and far north of it."""
    model, evidence = drive(ON_A_LINE, 1, runs=(8,))
    answer = pgm.smooth(model, evidence, **CAREFUL)
    found = pgm.audit(answer, rng=0)
    # Both modes are of one shape, and their weights those of the prior.
    north = answer[place].mean[:, 0, 1]
    mass = 1.0 / (1.0 + np.exp(2.0 * 0.3 * north))
    lost = np.abs(north) > 0.5
    assert lost.sum() >= 5
    assert found.suspect[lost].all()
    assert (found.modes[lost] >= 1).all()
    exact = (1.0 - mass) * north - mass * north
    np.testing.assert_allclose(found.corrected[place].mean[lost, 0, 1], exact[lost], atol=0.25)


def test_a_filter_and_sigma_points_are_audited_alike():
    model, evidence = drive(ON_A_LINE, 1002)
    for answer in (
        pgm.filter(model, evidence),
        pgm.smooth(model, evidence, lineariser=pgm.Unscented(), iterations=30, damping=0.5),
    ):
        found = pgm.audit(answer, rng=0)
        assert found.suspect
        assert found.modes >= 1


def test_robust_noise_has_its_mirror_image_too():
    model, evidence = drive(ON_A_LINE, 3, noise=pgm.Huber(2.0))
    found = pgm.audit(pgm.smooth(model, evidence, **CAREFUL), rng=0)
    assert found.suspect
    assert found.modes == 1


gauge = pgm.Variable("gauge", components=("east",))


@pytest.mark.parametrize("beacons", [ON_A_LINE, IN_THE_PLANE])
def test_beside_an_exact_sensor_a_mode_is_told_though_not_drawn_from(beacons):
    model, evidence = drive(beacons, 1)
    exact = pgm.LinearGaussianCPD(gauge, {place: [[1.0, 0.0]]}, cov=0.0)
    model = model.replace(observation=[*model.observation, exact])
    evidence = dict(evidence) | {gauge: pgm.sightings([[0.3], [0.8]], step=[5, 15])}
    answer = pgm.smooth(model, evidence, **CAREFUL)
    found = pgm.audit(answer, rng=0)
    assert found.modes == 0
    if beacons is IN_THE_PLANE:
        assert found.trusted
        assert found.missed == 0.0
        return
    other = pgm.smooth(model, evidence, start={place: answer[place].mean * [1, -1]}, **CAREFUL)
    weight = np.exp(other.log_evidence - answer.log_evidence)
    assert not found.trusted
    assert found.missed == pytest.approx(weight / (1.0 + weight), abs=0.01)
    assert "not drawn from" in repr(found)


where, speed, seen = pgm.variables("where speed seen")


def corridor(variance, pace):
    """Doors at every second metre."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(where, 0.0, variance)],
        [pgm.LinearGaussianCPD(where, {where.previous: 1.0, speed: 1.0}, cov=0.0025)],
        [pgm.NonlinearGaussianCPD(seen, where, lambda x: np.sin(np.pi * x), cov=0.01)],
    )
    steps = pgm.sightings(step=np.arange(1, STEPS + 1))
    given = {speed: np.full((STEPS, 1), pace), seen: steps}
    return model, model.sample(given, rng=1).evidence


@pytest.mark.parametrize(
    ("variance", "pace", "several"), [(1.0, 0.1, True), (9.0, 0.1, True), (0.01, 0.0, False)]
)
def test_a_corridor_of_doors_all_alike(variance, pace, several):
    model, evidence = corridor(variance, pace)
    answer = pgm.smooth(model, evidence, **CAREFUL)
    exact = pgm.smooth(model, evidence, belief=pgm.Grid({"where": (-14.0, 16.0, 1200)}))
    divergence = furthest(where, exact[where], answer[where])
    assert divergence > 50.0 if several else divergence < 0.1
    found = pgm.audit(answer, rng=0)
    assert found.suspect == several
    assert (found.modes > 0) == several
    assert found.trusted or several


number, square = pgm.variables("number square")


@pytest.mark.parametrize(("reading", "told"), [(4.0, True), (100.0, True), (1e4, False)])
def test_a_squared_measurement_far_beyond_the_prior(reading, told):
    """The other root is so many deviations from the prior that draws of it hardly get there."""
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(number, 0.3, 1.0),
            pgm.NonlinearGaussianCPD(square, number, lambda x: x**2, 0.01),
        ]
    )
    root = np.sqrt(reading)
    schedule = pgm.Calibration(iterations=30)
    answer = pgm.infer(
        pgm.compile(network), {square: reading}, schedule=schedule, start={number: root}
    )
    found = pgm.audit(answer, rng=0)
    lost = 1.0 / (1.0 + np.exp(2.0 * 0.3 * root))
    assert found.suspect == told == (lost > 1e-4)
    assert found.trusted
    mean = (1.0 - 2.0 * lost) * answer[number].mean
    np.testing.assert_allclose(found.corrected[number].mean, mean, rtol=0.1, atol=0.02)


def test_draws_with_modes_come_from_the_density_that_is_told():
    """The mean of q/r, and of d/r, over draws of both is one half each."""
    model, evidence = drive(ON_A_LINE, 5, runs=(2,))
    chain = ChainDraws.make(pgm.smooth(model, evidence, **CAREFUL)._outcome)
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(number, 0.3, 1.0),
            pgm.NonlinearGaussianCPD(square, number, lambda x: x**2, 0.01),
        ]
    )
    answer = pgm.infer(pgm.compile(network), {square: 4.0}, start={number: 2.0})
    for draws in (chain, TreeDraws.make(answer._outcome)):
        assert len(draws.modes.paths) >= 1
        rng = np.random.default_rng(1)
        both = [draws.draw(8_000, rng, defensive=kind) for kind in (False, True)]
        logs = [np.logaddexp(each.gaussian, each.defensive) for each in both]
        shares = [np.exp(e.defensive - log) for e, log in zip(both, logs, strict=True)]
        mean = sum(each.mean(axis=-1) for each in shares)
        error = np.sqrt(sum(each.var(axis=-1) / each.shape[-1] for each in shares))
        assert (error < 0.02).all()
        assert (np.abs(mean - 1.0) < 4 * error).all()


def points(mean, log_evidence):
    """Fixed points (C,) of one run and one component, of unit variance."""
    mean, log_evidence = (np.array(each, dtype=float)[:, None] for each in (mean, log_evidence))
    return FixedPoints(mean[..., None], np.ones((len(mean), 1, 1)), log_evidence, np.zeros(1, bool))


def test_modes_are_distinct_and_the_likeliest_first():
    nothing, one = np.zeros((1, 1)), np.ones((1, 1))
    found = choose(
        points([0.1, 5.0, 5.4, -7.0, 9.0], [0.0, 1.0, 0.5, np.log(0.5), -20.0]), nothing, one
    )
    assert APART == 1.0
    np.testing.assert_array_equal(found.index[:, 0], [1, 3])
    weights = np.exp([1.0, np.log(0.5)])
    due = SHARE * (0.8 * weights / weights.sum() + 0.1)
    np.testing.assert_allclose(found.shares[:, 0], due)
    assert found.missed == 0.0


def test_modes_beyond_the_most_are_missed_by_their_evidence():
    nothing, one = np.zeros((1, 1)), np.ones((1, 1))
    every = points([0.0, 5.0, -7.0], [0.0, 0.0, np.log(0.5)])
    assert choose(every, nothing, one, most=1).missed == pytest.approx(0.5 / 2.5)
    assert choose(every, nothing, one, most=0).missed == pytest.approx(1.5 / 2.5)
    failed = points([0.0, 5.0], [-np.inf, -np.inf])
    assert np.isnan(choose(failed, nothing, one).missed)


def test_without_other_modes_draws_are_those_of_excursions():
    rng = np.random.default_rng(0)
    before = rng.bit_generator.state
    assert (Modes.none(3).drawn(5, rng) == 0).all()
    assert rng.bit_generator.state == before


def test_runs_in_parts_have_the_modes_of_all_at_once(monkeypatch):
    model, evidence = drive(ON_A_LINE, 1, runs=(3,))
    answer = pgm.smooth(model, evidence, **CAREFUL)
    whole = ChainDraws.make(answer._outcome).modes
    monkeypatch.setattr(chain_modes, "ROOM", 1)
    parts = ChainDraws.make(answer._outcome).modes
    np.testing.assert_allclose(parts.shares, whole.shares, atol=1e-6)
    for one, other in zip(parts.paths, whole.paths, strict=True):
        np.testing.assert_allclose(one.first.offset, other.first.offset, atol=1e-3)


def test_a_function_that_starts_leave_is_searched_as_far_as_it_goes():
    """A logarithm, defined east of the origin alone: half of the starts are outside."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(where, 1.0, 0.5)],
        [pgm.LinearGaussianCPD(where, {where.previous: 1.0}, cov=0.01)],
        [pgm.NonlinearGaussianCPD(seen, where, np.log, cov=0.01)],
    )
    answer = pgm.smooth(model, {seen: np.full((8, 1), 0.7)}, **CAREFUL)
    found = pgm.audit(answer, rng=0)
    assert found.trusted
    assert not found.suspect
    assert found.missed == 0.0
