"""A batch of runs gives what its single runs give; the online filter what the filter gives."""

import numpy as np
import pytest
from robots import (
    DRIVE,
    LANDMARKS,
    P0,
    SENSORS,
    Q,
    controls,
    drive_along,
    drive_cpd,
    m,
    network,
    u,
    x,
)
from textbooks import assert_belief, assert_log, assert_same

import pgm

T, RUNS = 12, 100
SIGHT = SENSORS["range_bearing"]
RULES = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "cubature": pgm.Cubature(),
    "monte carlo": pgm.MonteCarlo(40, seed=3),
}


def hidden_control_model():
    """Everything at once: noisy controls, an unknown landmark, a known one."""
    command = pgm.Variable("command", components=u.components)
    lost = pgm.Variable("lost", components=m.components)
    seen = pgm.Variable("seen", components=SIGHT.z.components, angles=SIGHT.z.angles)
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(x, [0, 0, 0], P0),
            pgm.GaussianCPD(lost, LANDMARKS[2], 0.3 * np.eye(2)),
        ],
        transition=[
            pgm.LinearGaussianCPD(u, {command: 1.0}, cov=0.01 * np.eye(2)),
            drive_cpd(jacobian=None),
            pgm.LinearGaussianCPD(lost, {lost.previous: 1.0}, cov=np.zeros((2, 2))),
        ],
        observation=[
            SIGHT.cpd(jacobian=None),
            pgm.NonlinearGaussianCPD(seen, (x, lost), SIGHT.function, SIGHT.cov),
        ],
    )


class Recording:
    """Runs of a model: evidence of all of them, of one of them, and of one step of them."""

    def __init__(self, hidden):
        rng = np.random.default_rng(31)
        self.model = hidden_control_model() if hidden else network(SIGHT.cpd())
        self.drive = self.model.inputs[0] if hidden else u
        assert self.drive.name in ("command", "u")
        self.commands = np.stack([controls(rng, T) for _ in range(RUNS)])
        states = np.stack([drive_along(each, rng) for each in self.commands])
        self.step = np.sort(rng.integers(0, T + 1, 20))
        self.landmarks = LANDMARKS[rng.integers(0, 2, 20)]
        self.values = SIGHT.draw(states[:, self.step], self.landmarks, rng)
        self.values[rng.random((RUNS, 20)) < 0.1] = np.nan
        self.second = SIGHT.draw(states[:, 1:], LANDMARKS[2], rng) if hidden else None

    def evidence(self, run=slice(None)):
        rows = pgm.sightings(self.values[run], step=self.step, given={m: self.landmarks})
        result = {self.drive: self.commands[run], SIGHT.z: rows}
        if self.second is not None:
            result[self.model.sensors[1]] = self.second[run]
        return result

    def update(self, step, run=slice(None)):
        rows = self.step == step
        given = {m: self.landmarks[rows]}
        result = {SIGHT.z: pgm.sightings(self.values[run][..., rows, :], given=given)}
        if self.second is not None and step:
            result[self.model.sensors[1]] = self.second[run][..., step - 1, :]
        return result


@pytest.fixture(scope="module", params=[False, True], ids=["robot", "hidden control"])
def recording(request):
    return Recording(request.param)


def run_of(gaussian, run):
    return gaussian.mean[run], gaussian.cov[run]


def infer(kind, recording, run, rule):
    if kind == "filter":
        return pgm.filter(recording.model, recording.evidence(run), lineariser=rule)
    schedule = {"iterations": 4, "tolerance": 0.0} if kind == "iterated" else {}
    return pgm.smooth(recording.model, recording.evidence(run), lineariser=rule, **schedule)


@pytest.mark.parametrize("kind", ["filter", "smooth", "iterated"])
@pytest.mark.parametrize("rule", RULES)
def test_a_batch_gives_what_single_runs_give(recording, kind, rule):
    every = 1 if rule == "taylor" and kind != "iterated" else 11
    batch = infer(kind, recording, slice(None), RULES[rule])
    hidden = [*recording.model.states, *recording.model.controls]
    for run in range(0, RUNS, every):
        single = infer(kind, recording, run, RULES[rule])
        for variable in hidden:
            assert_belief(single[variable], *run_of(batch[variable], run))
        assert_log(single.log_evidence, batch.log_evidence[run])


def test_iterating_to_convergence_stops_each_run_by_itself(recording):
    """A run that is done waits unchanged for the others."""
    batch = pgm.smooth(recording.model, recording.evidence(), iterations=40)
    iterations = set()
    for run in range(0, RUNS, 9):
        single = pgm.smooth(recording.model, recording.evidence(run), iterations=40)
        iterations.add(single.status.iterations)
        assert batch.status.converged[run] == single.status.converged
        assert_belief(single[x], *run_of(batch[x], run), 1e-8)
        assert_log(single.log_evidence, batch.log_evidence[run])
    assert len(iterations) > 1, "all runs took equally long: the test says nothing"


def test_runs_may_have_any_leading_axes_and_broadcast():
    recording = Recording(False)
    evidence = recording.evidence()
    flat = pgm.smooth(recording.model, evidence)
    rows = evidence[SIGHT.z]
    square = {
        u: recording.commands.reshape(10, 10, T, 2),
        SIGHT.z: pgm.sightings(rows.values.reshape(10, 10, 20, 2), rows.step, rows.given),
    }
    folded = pgm.smooth(recording.model, square)
    assert folded[x].mean.shape == (10, 10, T + 1, 3)
    assert_belief(
        folded[x],
        flat[x].mean.reshape(10, 10, T + 1, 3),
        flat[x].cov.reshape(10, 10, T + 1, 3, 3),
        0.0,
    )
    crossed = {
        u: recording.commands[:4, None],
        SIGHT.z: pgm.sightings(rows.values[:3], rows.step, rows.given),
    }
    posterior = pgm.smooth(recording.model, crossed)
    assert posterior[x].mean.shape == (4, 3, T + 1, 3)
    assert_belief(
        pgm.Gaussian(x, *run_of(posterior[x], (2, 2))),
        *run_of(flat[x], 2),
    )
    one = pgm.smooth(recording.model, recording.evidence(slice(0, 1)))
    assert one[x].mean.shape == (1, T + 1, 3)


def test_landmarks_may_differ_by_run_too():
    """Shared readings with landmarks of each run, and the other way round."""
    recording = Recording(False)
    values, step = np.nan_to_num(recording.values[0], nan=1.0), recording.step
    wide = recording.landmarks + np.random.default_rng(2).normal(size=(5, 20, 2)) * 0.1
    evidence = {u: recording.commands[0]}
    batch = pgm.smooth(
        recording.model, evidence | {SIGHT.z: pgm.sightings(values, step=step, given={m: wide})}
    )
    assert batch[x].mean.shape == (5, T + 1, 3)
    for run in range(5):
        rows = pgm.sightings(values, step=step, given={m: wide[run]})
        single = pgm.smooth(recording.model, evidence | {SIGHT.z: rows})
        assert_belief(single[x], *run_of(batch[x], run))
        assert_log(single.log_evidence, batch.log_evidence[run])


@pytest.mark.parametrize("rule", RULES)
def test_the_online_filter_is_the_filter(recording, rule):
    filtered = pgm.filter(recording.model, recording.evidence(), lineariser=RULES[rule])
    robot = pgm.OnlineFilter(recording.model, lineariser=RULES[rule])
    belief = robot.initial()
    logs = []
    for step in range(T + 1):
        if step:
            belief = robot.predict(belief, {recording.drive: recording.commands[:, step - 1]})
            for state in recording.model.states:
                due = filtered.predicted[state.at(step)]
                assert_belief(belief[state], due.mean, due.cov)
        belief = robot.update(belief, recording.update(step))
        assert belief.step == step
        for variable in (*recording.model.states, *recording.model.controls):
            if step or variable in recording.model.states:
                due = filtered[variable.at(step)]
                found = belief[variable]
                assert_belief(
                    found,
                    np.broadcast_to(due.mean, found.mean.shape),
                    np.broadcast_to(due.cov, found.cov.shape),
                )
        logs.append(belief.log_evidence)
    assert_log(logs[-1], filtered.log_evidence)


def test_the_online_filter_with_one_run(recording):
    """No leading axes at all, as in a robot's loop."""
    filtered = pgm.filter(recording.model, recording.evidence(5))
    robot = pgm.OnlineFilter(recording.model)
    belief = robot.update(robot.initial(), recording.update(0, 5))
    for step in range(1, T + 1):
        belief = robot.predict(belief, {recording.drive: recording.commands[5, step - 1]})
        belief = robot.update(belief, recording.update(step, 5))
    assert belief[x].mean.shape == (3,)
    assert_same(belief[x], filtered[x.at(T)])
    assert_log(belief.log_evidence, filtered.log_evidence)
    assert belief.log_evidence.shape == ()


def test_online_updates_with_nothing_change_nothing():
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    for nothing in (
        {},
        {SIGHT.z: pgm.sightings(np.zeros((0, 2)), given={m: np.zeros((0, 2))})},
        {SIGHT.z: pgm.sightings([[np.nan, np.nan]], given={m: LANDMARKS[:1]})},
    ):
        after = robot.update(belief, nothing)
        assert_same(after[x], belief[x], 0.0)
        assert after.log_evidence == belief.log_evidence
        assert after.step == belief.step == 1


def test_a_second_online_update_linearises_at_the_first_ones_posterior():
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    one, two = (
        {SIGHT.z: pgm.sightings([value], given={m: [LANDMARKS[k]]})}
        for k, value in enumerate(([8.0, 1.0], [4.5, 2.5]))
    )
    first = robot.update(belief, one)
    again = network(
        SIGHT.cpd(), prior=pgm.GaussianCPD(x, first[x].mean, first[x].cov), transition=drive_cpd()
    )
    second = robot.update(first, two)
    fresh = pgm.OnlineFilter(again)
    due = fresh.update(fresh.initial(), two)
    assert_same(second[x], due[x])
    assert_log(second.log_evidence, first.log_evidence + due.log_evidence)
    together = {
        SIGHT.z: pgm.sightings([[8.0, 1.0], [4.5, 2.5]], given={m: LANDMARKS[:2]}),
    }
    at_once = robot.update(belief, together)
    assert np.abs(at_once[x].mean - second[x].mean).max() > 1e-6


def test_online_beliefs_and_filters_are_values():
    robot = pgm.OnlineFilter(network(SIGHT.cpd()))
    start = robot.initial()
    kept = start[x].mean.copy(), start[x].cov.copy()
    left = robot.predict(start, {u: [1.0, 0.5]})
    right = robot.predict(start, {u: [1.0, -0.5]})
    assert_belief(start[x], *kept, 0.0)
    assert left[x].mean[2] == pytest.approx(0.5)
    assert right[x].mean[2] == pytest.approx(-0.5)
    for value, name in ((robot, "model"), (start, "step")):
        with pytest.raises(AttributeError):
            setattr(value, name, None)
    with pytest.raises(ValueError, match="read-only"):
        start[x].mean[0] = 1.0


def test_online_with_a_prior_for_each_run():
    starts = np.random.default_rng(0).normal(size=(5, 3))
    model = network(SIGHT.cpd(), prior=pgm.GaussianCPD(x, starts, P0))
    robot = pgm.OnlineFilter(model)
    belief = robot.predict(robot.initial(), {u: [1.0, 0.1]})
    due = pgm.filter(model, {u: [[1.0, 0.1]]})
    assert_same(belief[x], due[x.at(1)])
    assert belief[x].mean.shape == (5, 3)


def test_online_noise_that_depends_on_the_control():
    def driven(c):
        return (0.01 + np.abs(c[..., 0, None, None])) * np.eye(3)

    cpd = pgm.NonlinearGaussianCPD(x, (x.previous, u), DRIVE, pgm.noise(driven, given=u))
    model = network(transition=cpd)
    robot = pgm.OnlineFilter(model)
    belief = robot.initial()
    commands = [[1.0, 0.1], [0.5, -0.2], [2.0, 0.0]]
    for command in commands:
        belief = robot.predict(belief, {u: command})
    due = pgm.filter(model, {u: commands})
    assert_same(belief[x], due[x.at(3)])
    assert (np.diagonal(belief[x].cov) > np.diagonal(Q)).all()
