"""Likelihood fields against one beam at a time."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.distance import cdist
from scipy.stats import norm

import pgm
from pgm.errors import EvidenceError, LinearisationError, ModelError
from pgm.maps import LikelihoodField, OccupancyMap

MOUNT = np.array([0.15, -0.05, 0.3])
SET = {"most": 2.5, "std": 0.08, "hit": 0.7, "random": 0.2, "distance": 0.6}


@pytest.fixture(scope="module")
def field(x, z, building, angles):
    return LikelihoodField(z, x, building, angles=angles, mount=MOUNT, **SET)


def terms(map, angles, scan, pose):
    """The log-likelihood of each beam of a scan at a pose; 0 of those that say nothing."""
    corners = np.argwhere(map.obstacles)
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    turned = [cos * MOUNT[0] - sin * MOUNT[1], sin * MOUNT[0] + cos * MOUNT[1], MOUNT[2]]
    sensor = pose + np.array(turned)
    found = []
    for angle, distance in zip(angles, scan, strict=True):
        if np.isnan(distance) or distance >= SET["most"]:
            found.append(0.0)
            continue
        turn = sensor[2] + angle
        end = sensor[:2] + distance * np.array([np.cos(turn), np.sin(turn)])
        away = (end - map.origin[:2]) @ [
            [np.cos(map.origin[2]), -np.sin(map.origin[2])],
            [np.sin(map.origin[2]), np.cos(map.origin[2])],
        ]
        column, row = np.floor(away / map.resolution)
        near = cdist([[row, column]], corners).min() * map.resolution
        near = min(near, SET["distance"])
        inside = 0 <= row < map.shape[0] and 0 <= column < map.shape[1]
        known = inside and not np.isnan(map.occupied[int(row), int(column)])
        share = SET["hit"] if known else 0.0
        density = share * norm.pdf(near, scale=SET["std"]) + SET["random"] / SET["most"]
        found.append(np.log(density))
    return np.array(found)


@pytest.fixture(scope="module")
def poses(building):
    """Poses in the building and around it."""
    rng = np.random.default_rng(5)
    return np.array([6.0, 0.0, 0.0]) + rng.normal(size=(60, 3)) * [2.0, 2.0, 3.0]


@pytest.fixture(scope="module")
def scan(building, angles):
    found = building.cast([6.0, -0.6, 0.4], angles, SET["most"])
    found += np.random.default_rng(6).normal(0.0, 0.05, size=found.shape)
    found[[2, 7]], found[4] = np.nan, SET["most"]
    return np.minimum(found, SET["most"])


def test_one_scan_at_many_poses(field, building, angles, scan, poses, x):
    due = [terms(building, angles, scan, pose).sum() for pose in poses]
    found = field.log_density(scan, {x: poses})
    assert_allclose(found, due, rtol=2e-6)
    assert np.ptp(found) > 5.0
    assert_allclose(field.log_density(scan, {x: poses.reshape(5, 12, 3)}).ravel(), found)


def test_a_scan_of_its_own_for_each_pose(field, building, angles, scan, poses, x):
    scans = scan * np.random.default_rng(7).uniform(0.5, 1.0, size=(60, 1))
    scans[:5] = np.nan
    due = [terms(building, angles, *both).sum() for both in zip(scans, poses, strict=True)]
    found = field.log_density(scans, {x: poses})
    assert_allclose(found, due, rtol=2e-6)
    assert not found[:5].any()
    crossed = field.log_density(scans[:, None], {x: poses[:7]})
    assert_allclose(crossed[3:7, 3:7].diagonal(), found[3:7], rtol=1e-5)


def test_many_poses_are_blocks_of_few(x, z, building, angles, scan):
    poses = np.random.default_rng(8).normal([6.0, 0.0, 0.0], size=(9000, 3))
    field = LikelihoodField(z, x, building, angles=angles, **SET)
    found = field.log_density(scan, {x: poses})
    few = [field.log_density(scan, {x: part}) for part in np.array_split(poses, 100)]
    assert_allclose(found, np.concatenate(few), rtol=1e-6)


def test_some_beams_and_a_power(x, z, building, angles, scan, poses):
    kept = LikelihoodField(z, x, building, angles=angles, mount=MOUNT, every=3, weight=0.25, **SET)
    assert kept.beams == 4
    due = [0.25 * terms(building, angles, scan, pose)[::3].sum() for pose in poses]
    assert_allclose(kept.log_density(scan, {x: poses}), due, rtol=2e-6)


def test_ends_in_cells_of_which_nothing_is_known_are_random(x):
    z = pgm.Variable("z")
    wall = OccupancyMap([[0, 0, 0.4, 1, 0.4, np.nan]], 0.1)
    field = LikelihoodField(z, x, wall, angles=[0.0], most=9.0, std=0.1)
    found = field.log_density([[0.1], [0.2], [0.3], [0.4], [0.5], [0.6]], {x: [0.05, 0.05, 0.0]})
    assert found[0] < found[1] < found[2]
    assert found[3] == found[1]
    assert_allclose(found[4:], np.log(0.05 / 9.0), rtol=1e-6)


def test_particles_take_scans_of_which_beams_are_missing(building, x, z, scan, angles):
    field = LikelihoodField(z, x, building, angles=angles, mount=MOUNT, weight=0.2, **SET)
    move = pgm.LinearGaussianCPD(x, {x.previous: np.eye(3)}, cov=np.diag([1e-3] * 3))
    model = pgm.DynamicBayesianNetwork([building.uniform(x)], [move], [field])
    scans = np.stack([scan, np.full_like(scan, np.nan), np.roll(scan, 1)])
    cloud = pgm.Particles(300, seed=1, threshold=1.0)
    found = pgm.filter(model, {z: scans}, belief=cloud)
    # All particles weigh the same before each step.
    beliefs = [found[x.at(step)] for step in (1, 2)]
    states = beliefs[0].states
    due = 0.2 * np.array([terms(building, angles, scan, pose).sum() for pose in states])
    due -= np.logaddexp.reduce(due)
    assert_allclose(np.log(beliefs[0].weights), due, atol=2e-4)
    assert_allclose(beliefs[1].weights, 1.0 / 300)  # nothing was seen
    runs = np.stack([scans, np.roll(scans, 2, axis=-1)])
    batch = pgm.filter(model, {z: runs}, belief=cloud)
    assert_allclose(batch[x][0].mean, found[x].mean, atol=1e-4)
    robot = pgm.OnlineFilter(model, belief=cloud)
    belief = robot.initial()
    for scan in scans:
        belief = robot.update(robot.predict(belief), {z: scan})
    assert_allclose(belief[x].mean, found[x].mean[3], atol=1e-4)
    light = pgm.filter(model, {z: scans}, belief=pgm.Particles(300, seed=1, dtype=np.float32))
    assert np.isfinite(light.log_evidence)


def test_no_poses_and_no_beams(field, scan, x):
    assert field.log_density(scan, {x: np.zeros((0, 3))}).shape == (0,)
    assert field.log_density(np.zeros((0, 12)), {x: np.zeros(3)}).shape == (0,)
    assert field.log_density(np.full(12, np.nan), {x: [6.0, 0.0, 0.0]}) == 0.0


def test_values_that_are_none(field, scan, x):
    with pytest.raises(LinearisationError, match=r"a pose is .* look for what the motion"):
        field._log_density(scan, _known(x, [[1.0, np.nan, 0.0]]))
    with pytest.raises(ModelError, match="NaN or infinite"):
        field.log_density(scan, {x: [1.0, np.inf, 0.0]})
    with pytest.raises(ModelError, match="entries that are infinite"):
        field.log_density(np.full_like(scan, np.inf), {x: [1.0, 1.0, 0.0]})
    with pytest.raises(EvidenceError, match=r"has the range -0\.5"):
        field.log_density(np.full_like(scan, -0.5), {x: [1.0, 1.0, 0.0]})
    with pytest.raises(ModelError, match="cannot be drawn from"):
        field.sample({x: [1.0, 1.0, 0.0]}, rng=1)


def _known(variable, values):
    from pgm.cpds.base import Known

    values = np.array(values)
    return Known({variable: values}, (len(values),), (len(values),), 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"std": 0.0}, "std must be a number above 0"),
        ({"hit": 0.9, "random": 0.2}, "0.9 and 0.2, shares that make more than 1"),
        ({"random": 0.0}, "random must be a number above 0 to 1"),
        ({"distance": -1.0}, "distance must be"),
        ({"most": np.inf}, "most, must be a number above 0, not inf"),
        ({"every": 0}, "every is a whole number, 1 or more, not 0"),
        ({"weight": 1.5}, "weight must be a number above 0 to 1"),
        ({"mount": [0.0, 0.0]}, "mount has shape"),
        ({"angles": [0.0]}, "1 angles of 12 beams"),
        ({"angles": [[0.0]]}, "angles of beams have shape"),
        ({"map": np.zeros((3, 3))}, "its map is an OccupancyMap"),
        ({"map": OccupancyMap(np.zeros((3, 3)), 1.0)}, "has no obstacle"),
        ({"given": pgm.variables("a b")}, "given one variable, the pose"),
        ({"given": pgm.Variable("a", components=("x", "y", "t"))}, "is no pose"),
    ],
)
def test_bad_fields(x, z, building, angles, change, message):
    arguments = {"child": z, "given": x, "map": building, "angles": angles} | SET | change
    with pytest.raises(ModelError, match=message):
        LikelihoodField(**arguments)


def test_gaussian_beliefs_refuse_it(field, building, x, z, scan):
    move = pgm.LinearGaussianCPD(x, {x.previous: np.eye(3)}, cov=np.eye(3))
    prior = pgm.GaussianCPD(x, np.zeros(3), np.eye(3))
    model = pgm.DynamicBayesianNetwork([prior], [move], [field])
    with pytest.raises(ModelError, match="is no Gaussian CPD"):
        pgm.filter(model, {z: scan[None]})


def test_a_scan_that_fits_needs_few_particles():
    """Peaks are those of a pose whose beams end at walls, and particles are counted by them."""
    walls = np.zeros((40, 60))
    walls[[0, -1]] = walls[:, [0, -1]] = 1.0
    plan = OccupancyMap(walls, resolution=0.25)
    angles = np.linspace(-1.5, 1.5, 9)
    robot = pgm.Variable("robot", components=("x", "y", "heading"), angles=("heading",))
    scan = pgm.Variable("scan", components=tuple(f"b{k}" for k in range(9)))
    field = LikelihoodField(scan, robot, plan, angles=angles, most=8.0, std=0.3, weight=0.3)
    true = np.array([5.0, 5.0, 0.4])
    ranges = np.minimum(plan.cast(true[None], angles, 8.0)[0] + 0.125, 8.0)
    ranges[2] = np.nan
    peak = field._log_peak(ranges)
    near = field.log_density(ranges, {robot: true})
    assert peak - 0.5 < near < peak + 1e-6
    world = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(robot, mean=true, cov=np.diag([0.1, 0.1, 0.02]) ** 2)],
        transition=[
            pgm.LinearGaussianCPD(
                robot, given={robot.previous: np.eye(3)}, cov=np.diag([0.05, 0.05, 0.02]) ** 2
            )
        ],
        observation=[field],
    )
    number = pgm.LikelihoodSampling(40.0, least=50, most=2000)
    belief = pgm.Particles(300, number=number)
    seen = pgm.filter(world, {scan: ranges[None]}, belief=belief)
    away = pgm.GaussianCPD(robot, mean=true + 2.0, cov=0.01 * np.eye(3))
    far = world.replace(prior=[away])
    lost = pgm.filter(far, {scan: ranges[None]}, belief=belief)
    assert seen.status.number[1] <= 100
    assert lost.status.number[1] > 4 * seen.status.number[1]


def test_an_injection_counts_the_beams_in_use():
    """Each third beam of a scan injects as a scan of these beams does."""
    walls = np.zeros((40, 60))
    walls[[0, -1]] = walls[:, [0, -1]] = walls[15, 10:40] = 1.0
    plan = OccupancyMap(walls, resolution=0.25)
    angles = np.linspace(-1.5, 1.5, 30)
    robot = pgm.Variable("robot", components=("x", "y", "heading"), angles=("heading",))
    cells = pgm.CellProposal(robot, plan.poses(1.0, 8), [1.0, 1.0, np.pi / 4])
    injection = pgm.Injection(cells, slow=0.1, fast=0.9)
    places = np.array([[5.0, 7.0, 0.4]] * 2 + [[12.0, 2.0, -1.0]] * 2)
    ranges = plan.cast(places, angles, 8.0)

    def injected(beams, every):
        scan = pgm.Variable("scan", components=tuple(f"b{k}" for k in range(len(beams))))
        field = LikelihoodField(scan, robot, plan, angles=beams, most=8.0, std=0.3, every=every)
        world = pgm.DynamicBayesianNetwork(
            prior=[pgm.GaussianCPD(robot, mean=places[0], cov=0.01 * np.eye(3))],
            transition=[
                pgm.LinearGaussianCPD(
                    robot, given={robot.previous: np.eye(3)}, cov=0.001 * np.eye(3)
                )
            ],
            observation=[field],
        )
        scans = ranges if every == 3 else ranges[:, ::3]
        belief = pgm.Particles(400, injection=injection)
        return pgm.filter(world, {scan: scans}, belief=belief).status.injected

    few = injected(angles[::3], 1)
    assert few.sum() > 50
    np.testing.assert_array_equal(injected(angles, 3), few)
