"""Sharp readings, and wide priors beside ordinary ones, against 300 digits."""

from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from precise import Reference, floats

import pgm
from pgm.beliefs.moments.parts import split as parts

MEAN = EVIDENCE = 1e-6
x = pgm.Variable("x", components=("position", "velocity"))
z = pgm.Variable("z")
MOVED = np.array([[1.0, 1.0], [0.0, 1.0]])


def reference(model, steps, values, sensor=z):
    """Of readings at steps 1, 2, ..., (T, d); what is NaN was not read."""
    read = [(sensor, k + 1, row, {}) for k, row in enumerate(values) if not np.isnan(row).any()]
    return Reference(model, steps, {}, read)


def assert_belief(belief, due):
    """Means to 1e-6 deviations, covariances to 1e-6 of theirs; of beliefs as a list, or of one."""
    stacked = [due] if isinstance(due, tuple) else due
    mean, cov = (floats([each[k] for each in stacked]) for k in (0, 1))
    std = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    assert belief.mean.reshape(-1).shape == mean.reshape(-1).shape
    assert (np.abs(belief.mean - mean) / std).max() <= MEAN
    assert (np.abs(belief.cov - cov) / (std[..., None] * std[..., None, :])).max() <= MEAN


def run_of(belief, run):
    return SimpleNamespace(mean=belief.mean[run], cov=belief.cov[run])


def assert_evidence(found, due):
    """To 1e-6."""
    np.testing.assert_allclose(found, floats(due), rtol=0, atol=EVIDENCE)


# ---- a sharp sensor on a wide motion


def sharp(deviation):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.0], np.eye(2))],
        [pgm.LinearGaussianCPD(x, {x.previous: MOVED}, cov=np.eye(2))],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=[[deviation**2]])],
    )


@pytest.mark.parametrize("deviation", [1e-6, 1e-7, 1e-8, 1e-9])
def test_a_sharp_sensor_on_a_wide_motion(deviation):
    """The chain, and the balanced tree."""
    model, rng = sharp(deviation), np.random.default_rng(5)
    steps = 30
    values = np.cumsum(rng.normal(size=(steps, 1)), axis=0)
    due = reference(model, steps, values)
    tree = pgm.compile(model, steps=steps, method=pgm.Balanced())
    for posterior in (
        pgm.smooth(model, {z: values}),
        pgm.infer(tree, {z: values}, schedule=pgm.Smoothing()),
    ):
        assert_belief(posterior[x], due.smoothed)
        assert_belief(posterior.filtered[x], due.filtered)
        assert_evidence(posterior.log_evidence, due.log_evidence)
        joint = posterior.joint(x.at(12), x.at(20))
        assert_belief(joint, due.joint(x.at(12), x.at(20)))


# ---- a wide prior

STEPS, RUNS = 8, 40
PUSH = np.outer([0.5, 1.0], [0.5, 1.0]) * 0.01  # of rank one
WIDE = [1e6, 1e9, 1e12]
RUNS_TOLD = [0, 17, 39]


def linear_function(child, parent, matrix, cov):
    def slope(state):
        return np.broadcast_to(matrix, (*state.shape[:-1], *matrix.shape))

    return pgm.NonlinearGaussianCPD(
        child, parent, lambda state: state @ matrix.T, cov, jacobian={parent: slope}
    )


def wide(deviation, function=False):
    """A constant velocity read to .1; by functions that are linear, if asked for."""
    row = np.array([[1.0, 0.0]])
    prior = pgm.GaussianCPD(x, [0.0, 0.0], np.diag([deviation**2, (deviation / 10.0) ** 2]))
    move = pgm.LinearGaussianCPD(x, {x.previous: MOVED}, cov=PUSH)
    read = pgm.LinearGaussianCPD(z, {x: row}, cov=[[0.01]])
    if function:
        move = linear_function(x, x.previous, MOVED, PUSH)
        read = linear_function(z, x, row, [[0.01]])
    return pgm.DynamicBayesianNetwork([prior], [move], [read])


def record(runs=None, missing=False):
    """Readings about a place that is nothing special, of some runs or one."""
    rng = np.random.default_rng(6)
    lead = () if runs is None else (runs,)
    values = 30.0 + np.arange(STEPS)[:, None] + 0.1 * rng.normal(size=(*lead, STEPS, 1))
    if missing:
        values[..., 2:, :][rng.random((*lead, STEPS - 2, 1)) < 0.3] = np.nan
    return values


@pytest.fixture(scope="module", params=WIDE, ids="{:.0e}".format)
def one(request):
    """A deviation, readings of one run, and what they tell."""
    values = record()
    return request.param, values, reference(wide(request.param), STEPS, values)


@pytest.fixture(scope="module", params=WIDE[::2], ids="{:.0e}".format)
def many(request):
    """The same of many runs, some readings missing."""
    values = record(RUNS, missing=True)
    model = wide(request.param)
    return request.param, values, {k: reference(model, STEPS, values[k]) for k in RUNS_TOLD}


def assert_posterior(posterior, due, smooth):
    assert_belief(posterior.filtered[x], due.filtered)
    assert_belief(posterior.predicted[x], due.predicted)
    assert_evidence(posterior.log_evidence, due.log_evidence)
    if smooth:
        assert_belief(posterior[x], due.smoothed)
        for pair in ((3, 4), (0, STEPS)):
            variables = [x.at(step) for step in pair]
            assert_belief(posterior.joint(*variables), due.joint(*variables))


def test_a_wide_prior(one):
    deviation, values, due = one
    model = wide(deviation)
    assert_posterior(pgm.filter(model, {z: values}), due, False)
    assert_posterior(pgm.smooth(model, {z: values}), due, True)
    tree = pgm.compile(model, steps=STEPS, method=pgm.Balanced())
    assert_posterior(pgm.infer(tree, {z: values}, schedule=pgm.Smoothing()), due, True)


@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()], ids=repr)
def test_iterations_where_functions_are_linear(one, rule):
    deviation, values, due = one
    found = pgm.smooth(wide(deviation, True), {z: values}, lineariser=rule, iterations=4)
    assert_belief(found[x], due.smoothed)
    if isinstance(rule, pgm.Taylor):
        assert_evidence(found.log_evidence, due.log_evidence)


def assert_runs(belief, log_evidence, due, part):
    for run, each in due.items():
        assert_belief(run_of(belief, run), getattr(each, part))
        assert_evidence(log_evidence[run], each.log_evidence)


THREADS = ThreadPoolExecutor(2)


@pytest.mark.parametrize(
    "options", [{}, {"keep": x}, {"executor": THREADS}, {"keep": x, "executor": THREADS}]
)
def test_many_runs_with_missing_readings(many, options, monkeypatch):
    monkeypatch.setattr(parts, "MOST", 15)
    deviation, values, due = many
    for run, part in ((pgm.filter, "filtered"), (pgm.smooth, "smoothed")):
        found = run(wide(deviation), {z: values}, **options)
        assert_runs(found[x], found.log_evidence, due, part)
        assert found.status.digits is None or found.status.digits.shape == (RUNS,)
        assert found.status.digits is None or (found.status.digits > 6.0).all()


def test_a_robot_with_a_wide_prior(one):
    deviation, values, due = one
    robot = pgm.OnlineFilter(wide(deviation))
    belief = robot.initial()
    for step, value in enumerate(values, 1):
        belief = robot.predict(belief)
        assert_belief(belief[x], due.predicted[step])
        belief = robot.update(belief, {z: value})
        assert_belief(belief[x], due.filtered[step])
    assert_evidence(belief.log_evidence, due.log_evidence)


def test_robots_with_a_wide_prior(many):
    """A batch, each of whose robots has other readings missing."""
    deviation, values, due = many
    robot = pgm.OnlineFilter(wide(deviation))
    belief = robot.initial()
    for step in range(1, STEPS + 1):
        belief = robot.update(robot.predict(belief), {z: values[:, step - 1]})
        for run, each in due.items():
            assert_belief(run_of(belief[x], run), each.filtered[step])
    for run, each in due.items():
        assert_evidence(belief.log_evidence[run], each.log_evidence)


# ---- components that read one scalar

scalar = pgm.Variable("scalar")
pair = pgm.Variable("pair", components=("left", "right"))


@pytest.mark.parametrize("deviation", [1e5, 1e6, 1e8])
@pytest.mark.parametrize("runs", [None, RUNS])
def test_two_components_read_one_scalar(deviation, runs):
    """To .01 each, hence to .00707; nothing is exact, so that nothing contradicts."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(scalar, [0.0], [[deviation**2]])],
        [pgm.LinearGaussianCPD(scalar, {scalar.previous: 1.0}, cov=[[1e-6]])],
        [pgm.LinearGaussianCPD(pair, {scalar: [[1.0], [1.0]]}, cov=np.eye(2) * 1e-4)],
    )
    lead = () if runs is None else (runs,)
    values = 7.0 + 0.01 * np.random.default_rng(7).normal(size=(*lead, 2, 2))
    due = reference(model, 2, values.reshape(-1, 2, 2)[0], pair)
    robot = pgm.OnlineFilter(model)
    belief = robot.initial()
    for step in (1, 2):
        belief = robot.update(robot.predict(belief), {pair: values[..., step - 1, :]})
    assert due.filtered[1][1] == pytest.approx(0.5e-4, rel=1e-3)
    for run, part in ((pgm.filter, "filtered"), (pgm.smooth, "smoothed")):
        posterior = run(model, {pair: values})
        found = posterior[scalar]
        assert_belief(found if runs is None else run_of(found, 0), getattr(due, part))
        assert_evidence(posterior.log_evidence.reshape(-1)[0], due.log_evidence)
    assert_belief(belief[scalar] if runs is None else run_of(belief[scalar], 0), due.filtered[2])
    assert_evidence(belief.log_evidence.reshape(-1)[0], due.log_evidence)
