"""Taylor and unscented inference against the EKF, the UKF, and their RTS smoothers."""

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
from robots import (
    DRIVE,
    LANDMARKS,
    P0,
    SENSORS,
    Q,
    T,
    controls,
    drive_along,
    drive_cpd,
    m,
    moves,
    network,
    u,
    x,
)
from scipy.linalg import block_diag
from textbooks import (
    assert_belief,
    assert_beliefs,
    assert_log,
    assert_same,
    log_normal,
    motion,
    reading,
    run_filter,
    run_smoother,
    stacked,
    taylor,
    unscented,
    wrap,
    wrapped,
)

import pgm
from models import sensors
from models.motion import velocity, velocity_by_control, velocity_by_state

RULES = {"taylor": (pgm.Taylor(), taylor), "unscented": (pgm.Unscented(), unscented)}


@pytest.fixture(scope="module", params=list(SENSORS))
def recorded(request):
    """A sensor, its model, commands, one reading at each of the steps 0..T, and the evidence."""
    sensor, rng = SENSORS[request.param], np.random.default_rng(7)
    commands = controls(rng)
    states = drive_along(commands, rng)
    landmarks = LANDMARKS[np.arange(T + 1) % 3]
    values = sensor.draw(states, landmarks, rng)
    given = {m: landmarks} if m in sensor.given else {}
    evidence = {u: commands, sensor.z: pgm.sightings(values, step=np.arange(T + 1), given=given)}
    return sensor, network(sensor.cpd()), commands, values, landmarks, evidence


def test_the_heading_goes_round():
    rng = np.random.default_rng(7)
    assert drive_along(controls(rng), rng)[-1, 2] > 2 * np.pi


@pytest.mark.parametrize("rule", RULES)
def test_filter_and_smoother(recorded, rule):
    sensor, model, commands, values, landmarks, evidence = recorded
    lineariser, twin = RULES[rule]
    seen = [sensor.seen(*row) for row in zip(values, landmarks, strict=True)]
    due = run_filter(twin, np.zeros(3), P0, moves(commands), seen)
    filtered = pgm.filter(model, evidence, lineariser=lineariser)
    smoothed = pgm.smooth(model, evidence, lineariser=lineariser)
    assert_beliefs(filtered[x], due.filtered)
    assert_beliefs(filtered.predicted[x], due.predicted)
    assert_beliefs(smoothed[x], run_smoother(due))
    assert_beliefs(smoothed.filtered[x], due.filtered)
    assert_log(filtered.log_evidence, due.log_evidence)
    assert_log(smoothed.log_evidence, due.log_evidence)


def test_filterpy_is_the_unscented_filter(recorded):
    sensor, model, commands, values, landmarks, evidence = recorded
    angles, due_log = sensor.z.angle_mask, 0.0

    def mean_of(sigmas, weights):
        return sigmas[0] + weights @ wrapped(sigmas - sigmas[0], angles)

    reference = UnscentedKalmanFilter(
        dim_x=3,
        dim_z=sensor.z.dimension,
        dt=1.0,
        fx=lambda state, k: DRIVE(state, commands[int(k)]),
        hx=lambda state, landmark: sensor.seen(0.0, landmark).function(state),
        points=MerweScaledSigmaPoints(3, alpha=np.sqrt(5 / 3), beta=2.0, kappa=0.0),
        z_mean_fn=mean_of,
        residual_z=lambda a, b: wrapped(a - b, angles),
    )
    reference.x, reference.P, reference.Q, reference.R = np.zeros(3), P0, Q, sensor.cov
    reference.sigmas_f = reference.points_fn.sigma_points(reference.x, reference.P)
    beliefs = []
    for step in range(T + 1):
        if step:
            reference.predict(dt=step - 1)
        reference.update(values[step], landmark=landmarks[step])
        due_log += reference.log_likelihood
        beliefs.append((reference.x.copy(), reference.P.copy()))
    steps = np.arange(T + 1)
    back = reference.rts_smoother(*map(np.array, zip(*beliefs, strict=True)), dts=steps)
    filtered = pgm.filter(model, evidence, lineariser=pgm.Unscented())
    assert_beliefs(filtered[x], beliefs)
    assert_log(filtered.log_evidence, due_log)
    smoothed = pgm.smooth(model, evidence, lineariser=pgm.Unscented())
    assert_belief(smoothed[x], back[0], back[1])


def several(rng):
    """Range and bearing to none up to four landmarks a step, of a drive of T steps, shuffled."""
    sensor, commands = SENSORS["range_bearing"], controls(rng)
    states = drive_along(commands, rng)
    step = np.repeat(np.arange(T + 1), rng.integers(0, 5, T + 1))
    landmarks = LANDMARKS[rng.integers(0, 3, step.size)]
    values = sensor.draw(states[step], landmarks, rng)
    order = rng.permutation(step.size)
    return commands, values[order], step[order], landmarks[order]


def twin_of_several(commands, values, step, landmarks, prior=(0, 0, 0)):
    sensor, seen = SENSORS["range_bearing"], []
    for k in range(T + 1):
        rows = np.flatnonzero(step == k)
        each = [sensor.seen(values[i], landmarks[i]) for i in rows]
        seen.append(stacked(each) if each else None)
    return run_filter(taylor, prior, P0, moves(commands), seen)


def test_several_sightings_a_step_are_a_stacked_ekf():
    sensor = SENSORS["range_bearing"]
    commands, values, step, landmarks = several(np.random.default_rng(3))
    due = twin_of_several(commands, values, step, landmarks)
    evidence = {u: commands, sensor.z: pgm.sightings(values, step=step, given={m: landmarks})}
    posterior = pgm.smooth(network(sensor.cpd()), evidence)
    assert_beliefs(posterior.filtered[x], due.filtered)
    assert_beliefs(posterior[x], run_smoother(due))
    assert_log(posterior.log_evidence, due.log_evidence)


@pytest.mark.parametrize("rule", RULES)
def test_the_order_of_sightings_does_not_matter(rule):
    sensor, rng = SENSORS["range_bearing"], np.random.default_rng(4)
    commands, values, step, landmarks = several(rng)
    posteriors, twice = [], {"iterations": 2, "tolerance": 0}
    for order in (np.arange(step.size), rng.permutation(step.size)):
        seen = pgm.sightings(values[order], step=step[order], given={m: landmarks[order]})
        evidence = {u: commands, sensor.z: seen}
        posteriors.append(
            pgm.smooth(network(sensor.cpd()), evidence, lineariser=RULES[rule][0], **twice)
        )
    assert_same(posteriors[1][x], posteriors[0][x])
    assert_log(posteriors[1].log_evidence, posteriors[0].log_evidence)


def test_two_kinds_of_sensor_at_a_step():
    """A pose in rows 1..T and landmarks at any steps; both linearised at the predicted belief."""
    sight, pose, rng = SENSORS["range_bearing"], SENSORS["pose"], np.random.default_rng(5)
    commands, values, step, landmarks = several(rng)
    fixes = pose.draw(drive_along(commands, rng)[1:], LANDMARKS[0], rng)
    fix = pgm.Variable("fix", components=x.components, angles=x.angles)
    seen = []
    for k in range(T + 1):
        each = [sight.seen(values[i], landmarks[i]) for i in np.flatnonzero(step == k)]
        each += [pose.seen(fixes[k - 1], None)] if k else []
        seen.append(stacked(each) if each else None)
    due = run_filter(taylor, np.zeros(3), P0, moves(commands), seen)
    cpd = pgm.NonlinearGaussianCPD(fix, (x,), pose.function, pose.cov, jacobian={x: pose.by_state})
    evidence = {
        u: commands,
        fix: fixes,
        sight.z: pgm.sightings(values, step=step, given={m: landmarks}),
    }
    for sensors_ in ([sight.cpd(), cpd], [cpd, sight.cpd()]):
        posterior = pgm.smooth(network(*sensors_), evidence)
        assert_beliefs(posterior.filtered[x], due.filtered)
        assert_beliefs(posterior[x], run_smoother(due))
        assert_log(posterior.log_evidence, due.log_evidence)


@pytest.mark.parametrize("rule", RULES)
def test_a_row_of_nan_is_a_reading_left_out(rule):
    """Other rows are missing in each run."""
    sensor, rng = SENSORS["range_bearing"], np.random.default_rng(8)
    commands, values, step, landmarks = several(rng)
    many = np.stack([values, values + 0.05, values - 0.05])
    lost = rng.random(many.shape[:2]) < 0.5
    lost[1, step == 4] = True
    lost[2] = True
    many[lost] = np.nan
    model, lineariser = network(sensor.cpd()), RULES[rule][0]
    evidence = {u: commands, sensor.z: pgm.sightings(many, step=step, given={m: landmarks})}
    for infer in (pgm.filter, pgm.smooth):
        posterior = infer(model, evidence, lineariser=lineariser)
        for run, keep in enumerate(~lost):
            rows = pgm.sightings(many[run, keep], step=step[keep], given={m: landmarks[keep]})
            alone = infer(model, {u: commands, sensor.z: rows}, lineariser=lineariser)
            assert_belief(posterior[x].marginal(x), *_with(posterior[x], run, alone[x]))
            assert_log(posterior.log_evidence[run], alone.log_evidence)


def _with(stack, run, alone):
    """The stack's moments with one run replaced by what is due there."""
    mean, cov = stack.mean.copy(), stack.cov.copy()
    mean[run], cov[run] = alone.mean, alone.cov
    return mean, cov


def test_no_sensors():
    commands = controls(np.random.default_rng(1))
    due = run_filter(taylor, np.zeros(3), P0, moves(commands), [None] * (T + 1))
    for evidence in (
        {u: commands},
        {u: commands, SENSORS["pose"].z: np.full((T, 3), np.nan)},
        {u: commands, SENSORS["pose"].z: pgm.sightings(np.zeros((0, 3)), step=[])},
    ):
        posterior = pgm.smooth(network(SENSORS["pose"].cpd()), evidence)
        assert_beliefs(posterior[x], due.filtered)
        assert posterior.log_evidence == 0.0


@pytest.mark.parametrize("rule", RULES)
def test_no_steps_at_all(rule):
    sensor, lineariser = SENSORS["range_bearing"], RULES[rule][0]
    value = np.array([8.0, 1.5])
    due = run_filter(RULES[rule][1], np.zeros(3), P0, [], [sensor.seen(value, LANDMARKS[0])])
    model = network(sensor.cpd())
    evidence = {
        u: np.zeros((0, 2)),
        sensor.z: pgm.sightings([value], step=[0], given={m: LANDMARKS[:1]}),
    }
    for infer in (pgm.filter, pgm.smooth):
        posterior = infer(model, evidence, lineariser=lineariser)
        assert_beliefs(posterior[x], due.filtered)
        assert_log(posterior.log_evidence, due.log_evidence)
    iterated = pgm.smooth(model, evidence, lineariser=lineariser, iterations=5, tolerance=0)
    assert iterated[x].mean.shape == (1, 3)
    bare = network(transition=pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=Q))
    assert_beliefs(pgm.smooth(bare, {}, steps=0)[x], [(np.zeros(3), P0)])


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("own", [Q, 0 * Q], ids=["noisy", "singular"])
def test_a_hidden_control(rule, own):
    """u given a command: the noise of the controls enters through the motion, rank 2 of 3."""
    sensor, rng = SENSORS["range_bearing"], np.random.default_rng(11)
    lineariser, twin = RULES[rule]
    commands, M = controls(rng), np.array([[0.02, 0.003], [0.003, 0.01]])
    states = drive_along(commands + rng.multivariate_normal([0, 0], M, T), rng, own)
    values = sensor.draw(states[1:], LANDMARKS[0], rng)
    command = pgm.Variable("command", components=u.components)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, mean=[0, 0, 0], cov=P0)],
        transition=[
            drive_cpd(cov=own, jacobian={x.previous: DRIVE.by_state, u: DRIVE.by_control}),
            pgm.LinearGaussianCPD(u, given={command: 1.0}, cov=M),
        ],
        observation=[sensor.cpd()],
    )
    evidence = {command: commands, sensor.z: values, m: pgm.constant(LANDMARKS[0])}
    moving = [
        motion(
            lambda s: DRIVE(s[..., :3], s[..., 3:]),
            lambda s: np.hstack(
                [DRIVE.by_state(s[:3], s[3:]), DRIVE.by_control(s[:3], s[3:])],
            ),
            own,
            disturbance=(c, M),
        )
        for c in commands
    ]
    seen = [None, *(sensor.seen(value, LANDMARKS[0]) for value in values)]
    due = run_filter(twin, np.zeros(3), P0, moving, seen)
    posterior = pgm.smooth(model, evidence, lineariser=lineariser)
    assert_beliefs(posterior.filtered[x], due.filtered)
    assert_beliefs(posterior.predicted[x], due.predicted)
    assert_beliefs(posterior[x], run_smoother(due))
    assert_log(posterior.log_evidence, due.log_evidence)
    assert posterior[u].steps.tolist() == list(range(1, T + 1))
    assert posterior[u].mean.shape == (T, 2)
    assert (np.diagonal(posterior[u].cov, axis1=1, axis2=2) <= np.diag(M) + 1e-12).all()


@pytest.mark.parametrize("swap", [False, True])
def test_two_states_with_an_edge_in_the_slice(swap):
    """A speed that drifts, and a pose that moves with the new speed."""
    s = pgm.Variable("s")
    sensor, rng = SENSORS["range_bearing"], np.random.default_rng(12)
    turn = pgm.Variable("turn")
    turns = rng.uniform(0.0, 0.3, (T, 1))

    def roll(before, speed, turning):
        return DRIVE(before, np.concatenate([speed, turning], axis=-1))

    def roll_by_state(before, speed, turning):
        return DRIVE.by_state(before, np.concatenate([speed, turning], axis=-1))

    def roll_by_speed(before, speed, turning):
        return DRIVE.by_control(before, np.concatenate([speed, turning], axis=-1))[..., :1]

    cpds = [
        pgm.LinearGaussianCPD(s, given={s.previous: 0.9}, offset=0.1, cov=0.03),
        pgm.NonlinearGaussianCPD(
            x,
            (x.previous, s, turn),
            roll,
            Q,
            jacobian={x.previous: roll_by_state, s: roll_by_speed},
        ),
    ]
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(s, 1.0, 0.04),
            pgm.LinearGaussianCPD(x, {s: [[0.5], [0], [0]]}, cov=P0),
        ],
        transition=cpds[::-1] if swap else cpds,
        observation=[sensor.cpd()],
    )
    states = drive_along(np.column_stack([np.ones(T), turns]), rng)
    values = sensor.draw(states[1:], LANDMARKS[1], rng)
    evidence = {turn: turns, sensor.z: values, m: pgm.constant(LANDMARKS[1])}

    # The twin's state is (s, x); the disturbance is the noise of s.
    def step_on(a, c):
        speed = 0.9 * a[..., :1] + 0.1 + a[..., 4:]
        return np.concatenate([speed, roll(a[..., 1:4], speed, np.full_like(speed, c))], axis=-1)

    def slope(a, c):
        speed = 0.9 * a[:1] + 0.1 + a[4:]
        by_speed = roll_by_speed(a[1:4], speed, np.array([c]))
        by_state = roll_by_state(a[1:4], speed, np.array([c]))
        top = [[0.9, 0, 0, 0, 1.0]]
        return np.vstack([top, np.hstack([0.9 * by_speed, by_state, by_speed])])

    moving = [
        motion(
            lambda a, c=c: step_on(a, c),
            lambda a, c=c: slope(a, c),
            block_diag(0.0, Q),
            disturbance=([0.0], [[0.03]]),
        )
        for c in turns[:, 0]
    ]
    pose_part = np.eye(4)[1:]
    seen = [None]
    for value in values:
        alone = sensor.seen(value, LANDMARKS[1])
        seen.append(
            reading(
                lambda a, alone=alone: alone.function(a[..., 1:]),
                lambda a, alone=alone: alone.jacobian(a[1:]) @ pose_part,
                sensor.cov,
                value,
                alone.angles,
            )
        )
    prior = block_diag(0.04, P0)
    prior[0, 1] = prior[1, 0] = 0.02
    prior[1, 1] += 0.01
    due = run_filter(taylor, [1.0, 0.5, 0, 0], prior, moving, seen)
    posterior = pgm.smooth(model, evidence)
    for variable, part in ((s, slice(0, 1)), (x, slice(1, 4))):
        for found, expected in (
            (posterior[variable], run_smoother(due)),
            (posterior.filtered[variable], due.filtered),
        ):
            assert_beliefs(found, [(mean[part], cov[part, part]) for mean, cov in expected])
    assert_log(posterior.log_evidence, due.log_evidence)


@pytest.mark.parametrize("rule", RULES)
def test_a_static_unknown_landmark(rule):
    """The landmark is a state that keeps its value: SLAM with one landmark, a UKF over both."""
    sensor, rng = SENSORS["range_bearing"], np.random.default_rng(13)
    lineariser = RULES[rule][0]
    commands = controls(rng)
    values = sensor.draw(drive_along(commands, rng), LANDMARKS[0], rng)
    where, spread = LANDMARKS[0] + [0.3, -0.2], np.diag([0.5, 0.4])
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0, 0], P0), pgm.GaussianCPD(m, where, spread)],
        transition=[
            drive_cpd(),
            pgm.LinearGaussianCPD(m, {m.previous: 1.0}, cov=np.zeros((2, 2))),
        ],
        observation=[
            sensor.cpd(jacobian={x: sensor.by_state, m: sensors.range_bearing_by_landmark})
        ],
    )

    def both(a):
        return sensor.function(a[..., :3], a[..., 3:])

    def slope(a):
        by_landmark = sensors.range_bearing_by_landmark(a[:3], a[3:])
        return np.hstack([sensor.by_state(a[:3], a[3:]), by_landmark])

    moving = []
    for move in moves(commands):
        # Only the pose moves by a function of it, so its points are over the pose alone.
        moving.append(_beside(move, 2))
    seen = [reading(both, slope, sensor.cov, value, sensor.z.angle_mask) for value in values]

    due = run_filter(
        taylor if rule == "taylor" else _partial_unscented,
        np.concatenate([np.zeros(3), where]),
        block_diag(P0, spread),
        moving,
        seen,
    )
    evidence = {u: commands, sensor.z: pgm.sightings(values, step=np.arange(T + 1))}
    posterior = pgm.smooth(model, evidence, lineariser=lineariser)
    back = run_smoother(due)
    for variable, part in ((x, slice(0, 3)), (m, slice(3, 5))):
        found, ahead = posterior[variable], posterior.filtered[variable]
        assert_beliefs(ahead, [(mean[part], cov[part, part]) for mean, cov in due.filtered])
        assert_beliefs(found, [(mean[part], cov[part, part]) for mean, cov in back])
    assert_log(posterior.log_evidence, due.log_evidence)
    spread_of_means = np.ptp(posterior[m].mean, axis=0)
    assert (spread_of_means < 1e-9).all(), "a static unknown has one smoothed belief"


def _beside(move, size):
    """A motion of the first three components; the others stay."""

    def function(a):
        return np.concatenate([move.function(a[..., :3]), a[..., 3:]], axis=-1)

    def jacobian(a):
        return block_diag(move.jacobian(a[:3]), np.eye(size))

    function.moving = move
    return motion(function, jacobian, block_diag(move.cov, np.zeros((size, size))))


def _partial_unscented(function, mean, cov, jacobian, angles):
    """Points over the pose alone where only it moves: the rest follows through its covariance."""
    move = getattr(function, "moving", None)
    if move is None:
        return unscented(function, mean, cov, jacobian, angles)
    new, own, cross = unscented(move.function, mean[:3], cov[:3, :3], None, angles[:3])
    slope = block_diag(np.linalg.solve(cov[:3, :3], cross).T, np.eye(2))
    error = own - slope[:3, :3] @ cross
    all_own = slope @ cov @ slope.T
    all_own[:3, :3] += error
    return np.concatenate([new, mean[3:]]), all_own, cov @ slope.T


def test_noise_that_depends_on_the_control_and_steps_of_any_length():
    rng = np.random.default_rng(14)
    sensor = SENSORS["pose"]
    drive = pgm.Variable("drive", components=("v", "omega", "dt"))
    commands = np.column_stack([controls(rng), rng.uniform(0.2, 2.0, T)])

    def driven(c):
        return c[..., 2, None, None] * (0.01 + 0.05 * np.abs(c[..., 0, None, None])) * np.eye(3)

    cpd = pgm.NonlinearGaussianCPD(
        x,
        (x.previous, drive),
        velocity,
        pgm.noise(driven, given=(drive,)),
        jacobian={x.previous: velocity_by_state},
    )
    values = sensor.draw(rng.normal(size=(T, 3)), LANDMARKS[0], rng)
    moving = [
        motion(
            lambda s, c=c: velocity(s, np.broadcast_to(c, (*s.shape[:-1], 3))),
            lambda s, c=c: velocity_by_state(s, c),
            driven(c),
        )
        for c in commands
    ]
    seen = [None, *(sensor.seen(value, None) for value in values)]
    for lineariser, twin in RULES.values():
        due = run_filter(twin, np.zeros(3), P0, moving, seen)
        evidence = {drive: commands, sensor.z: values}
        posterior = pgm.smooth(
            network(sensor.cpd(), transition=cpd), evidence, lineariser=lineariser
        )
        assert_beliefs(posterior[x], run_smoother(due))
        assert_log(posterior.log_evidence, due.log_evidence)


def test_constant_inputs_are_rows_of_one_value():
    sensor = SENSORS["range_bearing"]
    model, values = network(sensor.cpd()), np.tile([8.0, 1.0], (6, 1))
    by_rows = {u: np.tile([1.0, 0.1], (6, 1)), m: np.tile(LANDMARKS[0], (6, 1))}
    by_constants = {u: pgm.constant([1.0, 0.1]), m: pgm.constant(LANDMARKS[0])}
    posteriors = [
        pgm.smooth(model, {**inputs, sensor.z: values}) for inputs in (by_rows, by_constants)
    ]
    assert_same(posteriors[1][x], posteriors[0][x], 0.0)


def test_the_prior_differs_by_run():
    sensor, rng = SENSORS["range_bearing"], np.random.default_rng(15)
    commands, values, step, landmarks = several(rng)
    starts = rng.normal(size=(2, 3, 3)) * 0.3
    evidence = {u: commands, sensor.z: pgm.sightings(values, step=step, given={m: landmarks})}
    model = network(sensor.cpd(), prior=pgm.GaussianCPD(x, mean=starts, cov=P0))
    posterior = pgm.smooth(model, evidence)
    assert posterior[x].mean.shape == (2, 3, T + 1, 3)
    assert posterior.log_evidence.shape == (2, 3)
    for run in np.ndindex(2, 3):
        due = twin_of_several(commands, values, step, landmarks, starts[run])
        expected = run_smoother(due)
        mean, cov = posterior[x].mean[run], posterior[x].cov[run]
        assert_beliefs(pgm.Gaussian(x, mean, cov), expected)
        assert_log(posterior.log_evidence[run], due.log_evidence)


def test_a_smoother_of_singular_beliefs():
    """A known start and noise in the controls alone: predicted covariances have rank 2, then 3."""
    sensor, rng = SENSORS["pose"], np.random.default_rng(16)
    commands = controls(rng, 8)
    noise = [
        (by := DRIVE.by_control(np.array([0, 0, 0.2]), c)) @ np.diag([0.02, 0.01]) @ by.T
        for c in commands
    ]
    values = sensor.draw(drive_along(commands, rng, 1e-3 * Q)[1:], LANDMARKS[0], rng)
    values[:4] = np.nan
    index = pgm.Variable("index")

    def drive_with_index(before, c, k):
        return DRIVE(before, c)

    cpd = pgm.NonlinearGaussianCPD(
        x,
        (x.previous, u, index),
        drive_with_index,
        pgm.noise(lambda k: np.array(noise)[k[..., 0].astype(int)], given=(index,)),
        jacobian={x.previous: lambda before, c, k: DRIVE.by_state(before, c)},
    )
    model = network(sensor.cpd(), transition=cpd, prior=pgm.GaussianCPD(x, [0, 0, 0], 0 * P0))
    evidence = {u: commands, index: np.arange(8.0)[:, None], sensor.z: values}
    moving = [
        motion(one.function, one.jacobian, cov)
        for one, cov in zip(moves(commands), noise, strict=True)
    ]
    seen = [None, *(None if np.isnan(v[0]) else sensor.seen(v, None) for v in values)]
    due = run_filter(taylor, np.zeros(3), 0 * P0, moving, seen)
    posterior = pgm.smooth(model, evidence)
    expected = run_smoother(due, lambda P: np.linalg.pinv(P, rcond=1e-11, hermitian=True))
    assert_beliefs(posterior[x], expected, 1e-8)
    assert_log(posterior.log_evidence, due.log_evidence)


@pytest.mark.parametrize("lineariser", [r[0] for r in RULES.values()] + [pgm.MonteCarlo(30)])
@pytest.mark.parametrize("iterations", [1, 5])
def test_an_exact_pose_is_the_posterior(lineariser, iterations):
    """Also when everything is linearised again at beliefs that are certain."""
    rng = np.random.default_rng(17)
    commands = controls(rng, 8)
    states = drive_along(commands, rng)
    exact = SENSORS["pose"].cpd(cov=np.zeros((3, 3)))
    evidence = {u: commands, SENSORS["pose"].z: wrapped(states[1:], x.angle_mask)}
    posterior = pgm.smooth(
        network(exact), evidence, lineariser=lineariser, iterations=iterations, tolerance=0.0
    )
    np.testing.assert_allclose(posterior[x].mean[1:], states[1:], atol=1e-9)
    assert np.abs(posterior[x].cov[1:]).max() < 1e-12
    residual = states[2:] - DRIVE(states[1:-1], commands[1:])
    due = sum(log_normal(r, Q) for r in residual)
    first = posterior.innovations[SENSORS["pose"].z]
    due += log_normal(first.residual[0], first.cov[0])
    assert_log(posterior.log_evidence, due, 1e-7)


def test_exact_control_by_control_jacobians():
    """Those of the models, in the tests' hands: a guard against testing with wrong functions."""
    state, c, step = np.array([0.3, -0.2, 2.0]), np.array([1.1, 0.2, 0.7]), 1e-6
    moved = [
        (velocity(state, c + d) - velocity(state, c - d)) / (2 * step) for d in step * np.eye(3)
    ]
    np.testing.assert_allclose(np.transpose(moved), velocity_by_control(state, c), atol=1e-8)
    assert wrap(3 * np.pi) == pytest.approx(-np.pi)
