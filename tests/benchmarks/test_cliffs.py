"""Changed models must be what they are called, and find what a textbook's filter finds."""

import numpy as np
import pytest

from benchmarks import cliffs
from benchmarks.libraries import pgm_robots
from benchmarks.work import changes, robots
from models import sensors

BY_NAME = {change.name: change for change in cliffs.CHANGES}
DRIFT = np.array([[0.0], [0.0], [robots.DT]])


def textbook(work, *, noise=None, bias=False, iterations=1):
    """The extended Kalman filter of one robot after another, in absolute terms."""
    n = 4 if bias else 3
    H, F, Q = np.zeros((2, n)), np.eye(n), np.zeros((n, n))
    Q[:3, :3] = work.motion_cov if noise is None else np.diag(np.square(noise))
    P0 = np.zeros((n, n))
    P0[:3, :3] = work.start[1]
    if bias:
        P0[3, 3], Q[3, 3], F[:3, 3:] = changes.BIAS_STD**2, changes.DRIFT_STD**2, DRIFT
    means = np.empty((work.runs, work.steps, 3))
    covs = np.empty((work.runs, work.steps, 3, 3))
    for run in range(work.runs):
        x, P = np.zeros(n), P0
        for k in range(work.steps):
            F[:3, :3] = robots.DRIVE.by_state(x[:3], work.controls[k])
            moved = robots.DRIVE(x[:3], work.controls[k])
            x = np.concatenate([moved + DRIFT[:, 0] * x[3], x[3:]]) if bias else moved
            P = F @ P @ F.T + Q
            z, m = work.readings[run, k, 0], work.landmarks[k, 0]
            if not np.isnan(z).any():
                at = x
                for _ in range(iterations):
                    H[:, :3] = sensors.range_bearing_by_state(at[:3], m)
                    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + work.sensor_cov)
                    # No bearing comes near a half turn.
                    at = x + gain @ (z - sensors.range_bearing(at[:3], m) - H @ (x - at))
                x, P = at, (np.eye(n) - gain @ H) @ P
            means[run, k], covs[run, k] = x[:3], P[:3, :3]
    return means, covs


TEXTBOOK = {
    "missing": {},
    "second_state": {"bias": True},
    "no_jacobian": {},
    "singular": {"noise": changes.NOISE_STD},
    "grouped": {},
    "iterations": {"iterations": 2},
    "one_fewer": {},
    "own_taylor": {},
}


@pytest.mark.parametrize("name", BY_NAME)
@pytest.mark.parametrize("runs", [2, 40])
def test_changes_find_what_a_textbooks_filter_finds(name, runs):
    change = BY_NAME[name]
    work = change.work(robots.draw(runs, 25))
    found = pgm_robots.filtering(change.rule, work, change.iterations).call()
    for one, other in zip(found, textbook(work, **TEXTBOOK[name]), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    if not change.same:
        unchanged = textbook(robots.draw(runs, 25))
        assert np.abs(found[0] - unchanged[0]).max() > 1e-4


@pytest.mark.parametrize("name", [each.name for each in cliffs.CHANGES if "online" in each.kinds])
def test_changes_find_the_same_in_a_loop(name):
    change = BY_NAME[name]
    work = change.work(robots.draw(1, 25))
    online = pgm_robots.online(change.rule, work, change.iterations).call()
    for one, other in zip(online, textbook(work, **TEXTBOOK[name]), strict=True):
        np.testing.assert_allclose(one, other[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("row", cliffs.ROWS, ids=lambda row: row.name)
def test_changes_that_find_the_same_are_held_to_it(row):
    ready, missing = row.prepared(3)
    assert not missing
    assert next(iter(ready)) == "pgm"
    row.agree(ready, 3)
    assert len({contender.units for contender in ready.values()}) == 1
    same = {name for name in row.contenders if name != "pgm" and BY_NAME[name].same}
    assert same == set(row.contenders) - row.unchecked - {"pgm"}


@pytest.mark.parametrize(("runs", "steps", "count"), [(1_000, 200, 2), (1, 10_000, 1), (1, 5, 1)])
def test_one_reading_in_100_000_is_missing(runs, steps, count):
    work = robots.draw(runs, steps)
    holes = np.isnan(changes.missing(work).readings)
    assert holes.any(axis=-1).sum() == holes.all(axis=-1).sum() == count
    assert not np.isnan(work.readings).any()


def test_the_seconds_slopes_are_its_derivatives():
    rng = np.random.default_rng(0)
    x, b, u = rng.normal(size=(5, 3)), rng.normal(size=(5, 1)), rng.normal(size=(5, 2))
    ends = [changes.biased(x, b + sign * 1e-6, u) for sign in (1, -1)]
    slope = (ends[0] - ends[1]) / 2e-6
    np.testing.assert_allclose(changes.biased_by_bias(x, b, u)[..., 0], slope, atol=1e-8)
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        slope = (changes.biased(x + step, b, u) - changes.biased(x - step, b, u)) / 2e-6
        np.testing.assert_allclose(changes.biased_by_state(x, b, u)[..., k], slope, atol=1e-8)


def test_every_kind_is_of_the_benchmarks_model():
    sizes = {name: (kind.runs, kind.size) for name, kind in cliffs.KINDS.items()}
    assert sizes == {
        "many": (1_000, 200),
        "one": (1, 10_000),
        "online": (1, 1_000),
        "few": (32, 200),
    }
    assert {change.name: change.most for change in cliffs.CHANGES} == {
        "missing": 1.3,
        "second_state": 1.8,
        "no_jacobian": None,
        "singular": 1.3,
        "grouped": 1.4,
        "iterations": 2.3,
        "one_fewer": 1.1,
        "own_taylor": 1.3,
    }
