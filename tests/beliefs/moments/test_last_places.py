"""Means far from zero with small deviations: digits count the mean's own last place in float64."""

import math
import warnings
from fractions import Fraction

import numpy as np
import pytest
from crossed import crossed

import pgm
from pgm.beliefs.moments.passes.forward import Filtered

x, z, y = pgm.variables("x z y")
FAR, STEPS = 374866.7, 12


def fraction(value):
    return Fraction(float(value))


def network(far, std, *, carried=1.0, linear=True):
    """A number that is carried on about `far`, read ten times better than it moves."""

    def motion(a):
        return carried * a + far * (1.0 - carried)

    if linear:
        shift = {"offset": far * (1.0 - carried), "cov": (0.3 * std) ** 2}
        move = pgm.LinearGaussianCPD(x, {x.previous: carried}, **shift)
    else:
        move = pgm.NonlinearGaussianCPD(x, x.previous, motion, cov=(0.3 * std) ** 2)
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, far, std**2)],
        [move],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=(0.03 * std) ** 2)],
    )


def readings(far, std, seed=0):
    return far + std * np.cumsum(np.random.default_rng(seed).normal(size=(STEPS, 1)), axis=0)


def textbook(far, std, values):
    """Kalman's filter and Rauch's smoother in fractions: means and variances of each step."""
    mean, variance = fraction(far), fraction(std**2)
    moved, noise = fraction((0.3 * std) ** 2), fraction((0.03 * std) ** 2)
    filtered = [(mean, variance)]
    for value in values[:, 0]:
        variance = variance + moved
        gain = variance / (variance + noise)
        mean, variance = mean + gain * (fraction(value) - mean), (1 - gain) * variance
        filtered.append((mean, variance))
    smoothed = filtered[-1:]
    for mean, variance in filtered[-2::-1]:
        gain = variance / (variance + moved)
        later, left = smoothed[0]
        found = mean + gain * (later - mean), variance + gain**2 * (left - variance - moved)
        smoothed.insert(0, found)
    return filtered, smoothed


def largest(means, due):
    """The largest error of means, in their exact standard deviations."""
    return max(
        float(abs(fraction(mean) - exact)) / math.sqrt(variance)
        for mean, (exact, variance) in zip(means, due, strict=True)
    )


def online(model, values, **options):
    """Means after each step, and the fewest digits of all."""
    robot = pgm.OnlineFilter(model, **options)
    belief = robot.initial()
    means, digits = [belief[x].mean[0]], []
    for value in values:
        belief = robot.update(robot.predict(belief), {z: value})
        means.append(belief[x].mean[0])
        digits.append(belief.status.digits)
    return np.array(means), min((told for told in digits if told is not None), default=None)


def balanced(model, evidence):
    graph = pgm.compile(model, steps=STEPS, method=pgm.Balanced())
    return pgm.infer(graph, evidence, schedule=pgm.Smoothing())


OFFLINE = {
    "filter": lambda m, e: pgm.filter(m, e, compiled=False),
    "compiled filter": lambda m, e: pgm.filter(m, e, compiled=True),
    "smoother": lambda m, e: pgm.smooth(m, e, compiled=False),
    "compiled smoother": lambda m, e: pgm.smooth(m, e, compiled=True),
    "whole lag": lambda m, e: pgm.smooth(m, e, lag=STEPS),
    "kept": lambda m, e: pgm.smooth(m, e, keep=[x]),
    "balanced": balanced,
}
ONLINE = {
    "online": {},
    "compiled online": {"compiled": True},
    "windows": {"schedule": pgm.FixedLag(2, iterations=2)},
}


def asked(way, model, values):
    """Means, digits, and the warnings that came."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", pgm.ConvergenceWarning)
        if way in ONLINE:
            means, digits = online(model, values, **ONLINE[way])
        else:
            found = OFFLINE[way](model, {z: values})
            means, digits = found[x].mean[..., 0], found.status.digits
    assert all(each.category is pgm.PrecisionWarning for each in said)
    return means, digits, said


@crossed(
    ("way", "std", "linear"),
    [*OFFLINE, *ONLINE],
    [1e-4, 8e-5, 1e-6, 1e-7],
    {"linear": True, "nonlinear": False},
)
def test_digits_are_no_more_than_a_mean_has(way, std, linear):
    """Against Kalman's and Rauch's formulas in fractions; the warning names what is small."""
    if way == "balanced" and not linear:
        pytest.skip("what is nonlinear a balanced tree linearises elsewhere")
    values = readings(FAR, std)
    means, digits, said = asked(way, network(FAR, std, linear=linear), values)
    filtered, smoothed = textbook(FAR, std, values)
    behind = way in ONLINE or "filter" in way
    error = largest(means, filtered if behind else smoothed)
    assert digits is not None
    assert digits <= -math.log10(error)
    assert digits >= -math.log10(error) - 2.0
    assert said
    assert "too small beside its mean" in str(said[0].message)
    assert len(said) == 1 or way in ONLINE


@pytest.mark.parametrize("std", [1e-3, 1e-2, 1.0])
@pytest.mark.parametrize("way", [*OFFLINE, *ONLINE])
def test_map_coordinates_are_ordinary(way, std):
    """At 5000 km half a last place is 0.5 nm: to a millimetre's deviation six digits are left."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 5e6, std**2)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=std**2)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=std**2)],
    )
    values = 5e6 + std * np.random.default_rng(1).normal(size=(STEPS, 1))
    _, digits, said = asked(way, model, values)
    assert not said
    assert digits is None or digits > 6.0


@pytest.mark.parametrize("way", [*OFFLINE, *ONLINE])
def test_the_limit_is_half_a_last_place(way):
    """A state that is known to σ at the least is told if ½ u(m) is more than 10⁻⁶ σ."""
    half = 0.5 * np.spacing(5e6)
    for times, told in ((0.6, True), (3.0, False)):
        std = times * 1e6 * half
        model = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(x, 5e6, std**2)],
            [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=std**2)],
            [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1e4 * std**2)],
        )
        _, digits, said = asked(way, model, np.full((STEPS, 1), 5e6))
        assert bool(said) == told
        assert (digits is not None and digits < 6.0) == told


@pytest.mark.parametrize("way", ["filter", "compiled filter", "smoother", "online", "windows"])
def test_what_is_certain_has_no_last_place(way):
    """A place known exactly, at 10¹² m, beside an ordinary number."""
    known = pgm.Variable("known")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.3, 1.0), pgm.GaussianCPD(known, 1e12, 0.0)],
        [
            pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1),
            pgm.LinearGaussianCPD(known, {known.previous: 1.0}, cov=0.0),
        ],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1)],
    )
    _, digits, said = asked(way, model, readings(0.3, 1.0))
    assert not said
    assert digits is None or digits > 6.0


@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
@pytest.mark.parametrize("options", [{}, {"keep": [x]}, {"compiled": True}], ids=str)
def test_each_run_has_its_own(call, options):
    """Of twelve runs the third alone is far from zero."""
    far = np.zeros((12, 1))
    far[2] = FAR
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, far, 1e-12)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1e-12)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1e-12)],
    )
    values = far[:, None] + readings(0.0, 1e-6)
    with pytest.warns(pgm.PrecisionWarning, match="status.digits says in which runs") as said:
        digits = call(model, {z: values}, **options).status.digits
    assert len(said) == 1
    assert digits.shape == (12,)
    assert digits[2] < 5.0
    assert (np.delete(digits, 2) > 8.0).all()


def test_a_loop_is_warned_once():
    """Python's filter knows a warning by its text, which therefore does not say how many digits."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("default")
        few = [
            float(pgm.filter(network(FAR, std), {}, steps=3).status.digits)
            for std in (1e-6, 1e-7, 1e-8)
        ]
    assert few == sorted(few, reverse=True)
    assert few[0] - few[-1] > 1.0
    assert [each.category for each in told] == [pgm.PrecisionWarning]


def test_a_motion_that_forgets_keeps_digits():
    """Roundings of a thousand steps add up to little where each step keeps a half, unread."""
    with pytest.warns(pgm.PrecisionWarning):
        few, many = (
            pgm.filter(network(FAR, 1e-6, carried=0.5), {}, steps=n).status.digits
            for n in (10, 1000)
        )
    assert 0.0 <= few - many < 0.1


def test_a_filter_that_keeps_its_digits_is_swept_once(monkeypatch):
    """Precise at the origin, and far away where it is vague: no step has a coarse last place."""
    u, runs = pgm.Variable("u"), 9
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1e-12)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0, u: 1.0}, cov=1.0)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1.0)],
    )
    far = 1e6 * np.arange(1.0, STEPS + 1)
    evidence = {u: np.full((STEPS, 1), 1e6), z: np.tile(far[:, None], (runs, 1, 1))}
    monkeypatch.setattr(Filtered, "whole", property(lambda _: pytest.fail("swept again")))
    assert pgm.filter(model, evidence, compiled=False).status.digits is None


# ---- networks without time


def tree(far, std):
    cpds = [
        pgm.GaussianCPD(x, far, std**2),
        pgm.LinearGaussianCPD(y, {x: 1.0}, cov=(0.3 * std) ** 2),
        pgm.LinearGaussianCPD(z, {y: 1.0}, cov=(0.2 * std) ** 2),
    ]
    return pgm.BayesianNetwork(cpds)


@pytest.mark.parametrize("schedule", [None, pgm.Flooding()], ids=["tree", "any graph"])
@pytest.mark.parametrize("std", [1e-5, 1e-7])
def test_a_network_without_time_tells_too(std, schedule):
    """Against conditioning in fractions."""
    value = FAR + 0.7 * std
    method = pgm.JunctionTree() if schedule is None else pgm.Bethe()
    graph = pgm.compile(tree(FAR, std), method=method)
    words = "too small beside its mean" if schedule is None else "status.digits"
    with pytest.warns(pgm.PrecisionWarning, match=words) as said:
        found = pgm.infer(graph, {z: [value]}, schedule=schedule)
    prior, moved = fraction(std**2), fraction((0.3 * std) ** 2)
    total = prior + moved + fraction((0.2 * std) ** 2)
    gap, error = fraction(value) - fraction(FAR), 0.0
    for v, variance in ((x, prior), (y, prior + moved)):
        gain = prior / total if v is x else (prior + moved) / total
        exact, left = fraction(FAR) + gain * gap, variance * (1 - gain)
        error = max(error, largest(found[v].mean, [(exact, left)]))
    assert len(said) == 1
    assert found.status.digits <= -math.log10(error)
    assert found.status.digits >= -math.log10(error) - 2.0


@pytest.mark.parametrize("std", [1e-3, 1.0])
def test_map_coordinates_of_a_network_without_time_are_ordinary(std):
    found = pgm.infer(pgm.compile(tree(5e6, 10.0 * std)), {z: [5e6 + std]})
    assert found.status.digits is None or found.status.digits > 6.0
