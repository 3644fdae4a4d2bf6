"""Networks whose deviations lie too far apart for float64: right in more digits, or told."""

import warnings

import numpy as np
import pytest
from crossed import slow_after
from gaussian.draws import Conditioned, Drawn, assert_moments
from numpy.testing import assert_allclose
from textbooks import assert_log, rational

import pgm
from pgm.beliefs.gaussian import careful

x, y, z = pgm.variables("x y z")
p, q = (pgm.Variable(name, (f"{name}0", f"{name}1")) for name in "pq")


def drawn(cpds, evidence):
    """A linear network, and evidence, for `Conditioned`."""
    return Drawn(tuple(cpds), {v: rational(np.atleast_1d(a)) for v, a in evidence.items()})


def check(cpds, evidence, method=None, tolerance=1e-9, digits=4e-16):
    """The joint of all that is hidden and the log-evidence, against fractions."""
    evidence = {v: np.atleast_1d(np.asarray(a, dtype=float)) for v, a in evidence.items()}
    posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds), method=method), evidence)
    due = Conditioned(drawn(cpds, evidence), evidence)
    hidden = [cpd.child for cpd in cpds if cpd.child not in evidence]
    joint = posterior.joint(*hidden)
    assert_moments(joint.mean, joint.cov, *due[hidden], tolerance, digits=digits)
    for v in hidden:
        assert_moments(posterior[v].mean, posterior[v].cov, *due[[v]], tolerance, digits=digits)
    if not due.certain:
        assert_log(posterior.log_evidence, due.log_evidence)
    return posterior


def motion(prior, reading, steps=3, exact=False):
    """Constant velocity with motion noise of rank 1, and a position read at every step."""
    state = [pgm.Variable(f"s{k}", ("position", "velocity")) for k in range(steps)]
    seen = pgm.variables(" ".join(f"r{k}" for k in range(steps)))
    push = np.array([[0.5], [1.0]])
    cpds = [pgm.GaussianCPD(state[0], [0.0, 0.0], prior**2 * np.eye(2))]
    for k in range(steps):
        if k:
            slope = [[1.0, 1.0], [0.0, 1.0]]
            cpds.append(pgm.LinearGaussianCPD(state[k], {state[k - 1]: slope}, cov=push @ push.T))
        cov = 0.0 if exact else reading**2
        cpds.append(pgm.LinearGaussianCPD(seen[k], {state[k]: [[1.0, 0.0]]}, cov=cov))
    return cpds, {seen[k]: 1.0 + 2.25 * k + 0.5 * (k % 2) for k in range(steps)}


@pytest.mark.parametrize("method", [None, pgm.JunctionTree(order=lambda net: net.variables)])
@pytest.mark.parametrize("prior", [1.0, 2.0**13, 2.0**27, 2.0**60, 2.0**200])
def test_a_wide_prior_beside_readings_and_motion_of_rank_1(prior, method):
    for exact in (False, True):
        check(*motion(prior, 2.0**-3, exact=exact), method)


@pytest.mark.parametrize("ratio", [1e5, 1e7, 1e9, 1e14])
def test_two_components_of_one_scalar(ratio):
    """Copied without noise and read: half the variance of either, whatever is declared."""
    copies = {
        "linear": pgm.LinearGaussianCPD(q, {p: 1.0}, cov=np.zeros((2, 2))),
        "function": pgm.NonlinearGaussianCPD(
            q, p, lambda p: 1.0 * p, np.zeros((2, 2)), lineariser=pgm.Unscented()
        ),
    }
    for name, copy in copies.items():
        if name == "function" and ratio > 1e7:
            continue  # the values of the function at the rule's points have no such digits
        cpds = [
            pgm.GaussianCPD(x, 0.0, (0.01 * ratio) ** 2),
            pgm.LinearGaussianCPD(p, {x: [[1.0], [1.0]]}, cov=1e-4 * np.eye(2)),
            copy,
        ]
        posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), {q: [1.0, 1.01]})
        assert_allclose(posterior[x].mean, [1.005], rtol=1e-8)
        assert_allclose(posterior[x].std, [0.01 * np.sqrt(0.5)], rtol=1e-6)


def test_an_input_is_taken_to_all_its_digits():
    """b + M u rounds at 1e8; what the reading says of x is known to 1e-12."""
    u = pgm.Variable("u")
    cpds = [
        pgm.GaussianCPD(x, 0.0, 1.0),
        pgm.LinearGaussianCPD(y, {x: 1.0, u: 0.1}, offset=-1e8, cov=2.0**-80),
    ]
    posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), {u: 1e9 + 0.5, y: 0.25})
    due = rational(0.25) - rational(-1e8) - rational(0.1) * rational(1e9 + 0.5)
    assert_allclose(posterior[x].mean, float(due), rtol=1e-11)


def test_runs_and_missing_components():
    """Each run is right by itself, whatever its scale and whichever components it lacks."""
    cov = np.array([1.0, 1e8, 1e20])[:, None, None]
    cpds = [
        pgm.GaussianCPD(x, 1.0, cov),
        pgm.LinearGaussianCPD(p, {x: [[1.0], [1.0]]}, cov=0.01 * np.eye(2)),
    ]
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    rows = np.array([[2.0, 2.5], [np.nan, 2.5], [2.0, 3.0]])
    posterior = pgm.infer(graph, {p: rows})
    for run in range(3):
        alone = pgm.BayesianNetwork([pgm.GaussianCPD(x, 1.0, cov[run]), cpds[1]])
        one = pgm.infer(pgm.compile(alone), {p: rows[run]})
        known = rows[run][np.isfinite(rows[run])]
        precision = 1 / cov[run, 0, 0] + known.size / 0.01
        mean = (1 / cov[run, 0, 0] + known.sum() / 0.01) / precision
        for found, at in ((posterior, run), (one, ())):
            assert_allclose(found[x].mean[at], [mean], rtol=1e-12)
            assert_allclose(found[x].std[at], [precision**-0.5], rtol=1e-12)
        assert_allclose(posterior.log_evidence[run], one.log_evidence, rtol=1e-12)


def test_relinearised_in_more_digits():
    """A root of x = 2 that an exact square reads, its prior wide."""
    cpds = [
        pgm.GaussianCPD(x, 1.5, 1.0),
        pgm.NonlinearGaussianCPD(
            y, x, lambda x: x**2, 1e-16, jacobian={x: lambda x: 2 * x[..., None]}
        ),
    ]
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    posterior = pgm.infer(graph, {y: 4.0}, schedule=pgm.Calibration(iterations=20))
    assert posterior.status.converged
    assert_allclose(posterior[x].mean, [2.0], rtol=1e-14)
    assert_allclose(posterior[x].std, [0.25e-8], rtol=1e-9)


def test_digits_are_told_where_a_function_has_none():
    """x + y − 1e9 of numbers near 1e9 is known to 1e-7, its noise to 1e-9."""
    origin = 1e9
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, origin, 1.0),
            pgm.NonlinearGaussianCPD(y, x, lambda x: x - origin, 1e-18),
        ]
    )
    with pytest.warns(pgm.PrecisionWarning, match="decimal digits of a mean"):
        posterior = pgm.infer(pgm.compile(net), {y: 0.3}, lineariser=pgm.Unscented())
    assert posterior.status.digits < 4


def test_a_network_too_large_for_more_digits_says_what_is_lost(monkeypatch):
    monkeypatch.setattr(careful, "MOST_WORK", 10)
    cpds, evidence = motion(2.0**27, 2.0**-3)
    with pytest.warns(pgm.PrecisionWarning, match="decimal digits of a mean"):
        posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), evidence)
    assert posterior.status.digits < 6


def test_moderate_networks_stay_in_float64():
    """More digits cost time, which networks that do not need them are not to pay."""
    for cpds, evidence in (motion(1e3, 0.1), motion(100.0, 0.0, exact=True)):
        posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), evidence)
        assert not isinstance(posterior._outcome._done.beliefs, careful.DenseBeliefs)


def test_messages_of_a_network_in_more_digits():
    """Forms are in float64, and where they exist they integrate to the same evidence."""
    cpds, evidence = motion(2.0**20, 1.0, steps=2)
    posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), evidence)
    assert isinstance(posterior._outcome._done.beliefs, careful.DenseBeliefs)
    assert posterior.log_evidence_kind == "exact"
    form = posterior.belief(len(posterior.graph) - 1)
    assert_allclose(form.log_integral, posterior.log_evidence, rtol=1e-9)


# ---- the range of float64


def extreme(seed):
    """Networks whose numbers go from 1e-320 to 1e308."""
    rng = np.random.default_rng([seed, 5])

    def numbers(*shape):
        if rng.random() < 0.4:
            return rng.normal(size=shape)
        return rng.choice([-1, 1], shape) * 10.0 ** rng.uniform(-320, 308, shape)

    found, cpds = [], []
    for k in range(int(rng.integers(2, 6))):
        size = int(rng.choice([1, 1, 2]))
        child = pgm.Variable(f"v{k}", tuple(f"c{i}" for i in range(size)))
        spread = [10.0 ** rng.uniform(-320, 308, size), np.full(size, rng.choice([0, 1, 1e30]))]
        cov = np.diag(spread[int(rng.random() < 0.4)])
        chosen = rng.choice(k, min(k, int(rng.integers(0, 3))), replace=False) if k else []
        given = {found[j]: numbers(size, found[j].dimension) for j in chosen}
        if not given:
            cpds.append(pgm.GaussianCPD(child, numbers(size), cov))
        elif rng.random() < 0.5:
            cpds.append(pgm.LinearGaussianCPD(child, given, offset=numbers(size), cov=cov))
        else:
            matrices = list(given.values())

            def function(*parents, matrices=matrices):
                with np.errstate(all="ignore"):
                    return sum(a @ m.T for a, m in zip(parents, matrices, strict=True))

            cpds.append(pgm.NonlinearGaussianCPD(child, tuple(given), function, cov))
        found.append(child)
    evidence = {v: numbers(v.dimension) for v in found if rng.random() < 0.4}
    return cpds, evidence


@pytest.mark.parametrize("chunk", slow_after(1, range(4)))
def test_numbers_of_any_size_leak_no_warnings(chunk):
    """An answer that is finite, or an error of the library's own."""
    rules = [pgm.Taylor(), pgm.Unscented(), pgm.Cubature(), pgm.MonteCarlo(20)]
    answered = 0
    for seed in range(40 * chunk, 40 * chunk + 40):
        cpds, evidence = extreme(seed)
        schedule = [None, pgm.Calibration(iterations=3), pgm.Flooding()][seed % 3]
        graph = pgm.compile(pgm.BayesianNetwork(cpds))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", pgm.PrecisionWarning)
                warnings.simplefilter("ignore", pgm.ConvergenceWarning)
                posterior = pgm.infer(
                    graph, evidence, schedule=schedule, lineariser=rules[seed % 4]
                )
            hidden = [cpd.child for cpd in cpds if cpd.child not in evidence]
            parts = [posterior[v] for v in hidden]
            parts += [posterior.joint(*hidden)] if hidden else []
            assert all(np.isfinite(part.cov).all() for part in parts)
            assert np.isfinite(posterior.log_evidence)
            posterior.belief(0)
            answered += 1
        except pgm.PgmError:
            continue
    assert answered


@pytest.mark.parametrize("schedule", [pgm.Flooding(), pgm.Sequential(), pgm.Residual()], ids=repr)
def test_schedules_for_any_graph_tell_what_float64_leaves(schedule):
    """Deviations of 10⁶ beside 10⁻⁹; of moderate ones there is nothing to tell."""

    def solved(sharp):
        network = pgm.BayesianNetwork(
            [
                pgm.GaussianCPD(x, 0.0, 1e12),
                pgm.LinearGaussianCPD(y, {x: 0.24}, cov=sharp**2),
                pgm.LinearGaussianCPD(z, {x: 1.28}, cov=sharp**2),
            ]
        )
        graph = pgm.compile(network, method=pgm.Bethe())
        return pgm.infer(graph, {z: -2713270.3}, schedule=schedule)

    with pytest.warns(pgm.PrecisionWarning, match="digits"):
        lost = solved(1e-9)
    assert lost.status.digits < 6
    assert solved(1e5).status.digits is None
