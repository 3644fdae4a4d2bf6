"""Digits: large coordinates, sharp noise beside weak priors, units."""

import numpy as np
import pytest
from gaussian.draws import Conditioned, Drawn, assert_moments, conditional, regular
from numpy.testing import assert_allclose
from textbooks import assert_log, rational

import pgm


def in_fractions(seed, count, coordinate=0.0, std=lambda rng: 1.0, prior=1.0):
    """Draw a tree-like network of scalars whose numbers and values are binary fractions."""
    rng = np.random.default_rng(seed)
    found = pgm.variables(" ".join(f"v{k}" for k in range(count)))
    cpds, values = [], {}
    for k, child in enumerate(found):
        chosen = rng.choice(k, min(k, int(rng.integers(0, 3))), replace=False) if k else []
        given = {found[j]: float(rng.choice([-1.0, 0.5, 1.0, 1.5])) for j in chosen}
        deviation = std(rng) if given else prior
        # Offsets that keep each variable near the coordinate.
        offset = coordinate * (1.0 - sum(given.values())) + rng.integers(-8, 9) / 4.0
        cpds.append(conditional(child, given, np.array([offset]), [[deviation**2]]))
        mean = offset + sum(f * values[parent][0] for parent, f in given.items())
        digit = 2.0**-20 if coordinate else 2.0**-36
        values[child] = rational([np.round((mean + deviation * rng.normal()) / digit) * digit])
    return Drawn(tuple(cpds), {v: [float(x[0])] and x for v, x in values.items()})


def check(drawn, seed, digits, tolerance=1e-9):
    rng = np.random.default_rng(seed)
    evidence, hidden = drawn.observe(rng, 0.5)
    posterior = pgm.infer(pgm.compile(drawn.network(rng)), evidence)
    due = Conditioned(drawn, evidence)
    if hidden:
        joint = posterior.joint(*hidden)
        assert_moments(joint.mean, joint.cov, *due[hidden], tolerance, digits=digits)
    assert_log(posterior.log_evidence, due.log_evidence, tolerance)


@pytest.mark.filterwarnings("ignore:.*too small beside its mean:pgm.PrecisionWarning")
@pytest.mark.parametrize("coordinate", [2.0**20, 2.0**27])
def test_large_coordinates(coordinate):
    """About the frame, sharp noise at 10⁶ … 10⁸ costs no digits but those of the coordinates."""
    for seed in range(25):
        drawn = in_fractions(seed, 8, coordinate, lambda rng: 2.0**-10, prior=2.0**-9)
        check(drawn, seed, 4e-16)


@pytest.mark.filterwarnings("ignore:.*too small beside its mean:pgm.PrecisionWarning")
@pytest.mark.parametrize("ratio", [10, 20, 25])
def test_sharp_noise_beside_weak_priors(ratio):
    """Deviations from 2⁻²⁵ to 2⁹ in one network: variances, and means but for their digits."""
    for seed in range(25):
        drawn = in_fractions(seed, 8, 0.0, lambda rng: 2.0 ** -rng.integers(0, ratio), 2.0**9)
        check(drawn, seed, 1e-14)


@pytest.mark.parametrize("sharp", [1e-3, 1e-6, 1e-7])
def test_two_sharp_readings_of_weak_unknowns(sharp):
    """Sum and difference of two unknowns of deviation 10³."""
    a, b, plus, minus = pgm.variables("a b plus minus")
    weak = 1e6
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, weak),
            pgm.GaussianCPD(b, 0.0, weak),
            pgm.LinearGaussianCPD(plus, {a: 1.0, b: 1.0}, cov=sharp**2),
            pgm.LinearGaussianCPD(minus, {a: 1.0, b: -1.0}, cov=sharp**2),
        ]
    )
    graph = pgm.compile(net)
    both = pgm.infer(graph, {plus: 3.0, minus: 1.0})
    variance = 1.0 / (2.0 / sharp**2 + 1.0 / weak)
    assert_allclose(both.joint(a, b).mean, [2.0, 1.0], rtol=1e-12)
    assert_allclose(both.joint(a, b).std, np.sqrt(variance), rtol=1e-12)
    # One reading leaves the difference as it was.
    one = pgm.infer(graph, {plus: 3.0})
    step = pgm.Gaussian((a, b), one.joint(a, b).mean, one.joint(a, b).cov)
    assert_allclose([1, -1] @ step.cov @ [1, -1], 2 * weak, rtol=1e-9)
    due = -0.5 * (np.log(2 * np.pi * (2 * weak + sharp**2)) + 9.0 / (2 * weak + sharp**2))
    assert_allclose(one.log_evidence, due, rtol=1e-12)


@pytest.mark.parametrize("unit", [1e-8, 1e8])
def test_units(unit):
    """A variable in other units: the same beliefs in them, and a log-evidence in them."""
    for seed in range(6):
        drawn = regular(seed, 8, 2)
        rng = np.random.default_rng(seed)
        evidence, hidden = drawn.observe(rng, 0.4)
        for scaled in (drawn.variables[0], drawn.variables[5]):
            cpds = []
            for cpd in drawn.cpds:
                own = unit if cpd.child == scaled else 1.0
                given = {
                    p: own * F / (unit if p == scaled else 1.0) for p, F in cpd.matrices.items()
                }
                cpds.append(conditional(cpd.child, given, own * cpd.offset, own**2 * cpd.cov))
            before = pgm.infer(pgm.compile(drawn.network()), evidence)
            seen = {v: x * (unit if v == scaled else 1.0) for v, x in evidence.items()}
            after = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), seen)
            for v in hidden:
                own = unit if v == scaled else 1.0
                std = before[v].std
                assert np.all(np.abs(after[v].mean / own - before[v].mean) <= 1e-10 * std)
                assert_allclose(after[v].cov / own**2, before[v].cov, atol=1e-10 * std.max() ** 2)
            shift = scaled.dimension * np.log(unit) if scaled in evidence else 0.0
            assert_log(after.log_evidence + shift, before.log_evidence, 1e-10)


def test_exact_readings_at_large_coordinates():
    """They agree to the digits that they have, many deviations of the last place."""
    x, y, z, w = pgm.variables("x y z w")
    origin, std = 123456789.1234, 1e-3
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, origin, std**2),
            pgm.LinearGaussianCPD(y, {x: 1.0}, offset=0.1 - origin, cov=0.0),
            pgm.LinearGaussianCPD(z, {x: 1.0}, offset=0.37, cov=0.0),
            pgm.LinearGaussianCPD(w, {x: 1.0}, cov=std**2),
        ]
    )
    value = origin + 0.7e-3
    posterior = pgm.infer(pgm.compile(net), {y: value - origin + 0.1, z: value + 0.37, w: value})
    assert_allclose(posterior[x].mean, [value], rtol=1e-15)
    assert posterior[x].cov == 0.0
    with pytest.raises(pgm.NumericalError, match="contradicts"):
        pgm.infer(pgm.compile(net), {y: value - origin + 0.1, z: value + 0.371})


def test_a_reading_far_out():
    """A billion deviations from the prior: exact readings that agree still do."""
    x, y, z = pgm.variables("x y z")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, 0.0, 1.0),
            pgm.LinearGaussianCPD(y, {x: 1.1}, cov=0.0),
            pgm.LinearGaussianCPD(z, {x: 1 / 3}, cov=0.0),
        ]
    )
    posterior = pgm.infer(pgm.compile(net), {y: 1.1 * 1e9, z: 1e9 / 3})
    assert_allclose(posterior[x].mean, [1e9], rtol=1e-14)


def test_a_sharp_sum_keeps_the_difference():
    """Of x + y some fifty digits are known, of x − y none: both stand in one covariance."""
    x, y, z = pgm.variables("x y z")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, 0.0, 1.0),
            pgm.GaussianCPD(y, 0.0, 1.0),
            pgm.LinearGaussianCPD(z, {x: 1.0, y: 1.0}, cov=1e-100),
        ]
    )
    posterior = pgm.infer(pgm.compile(net), {z: 1.0})
    assert_allclose(posterior.joint(x, y).mean, [0.5, 0.5], rtol=1e-15)
    assert_allclose(posterior.joint(x, y).cov, [[0.5, -0.5], [-0.5, 0.5]], rtol=1e-15)
    due = -0.5 * (np.log(4 * np.pi) + 0.5)
    assert_allclose(posterior.log_evidence, due, rtol=1e-15)
