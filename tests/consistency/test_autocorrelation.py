"""Whiteness: of filters that are right and wrong, with one reading a step and with many."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2, norm

import pgm
from models import networks
from models.networks import fix, shift
from pgm import consistency
from pgm.results import Innovations


def innovations(residual, step, cov=None):
    """Innovations of unit covariance, or of another."""
    residual = np.asarray(residual, dtype=float)
    size = residual.shape[-1]
    cov = np.broadcast_to(np.eye(size) if cov is None else cov, (*residual.shape, size)).copy()
    cov[np.isnan(residual[..., 0])] = np.nan
    steps = max(step) + 1
    nis = np.full((*residual.shape[:-2], steps), np.nan)
    return Innovations(residual, cov, np.asarray(step), nis, np.zeros(nis.shape, dtype=int))


def test_the_autocorrelation_by_hand():
    root = np.array([[2.0, 0.0], [1.0, 0.5]])
    white = np.random.default_rng(0).normal(size=(3, 6, 2))
    found = consistency.whiteness(innovations(white @ root.T, range(6), root @ root.T), 2)
    for lag in (1, 2):
        terms = (white[:, :-lag] * white[:, lag:]).sum(axis=-1)
        scale = np.sqrt((white[:, :-lag] ** 2).sum() * (white[:, lag:] ** 2).sum())
        assert_allclose(found.autocorrelation[lag - 1], terms.sum() / scale)
        due = norm.ppf(0.975) * np.sqrt((terms**2).sum()) / scale
        assert_allclose(found.band[lag - 1], due)
    ratio = found.autocorrelation / found.band * norm.ppf(0.975)
    assert_allclose(found.statistic, (ratio**2).sum())
    assert_allclose(found.probability, chi2(2).sf(found.statistic))
    assert_allclose(found.limit, chi2(2).ppf(0.95))


def test_readings_not_taken_are_left_out_and_lags_count_steps_with_readings():
    rng = np.random.default_rng(3)
    dense = rng.normal(size=(4, 10, 1))
    dense[0, 3] = dense[2, 7] = np.nan
    sparse = np.full((4, 40, 1), np.nan)
    sparse[:, 1::4] = dense
    due = consistency.whiteness(innovations(dense, range(10)), 5)
    found = consistency.whiteness(innovations(sparse, range(40)), 5)
    assert_allclose(found.autocorrelation, due.autocorrelation)
    assert_allclose(found.band, due.band)
    pairs = dense[:, :-1, 0] * dense[:, 1:, 0]
    assert_allclose(np.sign(found.autocorrelation[0]), np.sign(np.nansum(pairs)))
    with pytest.raises(pgm.ModelError, match="measurements at 10 steps"):
        consistency.whiteness(innovations(sparse, range(40)), 10)


def test_the_readings_of_a_step_meet_their_likes_and_are_one_term():
    white = np.random.default_rng(8).normal(size=(5, 7, 3, 1))  # runs, steps, readings
    white[1, 2, 0] = white[3, :, 2] = np.nan
    rows = white.reshape(5, 21, 1)
    found = consistency.whiteness(innovations(rows, np.repeat(np.arange(7), 3)), 3)
    for lag in (1, 2, 3):
        product = white[:, :-lag, :, 0] * white[:, lag:, :, 0]
        terms = np.nansum(product, axis=-1)
        met = np.isfinite(product)
        scale = np.sqrt(
            (white[:, :-lag, :, 0][met] ** 2).sum() * (white[:, lag:, :, 0][met] ** 2).sum()
        )
        assert_allclose(found.autocorrelation[lag - 1], terms.sum() / scale)
        due = norm.ppf(0.975) * np.sqrt((terms**2).sum()) / scale
        assert_allclose(found.band[lag - 1], due)


def test_the_order_of_rows_does_not_matter():
    residual = np.random.default_rng(4).normal(size=(2, 12, 2))
    shuffled = np.random.default_rng(5).permutation(12)
    due = consistency.whiteness(innovations(residual, range(12)), 4)
    found = consistency.whiteness(innovations(residual[:, shuffled], shuffled), 4)
    assert_allclose(found.autocorrelation, due.autocorrelation)


def test_the_band_of_one_reading_a_step_is_that_of_so_many_products(right):
    found = consistency.whiteness(right.innovations[fix], 10)
    products = 300 * 2 * (40 - found.lags)
    assert_allclose(found.band, norm.ppf(0.975) / np.sqrt(products), rtol=0.05)


def test_determined_components_have_no_innovation():
    """What rounding leaves of them is none, however large the readings' units make it."""
    rng = np.random.default_rng(9)
    one = rng.normal(size=(3, 12, 1))
    both = 1e6 * np.concatenate([one, one], axis=-1)
    both[..., 1] += 1e-3 * rng.normal(size=(3, 12))
    due = consistency.whiteness(innovations(one, range(12)), 4)
    found = consistency.whiteness(innovations(both, range(12), np.full((2, 2), 1e12)), 4)
    assert_allclose(found.autocorrelation, due.autocorrelation, rtol=1e-12)
    assert_allclose(found.band, due.band, rtol=1e-12)
    known = innovations(1e-12 * one, range(12), np.zeros((1, 1)))
    with pytest.raises(pgm.ModelError, match="measurements at 0 steps"):
        consistency.whiteness(known, 1)


def test_a_right_filter_is_white_and_a_wrong_one_is_not(right, wrong):
    assert consistency.whiteness(right.innovations[fix], confidence=0.999).inside
    bad = consistency.whiteness(wrong.innovations[fix], confidence=0.999)
    assert not bad.inside
    # A filter that trusts its sensor too much corrects too far, and has to come back.
    assert bad.autocorrelation[0] < -3 * bad.band[0]


def test_a_motion_noise_too_small_shows_as_innovations_of_one_sign(sample):
    slow = networks.linear(motion_std=0.1)
    found = consistency.whiteness(pgm.filter(slow, sample.evidence).innovations[fix], 10)
    assert not found.inside
    assert found.autocorrelation[0] > 3 * found.band[0]


def test_a_white_filter_is_called_white_as_often_as_it_says():
    """With several readings a step, which share their prediction, some of them not taken."""
    model, steps, groups, runs = networks.linear(), 30, 200, 4
    rng = np.random.default_rng(6)
    step = np.repeat(np.arange(steps + 1), 3)
    controls = np.zeros((steps, 2))
    drawn = model.sample({shift: controls, fix: pgm.sightings(step=step)}, runs=800, rng=rng)
    readings = np.where(rng.uniform(size=(800, step.size, 1)) < 0.3, np.nan, drawn[fix])
    posterior = pgm.filter(model, {shift: controls, fix: pgm.sightings(readings, step)})
    found = posterior.innovations[fix]
    each = [
        consistency.whiteness(
            Innovations(found.residual[part], found.cov[part], step, found.nis, found.dof), 10
        )
        for part in np.split(np.arange(groups * runs), groups)
    ]
    outside = np.mean([np.abs(w.autocorrelation) > w.band for w in each])
    assert abs(outside - 0.05) < 4 * np.sqrt(0.05 * 0.95 / (10 * groups))
    small = np.mean([w.probability < 0.1 for w in each])
    assert abs(small - 0.1) < 4 * np.sqrt(0.1 * 0.9 / groups)


def test_angles_on_either_side_of_a_turn_are_no_jumps():
    """The innovation of a bearing behind the robot is small, whichever way it is read."""
    t = pgm.Variable("t", components=("t",), angles=("t",))
    z = pgm.Variable("z", components=("z",), angles=("z",))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(t, np.pi, 0.01)],
        transition=[pgm.LinearGaussianCPD(t, given={t.previous: 1.0}, cov=0.01)],
        observation=[pgm.NonlinearGaussianCPD(z, given=t, function=lambda x: x, cov=0.01)],
    )
    sample = model.sample(steps=60, runs=50, rng=7)
    readings = (np.asarray(sample[z]) + np.pi) % (2 * np.pi) - np.pi
    assert (readings > 2.5).any()
    assert (readings < -2.5).any()
    posterior = pgm.filter(model, {z: readings})
    assert consistency.whiteness(posterior.innovations[z], confidence=0.999).inside
    assert consistency.anis(posterior.innovations[z], confidence=0.999).overall().inside
    assert consistency.anees(posterior[t], sample[t], confidence=0.999).overall().inside
    assert consistency.coverage(posterior[t], sample[t], band=0.999).inside


def test_refusals(right):
    none = Innovations(
        np.zeros((3, 0, 2)),
        np.zeros((3, 0, 2, 2)),
        np.zeros(0, dtype=int),
        np.full((3, 5), np.nan),
        np.zeros((3, 5), dtype=int),
    )
    for lags in (0, -1, 2.5, True, "3", None):
        with pytest.raises(pgm.ModelError, match=r"lags = .* whole number, 1 or more"):
            consistency.whiteness(right.innovations[fix], lags)
    with pytest.raises(pgm.ModelError, match="measurements at 40 steps"):
        consistency.whiteness(right.innovations[fix], 40)
    with pytest.raises(pgm.ModelError, match="measurements at 0 steps"):
        consistency.whiteness(none, 1)
    apart = np.array([[[1.0], [np.nan]], [[np.nan], [1.0]]])
    with pytest.raises(pgm.ModelError, match="no run was read at two steps"):
        consistency.whiteness(innovations(apart, [0, 1]), 1)
    with pytest.raises(pgm.ModelError, match=r"posterior.innovations\[z\]"):
        consistency.whiteness(right, 3)
