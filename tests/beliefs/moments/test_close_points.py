"""Sigma points that lie close together, at coordinates of millions of metres: told in digits."""

import re
import warnings

import numpy as np
import pytest
from crossed import crossed

import pgm
from pgm.linearisers import Points

x, z = pgm.Variable("x", ("east", "north")), pgm.Variable("z", ("first", "second"))
FAR, STEPS = np.array([5e6, 4e5]), 20


class Differences(pgm.StatisticalRegression):
    """Central differences over a thousandth of a deviation: the mean is the value at the centre."""

    def points(self, dimension, name, step):
        arm = 1e-3 * np.eye(dimension)
        mean = np.append(1.0, np.zeros(2 * dimension))
        weights = np.append(0.0, np.full(2 * dimension, 0.5e6))
        return Points(np.vstack([0.0 * arm[:1], arm, -arm]), mean, weights, True)


def ranges(place, to):
    away = place - to
    first = np.hypot(away[..., 0] + 20.0, away[..., 1])
    return np.stack([first, np.hypot(away[..., 0], away[..., 1] - 30.0)], -1)


def robot(start):
    """A walk that is drawn out from a place, and ranges to two beacons beside it."""

    def drift(place):
        return place + 0.1 * np.tanh(place - start)

    def measure(place):
        return ranges(place, start)

    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, start, 1.0)],
        [pgm.NonlinearGaussianCPD(x, (x.previous,), drift, cov=0.01)],
        [pgm.NonlinearGaussianCPD(z, (x,), measure, cov=0.01)],
    )


@pytest.fixture(scope="module")
def seen():
    return robot(0.0 * FAR).sample(steps=STEPS, rng=0).evidence[z]


def online(model, values, **options):
    loop = pgm.OnlineFilter(model, **options)
    belief = loop.initial()
    for row in np.moveaxis(values, -2, 0):
        belief = loop.update(loop.predict(belief), {z: row})
    return belief


WAYS = {
    "filter": lambda m, v, rule: pgm.filter(m, {z: v}, lineariser=rule, compiled=False),
    "compiled": lambda m, v, rule: pgm.filter(m, {z: v}, lineariser=rule, compiled=True),
    "smoother": lambda m, v, rule: pgm.smooth(m, {z: v}, lineariser=rule, iterations=2),
    "fixed lag": lambda m, v, rule: pgm.smooth(m, {z: v}, lineariser=rule, lag=3),
    "online": lambda m, v, rule: online(m, v, lineariser=rule),
    "compiled online": lambda m, v, rule: online(m, v, lineariser=rule, compiled=True),
    "online windows": lambda m, v, rule: online(
        m, v, lineariser=rule, schedule=pgm.FixedLag(3, iterations=2)
    ),
}


def asked(way, start, values, rule):
    """The posterior, and the warnings that came with it."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", pgm.ConvergenceWarning)  # two iterations are meant
        found = WAYS[way](robot(start), values, rule)
    assert all(each.category is pgm.PrecisionWarning for each in said)
    return found, said


@pytest.mark.parametrize(
    ("way", "runs"), [(way, None) for way in WAYS] + [(way, 9) for way in list(WAYS)[:-1]]
)
def test_far_coordinates_are_told(seen, way, runs):
    """The digits that are told are no more than those that are left."""
    rule = pgm.Unscented(alpha=1e-3)
    values = seen if runs is None else np.stack([seen] * runs)
    due, quiet = asked(way, 0.0 * FAR, values, rule)
    assert not quiet
    found, said = asked(way, FAR, values, rule)
    off = np.abs(found[x].mean - FAR - due[x].mean) / due[x].std
    assert off.max() > 1e-5
    assert said
    assert "sigma points" in str(said[0].message)
    assert np.shape(found.status.digits) == (() if runs is None else (runs,))
    left = -np.log10(off.max())
    assert (found.status.digits < left).all()
    assert (found.status.digits > left - 3.0).all()


@pytest.mark.parametrize("compiled", [False, True])
def test_digits_that_a_motion_lost_a_linear_sensor_does_not_forget(compiled):
    rule, place, read = pgm.Unscented(alpha=1e-3), pgm.Variable("place"), pgm.Variable("read")

    def driven(start):
        motion = lambda a: start + 0.9 * np.sin(a - start)  # noqa: E731
        robot = pgm.OnlineFilter(
            pgm.DynamicBayesianNetwork(
                [pgm.GaussianCPD(place, start, 1.0)],
                [pgm.NonlinearGaussianCPD(place, place.previous, motion, cov=0.01)],
                [pgm.LinearGaussianCPD(read, {place: 1.0}, cov=25.0)],
            ),
            rule,
            compiled=compiled,
        )
        belief = robot.initial()
        for reading in (3.0, -5.0, 4.0, 1.0):
            belief = robot.predict(belief)
            yield belief
            belief = robot.update(belief, {read: [start + reading]})
            yield belief

    with pytest.warns(pgm.PrecisionWarning, match="sigma points"):
        far = list(driven(1e6))
    for found, due in zip(far, driven(0.0), strict=True):
        off = np.abs(found[place].mean - 1e6 - due[place].mean) / due[place].std
        assert 10.0**-found.status.digits > off.max()
        assert found.status.digits < 5.0


@crossed(
    ("rule", "way"),
    [pgm.Unscented(), pgm.Cubature(), pgm.Taylor()],
    ["filter", "compiled", "online"],
)
def test_rules_of_wide_points_are_right(seen, way, rule):
    due, _ = asked(way, 0.0 * FAR, seen, rule)
    found, said = asked(way, FAR, seen, rule)
    assert (np.abs(found[x].mean - FAR - due[x].mean) <= 1e-6 * due[x].std).all()
    assert not said
    assert found.status.digits is None


def test_coordinates_nearby_need_no_word(seen):
    """Of some metres, the small alpha of many textbooks leaves seven digits."""
    found, said = asked("filter", np.zeros(2), seen, pgm.Unscented(alpha=1e-3))
    assert not said
    assert 6.0 < found.status.digits < 9.0


def test_a_rule_of_ones_own_is_told(seen):
    """Whose weights of the mean are harmless, and whose slopes are differences."""
    due, _ = asked("filter", 0.0 * FAR, seen, Differences())
    found, said = asked("filter", FAR, seen, Differences())
    off = np.abs(found[x].cov - due[x].cov).max() / due[x].cov.max()
    assert off > 1e-9
    assert said
    assert found.status.digits < -np.log10(off)


def test_readings_without_a_value_move_nothing(seen):
    """Digits are lost by measurements that were taken, not by those that are missing."""
    known = pgm.DynamicBayesianNetwork(
        robot(0.0 * FAR).prior,
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.01)],
        [pgm.NonlinearGaussianCPD(z, (x,), lambda place: 1e7 + place, cov=0.01)],
    )
    values = np.full((STEPS, 2), np.nan)
    rule = pgm.Unscented(alpha=1e-3)
    assert pgm.filter(known, {z: values}, lineariser=rule).status.digits is None
    values[3] = 1e7
    with pytest.warns(pgm.PrecisionWarning, match="sigma points"):
        assert pgm.filter(known, {z: values}, lineariser=rule).status.digits < 4.0


def test_forgotten_with_time():
    """What one step has lost, later ones that know better do not keep for ever."""
    rule = pgm.Unscented(alpha=1e-2)
    few, many = (
        pgm.filter(robot(1e-3 * FAR), {z: np.ones((n, 2))}, lineariser=rule).status.digits
        for n in (10, 1000)
    )
    assert few - many < 0.3


# ---- networks without time


def static(start):
    later = pgm.Variable("later", ("east", "north"))
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, start, 1.0),
            pgm.NonlinearGaussianCPD(
                later, (x,), lambda place: place + 0.1 * np.tanh(place - start), cov=0.01
            ),
            pgm.NonlinearGaussianCPD(z, (later,), lambda place: ranges(place, start), cov=0.01),
        ]
    )
    return pgm.compile(network), later


@pytest.mark.parametrize(
    "rule", [pgm.Unscented(alpha=1e-3), pgm.Unscented(), pgm.Taylor()], ids=repr
)
def test_a_junction_tree_is_right_or_told(rule):
    values = {z: [20.5, 30.2]}
    tree, later = static(0.0 * FAR)
    due = pgm.infer(tree, values, lineariser=rule)
    tree, later = static(FAR)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        found = pgm.infer(tree, values, lineariser=rule)
    off = np.abs(found[later].mean - FAR - due[later].mean) / due[later].std
    assert bool(said) == (rule == pgm.Unscented(alpha=1e-3))
    if said:
        assert re.search("sigma points", str(said[0].message))
        assert 10.0**-found.status.digits > off.max()
    else:
        assert off.max() < 1e-6


# ---- readings without noise


def scales(seed, size=1.0, alpha=1e-4):
    """Two weights that move, three scales without noise that read them, and their true readings."""
    rng = np.random.default_rng(seed)
    pair, read = pgm.Variable("pair", ("a", "b")), pgm.Variable("read", ("p", "q", "r"))
    see, moved = rng.normal(size=(3, 2)), rng.normal(size=(2, 2)) / np.sqrt(2.0)
    start = size * rng.normal(size=2)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(pair, start, size**2)],
        [pgm.NonlinearGaussianCPD(pair, (pair.previous,), lambda w: w @ moved.T, cov=0.0)],
        [pgm.NonlinearGaussianCPD(read, (pair,), lambda w: w @ see.T, cov=0.0)],
    )
    truth = [start + size * rng.normal(size=2)]
    for _ in range(3):
        truth.append(moved @ truth[-1])
    return model, pair, read, np.array(truth), np.array(truth[1:]) @ see.T, pgm.Unscented(alpha)


@pytest.mark.filterwarnings("ignore::pgm.PrecisionWarning")
@crossed(("size", "compiled"), [1.0, 1e5], [False, True])
@pytest.mark.parametrize(("alpha", "least"), [(1e-4, 0), (1e-3, 6), (1.0, 8)])
def test_consistent_readings_are_no_contradiction(alpha, least, size, compiled):
    """What is left of them is the rounding of a regression, which other rules do not have."""
    answered = 0
    for seed in range(8):
        model, pair, read, truth, values, rule = scales(seed, size, alpha)
        for own in (rule, pgm.Taylor(), pgm.Cubature()):
            try:
                found = pgm.filter(model, {read: values}, lineariser=own, compiled=compiled)
            except pgm.NumericalError as error:
                assert own is rule
                assert "rounds by as much" in str(error)  # noqa: PT017
                continue
            answered += own is rule
            far = np.abs(found[pair].mean[1:] - truth[1:])
            unsure = found[pair].std[1:] if own is rule and alpha == 1e-4 else 0.0
            assert (far <= 1e-5 * size + unsure).all()
    assert answered >= least


@pytest.mark.parametrize("alpha", [1e-4, 1e-3, 1.0])
def test_a_contradiction_is_refused_and_names_the_rule(alpha):
    """A scale that is off by a thousandth of the weights."""
    model, _, read, _, values, rule = scales(1, 1.0, alpha)
    values[0, 2] += 1e-3
    with pytest.raises(pgm.NumericalError, match=r"contradicts an exact model, as Unscented\("):
        pgm.filter(model, {read: values}, lineariser=rule)


def test_what_rounding_may_hide_is_refused_as_that():
    model, _, read, _, values, rule = scales(1, 1.0, 1e-3)
    values[2, 2] += 1e-7
    with pytest.raises(pgm.NumericalError, match=r"may contradict .* use a larger alpha"):
        pgm.filter(model, {read: values}, lineariser=rule)
