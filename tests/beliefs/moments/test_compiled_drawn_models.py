"""Drawn models in machine code against the general kernels: alike, or told."""

import warnings
from importlib.util import find_spec

import numpy as np
import pytest
from crossed import slow_after

import pgm

pytestmark = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")

CURVES = [
    np.sin,
    np.arctan,
    np.tanh,
    lambda s: s + 0.05 * s * np.abs(s),
    lambda s: np.exp(-0.5 * s * s),
    lambda s: np.hypot(s, 1.0),
    lambda s: s / (1.0 + s * s),
]
RULES = [
    pgm.Taylor(),
    pgm.Unscented(),
    pgm.Cubature(),
    pgm.Unscented(alpha=0.1),
    pgm.GaussHermite(3),
]
LOSSES = [pgm.StudentT(4.0), pgm.StudentT(1.0), pgm.Huber(1.5), pgm.Cauchy(2.0)]


def covariance(rng, scale, singular=False):
    """Of components of these scales, with variances over two decades, some of them zero."""
    n = len(scale)
    variances = 10.0 ** rng.uniform(-2, 0, n)
    if singular and n > 1:
        variances[: rng.integers(1, n)] = 0.0
    turned, _ = np.linalg.qr(rng.normal(size=(n, n)))
    root = scale[:, None] * turned * np.sqrt(variances)
    return root @ root.T


class Drawn:
    """A model of one or two states and up to three sensors, with its evidence."""

    sensors_below = 0, 4

    def __init__(self, seed):
        self.rng = rng = np.random.default_rng(seed)
        n, m = int(rng.integers(1, 5)), int(rng.integers(1, 3))
        names = tuple("abcd"[:n])
        angles = tuple(each for each in names if rng.random() < 0.25)
        self.runs = [(), (), (3,), (int(rng.integers(8, 301)),)][rng.integers(4)]
        self.steps = int(rng.integers(1, 25))
        turning = np.array([each in angles for each in names])
        scale = 10.0 ** (rng.integers(-6, 7) + rng.uniform(-1, 1, n)) if rng.random() < 0.5 else 1.0
        self.scale = np.where(turning, rng.choice([0.03, 0.3]), scale * np.ones(n))
        far = self.scale * 10.0 ** rng.uniform(0, 5) if rng.random() < 0.2 else np.zeros(n)
        self.far = np.where(turning, 0.0, far)
        self.x, self.u = pgm.Variable("x", names, angles), pgm.Variable("u", tuple("vw"[:m]))
        self.y = pgm.Variable("y") if rng.random() < 0.25 else None
        self.hidden = rng.random() < 0.3  # the control
        self.sensors = [self.sensor(k) for k in range(rng.integers(*self.sensors_below))]
        self.network = pgm.DynamicBayesianNetwork(*self.states(m), self.sensors)
        inputs = rng.normal(size=(*self.runs, self.steps, m)) * rng.choice([0.1, 1.0, 3.0])
        self.evidence = {} if self.hidden else {self.u: inputs}
        if self.sensors:
            self.evidence |= self.readings()

    def curve(self):
        return CURVES[self.rng.integers(len(CURVES))]

    def states(self, m):
        """Priors and transitions."""
        rng, x, u, y, scale, far = self.rng, self.x, self.u, self.y, self.scale, self.far
        n, curve = x.dimension, self.curve()
        a, b = rng.normal(size=(n, n)) / np.sqrt(n), rng.normal(size=(n, m))

        def move(state, control):
            s = (state - far) / scale
            pushed = 0.2 * (control @ b.T) + 0.1 * np.sin(s) * control[..., :1]
            return far + scale * (0.7 * curve(s @ a.T) + 0.3 * s + pushed)

        noise = 10.0 ** rng.uniform(-8, 0.5) * covariance(rng, scale, rng.random() < 0.25)
        mean = far + scale * rng.normal(size=(*self.runs, n))
        spread = 10.0 ** rng.uniform(-4, 1.5) * covariance(rng, scale, rng.random() < 0.1)
        prior = [pgm.GaussianCPD(x, mean, spread)]
        transition = [pgm.NonlinearGaussianCPD(x, (x.previous, u), move, cov=noise)]
        if rng.random() < 0.25:
            matrix = scale[:, None] * (0.8 * a) / scale
            given = {x.previous: matrix, u: scale[:, None] * b}
            transition = [pgm.LinearGaussianCPD(x, given, offset=far - matrix @ far, cov=noise)]
        if self.hidden:
            known = pgm.GaussianCPD(u, 0.5 * rng.normal(size=m), 10.0 ** rng.uniform(-3, -0.5))
            transition.insert(0, known)
        if y is not None:
            other, cov = self.curve(), 10.0 ** rng.uniform(-5, 0)

            def turned(before, state):
                return 0.7 * other(before) + 0.1 * ((state - far) / scale)[..., :1]

            prior.append(pgm.GaussianCPD(y, 0.3, 1.0))
            transition.append(pgm.NonlinearGaussianCPD(y, (y.previous, x), turned, cov=cov))
        return prior, transition

    def sensor(self, k):
        rng, x, far, scale = self.rng, self.x, self.far, self.scale
        height = int(rng.integers(1, 3))
        names = tuple("pq"[:height])
        z = pgm.Variable(f"z{k}", names, names[:1] if rng.random() < 0.3 else ())
        matrix, curve = rng.normal(size=(height, x.dimension)), self.curve()
        unit = np.where(z.angle_mask, 1.0, 10.0 ** rng.choice([0, 0, rng.integers(-5, 6)]))
        noise = 10.0 ** rng.uniform(-7, 1) * covariance(rng, unit)
        if self.y is None and rng.random() < 0.3:
            slope = unit[:, None] * matrix / scale
            return pgm.LinearGaussianCPD(z, {x: slope}, cov=noise, noise=self.loss())

        def see(state, *more):
            found = curve(((state - far) / scale) @ matrix.T)
            return unit * (found + 0.3 * more[0] if more else found)

        given = (x, self.y) if self.y is not None and rng.random() < 0.5 else (x,)
        return pgm.NonlinearGaussianCPD(z, given, see, cov=noise, noise=self.loss())

    def loss(self):
        """A sensor's robust noise."""
        return

    def readings(self):
        """Readings drawn from the model, some of them, or components of them, missing.

        Where a drawn motion grows beyond float64, they are of nothing.
        """
        try:
            drawn = self.network.sample(self.evidence, steps=self.steps, rng=self.rng)
        except pgm.LinearisationError:
            drawn = None
        found = {}
        for sensor in self.sensors:
            if drawn is None:
                values = self.rng.normal(size=(self.steps, sensor.child.dimension))
            else:
                values = np.array(drawn[sensor.child], dtype=float)[..., -self.steps :, :]
            values[self.rng.random(values.shape[:-1]) < 0.3] = np.nan
            values[self.rng.random(values.shape) < 0.1] = np.nan
            found[sensor.child] = values
        return found

    def solved(self, rule, smooth, compiled, by=0.0):
        """The posterior, or its refusal, and whether it warned.

        All readings and inputs, and the means of the prior, are changed `by` a share.
        """
        evidence = {each: values * (1.0 + by) for each, values in self.evidence.items()}
        prior = [
            pgm.GaussianCPD(each.child, each.mean * (1.0 + by), each.cov)
            for each in self.network.prior
        ]
        network = self.network.replace(prior=prior)
        infer, more = (pgm.smooth if smooth else pgm.filter), {}
        if not evidence:
            more["steps"] = self.steps
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                found = infer(network, evidence, lineariser=rule, compiled=compiled, **more)
            except pgm.PgmError as error:
                return error, False
        return found, bool(told)

    def apart(self, one, other):
        """The largest difference of means, in deviations; of exact ones, in digits.

        Their last places do not count: far from zero they are more than a deviation's 1e-10. A
        hundredth of that of a covariance, as a share of its deviations, counts too, and the share
        of a log-evidence. Numbers that are NaN on one side alone are infinitely far apart.
        """
        evidence = [np.asarray(each.log_evidence) for each in (one, other)]
        worst = largest(np.subtract(*evidence) / np.maximum(1.0, np.abs(evidence[0])))
        for variable in (self.x, self.y) if self.y is not None else (self.x,):
            left = one[variable].mean - other[variable].mean
            mask, std = variable.angle_mask, one[variable].std
            left[..., mask] = (left[..., mask] + np.pi) % (2 * np.pi) - np.pi
            unit = np.maximum(std, 1e-5 * (1e-300 + np.abs(one[variable].mean)) * (std == 0.0))
            beyond = np.maximum(np.abs(left) - 4.0 * np.spacing(np.abs(one[variable].mean)), 0.0)
            both = std[..., :, None] * std[..., None, :]
            spread = one[variable].cov - other[variable].cov
            worst = max(worst, largest(beyond / unit), 1e-2 * largest(spread, both))
        return worst


def largest(differences, unit=1.0):
    """The largest size of differences in units; of none in units of zero nothing, else infinity."""
    sizes = np.abs(differences)
    shares = np.where(sizes > 0.0, np.inf, 0.0)
    np.divide(sizes, unit, out=shares, where=np.broadcast_to(unit, sizes.shape) > 0.0)
    return np.inf if np.isnan(shares).any() else shares.max(initial=0.0)


class Robust(Drawn):
    """A model of one or two sensors of robust noise."""

    sensors_below = 1, 3

    def loss(self):
        """A sensor's robust noise."""
        return LOSSES[self.rng.integers(len(LOSSES))]


def check(seed, drawn=Drawn):
    model = drawn(seed)
    rule, smooth = RULES[seed % len(RULES)], bool(seed % 2)
    (plain, warned), (fast, told) = (
        model.solved(rule, smooth, compiled) for compiled in (False, True)
    )
    if isinstance(plain, pgm.PgmError) or isinstance(fast, pgm.PgmError):
        assert type(plain) is type(fast), (plain, fast)
        return
    apart = model.apart(plain, fast)
    if apart > 1e-10 and not (warned and told):
        # A model far from zero, and a filter that has lost its way, magnify a last digit as much.
        moved = [model.solved(rule, smooth, False, by=by)[0] for by in (-2e-16, 2.3e-16)]
        least = max(model.apart(plain, each) for each in moved)
        assert apart < 30.0 * least, (apart, least, plain.status, fast.status)


@pytest.mark.parametrize("seed", range(2))
def test_drawn_models(seed):
    check(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 1100))
def test_many_drawn_models(seed):
    check(seed)


@pytest.mark.parametrize("seed", slow_after(1, range(1, 301)))
def test_drawn_models_of_robust_noise(seed):
    check(seed, Robust)
