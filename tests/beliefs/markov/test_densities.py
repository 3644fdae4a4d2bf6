"""Hidden Markov models that read numbers, against sums over all paths and SciPy's densities."""

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import pgm

MODE = pgm.Discrete("mode", states=("calm", "wild", "off"))
FAULT = pgm.Discrete("fault", states=("no", "yes"))
SWITCH = pgm.Discrete("switch", states=("low", "high"))
U = pgm.Variable("u")
Z = pgm.Variable("z", components=("east", "north"))
W = pgm.Variable("w")
FIRST, MOVES = np.array([0.5, 0.3, 0.2]), np.array([[0.8, 0.2, 0], [0.1, 0.6, 0.3], [0, 0.5, 0.5]])
FAULTS = np.array([[0.9, 0.1], [0.7, 0.3], [0.5, 0.5]])
MEANS = np.array([[0.0, 1.0], [2.0, -1.0], [-3.0, 0.5]])
COVS = np.array([[[1.0, 0.3], [0.3, 2.0]], [[0.5, 0.0], [0.0, 0.4]], [[3.0, -1.0], [-1.0, 1.0]]])
SLOPE = np.array([[1.0, -2.0], [0.5, 3.0]])  # of u, by switch and fault


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def model():
    read = pgm.SwitchingCPD(
        Z, MODE, {s: pgm.GaussianCPD(Z, MEANS[k], COVS[k]) for k, s in enumerate(MODE.states)}
    )
    cases = {
        (s, f): pgm.LinearGaussianCPD(W, {U: SLOPE[i, j]}, cov=0.5 + j)
        for (i, s), (j, f) in product(enumerate(SWITCH.states), enumerate(FAULT.states))
    }
    cases["high", "yes"] = pgm.NonlinearGaussianCPD(W, U, lambda u: np.sin(u), cov=2.0)
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(MODE, table=FIRST)],
        transition=[
            pgm.TableCPD(MODE, MODE.previous, table=MOVES),
            pgm.TableCPD(FAULT, MODE, table=FAULTS),
        ],
        observation=[read, pgm.SwitchingCPD(W, (SWITCH, FAULT), cases)],
    )


def evidence(rng, runs=()):
    z = rng.normal(size=(*runs, 4, 2), scale=2.0)
    z[..., 1, :], z[..., 2, 0] = np.nan, np.nan
    w = rng.normal(size=(*runs, 4, 1))
    w[..., 3, :] = np.nan
    return {Z: z, W: w, U: rng.normal(size=(*runs, 4, 1)), SWITCH: [0, 1, 1, 0]}


def seen(given, t, mode, fault):
    """The log-density of the readings of a step."""
    z, w, u = given[Z][t - 1], given[W][t - 1, 0], given[U][t - 1, 0]
    some, total = ~np.isnan(z), 0.0
    if some.any():
        cov = COVS[mode][np.ix_(some, some)]
        total += multivariate_normal(MEANS[mode][some], cov).logpdf(z[some])
    if not np.isnan(w):
        i = given[SWITCH][t - 1]
        mean = np.sin(u) if (i, fault) == (1, 1) else SLOPE[i, fault] * u
        cov = 2.0 if (i, fault) == (1, 1) else 0.5 + fault
        total += norm(mean, np.sqrt(cov)).logpdf(w)
    return total


def enumerated(given, until=4):
    """All paths, (paths, 5) of modes and (paths, 4) of faults, and their log-probabilities."""
    modes = np.array(list(product(range(3), repeat=5)))
    with np.errstate(divide="ignore"):
        first, moves, faults = np.log(FIRST), np.log(MOVES), np.log(FAULTS)
    log_paths = first[modes[:, 0]] + sum(moves[modes[:, t - 1], modes[:, t]] for t in range(1, 5))
    every = np.array(list(product(range(2), repeat=4)))
    total = np.broadcast_to(log_paths[:, None], (len(modes), len(every))).copy()
    for t in range(1, 5):
        own = faults[:, :].copy()
        if t <= until:
            own += [[seen(given, t, m, f) for f in range(2)] for m in range(3)]
        total += own[modes[:, t]][:, every[:, t - 1]]
    return modes, every, total


def marginal(given, t, until=4):
    modes, faults, logs = enumerated(given, until)
    share = np.exp(logs - logsumexp(logs))
    mode = [share[modes[:, t] == m].sum() for m in range(3)]
    fault = [share[:, faults[:, t - 1] == f].sum() for f in range(2)]
    return mode, fault


def test_filter_and_smoother_are_sums_over_all_paths(rng):
    given = evidence(rng)
    smoothed, filtered = pgm.smooth(model(), given), pgm.filter(model(), given)
    assert_allclose(smoothed.log_evidence, logsumexp(enumerated(given)[2]), rtol=1e-12)
    for t in range(1, 5):
        for posterior, until in ((smoothed, 4), (filtered, t)):
            mode, fault = marginal(given, t, until)
            assert_allclose(posterior[MODE.at(t)].probabilities, mode, atol=1e-13)
            assert_allclose(posterior[FAULT.at(t)].probabilities, fault, atol=1e-13)


def test_runs_are_as_one_by_one(rng):
    given = evidence(rng, (2, 3))
    posterior = pgm.smooth(model(), given)
    for run in np.ndindex(2, 3):
        alone = {v: a if v is SWITCH else a[run] for v, a in given.items()}
        one = pgm.smooth(model(), alone)
        assert_allclose(posterior[MODE].probabilities[run], one[MODE].probabilities, atol=1e-14)
        assert_allclose(posterior.log_evidence[run], one.log_evidence, rtol=1e-13)


def test_the_most_probable_path_is_the_likeliest_of_all(rng):
    given = evidence(rng)
    path = pgm.most_probable(pgm.compile(model(), steps=4), given)
    modes, faults, logs = enumerated(given)
    best = np.unravel_index(logs.argmax(), logs.shape)
    assert list(path.states(MODE)) == [MODE.states[k] for k in modes[best[0]]]
    assert list(path.states(FAULT)) == [FAULT.states[k] for k in faults[best[1]]]
    assert_allclose(path.log_probability, logs.max(), rtol=1e-12)


def test_online_is_the_filter(rng):
    given = evidence(rng)
    online = pgm.OnlineFilter(model(), lag=2)
    belief, offline = online.initial(), pgm.filter(model(), given)
    for t in range(1, 5):
        belief = online.predict(belief)
        now = {v: a[t - 1] for v, a in given.items()}
        belief = online.update(belief, now)
        assert_allclose(belief[MODE].probabilities, offline[MODE.at(t)].probabilities, atol=1e-14)
    assert_allclose(belief.log_evidence, offline.log_evidence, rtol=1e-13)


def test_a_case_is_asked_where_it_is_chosen():
    """One without noise, or without a value, costs nothing where an observed switch excludes it."""
    h, z = pgm.Discrete("h", states=2), pgm.Variable("z")
    cases = {("low", k): pgm.NonlinearGaussianCPD(z, U, np.log, cov=1.0 + k) for k in range(2)}
    cases |= {("high", 0): pgm.GaussianCPD(z, 0, 1), ("high", 1): pgm.GaussianCPD(z, 1, 2)}
    chain = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(h, table=[0.5, 0.5])],
        [pgm.TableCPD(h, h.previous, table=np.eye(2))],
        [pgm.SwitchingCPD(z, (SWITCH, h), cases)],
    )
    given = {z: [[0.5], [0.3], [np.nan]], U: [[2.0], [-1.0], [-1.0]], SWITCH: [0, 1, 0]}
    logs = np.array([
        norm(np.log(2), 1).logpdf(0.5) + norm(0, 1).logpdf(0.3),
        norm(np.log(2), np.sqrt(2)).logpdf(0.5) + norm(1, np.sqrt(2)).logpdf(0.3),
    ]) + np.log(0.5)  # fmt: skip
    assert_allclose(pgm.filter(chain, given).log_evidence, logsumexp(logs), rtol=1e-13)
    with pytest.raises(pgm.LinearisationError, match="step 3"):
        pgm.filter(chain, given | {z: [[0.5], [0.3], [0.1]]})


def test_readings_far_from_all_states_and_several_a_step():
    h, z = pgm.Discrete("h", states=2), pgm.Variable("z")
    cases = {0: pgm.GaussianCPD(z, 0.0, 1.0), 1: pgm.GaussianCPD(z, 3.0, 2.0)}
    chain = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(h, table=[0.5, 0.5])],
        [pgm.TableCPD(h, h.previous, table=[[0.9, 0.1], [0.2, 0.8]])],
        [pgm.SwitchingCPD(z, h, cases)],
    )
    values, steps = [0.5, 400.0, 3.0, -2.0], [0, 2, 2, 3]
    posterior = pgm.smooth(
        chain, {z: pgm.sightings(np.array(values)[:, None], step=steps)}, steps=4
    )
    logs = np.full(2, np.log(0.5))
    for t in range(5):
        if t:
            logs = logsumexp(logs[:, None] + np.log([[0.9, 0.1], [0.2, 0.8]]), axis=0)
        for value in np.array(values)[np.array(steps) == t]:
            logs = logs + norm([0.0, 3.0], np.sqrt([1.0, 2.0])).logpdf(value)
    assert_allclose(posterior.log_evidence, logsumexp(logs), rtol=1e-13)
    assert_allclose(posterior[h.at(4)].probabilities, np.exp(logs - logsumexp(logs)), rtol=1e-9)
    assert posterior[h.at(2)].probabilities[1] == 1.0


@pytest.mark.parametrize("far", [1e3, 1e6, 1e9, 1e12])
def test_far_readings_leave_the_odds_that_they_say_nothing_of(far):
    a, b, z = pgm.Discrete("a", states=2), pgm.Discrete("b", states=2), pgm.Variable("z")
    moves = [[0.9, 0.1], [0.2, 0.8]]
    chain = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(a, table=[0.5, 0.5]), pgm.TableCPD(b, table=[0.1, 0.9])],
        [pgm.TableCPD(a, a.previous, table=moves), pgm.TableCPD(b, b.previous, table=np.eye(2))],
        [pgm.SwitchingCPD(z, a, {k: pgm.GaussianCPD(z, k, 1.0) for k in range(2)})],
    )
    for posterior in (pgm.filter(chain, {z: [[far]]}), pgm.smooth(chain, {z: [[far], [-far]]})):
        assert_allclose(posterior[b.at(1)].probabilities, [0.1, 0.9], rtol=1e-12)
    online = pgm.OnlineFilter(chain)
    belief = online.update(online.predict(online.initial()), {z: [far]})
    assert_allclose(belief[b].probabilities, [0.1, 0.9], rtol=1e-12)
    path = pgm.most_probable(pgm.compile(chain, steps=1), {z: [[far]]})
    assert list(path.states(b)) == ["1", "1"]
    posterior = pgm.smooth(chain, {z: [[np.nan], [-far]]})
    due = np.array([0.55 * 0.9, 0.45 * 0.2]) / (0.55 * 0.9 + 0.45 * 0.2)
    assert_allclose(posterior[a.at(1)].probabilities, due, rtol=1e-12)
    joint = posterior.joint(a.at(1), a.at(2)).probabilities
    assert_allclose(joint[:, 0], due, rtol=1e-12)
    several = pgm.sightings(np.array([[-far], [-2 * far]]), step=[2, 2])
    posterior = pgm.smooth(chain, {z: several}, steps=2)
    assert_allclose(posterior[a.at(1)].probabilities, due, rtol=1e-12)


def test_draws_are_of_the_cases():
    drawn = model().sample({U: np.zeros((3, 1)), SWITCH: [0, 0, 1]}, runs=20_000, steps=3, rng=1)
    modes = drawn[MODE][:, 1:].reshape(-1)
    values = drawn[Z].reshape(-1, 2)
    for k in range(3):
        own = values[modes == k]
        assert_allclose(own.mean(axis=0), MEANS[k], atol=0.06)
        assert_allclose(np.cov(own.T), COVS[k], atol=0.12)


def test_densities_that_take_too_much_memory_are_refused(monkeypatch):
    h, z = pgm.Discrete("h", states=2), pgm.Variable("z")
    chain = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(h, table=[0.5, 0.5])],
        [pgm.TableCPD(h, h.previous, table=np.eye(2))],
        [pgm.SwitchingCPD(z, h, {k: pgm.GaussianCPD(z, k, 1) for k in range(2)})],
    )
    many = pgm.sightings(np.zeros((50_000, 1)), step=np.ones(50_000, dtype=int))
    assert np.isfinite(pgm.filter(chain, {z: many}, steps=1).log_evidence)
    monkeypatch.setattr("pgm.resources.most_memory", lambda: 2**20)
    with pytest.raises(pgm.GraphError, match="densities of 50000 readings of z in 1 runs"):
        pgm.filter(chain, {z: many}, steps=1)


def test_refusals():
    h, z = pgm.Discrete("h", states=2), pgm.Variable("z")
    prior = [pgm.TableCPD(h, table=[0.5, 0.5])]
    moves = [pgm.TableCPD(h, h.previous, table=np.eye(2))]
    exact = pgm.SwitchingCPD(z, h, {0: pgm.GaussianCPD(z, 0, 0), 1: pgm.GaussianCPD(z, 0, 1)})
    chain = pgm.DynamicBayesianNetwork(prior, moves, [exact])
    with pytest.raises(pgm.ModelError, match="case '0' has no noise in some direction"):
        pgm.filter(chain, {z: [[0.0]]})
    atom = pgm.MixtureCPD([pgm.GaussianCPD(z, 0, 0), pgm.GaussianCPD(z, 0, 1)], weights=[0.5, 0.5])
    spiked = pgm.SwitchingCPD(z, h, {0: atom, 1: pgm.GaussianCPD(z, 0, 1)})
    chain = pgm.DynamicBayesianNetwork(prior, moves, [spiked])
    with pytest.raises(pgm.ModelError, match="case '0' has no noise in some direction"):
        pgm.filter(chain, {z: [[0.0]]})
    made = pgm.LinearGaussianCPD(z, {}, cov=pgm.noise(lambda u: u[..., None], given=U))
    vague = pgm.SwitchingCPD(z, h, {0: made, 1: pgm.GaussianCPD(z, 0, 1)})
    chain = pgm.DynamicBayesianNetwork(prior, moves, [vague])
    with pytest.raises(pgm.ModelError, match="case '0' has no noise in some direction"):
        pgm.filter(chain, {z: [[0.0]], U: [[0.0]]})
    absent = pgm.filter(chain, {z: [[0.0], [np.nan]], U: [[1.0], [0.0]]})  # nothing is read there
    assert np.isfinite(absent.log_evidence)
    with pytest.raises(pgm.ModelError, match="stands beside"):
        pgm.DynamicBayesianNetwork(prior, moves, [pgm.GaussianCPD(z, 0, 1)])
    fine = pgm.SwitchingCPD(z, h, {k: pgm.GaussianCPD(z, k, 1) for k in range(2)})
    chain = pgm.DynamicBayesianNetwork(prior, moves, [fine])
    with pytest.raises(pgm.EvidenceError, match="too far from what every state"):
        pgm.filter(chain, {z: [[1e200]]})
