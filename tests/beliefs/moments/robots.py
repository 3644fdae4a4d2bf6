"""The robot of the tests: its variables, sensors, networks and drives, and the twin's share."""

import numpy as np
from textbooks import motion, reading, wrapped

import pgm
from models import sensors
from models.motion import Velocity

x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
u = pgm.Variable("u", components=("v", "omega"))
m = pgm.Variable("m", components=("east", "north"))

P0, Q = np.diag([0.2, 0.1, 0.05]), np.diag([0.02, 0.01, 0.005])
DRIVE = Velocity(dt=1.0)
LANDMARKS = np.array([[4.0, 9.0], [-3.0, 2.0], [8.0, -4.0]])
T = 40


class Sensor:
    """A reading with its function, its Jacobian, and what it is given besides the pose."""

    def __init__(self, components, angles, function, by_state, cov, sights=False):
        self.z = pgm.Variable("z", components=components, angles=angles)
        self.function, self.by_state, self.cov = function, by_state, np.asarray(cov)
        self.given = (x, m) if sights else (x,)

    def cpd(self, **changes):
        parts = {"function": self.function, "cov": self.cov, "jacobian": {x: self.by_state}}
        return pgm.NonlinearGaussianCPD(self.z, self.given, **(parts | changes))

    def seen(self, value, landmark):
        """The twin's reading."""
        known = (landmark,) if len(self.given) > 1 else ()

        def wide(state):
            return (np.broadcast_to(k, (*state.shape[:-1], 2)) for k in known)

        return reading(
            lambda state: self.function(state, *wide(state)),
            lambda state: self.by_state(state, *wide(state)),
            self.cov,
            value,
            self.z.angle_mask,
        )

    def draw(self, states, landmarks, rng):
        known = (np.broadcast_to(landmarks, (*states.shape[:-1], 2)),)
        value = self.function(states, *known[: len(self.given) - 1])
        noise = rng.multivariate_normal(np.zeros(self.z.dimension), self.cov, value.shape[:-1])
        return wrapped(value + noise, self.z.angle_mask)


SENSORS = {
    "position": Sensor(
        ("east", "north"), (), sensors.position, sensors.position_by_state, np.diag([0.2, 0.3])
    ),
    "pose": Sensor(
        x.components, x.angles, sensors.pose, sensors.pose_by_state, np.diag([0.2, 0.3, 0.02])
    ),
    "range_bearing": Sensor(
        ("range", "bearing"),
        ("bearing",),
        sensors.range_bearing,
        sensors.range_bearing_by_state,
        [[0.1, 0.005], [0.005, 0.01]],
        sights=True,
    ),
    "range_only": Sensor(
        ("range",), (), sensors.range_only, sensors.range_only_by_state, [[0.05]], sights=True
    ),
}


def drive_cpd(**changes):
    parts = {"function": DRIVE, "cov": Q, "jacobian": {x.previous: DRIVE.by_state}}
    return pgm.NonlinearGaussianCPD(x, (x.previous, u), **(parts | changes))


def network(*observation, transition=None, prior=None):
    return pgm.DynamicBayesianNetwork(
        prior=[prior or pgm.GaussianCPD(x, mean=[0, 0, 0], cov=P0)],
        transition=[transition or drive_cpd()],
        observation=observation,
    )


def controls(rng, steps=T):
    return np.column_stack([rng.uniform(0.5, 1.5, steps), rng.uniform(0.0, 0.35, steps)])


def drive_along(commands, rng, cov=Q):
    states = [rng.multivariate_normal(np.zeros(3), P0)]
    for command in commands:
        states.append(DRIVE(states[-1], command) + rng.multivariate_normal(np.zeros(3), cov))
    return np.array(states)


def moves(commands, cov=Q):
    return [
        motion(
            lambda s, c=c: DRIVE(s, np.broadcast_to(c, (*s.shape[:-1], 2))),
            lambda s, c=c: DRIVE.by_state(s, c),
            cov,
        )
        for c in commands
    ]


def sighted(runs=None, steps=12, seed=3):
    """Evidence of a drive, the same commands in all runs, with a sighting at most of its steps."""
    rng, sight = np.random.default_rng(seed), SENSORS["range_bearing"]
    commands = controls(rng, steps)
    states = np.stack([drive_along(commands, rng) for _ in range(runs or 1)])
    states = states[0] if runs is None else states
    when = np.arange(1, steps + 1)[rng.random(steps) < 0.8]
    where = LANDMARKS[rng.integers(0, 3, when.size)]
    values = sight.draw(states[..., when, :], where, rng)
    return {u: commands, sight.z: pgm.sightings(values, step=when, given={m: where})}
