"""Smoothing after readings without noise, against least squares of the whole record."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from crossed import slow_after
from drawn_chains import draw
from precise import Reference, floats
from scipy.linalg import block_diag

import pgm

STEPS = 80
z = pgm.Variable("z")


def moving_average(coefficients):
    """z = u[t] + Σ θ_k u[t − k] of the state (u[t], ..., u[t − q])."""
    size = len(coefficients)
    push = np.zeros((size + 1, 1))
    push[0] = 1.0
    return np.eye(size + 1, k=-1), push, np.array([[1.0, *coefficients]]), np.eye(size + 1)


def arma_with_trend():
    """A straight trend and a[t] = .5 a[t−1] + e[t] + .1 e[t−1]: the state (level, slope, a, e)."""
    moved = block_diag([[1.0, 1.0], [0.0, 1.0]], [[0.5, 0.1], [0.0, 0.0]])
    push = np.array([[0.0], [0.0], [1.0], [1.0]])
    return moved, push, np.array([[1.0, 0.0, 1.0, 0.0]]), np.diag([10.0, 0.1, 1.0, 1.0])


MODELS = {
    "MA(1)": moving_average([0.2]),
    "MA(1), nearly not invertible": moving_average([0.9]),
    "MA(4)": moving_average([0.3, 0.0, 0.0, 0.1]),
    "ARMA with a trend": arma_with_trend(),
}


def whole_record(moved, push, row, root, values):
    """The states of all steps given all readings, by least squares: x = B e with e ~ N(0, 1).

    The readings are A e, so that e given them is N(A⁺ z, 1 − A⁺ A).
    """
    size, own = push.shape
    steps = len(values)
    lines = [np.hstack([root, np.zeros((size, steps * own))])]
    for k in range(steps):
        line = moved @ lines[-1]
        line[:, size + k * own : size + (k + 1) * own] = push
        lines.append(line)
    seen = np.vstack([row @ line for line in lines[1:]])
    orthogonal, triangle = np.linalg.qr(seen.T, mode="complete")
    triangle = triangle[:steps]
    assert np.linalg.cond(triangle) < 3e3  # hence ten digits and more are right
    white = np.linalg.solve(triangle.T, values[:, 0])
    every = np.vstack(lines)
    mean, spread = every @ orthogonal[:, :steps] @ white, every @ orthogonal[:, steps:]
    shape = (steps + 1, size)
    diagonal = np.log(np.abs(np.diag(triangle)))
    return SimpleNamespace(
        mean=mean.reshape(shape),
        cov=(spread @ spread.T).reshape(*shape, *shape),
        log_evidence=-diagonal.sum() - 0.5 * (white @ white + steps * np.log(2 * np.pi)),
    )


def network(moved, push, row, root):
    x = pgm.Variable("x", tuple(f"x{k}" for k in range(len(moved))))
    return x, pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros(len(moved)), root @ root.T)],
        [pgm.LinearGaussianCPD(x, {x.previous: moved}, cov=push @ push.T)],
        [pgm.LinearGaussianCPD(z, {x: row}, cov=np.zeros((1, 1)))],
    )


def smoothed(model, evidence, balanced):
    if not balanced:
        return pgm.smooth(model, evidence)
    graph = pgm.compile(model, steps=STEPS, method=pgm.Balanced())
    return pgm.infer(graph, evidence, schedule=pgm.Smoothing())


def solved(name):
    rng = np.random.default_rng(4)
    values = rng.normal(size=(STEPS, 1))
    x, model = network(*MODELS[name])
    return x, model, {z: values}, whole_record(*MODELS[name], values)


@pytest.mark.parametrize(
    ("name", "balanced"), [*((name, False) for name in MODELS), ("MA(1)", True), ("MA(4)", True)]
)
def test_least_squares_of_the_whole_record(name, balanced):
    """Means, covariances, log-evidence, and joints of steps near and far."""
    x, model, evidence, due = solved(name)
    posterior = smoothed(model, evidence, balanced)
    each = np.arange(STEPS + 1)
    belief = posterior[x]
    np.testing.assert_allclose(belief.mean, due.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(belief.cov, due.cov[each, :, each], rtol=0, atol=1e-9)
    assert (np.diagonal(belief.cov, axis1=-2, axis2=-1) >= 0.0).all()
    assert posterior.log_evidence == pytest.approx(due.log_evidence, abs=1e-9)
    for steps in ([0, 1, 40, 79, 80], [50, 2, 51]):
        joint = posterior.joint(*(x.at(step) for step in steps))
        size = len(steps) * x.dimension
        block = due.cov[steps][:, :, steps].reshape(size, size)
        np.testing.assert_allclose(joint.mean, due.mean[steps].ravel(), rtol=0, atol=1e-9)
        np.testing.assert_allclose(joint.cov, block, rtol=0, atol=1e-9)


# ---- what readings determine


def has_determined_states(case):
    singular = {"singular motion", "singular prior"} & case.traits
    return bool(singular) and "exact sensor" in case.traits


@pytest.mark.parametrize("first", slow_after(1, range(1000, 1060, 20)))
def test_what_is_determined_has_no_variance(first):
    """None is negative, and a belief can be handed back as a prior."""
    cases = [draw(seed, 8) for seed in range(first, first + 20)]
    compared = [compare(case) for case in cases if has_determined_states(case)]
    assert sum(compared) >= 7


def compare(case):
    references = [Reference(case.model, case.steps, *run) for run in case.runs]
    if max(r.disagreement for r in references) > 0.0:
        return False  # readings, rounded, that contradict exact ones determine nothing
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.PrecisionWarning)  # variances are right all the same
        posterior = pgm.smooth(case.model, case.evidence, steps=case.steps)
    due = floats([[cov for _, cov in r.smoothed] for r in references])
    for v, places in references[0].places.items():
        belief = posterior[v]
        first = 0 if v in case.model.states else 1
        shape = (len(references), case.steps + 1 - first, v.dimension)
        found = np.diagonal(belief.cov, axis1=-2, axis2=-1).reshape(shape)
        variances = np.diagonal(due, axis1=-2, axis2=-1)[:, first:, places]
        assert (found >= 0.0).all(), case.seed
        assert (found[variances == 0.0] == 0.0).all(), case.seed
        again = pgm.GaussianCPD(v, belief.mean, belief.cov)
        np.testing.assert_array_equal(again.cov, belief.cov)
    return True


@pytest.mark.filterwarnings("ignore::pgm.PrecisionWarning")  # means have few digits of 1e-15
@pytest.mark.parametrize("seed", [11, 49, 51, 54, 79, 113, 117, 135, 137, 147, 148])
def test_what_hardly_varies_has_a_covariance(seed):
    """A state that exact readings have narrowed to 1e-15 can be handed back as a prior."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(2, 4))
    push, row = rng.normal(size=(size, 1)), rng.normal(size=(1, size))
    x, model = network(0.6 * rng.normal(size=(size, size)), push, row, np.eye(size))
    seen = {z: model.sample({}, steps=15, rng=seed)[z]}
    for posterior in (pgm.filter(model, seen), pgm.smooth(model, seen)):
        pgm.GaussianCPD(x, posterior[x].mean, posterior[x].cov)
