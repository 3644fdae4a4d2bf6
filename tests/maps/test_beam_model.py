"""The beam model: its density, its draws, and its expected ranges."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.stats import expon, kstest, truncnorm

import pgm
from pgm.errors import ModelError
from pgm.maps import BeamModel, OccupancyMap

SET = {"hit": 0.6, "short": 0.15, "maximum": 0.05, "random": 0.2, "std": 0.2, "decay": 0.7}
MOST = 4.0
# Four cells of one metre, the last an obstacle; ranges ahead from a place are 3 − place.
WALL = OccupancyMap([[0.0, 0.0, 0.0, 1.0]], 1.0)
one = pgm.Variable("z")


@pytest.fixture(scope="module")
def ahead(x):
    return BeamModel(one, x, WALL, angles=[0.0], most=MOST, **SET)


def at(x, place, heading=0.0):
    return {x: [place, 0.5, heading]}


@pytest.mark.parametrize("place", [0.01, 1.5, 2.9, 3.5, -0.9])
@pytest.mark.parametrize("heading", [0.0, np.pi])
def test_densities_and_the_point_mass_sum_to_one(ahead, x, place, heading):
    def density(r):
        return np.exp(ahead.log_density(r, at(x, place, heading)))

    expected = WALL.cast([place, 0.5, heading], [0.0], MOST)[0]
    whole, _ = quad(density, 0.0, MOST, points=[0.0, min(expected, MOST)], limit=400)
    assert whole + density(MOST) == pytest.approx(1.0, abs=1e-6)
    assert density(MOST + 3.0) == density(MOST)


def test_the_density_is_the_mixture(ahead, x):
    ranges, expected = np.linspace(0.001, 3.99, 50), 1.8
    low, high = -expected / 0.2, (MOST - expected) / 0.2
    due = 0.6 * truncnorm.pdf(ranges, low, high, loc=expected, scale=0.2) + 0.2 / MOST
    early = expon.pdf(ranges, scale=1 / 0.7) / expon.cdf(expected, scale=1 / 0.7)
    due += np.where(ranges <= expected, 0.15 * early, 0.0)
    found = ahead.log_density(ranges[:, None], at(x, 3.0 - expected))
    assert_allclose(np.exp(found), due, rtol=1e-10)
    assert ahead.log_density(MOST, at(x, 1.2)) == pytest.approx(np.log(0.05))
    nothing = ahead.log_density(MOST, at(x, 1.2, np.pi))
    assert nothing == pytest.approx(np.log(0.65))  # where nothing is expected


@pytest.mark.parametrize(("place", "heading"), [(0.2, 0.0), (2.8, 0.0), (1.0, np.pi), (3.4, 0.0)])
def test_draws_have_the_density(ahead, x, place, heading):
    drawn = ahead.sample(at(x, place, heading), size=4000, rng=2)[:, 0]
    most = (drawn == MOST).mean()
    mass = np.exp(ahead.log_density(MOST, at(x, place, heading)))
    assert abs(most - mass) < 4.0 * np.sqrt(mass * (1 - mass) / 4000)
    edges = np.linspace(0.0, MOST, 40_001)
    middles = 0.5 * (edges[1:] + edges[:-1])
    density = np.exp(ahead.log_density(middles[:, None], at(x, place, heading)))
    below = np.append(0.0, np.cumsum(density * np.diff(edges))) / (1.0 - mass)
    found = kstest(drawn[drawn < MOST], lambda r: np.interp(r, edges, below))
    assert found.pvalue > 1e-3


def test_scans_are_products_of_beams(building, x, z, angles):
    mount = [0.1, 0.05, -0.2]
    cpd = BeamModel(z, x, building, angles=angles, most=2.5, mount=mount, **SET)
    poses = building.poses(0.6, 2)[:20]
    scans = cpd.sample({x: poses}, rng=3)
    found = cpd.log_density(scans, {x: poses})
    due = np.zeros((20, len(angles)))
    for k, angle in enumerate(angles):
        single = BeamModel(one, x, building, angles=[angle], most=2.5, mount=mount, **SET)
        due[:, k] = single.log_density(scans[:, [k]], {x: poses})
    assert_allclose(found, due.sum(axis=1))
    scans[:, 3] = np.nan
    assert_allclose(cpd.log_density(scans, {x: poses}), due.sum(axis=1) - due[:, 3])
    shared = cpd.log_density(scans[0], {x: poses})
    assert_allclose(shared[0], cpd.log_density(scans[0], {x: poses[0]}))
    sparse = BeamModel(
        z, x, building, angles=angles, most=2.5, mount=mount, every=4, weight=0.5, **SET
    )
    assert sparse.beams == 3
    assert_allclose(sparse.log_density(scans, {x: poses}), 0.5 * due[:, ::4].sum(axis=1))
    sensor = cpd.sample({x: poses}, size=(2, 3), rng=1)
    assert sensor.shape == (2, 3, 20, len(angles))


def test_expected_ranges_are_those_cast(building, x, z, angles):
    cpd = BeamModel(z, x, building, angles=angles, most=2.5, every=2, through_unknown=False, **SET)
    poses = building.poses(0.6, 2)[:20]
    due = building.cast(poses, angles[::2], 2.5, through_unknown=False)
    assert_allclose(cpd.expected(poses), due)


def test_without_random_ranges_some_are_impossible(x):
    pure = BeamModel(
        one, x, WALL, angles=[0.0], most=MOST, hit=1.0, short=0.0, maximum=0.0, random=0.0, std=0.01
    )
    assert np.isneginf(pure.log_density(MOST, at(x, 1.0)))
    assert np.isneginf(pure.log_density(0.5, at(x, 1.0)))
    assert np.isfinite(pure.log_density(2.0, at(x, 1.0)))


def test_networks_draw_scans_and_particles_find_the_pose(building, x, z, angles):
    mask = building.connected(building.centres(5, 5))
    start = pgm.GaussianCPD(x, [*building.centres(8, 10), 1.0], np.diag([1e-4] * 3))
    move = pgm.LinearGaussianCPD(x, {x.previous: np.eye(3)}, cov=np.diag([1e-4] * 3))
    sensor = BeamModel(z, x, building, angles=angles, most=2.5, std=0.1, weight=0.2)
    model = pgm.DynamicBayesianNetwork([start], [move], [sensor])
    drawn = model.sample({}, steps=6, rng=4)
    lost = model.replace(prior=[building.uniform(x, mask)])
    found = pgm.filter(lost, drawn.evidence, belief=pgm.Particles(6000, seed=1))
    error = found[x.at(6)].mean - drawn[x][6]
    assert np.hypot(*error[:2]) < 0.1
    assert abs(np.exp(1j * error[2]) - 1.0) < 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"hit": 0.7}, "sum to 1.1; 1 was due"),
        ({"short": -0.1}, "short must be a number from 0 to 1"),
        ({"decay": 0.0}, "decay must be a number above 0"),
        ({"std": np.nan}, "std must be a number above 0"),
    ],
)
def test_bad_models(x, change, message):
    with pytest.raises(ModelError, match=message):
        BeamModel(one, x, WALL, angles=[0.0], most=MOST, **(SET | change))
