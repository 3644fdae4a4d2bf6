"""Fixed lags where float64 has too few digits: flat priors, exact readings, singular noise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from robots import SENSORS, network, sighted
from robots import x as pose
from textbooks import assert_belief, assert_covs, assert_log, assert_means, exact_linear

import pgm
from pgm.beliefs.moments.smoothers import fixed_lag

x = pgm.Variable("x", components=("place", "speed"))
z = pgm.Variable("z")
ROLL, PLACE = np.array([[1.0, 0.5], [0.0, 1.0]]), np.array([[1.0, 0.0]])
I2, O2 = np.eye(2), np.zeros((2, 2))
PUSH = np.array([[0.25, 0.5], [0.5, 1.0]])  # rank 1


def rolling(prior=I2, cov=0.1 * I2, noise=0.25, motion=ROLL, mean=(0, 0), nonlinear=False):
    """A linear model; as a nonlinear CPD its motion is linearised again and again, to the same."""
    move = pgm.LinearGaussianCPD(x, {x.previous: motion}, cov=cov)
    if nonlinear:
        slope = np.asarray(motion)
        move = pgm.NonlinearGaussianCPD(
            x,
            (x.previous,),
            lambda x: x @ slope.T,
            cov,
            jacobian={x.previous: lambda x: np.broadcast_to(slope, (*x.shape[:-1], 2, 2))},
        )
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, mean, prior)],
        transition=[move],
        observation=[pgm.LinearGaussianCPD(z, {x: PLACE}, cov=noise)],
    )


READ = [(z, 0, [0.5], {}), (z, 2, [1.0], {}), (z, 2, [1.25], {}), (z, 3, [0.75], {})]
READ += [(z, 5, [2.0], {})]
STEPS = 6
EVIDENCE = {z: pgm.sightings([row[2] for row in READ], step=[row[1] for row in READ])}
CASES = {
    "noise of rank 1": {"cov": PUSH},
    "no process noise": {"cov": O2},
    "a known start and noise of rank 1": {"prior": O2, "cov": PUSH},
    "a start of rank 1": {"prior": PUSH, "cov": O2},
    "a static state": {"cov": O2, "motion": I2},
    "a motion that forgets": {"motion": [[0, 1.0], [0, 0]]},
    "sharp readings": {"noise": 2.0**-40},
    "a wide start": {"prior": 2.0**50 * I2},
}


def due_at(model, t, lag):
    """Moments of x[t] given the readings up to t + lag, in rational numbers, and their ln p."""
    known = [row for row in READ if row[1] <= t + lag]
    joint = exact_linear(model, STEPS, {}, known).joint
    return *joint[(x.at(t),)], joint.log_evidence


@pytest.mark.parametrize(
    ("name", "iterations"),
    [(name, 1) for name in CASES]
    + [(name, 3) for name in ("noise of rank 1", "a start of rank 1", "sharp readings")],
)
def test_singular_and_sharp_models(name, iterations):
    linear, lag = rolling(**CASES[name]), 2
    model = rolling(**CASES[name], nonlinear=iterations > 1)
    found = pgm.smooth(model, EVIDENCE, steps=STEPS, lag=lag, iterations=iterations)
    robot = pgm.OnlineFilter(model, schedule=pgm.FixedLag(lag, iterations))
    belief = robot.initial()
    for t in range(STEPS + 1):
        belief = robot.predict(belief) if t else belief
        values = [row[2] for row in READ if row[1] == t]
        belief = robot.update(belief, {z: pgm.sightings(values)} if values else {})
        mean, cov, _ = due_at(linear, t, lag)
        assert_means(found[x.at(t)].mean, mean, cov, 1e-7)
        assert_covs(found[x.at(t)].cov, cov, 1e-7)
        mean, cov, _ = due_at(linear, t, 0)
        for newest in (found.filtered[x.at(t)], belief[x]):
            assert_means(newest.mean, mean, cov, 1e-7)
            assert_covs(newest.cov, cov, 1e-7)
        if iterations > 1 and t >= lag:  # float64 alone may have to refuse it
            mean, cov, _ = due_at(linear, t - lag, lag)
            assert_means(belief.lagged[x].mean, mean, cov, 1e-7)
            assert_covs(belief.lagged[x].cov, cov, 1e-7)
    for log_evidence in (found.log_evidence, belief.log_evidence):
        assert_log(log_evidence, due_at(linear, STEPS, 0)[2], 1e-7)


@pytest.mark.parametrize("iterations", [1, 3])
@pytest.mark.parametrize("lag", [1, 3])
def test_flat_priors(lag, iterations):
    """Of a component that no reading up to the lag has determined the variance is infinite."""
    wide = rolling(prior=2.0**70 * I2)
    model = rolling(prior=np.inf, mean=(0.25, -0.5), nonlinear=iterations > 1)
    found = pgm.smooth(model, EVIDENCE, steps=STEPS, lag=lag, iterations=iterations)
    assert (found.status.digits > 12).all()
    for t in range(STEPS + 1):
        belief = found[x.at(t)]
        open_ = sum({row[1] for row in READ if row[1] <= t + lag} != {0} for _ in "1") == 0
        mean, cov, _ = due_at(wide, t, lag)
        if open_:  # one reading, of a place: nothing is known of the speed
            assert np.isinf(np.diagonal(belief.cov)).any()
            continue
        assert_means(belief.mean, mean, cov, 1e-8)
        assert_covs(belief.cov, cov, 1e-8)
    whole = pgm.smooth(model, EVIDENCE, steps=STEPS)
    assert_log(found.log_evidence, whole.log_evidence, 1e-9)


def test_windows_behind_a_flat_prior_are_in_float64():
    """Only those that begin with it take twice the digits; a robot that knows nothing at first."""
    unknown = pgm.GaussianCPD(pose, [0, 0, 0], np.diag([np.inf, np.inf, 0.05]))
    model = network(SENSORS["range_bearing"].cpd(), prior=unknown)
    options, short = {"iterations": 40, "tolerance": 1e-10}, sighted(steps=5)
    found = pgm.smooth(model, short, lag=30, **options)
    due = pgm.smooth(model, short, **options)
    assert_belief(found[pose], due[pose].mean, due[pose].cov, 1e-8)
    assert_log(found.log_evidence, due.log_evidence, 1e-8)
    found = pgm.smooth(model, sighted(runs=2), lag=2, iterations=3, tolerance=0)
    assert (found.status.digits > 12).all()
    with pytest.raises(pgm.NumericalError, match="joints of an iterated fixed lag are not kept"):
        found.joint(pose.at(3), pose.at(4))
    with pytest.raises(pgm.NumericalError, match="joints of an iterated fixed lag are not kept"):
        found.belief(4)
    assert np.isfinite(found[pose].cov[:, 5:]).all()


@pytest.mark.parametrize("damping", [0.0, pgm.LevenbergMarquardt()], ids=repr)
def test_twice_the_digits_are_the_same_where_float64_has_enough(damping, monkeypatch):
    model = network(SENSORS["range_bearing"].cpd())
    call = {"lag": 2, "iterations": 4, "tolerance": 0.0, "damping": damping}
    plain = pgm.smooth(model, sighted(runs=2, steps=6), **call)
    monkeypatch.setattr(fixed_lag.certificate, "suffices", lambda *_: False)
    monkeypatch.setattr(fixed_lag.certificate, "is_ordinary", lambda *_: False)
    careful = pgm.smooth(model, sighted(runs=2, steps=6), **call)
    assert plain.status.digits is None
    places = [
        0.5 * np.spacing(np.abs(b.mean)) / b.std for b in (careful[pose], careful.filtered[pose])
    ]
    left = -np.log10(np.max(places, axis=(0, 2, 3)))  # by the means' own last places
    assert (careful.status.digits <= left).all()
    assert (careful.status.digits > left - 1.0).all()
    for ours, theirs in (
        (plain[pose], careful[pose]),
        (plain.filtered[pose], careful.filtered[pose]),
        (plain.predicted[pose], careful.predicted[pose]),
    ):
        assert_belief(ours, theirs.mean, theirs.cov, 1e-9)
    assert_log(plain.log_evidence, careful.log_evidence, 1e-10)
    assert_allclose(plain.status.residuals, careful.status.residuals, atol=1e-9)


def test_joints_in_twice_the_digits():
    """Linearised once they are there: of a flat prior, given the readings of the latest's lag."""
    wide, model = rolling(prior=2.0**70 * I2), rolling(prior=np.inf)
    found = pgm.smooth(model, EVIDENCE, steps=STEPS, lag=2)
    known = [row for row in READ if row[1] <= 5]
    joint = exact_linear(wide, STEPS, {}, known).joint
    mean, cov = joint[(x.at(1), x.at(3))]
    belief = found.joint(x.at(1), x.at(3))
    assert_means(belief.mean, mean, cov, 1e-8)
    assert_covs(belief.cov, cov, 1e-8)


@pytest.mark.parametrize("way", ["offline", "online"])
def test_a_window_begins_in_the_digits_in_which_it_was_left(way):
    """A belief that looks ordinary in float64, whose variance later readings divide by 10¹³."""
    both = pgm.Variable("both", components=("sum", "difference"))
    see = np.array([[1.0, 1.0], [1.0, 1.0 + 2.0**-27]])
    roll, wide, noise = [[1.0, 1.0], [0.0, 1.0]], np.diag([2.0**27, 2.0**30]), 2.0**-16 * I2
    values = np.array([[3.0, 2.96875], [np.nan, np.nan], [7.0, 7.015625], [9.0, 8.984375]])
    prior, move, sensor = (
        pgm.GaussianCPD(x, [0.0, 0.0], wide),
        pgm.LinearGaussianCPD(x, {x.previous: roll}, cov=O2),
        pgm.LinearGaussianCPD(both, {x: see}, cov=noise),
    )
    linear = pgm.DynamicBayesianNetwork([prior], [move], [sensor])
    rows = [(both, k, list(value), {}) for k, value in enumerate(values) if k != 1]
    joint = exact_linear(linear, 3, {}, rows).joint
    mean, cov = joint[(x.at(1),)]
    if way == "online":
        robot = pgm.OnlineFilter(linear, schedule=pgm.FixedLag(2, iterations=2))
        belief = robot.initial()
        for step, value in enumerate(values):
            belief = robot.update(robot.predict(belief) if step else belief, {both: value})
        found, status = belief.lagged[x], belief.status
    else:
        seen = pgm.NonlinearGaussianCPD(
            both,
            (x,),
            lambda x: x @ see.T,
            noise,
            jacobian={x: lambda x: np.broadcast_to(see, (*x.shape[:-1], 2, 2))},
        )
        model = linear.replace(observation=[seen])
        evidence = {both: pgm.sightings(values, step=np.arange(4))}
        posterior = pgm.smooth(model, evidence, lag=2, iterations=3, steps=3)
        found, status = posterior[x.at(1)], posterior.status
    assert_belief(found, np.array(mean, float), np.array(cov, float), 1e-8)
    assert status.digits > 7
