"""Audits of linear models: every weight is the evidence, however singular the covariances."""

import numpy as np
import pytest
from dense import random_covariance
from test_linear_dense import CASES, I2, O2, PUSH, SOME, fix, rolling, z
from test_linear_dense import x as rolled
from textbooks import assert_log

import pgm
from pgm.inference.audit.chain import ChainDraws

x = pgm.Variable("x", components=("a", "b", "c"))
y = pgm.Variable("y", components=("p", "q"))
u, command = (pgm.Variable(name, components=("v", "w")) for name in ("u", "command"))
seen, extra = (pgm.Variable(name, components=("s", "t")) for name in ("seen", "extra"))
level = pgm.Variable("level")


def check(posterior, *, relative=False, samples=200):
    """All weights are equal, to the evidence that the innovations give."""
    assert posterior.log_evidence_kind == "exact"
    assert ChainDraws.make(posterior._outcome).relative == relative
    found = pgm.audit(posterior, samples=samples, rng=1)
    lead = posterior.log_evidence.shape
    assert found.log_weights.shape == (*lead, samples)
    assert_log(found.log_weights, posterior.log_evidence[..., None], 1e-9)
    assert_log(found.log_evidence, posterior.log_evidence, 1e-9)
    np.testing.assert_array_equal(found.gaussian_log_evidence, posterior.log_evidence)
    np.testing.assert_allclose(found.effective_sample_size, samples, rtol=1e-9)
    for value in (found.divergence, found.standard_error, found.correction):
        assert value.shape == lead
        assert np.abs(value).max() < 1e-7
    assert (found.pareto_k == -np.inf).all()
    return found


def readings(rows):
    return {
        cpd: pgm.sightings([row[2] for row in some], step=[row[1] for row in some])
        for cpd in {row[0] for row in rows}
        for some in [[row for row in rows if row[0] == cpd]]
    }


@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth], ids=["filter", "smooth"])
@pytest.mark.parametrize("name", CASES)
def test_singular_covariances(name, run):
    check(run(CASES[name], readings(SOME), steps=6))


@pytest.mark.parametrize("steps", [0, 1])
def test_short_chains(steps):
    check(pgm.smooth(rolling(), readings([(z, 0, [0.5]), (z, steps, [0.75])]), steps=steps))


def test_without_readings_the_evidence_is_one():
    found = check(pgm.smooth(rolling(cov=PUSH), {}, steps=4))
    np.testing.assert_allclose(found.log_evidence, 0.0, atol=1e-12)


EXACT = {
    "after noise": (rolling(noise=0.0), [(z, k, [0.5 * k]) for k in (0, 1, 3)]),
    "after noise of rank 1": (rolling(noise=0.0, cov=PUSH), [(z, k, [0.5]) for k in (0, 1, 3)]),
    "twice at a step": (rolling(noise=0.0), [(z, 2, [0.5]), (z, 2, [0.5])]),
    "static": (rolling(noise=0.0, cov=O2, motion=I2), [(z, k, [0.5]) for k in (0, 2, 4)]),
    "determined": (rolling(noise=0.0, cov=O2), [(z, 0, [1.0]), (z, 1, [1.25]), (z, 4, [2.0])]),
    "noise of rank 1": (
        rolling(cov=PUSH, sensor=pgm.LinearGaussianCPD(fix, {rolled: 1.0}, cov=0.1 * PUSH)),
        [(fix, 1, [0.5, 0.25]), (fix, 2, [0.75, 0.5])],
    ),
}


@pytest.mark.parametrize("name", EXACT)
def test_exact_sensors(name):
    model, rows = EXACT[name]
    check(pgm.smooth(model, readings(rows), steps=5), relative=True)


def louder(command):
    return (0.2 + command[..., :1, None] ** 2) * np.eye(2)


def network(rng, ranks):
    """Two states, one of which drives the other, a hidden control, noise of given ranks."""
    sizes = (3, 2, 2, 3, 2)
    cov = [random_covariance(rng, size, rank) for size, rank in zip(sizes, ranks, strict=True)]
    turn = [[0, 1], [-1, 0]]
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(x, rng.normal(size=(4, 3)), cov[0]),
            pgm.LinearGaussianCPD(y, {x: rng.normal(size=(2, 3))}, cov=cov[1]),
        ],
        transition=[
            pgm.LinearGaussianCPD(u, {command: 1.0}, cov=cov[2]),
            pgm.LinearGaussianCPD(
                x, {x.previous: 0.9 * np.eye(3), u: rng.normal(size=(3, 2))}, cov=cov[3]
            ),
            pgm.LinearGaussianCPD(y, {y.previous: turn, x: rng.normal(size=(2, 3))}, cov=cov[4]),
        ],
        observation=[
            pgm.LinearGaussianCPD(
                seen,
                {x: rng.normal(size=(2, 3)), y: rng.normal(size=(2, 2)), extra: 1.0},
                cov=pgm.noise(louder, given=extra),
            ),
            pgm.LinearGaussianCPD(level, {y: rng.normal(size=(1, 2)), u: [[1.0, 0.0]]}, cov=0.1),
        ],
    )


RANKS = [(3, 2, 2, 3, 2), (1, 0, 2, 0, 0), (0, 0, 1, 1, 0), (3, 1, 0, 1, 1), (2, 1, 1, 2, 1)]


@pytest.mark.parametrize("ranks", RANKS)
def test_batches_hidden_controls_sightings_and_missing_readings(ranks):
    rng = np.random.default_rng(sum(ranks))
    model, steps, count = network(rng, ranks), 12, 20
    when = rng.integers(0, steps + 1, count)
    inputs = {
        command: rng.normal(size=(steps, 2)),
        seen: pgm.sightings(step=when, given={extra: rng.normal(size=(count, 2))}),
    }
    evidence = dict(model.sample(inputs, runs=(2, 4), rng=rng).evidence)
    values = evidence[seen].values.copy()
    values[rng.random(values.shape[:-1]) < 0.3] = np.nan
    evidence[seen] = pgm.sightings(values, when, inputs[seen].given)
    check(pgm.smooth(model, evidence))
    check(pgm.filter(model, evidence))


def test_noise_that_comes_and_goes():
    """A standing robot has no noise: which components are drawn changes by step and run."""
    speed = pgm.Variable("speed")

    def driven(v):
        one, other = v[..., :1, None] ** 2, np.diag([1.0, 0.0])
        return one * other + (v[..., :1, None] > 1.0) * np.diag([0.0, 1e-3])

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(y, [0, 1], np.eye(2))],
        transition=[
            pgm.LinearGaussianCPD(
                y, {y.previous: [[1, 0.1], [0, 1]]}, cov=pgm.noise(driven, given=speed)
            )
        ],
        observation=[pgm.LinearGaussianCPD(level, {y: [[1.0, 0.5]]}, cov=0.1)],
    )
    rng = np.random.default_rng(0)
    speeds = rng.choice([0.0, 0.5, 2.0], (3, 15, 1))
    evidence = model.sample({speed: speeds}, runs=3, rng=rng).evidence
    check(pgm.smooth(model, evidence))


def test_a_static_network_with_a_child_without_noise():
    a, b, c, d, e = pgm.variables("a b c d e")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, mean=[[1.0], [2.0]], cov=2.0),
            pgm.LinearGaussianCPD(b, {a: 0.5}, cov=0.0),
            pgm.LinearGaussianCPD(c, {a: 1.0, b: -2.0}, cov=0.3),
            pgm.LinearGaussianCPD(d, {c: 1.5}, offset=0.2, cov=0.1),
            pgm.LinearGaussianCPD(e, {b: 1.0}, cov=0.4),
        ]
    )
    posterior = pgm.infer(pgm.compile(net), {d: 1.2, e: 0.3})
    found = pgm.audit(posterior, samples=50, rng=0)
    assert found.log_weights.shape == (2, 50)
    assert_log(found.log_weights, posterior.log_evidence[:, None])
    exact = net.replace(pgm.LinearGaussianCPD(e, {b: 1.0}, cov=0.0))
    posterior = pgm.infer(pgm.compile(exact), {d: 1.2, e: 0.3})
    assert_log(pgm.audit(posterior, samples=50, rng=0).log_weights, posterior.log_evidence[:, None])


def test_an_unrolled_network_gives_what_its_chain_does():
    model = rolling(cov=PUSH)
    values = np.array([[0.3], [1.0], [1.2], [2.0]])
    chain = pgm.smooth(model, {z: pgm.sightings(values, step=range(4))}, steps=3)
    net = model.unroll(3)
    tree = pgm.infer(pgm.compile(net), {z.at(k): value for k, value in enumerate(values)})
    due = pgm.audit(chain, rng=0).log_evidence
    assert_log(pgm.audit(tree, rng=0).log_weights, due)
