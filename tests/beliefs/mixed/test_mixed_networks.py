"""Networks of discrete and continuous variables, against enumeration and published figures."""

import pickle
from contextlib import suppress
from itertools import product

import numpy as np
import pytest
from mixed.enumerated import drawn, enumerated, observed
from numpy.testing import assert_allclose
from scipy.stats import norm

import pgm
from models import mixed

MODE = pgm.Discrete("mode", states=("calm", "wild"))
FAIR = pgm.TableCPD(MODE, table=[0.5, 0.5])
X, Z = pgm.variables("x z")


def switched(child, calm, wild):
    return pgm.SwitchingCPD(child, given=MODE, cases={"calm": calm, "wild": wild})


def inferred(cpds, evidence, **options):
    return pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), evidence, **options)


def assert_tables(posterior, tables, tolerance=1e-12):
    for variable, due in tables.items():
        assert_allclose(posterior[variable].probabilities, due, atol=tolerance)


def assert_enumerated(network, evidence):
    total, tables, beliefs = enumerated(network, evidence)
    if total is None:  # evidence repeats itself, all but or exactly, in some configuration
        with suppress(pgm.NumericalError):
            assert_tables(pgm.infer(pgm.compile(network), evidence), tables, 1e-6)
        return
    posterior = pgm.infer(pgm.compile(network), evidence)
    assert_allclose(posterior.log_evidence, total, atol=1e-10, rtol=1e-10)
    assert_tables(posterior, tables)
    for variable, (mean, cov) in beliefs.items():
        size = max(1.0, np.abs(cov).max() ** 0.5)
        assert_allclose(posterior[variable].mean / size, mean / size, atol=1e-9)
        assert_allclose(posterior[variable].cov / size**2, cov / size**2, atol=1e-9)


@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("exact", [0.0, 0.25])
def test_drawn_networks(seed, exact):
    network, rng = drawn(seed, exact)
    assert_enumerated(network, observed(network, rng))


@pytest.mark.slow
@pytest.mark.parametrize("exact", [0.0, 0.25])
@pytest.mark.parametrize("part", range(10))
def test_many_drawn_networks(part, exact):
    for seed in range(1000 + 50 * part, 1050 + 50 * part):
        network, rng = drawn(seed, exact)
        assert_enumerated(network, observed(network, rng))


NAMED = {
    "E": mixed.efficiency,
    "C": mixed.dioxide,
    "D": mixed.dust,
    "L": mixed.light,
    "Min": mixed.metals_in,
    "Mout": mixed.metals_out,
}


def incinerator():
    """The network, its variables by Lauritzen's names, and its discrete ones."""
    return mixed.incinerator(), NAMED, (mixed.filter_state, mixed.waste, mixed.burning)


def test_published_figures_of_the_incinerator():
    network, named, (filters, waste, burning) = incinerator()
    graph = pgm.compile(network)
    before = pgm.infer(graph, {})
    due = {
        "E": (-3.25, 0.709),
        "D": (3.04, 0.770),
        "C": (-1.85, 0.507),
        "L": (1.48, 0.631),
        "Min": (-0.214, 0.459),
        "Mout": (2.83, 0.860),
    }
    for name, (mean, std) in due.items():
        assert_allclose(before[named[name]].mean, mean, atol=6e-3)
        assert_allclose(before[named[name]].std, std, atol=6e-4)
    seen = {waste: "industrial", named["L"]: 1.1, named["C"]: -0.9}
    after = pgm.infer(graph, seen)
    for name, mean, std in [
        ("E", -3.90, 0.076),
        ("D", 3.61, 0.326),
        ("Min", 0.50, 0.100),
        ("Mout", 4.11, 0.344),
    ]:
        assert_allclose(after[named[name]].mean, mean, atol=6e-3)
        assert_allclose(after[named[name]].std, std, atol=6e-4)
    assert_allclose(after[burning].probabilities[0], 0.0123, atol=6e-5)
    assert_allclose(after[filters].probabilities[0], 0.9995, atol=6e-5)
    assert after.log_evidence_kind == "exact"


def test_runs_are_those_of_one_at_a_time():
    network, named, (filters, waste, burning) = incinerator()
    graph = pgm.compile(network)
    light = np.array([[[1.1], [1.0], [np.nan]], [[0.7], [1.4], [1.5]]])
    kinds = np.array([0, -1, 1])
    posterior = pgm.infer(graph, {named["L"]: light, waste: kinds, named["C"]: -0.9})
    assert posterior[burning].probabilities.shape == (2, 3, 2)
    assert posterior[named["E"]].lead == (2, 3)
    for i, j in product(range(2), range(3)):
        seen = {named["L"]: light[i, j], named["C"]: -0.9}
        if kinds[j] >= 0:
            seen[waste] = int(kinds[j])
        alone = pgm.infer(graph, seen)
        assert_allclose(posterior.log_evidence[i, j], alone.log_evidence, rtol=1e-12)
        for variable in (burning, filters):
            found = posterior[variable].probabilities[i, j]
            assert_allclose(found, alone[variable].probabilities, atol=1e-13)
        for variable in (named["E"], named["Mout"]):
            found = posterior[variable][i, j]
            assert_allclose(found.mean, alone[variable].mean, rtol=1e-10)
            assert_allclose(found.cov, alone[variable].cov, rtol=1e-9)


def test_priors_may_have_runs():
    cpds = [FAIR, pgm.GaussianCPD(X, [[0.0], [3.0]], 1.0)]
    sensor = switched(
        Z, pgm.LinearGaussianCPD(Z, {X: 1.0}, 1.0), pgm.LinearGaussianCPD(Z, {X: -1.0}, 2.0)
    )
    found = inferred([*cpds, sensor], {Z: 1.0})
    for run, mean in enumerate((0.0, 3.0)):
        alone = inferred([FAIR, pgm.GaussianCPD(X, mean, 1.0), sensor], {Z: 1.0})
        assert_allclose(found[MODE].probabilities[run], alone[MODE].probabilities)
        assert_allclose(found[X][run].mean, alone[X].mean)


def test_a_long_row_of_hidden_states_and_readings():
    """A hidden Markov model with Gaussian readings, unrolled: each reading is a part of its own."""
    table, means, stds = np.array([[0.9, 0.1], [0.2, 0.8]]), (0.0, 3.0), (1.0, 1.5)
    readings = [0.1, 3.0, np.nan, 60.0, -0.4, 2.2]
    states = [pgm.Discrete(f"s{k}", 2) for k in range(len(readings))]
    cpds, evidence = [pgm.TableCPD(states[0], table=[0.5, 0.5])], {}
    for k, (state, value) in enumerate(zip(states, readings, strict=True)):
        z = pgm.Variable(f"z{k}")
        if k:
            cpds.append(pgm.TableCPD(state, states[k - 1], table=table))
        cases = {j: pgm.GaussianCPD(z, means[j], stds[j] ** 2) for j in range(2)}
        cpds.append(pgm.SwitchingCPD(z, state, cases))
        evidence[z] = value
    posterior = inferred(cpds, evidence)
    forward, total = np.array([0.5, 0.5]), 0.0
    for k, value in enumerate(readings):
        forward = forward @ table if k else forward
        if np.isfinite(value):
            logs = [
                -0.5 * ((value - m) / s) ** 2 - np.log(s) for m, s in zip(means, stds, strict=True)
            ]
            logs = np.array(logs) - 0.5 * np.log(2 * np.pi)
            forward = forward * np.exp(logs - logs.max())
            total += logs.max() + np.log(forward.sum())
            forward /= forward.sum()
    assert_allclose(posterior[states[-1]].probabilities, forward, atol=1e-13)
    assert_allclose(posterior.log_evidence, total, rtol=1e-13)


def test_cases_that_are_not_linear_are_weighed_as_networks_of_their_own():
    prior = switched(X, pgm.GaussianCPD(X, 0.2, 0.1), pgm.GaussianCPD(X, 1.0, 0.3))
    calm = pgm.NonlinearGaussianCPD(Z, X, np.sin, 0.1, lineariser=pgm.Unscented())
    wild = pgm.NonlinearGaussianCPD(Z, X, np.cosh, 0.2)
    schedule = pgm.Calibration(iterations=60)
    found = inferred([FAIR, prior, switched(Z, calm, wild)], {Z: 0.7}, schedule=schedule)
    logs, means = [], []
    for first, sensor in ((pgm.GaussianCPD(X, 0.2, 0.1), calm), (pgm.GaussianCPD(X, 1, 0.3), wild)):
        alone = inferred([first, sensor], {Z: 0.7}, schedule=schedule)
        logs.append(alone.log_evidence)
        means.append(alone[X].mean)
    weights = np.exp(logs) / np.exp(logs).sum()
    assert_allclose(found[MODE].probabilities, weights, atol=1e-12)
    assert_allclose(found[X].mean, weights @ means, atol=1e-12)
    assert_allclose(found.log_evidence, np.log(0.5 * np.exp(logs).sum()), atol=1e-12)
    assert found.log_evidence_kind == "linearised"
    assert found.status.iterations > 1
    started = inferred([FAIR, prior, switched(Z, calm, wild)], {Z: 0.7}, start={X: [0.9]})
    assert not started.status.converged


def test_joints():
    network, named, (filters, waste, burning) = incinerator()
    posterior = pgm.infer(pgm.compile(network), {named["L"]: 1.1})
    outward, E, C = named["Mout"], named["E"], named["C"]
    joint = posterior.joint(outward, C, E)  # C is of a part of its own
    assert joint.scope == (outward, C, E)
    for k, variable in enumerate(joint.scope):
        assert_allclose(joint.mean[k], posterior[variable].mean[0])
        assert_allclose(joint.cov[k, k], posterior[variable].cov[0, 0])
    total = 0.0  # their covariance is that of the means of configurations
    for states in product(filters.states, waste.states, burning.states):
        seen = {named["L"]: 1.1, **dict(zip((filters, waste, burning), states, strict=True))}
        alone = pgm.infer(pgm.compile(network), seen)
        weight = np.exp(alone.log_evidence - posterior.log_evidence)
        total += weight * alone[outward].mean[0] * alone[C].mean[0]
    assert_allclose(joint.cov[0, 1], total - joint.mean[0] * joint.mean[1], atol=1e-10)
    tables = posterior.joint(waste, burning)
    assert_allclose(tables.probabilities.sum(axis=0), posterior[burning].probabilities)
    with pytest.raises(pgm.EvidenceError, match="neither a table nor a mixture"):
        posterior.joint(waste, C)


def test_a_value_that_is_certain_outweighs_a_density():
    sensor = switched(Z, pgm.GaussianCPD(Z, 5.0, 0.0), pgm.GaussianCPD(Z, 5.0, 1.0))
    readings = [[5.0], [4.0], [np.nan]]
    found = inferred([FAIR, sensor], {Z: readings})
    assert_allclose(found[MODE].probabilities, [[1, 0], [0, 1], [0.5, 0.5]])
    density = -0.5 - 0.5 * np.log(2 * np.pi)
    assert_allclose(found.log_evidence, [np.log(0.5), np.log(0.5) + density, 0.0], atol=1e-14)
    # No point mass where the reading's own source is uncertain.
    exact, noisy = pgm.LinearGaussianCPD(Z, {X: 1.0}, 0.0), pgm.LinearGaussianCPD(Z, {X: 1.0}, 1.0)
    found = inferred([FAIR, pgm.GaussianCPD(X, 0, 1), switched(Z, exact, noisy)], {Z: 1.0})
    densities = np.exp([-0.5, -0.25]) / np.sqrt([1.0, 2.0])
    assert_allclose(found[MODE].probabilities, densities / densities.sum())
    # Two sharp readings of one source are not certain.
    other = pgm.Variable("other")
    sharp = [pgm.LinearGaussianCPD(v, {X: 1.0}, 1e-16) for v in (Z, other)]
    prior = switched(X, pgm.GaussianCPD(X, 0, 1), pgm.GaussianCPD(X, 1, 1))
    found = inferred([FAIR, prior, *sharp], {Z: 1.0, other: 1.0 + 1e-8})
    assert_allclose(found[MODE].probabilities[0], 1 / (1 + np.exp(0.5)), rtol=1e-6)


def test_which_relations_are_exact_may_hang_on_states():
    """Cases with and without sources of noise are not solved as runs of one tree."""
    source, mode = pgm.Variable("source"), pgm.Discrete("d", 3)
    first = {0: pgm.GaussianCPD(X, 1, 0), 1: pgm.GaussianCPD(X, 4, 0)}
    first[2] = pgm.LinearGaussianCPD(X, {source: 1.0}, 0.0)
    slopes = {k: pgm.LinearGaussianCPD(Z, {X: a}, 0.0) for k, a in enumerate((4.0, 1.0, 1.0))}
    cpds = [pgm.TableCPD(mode, table=[0.4, 0.4, 0.2]), pgm.GaussianCPD(source, 0, 1)]
    switches = [pgm.SwitchingCPD(X, mode, first), pgm.SwitchingCPD(Z, mode, slopes)]
    found = inferred([*cpds, *switches], {Z: 4.0})
    assert_allclose(found[mode].probabilities, [0.5, 0.5, 0.0])
    assert_allclose(found.log_evidence, np.log(0.8))


def test_a_prior_that_is_exact_in_some_runs_is_refused():
    prior = pgm.GaussianCPD(X, np.zeros((2, 1)), np.array([[[0.0]], [[1.0]]]))
    sensor = switched(
        Z, pgm.LinearGaussianCPD(Z, {X: 1.0}, 0.0), pgm.LinearGaussianCPD(Z, {X: 1.0}, 1.0)
    )
    with pytest.raises(pgm.NumericalError, match="noise in others"):
        inferred([FAIR, prior, sensor], {Z: 0.0})


def test_evidence_that_repeats_itself_exactly_is_refused():
    other, exact = pgm.Variable("other"), pgm.LinearGaussianCPD(Z, {X: 1.0}, 0.0)
    calm = pgm.LinearGaussianCPD(other, {X: 1.0}, 0.0)
    wild = pgm.LinearGaussianCPD(other, {X: 2.0}, 0.0, offset=-0.5)
    cpds = [FAIR, pgm.GaussianCPD(X, 0, 1), exact, switched(other, calm, wild)]
    with pytest.raises(pgm.NumericalError, match="repeats itself"):
        inferred(cpds, {Z: 0.5, other: 0.5})
    assert_allclose(inferred(cpds, {Z: 1.0, other: 1.5})[MODE].probabilities, [0, 1])


def test_noise_that_a_function_makes_zero_is_refused():
    driven = pgm.LinearGaussianCPD(Z, {X: 1.0}, pgm.noise(lambda x: 0 * x[..., None], given=X))
    cpds = [FAIR, switched(Z, pgm.GaussianCPD(Z, 5, 4), driven)]
    with pytest.raises(pgm.NumericalError, match="zero in some direction"):
        inferred(cpds, {Z: 5.0, X: 5.0})


def test_functions_that_are_zero_and_readings_that_contradict_them():
    """Which relations are exact is known only when they are solved, all states in one call."""
    prior = switched(X, pgm.GaussianCPD(X, 0, 1), pgm.GaussianCPD(X, 1, 1))
    others = pgm.variables("one other")
    u = pgm.Variable("u")
    noise = [pgm.noise(lambda u: 0 * u[..., None], given=u) for _ in others]
    read = [pgm.LinearGaussianCPD(v, {X: 1.0}, n) for v, n in zip(others, noise, strict=True)]
    for second, words in ((2.0, "contradicts an exact model"), (1.0, "zero in some direction")):
        with pytest.raises(pgm.NumericalError, match=words):
            inferred([FAIR, prior, *read], {others[0]: 1.0, others[1]: second, u: 1.0})


def test_a_wide_prior_is_not_certain():
    a, b, w = pgm.variables("a b w")
    read = pgm.LinearGaussianCPD(a, {X: 1.0}, 1.0)
    sensor = switched(
        b, pgm.LinearGaussianCPD(b, {X: 1.0}, 1.0), pgm.LinearGaussianCPD(b, {X: 1.0}, 1e6)
    )
    cpds = [FAIR, pgm.GaussianCPD(X, 0, 1e28), read, sensor]
    cpds.append(pgm.LinearGaussianCPD(w, {X: 1.0}, 0.0))
    assert_allclose(inferred(cpds, {a: 0.0, b: 30.0})[MODE].probabilities, [0, 1], atol=1e-12)


def test_tables_have_the_runs_of_all_evidence():
    cpds = [FAIR, pgm.GaussianCPD(X, 0, 1), pgm.LinearGaussianCPD(Z, {X: 1.0}, 1.0)]
    for known, due in [
        ({}, (2, 3)),
        ({MODE: pgm.soft([0.1, 0.9])}, (2, 3)),
        ({MODE: [0, -1, 1]}, (2, 3)),
        ({MODE: np.array([[0], [-1]])}, (2, 3)),
    ]:
        found = inferred(cpds, {Z: np.zeros((2, 3, 1)), **known})
        assert found[MODE].probabilities.shape == (*due, 2)
        assert found.log_evidence.shape == found[X].lead == due
        assert repr(found)


def test_many_parts_of_one_opinion():
    cpds, evidence = [FAIR], {}
    for k in range(200):
        z = pgm.Variable(f"z{k}")
        cpds.append(switched(z, pgm.GaussianCPD(z, 0, 1), pgm.GaussianCPD(z, 40, 1)))
        evidence[z] = 0.0
    assert_allclose(inferred(cpds, evidence)[MODE].probabilities, [1, 0])
    # Weights that one run leaves out say nothing of another.
    pair = [pgm.Variable("one"), pgm.Variable("other")]
    cpds = [switched(v, pgm.GaussianCPD(v, 0, 1), pgm.GaussianCPD(v, 15, 1)) for v in pair]
    found = inferred([FAIR, *cpds], {pair[0]: [[0.0], [100.0]], pair[1]: 15.0})
    assert_allclose(found[MODE].probabilities, [[0.5, 0.5], [0, 1]], atol=1e-12)


def test_digits_are_those_of_states_that_may_be():
    sharp = switched(
        Z, pgm.LinearGaussianCPD(Z, {X: 1.0}, 0.1), pgm.LinearGaussianCPD(Z, {X: 2.0}, 1e-24)
    )
    found = inferred([FAIR, pgm.GaussianCPD(X, 1e6, 1), sharp], {Z: 1e6})
    assert_allclose(found[MODE].probabilities, [1, 0])
    assert found.status.digits is None or found.status.digits > 6


def test_as_a_data_set():
    pytest.importorskip("xarray")
    found = inferred(
        [FAIR, switched(X, pgm.GaussianCPD(X, 0, 1), pgm.GaussianCPD(X, 8, 4))], {}
    ).to_xarray()
    assert_allclose(found["mode"], [0.5, 0.5])
    assert_allclose(found["mean"], [4.0])


def test_parts_that_are_certain_of_what_excludes_one_another_are_refused():
    other = pgm.Variable("other")
    one = switched(Z, pgm.GaussianCPD(Z, 5.0, 0.0), pgm.GaussianCPD(Z, 5.0, 1.0))
    two = switched(other, pgm.GaussianCPD(other, 1.0, 1.0), pgm.GaussianCPD(other, 1.0, 0.0))
    with pytest.raises(pgm.NumericalError, match="exclude one another"):
        inferred([FAIR, one, two], {Z: 5.0, other: 1.0})
    hidden = switched(X, pgm.GaussianCPD(X, 5.0, 0.0), pgm.GaussianCPD(X, 5.0, 1.0))
    bent = pgm.NonlinearGaussianCPD(other, X, np.sin, 1.0)
    # Noise of its own leaves a reading uncertain, whatever its function is.
    each = norm.pdf(1.0, np.sin(5.0), np.sqrt([1.0, 1.0 + np.cos(5.0) ** 2]))
    found = inferred([FAIR, hidden, bent], {other: 1.0})
    assert_allclose(found[MODE].probabilities, each / each.sum(), rtol=1e-12)
    read = pgm.LinearGaussianCPD(Z, {other: 1.0}, 0.0)
    with pytest.raises(pgm.NumericalError, match="others depend are linear"):
        inferred([FAIR, hidden, bent, read], {Z: 1.0})


def test_what_no_configuration_allows_is_refused():
    both = switched(Z, pgm.GaussianCPD(Z, 5.0, 0.0), pgm.GaussianCPD(Z, 6.0, 0.0))
    found = inferred([FAIR, both], {Z: [[5.0], [6.0]]})
    assert_allclose(found[MODE].probabilities, np.eye(2))
    with pytest.raises(pgm.NumericalError, match="contradicts an exact model"):
        inferred([FAIR, both], {Z: [[5.0], [4.0]]})
    other = pgm.Variable("other")
    again = switched(other, pgm.GaussianCPD(other, 5.0, 0.0), pgm.GaussianCPD(other, 6.0, 0.0))
    with pytest.raises(pgm.EvidenceError, match="probability zero, in run 1"):
        inferred([FAIR, both, again], {Z: [[5.0], [5.0]], other: [[5.0], [6.0]]})


def test_parts_that_contradict_one_another_by_thousands_of_nats():
    other = pgm.Variable("other")
    wide = [pgm.GaussianCPD(v, m, 1.0) for v in (Z, other) for m in (0.0, 100.0)]
    apart = [switched(Z, *wide[:2]), switched(other, *wide[:1:-1])]
    found = inferred([FAIR, *apart], {Z: 0.0, other: 0.1})
    levels = norm(0, 1).logpdf([0, 100]) + norm(0, 1).logpdf([99.9, 0.1])
    assert_allclose(found.log_evidence, np.logaddexp(*levels) - np.log(2), rtol=1e-14)
    assert_allclose(found[MODE].probabilities[1], 1 / (1 + np.exp(levels[0] - levels[1])))


def test_soft_evidence_by_log_weights():
    seen = switched(Z, pgm.GaussianCPD(Z, 0.0, 1.0), pgm.GaussianCPD(Z, 3.0, 1.0))
    due = inferred([FAIR, seen], {Z: 1.0, MODE: pgm.soft([0.2, 0.8])})
    weights = np.log([0.2, 0.8])
    found = inferred([FAIR, seen], {Z: 1.0, MODE: pgm.soft(weights - 900, log=True)})
    assert_allclose(found[MODE].probabilities, due[MODE].probabilities, rtol=1e-12)
    assert_allclose(found.log_evidence, due.log_evidence - 900, rtol=1e-14)
    # A point mass outweighs a density, whatever weight its state has, as long as it has one.
    sure = switched(Z, pgm.GaussianCPD(Z, 1.0, 1.0), pgm.GaussianCPD(Z, 1.0, 0.0))
    found = inferred([FAIR, sure], {Z: 1.0, MODE: pgm.soft([0.0, -900.0], log=True)})
    assert_allclose(found[MODE].probabilities, [0, 1])
    assert_allclose(found.log_evidence, np.log(0.5) - 900)
    found = inferred([FAIR, sure], {Z: 1.0, MODE: pgm.soft([0.0, -np.inf], log=True)})
    assert_allclose(found[MODE].probabilities, [1, 0])


def test_too_many_configurations_are_refused_before_any_work():
    modes = [pgm.Discrete(f"m{k}", 4) for k in range(12)]
    each = [pgm.Variable(f"x{k}") for k in range(12)]
    cpds = [pgm.TableCPD(mode, table=np.full(4, 0.25)) for mode in modes]
    for mode, x in zip(modes, each, strict=True):
        cases = {k: pgm.GaussianCPD(x, k, 1.0) for k in range(4)}
        cpds.append(pgm.SwitchingCPD(x, mode, cases))
    cpds.append(pgm.LinearGaussianCPD(Z, dict.fromkeys(each, 1.0), 1.0))
    graph = pgm.compile(pgm.BayesianNetwork(cpds))
    with pytest.raises(pgm.GraphError, match="16,777,216 configurations"):
        pgm.infer(graph, {Z: 3.0})
    known = dict.fromkeys(modes[:9], 0)
    assert pgm.infer(graph, {Z: 3.0, **known})[modes[9]].probabilities.shape == (4,)
    with pytest.raises(pgm.GraphError, match="z was left out"):
        pgm.infer(graph, {})[Z]
    # Without the reading each is a part by itself.
    assert_allclose(pgm.infer(graph, {})[each[0]].mean, 1.5)


def test_shows_itself():
    posterior = inferred(
        [FAIR, switched(X, pgm.GaussianCPD(X, 0, 1), pgm.GaussianCPD(X, 8, 4))], {}
    )
    assert "mode  calm 0.5, wild 0.5" in repr(posterior)
    assert "4.00 ± 4.30" in repr(posterior)
    assert "mode" in posterior._repr_html_()
    assert_allclose(pickle.loads(pickle.dumps(posterior))[X].mean, 4.0)
    known = inferred([FAIR, posterior.graph.network.cpds[1]], {MODE: "wild"})
    assert repr(known[X]) == repr(pgm.Gaussian(X, [8.0], [4.0]))


@pytest.mark.parametrize(
    ("ask", "error", "words"),
    [
        (lambda p: p[Z], pgm.EvidenceError, "z is observed"),
        (lambda p: p[pgm.Variable("q")], pgm.EvidenceError, "q is not in the network"),
        (lambda p: p.joint(), pgm.EvidenceError, "one or more"),
        (lambda p: p.belief(0), pgm.GraphError, "mixtures of a mixed network have none"),
        (lambda p: pgm.audit(p, rng=0), pgm.ModelError, "mixed network"),
        (lambda p: pgm.view(p, "page.html"), pgm.GraphError, "mixtures"),
        (lambda p: pgm.query(p.graph.network, MODE), pgm.GraphError, "this one is mixed"),
        (lambda p: pgm.most_probable(p.graph, {}), pgm.GraphError, "discrete networks"),
        (lambda p: pgm.infer(p.graph, {Z: 1}, keep=[X]), pgm.GraphError, "keep="),
        (lambda p: pgm.infer(p.graph, {}, schedule=pgm.Flooding()), pgm.GraphError, "loops"),
        (lambda p: pgm.infer(p.graph, {}, start={Z: 1}), pgm.EvidenceError, None),
        (lambda p: pgm.infer(p.graph, {Z: 1}, start={X: [[1.0]] * 2}), pgm.EvidenceError, "start"),
        (lambda p: pgm.infer(p.graph, {Z: [[1.0]] * 2, MODE: [0] * 3}), pgm.EvidenceError, "axes"),
        (lambda p: pgm.infer(p.graph, {pgm.Variable("q"): 1.0}), pgm.EvidenceError, "q"),
        (lambda p: pgm.compile(p.graph.network, compiled=True), pgm.ModelError, "tables"),
    ],
)
def test_what_it_cannot_answer_is_refused(ask, error, words):
    cpds = [FAIR, switched(X, pgm.GaussianCPD(X, 0, 1), pgm.GaussianCPD(X, 8, 4))]
    posterior = inferred([*cpds, pgm.LinearGaussianCPD(Z, {X: 1.0}, 1.0)], {Z: 1.0})
    with pytest.raises(error, match=words):
        ask(posterior)


def test_robust_noise_is_refused():
    bent = pgm.LinearGaussianCPD(Z, {X: 1.0}, 1.0, noise=pgm.StudentT(4.0))
    with pytest.raises(pgm.ModelError, match="robust noise"):
        inferred([FAIR, pgm.GaussianCPD(X, 0, 1), bent], {Z: 1.0})


def test_the_tree_is_a_strong_one():
    """Continuous variables leave first, or their separators would join more discrete ones."""
    network, _, discrete = incinerator()
    graph = pgm.compile(network)
    graph.check()
    assert max(graph.sizes) == 24  # eight configurations of three components
    others = [v for v in network.variables if v not in discrete]
    orders = [*discrete, *others], [*others, *discrete]  # whatever an order says
    one, other = (pgm.compile(network, method=pgm.JunctionTree(order=o)).sizes for o in orders)
    assert one == other


def test_cases_that_differ_in_their_matrices_alone_are_told_apart():
    cases = {k: pgm.LinearGaussianCPD(Z, {X: f}, cov=0.1) for k, f in enumerate((1.0, 3.0))}
    sensor = pgm.SwitchingCPD(Z, given=MODE, cases=cases)
    found = inferred([FAIR, pgm.GaussianCPD(X, 0.0, 1.0), sensor], {Z: 3.0})
    each = norm.pdf(3.0, 0.0, np.sqrt([1.1, 9.1]))
    assert_allclose(found[MODE].probabilities, each / each.sum(), rtol=1e-12)
    at = found[X].components.mean[:, 0]
    assert_allclose(at, [3.0 / 1.1, 9.0 / 9.1], rtol=1e-12)
