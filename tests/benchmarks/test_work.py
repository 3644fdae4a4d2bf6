import json

import numpy as np
import pytest

import pgm
from benchmarks import command
from benchmarks.libraries import pgm_scans
from benchmarks.work import repository, robots, scans, tables, targets
from models import sensors


@pytest.mark.parametrize("own_controls", [False, True])
def test_drives_are_the_motion_models_steps(own_controls):
    work = robots.draw(3, 30, own_controls=own_controls)
    noise = np.random.default_rng(1).normal(size=(3, 30, 3))
    x = np.array([[1.0, 2.0, 0.5]] * 3)
    poses = [x]
    for k in range(30):
        x = robots.DRIVE(x, work.controls[..., k, :] * np.ones((3, 1))) + noise[:, k]
        poses.append(x)
    found = robots.drive(work.controls, noise, poses[0])
    np.testing.assert_allclose(found, np.stack(poses, axis=1), rtol=0, atol=1e-12)


def test_dead_reckoning_has_the_motions_drift_only():
    work = robots.draw(1, 500, motion_std=(0.0, 0.0, 0.0), start_std=(0.0, 0.0, 0.0))
    np.testing.assert_allclose(work.dead_reckoning(0), work.truth[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("runs", "steps"), [(1_000, 200), (10_000, 1), (1, 10_000)])
def test_no_bearing_comes_near_a_half_turn(runs, steps):
    """Libraries that do not wrap angles then need not."""
    readings = robots.draw(runs, steps).readings
    assert np.abs(readings[..., 1]).max() < 2.8
    assert readings[..., 0].min() > 2.0


def test_readings_have_the_sensors_noise():
    work = robots.precise(5_000)
    exact = sensors.range_bearing(
        np.broadcast_to(work.truth[:, 1:, None], (1, 5_000, 4, 3)), work.landmarks
    )
    noise = (work.readings - exact).reshape(-1, 2)
    np.testing.assert_allclose(noise.std(axis=0), np.sqrt(np.diag(work.sensor_cov)), rtol=0.03)
    assert len(np.unique(work.landmarks.reshape(-1, 2), axis=0)) == 5_000 / 50 * 4


def test_targets_move_as_their_network_says():
    work = targets.draw(2_000)
    p = work.parameters
    assert p.F.shape == (4, 4)
    # What is left of the readings after two differences is noise of the motion and of the sensor.
    second = np.diff(work.readings, 2, axis=0)
    motion = p.motion_cov[0, 0] + p.motion_cov[0, 0]  # of neighbours in time
    motion += 2 * targets.DT * p.motion_cov[0, 2] * -1 + targets.DT**2 * p.motion_cov[2, 2]
    expected = motion + 6.0 * p.sensor_cov[0, 0]
    np.testing.assert_allclose(second.var(axis=0), expected, rtol=0.15)


def test_scans_are_of_sixty_beams_where_the_robot_is():
    work = scans.draw(100)
    assert work.beams == 60
    assert work.units == 100 * 60 * (scans.STEPS + 1)
    met = work.map.cast(work.poses, work.angles, 50.0)
    assert np.median(np.abs(met - work.scans)) < 0.1
    last = pgm_scans.filtering(scans.draw(2_000)).call()
    np.testing.assert_allclose(last, work.poses[-1], atol=0.3)


def test_sets_are_of_five_leaves_and_each_of_its_own():
    pytest.importorskip("pgmpy", reason="the networks come with pgmpy")
    tasks = repository.several("alarm", 3)
    network = tasks[0].network
    parents = {parent for cpd in network.cpds for parent in cpd.given}
    for task in tasks:
        assert len(task.evidence) == repository.OBSERVED
        assert not parents & set(task.evidence)
        assert set(task.hidden) | set(task.evidence) == set(network.variables)
    assert tasks[0].evidence != tasks[1].evidence
    assert repository.several("alarm", 1)[0].evidence == tasks[0].evidence
    sets = repository.many("alarm", 50)
    seen = np.array(list(sets.evidence.values())) >= 0
    assert seen.shape[1] == sets.count == 50
    assert (seen.sum(axis=0) == repository.OBSERVED).all()
    assert len({tuple(column) for column in seen.T}) > 30


def test_networks_that_are_not_here_leave_their_rows_out(monkeypatch, tmp_path, capsys):
    repository.read.cache_clear()
    monkeypatch.setattr(repository, "find_spec", lambda name: None)
    names = "repository_asia,sets_asia,reading_asia,discrete_asia"
    command.main(["--quick", "--only", names, "--repeats", "1", "--out", str(tmp_path)])
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert "discrete_asia" in summary
    assert "reading_asia" not in summary
    told = " ".join(capsys.readouterr().out.split())
    for name in names.split(",")[:3]:
        assert f"{name} is left out: the networks' files come with pgmpy" in told
    with pytest.raises(ImportError, match="come with pgmpy"):
        repository.path("asia")


def test_the_random_network_is_as_wide_as_was_meant():
    task = tables.random()
    assert len(task.evidence) == tables.OBSERVED
    assert len(task.hidden) == tables.NODES - tables.OBSERVED
    assert pgm.compile(task.network).width <= 8
