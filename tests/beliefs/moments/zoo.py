"""Models and rules of all kinds, and recordings of a few runs that differ in everything."""

from functools import cache
from types import SimpleNamespace

import numpy as np
from robots import DRIVE, LANDMARKS, P0, SENSORS, Q, drive_along, drive_cpd, m, u, x
from textbooks import assert_belief, assert_log

import pgm
from pgm.evidence import Sightings

RUNS, T = 3, 8
SIGHT = SENSORS["range_bearing"]
bias = pgm.Variable("bias", components=("turn",))
command = pgm.Variable("command", components=u.components)
lost = pgm.Variable("lost", components=m.components)
seen = pgm.Variable("seen", components=SIGHT.z.components, angles=SIGHT.z.angles)
fix = pgm.Variable("fix", components=("east", "north"))
compass = pgm.Variable("compass", components=("heading",), angles=("heading",))
# Through exact and sharp sightings the textbook, and float64 online, keep fewer digits.
TOLERANCE = {"an exact range": 1e-8, "sharp readings": 1e-5}
# No step has more than two, and those of two landmarks: exact ones do not contradict each other.
STEP = np.array([0, 1, 1, 3, 4, 4, 5, 7, 7, 8])
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


def near_noise(landmark):
    return (0.02 + 0.01 * np.abs(landmark[..., 0, None, None])) * np.eye(2)


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


STARTS = np.array([[0.0, 0.0, 0.0], [0.5, -0.3, 0.4], [-1.0, 0.2, -0.1]])
SPREADS = np.array([0.5, 1.0, 2.0])[:, None, None] * P0
MODELS = {
    "plain": plain(),
    "numerical jacobians": plain(drive_cpd(jacobian=None), SIGHT.cpd(jacobian=None)),
    "wrapping drive": plain(drive_cpd(function=wrapping)),
    "noise by control": plain(drive_cpd(cov=pgm.noise(turning_noise, given=u))),
    "noise by landmark": plain(sensor=SIGHT.cpd(cov=pgm.noise(near_noise, given=m))),
    "grouped": plain(sensor=SIGHT.cpd(grouped=True)),
    "an exact range": plain(sensor=SIGHT.cpd(cov=np.diag([0.0, 0.01]))),
    "sharp readings": plain(sensor=SIGHT.cpd(cov=1e-9 * np.eye(2))),
    "a certain start": plain(prior=pgm.GaussianCPD(x, [0.0, 0.0, 0.0], np.diag([0.1, 0.0, 0.0]))),
    "a start for each run": plain(prior=pgm.GaussianCPD(x, STARTS, SPREADS)),
    "a motion without noise": plain(drive_cpd(cov=np.diag([0.01, 0.0, 0.0]))),
    "an unknown heading": plain(prior=pgm.GaussianCPD(x, [0, 0, 0], np.diag([0.1, 0.1, 9.0]))),
    "own lineariser": plain(sensor=SIGHT.cpd(lineariser=pgm.Cubature())),
    "everything": everything(),
}


def model_of(name, run=None):
    """The model of all runs, or of one alone, or of several."""
    if run is None or name != "a start for each run":
        return MODELS[name]
    return plain(prior=pgm.GaussianCPD(x, STARTS[run], SPREADS[run]))


def recording(name, runs=RUNS):
    """Evidence of a few runs, sightings at step 0 too, some of them missing; headings go round."""
    return dict(_recorded(name, runs))


@cache
def _recorded(name, runs):
    model, rng = MODELS[name], np.random.default_rng(5)
    given = np.stack([rng.uniform(0.5, 1.5, (runs, T)), rng.uniform(0.4, 0.9, (runs, T))], axis=-1)
    states = np.stack([drive_along(each, rng) for each in given])
    first = rng.integers(0, 2, (runs, STEP.size))
    first[:, 1:] = np.where(STEP[1:] == STEP[:-1], 1 - first[:, :-1], first[:, 1:])
    landmarks = LANDMARKS[first] + 0.1 * rng.normal(size=(runs, STEP.size, 2))
    noise = SIGHT.cov if name == "noise by landmark" else model.observation[0].cov
    exact = SIGHT.function(states[:, STEP], landmarks)
    values = exact + rng.multivariate_normal([0.0, 0.0], noise, exact.shape[:-1])
    values[..., 1] %= 2 * np.pi
    values[rng.random(values.shape[:2]) < 0.2] = np.nan
    values[rng.random(values.shape) < 0.1] = np.nan
    if name == "an exact range":  # two leave nothing of a place, and few digits
        values[:, 1:][:, STEP[1:] == STEP[:-1]] = np.nan
    found = {
        command if command in model.inputs else u: given,
        SIGHT.z: pgm.sightings(values, step=STEP, given={m: landmarks}),
    }
    if seen in model.sensors:
        found[seen] = SIGHT.draw(states[:, 1:], LANDMARKS[2], rng)
        close = LANDMARKS[2] + 0.1 * rng.normal(size=(runs, T, 2))
        found[fix] = np.where(rng.random((runs, T, 1)) < 0.5, np.nan, close)
        found[compass] = states[:, 1:, 2:] % (2 * np.pi)
    return found


def of_run(evidence, run):
    """The evidence of one run, without an axis of runs, or of several."""
    return {
        variable: pgm.sightings(
            given.values[run], given.step, {v: rows[run] for v, rows in given.given.items()}
        )
        if isinstance(given, Sightings)
        else given[run]
        for variable, given in evidence.items()
    }


def at_step(evidence, step):
    """The inputs and the readings of one step, as they are given online, of one run or many."""
    inputs, readings = {}, {}
    for variable, given in evidence.items():
        if not isinstance(given, Sightings):
            if variable in (u, command):
                if step:
                    inputs[variable] = given[..., step - 1, :]
            elif step:
                readings[variable] = given[..., step - 1, :]
            continue
        due = given.step == step
        if due.any():
            rows = {v: each[..., due, :] for v, each in given.given.items()}
            readings[variable] = pgm.sightings(given.values[..., due, :], given=rows)
    return inputs, readings


@cache
def smoothed(name, rule, run=None):
    """All runs, or one alone."""
    evidence = recording(name) if run is None else of_run(recording(name), run)
    return pgm.smooth(model_of(name, run), evidence, lineariser=RULES[rule])


def of(posterior, run=None, kinds=("predicted", "filtered", "smoothed")):
    """What is known of one run: {(kind, variable): (means, covariances)} and the log-evidence."""
    model, beliefs = posterior.graph.model, {}
    own = () if run is None else run
    for kind in kinds:
        marginals = posterior if kind == "smoothed" else getattr(posterior, kind)
        for variable in (*model.states, *model.controls):
            found = marginals[variable]
            beliefs[kind, variable] = found.mean[own], found.cov[own]
    return SimpleNamespace(beliefs=beliefs, log_evidence=posterior.log_evidence[own])


def assert_same(found, due, tolerance):
    assert found.beliefs.keys() == due.beliefs.keys()
    for key, (mean, cov) in found.beliefs.items():
        assert_belief(SimpleNamespace(mean=mean, cov=cov), *due.beliefs[key], tolerance)
    assert_log(found.log_evidence, due.log_evidence, tolerance)
