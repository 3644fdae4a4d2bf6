"""Audits of networks of factors, and of flat priors, against integrals on lattices."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from two_ranges import FORM, HEARD, PRIOR, RESIDUAL, P, ranges

import pgm

A, B, C = pgm.variables("a b c")
TURN = pgm.Variable("turn", angles=("turn",))
CAREFUL = pgm.Calibration(50, damping=pgm.LevenbergMarquardt())


def audited(network, evidence=None, start=None, samples=4000):
    posterior = pgm.infer(pgm.compile(network), evidence or {}, schedule=CAREFUL, start=start)
    return pgm.audit(posterior, samples=samples, rng=0)


def normal(residual, cov):
    return -0.5 * residual**2 / cov - 0.5 * np.log(2.0 * np.pi * cov)


def integral(logs, *axes):
    """Ln of the integral, and the means of the axes' coordinates."""
    weight = np.exp(logs - logs.max())
    total = np.log(weight.sum() * np.prod([axis[1] - axis[0] for axis in axes])) + logs.max()
    grids = np.meshgrid(*axes, indexing="ij")
    return total, [float((weight * grid).sum() / weight.sum()) for grid in grids]


def told(found, total, means, errors=4.0):
    """An audit that is trusted, with the log-evidence and means of a lattice."""
    assert found.trusted.all()
    assert found.standard_error.max() < 0.05
    assert abs(found.log_evidence - total) < errors * found.standard_error + 1e-4
    for variable, mean in means.items():
        belief = found.corrected[variable]
        assert abs(belief.mean[0] - mean) < 0.06 * belief.std[0]


def test_two_ranges_and_a_weak_form_against_a_lattice():
    """The answer is on one side of the beacons' line; the other is found, and weighed."""
    axis = np.linspace(-8.0, 8.0, 1201)
    east, north = np.meshgrid(axis, axis, indexing="ij")
    logs = normal(east, 9.0) + normal(north - 0.5, 9.0)
    for x, value in ((-2.0, 2.5), (2.0, 2.7)):
        logs += normal(value - np.hypot(east - x, north), 0.04)
    total, (_, mean) = integral(logs, axis, axis)
    found = audited(pgm.MarkovNetwork([FORM, *HEARD]), start={P: [0.0, 1.0]}, samples=8000)
    assert found.suspect
    assert (found.modes, found.missed) == (1, 0.0)
    told(found, total, {})
    assert abs(found.corrected[P].mean[1] - mean) < 0.1


def test_a_bayesian_network_and_the_same_of_factors():
    left, right = pgm.variables("left right")
    network = pgm.BayesianNetwork(
        [
            PRIOR,
            pgm.NonlinearGaussianCPD(left, P, ranges(-2.0), 0.04),
            pgm.NonlinearGaussianCPD(right, P, ranges(2.0), 0.04),
        ]
    )
    start = {P: [0.0, 1.0]}
    due = audited(network, {left: [2.5], right: [2.7]}, start)
    for prior in (PRIOR, FORM, RESIDUAL):
        found = audited(pgm.MarkovNetwork([prior, *HEARD]), start=start)
        assert_allclose(found.gaussian_log_evidence, due.gaussian_log_evidence, rtol=1e-12)
        error = np.hypot(found.standard_error, due.standard_error)
        assert abs(found.log_evidence - due.log_evidence) < 3.0 * error
        for value, error in (
            ("divergence", "divergence_error"),
            ("inclusive_divergence", "inclusive_error"),
        ):
            error = np.hypot(getattr(found, error), getattr(due, error))
            assert abs(getattr(found, value) - getattr(due, value)) < 3.0 * error
        assert_allclose(found.corrected[P].mean, due.corrected[P].mean, atol=0.1)
        assert (found.modes, found.suspect, found.trusted) == (1, True, True)


def test_without_affine_factors_other_modes_are_not_known():
    """Where nothing says where to look from, the audit is not trusted, and says why."""
    found = audited(pgm.MarkovNetwork(HEARD), start={P: [0.0, 1.0]})
    assert np.isnan(found.missed)
    assert not found.trusted
    assert "modes is not known: there was nowhere to look from" in repr(found)
    # The factor of the distance alone is affine in no direction, and half of the form is flat.
    flat = pgm.CanonicalForm(P, [[1.0, 0.0], [0.0, 0.0]], [0.0, 0.0])
    assert np.isnan(audited(pgm.MarkovNetwork([flat, *HEARD]), start={P: [0.0, 1.0]}).missed)
    # Of linear factors with Gaussian noise there is one mode, whatever they leave out.
    assert audited(pgm.MarkovNetwork([FORM])).missed == 0.0


def test_three_variables_against_a_lattice():
    """Forms that couple neighbours, one of rank one; and a product, which knows no sign."""
    pair = np.array([[1.0, -0.6], [-0.6, 1.0]])
    step = np.array([[1.0, -1.0], [-1.0, 1.0]])
    network = pgm.MarkovNetwork(
        [
            pgm.CanonicalForm((A, B), pair, [0.1, 0.0], 2.0),
            pgm.CanonicalForm((B, C), step, [0.0, 0.0], -1.0),
            pgm.NonlinearGaussianFactor((A, B), lambda a, b: a * b, 0.2, value=1.5),
        ]
    )
    axis = np.linspace(-5.0, 5.0, 161)
    a, b, c = np.meshgrid(axis, axis, axis, indexing="ij")
    logs = -0.5 * (a * a + b * b) + 0.6 * a * b + 0.1 * a + 2.0 - 0.5 * (b - c) ** 2 - 1.0
    logs += normal(a * b - 1.5, 0.2)
    total, means = integral(logs, axis, axis, axis)
    for side in (1.0, -1.0):
        start = {A: [side], B: [side], C: [side]}
        found = audited(network, start=start, samples=8000)
        assert found.modes == 1
        told(found, total, dict(zip((A, B, C), means, strict=True)))


@pytest.mark.parametrize("held", [A, B])
def test_evidence_of_variables_without_a_prior(held):
    """The constants of a flat prior of what is observed are none."""
    other = B if held is A else A
    factors = [
        pgm.NonlinearGaussianFactor((A, B), lambda a, b: a**2 * b, 0.2, value=1.0),
        pgm.CanonicalForm((A, B), [[0.5, 0.1], [0.1, 0.5]], [0.3, 0.0], 0.7),
    ]
    axis = np.linspace(-9.0, 9.0, 20_001)
    a, b = (0.8, axis) if held is A else (axis, 0.8)
    logs = normal(a * a * b - 1.0, 0.2) + 0.7
    logs += -0.25 * (a * a + b * b) - 0.1 * a * b + 0.3 * a
    total, (mean,) = integral(logs, axis)
    found = audited(pgm.MarkovNetwork(factors), {held: [0.8]}, {other: [1.0]}, samples=8000)
    told(found, total, {other: mean})


def circles():
    """Factors of a heading that know no turns, and their density by angle."""
    axis = np.linspace(-np.pi, np.pi, 20_001)[:-1]

    def off(value):
        return (axis - value + np.pi) % (2.0 * np.pi) - np.pi

    factor = pgm.NonlinearGaussianFactor
    opposite = [
        factor(TURN, lambda t: np.sin(t) ** 2, 0.01),
        factor(TURN, np.cos, 2.0, value=0.3),
    ]
    yield "two sides", [factor(TURN, np.cos, 0.01, value=0.5)], normal(np.cos(axis) - 0.5, 0.01)
    yield "opposite", opposite, normal(np.sin(axis) ** 2, 0.01) + normal(np.cos(axis) - 0.3, 2.0)
    yield (
        "loose",
        [factor(TURN, lambda t: t - 0.4, 1.0, angles=[True])],
        normal(off(0.4), 1.0),
    )
    yield (
        "loose and two sides",
        [
            factor(TURN, lambda t: t, 4.0, value=0.4, angles=[True]),
            factor(TURN, np.cos, 0.05, value=-0.5),
        ],
        normal(off(0.4), 4.0) + normal(np.cos(axis) + 0.5, 0.05),
    )


@pytest.mark.parametrize(("factors", "logs"), [pytest.param(*c[1:], id=c[0]) for c in circles()])
def test_an_angle_without_turns_has_its_integral_over_one(factors, logs):
    """Whichever turn the answer is on, and where another mode is opposite to it."""
    total = np.log(np.exp(logs).sum() * 2.0 * np.pi / len(logs))
    network = pgm.MarkovNetwork(factors)
    for start in (0.9, 3.0, -14.0):
        found = audited(network, start={TURN: [start]}, samples=8000)
        assert found.trusted
        assert abs(found.log_evidence - total) < 4.0 * found.standard_error + 1e-3
        assert found.standard_error < 0.03
    modes = pgm.Gaussians(4, starts=16, draws=8000)
    drawn = pgm.infer(pgm.compile(network), {}, belief=modes)
    assert drawn.log_evidence == pytest.approx(total, abs=0.03)


def test_a_heading_on_the_line_keeps_its_turns():
    """A form of an angle is no function of the circle, and its integral is over the line."""
    network = pgm.MarkovNetwork(
        [
            pgm.CanonicalForm(TURN, [[1.0 / 9.0]], [0.0]),
            pgm.NonlinearGaussianFactor(TURN, np.cos, 0.05, value=0.9),
        ]
    )
    axis = np.linspace(-40.0, 40.0, 200_001)
    total, _ = integral(-(axis**2) / 18.0 + normal(np.cos(axis) - 0.9, 0.05), axis)
    found = audited(network, start={TURN: [0.4]}, samples=20_000)
    assert abs(found.log_evidence - total) < 4.0 * found.standard_error


def test_robust_residuals_that_contradict_one_another():
    noise = pgm.StudentT(4.0)
    said = [
        pgm.NonlinearGaussianFactor(A, lambda a: a, 0.1, value=value, noise=noise)
        for value in (2.0, -2.0)
    ]
    axis = np.linspace(-60.0, 60.0, 400_001)
    logs = -0.005 * axis**2
    for value in (2.0, -2.0):  # Student's t of 4 degrees of freedom
        logs += np.log(0.375) - 2.5 * np.log1p((axis - value) ** 2 / 0.4) - 0.5 * np.log(0.1)
    total, (mean,) = integral(logs, axis)
    weak = pgm.CanonicalForm(A, [[0.01]], [0.0])
    told(audited(pgm.MarkovNetwork([*said, weak]), samples=8000), total, {A: mean})
    # Their tails are no Gaussian to look from.
    assert np.isnan(audited(pgm.MarkovNetwork(said)).missed)


def test_relations_without_noise():
    """As a CPD of its child, and as a measurement beside another of its child's."""
    axis = np.linspace(-8.0, 8.0, 200_001)
    square = pgm.NonlinearGaussianFactor(A, lambda a: a**2, 0.5, value=1.0)
    twice = pgm.LinearGaussianCPD(B, {A: 2.0}, cov=0.0)
    seen = pgm.GaussianCPD(B, 2.1, 1.0)
    logs = normal(2.0 * axis - 2.1, 1.0) + normal(axis**2 - 1.0, 0.5)
    total, (mean,) = integral(logs + normal(axis - 1.0, 1.0), axis)
    found = audited(pgm.MarkovNetwork([pgm.GaussianCPD(A, 1.0, 1.0), twice, seen, square]))
    told(found, total, {A: mean})
    # Beside what is read without noise other modes are found, and not drawn from.
    total, _ = integral(logs - 0.5 * axis**2, axis)
    form = pgm.CanonicalForm(A, [[1.0]], [0.0])
    found = audited(pgm.MarkovNetwork([form, seen, twice, square]))
    assert abs(found.log_evidence - total) < 4.0 * found.standard_error
    assert found.missed > 0.5
    assert not found.trusted


@pytest.mark.parametrize("level", [3.0, 3e5])
def test_linear_networks_are_exact(level):
    form = pgm.CanonicalForm((A, B), [[1.0, -0.4], [-0.4, 1.0]], [1.0, 0.5], level)
    found = audited(pgm.MarkovNetwork([form, pgm.GaussianCPD(B, 1.0, 0.5)]))
    assert_allclose(found.log_evidence, found.gaussian_log_evidence, rtol=1e-12)
    assert found.effective_sample_size == pytest.approx(4000)
    assert found.trusted
    assert not found.suspect


def test_runs_and_flat_priors_of_a_bayesian_network():
    """A square that is read, and a line; of each of three runs the integral over a flat prior."""
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(A, 0.0, np.inf),
            pgm.NonlinearGaussianCPD(B, A, lambda a: a**2, cov=0.1),
            pgm.LinearGaussianCPD(C, {A: 1.0}, cov=1.0),
        ]
    )
    square, line = np.array([[1.0], [2.0], [0.1]]), np.array([[0.3], [-1.0], [0.0]])
    posterior = pgm.infer(pgm.compile(network), {B: square, C: line}, schedule=CAREFUL)
    found = pgm.audit(posterior, samples=8000, rng=0)
    assert found.trusted.all()
    axis = np.linspace(-9.0, 9.0, 100_001)
    for run in range(3):
        logs = normal(square[run] - axis**2, 0.1) + normal(line[run] - axis, 1.0)
        total, (mean,) = integral(logs - 0.5 * np.log(2.0 * np.pi), axis)
        assert abs(found.log_evidence[run] - total) < 4.0 * found.standard_error[run]
        assert found.corrected[A].mean[run, 0] == pytest.approx(mean, abs=0.05)


def test_refusals_name_the_factor():
    circle = pgm.NonlinearGaussianFactor(P, ranges(0.0), 0.0, value=2.0)
    graph = pgm.compile(pgm.MarkovNetwork([FORM, circle]))
    tangent = pgm.infer(graph, {}, schedule=pgm.Calibration(50, damping=0.5), start={P: [0.0, 1.0]})
    with pytest.raises(pgm.NumericalError, match="is nonlinear, its noise is singular") as caught:
        pgm.audit(tangent, rng=0)
    assert caught.value.cpd is circle
    assert caught.value.variable == P
    broken = pgm.NonlinearGaussianFactor(A, np.sqrt, 0.5, value=0.5)
    network = pgm.MarkovNetwork([broken, pgm.CanonicalForm(A, [[1.0]], [0.3])])
    posterior = pgm.infer(pgm.compile(network), {}, start={A: [0.3]})
    with pytest.raises(pgm.LinearisationError, match="NaN or infinite at a draw") as caught:
        pgm.audit(posterior, rng=0)
    assert caught.value.cpd is broken
    pairs = [(A, B), (B, C), (C, A)]
    ring = pgm.MarkovNetwork([pgm.CanonicalForm(p, [[1, 0.2], [0.2, 1]], [0, 1.0]) for p in pairs])
    loopy = pgm.infer(pgm.compile(ring, method=pgm.Bethe()), {}, schedule=pgm.Flooding(100))
    with pytest.raises(pgm.GraphError, match="which only a calibrated tree has"):
        pgm.audit(loopy, rng=0)


@pytest.mark.parametrize("cov", [0.01, 0.0], ids=["noise", "none"])
def test_cpds_below_an_open_variable_are_drawn_from_it(cov):
    """A form of a, b its square, but for noise or exactly, and a residual of b."""
    network = pgm.MarkovNetwork(
        [
            pgm.CanonicalForm(A, [[1.0]], [0.3], 1.0),
            pgm.NonlinearGaussianCPD(B, A, lambda a: a**2, cov=cov),
            pgm.NonlinearGaussianFactor(B, np.sin, 0.1, value=0.8),
        ]
    )
    a, b = np.linspace(-5.0, 5.0, 2001), np.linspace(-1.0, 18.0, 3801)
    logs = -0.5 * a**2 + 0.3 * a + 1.0
    if cov:
        logs = logs[:, None] + normal(b - a[:, None] ** 2, cov) + normal(np.sin(b) - 0.8, 0.1)
        total, (mean, _) = integral(logs, a, b)
    else:
        total, (mean,) = integral(logs + normal(np.sin(a**2) - 0.8, 0.1), a)
    once = pgm.Calibration(50, damping=0.3)
    posterior = pgm.infer(pgm.compile(network), {}, schedule=once, start={A: [0.9], B: [0.8]})
    told(pgm.audit(posterior, samples=20_000, rng=0), total, {A: mean})
    drawn = pgm.infer(
        pgm.compile(network), {}, belief=pgm.Gaussians(8, starts=16, draws=20_000), schedule=once
    )
    assert drawn.log_evidence == pytest.approx(total, abs=0.03)
