"""CPDs by sampler and density, and particles of networks that have them."""

import numpy as np
import pytest
from scipy.stats import laplace, t

import pgm

x, z = pgm.variables("x z")
RUN = {"scale": 0.4}


def jump(y, size, rng):
    return y + rng.laplace(scale=0.4, size=(*size, 1))


def log_jump(child, y):
    return laplace.logpdf((child - y)[..., 0], **RUN)


def log_read(child, y):
    return t.logpdf((child - y)[..., 0], df=3, scale=0.5)


def model(**other):
    start = pgm.SampledCPD(
        x,
        sample=lambda size, rng: rng.uniform(-2.0, 2.0, size=(*size, 1)),
        log_density=lambda y: np.where(np.abs(y[..., 0]) < 2.0, -np.log(4.0), -np.inf),
    )
    move = pgm.SampledCPD(x, x.previous, sample=jump, log_density=log_jump)
    read = pgm.SampledCPD(z, x, log_density=log_read)
    parts = {"prior": [start], "transition": [move], "observation": [read]} | other
    return pgm.DynamicBayesianNetwork(**parts)


READ = {z: np.array([[1.4], [1.9], [-0.5], [2.2]])}


def quadrature():
    """Filtered means, smoothed means and log-evidence by sums over a fine line."""
    line = np.linspace(-9.0, 9.0, 1801)
    width = line[1] - line[0]
    move = np.exp(log_jump(line[:, None, None], line[None, :, None])) * width
    move /= move.sum(axis=0)
    belief = (np.abs(line) < 2.0) / (np.abs(line) < 2.0).sum()
    beliefs, log_evidence = [belief], 0.0
    weights = [np.exp(log_read(value[None], line[:, None])) for value in READ[z]]
    for weight in weights:
        belief = (move @ belief) * weight
        log_evidence += np.log(belief.sum())
        belief = belief / belief.sum()
        beliefs.append(belief)
    after, smoothed = np.ones_like(line), [beliefs[-1]]
    for weight, belief in zip(weights[::-1], beliefs[-2::-1], strict=True):
        after = move.T @ (weight * after)
        both = belief * after
        smoothed.append(both / both.sum())
    filtered = np.array([b @ line for b in beliefs])
    return filtered, np.array([b @ line for b in smoothed[::-1]]), log_evidence


@pytest.mark.parametrize("smoothing", ["metropolis", "full"])
def test_particles_of_any_density_agree_with_quadrature(smoothing):
    count = 40_000 if smoothing == "metropolis" else 1500
    cloud = pgm.Particles(count, seed=2, smoothing=smoothing)
    found = pgm.smooth(model(), READ, belief=cloud)
    filtered, smoothed, log_evidence = quadrature()
    error = 8.0 / np.sqrt(count)
    assert np.abs(found.filtered[x].mean[:, 0] - filtered).max() < error
    assert np.abs(found[x].mean[:, 0] - smoothed).max() < error
    assert abs(found.log_evidence - log_evidence) < error


def test_a_batch_has_the_densities_of_its_runs():
    runs = np.stack([READ[z], READ[z] + 0.5])
    cloud = pgm.Particles(300, seed=1)
    batch = pgm.filter(model(), {z: runs}, belief=cloud)
    single = pgm.filter(model(), READ, belief=cloud)
    np.testing.assert_array_equal(batch[x][0].states, single[x].states)


def test_density_and_draws_by_themselves():
    cpd = model().transition[0]
    values, before = np.linspace(-1.0, 1.0, 6).reshape(2, 3, 1), np.array([[0.1], [0.2], [0.3]])
    found = cpd.log_density(values, {x.previous: before})
    np.testing.assert_allclose(found, laplace.logpdf((values - before)[..., 0], **RUN))
    drawn = cpd.sample({x.previous: [[0.0], [5.0]]}, size=20_000, rng=1)
    assert drawn.shape == (20_000, 2, 1)
    assert np.abs(drawn.mean(axis=0)[:, 0] - [0.0, 5.0]).max() < 0.02
    sample = model(observation=[pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1)]).sample(
        {}, steps=3, runs=5, rng=1
    )
    assert sample[x].shape == (5, 4, 1)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda c, y: np.full(y.shape[:-1], np.nan), "NaN or plus infinity"),
        (lambda c, y: np.full(y.shape[:-1], np.inf), "NaN or plus infinity"),
        (lambda c, y: y, "returned shape"),
        (lambda c, y: 1 / 0, "failed: ZeroDivisionError"),
    ],
)
def test_densities_that_are_none(function, message):
    bad = model(observation=[pgm.SampledCPD(z, x, log_density=function)])
    with pytest.raises(pgm.PgmError, match=message) as caught:
        pgm.filter(bad, READ, belief=pgm.Particles(50))
    assert caught.value.step == 1


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda y, size, rng: np.full((*size, 1), np.nan), "draws values that are NaN"),
        (lambda y, size, rng: np.zeros(3), "returned shape"),
        (lambda y, size, rng: 1 / 0, "failed: ZeroDivisionError"),
    ],
)
def test_draws_that_are_none(function, message):
    bad = model(transition=[pgm.SampledCPD(x, x.previous, sample=function)])
    with pytest.raises(pgm.PgmError, match=message):
        pgm.filter(bad, READ, belief=pgm.Particles(50))


def test_half_a_cpd():
    with pytest.raises(pgm.ModelError, match="give sample="):
        pgm.SampledCPD(x)
    with pytest.raises(pgm.ModelError, match="must be callable"):
        pgm.SampledCPD(x, sample=3)
    unread = model(observation=[pgm.SampledCPD(z, x, sample=jump)])
    with pytest.raises(pgm.ModelError, match="has no density"):
        pgm.filter(unread, READ, belief=pgm.Particles(50))
    unmoved = model(transition=[pgm.SampledCPD(x, x.previous, log_density=log_jump)])
    with pytest.raises(pgm.ModelError, match="cannot be drawn from"):
        pgm.filter(unmoved, READ, belief=pgm.Particles(50))
    with pytest.raises(pgm.ModelError, match="discrete"):
        pgm.SampledCPD(pgm.Discrete("d", ("a", "b")), sample=jump)


def test_a_measurement_is_missing_as_a_whole():
    pair = pgm.Variable("pair", components=("a", "b"))
    both = pgm.SampledCPD(pair, x, log_density=lambda c, y: -np.abs(c - y).sum(axis=-1))
    read = np.array([[1.0, 1.1], [np.nan, np.nan]])
    cloud = pgm.Particles(100, seed=1)
    found = pgm.filter(model(observation=[both]), {pair: read}, belief=cloud)
    assert np.isfinite(found.log_evidence)
    read[1, 0] = 0.5
    with pytest.raises(pgm.EvidenceError, match="cannot leave out"):
        pgm.filter(model(observation=[both]), {pair: read}, belief=cloud)


def test_gaussian_beliefs_refuse_it():
    for work in (
        lambda: pgm.filter(model(), READ),
        lambda: pgm.smooth(model(), READ, lineariser=pgm.Unscented()),
        lambda: pgm.OnlineFilter(model()),
        lambda: pgm.infer(pgm.compile(model().unroll(2)), {}),
    ):
        with pytest.raises(pgm.ModelError, match="is no Gaussian CPD"):
            work()
