"""Flat priors by direction: of what is known by now, innovations, gates, NIS, lost and weights.

The reference is a filter in 300 digits whose prior variances κ grow, 10⁶⁰ and 10⁸⁰: what grows with
κ is unknown, each such direction by a factor of the determinant.
"""

import mpmath
import numpy as np
import pytest
from crossed import crossed
from numpy.testing import assert_allclose, assert_array_equal
from precise import Reference, floats, precise, zeros

import pgm

INF = np.inf
p = pgm.Variable("p", components=("place", "offset", "rate"))
g = pgm.Variable("g", components=("receiver", "twice"))
h = pgm.Variable("h", components=("place", "both"))
STEPS = 8
MOVED = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.5]])
PUSH = np.diag([0.04, 0.0, 0.01])
SEEN = {
    g: ([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]], [[0.25, 0.05], [0.05, 0.5]]),
    h: ([[1.0, 0.0, 0.0], [1.0, 1.0, 0.3]], [[1.0, 0.2], [0.2, 0.3]]),
}


def receiver(variance, unit=1.0, **sensed):
    """A place and a constant offset of which nothing is known, a rate that is, and two sensors.

    One sees the sum of both alone, twice; `unit` is that of its readings.
    """
    (first, noise), (second, other) = SEEN[g], SEEN[h]
    first, noise = unit * np.array(first), unit**2 * np.array(noise)
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(p, np.zeros(3), np.diag([variance, variance, 0.5]))],
        [pgm.LinearGaussianCPD(p, {p.previous: MOVED}, cov=PUSH)],
        [
            pgm.LinearGaussianCPD(g, {p: first}, cov=noise, **sensed),
            pgm.LinearGaussianCPD(h, {p: second}, cov=other, **sensed),
        ],
    )


def read(seed=0, runs=None, unit=1.0):
    """Sightings of a truth, two at one step, with a component and a whole one missing."""
    rng, lead = np.random.default_rng(seed), () if runs is None else (runs,)
    found = {}
    truth = [np.broadcast_to([30.0, -7.0, 0.4], (*lead, 3))]
    for _ in range(STEPS):
        truth.append(truth[-1] @ MOVED.T + rng.normal(size=(*lead, 3)) * np.sqrt(np.diag(PUSH)))
    truth = np.stack(truth, axis=-2)
    for sensor, steps in ((g, [1, 1, 2, 4, 5, 8]), (h, [5, 6, 6, 8])):
        matrix, noise = map(np.array, SEEN[sensor])
        values = truth[..., steps, :] @ matrix.T
        values = values + rng.normal(size=values.shape) @ np.linalg.cholesky(noise).T
        found[sensor] = values * (unit if sensor is g else 1.0), np.array(steps)
    found[g][0][..., 2, 1] = np.nan
    found[h][0][..., 1, :] = np.nan
    return {z: pgm.sightings(values, step=steps) for z, (values, steps) in found.items()}


class Limit:
    """The innovations of sightings as the variance of a prior grows."""

    def __init__(self, evidence, unit=1.0):
        listed = []  # a component by itself, decorrelated by hand, is a reading of its own
        for z, seen in evidence.items():
            for step, row in zip(seen.step, seen.values, strict=True):
                listed.append((z, int(step), row))
        self.models = [receiver(10.0**k, unit) for k in (60, 80)]
        self.passes = [self._filtered(model, listed) for model in self.models]

    def _filtered(self, model, listed):
        """Predicted moments of each step; components that are missing are left out."""
        reference = Reference(model, STEPS, {}, [])
        mean, cov = reference.predicted[0]
        motion, noise = precise(MOVED), precise(PUSH)
        found = []
        for step in range(STEPS + 1):
            if step:
                mean, cov = motion @ mean, motion @ cov @ motion.T + noise
            found.append((mean, cov))
            now = [(z, row) for z, k, row in listed if k == step and not np.isnan(row).all()]
            if now:
                matrix, residual, spread = self.joint(model, now, mean, cov)
                gain = np.array(
                    (mpmath.matrix((cov @ matrix.T).tolist()) * inverse(spread)).tolist()
                )
                mean, cov = mean + gain @ residual, cov - gain @ matrix @ cov
        return found

    @staticmethod
    def joint(model, seen, mean, cov):
        """H, ν and S of readings (sensor, row), stacked, of what is there."""
        cpds = {cpd.child: cpd for cpd in model.observation}
        there = np.concatenate([~np.isnan(row) for _, row in seen])
        matrix = precise(np.vstack([cpds[z].matrices[p] for z, _ in seen]))[there]
        noise = zeros(len(there), len(there))
        for k, (z, _) in enumerate(seen):
            noise[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = precise(cpds[z].cov)
        values = precise(np.nan_to_num(np.concatenate([row for _, row in seen])))[there]
        return matrix, values - matrix @ mean, matrix @ cov @ matrix.T + noise[there][:, there]

    def of(self, seen, step):
        """Residuals and covariance, NaN where unknown; νᵀS⁻¹ν and its degrees of freedom."""
        (_, left, spread), (_, _, wider) = (
            self.joint(model, seen, *found[step])
            for model, found in zip(self.models, self.passes, strict=True)
        )
        unknown = np.array([wider[k, k] > 2 * spread[k, k] for k in range(len(left))])
        square = left @ np.array((inverse(spread) * mpmath.matrix(left.tolist())).tolist())[:, 0]
        grown = mpmath.log10(mpmath.det(as_matrix(wider)) / mpmath.det(as_matrix(spread)))
        residual, cov = floats(left), floats(spread)
        residual[unknown], cov[unknown], cov[:, unknown] = np.nan, np.nan, np.nan
        return residual, cov, float(square), len(left) - round(float(grown) / 20)


def as_matrix(array):
    return mpmath.matrix(array.tolist())


def inverse(array):
    with mpmath.workdps(300):
        return as_matrix(array) ** -1


def assert_limit(found, rejected, evidence, unit, run=()):
    with mpmath.workdps(300):
        own = {z: pgm.sightings(seen.values[run], step=seen.step) for z, seen in evidence.items()}
        due = Limit(own, unit)
        for z, seen in own.items():
            innovations = found[z]
            at = list(enumerate(zip(seen.step.tolist(), seen.values, strict=True)))
            for k, (step, row) in at:
                there = ~np.isnan(row)
                residual, cov, square, dof = (
                    due.of([(z, row)], step) if there.any() else ([], [], 0.0, 0)
                )
                assert np.isnan(innovations.residual[run][k][~there]).all()
                assert_allclose(innovations.residual[run][k][there], residual, rtol=1e-9)
                assert_allclose(
                    innovations.cov[run][k][there][:, there], np.reshape(cov, (there.sum(),) * 2)
                )
                assert_allclose(rejected[z].square[run][k], square if dof else np.nan, rtol=1e-6)
            for step in range(STEPS + 1):
                now = [(z, row) for _, (t, row) in at if t == step and not np.isnan(row).all()]
                *_, square, dof = due.of(now, step) if now else (0.0, 0)
                assert innovations.dof[run][step] == dof
                assert_allclose(innovations.nis[run][step], square if dof else np.nan, rtol=1e-6)


LET_IN = 1.0 - 1e-14


@crossed(("infer", "unit"), [pgm.filter, pgm.smooth], [1.0, 1e8, 1e-8])
def test_what_is_foretold_is_the_limit_of_wide_priors(infer, unit):
    evidence = read(unit=unit)
    found = infer(receiver(INF, unit), evidence, steps=STEPS, gate=LET_IN)
    assert not any(each.rejected.any() for each in found.rejected.values())
    assert_limit(found.innovations, found.rejected, evidence, unit)
    # Of the place alone, and of the offset, nothing is known until the place is read.
    assert np.isinf(found.predicted[p].cov[4, 0, 0])
    assert np.isnan(found.innovations[h].residual[0]).tolist() == [True, False]


def test_of_many_runs_each_is_the_limit_of_its_own():
    evidence = read(seed=3, runs=4)
    evidence[g].values[1, :2] = np.nan
    evidence[g].values[2, :4] = np.nan
    found = pgm.filter(receiver(INF), evidence, steps=STEPS, gate=LET_IN)
    for run in range(4):
        assert_limit(found.innovations, found.rejected, evidence, 1.0, (run,))


def test_of_two_unknown_readings_a_difference_may_be_known():
    """The first sightings of the sum: four components, of which one direction is unknown."""
    innovations = pgm.filter(receiver(INF), read(), steps=STEPS).innovations[g]
    assert np.isnan(innovations.residual[:2]).all()
    assert innovations.dof[1] == 3
    assert np.isfinite(innovations.nis[1])


def wrong():
    """Readings of which one, at step 5, is 500 off, as the first of the place is."""
    evidence = read(seed=4)
    evidence[g].values[4] += [500.0, 1000.0]
    evidence[h].values[0, 0] += 500.0
    return evidence


SCHEDULES = [
    pgm.Filtering(gate=0.999),
    pgm.Smoothing(gate=0.999),
    pgm.FixedLag(2, gate=0.999),
]


@pytest.mark.parametrize("schedule", SCHEDULES, ids=lambda s: type(s).__name__)
@pytest.mark.parametrize("runs", [None, 3])
def test_a_reading_far_off_along_a_known_direction_is_rejected(schedule, runs):
    evidence = wrong()
    if runs is not None:
        evidence = {
            z: pgm.sightings(np.stack([seen.values] * runs), step=seen.step)
            for z, seen in evidence.items()
        }
    flat, wide = (
        pgm.infer(pgm.compile(receiver(v), steps=STEPS), evidence, schedule=schedule)
        for v in (INF, 1e6)
    )
    # The first reading of the place is let in, as nothing contradicts it; later ones then do.
    for z, steps in ((g, [4]), (h, [2, 3])):
        rejected = flat.rejected[z].rejected
        assert_array_equal(rejected, wide.rejected[z].rejected)
        for own in rejected.reshape(-1, rejected.shape[-1]):
            assert np.flatnonzero(own).tolist() == steps
    assert_allclose(flat[p].mean[..., -1, :], wide[p].mean[..., -1, :], atol=1e-2)
    assert flat.lost.at.tolist() == wide.lost.at.tolist()


def test_lost_along_a_known_direction():
    """A receiver whose readings leave what was foretold, while place and offset are unknown."""
    steps = np.arange(1, 41)
    values = np.array([1.0, 2.0]) * np.where(steps > 20, 40.0, 0.0)[:, None]
    evidence = {g: pgm.sightings(values, step=steps)}
    flat, wide = (pgm.filter(receiver(v), evidence, steps=40, gate=0.99) for v in (INF, 1e8))
    assert np.isinf(flat[p].cov[-1, 0, 0])
    assert [(s.first, s.why) for s in flat.lost.stretches] == [(21, "rejections")]
    assert_array_equal(flat.lost.at, wide.lost.at)


@crossed(
    ("schedule", "lineariser"),
    [pgm.Filtering(), pgm.Smoothing(), pgm.Smoothing(60)],
    [pgm.Taylor(), pgm.Unscented()],
)
def test_weights_of_robust_noise(schedule, lineariser):
    """Place and offset are never told apart; expected squares are those of their sum."""
    evidence = {g: wrong()[g]}
    flat, wide = (
        pgm.infer(
            pgm.compile(receiver(v, noise=pgm.Huber(2.0)), steps=STEPS),
            evidence,
            schedule=schedule,
            lineariser=lineariser,
        )
        for v in (INF, 1e6)
    )
    assert np.isinf(flat[p].cov[-1, 0, 0])
    assert flat.weights[g][4] < 0.1
    assert_allclose(flat.weights[g], wide.weights[g], atol=1e-5)
    assert_array_equal(flat.status.converged, wide.status.converged)
    matrix = np.array([1.0, 1.0, 0.0])
    assert_allclose(flat[p].mean @ matrix, wide[p].mean @ matrix, atol=1e-4)


def test_exact_sensors_along_a_known_direction():
    """Readings without noise: of the sum, then of the sum again, foretold to the motion's noise."""
    a = pgm.Variable("a", components=("place", "offset"))
    b, z = pgm.variables("b z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, [0.0, 0.0], INF), pgm.GaussianCPD(b, 0.0, 1.0)],
        [
            pgm.LinearGaussianCPD(a, {a.previous: np.eye(2)}, cov=[0.01, 0.0]),
            pgm.LinearGaussianCPD(b, {b.previous: 1.0}, cov=0.0),
        ],
        [pgm.LinearGaussianCPD(z, {a: [[1.0, 1.0]]}, cov=0.0)],
    )
    found = pgm.filter(model, {z: [[5.0], [5.1], [5.1], [7.1]]}, gate=0.99)
    innovations = found.innovations[z]
    assert_allclose(innovations.residual[:, 0], [np.nan, 0.1, 0.0, 2.0], atol=1e-12)
    assert_allclose(innovations.nis[2:], [1.0, 0.0, np.nan], atol=1e-9)
    assert_allclose(found.rejected[z].square, [np.nan, 1.0, 0.0, 400.0], atol=1e-9)
    assert found.rejected[z].rejected.tolist() == [False, False, False, True]


def test_windows_of_an_iterated_fixed_lag():
    """A range that is nonlinear in what is known, beside a receiver of an unknown offset."""
    r = pgm.Variable("r")
    base = receiver(INF)
    bent = pgm.NonlinearGaussianCPD(r, (p,), lambda p: np.exp(0.1 * p[..., 2:]), 0.01)
    model = base.replace(observation=[*base.observation, bent])
    evidence = {
        g: read()[g],
        r: pgm.sightings(np.full((STEPS, 1), 1.02), step=np.arange(1, STEPS + 1)),
    }
    lagged = pgm.smooth(model, evidence, steps=STEPS, lag=2, iterations=5)
    plain = pgm.filter(model, evidence, steps=STEPS)
    assert_array_equal(lagged.innovations[g].dof, plain.innovations[g].dof)
    assert_allclose(
        lagged.innovations[g].residual, plain.innovations[g].residual, rtol=1e-2, atol=1e-2
    )
    assert lagged.lost.at.shape == (STEPS + 1,)
