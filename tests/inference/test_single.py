"""A single run is swept without an axis of runs, and leaves what the general sweep leaves."""

import numpy as np
import pytest
from robots import DRIVE, LANDMARKS, P0, SENSORS, Q, controls, drive_along, drive_cpd, m, u, x

import pgm
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.family import Family

T = 15
SIGHT, POSE = SENSORS["range_bearing"], SENSORS["pose"]
bias = pgm.Variable("bias", components=("turn",))
command = pgm.Variable("command", components=u.components)
lost = pgm.Variable("lost", components=m.components)
seen = pgm.Variable("seen", components=SIGHT.z.components, angles=SIGHT.z.angles)
fix = pgm.Variable("fix", components=("east", "north"))
compass = pgm.Variable("compass", components=("heading",), angles=("heading",))
RULES = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "negative weights": pgm.Unscented(alpha=0.8, beta=2.0, kappa=0.0),
    "cubature": pgm.Cubature(),
    "hermite": pgm.GaussHermite(3),
    "monte carlo": pgm.MonteCarlo(40, seed=3),
    "prior moments": pgm.MonteCarlo(400, seed=3, prior_moments=True),
    "fresh": pgm.MonteCarlo(40, seed=3, fresh_per_run=True),
    "sobol": pgm.QuasiMonteCarlo(32),
    "bare function": lambda function, at: pgm.Cubature()(function, at),
}


def wrapping(state, control):
    moved = DRIVE(state, control)
    moved[..., 2] = (moved[..., 2] + np.pi) % (2 * np.pi) - np.pi
    return moved


def drifting(state, turn, control):
    moved = DRIVE(state, control)
    moved[..., 2] += turn[..., 0]
    return moved


def turning_noise(control):
    return (0.01 + 0.1 * np.abs(control[..., 1, None, None])) * np.eye(3)


def plain(transition=None, sensor=None, prior=None):
    return pgm.DynamicBayesianNetwork(
        prior=[prior or pgm.GaussianCPD(x, [0.0, 0.0, 0.0], P0)],
        transition=[transition or drive_cpd()],
        observation=[sensor or SIGHT.cpd()],
    )


def everything():
    """Noisy controls, an unknown landmark that stands still, a bias: all shapes at once."""
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(bias, [0.01], 0.01),
            pgm.GaussianCPD(x, [0.0, 0.0, 0.0], P0),
            pgm.GaussianCPD(lost, LANDMARKS[2], 0.3 * np.eye(2)),
        ],
        transition=[
            pgm.LinearGaussianCPD(u, {command: 1.0}, cov=0.01 * np.eye(2)),
            pgm.LinearGaussianCPD(bias, {bias.previous: 0.9}, cov=1e-4),
            pgm.NonlinearGaussianCPD(
                x,
                (x.previous, bias, u),
                drifting,
                Q,
                jacobian={x.previous: lambda state, turn, control: DRIVE.by_state(state, control)},
            ),
            pgm.LinearGaussianCPD(lost, {lost.previous: 1.0}, cov=np.zeros((2, 2))),
        ],
        observation=[
            SIGHT.cpd(jacobian=None),
            pgm.NonlinearGaussianCPD(seen, (lost, x), lambda m, x: SIGHT.function(x, m), SIGHT.cov),
            pgm.LinearGaussianCPD(fix, {lost: np.eye(2)}, cov=np.diag([0.5, 0.2])),
            pgm.LinearGaussianCPD(compass, {x: [[0.0, 0.0, 1.0]]}, cov=0.01),
        ],
    )


MODELS = {
    "plain": plain(),
    "numerical jacobians": plain(drive_cpd(jacobian=None), SIGHT.cpd(jacobian=None)),
    "wrapping drive": plain(drive_cpd(function=wrapping)),
    "noise by control": plain(drive_cpd(cov=pgm.noise(turning_noise, given=u))),
    "grouped": plain(sensor=SIGHT.cpd(grouped=True)),
    "an exact range": plain(sensor=SIGHT.cpd(cov=np.diag([0.0, 0.01]))),
    "sharp readings": plain(sensor=SIGHT.cpd(cov=1e-9 * np.eye(2))),
    "a certain start": plain(prior=pgm.GaussianCPD(x, [0.0, 0.0, 0.0], np.diag([0.1, 0.0, 0.0]))),
    "a motion without noise": plain(drive_cpd(cov=np.diag([0.01, 0.0, 0.0]))),
    "an unknown heading": plain(prior=pgm.GaussianCPD(x, [0, 0, 0], np.diag([0.1, 0.1, 9.0]))),
    "own lineariser": plain(sensor=SIGHT.cpd(lineariser=pgm.Cubature())),
    "everything": everything(),
}


def evidence(model, seed=5):
    """Several sightings a step, at step 0 too, some of them missing; a heading of many turns."""
    rng = np.random.default_rng(seed)
    given = controls(rng, T)
    states = drive_along(given, rng)
    step = np.sort(rng.integers(0, T + 1, 24))
    landmarks = LANDMARKS[rng.integers(0, 2, step.size)]
    values = SIGHT.draw(states[step], landmarks, rng)
    values[rng.random(step.size) < 0.2] = np.nan
    found = {
        command if command in model.inputs else u: given,
        SIGHT.z: pgm.sightings(values, step=step, given={m: landmarks}),
    }
    if seen in model.sensors:
        found[seen] = SIGHT.draw(states[1:], LANDMARKS[2], rng)
        found[fix] = np.where(
            rng.random((T, 1)) < 0.5, np.nan, LANDMARKS[2] + 0.1 * rng.normal(size=(T, 2))
        )
        found[compass] = states[1:, 2:] % (2 * np.pi)
    return found


def both(monkeypatch, work):
    """What comes out of the sweep of a single run, and of the general one."""
    lean = work()
    with monkeypatch.context() as patch:
        patch.setattr(ChainPlan, "lean", False)
        return lean, work()


def assert_close(found, due, what):
    scale = np.abs(due).max(initial=1.0)
    np.testing.assert_allclose(found, due, rtol=1e-9, atol=1e-11 * scale, err_msg=what)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("rule", RULES)
def test_it_is_the_general_sweep(monkeypatch, name, rule):
    model, given = MODELS[name], evidence(MODELS[name])
    outcomes = []

    def work():
        try:
            posterior = pgm.filter(model, given, lineariser=RULES[rule])
        except pgm.PgmError as error:
            outcomes.append(str(error))
            return None
        outcomes.append("")
        return posterior

    lean, general = both(monkeypatch, work)
    assert outcomes[0] == outcomes[1]
    if general is None:
        return
    ahead, due = lean._forward, general._forward
    for part in ("predicted_mean", "predicted_cov", "mean", "cov", "log_density"):
        assert_close(getattr(ahead, part), getattr(due, part), part)
    assert (ahead.cov == ahead.cov.swapaxes(-1, -2)).all()
    assert (ahead.predicted_cov == ahead.predicted_cov.swapaxes(-1, -2)).all()
    for mine, its in zip(lean._plan.families, general._plan.families, strict=True):
        for part in ("matrix", "offset", "noise"):
            assert_close(getattr(mine, part), getattr(its, part), f"{its.cpd!r} {part}")
        assert mine.approximate == its.approximate
    for mine, its in zip(lean._plan.sensors, general._plan.sensors, strict=True):
        assert_close(mine.moved, its.moved, "moved")
        for step in mine.cross.keys() | its.cross.keys():
            crosses = (each.cross.get(step, 0.0) for each in (mine, its))
            assert_close(*crosses, f"cross terms at {step}")
    assert lean.status.converged == general.status.converged


def test_most_of_the_cases_are_no_errors():
    outcomes = []
    for model in MODELS.values():
        for rule in RULES.values():
            try:
                pgm.filter(model, evidence(model), lineariser=rule)
            except pgm.PgmError:
                outcomes.append(False)
            else:
                outcomes.append(True)
    assert np.mean(outcomes) > 0.9


@pytest.mark.parametrize("rule", ["taylor", "unscented", "monte carlo"])
@pytest.mark.parametrize("name", ["plain", "grouped", "everything"])
def test_the_general_way_is_not_taken(monkeypatch, name, rule):
    """Otherwise the comparisons would compare it with itself."""
    from pgm.inference.chain import single_sight

    def refuse(*arguments, **options):
        raise AssertionError("an ordinary step went the general way")

    model = MODELS[name]
    monkeypatch.setattr(single_sight, "update", refuse)
    monkeypatch.setattr(single_sight, "linearise_sensor", refuse)
    monkeypatch.setattr(Family, "linearise", refuse)
    pgm.filter(model, evidence(model), lineariser=RULES[rule])


@pytest.mark.parametrize("lost_at", range(4))
@pytest.mark.parametrize("rule", ["taylor", "unscented"])
@pytest.mark.parametrize("where", ["drive", "sight", "both"])
def test_what_is_not_finite_is_refused_alike(monkeypatch, where, rule, lost_at):
    """At a step of the motion, of a sensor: the same words, the same step."""

    def hole(function, at):
        def broken(state, other):
            value = np.array(function(state, other))
            return np.where(np.abs(other[..., :1] - at) < 1e-9, np.nan, value)

        return broken

    given = evidence(MODELS["plain"])
    drive, sight = DRIVE, SIGHT.function
    if where != "sight":
        drive = hole(drive, given[u][lost_at, 0])
    if where != "drive":
        sight = hole(sight, given[SIGHT.z].given[m][lost_at, 0])
    model = plain(drive_cpd(function=drive), SIGHT.cpd(function=sight))
    found = []

    def work():
        with pytest.raises(pgm.PgmError) as caught:
            pgm.filter(model, given, lineariser=RULES[rule])
        found.append((type(caught.value), str(caught.value), caught.value.step, caught.value.cpd))

    both(monkeypatch, work)
    assert found[0] == found[1]
    assert issubclass(found[0][0], pgm.LinearisationError)


@pytest.mark.parametrize("fault", ["shape", "complex", "integers"])
def test_functions_that_turn_odd_after_the_probe(monkeypatch, fault):
    """A shape that is wrong for some arguments alone, and values that are no floats."""

    def odd(state, control):
        value = DRIVE(state, control)
        if value.ndim == 3:
            return value  # the probe
        if fault == "integers":
            return np.round(value).astype(int)
        return value + 1j if fault == "complex" else value[..., :2]

    model = plain(drive_cpd(function=odd))
    found = []

    def work():
        try:
            found.append(pgm.filter(model, evidence(model))[x].mean)
        except pgm.ModelError as error:
            found.append(str(error))

    both(monkeypatch, work)
    if fault == "integers":
        assert_close(found[0], found[1], "means")
    else:
        assert found[0] == found[1]
        assert fault in found[0]


@pytest.mark.parametrize("schedule", [{}, {"iterations": 3, "tolerance": 0.0}])
@pytest.mark.parametrize("name", ["plain", "grouped", "everything"])
def test_smoothing_begins_with_it(monkeypatch, name, schedule):
    model = MODELS[name]
    lean, general = both(
        monkeypatch,
        lambda: pgm.smooth(model, evidence(model), lineariser=pgm.Unscented(), **schedule),
    )
    for state in model.states:
        assert_close(lean[state].mean, general[state].mean, f"{state!r} mean")
        assert_close(lean[state].cov, general[state].cov, f"{state!r} cov")
    assert_close(lean.log_evidence, general.log_evidence, "log-evidence")


def test_an_axis_of_one_run_stays():
    model = MODELS["plain"]
    given = evidence(model)
    wide = given | {u: given[u][None]}
    assert pgm.filter(model, wide)[x].mean.shape == (1, T + 1, 3)


def test_no_steps_and_no_readings():
    model = MODELS["plain"]
    start = pgm.filter(model, {u: np.zeros((0, 2))})
    np.testing.assert_array_equal(start[x].mean, np.zeros((1, 3)))
    ahead = pgm.filter(model, {u: np.ones((3, 2))})
    assert ahead.log_evidence == 0.0
    assert ahead[x].mean.shape == (4, 3)
