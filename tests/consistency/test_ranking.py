"""Sensors ranked by their innovations, against sums written out and simulated chance."""

import numpy as np
import pytest

import pgm
from pgm.results import Innovations

z, y = pgm.variables("z y")


def made(residual, step, cov=1.0):
    """Innovations of scalar sightings that are independent: (..., M)."""
    residual, step = np.asarray(residual, dtype=float), np.asarray(step)
    steps = int(step.max()) + 1
    nis = np.zeros((*residual.shape[:-1], steps))
    dof = np.zeros(nis.shape, dtype=int)
    taken = ~np.isnan(residual)
    np.add.at(nis, (..., step), np.where(taken, residual**2 / cov, 0.0))
    np.add.at(dof, (..., step), taken)
    covs = np.where(taken, cov, np.nan)[..., None, None]
    nis[dof == 0] = np.nan
    return Innovations(residual[..., None], covs, step, nis, dof, np.zeros(residual.shape, bool))


def test_mean_bias_and_order_are_those_of_sums():
    quiet, loud = [0.5, -1.0, np.nan, 1.0], [2.0, 3.0, -1.0, 2.0]
    found = pgm.consistency.ranking({z: made(quiet, range(4)), y: made(loud, range(4), 4.0)})
    assert [row.sensor for row in found.rows] == [y, z]
    assert found[0].average.value == pytest.approx(18.0 / 4.0 / 4.0)
    assert found[1].average.value == pytest.approx(2.25 / 3.0)
    np.testing.assert_allclose(found[0].bias, [6.0 / 4.0 / 2.0])
    np.testing.assert_allclose(found[1].bias_error, [3.0**-0.5])
    low, high = pgm.consistency.mean_band(dof=1, count=4)
    assert (found[0].average.low, found[0].average.high) == pytest.approx((low, high))


@pytest.mark.parametrize("seed", range(5))
def test_the_stretch_is_the_heaviest_of_all(seed):
    rng = np.random.default_rng(seed)
    residual = rng.standard_normal((2, 40))
    residual[1, 10:20] *= 3.0
    row = pgm.consistency.ranking({z: made(residual, np.arange(40))})[0]
    gain = 0.25 * residual**2 - 0.5 * np.log(2.0)
    every = [
        (gain[run, a : b + 1].sum(), a, b)
        for run in (0, 1)
        for a in range(40)
        for b in range(a, 40)
    ]
    most, first, last = max(every)
    assert (row.first, row.last) == (first, last)
    assert row.probability == pytest.approx(min(1.0, 80.0 * np.exp(-most)))


def test_chance_is_bounded():
    residual = np.random.default_rng(1).standard_normal((400, 1, 200))
    chances = [
        pgm.consistency.ranking({z: made(r, np.arange(200))})[0].probability for r in residual
    ]
    assert np.mean(np.array(chances) <= 0.1) <= 0.1


def test_sightings_by_label_are_those_of_the_label():
    rng = np.random.default_rng(0)
    step = np.repeat(np.arange(50), 2)
    label = np.tile(["left", "right"], 50)
    residual = rng.standard_normal(100)
    residual[(label == "right") & (step >= 30)] += 4.0
    found = pgm.consistency.ranking({z: made(residual, step)}, by={z: label})
    assert [row.group for row in found.rows] == ["right", "left"]
    mine = made(residual[label == "right"], step[label == "right"])
    alone = pgm.consistency.ranking({z: mine})[0]
    assert found[0].average.value == pytest.approx(alone.average.value)
    assert 28 <= found[0].first <= 31
    assert found[0].last == 49
    assert "z, right" in repr(found)


def test_joint_covariances_of_a_step_are_used_where_sightings_are_not_divided():
    x = pgm.Variable("x")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 4.0)],
        transition=[pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=1.0)],
        observation=[pgm.LinearGaussianCPD(z, given={x: 1.0}, cov=1.0)],
    )
    seen = pgm.sightings([[3.0], [1.0]], step=[1, 1])
    filtered = pgm.filter(model, {z: seen}, steps=1)
    joint = np.array([[6.0, 5.0], [5.0, 6.0]])
    square = np.array([3.0, 1.0]) @ np.linalg.solve(joint, [3.0, 1.0])
    row = pgm.consistency.ranking(filtered.innovations)[0]
    assert row.average.value == pytest.approx(square / 2.0)


def test_rejected_sightings_count():
    whole = made([1.0, 9.0, -2.0, 1.0], [0, 1, 1, 2])
    nis, dof = whole.nis.copy(), whole.dof.copy()
    nis[1], dof[1] = 4.0, 1
    rejected = np.array([False, True, False, False])
    gated = Innovations(whole.residual, whole.cov, whole.step, nis, dof, rejected)
    both = [pgm.consistency.ranking({z: each})[0] for each in (whole, gated)]
    np.testing.assert_allclose(both[0].nis, both[1].nis)
    np.testing.assert_array_equal(both[0].dof, both[1].dof)


def test_a_sensor_without_a_reading_is_left_out():
    assert len(pgm.consistency.ranking({z: made([np.nan, np.nan], [0, 1])})) == 0


def test_refusals():
    seen = {z: made([1.0, 2.0], [0, 1])}
    with pytest.raises(pgm.ModelError, match="by sensor"):
        pgm.consistency.ranking(seen[z])
    with pytest.raises(pgm.ModelError, match="of one sensor"):
        pgm.consistency.ranking({z: 3})
    with pytest.raises(pgm.ModelError, match="no innovations"):
        pgm.consistency.ranking(seen, by={y: [1]})
    with pytest.raises(pgm.ModelError, match="one a sighting"):
        pgm.consistency.ranking(seen, by={z: [1]})
    with pytest.raises(pgm.ModelError, match="between 0 and 1"):
        pgm.consistency.ranking(seen, confidence=2.0)


def test_the_picture_has_the_windows_means():
    residual = np.array([1.0, 3.0, np.nan, np.nan, 0.5, 0.5])
    found = pgm.consistency.ranking({z: made(residual, np.arange(6))})
    ax = pgm.plot.ranking(found, windows=3, times=np.arange(6.0) * 10.0)
    (mesh,) = [each for each in ax.collections if each.get_array() is not None]
    shown = np.ma.getdata(mesh.get_array()).ravel(), np.ma.getmaskarray(mesh.get_array()).ravel()
    np.testing.assert_array_equal(shown[1], [False, True, False])
    np.testing.assert_allclose(shown[0][[0, 2]], np.log2([5.0, 0.25]))
    with pytest.raises(pgm.ModelError, match="ranking draws"):
        pgm.plot.ranking(pgm.consistency.ranking({}))
    with pytest.raises(pgm.ModelError, match="windows"):
        pgm.plot.ranking(found, windows=0)
    with pytest.raises(pgm.ModelError, match="times"):
        pgm.plot.ranking(found, times=[0.0])


@pytest.mark.parametrize(
    "labels",
    [["a", None, 7, None], np.array([1.0, np.nan, 2.0, np.nan])],
    ids=["mixed", "NaN"],
)
def test_sightings_without_a_label_are_a_group(labels):
    found = pgm.consistency.ranking({z: made([0.5, -3.0, 1.0, 2.0], range(4))}, by={z: labels})
    assert sum(int(row.average.count) for row in found.rows) == 4
    assert found[0].group == "no label"
    assert found[0].average.value == pytest.approx(6.5)


def test_readings_without_variance_that_are_as_foretold_have_no_bias():
    still = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(y, 0.0, 0.0)],
        transition=[pgm.LinearGaussianCPD(y, {y.previous: 1.0}, cov=0.0)],
        observation=[pgm.LinearGaussianCPD(z, {y: 1.0}, cov=0.0)],
    )
    found = pgm.consistency.ranking(pgm.filter(still, {z: [[0.0], [0.0]]}).innovations)
    np.testing.assert_array_equal(found[0].bias, [0.0])
