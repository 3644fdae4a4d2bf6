"""Several modes of networks without time, against integrals on a lattice."""

import numpy as np
import pytest

import pgm

P = pgm.Variable("p", components=("e", "n"))
LEFT, RIGHT, A, B, C = pgm.variables("left right a b c")


def ranges(x):
    return lambda p: np.linalg.norm(p - np.array([x, 0.0]), axis=-1, keepdims=True)


FIX = pgm.BayesianNetwork(
    [
        pgm.GaussianCPD(P, [0.0, 0.5], 9.0 * np.eye(2)),
        pgm.NonlinearGaussianCPD(LEFT, P, ranges(-2.0), cov=0.04),
        pgm.NonlinearGaussianCPD(RIGHT, P, ranges(2.0), cov=0.04),
    ]
)
HEARD = {LEFT: [2.5], RIGHT: [2.7]}


def fixes(heard, size=901, reach=6.0):
    """Of the position by the lattice: ln Z, and of each side its weight, mean and covariance."""
    axis = np.linspace(-reach, reach, size)
    p = np.stack(np.meshgrid(axis, axis, indexing="ij"), -1)
    logs = -0.5 * ((p - [0.0, 0.5]) ** 2).sum(-1) / 9.0 - np.log(2 * np.pi * 9.0)
    for x, variable in ((-2.0, LEFT), (2.0, RIGHT)):
        residual = heard[variable][0] - ranges(x)(p)[..., 0]
        if np.isfinite(residual).all():
            logs += -0.5 * residual**2 / 0.04 - 0.5 * np.log(2 * np.pi * 0.04)
    weight = np.exp(logs - logs.max())
    total = weight.sum()
    found = []
    for side in (p[..., 1] > 0, p[..., 1] < 0):
        own = weight * side
        mean = (own[..., None] * p).sum((0, 1)) / own.sum()
        away = p - mean
        cov = np.einsum("ab,abi,abj->ij", own, away, away) / own.sum()
        found.append((own.sum() / total, mean, cov))
    return logs.max() + np.log(total * (axis[1] - axis[0]) ** 2), found


def test_a_fix_by_two_ranges_has_two_modes():
    """Laplace's approximation of each, and nearer to the lattice's by draws."""
    total, sides = fixes(HEARD)
    graph = pgm.compile(FIX)
    rough = pgm.infer(graph, HEARD, belief=pgm.Gaussians(4, starts=16))
    fine = pgm.infer(graph, HEARD, belief=pgm.Gaussians(4, starts=16, draws=8000))
    assert (rough.log_evidence_kind, fine.log_evidence_kind) == ("modes", "draws")
    assert "2 modes; 16 of 16 starts settled" in repr(rough.status)
    assert rough.log_evidence == pytest.approx(total, abs=0.05)
    assert fine.log_evidence == pytest.approx(total, abs=0.02)
    for posterior, near in ((rough, 0.05), (fine, 0.01)):
        belief = posterior[P]
        order = np.argsort(-belief.components.mean[:, 1])
        assert len(order) == 2
        for k, (weight, mean, cov) in zip(order, sides, strict=True):
            assert belief.weights[k] == pytest.approx(weight, abs=near)
            np.testing.assert_allclose(belief.components.mean[k], mean, atol=near)
            np.testing.assert_allclose(belief.components.cov[k], cov, atol=near)
    np.testing.assert_allclose(fine.joint(P).mean, fine[P].mean)


def test_runs_are_those_of_calls_of_one():
    """With a missing reading, which leaves a ring, and with other runs' draws."""
    heard = {LEFT: np.array([[2.5], [3.0], [2.0]]), RIGHT: np.array([[2.7], [2.0], [2.9]])}
    graph = pgm.compile(FIX)
    every = pgm.infer(graph, heard, belief=pgm.Gaussians(4, starts=8))
    for run in range(3):
        own = {variable: values[run] for variable, values in heard.items()}
        alone = pgm.infer(graph, own, belief=pgm.Gaussians(4, starts=8))
        np.testing.assert_allclose(every[P].mean[run], alone[P].mean, atol=1e-6)
        np.testing.assert_allclose(every[P].cov[run], alone[P].cov, atol=1e-6)
        np.testing.assert_allclose(every.log_evidence[run], alone.log_evidence, atol=1e-8)
    drawn = pgm.infer(graph, heard, belief=pgm.Gaussians(4, starts=8, draws=4000))
    for run in range(3):
        own = {variable: values[run] for variable, values in heard.items()}
        total, _ = fixes(own)
        assert drawn.log_evidence[run] == pytest.approx(total, abs=0.03)


def test_a_chain_of_functions_against_the_integral():
    """The sine of a square: modes of unlike mass, far from Gaussian."""
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(A, 0.3, 1.0),
            pgm.NonlinearGaussianCPD(B, A, lambda a: a**2, cov=0.01),
            pgm.NonlinearGaussianCPD(C, B, np.sin, cov=0.1),
        ]
    )
    a, b = np.meshgrid(np.linspace(-5, 5, 2001), np.linspace(-1, 18, 3801), indexing="ij")
    logs = -0.5 * (a - 0.3) ** 2 - 0.5 * (b - a**2) ** 2 / 0.01
    logs = logs - 0.5 * (0.8 - np.sin(b)) ** 2 / 0.1 - np.log((2 * np.pi) ** 1.5 * np.sqrt(0.001))
    weight = np.exp(logs)
    total = np.log(weight.sum() * (a[1, 0] - a[0, 0]) * (b[0, 1] - b[0, 0]))
    weight /= weight.sum()
    posterior = pgm.infer(
        pgm.compile(network), {C: [0.8]}, belief=pgm.Gaussians(8, starts=16, draws=20_000)
    )
    assert posterior.log_evidence == pytest.approx(total, abs=0.02)
    for variable, values in ((A, a), (B, b)):
        mean = (weight * values).sum()
        spread = np.sqrt((weight * (values - mean) ** 2).sum())
        assert posterior[variable].mean[0] == pytest.approx(mean, abs=0.05 * spread)
        assert posterior[variable].std[0] == pytest.approx(spread, rel=0.05)


@pytest.mark.parametrize("noise", [None, pgm.StudentT(4.0)], ids=["gaussian", "robust"])
def test_squares_without_noise_of_their_own_and_robust_readings(noise):
    """Of a relation without noise draws have the free variable alone."""
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(A, 0.2, 1.0),
            pgm.NonlinearGaussianCPD(B, A, lambda a: a**2, cov=0.0),
            pgm.LinearGaussianCPD(C, {B: 1.0}, cov=0.1, noise=noise),
        ]
    )
    a = np.linspace(-6, 6, 20001)
    residual = 1.0 - a**2
    logs = -0.5 * (a - 0.2) ** 2 - 0.5 * np.log(2 * np.pi)
    if noise is None:
        logs += -0.5 * residual**2 / 0.1 - 0.5 * np.log(2 * np.pi * 0.1)
    else:  # Student's t of 4 degrees of freedom
        logs += np.log(0.375) - 2.5 * np.log1p(residual**2 / 0.4) - 0.5 * np.log(0.1)
    weight = np.exp(logs)
    total, weight = np.log(weight.sum() * (a[1] - a[0])), weight / weight.sum()
    posterior = pgm.infer(
        pgm.compile(network), {C: [1.0]}, belief=pgm.Gaussians(4, starts=8, draws=20_000),
        schedule=pgm.Calibration(50, damping=0.2),
    )  # fmt: skip
    assert len(posterior[A].weights) == 2
    assert posterior.log_evidence == pytest.approx(total, abs=0.02)
    assert posterior[A].mean[0] == pytest.approx((weight * a).sum(), abs=0.02)
    assert posterior[B].mean[0] == pytest.approx((weight * a**2).sum(), abs=0.02)


def test_whole_turns_of_an_angle_are_no_modes():
    heading = pgm.Variable("heading", angles=("heading",))
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(heading, 0.0, 16.0),
            pgm.NonlinearGaussianCPD(A, heading, np.sin, cov=0.01),
        ]
    )
    posterior = pgm.infer(pgm.compile(network), {A: [0.5]}, belief=pgm.Gaussians(8, starts=32))
    means = np.sort(np.mod(posterior[heading].components.mean[:, 0], 2 * np.pi))
    np.testing.assert_allclose(means, [np.pi / 6, 5 * np.pi / 6], atol=0.01)


def test_a_linear_network_has_its_one_gaussian():
    network = pgm.BayesianNetwork(
        [pgm.GaussianCPD(A, 0.0, 1.0), pgm.LinearGaussianCPD(B, {A: 1.0}, cov=1.0)]
    )
    graph = pgm.compile(network)
    for draws in (0, 20):
        with pytest.warns(pgm.BeliefWarning) if draws == 20 else np.errstate():
            found = pgm.infer(graph, {B: [1.0]}, belief=pgm.Gaussians(4, starts=8, draws=draws))
        due = pgm.infer(graph, {B: [1.0]})
        assert len(found[A].weights) == 1
        assert found.log_evidence == pytest.approx(due.log_evidence, abs=1e-12)


def test_a_mixed_network_is_exact_whatever_the_count():
    sort = pgm.Discrete("sort", states=("s", "t"))
    cases = {"s": pgm.GaussianCPD(A, 0.0, 1.0), "t": pgm.GaussianCPD(A, 2.0, 1.0)}
    network = pgm.BayesianNetwork(
        [pgm.TableCPD(sort, table=[0.5, 0.5]), pgm.SwitchingCPD(A, sort, cases)]
    )
    graph = pgm.compile(network)
    found = pgm.infer(graph, {}, belief=pgm.Gaussians(1))
    np.testing.assert_array_equal(found[A].weights, pgm.infer(graph, {})[A].weights)


def refused(error, told, network, evidence, belief=None, **options):
    belief = belief or pgm.Gaussians(4, starts=8)
    with pytest.raises(error, match=told):
        pgm.infer(pgm.compile(network), evidence, belief=belief, **options)


def test_refusals():
    square = pgm.NonlinearGaussianCPD(B, A, lambda a: a**2, cov=0.1)
    network = pgm.BayesianNetwork([pgm.GaussianCPD(A, 0.0, 1.0), square])
    seen = {B: [1.0]}
    refused(pgm.EvidenceError, "modes are looked for that evidence leaves", network, {})
    refused(pgm.EvidenceError, "all are observed", network, {A: [1.0], B: [1.0]})
    refused(pgm.ModelError, "starts= looks for modes", network, seen, pgm.Gaussians(4))
    refused(pgm.ModelError, "start= is not for mixtures", network, seen, start={A: [1.0]})
    refused(pgm.GraphError, "round loops", network, seen, schedule=pgm.Flooding())
    flat = pgm.BayesianNetwork([pgm.GaussianCPD(A, 0.0, np.inf), square])
    refused(pgm.ModelError, "prior of finite variance, or .* and neither bounds a:", flat, seen)
    by_run = pgm.BayesianNetwork([pgm.GaussianCPD(A, np.zeros((3, 1)), 1.0), square])
    refused(pgm.ModelError, "differs by run", by_run, seen)
    exact = pgm.LinearGaussianCPD(C, {A: 1.0}, cov=0.0)
    certain = pgm.BayesianNetwork([pgm.GaussianCPD(A, 0.0, 1.0), square, exact])
    draws = pgm.Gaussians(2, starts=4, draws=100)
    refused(pgm.NumericalError, "draws are weighed", certain, {**seen, C: [0.9]}, draws)
    sort = pgm.Discrete("sort", states=("s", "t"))
    tables = pgm.BayesianNetwork([pgm.TableCPD(sort, table=[0.5, 0.5])])
    refused(pgm.ModelError, "network of tables is exact", tables, {})
    kept = pgm.infer(pgm.compile(network), seen, belief=pgm.Gaussians(2, starts=4, draws=1000))
    for asked in (lambda: kept[B], lambda: kept.joint(A, B)):
        with pytest.raises(pgm.EvidenceError, match="b is observed"):
            asked()


def test_what_has_not_settled_is_told():
    graph = pgm.compile(FIX)
    belief = pgm.Gaussians(4, starts=8)
    with pytest.warns(pgm.ConvergenceWarning, match="had not settled after 2 linearisations"):
        found = pgm.infer(graph, HEARD, belief=belief, schedule=pgm.Calibration(2))
    assert not found.status.converged
    assert found.status.residuals.shape == (1,)
