"""Draws of all variables together: their moments, joints and shares are those of the posterior."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm

N = 40_000


def tables(seed=0):
    """A tree of five discrete variables with zeros, of which one has a single state."""
    rng = np.random.default_rng(seed)
    v = [pgm.Discrete(f"v{k}", n) for k, n in enumerate((2, 3, 1, 4, 2))]
    factors = [
        pgm.Table((v[0], v[1]), rng.random((2, 3))),
        pgm.Table((v[1], v[2], v[3]), rng.random((3, 1, 4)) * (rng.random((3, 1, 4)) > 0.3)),
        pgm.Table((v[3], v[4]), rng.random((4, 2))),
        pgm.Table((v[0], v[4]), rng.random((2, 2))),
    ]
    return pgm.MarkovNetwork(factors), v


def shares(drawn, scope):
    """The shares of the joint states of some variables among draws, (sizes...)."""
    found = np.zeros([v.size for v in scope])
    np.add.at(found, tuple(drawn[v] for v in scope), 1.0)
    return found / found.sum()


def test_tables_of_a_tree():
    network, v = tables()
    posterior = pgm.infer(pgm.compile(network), {v[4]: 1})
    drawn = posterior.sample(N, rng=0)
    assert list(drawn) == list(posterior._hidden)
    assert all(own.shape == (N,) for own in drawn.values())
    due = posterior.joint(v[0], v[1], v[3]).probabilities
    found = shares(drawn, (v[0], v[1], v[3]))
    assert_allclose(found, due, atol=0.012)
    assert (found[due == 0.0] == 0.0).all()


def test_runs_of_tables_have_draws_of_their_own():
    """Runs of equal evidence share a table, and not the draws."""
    network, v = tables()
    states = np.array([[0, 1, -1], [1, 0, 1]])
    posterior = pgm.infer(pgm.compile(network), {v[4]: states})
    drawn = posterior.sample((100, 60), rng=1)
    assert drawn[v[3]].shape == (100, 60, 2, 3)
    for run in np.ndindex(2, 3):
        due = posterior[v[3]].probabilities[run]
        found = np.bincount(drawn[v[3]][(..., *run)].ravel(), minlength=4) / 6000
        assert_allclose(found, due, atol=0.03)
    same = [run for run in np.ndindex(2, 3) if states[run] == 1]
    for one, other in itertools.combinations(same, 2):
        assert (drawn[v[3]][(..., *one)] != drawn[v[3]][(..., *other)]).any()
    seen = drawn[v[4]]  # hidden in one run alone
    assert (seen[..., 0, 0] == 0).all()
    assert 0 < seen[..., 0, 2].mean() < 1


def test_a_thousand_runs_and_logarithms():
    """A chain so long that numbers underflow, and few runs kept at a time."""
    v = [pgm.Discrete(f"v{k}", 2) for k in range(400)]
    pairs = [pgm.Table((v[k], v[k + 1]), [[1e-9, 3e-9], [1e-9, 1e-9]]) for k in range(399)]
    graph = pgm.compile(pgm.MarkovNetwork(pairs))
    rng = np.random.default_rng(3)
    states = rng.integers(0, 2, 500)
    posterior = pgm.infer(graph, {v[0]: states}, memory=2**22)
    drawn = posterior.sample(40, rng=2)
    found = drawn[v[1]][:, states == 0].mean()
    assert_allclose(found, posterior[v[1]].values[states == 0, 1].mean(), atol=0.02)
    assert drawn[v[399]].shape == (40, 500)


def moments(drawn, scope):
    """The mean and covariance of scalars or vectors side by side, of draws (N, d) each."""
    values = np.concatenate([drawn[v] for v in scope], axis=-1)
    return values.mean(axis=0), np.cov(values.T)


def test_gaussian_trees():
    a, b, c, d, e = pgm.variables("a b c d e")
    p = pgm.Variable("p", components=("x", "y"))
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 1.0, 2.0),
            pgm.LinearGaussianCPD(p, {a: [[1.0], [-1.0]]}, cov=[[0.5, 0.2], [0.2, 0.3]]),
            pgm.LinearGaussianCPD(b, {p: [[1.0, 2.0]]}, cov=0.0),
            pgm.LinearGaussianCPD(c, {b: 0.5, a: 1.0}, cov=0.4),
            pgm.LinearGaussianCPD(d, {c: 2.0}, cov=0.1),
            pgm.GaussianCPD(e, 0.0, 1.0),
        ]
    )
    posterior = pgm.infer(pgm.compile(network), {d: [1.5]})
    drawn = posterior.sample(N, rng=0)
    scope = (a, p, b, c, e)
    due = posterior.joint(*scope)
    mean, cov = moments(drawn, scope)
    assert_allclose(mean, due.mean, atol=0.04)
    assert_allclose(cov, due.cov, atol=0.06)
    assert_allclose(drawn[b][:, 0], drawn[p] @ [1.0, 2.0], atol=1e-9)
    runs = pgm.infer(pgm.compile(network), {d: [[1.5], [-2.0]]}).sample((3, 4), rng=0)
    assert runs[p].shape == (3, 4, 2, 2)


X = pgm.Variable("x", components=("position", "speed"))
Z, K, U = pgm.variables("z k u")
CHAIN = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(X, [0.0, 1.0], [1.0, 0.5])],
    [
        pgm.LinearGaussianCPD(K, {U: 1.0}, cov=0.3),
        pgm.LinearGaussianCPD(
            X,
            {X.previous: [[1.0, 1.0], [0.0, 1.0]], K: [[0.0], [1.0]]},
            cov=[[0.1, 0.0], [0.0, 0.0]],
        ),
    ],
    [pgm.LinearGaussianCPD(Z, {X: [[1.0, 0.0]]}, cov=0.5)],
)
GIVEN = {U: [[0.5], [-0.5], [0.2]], Z: [[1.0], [np.nan], [2.5]]}


@pytest.mark.parametrize("options", [{}, {"method": pgm.Balanced()}, {"compiled": True}], ids=str)
def test_trajectories_of_a_chain(options):
    """All steps and the hidden control together, singular noise included."""
    graph = pgm.compile(CHAIN, 3, **options)
    posterior = pgm.infer(graph, GIVEN, schedule=pgm.Smoothing())
    drawn = posterior.sample(N, rng=0)
    assert drawn[X].shape == (N, 4, 2)
    assert drawn[K].shape == (N, 3, 1)
    scope = [X.at(0), X.at(1), K.at(1), X.at(2), K.at(2), X.at(3), K.at(3)]
    due = posterior.joint(*scope)
    flat = {v: drawn[v.template][:, v.step - (v.template == K)] for v in scope}
    mean, cov = moments(flat, scope)
    assert_allclose(mean, due.mean, atol=0.03)
    assert_allclose(cov, due.cov, atol=0.04)


def test_runs_of_trajectories_and_twice_the_digits():
    rng = np.random.default_rng(0)
    many = {U: np.array(GIVEN[U]), Z: rng.normal(size=(2, 3, 3, 1))}
    posterior = pgm.smooth(CHAIN, many)
    drawn = posterior.sample(4000, rng=0)
    assert drawn[X].shape == (4000, 2, 3, 4, 2)
    assert_allclose(drawn[X].mean(axis=0), posterior[X].mean, atol=0.08)
    wide = CHAIN.replace(prior=[pgm.GaussianCPD(X, [0.0, 1.0], [1e18, 0.5])])
    posterior = pgm.smooth(wide, GIVEN)
    assert posterior.status.digits is not None
    drawn = posterior.sample(N, rng=0)
    assert_allclose(drawn[X].mean(axis=0), posterior[X].mean, atol=0.05)
    assert_allclose(drawn[X].std(axis=0), posterior[X].std, atol=0.05)


def test_iterated_smoothers_are_drawn_at_their_last_linearisation():
    bent = pgm.NonlinearGaussianCPD(Z, X, lambda x: x[..., :1] + 0.3 * np.sin(x[..., :1]), cov=0.1)
    posterior = pgm.smooth(CHAIN.replace(observation=[bent]), GIVEN, iterations=100, damping=0.3)
    drawn = posterior.sample(N, rng=0)
    assert_allclose(drawn[X].mean(axis=0), posterior[X].mean, atol=0.03)
    assert_allclose(drawn[X].std(axis=0), posterior[X].std, atol=0.03)


def test_paths_of_tables():
    """States, a control that is hidden, and an impossible transition."""
    rain, pump = (pgm.Discrete(name, states=("no", "yes")) for name in ("rain", "pump"))
    wet, ask = pgm.Discrete("wet", 3), pgm.Discrete("ask", 2)
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(rain, table=[0.6, 0.4])],
        [
            pgm.TableCPD(pump, given=ask, table=[[0.9, 0.1], [0.3, 0.7]]),
            pgm.TableCPD(
                rain,
                given=(rain.previous, pump),
                table=[[[0.8, 0.2], [1.0, 0.0]], [[0.3, 0.7], [0.5, 0.5]]],
            ),
        ],
        [pgm.TableCPD(wet, given=rain, table=[[0.7, 0.2, 0.1], [0.1, 0.3, 0.6]])],
    )
    given = {ask: [0, 1, 1, 0], wet: [1, 2, -1, 0]}
    posterior = pgm.smooth(model, given)
    drawn = posterior.sample(N, rng=0)
    assert drawn[rain].shape == (N, 5)
    assert drawn[pump].shape == (N, 4)
    scope = [rain.at(1), pump.at(2), rain.at(2), rain.at(4), pump.at(4)]
    due = posterior.joint(*scope).probabilities
    flat = {v: drawn[v.template][:, v.step - (v.template == pump)] for v in scope}
    found = shares(flat, scope)
    assert_allclose(found, due, atol=0.012)
    assert (found[due == 0.0] == 0.0).all()
    runs = {ask: np.array(given[ask]), wet: np.array([given[wet], [0, 0, 0, 0]])}
    drawn = pgm.smooth(model, runs).sample((5, 2), rng=1)
    assert drawn[rain].shape == (5, 2, 2, 5)


def test_trajectories_of_particles():
    posterior = pgm.smooth(
        pgm.DynamicBayesianNetwork(
            CHAIN.prior,
            [pgm.LinearGaussianCPD(X, {X.previous: [[1.0, 1.0], [0.0, 1.0]]}, cov=0.1)],
            CHAIN.observation,
        ),
        {Z: GIVEN[Z]},
        belief=pgm.Particles(2000, seed=0),
    )
    drawn = posterior.sample(4000, rng=0)
    assert drawn[X].shape == (4000, 4, 2)
    assert_allclose(drawn[X].mean(axis=0), posterior[X].mean, atol=0.06)


def test_mixed_networks():
    """Discrete variables, and the continuous ones that they choose, together."""
    x, y, z = pgm.variables("x y z")
    m, k = pgm.Discrete("m", 2), pgm.Discrete("k", 3)
    network = pgm.BayesianNetwork(
        [
            pgm.TableCPD(m, table=[0.4, 0.6]),
            pgm.TableCPD(k, given=m, table=[[0.2, 0.5, 0.3], [0.6, 0.0, 0.4]]),
            pgm.GaussianCPD(x, 0.0, 1.0),
            pgm.SwitchingCPD(
                y, k, {s: pgm.LinearGaussianCPD(y, {x: 1.0 + s}, cov=0.1 + s) for s in range(3)}
            ),
            pgm.SwitchingCPD(
                z, m, {s: pgm.LinearGaussianCPD(z, {y: 1.0}, 0.5, offset=3.0 * s) for s in range(2)}
            ),
        ]
    )
    posterior = pgm.infer(pgm.compile(network), {z: [2.0]})
    drawn = posterior.sample(N, rng=0)
    assert set(drawn) == {x, y, m, k}
    due = posterior.joint(m, k).probabilities
    assert_allclose(shares(drawn, (m, k)), due, atol=0.012)
    mean, cov = moments(drawn, (x, y))
    assert_allclose(mean, posterior.joint(x, y).mean, atol=0.03)
    assert_allclose(cov, posterior.joint(x, y).cov, atol=0.06)
    # Given the discrete variables the continuous ones are those of their configuration.
    for states in ((0, 1), (1, 2)):
        own = (drawn[m] == states[0]) & (drawn[k] == states[1])
        alone = pgm.infer(pgm.compile(network), {z: [2.0], m: states[0], k: states[1]})
        assert_allclose(drawn[y][own].mean(), float(alone[y].mean[0]), atol=0.06)
        assert_allclose(drawn[y][own].std(), float(alone[y].std[0]), atol=0.06)
    runs = pgm.infer(pgm.compile(network), {z: [[2.0], [-1.0], [5.0]]})
    drawn = runs.sample(8000, rng=0)
    assert drawn[y].shape == (8000, 3, 1)
    assert_allclose(drawn[y].mean(axis=0), runs[y].mean, atol=0.07)


def test_several_modes():
    x, z = pgm.variables("x z")
    square = pgm.NonlinearGaussianCPD(z, x, lambda x: x**2, cov=0.05)
    network = pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.3, 1.0), square])
    posterior = pgm.infer(
        pgm.compile(network),
        {z: [1.0]},
        belief=pgm.Gaussians(2, starts=16),
        schedule=pgm.Calibration(50),
    )
    drawn = posterior.sample(N, rng=0)[x]
    assert_allclose(drawn.mean(), float(posterior[x].mean[0]), atol=0.02)
    assert_allclose(drawn.std(), float(posterior[x].std[0]), atol=0.02)


def test_what_has_no_draws():
    with pytest.raises(pgm.EvidenceError, match=r"this posterior is filtered: take pgm\.smooth"):
        pgm.filter(CHAIN, GIVEN).sample(2, rng=0)
    with pytest.raises(pgm.EvidenceError, match="fixed-lag"):
        pgm.smooth(CHAIN, GIVEN, lag=1).sample(2, rng=0)
    network, v = tables()
    loopy = pgm.compile(network, method=pgm.Bethe())
    with pytest.raises(pgm.GraphError, match="compile a junction tree"):
        pgm.infer(loopy, {}, schedule=pgm.Flooding()).sample(2, rng=0)
    posterior = pgm.infer(pgm.compile(network), {})
    for bad in ({"size": -1, "rng": 0}, {"size": 2, "rng": None}, {"size": 10**15, "rng": 0}):
        with pytest.raises(pgm.ModelError):
            posterior.sample(**bad)
    even = pgm.MarkovNetwork([pgm.Table(v[0], [1.0, 0.0])])
    lost = pgm.infer(pgm.compile(even), {v[0]: [0, 1]}, impossible="allow")
    with pytest.raises(pgm.EvidenceError, match="of which there are no draws"):
        lost.sample(2, rng=0)
    one = posterior.sample(rng=0)
    assert one[v[0]].shape == ()
    assert_array_equal(one[v[2]], 0)


@pytest.mark.parametrize("spread", [1.0, 1e4, 1e6])
def test_components_nearly_determined_by_others(spread):
    """A difference of a millimetre between two places known to a thousand kilometres."""
    a, b, c, total = pgm.variables("a b c total")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, spread**2),
            pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1e-6),
            pgm.LinearGaussianCPD(c, {b: 1.0}, cov=1e-6),
            pgm.LinearGaussianCPD(total, {a: 1.0, c: 1.0}, cov=0.0),
        ]
    )
    drawn = pgm.infer(pgm.compile(net), {}).sample(40_000, rng=0)
    assert np.std(drawn[b] - drawn[a]) == pytest.approx(1e-3, rel=0.02)
    assert np.std(drawn[c] - drawn[b]) == pytest.approx(1e-3, rel=0.02)
    assert np.std(drawn[c]) == pytest.approx(spread, rel=0.02)
    assert_allclose(drawn[total], drawn[a] + drawn[c], atol=1e-9 * spread)
