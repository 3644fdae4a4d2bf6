"""A sigma-point filter of a user's own, by the means and covariances of a slice's CPDs."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import pgm
from tests.beliefs.own.robot import CONTROLS, ROBOT, S, U, driven


def sigma(mean, cov):
    """The 2d points about a mean, (runs, 2d, d), of equal weights; a central rule, κ = 0."""
    root = np.linalg.cholesky(cov) * np.sqrt(mean.shape[-1])
    rows = root.swapaxes(-1, -2)
    return mean[:, None] + np.concatenate([rows, -rows], axis=1)


class SigmaPoints(pgm.BeliefFamily):
    """The unscented filter with equal weights, by what a slice tells of its CPDs."""

    def begin(self, at):
        (cpd,) = at.cpds
        return at.mean(np.zeros((at.runs, 1, 3)))[:, 0], np.broadcast_to(cpd.cov, (at.runs, 3, 3))

    def predict(self, at, belief):
        (cpd,) = at.cpds
        points = at.mean(sigma(*belief))
        off = cpd.residual(points, points[:, :1])
        mean = points[:, 0] + off.mean(axis=1)
        off = off - off.mean(axis=1, keepdims=True)
        return mean, off.swapaxes(1, 2) @ off / points.shape[1] + cpd.cov

    def take(self, at, belief):
        total = np.zeros(at.runs)
        for seen in at.measurements:
            mean, cov = belief
            points = sigma(mean, cov)
            told = seen.mean(points)
            off = seen.residual(told, told[:, :1])
            middle = told[:, 0] + off.mean(axis=1)
            off = off - off.mean(axis=1, keepdims=True)
            spread = off.swapaxes(1, 2) @ off / points.shape[1] + seen.cov
            cross = (points - mean[:, None]).swapaxes(1, 2) @ off / points.shape[1]
            gain = cross @ np.linalg.inv(spread)
            residual = seen.residual(seen.value, middle)
            whitened = np.linalg.solve(spread, residual[..., None])[..., 0]
            total -= 0.5 * (residual * whitened).sum(axis=-1)
            total -= 0.5 * np.linalg.slogdet(2.0 * np.pi * spread)[1]
            belief = (
                mean + (gain @ residual[..., None])[..., 0],
                cov - gain @ spread @ gain.swapaxes(1, 2),
            )
        return belief, total

    def moments(self, belief):
        return belief


class Densities(SigmaPoints):
    """The same, that notes the densities which a slice tells."""

    def predict(self, at, belief):
        before = np.random.default_rng(1).normal(size=(at.runs, 4, 3))
        now = np.random.default_rng(2).normal(size=(at.runs, 4, 3))
        self.found.append((at, now, before, at.log_density(now, before)))
        return super().predict(at, belief)


@pytest.fixture(scope="module")
def drawn():
    return driven((2,), each=1)


def test_means_and_covariances_of_a_slice_make_the_unscented_filter(drawn):
    own = pgm.filter(ROBOT, drawn.evidence, belief=SigmaPoints())
    known = pgm.filter(ROBOT, drawn.evidence, lineariser=pgm.Unscented(alpha=1, beta=0, kappa=0))
    assert np.allclose(own[S].mean, known[S].mean, rtol=0, atol=1e-9)
    assert np.allclose(own[S].cov, known[S].cov, rtol=0, atol=1e-9)
    assert np.allclose(own.log_evidence, known.log_evidence, rtol=0, atol=1e-7)


def test_the_log_density_of_a_slice_is_that_of_its_cpds(drawn):
    family = Densities()
    family.found = []
    pgm.filter(ROBOT, drawn.evidence, belief=family)
    at, now, before, told = family.found[4]
    (cpd,) = ROBOT.transition
    controls = at.inputs[U]
    assert np.array_equal(controls, CONTROLS[at.step - 1 : at.step])
    for run in range(2):
        for k in range(4):
            mean = cpd.function(before[run, k], controls[0])
            off = now[run, k] - mean
            off[2] = (off[2] + np.pi) % (2.0 * np.pi) - np.pi
            due = multivariate_normal(np.zeros(3), at.cpds[0].cov[0]).logpdf(off)
            assert told[run, k] == pytest.approx(due, abs=1e-9)
