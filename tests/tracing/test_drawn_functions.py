"""Drawn functions, traced or not, changed between two calls, against twins that call them."""

import functools
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from tests.tracing import drawn, twin

MACHINE = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")
# At a kink within a step of differences these differ from each other; a trace is exact.
TANGENTS = [functools.partial(twin.tangent, finer=each) for each in (1.0, 1e-2, 1e-5)]
RULES = [(pgm.Taylor(), TANGENTS, 1e-5), (pgm.Unscented(), [twin.unscented], 1e-6)]


class Model:
    """A chain whose motion, and often sensor, is a drawn function, and its evidence."""

    def __init__(self, seed, runs):
        rng = np.random.default_rng(seed)
        n, m = int(rng.integers(1, 4)), int(rng.integers(1, 3))
        self.x = x = pgm.Variable("x", components=tuple("abc"[:n]))
        self.u = u = pgm.Variable("u", components=tuple("vw"[:m]))
        steps, centred = int(rng.choice([6] * 9 + [70])), rng.random() < 0.35
        mean = np.zeros((*runs, n)) if centred else rng.normal(size=(*runs, n))
        variance, self.motion = rng.choice([0.01, 0.3]), rng.choice([1e-4, 0.02]) * np.eye(n)
        self.inputs = rng.choice([0.0, 1.0, 2.0, 3.0], size=(*runs, steps, m))
        if rng.random() < 0.5:  # seldom another one
            self.inputs[..., 0] = 0.0
            self.inputs[..., [steps // 3, steps // 2], 0] = 2.0
        self.functions = [drawn.draw(rng, n, m)]
        move = self.functions[0].function
        if rng.random() < 0.4:
            self.functions.append(drawn.draw(rng, n, m))
            known, see = rng.choice([1.0, 2.0], size=m), self.functions[1].function
            z = pgm.Variable("z", components=x.components)
            self.see = lambda a: see(a, np.broadcast_to(known, (*a.shape[:-1], m)))
            sensor = pgm.NonlinearGaussianCPD(z, x, self.see, cov=0.05)
        else:
            matrix, z = rng.normal(size=(1, n)), pgm.Variable("z")
            self.see = lambda a: matrix @ a
            sensor = pgm.LinearGaussianCPD(z, {x: matrix}, cov=0.05)
        self.noise = 0.05 * np.eye(z.dimension)
        self.readings = rng.normal(size=(*runs, steps, z.dimension)) * (not centred)
        self.readings[rng.random(self.readings.shape[:-1]) < 0.4] = np.nan
        self.evidence = {u: self.inputs, z: self.readings}
        self.prior = mean, variance * np.eye(n)
        self.network = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(x, mean, variance)],
            [pgm.NonlinearGaussianCPD(x, (x.previous, u), move, cov=self.motion)],
            [sensor],
        )

    def __str__(self):
        return " | ".join(each.name for each in self.functions)

    def change(self):
        for each in self.functions:
            each.change()

    def due(self, rule, run):
        """The twin's filter and smoother of a run."""
        mean, cov = self.prior
        before = np.full((1, len(self.noise)), np.nan)
        return twin.smooth(
            rule,
            twin.Moments(mean[run], cov),
            self.functions[0].function,
            self.motion,
            lambda a: np.asarray(self.see(a), dtype=float),
            self.noise,
            self.inputs[run],
            np.vstack([before, self.readings[run]]),
        )


def error(found, due, run):
    """The largest error of means and covariances, in deviations."""
    std = np.sqrt(np.einsum("tii->ti", due.cov))
    means = np.abs((found.mean[run] - due.mean) / std)
    covs = np.abs((found.cov[run] - due.cov) / (std[:, :, None] * std[:, None]))
    return max(means.max(), covs.max())


def check(seed, compiled):
    """Filter or smooth, change the functions, and do it again."""
    runs = [(), (3,), (12,)][seed % 3]
    smooth = seed // 3 % 2
    rule, twins, least = RULES[seed // 6 % 2]
    model = Model(seed, runs)
    infer = pgm.smooth if smooth else pgm.filter
    for _ in range(2):
        found = infer(model.network, model.evidence, lineariser=rule, compiled=compiled)[model.x]
        for run in {tuple(0 for _ in runs), tuple(size - 1 for size in runs)}:
            errors = (error(found, model.due(each, run)[smooth], run) for each in twins)
            assert any(each < least for each in errors), str(model)
        model.change()


# The first ones have slopes that go wrong where all values are alike.
@pytest.mark.parametrize("seed", [37, 98, 173, 229, *range(30)])
def test_drawn_functions(seed):
    check(seed, False)


@MACHINE
@pytest.mark.parametrize("seed", [4, 6, 1201])  # the last has a trace at every second try
def test_drawn_functions_in_machine_code(seed):
    check(seed, True)


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
@pytest.mark.parametrize("seed", range(1000, 1300))
def test_many_drawn_functions(seed, compiled):
    check(seed, compiled)


def online(seed, compiled):
    model = Model(seed, ())
    rule, twins, least = RULES[seed % 2]
    robot = pgm.OnlineFilter(model.network, lineariser=rule, compiled=compiled)
    (z,) = set(model.evidence) - {model.u}
    for _ in range(2):
        beliefs = [robot.initial()]
        for given, reading in zip(model.inputs, model.readings, strict=True):
            belief = robot.predict(beliefs[-1], {model.u: given})
            beliefs.append(robot.update(belief, {z: reading}))
        mean, cov = (
            np.array([getattr(belief[model.x], each) for belief in beliefs])
            for each in ("mean", "cov")
        )
        found = twin.Moments(mean, cov)
        assert any(error(found, model.due(each, ())[0], ...) < least for each in twins), str(model)
        model.change()
        robot = robot.renewed()


@pytest.mark.parametrize("seed", range(100, 108))
def test_drawn_functions_online(seed):
    online(seed, False)


@pytest.mark.slow
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=MACHINE)])
@pytest.mark.parametrize("seed", range(2000, 2150))
def test_many_drawn_functions_online(seed, compiled):
    online(seed, compiled)


def test_each_way_of_changing_changes_the_constants():
    for name, holder in drawn.HOLDERS.items():
        get, change = holder([1.0, 2.0], [3.0, 4.0])
        assert_allclose(get(), [1.0, 2.0], err_msg=name)
        change()
        assert_allclose(get(), [3.0, 4.0], err_msg=name)


def test_half_of_the_drawn_functions_have_a_trace():
    """Else the draws above would say little about traces."""
    rng = np.random.default_rng(4)
    x, u = pgm.variables("x u")
    every = [drawn.draw(rng, 1, 1).function for _ in range(60)]
    made = [pgm.NonlinearGaussianCPD(x, (x.previous, u), each, cov=1.0) for each in every]
    traced = [each.derivatives[x.previous] == "traced" for each in made]
    assert 15 <= sum(traced) <= 45


def test_the_twin_is_a_kalman_filter_of_a_line():
    """The twin itself, against the joint of a chain of two steps."""
    a, c, q, r, p = 0.8, 1.5, 0.1, 0.2, 0.7
    rng = np.random.default_rng(1)
    readings = np.vstack([[[np.nan]], rng.normal(size=(2, 1))])
    inputs = np.zeros((2, 1))
    # Of (x0, x1, x2) with noises e ~ N(0, diag(p, q, q)): x = L e.
    lower = np.array([[1.0, 0, 0], [a, 1.0, 0], [a * a, a, 1.0]])
    joint, seen = lower @ np.diag([p, q, q]) @ lower.T, c * np.eye(3)[1:]
    gain = joint @ seen.T @ np.linalg.inv(seen @ joint @ seen.T + r * np.eye(2))
    mean = lower[:, 0] * 0.4
    mean = mean + gain @ (readings[1:, 0] - seen @ mean)
    cov = joint - gain @ seen @ joint
    for rule in (twin.tangent, twin.unscented):
        _, found = twin.smooth(
            rule,
            twin.Moments(np.array([0.4]), np.array([[p]])),
            lambda x, u: a * x,
            np.array([[q]]),
            lambda x: c * x,
            np.array([[r]]),
            inputs,
            readings,
        )
        assert_allclose(found.mean[:, 0], mean, rtol=1e-9)
        assert_allclose(found.cov[:, 0, 0], np.diag(cov), rtol=1e-9)
