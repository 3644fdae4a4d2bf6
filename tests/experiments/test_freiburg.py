"""The Freiburg exercise: its reader, its extended Kalman filter, and the particles' reference."""

import json
import tracemalloc

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from experiments import freiburg
from experiments.freiburg import exercise
from experiments.freiburg import log as recording
from experiments.freiburg.experiment import (
    STACKED,
    by_schedule,
    cell_count,
    dead_reckoning,
    divergences,
    furthest,
    largest_difference,
    smooth,
)
from experiments.freiburg.grid import cells, compared, gridded
from experiments.freiburg.particles import particle_filter
from models import networks
from models.networks import pose
from pgm import FileError, consistency

WORLD = "1 2 1\n2 0 4\n\n7 2.5 7\n"
SENSOR = """ODOMETRY 0.1 0.2 0.001
SENSOR 1 2.1 0.35
SENSOR 7 7.1 1.51
ODOMETRY 0.2 1.5 -0.2
ODOMETRY -0.1 0.4 3.0
SENSOR 2 3.2 -3.23
SENSOR 2 3.3 3.05
SENSOR 1 1.0 0.2
"""
# Mean KL of the filtered belief to a particle reference, of textbook implementations; the unscented
# filter's is of small points and all ranges of a step as one vector.
BASELINES = {
    ("alone", "Taylor"): 0.169,
    ("stacked", "unscented, α = 0.001"): 0.046,
    ("alone", "cubature"): 0.117,
    ("alone", "Gauss–Hermite 7"): 0.069,
}


def written(folder, sensor=SENSOR, world=WORLD):
    (folder / recording.SENSOR).write_text(sensor)
    (folder / recording.WORLD).write_text(world)
    return folder


@pytest.fixture(scope="module")
def recorded():
    folder = recording.find()
    if folder is None:
        pytest.skip("the Freiburg recording is not here; PGM_DATA may name its folder's folder")
    return recording.load(folder)


def test_a_recording_is_read(tmp_path):
    log = recording.load(written(tmp_path))
    assert log.landmarks.tolist() == [[2.0, 1.0], [0.0, 4.0], [2.5, 7.0]]
    assert log.odometry.tolist() == [[0.1, 0.2, 0.001], [0.2, 1.5, -0.2], [-0.1, 0.4, 3.0]]
    assert log.step.tolist() == [1, 1, 3, 3, 3]
    assert log.seen.tolist() == [1, 7, 2, 2, 1]
    assert log.ranges.tolist() == [2.1, 7.1, 3.2, 3.3, 1.0]
    assert log.sightings["bearing"].tolist() == [0.35, 1.51, -3.23, 3.05, 0.2]
    assert log.places.tolist() == [[2.0, 1.0], [2.5, 7.0], [0.0, 4.0], [0.0, 4.0], [2.0, 1.0]]


def test_a_recording_without_sightings_is_one(tmp_path):
    log = recording.load(written(tmp_path, "ODOMETRY 0.1 0.2 0.3\n"))
    belief = pgm.filter(exercise.network(), log.evidence)[pose]
    assert_allclose(belief.mean, dead_reckoning(log))


@pytest.mark.parametrize(
    ("sensor", "line", "told"),
    [
        ("ODOMETRY 1 2\n", 1, "found 3 words; `ODOMETRY rot1 trans rot2` was due"),
        ("ODOMETRY 1 2 3\nSENSOR 1 2 3 4\n", 2, "found 5 words; `SENSOR id range bearing`"),
        ("ODOMETRY 1 2 3\n\nLASER 1 2 3\n", 3, "found 'LASER'; ODOMETRY, SENSOR was due; skip="),
        ("ODOMETRY 1 two 3\n", 1, "'two'; .* in finite numbers"),
        ("ODOMETRY 1 nan 3\n", 1, "in finite numbers"),
        ("ODOMETRY 1 2 3\nSENSOR 1 inf 0\n", 2, "in finite numbers"),
        ("ODOMETRY 1 2 3\nSENSOR 3 2 3\n", 2, r"a landmark 3 that world\.dat does not have"),
        ("ODOMETRY 1 2 3\nSENSOR 1.5 2 3\n", 2, r"a landmark 1\.5 that"),
        ("ODOMETRY 1 2 3\nSENSOR 1 -2 3\n", 2, "a range of -2 m; 0 or more was due"),
        ("SENSOR 1 2 3\nODOMETRY 1 2 3\n", 1, "a sighting before the first ODOMETRY"),
    ],
)
def test_a_malformed_line_is_named(sensor, line, told, tmp_path):
    path = written(tmp_path, sensor) / recording.SENSOR
    with pytest.raises(FileError, match=told) as caught:
        recording.load(tmp_path)
    assert (caught.value.path, caught.value.line) == (str(path), line)
    assert str(caught.value).startswith(f"{path}, line {line}: ")


@pytest.mark.parametrize(
    ("world", "line", "told"),
    [
        ("1 2\n", 1, "found 2 words; `id east north` was due"),
        ("1 2 3\n1 4 5\n", 2, "found the landmark 1 for the second time"),
        ("1.5 2 3\n", 1, r"a landmark 1\.5; a whole number was due"),
        ("1 2 3\n\nx 1 1\n", 3, "in finite numbers"),
        ("inf 2 3\n", 1, "in finite numbers"),
        ("", None, "no landmarks; lines of id east north were due"),
    ],
)
def test_a_malformed_world_is_named(world, line, told, tmp_path):
    path = written(tmp_path, world=world) / recording.WORLD
    with pytest.raises(FileError, match=told) as caught:
        recording.load(tmp_path)
    assert (caught.value.path, caught.value.line) == (str(path), line)


def test_files_that_are_not_recordings(tmp_path):
    with pytest.raises(FileError, match=r"world\.dat cannot be read \(FileNotFoundError"):
        recording.load(tmp_path)
    written(tmp_path, "")
    with pytest.raises(FileError, match="no line of ODOMETRY"):
        recording.load(tmp_path)
    (tmp_path / recording.SENSOR).write_bytes(b"ODOMETRY \xff\xfe")
    with pytest.raises(FileError, match="0xff is no UTF-8"):
        recording.load(tmp_path)


def exercise_filter(log):
    """The exercise's extended Kalman filter: prediction_step and correction_step, sheet 7."""
    mu, sigma = np.zeros(3), np.eye(3)
    beliefs = [(mu, sigma)]
    for t, (rot1, trans, rot2) in enumerate(log.odometry, start=1):
        x, y, theta = mu
        mu = np.array(
            [
                x + trans * np.cos(theta + rot1),
                y + trans * np.sin(theta + rot1),
                theta + rot1 + rot2,
            ]
        )
        G = np.eye(3)
        G[:2, 2] = -trans * np.sin(theta + rot1), trans * np.cos(theta + rot1)
        sigma = G @ sigma @ G.T + np.diag([0.2, 0.2, 0.02])
        z = log.ranges[log.step == t]
        if z.size:
            away = mu[:2] - log.places[log.step == t]
            expected = np.sqrt((away**2).sum(axis=1))
            H = np.column_stack([away / expected[:, None], 0.0 * z])
            K = sigma @ H.T @ np.linalg.inv(H @ sigma @ H.T + 0.5 * np.eye(z.size))
            mu, sigma = mu + K @ (z - expected), (np.eye(3) - K @ H) @ sigma
        beliefs.append((mu, sigma))
    return [np.array(part) for part in zip(*beliefs, strict=True)]


def assert_the_exercise_s(log):
    belief = pgm.filter(exercise.network(), log.evidence, lineariser=pgm.Taylor())[pose]
    mean, cov = exercise_filter(log)
    assert_allclose(belief.mean, mean, rtol=0, atol=1e-9)
    assert_allclose(belief.cov, cov, rtol=0, atol=1e-9)
    return belief


def test_the_filter_is_the_exercise_s_on_a_few_lines(tmp_path):
    assert_the_exercise_s(recording.load(written(tmp_path)))


def test_the_filter_is_the_exercise_s_on_the_recording(recorded):
    assert len(recorded.odometry) == 331
    assert len(recorded.landmarks) == 9
    assert_the_exercise_s(recorded)


def test_ranges_may_be_linearised_as_one_vector(tmp_path):
    """It is the same for Taylor; sigma points then see errors that go together."""
    log = recording.load(written(tmp_path))
    one, all_ = smooth(log), smooth(log, grouped=True)
    assert_allclose(one["Taylor"][pose].mean, all_["Taylor"][pose].mean, atol=1e-12)
    assert np.abs(one["cubature"][pose].mean - all_["cubature"][pose].mean).max() > 1e-4


def test_particles_are_right_about_a_short_drive(tmp_path):
    """Against importance sampling: whole paths drawn from the motion, weighed by all ranges."""
    log = recording.load(written(tmp_path))
    found = particle_filter(log, 100_000, 1)
    rng, weight = np.random.default_rng(0), np.ones(400_000)
    x = rng.standard_normal((400_000, 3))
    for t, (rot1, trans, rot2) in enumerate(log.odometry, start=1):
        course = x[:, 2] + rot1
        x = x + np.column_stack([trans * np.cos(course), trans * np.sin(course), course - x[:, 2]])
        x += [0.0, 0.0, rot2] + np.sqrt([0.2, 0.2, 0.02]) * rng.standard_normal(x.shape)
        for place, heard in zip(log.places[log.step == t], log.ranges[log.step == t], strict=True):
            away = heard - np.linalg.norm(place - x[:, :2], axis=1)
            weight = weight * np.exp(-(away**2)) / np.sqrt(np.pi)  # of variance 1/2
        mean = np.average(x, axis=0, weights=weight)
        assert_allclose(found.belief.mean[t], mean, atol=0.03)
    assert found.log_evidence == pytest.approx(np.log(weight.mean()), abs=0.05)
    cov = np.cov(x.T, aweights=weight)
    assert_allclose(found.belief.cov[-1], cov, atol=0.05)
    assert found.cloud.shape == (4, 500, 3)
    assert_allclose(found.cloud[-1].mean(axis=0), mean, atol=0.2)
    assert 0.0 < found.effective.min() < found.effective[0] == pytest.approx(100_000)


def test_particles_of_past_steps_are_let_go(tmp_path):
    log = recording.load(written(tmp_path, "ODOMETRY 0.1 0.2 0.001\n" * 60))
    tracemalloc.start()
    try:
        particle_filter(log, 20_000, 1)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 20 * (20_000 * 3 * 8)  # sixty steps were three times as much


def test_divergences_are_to_the_reference(tmp_path):
    log = recording.load(written(tmp_path))
    posteriors = {"Taylor": pgm.filter(exercise.network(), log.evidence)}
    belief = posteriors["Taylor"].filtered[pose]
    wider = pgm.Gaussian(pose, belief.mean, 2.0 * belief.cov, steps=belief.steps)
    found = divergences(wider, posteriors)
    due = 0.5 * (3.0 - 3.0 * np.log(2.0))  # of a Gaussian from one of half its covariance
    assert found["Taylor"] == pytest.approx(dict.fromkeys(("mean", "median", "largest"), due))
    assert len(furthest(wider, posteriors)) == 1  # of four steps, which are near each other


def from_particles(log, count):
    """By way of linearising and lineariser, the divergences of the filters."""
    reference = particle_filter(log, count, 0).belief
    return {
        name: divergences(reference, smooth(log, grouped=grouped))
        for name, grouped in STACKED.items()
    }


@pytest.fixture(scope="module")
def by_particles(recorded):
    return from_particles(recorded, 100_000)


@pytest.fixture(scope="module")
def by_grid(recorded):
    """The same, from a grid that filters; no smoother is asked for."""
    posterior = pgm.filter(exercise.network(), recorded.evidence, belief=cells(recorded))
    assert posterior.status.outside < 1e-6
    return {
        name: pgm.compare(
            exercise.network(grouped=grouped),
            recorded.evidence,
            linearisers=exercise.LINEARISERS,
            schedules=[pgm.Filtering()],
            oracle=posterior,
        )
        for name, grouped in STACKED.items()
    }


@pytest.mark.slow
def test_linearisers_part_as_textbook_implementations_do(by_particles):
    """Within what 10⁵ particles leave: a tenth."""
    for (name, label), due in BASELINES.items():
        assert by_particles[name][label]["mean"] == pytest.approx(due, rel=0.1)


def assert_alike(grid, particles, within):
    for name, by_label in particles.items():
        for label, each in by_label.items():
            row = grid[name][label, "filter"]
            assert row.kl == pytest.approx(each["mean"], rel=within), (name, label)


@pytest.mark.slow
def test_the_grid_tells_what_particles_tell(by_grid, by_particles):
    """Particles are 10⁵ here, and leave some of the tenth that is allowed; 10⁶ below."""
    assert_alike(by_grid, by_particles, 0.1)


@pytest.mark.slow
def test_the_grid_tells_what_a_million_particles_tell(recorded, by_grid):
    assert_alike(by_grid, from_particles(recorded, 1_000_000), 0.05)


def test_a_grid_is_around_landmarks_and_start(tmp_path):
    log = recording.load(written(tmp_path))
    found = cells(log).cells
    for name, reach in (("east", (-6.0, 8.5)), ("north", (-6.0, 13.0))):
        low, high, count = found[name]
        assert low == reach[0]
        assert 0.0 <= high - reach[1] < 0.4 == pytest.approx((high - low) / count)
    assert found["heading"] == 48


def test_the_experiment_s_comparison_has_filters_and_smoothers(tmp_path):
    log = recording.load(written(tmp_path))
    grid = gridded(log)
    table = compared(log, grid.posterior)
    belief = pgm.smooth(exercise.network(), log.evidence, lineariser=pgm.Cubature())
    due = consistency.kl(grid.posterior[pose].gaussian(), belief[pose])
    assert_allclose(table["cubature", "smoother"].kl_by_step, due)
    by_word = by_schedule(table)["cubature"]
    assert by_word["smoother"] == pytest.approx({"mean": due.mean(), "largest": due.max()})
    assert cell_count(grid.posterior) == grid.posterior[pose].values[0].size
    alone = {"alone": {"cubature": {"mean": 2.0}}}
    twice = {"alone": {"cubature": {"filter": {"mean": 1.5}}}}
    assert largest_difference(alone, twice) == 0.25


def test_the_smoother_knows_more(recorded):
    posterior = smooth(recorded)["Taylor"]
    filtered, smoothed = posterior.filtered[pose].std, posterior[pose].std
    assert (smoothed <= filtered + 1e-12).all()
    assert smoothed[:-1].mean() < 0.9 * filtered[:-1].mean()


def test_everything_is_written(tmp_path):
    out = tmp_path / "out"
    freiburg.run(out=out, seed=0, path=written(tmp_path), particles=2000)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["settings"]["particles"] == 2000
    assert set(summary["divergence"]) == {"alone", "stacked"}
    for found in summary["divergence"].values():
        assert set(found) == set(exercise.LINEARISERS)
    assert summary["from_dead_reckoning"]["Taylor"].keys() == {"filter", "smoother"}
    assert set(summary["divergence_from_grid"]["alone"]) == set(exercise.LINEARISERS)
    assert summary["grid"]["cells"].startswith("Grid(east: ")
    for name in ("path", "filters", "divergence", "comparison", "beliefs"):
        assert (out / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (out / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_a_recording_that_is_not_there_is_told(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv(recording.VARIABLE, str(tmp_path))
    assert recording.find() is None
    freiburg.run(out=tmp_path / "out", seed=0)
    assert "the recording is not there; give its folder with --path" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()
    (tmp_path / "freiburg").mkdir()
    assert recording.find() is None
    assert recording.load(written(tmp_path / "freiburg")) is not None
    assert recording.find() == tmp_path / "freiburg"


def test_the_network_is_as_declared():
    model = networks.odometry_ranges(
        start=(1.0, 2.0, 0.5), start_std=(0, 0, 0), motion_std=(0.1, 0.2, 0.3), sensor_std=0.4
    )
    belief = pgm.filter(model, {networks.odometry: np.array([[0.5, 2.0, -0.25]])})[pose]
    mean = [1.0 + 2.0 * np.cos(1.0), 2.0 + 2.0 * np.sin(1.0), 0.75]
    assert_allclose(belief.mean[1], mean)
    assert_allclose(belief.cov[1], np.diag([0.01, 0.04, 0.09]), atol=1e-15)
