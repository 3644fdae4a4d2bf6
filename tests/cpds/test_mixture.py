"""Mixtures of CPDs by themselves, and particles of networks that have them."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import pgm

x, z, u, v = pgm.variables("x z u v")
pose = pgm.Variable("pose", components=("a", "turn"), angles=("turn",))
Linear = pgm.LinearGaussianCPD


def drawn(size, rng):
    return rng.uniform(-10.0, 10.0, size=(*size, 1))


def log_flat(y):
    return np.where(np.abs(y[..., 0]) < 10.0, -np.log(20.0), -np.inf)


ANYWHERE = pgm.SampledCPD(z, sample=drawn, log_density=log_flat)
READ = pgm.MixtureCPD([Linear(z, {x: 1.0}, cov=0.25), ANYWHERE], [0.8, 0.2])


def model(**other):
    start = pgm.MixtureCPD(
        [pgm.GaussianCPD(x, -1.0, 0.1), pgm.GaussianCPD(x, 1.0, 0.1)], [0.3, 0.7]
    )
    # With noise that an input sets, and parents that differ.
    hop = pgm.noise(lambda u: u[..., None] ** 2, given=u)
    move = pgm.MixtureCPD(
        [Linear(x, {x.previous: 1.0}, offset=0.2, cov=hop), Linear(x, {v: 1.0}, cov=0.3)],
        [0.9, 0.1],
    )
    parts = {"prior": [start], "transition": [move], "observation": [READ]} | other
    return pgm.DynamicBayesianNetwork(**parts)


GIVEN = {
    u: np.array([[0.3], [0.4], [0.5], [0.3]]),
    v: np.array([[0.0], [2.0], [2.0], [1.0]]),
    z: np.array([[1.4], [1.9], [-9.0], [2.2]]),
}


def quadrature():
    """Filtered means and log-evidence by sums over a fine line."""
    line = np.linspace(-9.0, 9.0, 1801)
    width = line[1] - line[0]
    belief = (0.3 * norm.pdf(line, -1.0, 0.1**0.5) + 0.7 * norm.pdf(line, 1.0, 0.1**0.5)) * width
    means, log_evidence = [belief @ line], 0.0
    for hop, to, read in zip(*(GIVEN[each][:, 0] for each in (u, v, z)), strict=True):
        move = 0.9 * norm.pdf(line[:, None], line + 0.2, hop)
        move += 0.1 * norm.pdf(line[:, None], to, 0.3**0.5)
        belief = (move @ belief) * width * (0.8 * norm.pdf(read, line, 0.5) + 0.2 / 20.0)
        log_evidence += np.log(belief.sum())
        belief = belief / belief.sum()
        means.append(belief @ line)
    return np.array(means), log_evidence


def test_density_is_the_weighted_sum():
    move = model().transition[0]
    assert move.parents == (x.previous, v, u)
    assert move.noise_given == (u,)
    rng = np.random.default_rng(0)
    child, before, to = rng.normal(size=(3, 4, 5, 1))
    hop = np.array([[0.3]] * 5)
    found = move.log_density(child, {x.previous: before, v: to, u: hop})
    terms = [norm.logpdf(child, before + 0.2, hop), norm.logpdf(child, to, 0.3**0.5)]
    due = logsumexp(np.concatenate(terms, axis=-1), b=[0.9, 0.1], axis=-1)
    assert_allclose(found, due, rtol=1e-12)


def test_far_off_it_is_stable_and_impossible_is_minus_infinity():
    near, far = Linear(z, {x: 1.0}, cov=1.0), Linear(z, {x: 1.0}, offset=1.0, cov=1.0)
    found = pgm.MixtureCPD([near, far], [0.5, 0.5]).log_density(1e4, {x: 0.0})
    assert_allclose(found, logsumexp(norm.logpdf(1e4, [0.0, 1.0]), b=[0.5, 0.5]), rtol=1e-12)
    fixed = pgm.MixtureCPD([Linear(z, {x: 1.0}, cov=0.0), ANYWHERE], [0.5, 0.5])
    assert fixed.log_density(20.0, {x: 0.0}) == -np.inf
    assert_allclose(fixed.log_density(2.0, {x: 0.0}), np.log(0.5 / 20.0))


def test_draws_come_from_the_chosen_ones_alone():
    asked = []

    def counted(y, size, rng):
        asked.append(size)
        return y + rng.laplace(size=(*size, 1))

    cpd = pgm.MixtureCPD(
        [pgm.SampledCPD(z, x, sample=counted), Linear(z, {v: 1.0}, cov=0.0)], [0.3, 0.7]
    )
    found = cpd.sample({x: [[0.0], [50.0]], v: -40.0}, size=20_000, rng=1)
    assert found.shape == (20_000, 2, 1)
    exact = found[..., 0] == -40.0
    assert np.abs(exact.mean(axis=0) - 0.7).max() < 0.02
    assert asked == [(int((~exact).sum()),)]
    for k, centre in enumerate((0.0, 50.0)):
        assert abs(found[:, k, 0][~exact[:, k]].mean() - centre) < 0.1


def test_a_mixture_of_mixtures_and_copies_of_steps():
    nested = pgm.MixtureCPD([READ, ANYWHERE], [0.5, 0.5])
    flat = pgm.MixtureCPD([Linear(z, {x: 1.0}, cov=0.25), ANYWHERE], [0.4, 0.6])
    values = np.linspace(-12.0, 12.0, 7)[:, None]
    due = flat.log_density(values, {x: 1.0})
    assert_allclose(nested.log_density(values, {x: 1.0}), due)
    placed = model().transition[0].at(3)
    assert placed.parents == (x.at(2), v.at(3), u.at(3))
    assert placed.origin.child == x
    copied = pickle.loads(pickle.dumps(flat))
    assert_allclose(copied.log_density(values, {x: 1.0}), due)
    with pytest.raises(AttributeError, match="immutable"):
        flat.weights = np.ones(2)
    draws = nested.sample({x: 0.0}, size=5000, rng=3)
    assert abs((np.abs(draws) > 2.0).mean() - 0.6 * 0.8) < 0.03


def test_an_angle_is_wrapped():
    part = Linear(pose, {x: [[1.0], [1.0]]}, cov=np.diag([0.3, 0.2]))
    cpd = pgm.MixtureCPD([part, part], [0.5, 0.5])
    around = cpd.log_density([0.0, 3.1 - 2.0 * np.pi], {x: 3.0})
    assert_allclose(around, norm.logpdf(3.0, 0, 0.3**0.5) + norm.logpdf(0.1, 0, 0.2**0.5))


@pytest.mark.parametrize(
    ("components", "weights", "message"),
    [
        ([], [], "one CPD or more"),
        ([3.0], [1.0], "continuous variables; found 3.0"),
        ([Linear(z, {x: 1.0}, cov=1.0), Linear(v, {x: 1.0}, cov=1.0)], [0.5, 0.5], "one child"),
        ([ANYWHERE, ANYWHERE], [1.0], r"2 weights; found an array of shape \(1,\)"),
        ([ANYWHERE, ANYWHERE], [0.5, 0.4], r"found \[0.5, 0.4\], of sum 0.9"),
        ([ANYWHERE, ANYWHERE], [1.0, 0.0], r"found \[1.0, 0.0\]"),
        ([ANYWHERE, ANYWHERE], [1.5, -0.5], r"found \[1.5, -0.5\]"),
        ([ANYWHERE, ANYWHERE], [np.nan, 0.5], "weights of a mixture"),
        ([pgm.GaussianCPD(x, 0.0, np.inf)], [1.0], "infinite variance"),
        (
            [pgm.GaussianCPD(x, np.zeros((2, 1)), 1.0), pgm.GaussianCPD(x, np.zeros((3, 1)), 1.0)],
            [0.5, 0.5],
            "axes of runs that do not broadcast",
        ),
    ],
)
def test_what_is_no_mixture(components, weights, message):
    with pytest.raises(pgm.ModelError, match=message):
        pgm.MixtureCPD(components, weights)


def test_tables_cannot_be_mixed():
    rain = pgm.Discrete("rain", ("no", "yes"))
    with pytest.raises(pgm.ModelError, match="continuous"):
        pgm.MixtureCPD([pgm.TableCPD(rain, table=[0.5, 0.5])], [1.0])


def test_particles_agree_with_quadrature():
    means, log_evidence = quadrature()
    found = pgm.smooth(model(), GIVEN, belief=pgm.Particles(40_000, seed=2))
    assert np.abs(found.filtered[x].mean[:, 0] - means).max() < 0.04
    assert abs(found.log_evidence - log_evidence) < 0.04
    on = pgm.smooth(model(), GIVEN, belief=pgm.Grid({"x": (-9.0, 9.0, 360)}))
    assert_allclose(on.filtered[x].mean[:, 0], means, atol=1e-6)
    assert_allclose(on.log_evidence, log_evidence, atol=1e-6)
    assert np.abs(found[x].mean - on[x].mean).max() < 0.04
    small = pgm.Particles(1500, seed=2, smoothing="full", dtype=np.float32)
    assert np.abs(pgm.smooth(model(), GIVEN, belief=small)[x].mean - on[x].mean).max() < 0.15
    robot = pgm.OnlineFilter(model(), belief=pgm.Particles(40_000, seed=3))
    belief = robot.initial()
    for k in range(4):
        belief = robot.predict(belief, {u: GIVEN[u][k], v: GIVEN[v][k]})
        belief = robot.update(belief, {z: GIVEN[z][k]})
    assert abs(belief[x].mean[0] - means[-1]) < 0.04
    assert abs(belief.log_evidence - log_evidence) < 0.04


def test_a_batch_is_its_runs_and_cpds_may_differ_by_run():
    wide = GIVEN | {z: np.stack([GIVEN[z], GIVEN[z] + 0.5]), u: np.stack([GIVEN[u], GIVEN[u] / 2])}
    cloud = pgm.Particles(20_000, seed=1)  # more than a block
    batch = pgm.filter(model(), wide, belief=cloud)
    single = pgm.filter(model(), GIVEN, belief=cloud)
    assert_array_equal(batch[x][0].states, single[x].states)
    apart = pgm.MixtureCPD(
        [pgm.GaussianCPD(x, [[-1.0], [-3.0]], 0.1), pgm.GaussianCPD(x, 1.0, 0.1)], [0.3, 0.7]
    )
    runs = model(prior=[apart])
    assert runs.lead == (2,)
    batch = pgm.filter(runs, GIVEN, belief=cloud)
    assert_array_equal(batch[x][0].states, single[x].states)
    start = runs.sample({u: GIVEN[u], v: GIVEN[v]}, runs=(4000, 2), rng=1)[x][:, :, 0, 0]
    assert np.abs(start.mean(axis=0) - [0.4, -0.2]).max() < 0.1


def test_part_of_a_measurement_may_be_missing_where_all_are_gaussian():
    cov = np.array([[0.3, 0.1], [0.1, 0.2]])
    one, two = (Linear(pose, {x: [[1.0], [k]]}, cov=cov * k) for k in (1.0, 4.0))
    both = pgm.MixtureCPD([one, two], [0.6, 0.4])
    read = np.array([[0.2, np.nan], [np.nan, 0.4], [0.1, 0.3], [np.nan, np.nan]])
    still = model(
        prior=[pgm.GaussianCPD(x, 0.5, 0.0)],
        transition=[Linear(x, {x.previous: 1.0}, cov=0.0)],
        observation=[both],
    )
    found = pgm.filter(still, {pose: read}, belief=pgm.Particles(10)).log_evidence
    means = np.array([[0.5, 0.5], [0.5, 2.0]])
    due = logsumexp(norm.logpdf(0.2, means[:, 0], np.sqrt([0.3, 1.2])), b=[0.6, 0.4])
    due += logsumexp(norm.logpdf(0.4, means[:, 1], np.sqrt([0.2, 0.8])), b=[0.6, 0.4])
    whole = [
        multivariate_normal.logpdf(read[2], m, cov * k) for m, k in zip(means, (1, 4), strict=True)
    ]
    assert_allclose(found, due + logsumexp(whole, b=[0.6, 0.4]), rtol=1e-9)
    assert both.partial
    assert not READ.partial
    mixed = pgm.MixtureCPD(
        [one, pgm.SampledCPD(pose, x, log_density=lambda c, y: 0 * c[..., 0])], [0.5, 0.5]
    )
    with pytest.raises(pgm.EvidenceError, match="cannot leave out"):
        pgm.filter(still.replace(observation=[mixed]), {pose: read}, belief=pgm.Particles(10))


def test_a_sensor_without_noise_is_refused():
    for sure in (
        Linear(z, {x: 1.0}, cov=0.0),
        Linear(z, {x: 1.0}, cov=pgm.noise(lambda u: 0.0 * u[..., None], given=u)),
    ):
        exact = model(observation=[pgm.MixtureCPD([sure, ANYWHERE], [0.5, 0.5])])
        with pytest.raises(pgm.ModelError, match="has no noise in a component"):
            pgm.filter(exact, GIVEN, belief=pgm.Particles(50))
        with pytest.raises(pgm.ModelError, match="has no noise in a component"):
            pgm.filter(exact, GIVEN, belief=pgm.Grid({"x": (-9.0, 9.0, 90)}))


def test_a_network_without_time_is_a_mixture_of_all_configurations():
    """Unrolled, it has the exact beliefs that a smoother with room for all has."""
    seldom = pgm.MixtureCPD(
        [Linear(z, {x: 1.0}, cov=0.1), pgm.GaussianCPD(z, 0.0, 9.0)], [0.9, 0.1]
    )
    network = model(observation=[seldom])
    steps = 3
    own = {variable: values[:steps] for variable, values in GIVEN.items()}
    due = pgm.smooth(network, own, belief=pgm.Gaussians(128))
    given = {v.at(t + 1): row for v, values in own.items() for t, row in enumerate(values)}
    found = pgm.infer(pgm.compile(network.unroll(steps)), given)
    assert found.log_evidence == pytest.approx(due.log_evidence, abs=1e-9)
    for step in range(steps + 1):
        assert_allclose(found[x.at(step)].mean, due[x.at(step)].mean, atol=1e-9)
        assert_allclose(found[x.at(step)].cov, due[x.at(step)].cov, atol=1e-9)


def test_a_static_network_is_drawn():
    net = pgm.BayesianNetwork([pgm.GaussianCPD(x, 3.0, 0.01), READ])
    draws = net.sample(4000, rng=0)
    near = np.abs(draws[z] - draws[x])[:, 0] < 2.0
    assert abs(near.mean() - (0.8 + 0.2 * 0.2)) < 0.03
