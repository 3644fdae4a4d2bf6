"""Measurements that are too sharp for the cells, against Kalman filters and finer grids.

`status.unresolved` is an expected error: it is compared with the real one.
"""

import warnings

import numpy as np
import pytest

import pgm
from pgm.beliefs.grid import resolution

x, z = pgm.variables("x z")
p = pgm.Variable("p", components=("east", "north"))
h = pgm.Variable("h", components=("heading",), angles=("heading",))
seen = pgm.Variable("seen", components=("heading",), angles=("heading",))
WIDTH = 0.1
LINE = pgm.Grid({"x": (-8.0, 8.0, 160)})
TOLD = "too sharp for the cells"


def line(sensor, motion=0.3, prior=1.0, place=0.0):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, place, prior)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=motion**2)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=sensor**2)],
    )


def told(infer, *arguments, **options):
    """The answer, and whether it was said that measurements are too sharp."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", pgm.GridWarning)
        found = infer(*arguments, **options)
    assert all("sharp" in str(each.message) for each in said)
    return found, bool(said)


def readings(steps=20):
    return np.sin(np.arange(float(steps)))[:, None]


@pytest.mark.parametrize("infer", [pgm.filter, pgm.smooth])
@pytest.mark.parametrize("share", [5.0, 1.0, 0.7, 0.5, 0.3, 0.1, 0.01])
def test_a_sensor_of_a_share_of_a_cell(infer, share):
    """Off by more than half a nat is told, and from .7 of a cell on nothing is."""
    model = line(share * WIDTH)
    found, said = told(infer, model, {z: readings()}, belief=LINE)
    off = abs(float(found.log_evidence - pgm.filter(model, {z: readings()}).log_evidence))
    assert said == (share < 0.4)
    assert said or off < 0.5
    assert share > 0.25 or off > 0.5
    assert found.status.unresolved > min(10.0, off / 3.0 - 1e-3)


def drawn_line(rng):
    sensor, motion = WIDTH * 10.0 ** rng.uniform(-1.0, 1.0), WIDTH * 10.0 ** rng.uniform(0.0, 1.0)
    return line(sensor, motion, place=rng.normal()), LINE, None


def drawn_plane(rng):
    """One or two directions of the plane, read at any angle to the axes."""
    matrix = rng.normal(size=(rng.integers(1, 3), 2))
    v = pgm.Variable("v", components=tuple("ab"[: len(matrix)]))
    noise = 0.2 * 10.0 ** rng.uniform(-1.5, 0.3)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(p, [0.0, 0.0], np.eye(2))],
        [pgm.LinearGaussianCPD(p, {p.previous: np.eye(2)}, cov=0.09)],
        [pgm.LinearGaussianCPD(v, {p: matrix}, cov=noise**2)],
    )
    return model, pgm.Grid({"east": (-7, 7, 70), "north": (-7, 7, 70)}), None


def drawn_circle(rng):
    noise = 0.1 * 10.0 ** rng.uniform(-1.0, 0.5)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(h, 3.0, 0.3)],
        [pgm.LinearGaussianCPD(h, {h.previous: 1.0}, cov=0.02)],
        [pgm.LinearGaussianCPD(seen, {h: 1.0}, cov=noise**2)],
    )
    return model, pgm.Grid({"heading": 63}), pgm.Grid({"heading": 63 * 25})


@pytest.mark.parametrize("draw", [drawn_line, drawn_plane, drawn_circle])
def test_drawn_models(draw):
    """None is off by more than half a nat in silence, and the expected errors are the real ones."""
    rng, off, expected = np.random.default_rng(2), [], []
    for seed in range(12):
        model, grid, finer = draw(rng)
        evidence = model.sample({}, steps=int(rng.integers(1, 12)), rng=seed).evidence
        found, said = told(pgm.filter, model, evidence, belief=grid)
        due = pgm.filter(model, evidence, belief=finer).log_evidence
        off.append(abs(float(found.log_evidence - due)))
        expected.append(float(found.status.unresolved))
        assert said or off[-1] < 0.5, seed
    off, expected = np.array(off), np.array(expected)
    assert (off[expected < 0.01] < 0.1).all()
    large = expected > 0.25
    assert 2 <= large.sum() <= 10
    assert 0.3 < np.median(off[large] / expected[large]) < 5.0


def test_a_ring_sharper_than_a_cell_may_be_resolved():
    """Along a ring of many cells the centres stand everywhere between its edges."""
    ranged = pgm.Variable("ranged")

    def reach(p):
        return np.hypot(p[..., :1], p[..., 1:])

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(p, [0.0, 0.0], 4.0 * np.eye(2))],
        [pgm.LinearGaussianCPD(p, {p.previous: np.eye(2)}, cov=0.09)],
        [pgm.NonlinearGaussianCPD(ranged, (p,), reach, 0.05**2)],
    )
    logs = []
    for cells in (80, 640):
        grid = pgm.Grid({"east": (-8, 8, cells), "north": (-8, 8, cells)})
        found, said = told(pgm.filter, model, {ranged: [[2.2]]}, belief=grid)
        assert not said
        logs.append(float(found.log_evidence))
    assert abs(logs[0] - logs[1]) < 0.2


def test_many_dull_sensors_are_sharp_together():
    """A step's sixty sightings of half a cell's sharpness each, and a place that only narrows."""
    close = {z: pgm.sightings(np.full((60, 1), 0.03), step=np.ones(60, dtype=int))}
    found, said = told(pgm.filter, line(2.0 * WIDTH), close, steps=1, belief=LINE)
    assert said
    assert found.status.sharp is None
    model = line(1.0, motion=0.0)
    slow = {z: pgm.sightings(np.full((2000, 1), 0.05), step=np.repeat(np.arange(1, 41), 50))}
    found, said = told(pgm.filter, model, slow, steps=40, belief=LINE)
    assert said
    off = abs(float(found.log_evidence - pgm.filter(model, slow, steps=40).log_evidence))
    assert 0.4 < off < 3.0 * found.status.unresolved
    assert "x at step 40 is known to 0.0" in repr(found.status)


def test_each_run_by_itself_and_missing_readings():
    values = np.stack([readings(6), np.full((6, 1), np.nan), readings(6) + 0.05])
    found, said = told(pgm.filter, line(0.2 * WIDTH), {z: values}, belief=LINE)
    assert said
    assert found.status.unresolved.shape == (3,)
    assert found.status.unresolved[1] == 0.0
    for run in (0, 2):
        alone, _ = told(pgm.filter, line(0.2 * WIDTH), {z: values[run]}, belief=LINE)
        np.testing.assert_allclose(found.status.unresolved[run], alone.status.unresolved)


def test_online_says_it_once():
    robot = pgm.OnlineFilter(line(0.2 * WIDTH), belief=LINE)
    belief, said = robot.initial(), []
    for reading in readings(8):
        belief, now = told(robot.update, robot.predict(belief), {z: reading})
        said.append(now)
    assert sum(said) == 1
    offline, _ = told(pgm.filter, line(0.2 * WIDTH), {z: readings(8)}, belief=LINE)
    np.testing.assert_allclose(belief.status.unresolved, offline.status.unresolved, rtol=1e-6)


def test_densities_of_any_shape():
    """A sampled sensor is judged by its density, as the Gaussian one that it is."""
    density = pgm.SampledCPD(
        z,
        (x,),
        log_density=lambda value, x: (
            -0.5 * ((value - x)[..., 0] / 0.02) ** 2 - np.log(0.02 * np.sqrt(2 * np.pi))
        ),
    )
    plain = line(0.02)
    found, said = told(
        pgm.filter, plain.replace(observation=[density]), {z: readings()}, belief=LINE
    )
    due, _ = told(pgm.filter, plain, {z: readings()}, belief=LINE)
    assert said
    np.testing.assert_allclose(found.status.unresolved, due.status.unresolved, rtol=1e-6)


def test_refining_finds_cells_that_do():
    grid = pgm.Grid({"x": (-8.0, 8.0, 160)}, refine="log_evidence")
    found, said = told(pgm.filter, line(0.3 * WIDTH), {z: readings()}, belief=grid)
    assert not said
    assert found.status.unresolved < 0.01


@pytest.mark.parametrize("reading", [6.0, 12.0, 15.0, 50.0, 1e6])
@pytest.mark.parametrize("sensor", [0.3, 1.0, 3.0])
def test_a_reading_outside_the_grid(sensor, reading):
    """Right, refused, or told."""
    model, grid = line(sensor), pgm.Grid({"x": (-5.0, 5.0, 100)})
    for values in ([[reading]], [[0.0], [0.0], [reading]]):
        due = pgm.filter(model, {z: values})
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", pgm.GridWarning)
            try:
                found = pgm.filter(model, {z: values}, belief=grid)
            except pgm.EvidenceError:
                continue
        assert said or abs(float(found.log_evidence - due.log_evidence)) < 0.5


def test_shifts_are_spread_evenly():
    for axes in (1, 2, 3, 4):
        shifts = resolution._shifts(axes)
        assert (shifts[0] == 0.0).all()
        assert (np.abs(shifts) <= 0.5).all()
        # Waves of a cell's length, along and across the axes, average out.
        for wave in np.ndindex(*(3,) * axes):
            k = np.array(wave) - 1
            if k.any():
                assert abs(np.exp(2j * np.pi * shifts @ k).mean()) < 0.6
