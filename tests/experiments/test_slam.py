"""The map of a house: walls hide, the network is least squares, and the closing tells backwards."""

import json
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares

import pgm
from experiments import slam
from experiments.slam import drive as driving
from experiments.slam.drive import drive
from experiments.slam.judging import judged, misfit, shrinking
from experiments.slam.network import ANYWHERE, mapped
from experiments.slam.rooms import ROOM, rooms
from models.networks import landmark


def small(runs=2, seed=0):
    """Up to the closing, and a few steps on."""
    return drive(rooms(1), 60, 12, runs, np.random.default_rng(seed)).until(48)


@pytest.fixture(scope="module")
def found():
    return mapped(small())


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    out = tmp_path_factory.mktemp("slam")
    slam.run(out=out, seed=0, **slam.QUICK)
    return out, json.loads((out / "summary.json").read_text())


def crosses(a, b, c, d):
    """Whether the segments ab and cd have a point in common, by solving for it."""
    try:
        s, t = np.linalg.solve(np.column_stack([b - a, c - d]), c - a)
    except np.linalg.LinAlgError:  # parallel
        return False
    return 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0


@pytest.mark.parametrize("side", [1, 3])
def test_places_are_seen_where_no_wall_is_between(side):
    house = rooms(side)
    rng = np.random.default_rng(1)
    places = house.places(20, rng)
    eyes = rng.uniform(-8.0, 8.0, (30, 2)) * side
    seen = house.seen(eyes, places, 5.0)
    assert 0 < seen.sum() < seen.size
    for k, eye in enumerate(eyes):
        for j, place in enumerate(places):
            near = np.linalg.norm(place - eye) <= 5.0
            hidden = any(crosses(eye, place, *wall) for wall in house.walls)
            assert seen[k, j] == (near and not hidden)


@pytest.mark.parametrize(("side", "poses"), [(1, 60), (1, 80), (5, 2000)])
def test_the_robot_drives_through_doors_and_into_all_rooms(side, poses):
    made = drive(rooms(side), poses, 12 * side, 1, np.random.default_rng(0))
    places = made.truth[:, :2]
    for a, b in pairwise(places):
        assert not any(crosses(a, b, *wall) for wall in made.house.walls)
    outer = 0.5 * side * ROOM + 2.0
    in_rooms = (np.abs(places) > outer).any(axis=-1)
    visits = np.count_nonzero(np.diff(in_rooms.astype(int)) == 1)
    assert visits == 4 * side
    # One lap to the left; the turns within a room undo each other.
    assert abs(made.truth[-1, 2] - 2.0 * np.pi) < 0.3
    assert np.abs(np.diff(made.truth[:, 2])).max() < 0.6 * np.pi


def test_places_are_spread_over_the_walls():
    house = rooms(2)
    places = house.places(40, np.random.default_rng(0))
    begin, end = house.faces[:, 0], house.faces[:, 1]
    along = end - begin
    part = np.einsum("lfi,fi->lf", places[:, None] - begin, along) / (along**2).sum(axis=-1)
    nearest = begin + part.clip(0.0, 1.0)[..., None] * along
    assert np.linalg.norm(places[:, None] - nearest, axis=-1).min(axis=1).max() < 1e-12


def test_what_is_told_has_the_noise_that_the_model_says():
    made = drive(rooms(1), 80, 24, 400, np.random.default_rng(0))
    cos, sin = np.cos(made.truth[0, 2]), np.sin(made.truth[0, 2])
    u = made.odometry[:, 0]
    east, north = cos * u[:, 0] - sin * u[:, 1], sin * u[:, 0] + cos * u[:, 1]
    one = made.truth[0] + np.column_stack([east, north, u[:, 2]]) - made.truth[1]
    assert_allclose(one.std(axis=0), made.motion_std, rtol=0.1)
    away = made.landmarks[made.landmark] - made.truth[made.step, :2]
    due = np.arctan2(away[:, 1], away[:, 0]) - made.truth[made.step, 2]
    errors = made.sightings - np.column_stack([np.hypot(*away.T), due])
    errors[..., 1] = (errors[..., 1] + np.pi) % (2.0 * np.pi) - np.pi
    assert_allclose(errors.std(axis=(0, 1)), driving.SENSOR_STD, rtol=0.02)
    metres = made.way[-1] / 79
    assert made.motion_std[2] == pytest.approx(driving.TURN_STD * np.sqrt(metres), rel=0.05)


def residuals(made, run, poses, marks):
    """Steps, sightings and priors, each over its deviation, in plain sums."""
    out = []
    for t in range(made.steps):
        east, north, heading = poses[t]
        forward, left, turn = made.odometry[run, t]
        step = [
            east + np.cos(heading) * forward - np.sin(heading) * left,
            north + np.sin(heading) * forward + np.cos(heading) * left,
            heading + turn,
        ]
        out.append((poses[t + 1] - step) / made.motion_std)
    names = made.seen.tolist()
    for t, k, told in zip(made.step, made.landmark, made.sightings[run], strict=True):
        away = marks[names.index(k)] - poses[t, :2]
        turn = np.arctan2(away[1], away[0]) - poses[t, 2] - told[1]
        turn = (turn + np.pi) % (2.0 * np.pi) - np.pi
        out.append(np.array([np.hypot(*away) - told[0], turn]) / driving.SENSOR_STD)
    return np.concatenate([*out, marks.ravel() / ANYWHERE])


@pytest.mark.parametrize("run", [0, 1])
def test_the_map_is_least_squares_and_its_covariances_the_inverse(found, run):
    made = small()
    count = 3 * made.steps

    def of(v):
        poses = np.vstack([made.truth[0], v[:count].reshape(-1, 3)])
        return residuals(made, run, poses, v[count:].reshape(-1, 2))

    reckoned = made.reckoned()
    first = np.append(reckoned[run, 1:].ravel(), made.placed(reckoned)[run].ravel())
    due = least_squares(of, first, xtol=1e-14, ftol=1e-14)
    assert found.posterior.status.converged.all()
    means = np.append(found.poses.mean[run, 1:].ravel(), found.landmarks.mean[run].ravel())
    cov = np.linalg.inv(due.jac.T @ due.jac)
    deviations = np.sqrt(np.diag(cov))
    assert (np.abs(means - due.x) / deviations).max() < 1e-3
    for k in (0, 20, made.steps - 1):
        own = cov[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        assert_allclose(found.poses.cov[run, k + 1], own, rtol=1e-3, atol=1e-7)
    assert_allclose(found.landmarks.cov[run, -1], cov[-2:, -2:], rtol=1e-3, atol=1e-7)
    both = [misfit(each, one) for each, one in parts(made, found)]
    degrees = 2 * (len(made.step) - len(made.seen))
    square = np.sum(of(due.x)[: -2 * len(made.seen)] ** 2)
    assert both[run]["chi2"] == pytest.approx(square / degrees, rel=1e-4)


def parts(made, found):
    """Each run by itself."""
    for run in range(len(made.odometry)):
        one = type(found)(
            found.poses[run : run + 1],
            found.landmarks[run : run + 1],
            found.posterior,
            found.graph,
            found.seconds,
        )
        yield made.run(run), one


def test_a_start_elsewhere_has_the_same_map(found):
    other = mapped(small(), small().truth[None].repeat(2, axis=0))
    away = np.abs(other.poses.mean[:, 1:] - found.poses.mean[:, 1:]) / found.poses.std[:, 1:]
    assert away.max() < 1e-4


def test_the_closing_is_the_first_sighting_of_what_was_long_not_seen():
    made = drive(rooms(1), 80, 24, 1, np.random.default_rng(0))
    closing = made.closing
    before = made.until(closing - 1)
    again = set(made.landmark[made.step == closing].tolist())
    lately = set(before.landmark[before.step >= closing - made.steps // 2].tolist())
    assert again & set(before.landmark.tolist()) - lately
    for step in range(made.steps // 2 + 1, closing):
        seen = made.landmark[made.step == step]
        long_ago = made.landmark[made.step < step - made.steps // 2]
        lately = made.landmark[(made.step < step) & (made.step >= step - made.steps // 2)]
        assert not set(seen.tolist()) & set(long_ago.tolist()) - set(lately.tolist())
    short = before.until(made.steps // 3)
    with pytest.raises(pgm.EvidenceError, match="no loop is closed; ask for more landmarks"):
        _ = short.closing


def test_what_is_known_after_the_closing_is_never_less(quick):
    made = drive(rooms(1), 60, 12, 2, np.random.default_rng(0))
    before, after = (mapped(made.until(step)) for step in (made.closing - 1, made.closing))
    changed = shrinking(made, before, after)
    for kind in ("poses", "landmarks"):
        old, new = changed[kind]
        assert (new <= old * 1.02).all()
    assert 0.0 < changed["reach"] < made.way[made.closing]
    assert min(new / old for old, new in zip(*changed["poses"], strict=True)) < 0.8
    rows = quick[1]["closing"]["quarters"]
    ratios = [row["ratio"] for row in rows]
    assert ratios == sorted(ratios, reverse=True)


def test_normalised_errors_are_those_of_dense_sums(found):
    made = small()
    truth = made.landmarks[made.seen]
    errors = found.landmarks.mean - truth
    each = np.einsum("rli,rlij,rlj->rl", errors, np.linalg.inv(found.landmarks.cov), errors)
    by_run = each.mean(axis=1) / 2.0
    result = judged(found.landmarks, truth)
    assert result["nees"] == pytest.approx(by_run.mean())
    assert result["nees_error"] == pytest.approx(abs(by_run[0] - by_run[1]) / 2.0)
    assert result["rmse"] == pytest.approx(np.sqrt((errors**2).sum(axis=-1).mean()))


def test_the_map_knows_its_errors(quick):
    """Of 4 runs whose parts hang together: within four errors of the mean, at least .3 wide."""
    summary = quick[1]
    for kind in ("poses", "landmarks"):
        assert summary[kind]["rmse"] < 0.3 * summary["dead_reckoning"]
        assert abs(summary[kind]["nees"] - 1.0) < max(4.0 * summary[kind]["nees_error"], 0.3)
        assert summary[kind]["coverage"] > 0.8
    fit = summary["misfit"]
    assert fit["low"] < fit["chi2"] < fit["high"]
    assert summary["converged"] == 1.0
    for row in summary["filter"]:
        assert row["smoother_std"] < row["filter_std"]
    assert summary["filter"][-1]["filter_std"] < 0.6 * summary["filter"][-2]["filter_std"]


def test_the_page_has_figures_and_tables(quick):
    out, summary = quick
    figures = [part["figure"] for part in summary["page"] if "figure" in part]
    assert figures == [f"{n}.png" for n in ("closing", "shrinking", "nees", "cluster_graph")]
    for name in figures:
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    tables = [part for part in summary["page"] if "table" in part]
    assert [len(part["rows"]) for part in tables] == [3, 5, 1, 4]


def test_the_same_seed_gives_the_same_drive():
    first, second, other = (drive(rooms(1), 60, 12, 2, np.random.default_rng(s)) for s in (1, 1, 2))
    assert_array_equal(first.sightings, second.sightings)
    assert_array_equal(first.odometry, second.odometry)
    assert not np.array_equal(first.landmarks, other.landmarks)


def test_landmarks_that_are_not_seen_are_left_out(found):
    made = small()
    assert len(made.seen) < len(made.landmarks) or len(made.seen) == 12
    assert found.landmarks.mean.shape == (2, len(made.seen), 2)
    assert found.landmarks.scope == (landmark,)
    early = made.until(3)
    assert len(early.seen) < len(made.seen)
    assert mapped(early).landmarks.mean.shape == (2, len(early.seen), 2)
