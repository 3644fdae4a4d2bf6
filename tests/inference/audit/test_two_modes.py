"""Readings that leave two modes, of which the Gaussian knows one; and readings that do not."""

import numpy as np
import pytest
from crossed import crossed, slow_after
from scipy.integrate import quad

import pgm

a, b, z = pgm.variables("a b z")
RUNS = 400


def product(variance):
    """The network z = a b + noise, its log-evidence at z = 0.7, and E a² given that."""
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.GaussianCPD(b, 0.0, 1.0),
            pgm.NonlinearGaussianCPD(z, (a, b), lambda a, b: a * b, variance),
        ]
    )

    def density(x):
        """p(a = x, z): z is N(0, variance + x²) given a."""
        spread = variance + x * x
        return np.exp(-0.5 * (x * x + 0.49 / spread)) / np.sqrt(spread) / (2.0 * np.pi)

    where = {"points": [0.05, 0.1, 0.3, 0.7, 1.5], "limit": 400}
    evidence = 2.0 * quad(density, 0.0, 12.0, **where)[0]
    second = 2.0 * quad(lambda x: x * x * density(x), 0.0, 12.0, **where)[0] / evidence
    return net, np.log(evidence), second


def one_mode(net, lineariser):
    schedule = pgm.Calibration(iterations=80)
    evidence = {z: np.full((RUNS, 1), 0.7)}
    start = {a: 0.8, b: 0.8}
    return pgm.infer(
        pgm.compile(net), evidence, lineariser=lineariser, schedule=schedule, start=start
    )


@crossed(("lineariser", "variance"), [pgm.Taylor(), pgm.Cubature()], [0.1, 0.01])
def test_a_product_whose_other_mode_was_lost(variance, lineariser):
    net, evidence, second = product(variance)
    posterior = one_mode(net, lineariser)
    found = pgm.audit(posterior, rng=1)
    assert (posterior[a].mean > 0.3).all()
    plain = np.log(np.exp(found.log_weights).mean(axis=-1))
    assert np.median(plain) < evidence - 0.3  # the Gaussian's own draws see one mode
    off = np.abs(found.log_evidence - evidence)
    assert (off < 2 * found.standard_error).mean() > 0.92
    assert (off < 4 * found.standard_error).mean() > 0.99
    assert found.standard_error.max() < 0.25
    assert found.suspect.mean() > 0.97
    assert "SUSPECT in " in repr(found)
    # Both modes are in the exact moments: a mean of zero, and the variance of quadrature.
    corrected = found.corrected[a]
    assert abs(corrected.mean.mean()) < 0.02
    assert (corrected.mean[..., 0] ** 2 + corrected.cov[..., 0, 0]).mean() == pytest.approx(
        second, rel=0.03
    )
    if lineariser == pgm.Taylor():  # narrow: what it lost is far beyond its deviations
        assert (found.divergence < found.inclusive_divergence).all()


@pytest.mark.parametrize("variance", slow_after(1, [0.1, 0.01]))
def test_a_product_at_the_prior_covers_both_modes(variance):
    """Linearised at zero, the reading says nothing: moments are nearly right, the evidence is not.

    By a rule that knows the product's variance the evidence is nearly right, too.
    """
    net, evidence, _ = product(variance)
    for lineariser, low in ((pgm.Unscented(), True), (pgm.GaussHermite(5), False)):
        posterior = pgm.infer(pgm.compile(net), {z: np.full((RUNS, 1), 0.7)}, lineariser=lineariser)
        found = pgm.audit(posterior, rng=2)
        off = np.abs(found.log_evidence - evidence)
        assert (off < 2 * found.standard_error).mean() > 0.92
        assert (posterior.log_evidence < evidence - 0.8).all() == low
        assert (np.abs(posterior.log_evidence - evidence) < 0.4).all() != low
        assert np.median(found.moment_divergence[a]) < 0.1
        assert found.suspect.mean() == pytest.approx(float(low), abs=0.02)


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # it drifts on, to the prior
def test_a_product_whose_factors_are_right_one_by_one():
    """Both moments of a and of b, and not their covariance: E ab is that of a z a / (v + a²)."""
    variance = 0.01
    net, evidence, _ = product(variance)
    posterior = one_mode(net, pgm.GaussHermite(5))
    found = pgm.audit(posterior, rng=0)
    belief = posterior.joint(a, b).run(0)

    def density(x):
        spread = variance + x * x
        return np.exp(-0.5 * (x * x + 0.49 / spread)) / np.sqrt(spread) / (2.0 * np.pi)

    def mean(function):
        where = {"points": [0.05, 0.1, 0.3, 0.7, 1.5], "limit": 400}
        total = quad(lambda x: function(x) * density(x), 0.0, 12.0, **where)[0]
        return 2.0 * total / np.exp(evidence)

    square, product_ = mean(lambda x: x * x), mean(lambda x: 0.7 * x * x / (variance + x * x))
    exact = pgm.Gaussian((a, b), np.zeros(2), [[square, product_], [product_, square]])
    assert exact.kl(belief) > 1.0
    assert pgm.Gaussian(a, [0.0], [[square]]).kl(posterior[a].run(0)) < 0.4
    assert abs(posterior.log_evidence[0] - evidence) < 0.4
    assert found.suspect.mean() > 0.97
    assert "the belief of a, b of run" in repr(found)


place = pgm.Variable("place", components=("east", "north"))
seen = pgm.Variable("seen", components=("one", "other"))
bearing = pgm.Variable("bearing", components=("angle",), angles=("angle",))
BEACONS = np.array([[0.0, 0.0], [4.0, 0.0]])
AXIS = np.linspace(-10.0, 12.0, 1101)
PLANE = np.stack(np.meshgrid(AXIS, AXIS, indexing="ij"), axis=-1)


def ranges(x):
    return np.hypot(x[..., None, 0] - BEACONS[:, 0], x[..., None, 1] - BEACONS[:, 1])


def angle(x):
    return np.arctan2(x[..., 1:], x[..., :1])


def read(child, function, value, noise, mean, cov, runs=100):
    """A place, what is read of it, and the exact log-evidence and moments on a dense plane."""
    cov, size = np.asarray(cov), child.dimension
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(place, mean, cov),
            pgm.NonlinearGaussianCPD(child, place, function, noise * np.eye(size)),
        ]
    )
    off, residual = PLANE - mean, np.asarray(value) - function(PLANE)
    residual = (residual + np.pi) % (2 * np.pi) - np.pi if child is bearing else residual
    log = -0.5 * np.einsum("...i,ij,...j", off, np.linalg.inv(cov), off)
    log -= 0.5 * np.linalg.slogdet(2 * np.pi * cov)[1]
    log -= 0.5 * ((residual**2).sum(-1) / noise + size * np.log(2 * np.pi * noise))
    weights = np.exp(log) * (AXIS[1] - AXIS[0]) ** 2
    evidence, share = np.log(weights.sum()), weights / weights.sum()
    centre = np.einsum("ij,ijk->k", share, PLANE)
    spread = np.einsum("ij,ijk,ijl->kl", share, PLANE - centre, PLANE - centre)
    schedule = pgm.Calibration(iterations=20)
    posterior = pgm.infer(
        pgm.compile(net), {child: np.broadcast_to(value, (runs, size))}, schedule=schedule
    )
    kl = pgm.Gaussian(place, centre, spread).kl(posterior[place].run(0))
    return posterior, evidence, float(kl)


def test_two_ranges_leave_a_mirror_image():
    posterior, evidence, kl = read(seen, ranges, [2.5, 2.5], 0.04, [2.0, 0.6], np.diag([1.0, 2.0]))
    assert kl > 2.0
    found = pgm.audit(posterior, rng=0)
    assert (np.abs(found.log_evidence - evidence) < 3 * found.standard_error).mean() > 0.95
    assert found.suspect.mean() > 0.97
    assert np.median(found.moment_divergence[place]) == pytest.approx(kl, rel=0.25)


def test_a_mirror_image_of_next_to_no_mass_is_none():
    posterior, evidence, kl = read(seen, ranges, [2.5, 2.5], 0.04, [2.0, 1.5], np.diag([0.5, 0.2]))
    assert kl < 0.1
    found = pgm.audit(posterior, rng=0)
    assert (np.abs(found.log_evidence - evidence) < 3 * found.standard_error).mean() > 0.95
    assert found.suspect.mean() < 0.03


def test_a_bearing_of_a_near_place_is_no_gaussian():
    posterior, evidence, kl = read(bearing, angle, [1.4], 0.01, [1.5, 0.8], np.diag([1.0, 1.0]))
    found = pgm.audit(posterior, rng=0)
    assert (np.abs(found.log_evidence - evidence) < 3 * found.standard_error).mean() > 0.95
    np.testing.assert_allclose(np.median(found.moment_divergence[place]), kl, rtol=0.25)
    assert found.suspect.mean() == pytest.approx(float(kl > 0.5), abs=0.1)


@pytest.mark.parametrize(
    "case",
    [
        (seen, ranges, [2.6, 2.4], 0.01, [2.0, 1.5], np.diag([0.05, 0.05])),
        (bearing, angle, [0.4], 0.0025, [6.0, 2.0], np.diag([0.3, 0.3])),
    ],
    ids=["two ranges", "bearing"],
)
def test_mildly_curved_readings_are_not_suspect(case):
    posterior, evidence, kl = read(*case)
    found = pgm.audit(posterior, rng=0)
    assert kl < 0.05
    assert not found.suspect.any()
    assert found.trusted.mean() > 0.9
    assert (np.abs(found.log_evidence - evidence) < 3 * found.standard_error).mean() > 0.95
    np.testing.assert_allclose(np.median(found.moment_divergence[place]), kl, atol=0.01)
