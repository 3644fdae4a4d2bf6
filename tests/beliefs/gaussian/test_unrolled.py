"""Dynamic networks unrolled: on any graph of clusters they give what the smoother gives."""

import numpy as np
import pytest
from crossed import crossed
from robots import DRIVE, LANDMARKS, P0, SENSORS, drive_cpd, m, network, u, x

import pgm
from models import sensors

T = 8
RANGE, FIX = SENSORS["range_bearing"], SENSORS["position"]
Z = RANGE.z
POSITION = pgm.Variable("fix", components=("east", "north"))
RULES = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "monte carlo": pgm.MonteCarlo(12, seed=5),
}
rules = pytest.mark.parametrize("rule", RULES.values(), ids=RULES.keys())


# ---- evidence and graphs


def flat(evidence, steps=T):
    """Give plain arrays of steps 1..T to the variables of an unrolled network."""
    return {v.at(k + 1): value[..., k, :] for v, value in evidence.items() for k in range(steps)}


def junction_tree(net, states, steps):
    return pgm.compile(net)


def pairs(net, states, steps):
    """Clusters of two transitions each, and every sensor in a cluster of its own."""
    last = steps - steps % 2
    made = [
        {s.at(k + i) for s in states for i in range(3) if k + i <= steps}
        for k in range(0, max(last, 1), 2)
    ]
    if steps % 2:
        made.append({s.at(k) for s in states for k in (steps - 1, steps)})
    return by_hand(net, states, made)


def triples(net, states, steps):
    """Windows of four states that overlap in three."""
    return by_hand(
        net, states, [{s.at(k + i) for s in states for i in range(4)} for k in range(steps - 2)]
    )


def by_hand(net, states, made):
    """Each further family is put where its states are, or beside it."""
    hubs = [set(cluster) for cluster in made]
    for cpd in net.cpds:
        family = set(cpd.scope)
        if any(family <= hub for hub in hubs):
            continue
        inside = {v for v in family if v.template in states}
        home = next(k for k, cluster in enumerate(made) if inside <= cluster)
        if cpd.child.template in states:
            hubs[home] |= family
        else:
            hubs.append(family)
    return pgm.ClusterGraph(net, hubs)


GRAPHS = {"junction tree": junction_tree, "pairs": pairs, "triples": triples}
graphs = pytest.mark.parametrize("graph", GRAPHS.values(), ids=GRAPHS.keys())


def assert_same(found, due, states, steps=T, close=1e-9, wrap=False):
    """Means by standard deviations, covariances, neighbours' joints, log-evidence."""
    for s in states:
        for k in range(steps + 1):
            a, b = found[s.at(k)], due[s.at(k)]
            off = a.mean - b.mean
            if wrap:
                turns = np.round(off / (2 * np.pi))
                off = off - 2 * np.pi * turns * s.angle_mask
            np.testing.assert_array_less(np.abs(off), close * b.std + 1e-12)
            unit = b.std[..., :, None] * b.std[..., None, :]
            np.testing.assert_array_less(np.abs(a.cov - b.cov), close * unit + 1e-14)
        for k in range(steps):
            a, b = found.joint(s.at(k), s.at(k + 1)), due.joint(s.at(k), s.at(k + 1))
            unit = b.std[..., :, None] * b.std[..., None, :]
            np.testing.assert_array_less(np.abs(a.cov - b.cov), close * unit + 1e-14)
    np.testing.assert_allclose(found.log_evidence, due.log_evidence, rtol=close, atol=close)
    assert found.log_evidence_kind == due.log_evidence_kind


# ---- a linear robot


def linear_model():
    p, v, c = pgm.Variable("p", ("a", "b")), pgm.Variable("v", ("a", "b")), pgm.Variable("c")
    z, w = pgm.Variable("z"), pgm.Variable("w", ("a", "b"))
    model = pgm.DynamicBayesianNetwork(
        prior=[
            pgm.GaussianCPD(p, [1.0, -2.0], np.diag([2.0, 3.0])),
            pgm.LinearGaussianCPD(v, {p: [[0.1, 0.0], [0.3, 0.2]]}, cov=0.3 * np.eye(2)),
        ],
        transition=[
            pgm.LinearGaussianCPD(
                p,
                {p.previous: np.eye(2), v.previous: 0.5 * np.eye(2)},
                offset=[0.1, 0.2],
                cov=[[0.02, 0.01], [0.01, 0.05]],
            ),
            pgm.LinearGaussianCPD(
                v, {v.previous: 0.9 * np.eye(2), c: [[1.0], [0.5]]}, cov=0.1 * np.eye(2)
            ),
        ],
        observation=[
            pgm.LinearGaussianCPD(z, {p: [[1.0, 0.3]], v: [[0.0, 0.2]]}, cov=0.4),
            pgm.LinearGaussianCPD(w, {p: np.eye(2)}, cov=np.diag([0.2, 0.5])),
        ],
    )
    return model, (p, v), c, (z, w)


@graphs
@pytest.mark.parametrize("runs", [(), (2, 3)])
def test_a_linear_robot(graph, runs):
    model, states, c, seen = linear_model()
    rng = np.random.default_rng(1)
    sample = model.sample({c: rng.normal(size=(T, 1))}, runs=runs, rng=rng)
    evidence = {c: rng.normal(size=(T, 1))} | {z: sample[z] for z in seen}
    found = pgm.infer(graph(model.unroll(T), states, T), flat(evidence))
    due = pgm.smooth(model, evidence)
    assert_same(found, due, states)
    assert found.log_evidence_kind == "exact"
    assert found.status.converged.all()
    for each in states:
        for other in states:
            a, b = found.joint(each.at(2), other.at(7)), due.joint(each.at(2), other.at(7))
            np.testing.assert_allclose(a.cov, b.cov, atol=1e-9)
            np.testing.assert_allclose(a.mean, b.mean, atol=1e-9)


def test_readings_that_are_left_out():
    """What a smoother knows as a row of NaN is a variable without evidence here."""
    model, states, c, (z, _) = linear_model()
    rng = np.random.default_rng(2)
    control = rng.normal(size=(T, 1))
    sample = model.sample({c: control}, rng=rng)
    taken = rng.random(T) < 0.4
    rows = np.where(taken[:, None], sample[z], np.nan)
    due = pgm.smooth(model, {c: control, z: rows})
    evidence = flat({c: control})
    evidence |= {z.at(k + 1): sample[z][k] for k in range(T) if taken[k]}
    found = pgm.infer(pgm.compile(model.unroll(T)), evidence)
    assert_same(found, due, states)
    unseen = int(np.flatnonzero(~taken)[0]) + 1
    predicted = found[z.at(unseen)]
    at = due.joint(*(s.at(unseen) for s in states))
    row = np.array([[1.0, 0.3, 0.0, 0.2]])
    np.testing.assert_allclose(predicted.mean, row @ at.mean, atol=1e-9)
    np.testing.assert_allclose(predicted.cov, row @ at.cov @ row.T + 0.4, atol=1e-9)


# ---- the robot of the design's first program


def robot(*, transition=None, observation=None, turn=0.3, runs=(), seed=0, prior=None, steps=T):
    model = network(
        *(observation or (RANGE.cpd(),)), transition=transition or drive_cpd(), prior=prior
    )
    rng = np.random.default_rng(seed)
    controls = np.column_stack([rng.uniform(0.5, 1.5, steps), np.full(steps, turn)])
    landmarks = LANDMARKS[rng.integers(0, 3, steps)]
    known = {u: controls, m: landmarks}
    sample = model.sample(known, runs=runs, rng=rng)
    return model, known | {z: sample[z] for z in model.sensors}


FIXED = {"iterations": 60, "tolerance": 1e-11}


@graphs
@rules
def test_the_fixed_points_of_relinearisation_are_the_same(graph, rule):
    """From different first linearisations: the filter's, and the prior predictive."""
    model, evidence = robot()
    due = pgm.smooth(model, evidence, lineariser=rule, **FIXED)
    found = pgm.infer(
        graph(model.unroll(T), (x,), T),
        flat(evidence),
        lineariser=rule,
        schedule=pgm.Calibration(**FIXED),
    )
    assert found.status.converged.all()
    assert due.status.converged.all()
    assert_same(found, due, (x,))
    assert found.log_evidence_kind == ("laplace" if rule == pgm.Taylor() else "linearised")


@graphs
@rules
@pytest.mark.parametrize("runs", [(), (3,)])
def test_one_linearisation_at_a_start_is_the_same(graph, rule, runs):
    """At any start, with a covariance of zero."""
    model, evidence = robot(runs=runs, seed=3)
    rng = np.random.default_rng(9)
    path = [np.zeros(3)]
    for control in evidence[u]:
        path.append(DRIVE(path[-1], control))
    start = np.array(path) + 0.3 * rng.normal(size=(*runs, T + 1, 3))
    due = pgm.smooth(model, evidence, lineariser=rule, start={x: start})
    found = pgm.infer(
        graph(model.unroll(T), (x,), T),
        flat(evidence),
        lineariser=rule,
        start={x.at(k): start[..., k, :] for k in range(T + 1)},
    )
    assert_same(found, due, (x,))
    assert found.status.iterations == 1
    assert not found.status.converged.any()
    assert found.log_evidence_kind == "linearised"


@graphs
def test_a_lineariser_for_each_cpd(graph):
    sights = RANGE.cpd(lineariser=pgm.Cubature())
    fixes = pgm.NonlinearGaussianCPD(POSITION, x, sensors.position, np.diag([0.2, 0.3]))
    model, evidence = robot(
        transition=drive_cpd(lineariser=pgm.Unscented()), observation=(sights, fixes)
    )
    due = pgm.smooth(model, evidence, lineariser=pgm.MonteCarlo(14), **FIXED)
    net = model.unroll(T)
    found = pgm.infer(
        graph(net, (x,), T),
        flat(evidence),
        lineariser=pgm.MonteCarlo(14),
        schedule=pgm.Calibration(**FIXED),
    )
    assert_same(found, due, (x,))


@pytest.mark.parametrize("jacobians", [True, False])
@graphs
def test_given_jacobians_and_noise_that_depends_on_controls(graph, jacobians):
    def spread(control):
        return control[..., :1, None] ** 2 * 0.01 * np.eye(3)

    given = {x.previous: DRIVE.by_state} if jacobians else None
    model, evidence = robot(
        transition=drive_cpd(cov=pgm.noise(spread, given=(u,)), jacobian=given),
        observation=(RANGE.cpd(**({} if jacobians else {"jacobian": None})),),
    )
    due = pgm.smooth(model, evidence, **FIXED)
    found = pgm.infer(
        graph(model.unroll(T), (x,), T), flat(evidence), schedule=pgm.Calibration(**FIXED)
    )
    assert_same(found, due, (x,), close=1e-9 if jacobians else 1e-7)


@crossed(("rule", "graph"), RULES, GRAPHS)
def test_controls_with_noise_are_hidden(graph, rule):
    """A command is known, what the wheels make of it is not."""
    command = pgm.Variable("command", ("v", "omega"))
    slip = pgm.LinearGaussianCPD(u, {command: np.eye(2)}, cov=np.diag([0.02, 0.01]))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0, 0, 0], P0)],
        transition=[slip, drive_cpd()],
        observation=[RANGE.cpd()],
    )
    rng = np.random.default_rng(4)
    known = {
        command: np.column_stack([np.ones(T), np.full(T, 0.3)]),
        m: LANDMARKS[np.arange(T) % 3],
    }
    evidence = known | {Z: model.sample(known, rng=rng)[Z]}
    due = pgm.smooth(model, evidence, lineariser=rule, **FIXED)
    found = pgm.infer(
        graph(model.unroll(T), (x,), T),
        flat(evidence),
        lineariser=rule,
        schedule=pgm.Calibration(**FIXED),
    )
    close = 1e-9
    assert_same(found, due, (x,), close=close)
    for k in range(1, T + 1):
        a, b = found[u.at(k)], due[u.at(k)]
        np.testing.assert_array_less(np.abs(a.mean - b.mean), close * b.std)
        np.testing.assert_allclose(a.cov, b.cov, atol=close * b.cov.max())
        a, b = found.joint(u.at(k), x.at(k)), due.joint(u.at(k), x.at(k))
        np.testing.assert_allclose(a.cov, b.cov, atol=close * b.cov.max())


# ---- angles


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


@crossed(("turns", "rule", "graph"), ["as read", "wrapped", "any"], RULES, GRAPHS)
def test_a_robot_that_turns_round_and_round(graph, rule, turns):
    """Nearly half a turn a step, bearings on both sides of the seam, in any count of turns."""
    model, evidence = robot(turn=2.4, seed=8)
    if turns != "as read":
        seen = evidence[Z].copy()
        seen[:, 1] = wrapped(seen[:, 1])
        if turns == "any":
            seen[:, 1] += 2 * np.pi * np.random.default_rng(0).integers(-3, 4, T)
        evidence = evidence | {Z: seen}
    due = pgm.smooth(model, evidence, lineariser=rule, **FIXED)
    found = pgm.infer(
        graph(model.unroll(T), (x,), T),
        flat(evidence),
        lineariser=rule,
        schedule=pgm.Calibration(**FIXED),
    )
    assert due[x].mean[-1, 2] > 4 * np.pi
    assert_same(found, due, (x,))


@graphs
def test_a_motion_that_wraps_its_heading(graph):
    """Each heading is on a chart of its own; but for whole turns the beliefs are the same."""

    def drive(pose, control):
        moved = DRIVE(pose, control)
        return np.concatenate([moved[..., :2], wrapped(moved[..., 2:])], axis=-1)

    plain, evidence = robot(turn=2.4, seed=8)
    model = network(
        RANGE.cpd(), transition=pgm.NonlinearGaussianCPD(x, (x.previous, u), drive, drive_cpd().cov)
    )
    due = pgm.smooth(plain, evidence, **FIXED)
    found = pgm.infer(
        graph(model.unroll(T), (x,), T), flat(evidence), schedule=pgm.Calibration(60, 1e-8)
    )
    assert_same(found, due, (x,), close=1e-6, wrap=True)


def test_a_start_on_another_chart():
    """A start whose headings are wrapped means the same poses."""
    model, evidence = robot(turn=2.4, seed=8)
    due = pgm.smooth(model, evidence, **FIXED)
    start = due[x].mean.copy()
    start[:, 2] = wrapped(start[:, 2])
    found = pgm.infer(
        pgm.compile(model.unroll(T)),
        flat(evidence),
        schedule=pgm.Calibration(**FIXED),
        start={x.at(k): start[k] for k in range(T + 1)},
    )
    assert_same(found, due, (x,), wrap=True)


# ---- batches, loops


@rules
def test_a_batch_is_its_single_runs(rule):
    """Runs that have converged stay as they are while others are linearised anew."""
    model, evidence = robot(runs=(2, 2), seed=6)
    net = pgm.compile(model.unroll(T))
    schedule = pgm.Calibration(30, 1e-8)
    found = pgm.infer(net, flat(evidence), lineariser=rule, schedule=schedule)
    counts = []
    for run in np.ndindex(2, 2):
        alone = pgm.infer(
            net,
            flat(evidence | {Z: evidence[Z][run]}),
            lineariser=rule,
            schedule=schedule,
        )
        counts.append(alone.status.iterations)
        for k in range(T + 1):
            np.testing.assert_allclose(found[x.at(k)].mean[run], alone[x.at(k)].mean, rtol=1e-12)
            np.testing.assert_allclose(
                found[x.at(k)].cov[run], alone[x.at(k)].cov, rtol=1e-10, atol=1e-14
            )
        assert found.log_evidence[run] == pytest.approx(alone.log_evidence, rel=1e-12)
        assert found.status.converged[run] == alone.status.converged
    assert found.status.iterations == max(counts)
    assert found.status.residuals.shape == (max(counts) - 1, 2, 2)


@pytest.mark.parametrize("kind", [pgm.Flooding, pgm.Sequential])
def test_loopy_schedules_on_a_tree_reach_the_same_fixed_point(kind):
    model, evidence = robot()
    due = pgm.smooth(model, evidence, **FIXED)
    graph = pairs(model.unroll(T), (x,), T)
    found = pgm.infer(graph, flat(evidence), schedule=kind(tolerance=1e-11))
    assert found.status.converged
    assert found.graph.is_tree
    for k in range(T + 1):
        b = due[x.at(k)]
        np.testing.assert_array_less(np.abs(found[x.at(k)].mean - b.mean), 1e-9 * b.std)
        np.testing.assert_allclose(found[x.at(k)].cov, b.cov, atol=1e-9 * b.cov.max())
    assert found.log_evidence == pytest.approx(due.log_evidence, rel=1e-9)
    assert found.log_evidence_kind == "laplace"
