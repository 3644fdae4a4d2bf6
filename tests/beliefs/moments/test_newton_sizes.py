"""Gauss–Newton steps in machine code, of slices of all sizes and drawn parts."""

import numpy as np
import pytest
from crossed import slow_after
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

import pgm
from pgm.beliefs.moments.compiled import sweep
from pgm.beliefs.moments.smoothers import smoother

pytest.importorskip("llvmlite", reason="machine code is written by LLVM")


@pytest.fixture(autouse=True)
def steps_alone(monkeypatch):
    """The steps are in machine code, or fail; sweeps of large slices are not, which takes long."""
    for name in ("forward", "backward"):
        monkeypatch.setattr(sweep, name, lambda *arguments, **options: None)
    general = smoother._iterated

    def plain_only(chain, *arguments):
        assert chain.plan.layout.compiled is False, "runs were left to the general kernels"
        return general(chain, *arguments)

    monkeypatch.setattr(smoother, "_iterated", plain_only)


def both(model, evidence, steps, start, **options):
    graphs = [pgm.compile(model, steps, compiled=choice) for choice in (pgm.Compiled(2), False)]
    schedule = pgm.Smoothing(**{"iterations": 4, "tolerance": 0.0} | options)
    return [pgm.infer(graph, evidence, schedule=schedule, start=start) for graph in graphs]


def assert_same(found, due, variables):
    for variable in variables:
        ours, theirs = found[variable], due[variable]
        assert (abs(ours.mean - theirs.mean) <= 1e-10 * theirs.std).all()
        assert_allclose(ours.std, theirs.std, rtol=1e-10)
    residuals = [np.asarray(each.status.residuals) for each in (found, due)]
    assert_allclose(*residuals, rtol=1e-6, atol=1e-8)


def turned(values):
    return np.concatenate([values[..., 1:], values[..., :1]], axis=-1)


def drift(values):
    return 0.9 * values + 0.3 * np.sin(turned(values))


def sight(values):
    return values[..., :1] + 0.2 * np.sin(values[..., -1:])


def spread(rng, size):
    """A covariance that is not nearly singular."""
    root = rng.normal(size=(size, size))
    return 0.1 * np.eye(size) + 0.05 * root @ root.T / size


def of_size(size):
    """A drifting state of so many components, of which the first and the last are sighted."""
    rng = np.random.default_rng(size)
    state = pgm.Variable("state", components=tuple(f"c{k}" for k in range(size)))
    reading = pgm.Variable("reading", components=("seen",))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(state, rng.normal(size=size), spread(rng, size))],
        transition=[
            pgm.NonlinearGaussianCPD(state, (state.previous,), drift, cov=spread(rng, size))
        ],
        observation=[pgm.NonlinearGaussianCPD(reading, (state,), sight, cov=0.2)],
    )
    return model, state, reading, rng


@pytest.mark.parametrize("size", slow_after(5, [1, 3, 7, 17, 29, 2, 4, 5, 6, 8, 9, 12, 16, 60]))
def test_slices_of_all_sizes(size):
    model, state, reading, rng = of_size(size)
    evidence = {reading: rng.normal(size=(9, 1))}
    start = {state: rng.normal(size=(10, size))}
    assert_same(*both(model, evidence, 9, start), [state])


@pytest.mark.parametrize("size", [3, 7])
def test_the_optimum_is_that_of_a_dense_least_squares(size):
    model, state, reading, rng = of_size(size)
    values = rng.normal(size=(6, 1))
    start = {state: np.zeros((7, size))}
    found, _ = both(model, {reading: values}, 6, start, iterations=90, tolerance=1e-11)
    (prior,), (motion,) = model.prior, model.transition
    white = [np.linalg.inv(np.linalg.cholesky(each.cov)) for each in (prior, motion)]

    def residuals(flat):
        states = flat.reshape(7, size)
        parts = (
            (states[:1] - prior.offset) @ white[0].T,
            (states[1:] - drift(states[:-1])) @ white[1].T,
            (values - sight(states[1:])) / np.sqrt(0.2),
        )
        return np.concatenate([part.ravel() for part in parts])

    mean = found[state].mean
    due = least_squares(residuals, mean.ravel() + 0.01, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert_allclose(mean.ravel(), due.x, atol=1e-7)
    cov = np.linalg.inv(due.jac.T @ due.jac).reshape(7, size, 7, size)
    each = np.arange(7)
    assert_allclose(found[state].cov, cov[each, :, each], atol=1e-6)


def drawn(seed):
    """A model of two states and a hidden control, with sensors of different rates, and evidence."""
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 3, 2) if seed % 2 else rng.integers(3, 9, 2)
    runs, steps = (int(k) for k in (rng.integers(1, 4), rng.integers(1, 80)))
    names = [tuple(f"{name}{k}" for k in range(n)) for name, n in zip("ab", sizes, strict=True)]
    first = pgm.Variable("first", components=names[0], angles=names[0][:1])
    other = pgm.Variable("other", components=names[1])
    push = pgm.Variable("push", components=("p", "q"))
    look = pgm.Variable("look", components=tuple(f"l{k}" for k in range(sizes[0])))
    bearing = pgm.Variable("bearing", components=("at", "off"), angles=("at",))
    fix = pgm.Variable("fix", components=names[1])
    m, n = (int(size) for size in sizes)
    mixing, turn = 0.3 * rng.normal(size=(n, m)), 0.3 * rng.normal(size=(m, n))

    def moved(old, force):
        found = old + 0.1 * np.sin(turned(old)) + force[..., :1]
        angle = found[..., :1]
        return np.concatenate([np.arctan2(np.sin(angle), np.cos(angle)), found[..., 1:]], axis=-1)

    def seen(values, others):
        parts = sum(np.asarray(turn)[:, k] * others[..., k : k + 1] for k in range(n))
        return np.cos(values) + parts

    def aimed(values, force):
        angle = values[..., :1] + 0.3 * force[..., 1:]
        wrapped = np.arctan2(np.sin(angle), np.cos(angle))
        return np.concatenate([wrapped, force[..., :1] * values[..., -1:]], axis=-1)

    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(first, np.zeros(m), spread(rng, m)),
            pgm.LinearGaussianCPD(other, {first: mixing}, cov=spread(rng, n)),
        ],
        transition=[
            pgm.GaussianCPD(push, [0.3, 0.3], 0.1 * np.eye(2)),
            pgm.NonlinearGaussianCPD(first, (first.previous, push), moved, cov=spread(rng, m)),
            pgm.LinearGaussianCPD(
                other, {other.previous: 0.8 * np.eye(n), first: mixing}, cov=spread(rng, n)
            ),
        ],
        observation=[
            pgm.NonlinearGaussianCPD(look, (first, other), seen, cov=spread(rng, m)),
            pgm.NonlinearGaussianCPD(bearing, (first, push), aimed, cov=0.1 * np.eye(2)),
            pgm.LinearGaussianCPD(fix, {other: np.eye(n)}, cov=spread(rng, n)),
        ],
    )

    def sighted(variable, since, count):
        values = 0.5 * rng.normal(size=(runs, count, variable.dimension))
        values[rng.random(values.shape) < 0.15] = np.nan
        return pgm.sightings(values, step=np.sort(rng.integers(since, steps + 1, count)))

    evidence = {
        look: sighted(look, 0, int(rng.integers(1, 2 * steps + 2))),
        bearing: sighted(bearing, 1, int(rng.integers(1, steps + 2))),
        fix: sighted(fix, 0, steps),
    }
    start = {
        first: np.cumsum(0.3 * rng.normal(size=(runs, steps + 1, m)), axis=1),
        other: 0.3 * rng.normal(size=(runs, steps + 1, n)),
        push: 0.3 * rng.normal(size=(runs, steps, 2)),
    }
    return model, evidence, steps, start


@pytest.mark.parametrize("seed", slow_after(2, range(8)))
def test_drawn_models(seed):
    model, evidence, steps, start = drawn(seed)
    found, due = both(model, evidence, steps, start)
    assert_same(found, due, [*model.states, *model.controls])
