"""Messages that diverge on graphs with loops: stopped, told with the cause, and never NaN."""

import warnings

import numpy as np
import pytest

import pgm
from pgm.beliefs.gaussian.walks import shown, spectral_radius

LTRIP = pgm.LTRIP()


def readings_of_four(seed, noise, unknowns=8):
    """Return as many sharp readings as unknowns, each of a combination of four, and J."""
    rng = np.random.default_rng(seed)
    hidden = [pgm.Variable(f"v{k}") for k in range(unknowns)]
    cpds, evidence, J = [pgm.GaussianCPD(v, 0.0, 1.0) for v in hidden], {}, np.eye(unknowns)
    for k in range(unknowns):
        row = np.zeros(unknowns)
        some = rng.choice(unknowns, size=4, replace=False)
        row[some] = rng.choice([-1.0, 1.0], size=4) * rng.uniform(0.5, 2.0, 4)
        reading = pgm.Variable(f"c{k}")
        given = {hidden[j]: float(row[j]) for j in some}
        cpds.append(pgm.LinearGaussianCPD(reading, given=given, cov=noise))
        evidence[reading] = float(rng.normal())
        J += np.outer(row, row) / noise
    return pgm.BayesianNetwork(cpds), evidence, hidden, J


def sums_of_four(count=3, noise=1e-3):
    """Return sharp readings of the sum of four unknowns, whose loops amplify fast, and J."""
    hidden = list(pgm.variables("v1 v2 v3 v4"))
    cpds, evidence, J = [pgm.GaussianCPD(v, 0.0, 1.0) for v in hidden], {}, np.eye(4)
    for k in range(count):
        reading = pgm.Variable(f"s{k}")
        cpds.append(pgm.LinearGaussianCPD(reading, given=dict.fromkeys(hidden, 1.0), cov=noise))
        evidence[reading] = 2.0
        J += np.ones((4, 4)) / noise
    return pgm.BayesianNetwork(cpds), evidence, hidden, J


def radius(J):
    """Return the spectral radius of the absolute partial correlations, by their eigenvalues."""
    scale = np.sqrt(np.diag(J))
    return np.abs(np.linalg.eigvals(np.abs(np.eye(len(J)) - J / np.outer(scale, scale)))).max()


def sent(graph, evidence, schedule):
    """Return the posterior, and the one warning, if any."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = pgm.infer(graph, evidence, schedule=schedule)
    assert len(caught) <= 1
    if not caught:
        return found, ""
    assert caught[0].category is pgm.ConvergenceWarning
    assert caught[0].filename == __file__
    return found, str(caught[0].message)


@pytest.mark.parametrize("schedule", [pgm.Flooding(), pgm.Sequential()])
def test_divergence_is_stopped_and_told(schedule):
    net, evidence, hidden, J = sums_of_four()
    found, told = sent(pgm.compile(net, method=pgm.Bethe()), evidence, schedule)
    residuals = found.status.residuals
    assert not found.status.converged
    assert found.status.iterations < 1000
    assert residuals[-1] > 1e4 * residuals.min()
    assert (residuals[:-1] <= 1e4 * np.minimum.accumulate(residuals[:-1])).all()
    assert f"diverged, and were stopped after {found.status.iterations} rounds" in told
    assert f"changed one by {residuals[-1]:.3g} " in told
    assert "not walk-summable: the spectral radius of |R|" in told
    assert f" is {radius(J):.3g}, " in told
    assert "damping=0.5" in told
    assert "pgm.LTRIP()" in told
    for v in hidden:
        assert np.isfinite(found[v].mean).all()
        assert abs(found[v].mean[0]) < 1e8
        assert found[v].cov[0, 0] > 0.0


def test_with_a_tolerance_of_zero_only_divergence_is_told():
    net, evidence, _, _ = sums_of_four()
    graph = pgm.compile(net, method=pgm.Bethe())
    found, told = sent(graph, evidence, pgm.Flooding(iterations=3, tolerance=0))
    assert not found.status.converged
    assert told == ""
    _, told = sent(graph, evidence, pgm.Flooding(tolerance=0))
    assert "diverged, and were stopped" in told


def test_messages_that_go_round_without_end_are_told():
    """Here the largest changes first neither settle nor diverge."""
    net, evidence, _, J = sums_of_four()
    schedule = pgm.Residual(iterations=20)
    found, told = sent(pgm.compile(net, method=pgm.Bethe()), evidence, schedule)
    assert "had not settled after 20 rounds" in told
    assert f"changed one by {found.status.residuals[-1]:.3g} " in told
    assert f" is {radius(J):.3g}, " in told


def test_whatever_messages_do_is_right_or_told():
    """Of drawn networks Bethe graphs hardly ever settle and LTRIP's mostly do, as they say."""
    settled = {"Bethe": 0, "LTRIP": 0}
    for seed in range(4):
        net, evidence, hidden, _ = readings_of_four(seed, 0.1)
        exact = pgm.infer(pgm.compile(net), evidence)
        for method in (pgm.Bethe(), LTRIP):
            graph = pgm.compile(net, method=method)
            found, told = sent(graph, evidence, pgm.Sequential(iterations=100))
            assert bool(told) != bool(found.status.converged)
            if told:
                continue
            settled[type(method).__name__] += 1
            for v in hidden:
                off = abs(found[v].mean[0] - exact[v].mean[0])
                assert off <= 1e-6 * exact[v].std[0]
    assert settled["LTRIP"] > settled["Bethe"]


def test_the_radius_of_networks_that_are_and_are_not_walk_summable():
    for noise, unknowns in ((1e-3, 8), (100.0, 6)):
        net, evidence, _, J = readings_of_four(3, noise, unknowns)
        graph = pgm.compile(net, method=pgm.Bethe())
        found, _ = sent(graph, evidence, pgm.Flooding(iterations=3))
        assert spectral_radius(found._outcome._sent, 0) == pytest.approx(radius(J), rel=1e-9)
        assert found._why_unsettled().startswith(
            "The network is walk-summable" if radius(J) < 1.0 else "The network is not walk-summ"
        )


def test_the_radius_is_of_the_run_that_is_furthest_off():
    """Two runs of a nonlinear network are linearised at different points: J differs."""
    x, y, a, b = pgm.variables("x y a b")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, 0.0, 1.0),
            pgm.GaussianCPD(y, 0.0, 1.0),
            pgm.NonlinearGaussianCPD(a, (x, y), lambda x, y: x + y + 0.1 * x**2, 0.01),
            pgm.LinearGaussianCPD(b, {x: 1.0, y: 1.0}, cov=0.01),
        ]
    )
    graph = pgm.compile(net, method=pgm.Bethe())
    found, told = sent(graph, {a: [[0.0], [9.0]], b: [[0.0], [5.0]]}, pgm.Flooding(iterations=4))
    last = int(np.argmax(found.status.residuals[-1]))
    group = [family.exact for family in found._outcome._model.families].index(False)
    at = found._outcome._model.points[group][0][0, last]  # where the function is expanded
    rows = np.array([[1.0 + 0.2 * at[0], 1.0], [1.0, 1.0]]) / 0.1
    assert f"{radius(np.eye(2) + rows.T @ rows):.3g}" in told or "walk-summable (" in told
    assert spectral_radius(found._outcome._sent, last) == pytest.approx(
        radius(np.eye(2) + rows.T @ rows), rel=1e-9
    )


def differences(noise, loop=4):
    """Return a ring of unknowns with sharp readings of neighbours' differences, and J."""
    hidden = [pgm.Variable(f"v{k}") for k in range(loop)]
    cpds, evidence, J = [pgm.GaussianCPD(v, 0.0, 1.0) for v in hidden], {}, np.eye(loop)
    for k in range(loop):
        row = np.zeros(loop)
        row[[k, (k + 1) % loop]] = 1.0, -1.0
        reading = pgm.Variable(f"d{k}")
        given = {hidden[k]: 1.0, hidden[(k + 1) % loop]: -1.0}
        cpds.append(pgm.LinearGaussianCPD(reading, given=given, cov=noise))
        evidence[reading] = 0.3 * k
        J += np.outer(row, row) / noise
    return pgm.BayesianNetwork(cpds), evidence, J


@pytest.mark.parametrize("noise", [1e-4, 1e-7])
def test_a_radius_that_rounds_to_one_is_told_by_its_difference(noise):
    """Of this ring it is 1 / (1 + noise/2), with 2/noise + 1 on the diagonal of J."""
    net, evidence, J = differences(noise)
    schedule = pgm.Sequential(iterations=40)
    found, told = sent(pgm.compile(net, method=pgm.Bethe()), evidence, schedule)
    assert not found.status.converged
    gap = 1.0 - 1.0 / (1.0 + noise / 2.0)
    np.testing.assert_allclose(1.0 - radius(J), gap, rtol=1e-6)
    assert "The network is walk-summable" in told
    assert f" is 1 − {gap:.1g}): the nearer 1, the slower" in told


RADII = {0.99941: "0.9994", 0.99997: "1 − 3e-05", 1.0: "1", 1.0004: "1 + 0.0004", 1.006: "1.01"}


@pytest.mark.parametrize("value", RADII)
def test_how_a_radius_is_shown(value):
    assert shown(value) == RADII[value]


def test_damping_is_not_offered_where_residuals_shrink_steadily():
    """There it would only slow: of as many rounds, damped ones leave more to do."""
    net, evidence, _ = differences(1e-2)
    graph = pgm.compile(net, method=pgm.Bethe())
    found, told = sent(graph, evidence, pgm.Sequential(iterations=100))
    assert (np.diff(found.status.residuals[-11:]) < 0.0).all()
    assert "damping=" not in told
    assert "Try iterations=" in told
    damped, told = sent(graph, evidence, pgm.Sequential(iterations=100, damping=0.5))
    assert "damping=" not in told
    assert damped.status.residuals[-1] > found.status.residuals[-1]
    _, told = sent(graph, evidence, pgm.Sequential(iterations=5))
    assert "damping=0.5" in told, "too few rounds to judge by"


def test_no_cause_is_told_where_none_is_known():
    """CPDs without noise have no information matrix; trees have no loops."""
    x, y, z, w = pgm.variables("x y z w")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, 1.0, 2.0),
            pgm.LinearGaussianCPD(y, {x: 1.0}, cov=0.0),
            pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1),
            pgm.LinearGaussianCPD(w, {y: 1.0, z: 1.0}, cov=0.1),
        ]
    )
    graph = pgm.compile(net, method=pgm.Bethe())
    _, told = sent(graph, {w: 6.0}, pgm.Flooding(iterations=2))
    assert "had not settled after 2 rounds" in told
    assert "walk-summable" not in told
    assert pgm.infer(pgm.compile(net), {w: 6.0})._why_unsettled() == ""


def test_a_run_that_diverges_stays_behind_and_spoils_no_other():
    """Runs of one network share matrices; evidence as expected has nothing that could grow."""
    net, evidence, hidden, _ = sums_of_four()
    graph = pgm.compile(net, method=pgm.Bethe())
    both = {c: [[0.0], [value]] for c, value in evidence.items()}
    found, told = sent(graph, both, pgm.Flooding(iterations=400))
    assert found.status.converged.tolist() == [True, False]
    assert "in 1 of 2 runs" in told
    for v in hidden:
        np.testing.assert_allclose(found[v].mean[0], 0.0, atol=1e-12)
        assert abs(found[v].mean[1, 0]) < 1e8


def test_a_run_that_settles_slowly_is_told_how_long_it_takes():
    net, evidence, _, _ = readings_of_four(2, 1.0)
    graph = pgm.compile(net, method=LTRIP)
    _, told = sent(graph, evidence, pgm.Sequential(iterations=12))
    assert "LTRIP" not in told, "it is one"
    needed = int(told.split("iterations=")[1].split(",")[0])
    _, told = sent(graph, evidence, pgm.Sequential(iterations=2 * needed))
    assert told == ""


@pytest.mark.parametrize("scale", [1.0, 1e8])
def test_rounding_of_far_means_is_no_change(scale):
    """At 10⁸ deviations a message changes by 10⁻⁷ of them for ever."""
    net, evidence, hidden, _ = readings_of_four(2, 1.0)
    far = {c: scale * value for c, value in evidence.items()}
    found, told = sent(pgm.compile(net, method=LTRIP), far, pgm.Sequential())
    assert found.status.converged
    assert told == ""
    exact = pgm.infer(pgm.compile(net), far)
    for v in hidden:
        assert abs(found[v].mean[0] - exact[v].mean[0]) < 1e-6 * max(scale * 1e-6, 1.0)


# ---- tables


def ising(side, coupling, field, signs=None):
    """Return spins on a square grid, neighbours read as the same, P ∝ exp(J Σ s s' + h Σ s)."""
    spins = {(i, j): pgm.Discrete(f"s{i}{j}", ("-", "+")) for i in range(side) for j in range(side)}
    up = 1.0 / (1.0 + np.exp(-2.0 * field))
    cpds, evidence = [pgm.TableCPD(s, table=(1.0 - up, up)) for s in spins.values()], {}
    for (i, j), spin in spins.items():
        for place in ((i + 1, j), (i, j + 1)):
            if place not in spins:
                continue
            sign = 1.0 if signs is None else signs.choice([-1.0, 1.0])
            yes = 1.0 / (1.0 + np.exp(-2.0 * coupling * sign))
            reading = pgm.Discrete(f"z{len(evidence)}", ("other", "same"))
            alike, unlike = (1.0 - yes, yes), (yes, 1.0 - yes)
            cpds.append(
                pgm.TableCPD(
                    reading, given=(spin, spins[place]), table=[[alike, unlike], [unlike, alike]]
                )
            )
            evidence[reading] = "same"
    return pgm.BayesianNetwork(cpds), evidence, list(spins.values())


@pytest.mark.parametrize("schedule", [pgm.Flooding, pgm.Sequential, pgm.Residual])
def test_a_frustrated_ising_model_wanders_and_is_told(schedule):
    net, evidence, spins = ising(4, 2.0, 0.1, np.random.default_rng(1))
    graph = pgm.compile(net, method=pgm.Bethe())
    found, told = sent(graph, evidence, schedule(iterations=30))
    assert not found.status.converged
    assert "had not settled after 30 rounds" in told
    assert f"changed one by {found.status.residuals[-1]:.3g} (tolerance 1e-10" in told
    assert "pgm.LTRIP()" in told
    assert "damping=0.5" in told
    assert "walk-summable" not in told
    for spin in spins:
        assert found[spin].probabilities.sum() == pytest.approx(1.0)


def test_spins_that_leave_an_unstable_fixed_point_are_not_stopped():
    """In a weak field residuals grow 10⁴-fold, to a stable fixed point, where they settle."""
    net, evidence, spins = ising(4, 0.7, 1e-8)
    found, told = sent(pgm.compile(net, method=pgm.Bethe()), evidence, pgm.Sequential())
    residuals = found.status.residuals
    assert (residuals / np.minimum.accumulate(residuals)).max() > 1e4
    assert found.status.converged
    assert told == ""
    assert found[spins[5]]["+"] > 0.8
