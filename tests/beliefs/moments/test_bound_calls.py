"""Calls that were bound equal those that go the general way, and see all that these see."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec

import numpy as np
import pytest

import pgm
from pgm.beliefs.moments.bound.bound import Bound
from pgm.beliefs.moments.digits import certificate, last_places
from pgm.beliefs.moments.steps import sensor

pytestmark = pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed")

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
u, m = (pgm.Variable(name, components=("first", "second")) for name in "um")
b, w = pgm.variables("b w")
STEPS, OFTEN = 12, 7
CALLS = {"filter": pgm.filter, "smooth": pgm.smooth}
dt = [0.5]


def drive(x, u):
    heading = x[..., 2] + 0.5 * dt[0] * u[..., 1]
    way = dt[0] * u[..., 0]
    change = [way * np.cos(heading), way * np.sin(heading), dt[0] * u[..., 1]]
    return x + np.stack(change, axis=-1)


def sight(x, m):
    away = m - x[..., :2]
    bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
    return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)


def robot(**own):
    """A robot whose sensors have options of their own, such as a robust noise."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0, 0, 0], np.square([0.1, 0.1, 0.05]))],
        [pgm.NonlinearGaussianCPD(x, (x.previous, u), drive, np.square([0.05, 0.05, 0.03]))],
        [
            pgm.NonlinearGaussianCPD(z, (x, m), sight, np.square([0.2, 0.05]), **own),
            pgm.LinearGaussianCPD(w, {x: [[1.0, 0.0, 0.0]], b: 1.0}, cov=0.1, **own),
        ],
    )


def evidence(seed, missing=0.0, runs=None):
    """Sightings of landmarks at some steps, two at one, and readings with a known offset."""
    rng, lead = np.random.default_rng(seed), () if runs is None else (runs,)
    step = np.array([0, 3, 3, 5, 9, 12])
    marks = np.resize([[7.0, 1.0], [-6.0, 8.0], [4.0, 12.0]], (len(step), 2))
    seen = np.stack([rng.uniform(*of, (*lead, len(step))) for of in ((5, 12), (-4, 4))], axis=-1)
    seen[rng.random(seen.shape) < missing] = np.nan
    return {
        u: [1.0, 0.2] + 0.1 * rng.normal(size=(*lead, STEPS, 2)),
        z: pgm.sightings(seen, step=step, given={m: marks}),
        w: rng.normal(size=(*lead, STEPS, 1)),
        b: rng.normal(size=(*lead, STEPS, 1)),
    }


@pytest.fixture(scope="module")
def bound():
    """A robot of which calls were bound."""
    model = robot()
    for seed in range(OFTEN):
        for call in CALLS.values():
            call(model, evidence(seed), compiled=True)
            call(model, evidence(seed, 0.3), compiled=True)
    assert is_bound(model)
    return model


def is_bound(model):
    """Whether all that was called often is bound."""
    found = [each for blank in model.layouts[True].plans for each in blank.bound.values()]
    return bool(found) and all(isinstance(each, Bound) for each in found)


@pytest.mark.parametrize("missing", [0.0, 0.3])
@pytest.mark.parametrize("name", CALLS)
def test_a_bound_call_equals_one_that_goes_the_general_way(name, missing, bound):
    call, given = CALLS[name], evidence(99, missing)
    found, due = call(bound, given, compiled=True), call(robot(), given, compiled=True)
    for one, other in [
        (found, due),
        (found.filtered, due.filtered),
        (found.predicted, due.predicted),
    ]:
        np.testing.assert_array_equal(one[x].mean, other[x].mean)
        np.testing.assert_array_equal(one[x].cov, other[x].cov)
    np.testing.assert_array_equal(found.log_evidence, due.log_evidence)
    pair = x.at(2), x.at(3)
    np.testing.assert_array_equal(found.joint(*pair).cov, due.joint(*pair).cov)
    assert repr(found.status) == repr(due.status)
    assert found.status.compilation == due.status.compilation == "compiled"


@pytest.mark.parametrize("name", CALLS)
def test_a_bound_posterior_goes_to_another_process(name, bound):
    """With what nobody has asked for yet."""
    found = CALLS[name](bound, evidence(97), compiled=True)
    sent = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(sent[x].mean, found[x].mean)
    np.testing.assert_array_equal(sent.predicted[x].cov, found.predicted[x].cov)
    np.testing.assert_array_equal(sent.log_evidence, found.log_evidence)
    pair = x.at(2), x.at(3)
    np.testing.assert_array_equal(sent.joint(*pair).cov, found.joint(*pair).cov)
    assert repr(sent) == repr(found)


def test_readings_that_the_sweep_moves_to_other_branches_are_told_as_they_were(bound):
    given = evidence(96)
    turned = np.add(given[z].values, [0.0, 2.0 * np.pi])
    other = {**given, z: pgm.sightings(turned, step=given[z].step, given=given[z].given)}
    one, another = (pgm.smooth(bound, each, compiled=True) for each in (given, other))
    np.testing.assert_allclose(one[x].mean, another[x].mean, rtol=0, atol=1e-10)
    due = pgm.smooth(robot(), given, compiled=True).innovations[z]
    np.testing.assert_array_equal(one.innovations[z].residual, due.residual)


def test_a_bound_call_of_numpy_alone(bound):
    found = pgm.smooth(bound, evidence(98), compiled=True)
    due = pgm.smooth(robot(), evidence(98), compiled=False)
    np.testing.assert_allclose(found[x].mean, due[x].mean, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found[x].cov, due[x].cov, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", CALLS)
def test_readings_are_those_of_the_call_wherever_they_lie(name, monkeypatch):
    """Readings with missing ones are a new array each time; kept, no other takes its place."""
    model, call, kept = robot(), CALLS[name], []
    marked = sensor._marked

    def keeping(*given):
        kept.append(marked(*given))
        return kept[-1]

    monkeypatch.setattr(sensor, "_marked", keeping)
    for seed in range(OFTEN):
        call(model, evidence(seed, 0.3), compiled=True)
    assert is_bound(model)
    given = evidence(99, 0.3)
    found, due = call(model, given, compiled=True), call(robot(), given, compiled=True)
    np.testing.assert_array_equal(found[x].mean, due[x].mean)
    np.testing.assert_array_equal(found.log_evidence, due.log_evidence)


def test_posteriors_of_bound_calls_share_nothing(bound):
    first = pgm.smooth(bound, evidence(1), compiled=True)
    kept = first[x].mean.copy(), first[x].cov.copy(), first.filtered[x].mean.copy()
    pgm.smooth(bound, evidence(2), compiled=True)
    for one, other in zip(kept, (first[x].mean, first[x].cov, first.filtered[x].mean), strict=True):
        np.testing.assert_array_equal(one, other)


def test_threads_call_at_once(bound):
    due = [pgm.smooth(bound, evidence(seed), compiled=True)[x].mean for seed in range(8)]
    with ThreadPoolExecutor(4) as pool:
        run = pgm.prepare(pgm.compile(bound, STEPS, compiled=True), evidence(0))
        found = list(pool.map(lambda seed: run(evidence(seed % 8))[x].mean, range(64)))
    for k, each in enumerate(found):
        np.testing.assert_array_equal(each, due[k % 8])


@pytest.mark.parametrize("name", CALLS)
def test_a_bound_call_sees_that_a_function_has_changed(name):
    model, call = robot(), CALLS[name]
    try:
        for seed in range(OFTEN):
            call(model, evidence(seed), compiled=True)
        assert is_bound(model)
        dt[0] = 0.25
        found = call(model, evidence(3), compiled=True)
        due = call(robot(), evidence(3), compiled=False)
        np.testing.assert_allclose(found[x].mean, due[x].mean, rtol=0, atol=1e-10)
        # And binds anew what it was traced to.
        for seed in range(OFTEN):
            call(model, evidence(seed), compiled=True)
        assert is_bound(model)
        again = call(model, evidence(3), compiled=True)
        np.testing.assert_allclose(again[x].mean, due[x].mean, rtol=0, atol=1e-10)
    finally:
        dt[0] = 0.5


@pytest.mark.filterwarnings("ignore::pgm.PrecisionWarning")
@pytest.mark.parametrize(("size", "wide"), [(None, 1.0), (7, 0.4)])
def test_what_a_sweep_back_takes_for_kept_is_so(size, wide):
    """Drawn chains, from harmless ones to such as float64 cannot tell apart; seven are in loops."""
    told = [is_rightly_kept(seed, size, wide) for seed in range(40)]
    assert told.count(True) > 10
    assert told.count(None) > 10
    assert False not in told


def is_rightly_kept(seed, own, spread):
    """Whether what a sweep back takes for kept is so by NumPy; None where it does not."""
    rng = np.random.default_rng(seed)
    size, steps = int(rng.integers(1, 4)), int(rng.integers(1, 8))
    size = own or size
    s, y = pgm.Variable("s", components=tuple("abcdefg"[:size])), pgm.Variable("y")
    scale, wide = 10.0 ** (spread * rng.uniform(-4, 4, size)), spread * rng.uniform(-5, 0)
    mean = 10.0 ** (spread * rng.uniform(0, 7)) * rng.normal(size=size)
    prior = pgm.GaussianCPD(s, mean, scale**2)
    matrix = np.eye(size) + 0.3 * rng.normal(size=(size, size))
    noise = np.square(scale * 10.0 ** rng.uniform(wide, 0, size))
    motion = pgm.LinearGaussianCPD(s, {s.previous: matrix}, cov=noise)
    sensor = pgm.LinearGaussianCPD(y, {s: rng.normal(size=(1, size))}, 10.0 ** rng.uniform(-8, 2))
    model = pgm.DynamicBayesianNetwork([prior], [motion], [sensor])
    found = pgm.smooth(model, {y: rng.normal(size=(steps, 1))}, compiled=True)._outcome
    plan, swept, smoothed = found._planned, found._swept, found._smoothed
    if not smoothed.kept:
        return None
    lost = last_places.error(plan, swept, smoothed, careful=False, measured=False)
    finite = all(np.isfinite(each).all() for each in (smoothed.mean, smoothed.cov, swept.cov))
    return (
        finite and certificate.suffices(plan, swept, smoothed.cov) and (lost is None or swept.far)
    )
