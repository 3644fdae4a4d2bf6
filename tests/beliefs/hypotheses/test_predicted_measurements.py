"""Beliefs of a switching chain's measurements, against the sum over all paths of modes."""

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

mode, said = pgm.Discrete("mode", 2), pgm.Discrete("said", 2)
x, z, w = pgm.variables("x z w")
FIRST, MOVE, READ = (
    np.array([0.6, 0.4]),
    np.array([[0.8, 0.2], [0.3, 0.7]]),
    [[0.9, 0.1], [0.4, 0.6]],
)
SLOPES, NOISES, SCALES = (1.0, 0.5), (0.1, 2.0), (0.2, 1.5)
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(mode, table=FIRST), pgm.GaussianCPD(x, 1.0, 1.0)],
    [
        pgm.TableCPD(mode, mode.previous, table=MOVE),
        pgm.SwitchingCPD(
            x,
            mode,
            {k: pgm.LinearGaussianCPD(x, {x.previous: SLOPES[k]}, NOISES[k]) for k in (0, 1)},
        ),
    ],
    [
        pgm.LinearGaussianCPD(z, {x: 2.0}, 0.25),
        pgm.SwitchingCPD(
            w, mode, {k: pgm.LinearGaussianCPD(w, {x: 1.0}, SCALES[k], offset=k) for k in (0, 1)}
        ),
        pgm.TableCPD(said, mode, table=READ),
    ],
)
ZS, STEPS = np.array([0.5, 3.0]), 4


def paths(read):
    """Weights, modes and moments of x at a last step by path, with the readings `read` of z."""
    for modes in product((0, 1), repeat=STEPS + 1):
        weight, mean, cov = FIRST[modes[0]], 1.0, 1.0
        before = []
        for t in range(STEPS + 1):
            if t:
                weight *= MOVE[modes[t - 1], modes[t]]
                mean, cov = SLOPES[modes[t]] * mean, SLOPES[modes[t]] ** 2 * cov + NOISES[modes[t]]
            before.append((weight, modes[t], mean, cov))
            if 1 <= t <= len(read):
                spread = 4.0 * cov + 0.25
                off = read[t - 1] - 2.0 * mean
                weight *= np.exp(-0.5 * off**2 / spread) / np.sqrt(2 * np.pi * spread)
                mean, cov = mean + 2.0 * cov / spread * off, cov - 4.0 * cov**2 / spread
        yield before, (weight, modes, mean, cov)


def moments(weights, means, covs):
    weights = np.array(weights) / np.sum(weights)
    mean = weights @ means
    return mean, weights @ (np.array(covs) + (np.array(means) - mean) ** 2)


@pytest.mark.parametrize("how", [pgm.filter, pgm.smooth])
def test_predictions_equal_the_sum_over_paths(how):
    found = how(MODEL, {z: ZS[:, None]}, steps=STEPS, belief=pgm.Gaussians(64)).predicted
    for t in range(1, STEPS + 1):
        # Each path counts once for each of its later modes, whose probabilities sum to one.
        before = [path[t] for path, _ in paths(ZS)]
        weights, modes, means, covs = map(np.array, zip(*before, strict=True))
        mean, cov = moments(weights, 2.0 * means, 4.0 * covs + 0.25)
        at = found[z.at(t)]
        assert_allclose((at.mean[0], at.cov[0, 0]), (mean, cov), rtol=1e-9)
        mean, cov = moments(weights, means + modes, covs + np.array(SCALES)[modes])
        assert_allclose(found[w].mean[t, 0], mean, rtol=1e-9)
        assert_allclose(found[w].cov[t, 0, 0], cov, rtol=1e-9)
        share = np.bincount(modes, weights) / weights.sum()
        assert_allclose(found[mode].probabilities[t], share, rtol=1e-9)
        assert_allclose(found[said].probabilities[t], share @ READ, rtol=1e-9)
        assert_allclose(found[x].mean[t, 0], moments(weights, means, covs)[0], rtol=1e-9)


def test_runs_and_measurements_that_were_not_taken():
    runs = np.stack([ZS, ZS + 1.0])[..., None]
    many = pgm.filter(MODEL, {z: runs}, steps=STEPS, belief=pgm.Gaussians(64))
    one = pgm.filter(MODEL, {z: runs[1]}, steps=STEPS, belief=pgm.Gaussians(64))
    for v in (z, w):
        assert_allclose(many.predicted[v].mean[1], one.predicted[v].mean, rtol=1e-9)
        assert_allclose(many.predicted[v].cov[1], one.predicted[v].cov, rtol=1e-9)
    last = one[z.at(STEPS)]
    assert_allclose(last.mean, one.predicted[z.at(STEPS)].mean, rtol=1e-9)
    assert_allclose(last.cov, one.predicted[z.at(STEPS)].cov, rtol=1e-9)
    assert_allclose(one[said].probabilities, one[mode].probabilities @ READ)
    with pytest.raises(pgm.EvidenceError, match=r"z\[2\] has evidence there"):
        one[z.at(2)]
    with pytest.raises(pgm.EvidenceError, match="hidden variables choose its CPD"):
        one[w.at(3)]
