"""Readings that lack components, against dense conditioning on those that are there."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from crossed import crossed
from dense import unrolled
from textbooks import assert_covs, assert_log, assert_means

import pgm

x = pgm.Variable("x", components=("place", "speed"))
w = pgm.Variable("w", components=("gain",))  # a sensor's input
z = pgm.Variable("z", components=("a", "b", "c"))
extra = pgm.Variable("extra")

T, RUNS = 6, 3
ROLL, COV = np.array([[1.0, 0.5], [-0.1, 0.9]]), np.array([[0.2, 0.05], [0.05, 0.1]])
SEE = np.array([[1.0, 0.0], [0.4, 1.0], [-0.7, 0.3]])
NOISE = np.array([[0.4, 0.3, -0.1], [0.3, 0.5, 0.1], [-0.1, 0.1, 0.3]])  # correlated
ROOT = np.array([[0.5, 0.3], [0.3, -0.4], [-0.4, 0.2]])
SEVERAL = np.array([3, 0, 2, 3, 5, 5, 6, 2, 5])  # in no order, several at a step
ONCE = np.array([3, 0, 2, 6, 1, 5])  # where more would be certain twice over


def function(a):
    """The linear sensor as a function."""
    return a @ SEE.T


def noise(a):
    """Noise that differs from sighting to sighting."""
    return NOISE * (1.0 + a[..., None] ** 2)


def linear(cov):
    return pgm.LinearGaussianCPD(z, {x: SEE}, cov=cov)


SENSORS = {
    "correlated": linear(NOISE),
    "rank 2": linear(ROOT @ ROOT.T),
    "partly exact": linear(np.diag([0.0, 0.2, 0.1])),
    "noise of inputs": pgm.LinearGaussianCPD(
        z, {x: SEE, w: np.zeros((3, 1))}, cov=pgm.noise(noise, w)
    ),
    "a function": pgm.NonlinearGaussianCPD(z, x, function, NOISE),
    "grouped": pgm.NonlinearGaussianCPD(z, x, function, NOISE, grouped=True),
}


def steps_of(sensor):
    """The steps of its readings."""
    return ONCE if sensor in (SENSORS["rank 2"], SENSORS["partly exact"]) else SEVERAL


def network(sensor):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.3, -0.2], [[1.0, 0.4], [0.4, 0.7]])],
        [pgm.LinearGaussianCPD(x, {x.previous: ROLL}, offset=[0.1, 0.0], cov=COV)],
        [sensor, pgm.LinearGaussianCPD(extra, {x: [[0.0, 1.0]]}, cov=0.3)],
    )


def draw(sensor, runs):
    """Values of z in which components, readings and all readings of a step are missing."""
    rng = np.random.default_rng(7)
    gains = rng.normal(size=(steps_of(sensor).size, 1))
    given = {w: gains} if w in sensor.parents else {}
    steps = {
        z: pgm.sightings(step=steps_of(sensor), given=given),
        extra: pgm.sightings(step=[1, 4]),
    }
    drawn = network(sensor).sample(steps, steps=T, runs=runs, rng=rng)
    values = np.array(drawn[z])
    values[rng.random(values.shape) < 0.4] = np.nan
    values[..., 4, :] = np.nan
    values[0, steps_of(sensor) == 2] = np.nan  # all of a step, in the first run
    values[-1, :4] = drawn[z][-1, :4]
    return values, drawn[extra], gains


def evidence(sensor, values, others, gains, until=T):
    step = steps_of(sensor)
    rows, early = until >= step, np.array([1, 4]) <= until
    given = {w: gains[rows]} if w in sensor.parents else {}
    return {
        z: pgm.sightings(values[..., rows, :], step=step[rows], given=given),
        extra: pgm.sightings(others[..., early, :], step=np.array([1, 4])[early]),
    }


def dense(sensor, values, others, gains, until=T):
    """The joint of one run given its readings up to a step, and their log-density."""
    twin = pgm.LinearGaussianCPD(z, {x: SEE}, cov=NOISE) if hasattr(sensor, "function") else sensor
    steps = steps_of(sensor)
    sightings = [(z, int(step), {}) for step in steps] + [(extra, step, {}) for step in (1, 4)]
    if w in sensor.parents:
        twin = linear(NOISE)
    model = network(twin)
    joint = unrolled(model, T, sightings=sightings)
    if w in sensor.parents:
        for k, gain in enumerate(gains):
            own = joint.index((z, k))
            joint.cov[np.ix_(own, own)] += NOISE * gain**2
    known = {(z, k): value for k, value in enumerate(values) if steps[k] <= until}
    later = {(extra, steps.size + k): other for k, other in enumerate(others) if (1, 4)[k] <= until}
    return joint.given(known | later)


def check(mean, cov, joint, step):
    """A belief against the dense one, whose variances of 1e-15 are rounding of zero."""
    due, spread = joint.marginal(x.at(step))
    open_ = np.diag(spread) > 1e-12
    spread = np.where(open_ & open_[:, None], spread, 0.0)
    assert_means(mean, due, spread, 1e-8)
    assert_covs(cov, spread, 1e-8)


SMOOTHERS = {
    "smooth": lambda model, seen: pgm.smooth(model, seen, steps=T),
    "balanced": lambda model, seen: pgm.infer(
        pgm.compile(model, T, method=pgm.Balanced()), seen, schedule=pgm.Smoothing()
    ),
    "iterated": lambda model, seen: pgm.smooth(model, seen, steps=T, iterations=3),
    "held": lambda model, seen: pgm.smooth(
        model, seen, steps=T, iterations=3, damping=pgm.LevenbergMarquardt()
    ),
    "unscented": lambda model, seen: pgm.smooth(model, seen, steps=T, lineariser=pgm.Unscented()),
    "newton": lambda model, seen: pgm.infer(
        pgm.compile(model, T, method=pgm.Balanced()), seen, schedule=pgm.Smoothing(iterations=3)
    ),
    "in parts": lambda model, seen: pgm.smooth(
        model, seen, steps=T, keep=[x], executor=ThreadPoolExecutor(2)
    ),
}


@pytest.mark.parametrize("method", SMOOTHERS)
@pytest.mark.parametrize("name", SENSORS)
def test_smoothed(name, method):
    sensor = SENSORS[name]
    values, others, gains = draw(sensor, RUNS)
    found = SMOOTHERS[method](network(sensor), evidence(sensor, values, others, gains))
    for run in range(RUNS):
        joint, log_density = dense(sensor, values[run], others[run], gains)
        assert_log(found.log_evidence[run], log_density)
        for step in range(T + 1):
            belief = found[x.at(step)]
            check(belief.mean[run], belief.cov[run], joint, step)


FILTERS = {
    "filter": {},
    "unscented": {"lineariser": pgm.Unscented()},
    "iterated": {"iterations": 3},
    "held": {"iterations": 3, "damping": pgm.LevenbergMarquardt()},
}


@crossed(("name", "method", "runs"), list(SENSORS), list(FILTERS), [RUNS, 40])
def test_filtered_together_alone_and_online(name, method, runs):
    sensor, options = SENSORS[name], dict(FILTERS[method])
    model = network(sensor)
    values, others, gains = draw(sensor, runs)
    due = [
        [dense(sensor, values[run], others[run], gains, step) for step in range(T + 1)]
        for run in range(RUNS)
    ]

    def compare(belief, step, run=None):
        mean, cov = (
            (belief.mean, belief.cov) if run is None else (belief.mean[run], belief.cov[run])
        )
        check(mean, cov, due[run or 0][step][0], step)

    together = pgm.filter(model, evidence(sensor, values, others, gains), steps=T, **options)
    alone = pgm.filter(model, evidence(sensor, values[0], others[0], gains), steps=T, **options)
    rule = options.pop("lineariser", pgm.Taylor())
    robot = pgm.OnlineFilter(model, rule, pgm.Filtering(**options))
    every = online(robot, sensor, values, others, gains)
    single = online(robot, sensor, values[0], others[0], gains)
    for step in range(T + 1):
        compare(alone[x.at(step)], step)
        compare(single[step][x], step)
        for run in range(RUNS):
            compare(together[x.at(step)], step, run)
            compare(every[step][x], step, run)
    for found in (together, every[-1]):
        assert_log(found.log_evidence[:RUNS], [steps[-1][1] for steps in due])
    for found in (alone, single[-1]):
        assert_log(found.log_evidence, due[0][-1][1])


def online(robot, sensor, values, others, gains):
    """The beliefs after each step."""
    beliefs = [robot.initial()]
    for step in range(T + 1):
        belief = robot.predict(beliefs[-1]) if step else beliefs.pop()
        rows = step == steps_of(sensor)
        given = {w: gains[rows]} if w in sensor.parents else {}
        seen = {z: pgm.sightings(values[..., rows, :], given=given)}
        if step in (1, 4):
            seen[extra] = others[..., (1, 4).index(step), :]
        beliefs.append(robot.update(belief, seen))
    return beliefs


@pytest.mark.parametrize("name", SENSORS)
def test_innovations_are_of_the_components_read(name):
    """Step by step: NaN in the residual where missing, a NIS of the others' joint."""
    sensor = SENSORS[name]
    values, others, gains = draw(sensor, RUNS)
    found = pgm.filter(network(sensor), evidence(sensor, values, others, gains), steps=T)
    ours, steps = found.innovations[z], steps_of(sensor)
    read = ~np.isnan(values)
    np.testing.assert_array_equal(~np.isnan(ours.residual), read)
    np.testing.assert_array_equal(~np.isnan(ours.cov), read[..., None] & read[..., None, :])
    np.testing.assert_array_equal(
        ours.dof, np.stack([read[:, steps == k].sum(axis=(1, 2)) for k in range(T + 1)], axis=-1)
    )
    for run in range(RUNS):
        for step in range(T + 1):
            joint, _ = dense(sensor, values[run], others[run], gains, step - 1)
            rows = np.flatnonzero(step == steps)
            seen = read[run, rows].reshape(-1)
            if not seen.any():
                assert np.isnan(ours.nis[run, step])
                continue
            mean, cov = joint.marginal(*((z, int(k)) for k in rows))
            residual = (values[run, rows].reshape(-1) - mean)[seen]
            due = residual @ np.linalg.solve(cov[np.ix_(seen, seen)], residual)
            np.testing.assert_allclose(ours.nis[run, step], due, rtol=1e-7)
            first = read[run, rows[0]]
            expected = (values[run, rows[0]] - mean[:3])[first]
            np.testing.assert_allclose(ours.residual[run, rows[0]][first], expected, atol=1e-9)


@pytest.mark.parametrize("name", ["correlated", "partly exact", "noise of inputs", "a function"])
def test_every_weight_of_an_audit_is_the_evidence(name):
    sensor = SENSORS[name]
    values, others, gains = draw(sensor, RUNS)
    posterior = pgm.smooth(network(sensor), evidence(sensor, values, others, gains), steps=T)
    found = pgm.audit(posterior, samples=50, rng=0)
    assert_log(found.log_weights, posterior.log_evidence[:, None], 1e-8)
