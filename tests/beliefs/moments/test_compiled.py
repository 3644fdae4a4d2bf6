"""Sweeps in machine code against the general kernels, on models and rules of all kinds."""

import pickle

import numpy as np
import pytest
from carts import drawn
from crossed import combinations, crossed, slow_after
from numpy.testing import assert_allclose, assert_array_equal
from plain import evidence_of, linear_network
from robots import SENSORS, drive_cpd, network, sighted, u, x
from test_zoo import by_function
from textbooks import assert_belief
from zoo import MODELS, RULES, SIGHT, model_of, of_run, plain, recording

import pgm

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")

COMPILED = ["taylor", "unscented", "negative weights", "cubature", "hermite"]
CHECKED = combinations(list(MODELS), ["taylor", "unscented"])
CHECKED += slow_after(
    3, [("everything", rule) for rule in RULES if rule not in ("taylor", "unscented")]
)


def assert_log(found, due, tolerance):
    due = np.asarray(due)
    assert (np.abs(found - due) <= tolerance * (1.0 + np.abs(due))).all()


def assert_posterior(found, due, tolerance=1e-9, smooth=True):
    """All that a posterior tells is that of another one."""
    model = due.graph.model
    for variable in (*model.states, *model.controls):
        kinds = ("filtered", "predicted")
        pairs = [(getattr(found, kind)[variable], getattr(due, kind)[variable]) for kind in kinds]
        for one, other in (*pairs, (found[variable], due[variable]))[: 3 if smooth else 2]:
            assert_belief(one, other.mean, other.cov, tolerance)
    assert_log(found.log_evidence, due.log_evidence, tolerance)
    assert_array_equal(found.status.converged, due.status.converged)
    assert found.status.iterations == due.status.iterations
    for sensor, other in due.innovations.items():
        ours = found.innovations[sensor]
        unit = np.sqrt(np.einsum("...ii->...i", other.cov))
        off = np.abs(ours.residual - other.residual) / unit
        assert (np.isnan(off) | (off <= 100 * tolerance)).all()
        assert_array_equal(np.isnan(ours.residual), np.isnan(other.residual))


def both(infer, model, evidence, **options):
    return [infer(model, evidence, compiled=choice, **options) for choice in (True, False)]


@pytest.mark.parametrize(("name", "rule"), CHECKED)
def test_runs_of_all_kinds(name, rule):
    evidence = recording(name)
    found = both(pgm.smooth, model_of(name), evidence, lineariser=RULES[rule])
    assert_posterior(*found)


@crossed(("shared", "lead"), [None, 0, 1], [(), (3,), (9,)])
def test_functions_of_several_inputs(lead, shared):
    """Inputs of each run, and those that all runs share, lie otherwise in memory."""
    s, v = (pgm.Variable(name, components=("a", "b")) for name in "sv")
    w, y = pgm.variables("w y")

    def move(s, v, w):
        return s + v * np.sin(w) + 0.1 * np.cos(s)

    def seen(s, v, w):
        return s[..., :1] * w + v[..., 1:]

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, [0.0, 1.0], 1.0)],
        [pgm.NonlinearGaussianCPD(s, (s.previous, v, w), move, 0.1)],
        [pgm.NonlinearGaussianCPD(y, (s, v, w), seen, 0.1)],
    )
    rng = np.random.default_rng(5)
    evidence = {
        each: rng.normal(size=(*(() if shared == k else lead), 12, each.dimension))
        for k, each in enumerate((v, w, y))
    }
    for options in ({}, {"lineariser": pgm.Unscented()}, {"iterations": 20}):
        assert_posterior(*both(pgm.smooth, model, evidence, **options))


@crossed(
    ("variance", "shape", "runs"),
    [1e-4, 1e-6, 1e-7, 1e-8],
    [np.eye(2), np.diag([1.0, 1e5]), [[1.0, 0.999], [0.999, 1.0]]],
    [1, 9],
)
def test_readings_of_all_sharpness(variance, shape, runs):
    """Some are sharper than either order of sums leaves digits for: they are left to one."""
    model = network(SENSORS["range_bearing"].cpd(cov=variance * np.asarray(shape)))
    evidence = sighted(runs, steps=20)
    for rule in ("taylor", "unscented"):
        found = both(pgm.smooth, model, evidence, lineariser=RULES[rule])
        assert_posterior(*found)


ODD = {
    "a wide prior": {"prior": pgm.GaussianCPD(x, np.zeros(3), 1e300 * np.eye(3))},
    "a far heading": {"prior": pgm.GaussianCPD(x, [0.0, 0.0, 1e300], np.eye(3))},
    "a far start": {"prior": pgm.GaussianCPD(x, [1e30, 0.0, 0.0], np.eye(3))},
    "much noise": {"transition": drive_cpd(cov=1e300 * np.eye(3))},
    "subnormal noise": {"transition": drive_cpd(cov=1e-320 * np.eye(3))},
}


@crossed(("parts", "rule"), ODD, ["taylor", "unscented"])
def test_odd_numbers_are_answered_or_refused_alike(parts, rule):
    told = []
    for choice in (True, False):
        try:
            model = network(SENSORS["range_bearing"].cpd(), **parts)
            found = pgm.filter(model, sighted(), compiled=choice, lineariser=RULES[rule])
            told.append((found[x].mean.tolist(), found[x].cov.tolist()))
        except (pgm.PgmError, pgm.PrecisionWarning) as error:
            told.append((type(error), str(error)))
    if isinstance(told[0][0], type) or isinstance(told[1][0], type):
        assert told[0] == told[1]
    else:
        for found, due in zip(*told, strict=True):
            assert_allclose(found, due, rtol=1e-9, atol=1e-9)


@crossed(
    ("name", "run", "rule"),
    ["plain", "noise by control", "a start for each run"],
    {"batch": None, "one": 1},
    COMPILED,
)
def test_ordinary_runs_are_not_left_to_the_general_kernels(alone, name, rule, run):
    evidence = recording(name) if run is None else of_run(recording(name), run)
    found = both(pgm.smooth, model_of(name, run), evidence, lineariser=RULES[rule])
    assert_posterior(*found)


@crossed(("threads", "name"), [1, 2], ["plain", "everything", "a start for each run"])
def test_many_runs_and_threads(name, threads):
    which = np.arange(40) % 3
    model, evidence = model_of(name, which), of_run(recording(name), which)
    found = pgm.filter(model, evidence, compiled=pgm.Compiled(threads=threads))
    due = pgm.filter(model, evidence, compiled=False)
    assert_posterior(found, due, smooth=False)


@crossed(
    ("name", "options"),
    ["plain", "grouped", "everything"],
    [{}, {"damping": 0.3}, {"lineariser": pgm.Unscented()}],
)
def test_iterated_updates(name, options):
    found = both(pgm.filter, MODELS[name], recording(name), iterations=20, **options)
    assert_posterior(*found, smooth=False)


@pytest.mark.parametrize("rule", ["taylor", "unscented"])
def test_iterated_smoothing(rule):
    rule = RULES[rule]
    found = both(pgm.smooth, MODELS["plain"], recording("plain"), iterations=20, lineariser=rule)
    assert_posterior(*found)


def test_long_iterated_smoothing(alone):
    """The general kernels solve for all steps in rounds."""
    found = both(
        pgm.smooth,
        network(SENSORS["range_bearing"].cpd()),
        sighted(steps=80),
        iterations=20,
        lineariser=pgm.Unscented(),
    )
    assert_posterior(*found)


@crossed(("lag", "nonlinear"), [0, 2], [False, True])
def test_a_fixed_lag_with_hidden_controls(nonlinear, lag):
    model, evidence, steps, _ = drawn(3, nonlinear)
    found, due = both(pgm.smooth, model, evidence, steps=steps, lag=lag)
    for variable in (*model.states, *model.controls):
        assert_belief(found[variable], due[variable].mean, due[variable].cov, 1e-9)


@pytest.mark.parametrize("steps", [0, 1])
def test_few_steps_and_no_sensor(steps):
    for model in (MODELS["plain"], network()):
        found = both(pgm.smooth, model, {u: np.ones((steps, 2))}, steps=steps)
        assert_posterior(*found)


@pytest.mark.parametrize("iterations", [1, 20])
def test_joints_are_of_the_last_linearisation(iterations):
    """The reversed chain is made when they are asked for."""
    evidence, schedule = sighted(3), pgm.Smoothing(iterations)
    model = MODELS["plain"]
    posteriors = [
        pgm.infer(pgm.compile(model, 12, compiled=choice), evidence, schedule=schedule)
        for choice in (True, False)
    ]
    found, due = (each.joint(x.at(4), x.at(5)) for each in posteriors)
    assert_belief(found, due.mean, due.cov, 1e-9)


@pytest.mark.parametrize("installed", [True, False])
def test_work_is_compiled_by_default_where_it_is_long(installed, monkeypatch):
    from pgm.beliefs.moments.compiled import sweep
    from pgm.examples import walk, z

    used, run = [], sweep.run
    monkeypatch.setattr(sweep, "run", lambda *given: used.append(1) or run(*given))
    if not installed:
        monkeypatch.setattr(sweep, "find_spec", lambda name: None)
    monkeypatch.setattr(sweep, "_LONG", 12 * 101)
    for steps, due in ((11, False), (12, installed)):
        pgm.filter(walk, {z: np.ones((steps, 1))})
        assert bool(used) is due


def test_a_graph_travels_after_its_functions_were_compiled():
    graph, evidence = pgm.compile(MODELS["plain"], 8, compiled=True), recording("plain")
    due = pgm.infer(graph, evidence)
    assert_posterior(pgm.infer(pickle.loads(pickle.dumps(graph)), evidence), due)


@pytest.mark.parametrize("slopes", [False, True])
def test_hidden_controls_of_narrow_states(slopes):
    """The smoother's gain of controls has more rows of four than that of states."""
    model, inputs, readings = linear_network()[0], *linear_network()[2:]
    if slopes:
        parts = (model.prior, model.transition, model.observation)
        model = pgm.DynamicBayesianNetwork(
            *([by_function(cpd, True) for cpd in cpds] for cpds in parts)
        )
    found = both(pgm.smooth, model, evidence_of(inputs, readings))
    assert_posterior(*found)


def test_variances_that_grow_and_shrink_between_readings_are_looked_at():
    a, z, w = pgm.Variable("a", components=("p", "q")), *pgm.variables("z w")
    pair, far = np.ones((2, 2)), 1e6

    def spread(state, by):
        return state + by * (state @ pair)

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, [1.0, 2.0], [[1.0, 0.2], [0.2, 2.0]])],
        [pgm.NonlinearGaussianCPD(a, (a.previous, w), spread, 1e-4 * np.eye(2))],
        [pgm.LinearGaussianCPD(z, {a: [[1.0, 0.0]]}, cov=1.0)],
    )
    by = np.zeros((3, 7, 1))
    by[1, 2:4, 0] = far, -far / (1.0 + 2.0 * far)
    found, due = both(pgm.filter, model, {w: by})
    assert_belief(found[a], due[a].mean, due[a].cov, 1e-9)


def bent(values):
    """A robot whose function gives odd numbers."""
    drive = pgm.NonlinearGaussianCPD(
        x, (x.previous, u), lambda s, c: values(s + 0.1 * c[..., :1]), np.eye(3)
    )
    return network(SENSORS["range_bearing"].cpd(), transition=drive)


@crossed(
    ("runs", "values"),
    [None, 3],
    {
        "infinite": lambda s: s / np.where(s > 0.5, 0.0, 1.0),
        "not a number": lambda s: np.sqrt(s - 0.4),
        "overflow": lambda s: np.exp(400 * s),
        "large": lambda s: s * 1e200,
    },
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_what_is_refused_is_refused_alike(values, runs):
    told = []
    for choice in (True, False):
        with pytest.raises(pgm.PgmError) as refusal:
            pgm.filter(bent(values), sighted(runs), compiled=choice)
        told.append((type(refusal.value), str(refusal.value)))
    assert told[0] == told[1]


def test_a_run_that_contradicts_an_exact_model_is_named():
    a, z = pgm.variables("a z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.0)],
        [pgm.LinearGaussianCPD(z, {a: 1.0}, cov=0.0)],
    )
    values = np.ones((5, 4, 1))
    values[3, 2] = 2.0
    told = []
    for choice in (True, False):
        with pytest.raises(pgm.PgmError) as refusal:
            pgm.filter(model, {z: values}, compiled=choice)
        told.append((type(refusal.value), str(refusal.value)))
    assert told[0] == told[1]


def test_a_function_is_seen_as_it_is_now():
    turn = {"by": 0.1}

    def moved(state, command):
        return state + turn["by"] * command[..., :1]

    model = network(
        SIGHT.cpd(), transition=pgm.NonlinearGaussianCPD(x, (x.previous, u), moved, np.eye(3))
    )
    evidence, graphs = sighted(), [pgm.compile(model, 12, compiled=c) for c in (True, False)]
    for turn["by"] in (0.1, 2.0):
        assert_posterior(*(pgm.infer(graph, evidence) for graph in graphs))


def test_machine_code_for_grids_is_refused():
    belief = pgm.Grid({x: (0.0, 1.0, 2)})
    graph = pgm.compile(MODELS["plain"], 12, compiled=True)
    calls = [
        lambda: pgm.infer(graph, sighted(), belief=belief),
        lambda: pgm.filter(MODELS["plain"], sighted(), belief=belief, compiled=pgm.Compiled()),
        lambda: pgm.smooth(MODELS["plain"], sighted(), belief=belief, compiled=True),
    ]
    for call in calls:
        with pytest.raises(pgm.ModelError, match="compiled= is for beliefs that are Gaussian"):
            call()


def test_machine_code_for_tables_is_refused():
    rain = pgm.Discrete("rain", states=("no", "yes"))
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(rain, table=[0.5, 0.5])],
        [pgm.TableCPD(rain, given=(rain.previous,), table=[[0.7, 0.3], [0.3, 0.7]])],
        [],
    )
    for call in (
        lambda: pgm.compile(model, 3, compiled=True),
        lambda: pgm.filter(model, {}, steps=3, compiled=True),
        lambda: pgm.OnlineFilter(model, compiled=True),
    ):
        with pytest.raises(pgm.ModelError, match="compiled= is for"):
            call()


def test_a_sensor_without_noise_is_told():
    told = pgm.compile(MODELS["an exact range"], 3).compilation
    sensor = MODELS["an exact range"].observation[0]
    assert told[sensor] == "its noise is singular"
    assert set(told.values()) == {"compiled", "its noise is singular"}


def test_a_lineariser_of_a_function_is_told():
    child, rule = SENSORS["range_only"].z, pgm.MonteCarlo(20)
    range_of = pgm.NonlinearGaussianCPD(
        child, (x,), lambda s: np.hypot(s[..., :1], 1.0), 0.1, lineariser=rule
    )
    told = pgm.compile(MODELS["plain"].replace(observation=[range_of]), 3).compilation
    assert told[range_of] == f"called back: it is linearised by {rule!r}"


@pytest.mark.parametrize("noise", [pgm.StudentT(4), pgm.Huber(1.5)], ids=repr)
def test_robust_sightings_of_which_components_are_missing(alone, noise):
    model = plain(sensor=SIGHT.cpd(noise=noise))
    assert_posterior(*both(pgm.smooth, model, recording("plain", 11)))
