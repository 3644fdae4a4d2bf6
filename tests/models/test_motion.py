"""Motion models against integration, textbook forms, complex numbers and recorded drives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from scipy.io import loadmat
from scipy.special import spherical_jn

from models import motion

DRIVE = motion.Velocity(dt=0.3)
WHEELS = motion.DifferentialDrive(radius=0.8, wheelbase=0.5, dt=0.3)
MODELS = {
    "velocity": (motion.velocity, motion.velocity_by_state, motion.velocity_by_control),
    "Velocity": (DRIVE, DRIVE.by_state, DRIVE.by_control),
    "arc": (motion.arc, motion.arc_by_state, motion.arc_by_control),
    "increment": (motion.increment, motion.increment_by_state, motion.increment_by_control),
    "retreat": (motion.retreat, motion.retreat_by_state, motion.retreat_by_control),
    "travelled": (motion.travelled, motion.travelled_by_state, motion.travelled_by_control),
    "odometry": (motion.odometry, motion.odometry_by_state, motion.odometry_by_control),
    "turn_after_move": (
        motion.turn_after_move,
        motion.turn_after_move_by_state,
        motion.turn_after_move_by_control,
    ),
    "DifferentialDrive": (WHEELS, WHEELS.by_state, WHEELS.by_control),
}
PAIRS = ("Velocity", "turn_after_move", "DifferentialDrive")  # whose controls have two components
every_model = pytest.mark.parametrize("name", MODELS)

coordinate = st.floats(-100.0, 100.0)
angle = st.floats(-20.0, 20.0)
states = st.tuples(coordinate, coordinate, angle).map(np.array)
speed = st.floats(-5.0, 5.0)
turn_rate = st.floats(-3.0, 3.0)
duration = st.floats(0.01, 2.0)
bends = st.sampled_from([-1.0, 1.0]).flatmap(lambda s: st.floats(0.1, 3.0).map(lambda w: s * w))


def arguments(name, seed=0, runs=(4, 25)):
    """Draw states and controls; every third control of a run has a component that is 0."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(*runs, 3)) * [3.0, 3.0, 6.0]
    u = rng.normal(size=(*runs, 2 if name in PAIRS else 3))
    u[..., ::3, 1] = 0.0
    u[..., 1::3, 1] *= 1e-6
    if name == "DifferentialDrive":  # straight where the others are
        u[..., 0] += u[..., 1]
    return x, u


def central_jacobian(function, at, step=1e-2):
    """Differentiate by the sixth-order central difference."""
    columns = []
    for move in np.eye(at.shape[-1]) * step:
        difference = [function(at + k * move) - function(at - k * move) for k in (1, 2, 3)]
        columns.append((45 * difference[0] - 9 * difference[1] + difference[2]) / (60 * step))
    return np.stack(columns, axis=-1)


@every_model
def test_jacobians_are_the_derivatives(name):
    function, by_state, by_control = MODELS[name]
    x, u = arguments(name)
    assert_allclose(by_state(x, u), central_jacobian(lambda s: function(s, u), x), atol=1e-10)
    assert_allclose(by_control(x, u), central_jacobian(lambda c: function(x, c), u), atol=1e-10)


@every_model
def test_a_batch_is_its_single_runs(name):
    x, u = arguments(name, seed=1)
    for function in MODELS[name]:
        batch = function(x, u)
        assert batch.dtype == np.float64
        assert batch.shape[:2] == (4, 25)
        for i in np.ndindex(4, 25):
            assert_allclose(batch[i], function(x[i], u[i]), rtol=1e-12, atol=1e-14)


@every_model
def test_arguments_are_left_alone(name):
    x, u = arguments(name)
    before = x.copy(), u.copy()
    for function in MODELS[name]:
        assert not np.shares_memory(function(x, u), x)
    assert_array_equal(x, before[0])
    assert_array_equal(u, before[1])


@every_model
def test_controls_that_all_runs_share_are_broadcast(name):
    x, u = arguments(name)
    shared = np.broadcast_to(u[:, :1], u.shape)
    for function in MODELS[name]:
        assert_array_equal(function(x, shared), function(x, shared.copy()))
        once = np.broadcast_to(u[0, 0], u.shape)
        assert_array_equal(function(x, once), function(x, once.copy()))


@every_model
def test_results_are_in_memory_as_states_are(name):
    """States whose runs are contiguous give results whose runs are."""
    x, u = arguments(name, runs=(40,))
    apart = x.copy(order="F")
    for function in MODELS[name]:
        assert function(apart, u).strides[0] == 8
        assert_array_equal(function(apart, u), function(x, u))


@every_model
def test_no_runs_give_no_states(name):
    x, u = arguments(name, runs=(0,))
    assert [f(x, u).shape for f in MODELS[name]] == [(0, 3), (0, 3, 3), (0, 3, u.shape[-1])]


@every_model
def test_whole_numbers_are_numbers(name):
    function, *_ = MODELS[name]
    x, u = np.array([[1, 2, 3]]), np.array([[1, 1, 1][: 2 if name in PAIRS else 3]])
    assert_array_equal(function(x, u), function(x.astype(float), u.astype(float)))


@every_model
@given(states, st.floats(-np.pi, np.pi), coordinate, coordinate)
def test_where_east_lies_does_not_matter(name, x, turn, east, north):
    """Moving and turning the map first, or the robot first, is the same."""
    function, *_ = MODELS[name]
    _, u = arguments(name, seed=2, runs=(2,))

    def on_new_map(x):
        p = (x[..., 0] + 1j * x[..., 1]) * np.exp(1j * turn) + complex(east, north)
        return np.stack([p.real, p.imag, x[..., 2] + turn], axis=-1)

    x = np.stack([x, x])
    assert_allclose(function(on_new_map(x), u), on_new_map(function(x, u)), atol=1e-11)


@every_model
def test_heading_is_not_wrapped(name):
    function, *_ = MODELS[name]
    x, u = arguments(name)
    turns = np.array([0.0, 0.0, 200 * np.pi])
    assert_allclose(function(x + turns, u), function(x, u) + turns, atol=1e-11)


@given(states, speed, bends, duration)
def test_velocity_is_the_textbook_arc(x, v, omega, dt):
    east, north, heading = x
    radius = v / omega
    textbook = [
        east - radius * np.sin(heading) + radius * np.sin(heading + omega * dt),
        north + radius * np.cos(heading) - radius * np.cos(heading + omega * dt),
        heading + omega * dt,
    ]
    assert_allclose(motion.velocity(x, np.array([v, omega, dt])), textbook, atol=1e-11)


@pytest.mark.parametrize("omega", [0.0, 1e-300, -1e-12, 1e-8, 1e-4, -0.03, 1.0, -7.0])
def test_velocity_integrates_the_motion(omega):
    v, dt, start = 1.7, 1.3, [4.0, -2.0, 2.5]
    driven = solve_ivp(
        lambda _, x: [v * np.cos(x[2]), v * np.sin(x[2]), omega],
        (0.0, dt),
        start,
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
    )
    reached = motion.velocity(np.array(start), np.array([v, omega, dt]))
    assert_allclose(reached, driven.y[:, -1], atol=1e-12)


@given(states, speed, st.floats(-1e-3, 1e-3), duration)
def test_velocity_is_continuous_at_no_turn(x, v, omega, dt):
    """An arc leaves its tangent by at most v ω Δt² / 2."""
    bent = motion.velocity(x, np.array([v, omega, dt]))
    straight = x + v * dt * np.array([np.cos(x[2]), np.sin(x[2]), 0.0])
    apart = np.hypot(*(bent - straight)[:2])
    assert apart <= 0.5 * abs(v * omega) * dt**2 + 1e-12


@given(states, speed, turn_rate, duration, duration)
def test_velocity_is_a_flow(x, v, omega, first, second):
    halfway = motion.velocity(x, np.array([v, omega, first]))
    whole = motion.velocity(x, np.array([v, omega, first + second]))
    assert_allclose(motion.velocity(halfway, np.array([v, omega, second])), whole, atol=1e-11)


@pytest.mark.parametrize("half", [0.0, 1e-12, 1e-6, 1e-3, 0.1, 0.249999, 0.25, 0.3, 1.0, 4.0])
def test_slope_by_turn_rate_keeps_its_digits(half):
    """The chord's slope is −j₁, a spherical Bessel function; the arc's course here is due east."""
    for a in (half, -half):
        jacobian = motion.velocity_by_control(np.array([0.0, 0.0, -a]), np.array([1.0, 2 * a, 1.0]))
        bessel = -np.sign(a) * spherical_jn(1, half)  # odd; scipy's keeps its digits for a > 0
        assert_allclose(jacobian[0, 1], 0.5 * bessel, rtol=2e-14)


def test_fixed_duration_is_a_given_duration():
    x, u = arguments("Velocity")
    longer = np.concatenate([u, np.full((*u.shape[:-1], 1), DRIVE.dt)], axis=-1)
    assert_array_equal(DRIVE(x, u), motion.velocity(x, longer))
    assert_array_equal(DRIVE.by_state(x, u), motion.velocity_by_state(x, longer))
    assert_array_equal(DRIVE.by_control(x, u), motion.velocity_by_control(x, longer)[..., :2])
    assert motion.Velocity(dt=0.3) == DRIVE


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf, "a", None])
def test_a_duration_that_is_none_is_refused(dt):
    with pytest.raises(ValueError, match="duration of a step"):
        motion.Velocity(dt=dt)
    with pytest.raises(ValueError, match="duration of a step"):
        motion.DifferentialDrive(radius=0.1, wheelbase=0.3, dt=dt)


@given(states, coordinate, coordinate, angle)
def test_increment_is_a_product_of_complex_numbers(x, forward, left, turn):
    place = complex(x[0], x[1]) + np.exp(1j * x[2]) * complex(forward, left)
    moved = motion.increment(x, np.array([forward, left, turn]))
    assert_allclose(moved, [place.real, place.imag, x[2] + turn], atol=1e-11)


@given(states, states, states)
def test_increments_associate(x, a, b):
    increment = motion.increment
    assert_allclose(increment(increment(x, a), b), increment(x, increment(a, b)), atol=1e-10)


@given(states, angle, speed, angle)
def test_odometry_is_turn_move_turn(x, rot1, trans, rot2):
    reached = x
    for step in ([0.0, 0.0, rot1], [trans, 0.0, 0.0], [0.0, 0.0, rot2]):
        reached = motion.increment(reached, np.array(step))
    assert_allclose(motion.odometry(x, np.array([rot1, trans, rot2])), reached, atol=1e-11)


@given(states, speed, angle)
def test_turn_after_move_is_an_increment(x, distance, turn):
    """Straight ahead by d, then the turn, is the step (d, 0, φ) of the robot's own frame."""
    reached = motion.increment(x, np.array([distance, 0.0, turn]))
    assert_allclose(motion.turn_after_move(x, np.array([distance, turn])), reached, atol=1e-11)


@pytest.mark.parametrize(("left", "right"), [(3.0, 5.0), (4.0, 4.0), (-2.0, 2.0), (5.0, -1.0)])
def test_wheels_roll_without_slip(left, right):
    """Each wheel's contact point, left or right of the axle's middle, rolls radius · ω · dt."""
    radius, base, dt = 0.1, 0.3, 1.7
    drive = motion.DifferentialDrive(radius=radius, wheelbase=base, dt=dt)

    def motions(_, x):
        tread = np.array([left, right]) * radius
        return [tread.mean() * np.cos(x[2]), tread.mean() * np.sin(x[2]), np.diff(tread)[0] / base]

    start = np.array([4.0, -2.0, 2.5])
    rolled = solve_ivp(motions, (0.0, dt), start, method="DOP853", rtol=1e-13, atol=1e-13)
    assert_allclose(drive(start, np.array([left, right])), rolled.y[:, -1], atol=1e-12)

    # The two wheels' own paths: their lengths are what the wheels have rolled.
    fine = motion.DifferentialDrive(radius=radius, wheelbase=base, dt=dt / 2000)
    path = [start]
    for _ in range(2000):
        path.append(fine(path[-1], np.array([left, right])))
    poses = np.array(path)
    for side, omega in ((1.0, left), (-1.0, right)):
        beside = np.exp(1j * (poses[:, 2] + side * np.pi / 2)) * base / 2
        wheel = poses[:, 0] + 1j * poses[:, 1] + beside
        assert_allclose(np.abs(np.diff(wheel)).sum(), abs(omega) * radius * dt, rtol=1e-6)


def test_equal_wheels_go_exactly_straight():
    drive = motion.DifferentialDrive(radius=0.1, wheelbase=0.3, dt=0.125)
    assert drive(np.zeros(3), np.array([7.3, 7.3]))[1:].tolist() == [0.0, 0.0]
    assert drive.velocity(np.array([-7.3, 7.3]))[0] == 0.0


@pytest.mark.parametrize("name", ["radius", "wheelbase"])
@pytest.mark.parametrize("value", [0.0, -0.1, np.nan, np.inf, "a", None, 1j, [0.1]])
def test_a_length_that_is_none_is_refused(name, value):
    with pytest.raises(ValueError, match=f"{name} is .* length above 0"):
        motion.DifferentialDrive(**{"radius": 0.1, "wheelbase": 0.3, "dt": 1.0} | {name: value})


@given(states, speed, st.floats(-0.3, 0.3), duration)
def test_travelled_takes_the_arc_for_its_chord(x, v, omega, dt):
    """Next to the exact arc it goes too far, by d (1 − sinc(φ / 2)), and in the right direction."""
    distance, turn = v * dt, omega * dt
    counted = motion.travelled(x, np.array([distance, turn, dt]))
    exact = motion.velocity(x, np.array([v, omega, dt]))
    excess = distance * (1.0 - np.sinc(turn / (2 * np.pi)))
    course = x[2] + turn / 2
    direction = np.array([np.cos(course), np.sin(course), 0.0])
    assert_allclose(counted - exact, excess * direction, atol=1e-12)


@given(states, speed, angle, duration, duration)
def test_travelled_does_not_need_the_duration(x, distance, turn, first, second):
    assert_array_equal(
        motion.travelled(x, np.array([distance, turn, first])),
        motion.travelled(x, np.array([distance, turn, second])),
    )


@pytest.mark.parametrize(
    ("recording", "flip", "rmse"), [("Plaza1_.mat", 0.0, 1.935), ("Plaza2_.mat", np.pi, 31.65)]
)
def test_travelled_is_the_recorded_dead_reckoning(recording, flip, rmse):
    """The last digit tells the mean heading (1.935, 31.65) from the exact arc (1.934, 31.64)."""
    gtsam = pytest.importorskip("gtsam", reason="the Plaza recordings come with the gtsam wheel")
    data = loadmat(gtsam.findExampleDataFile(recording))
    truth, rows = data["GT"], data["DR"]
    assert_array_equal(rows[:, 0], truth[1:, 0])
    controls = np.column_stack([rows[:, 1:], np.diff(truth[:, 0])])
    x = truth[:1, 1:] + [0.0, 0.0, flip]
    reckoned = [x]
    for u in controls[:, None]:
        reckoned.append(x := motion.travelled(x, u))
    error = np.concatenate(reckoned)[:, :2] - truth[:, 1:3]
    found = np.sqrt(np.mean(np.sum(error**2, axis=1)))
    assert float(f"{found:.4g}") == rmse
