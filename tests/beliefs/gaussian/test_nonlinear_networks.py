"""Networks with nonlinear CPDs: where they are linearised, and what iterating comes to."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from crossed import crossed, slow_after
from dense import linear_joint
from gaussian.loops import bent, draw_evidence, random_network, steepest
from scipy.optimize import least_squares

import pgm
from models.sensors import range_bearing
from pgm.linearisers import Points, StatisticalRegression

a = pgm.Variable("a")
b = pgm.Variable("b", ("b0", "b1"))
c = pgm.Variable("c")
d = pgm.Variable("d", ("d0", "d1"))
e = pgm.Variable("e")
NOISE = {a: [[0.8]], b: [[0.3, 0.1], [0.1, 0.2]], c: [[0.1]], d: 0.2 * np.eye(2), e: [[0.05]]}


def to_b(x):
    return np.concatenate([np.sin(x), 0.3 * x**2 + x], axis=-1)


def to_c(x):
    return np.exp(0.4 * x) - 0.2 * x


def to_d(x, y):
    """Depends on two parents with a common cause."""
    return np.stack([x[..., 0] * y[..., 0], np.cos(x[..., 1]) + 0.5 * y[..., 0] ** 2], axis=-1)


def to_e(x):
    return np.tanh(x[..., :1] + 0.4 * x[..., 1:])


GIVEN = {a: (), b: (a,), c: (a,), d: (b, c), e: (d,)}
FUNCTIONS = {b: to_b, c: to_c, d: to_d, e: to_e}


def diamond():
    cpds = [pgm.GaussianCPD(a, 0.4, NOISE[a])]
    cpds += [pgm.NonlinearGaussianCPD(v, GIVEN[v], f, NOISE[v]) for v, f in FUNCTIONS.items()]
    return pgm.BayesianNetwork(cpds)


NET = diamond()
EVIDENCE = {e: 0.9, c: 1.4}


def hand_made(net):
    """Another tree than the junction tree: larger clusters."""
    return pgm.ClusterGraph(net, [{a, b, c}, {b, c, d}, {d, e}])


graphs = pytest.mark.parametrize("graph", [pgm.compile, hand_made], ids=["junction tree", "hand"])


# ---- twins


def jacobian(function, x, step=1e-5):
    columns = [
        (function(x + step * unit) - function(x - step * unit)) / (2 * step)
        for unit in np.eye(x.size)
    ]
    return np.stack(columns, axis=-1)


def taylor(function, mean, cov):
    F = jacobian(function, mean)
    return F, function(mean) - F @ mean, 0.0


def unscented(function, mean, cov):
    """The textbook's, λ = n − 1 and β = 2."""
    n = mean.size
    root = np.linalg.cholesky((2 * n - 1) * cov)
    points = np.vstack([mean, mean + root.T, mean - root.T])
    weights = np.full(2 * n + 1, 0.5 / (2 * n - 1))
    weights[0] = (n - 1) / (2 * n - 1)
    spread = weights.copy()
    spread[0] += 3 - (2 * n - 1) / n
    values = np.array([function(point) for point in points])
    middle = weights @ values
    cross = np.einsum("k,ki,kj->ij", spread, points - mean, values - middle)
    own = np.einsum("k,ki,kj->ij", spread, values - middle, values - middle)
    F = np.linalg.solve(cov, cross).T
    return F, middle - F @ mean, own - F @ cov @ F.T


def cubature(function, mean, cov):
    n = mean.size
    root = np.linalg.cholesky(n * cov)
    points = np.vstack([mean + root.T, mean - root.T])
    values = np.array([function(point) for point in points])
    middle = values.mean(axis=0)
    F = np.linalg.solve(cov, (points - mean).T @ (values - middle) / (2 * n)).T
    own = (values - middle).T @ (values - middle) / (2 * n)
    return F, middle - F @ mean, own - F @ cov @ F.T


RULES = {
    "taylor": (pgm.Taylor(), taylor),
    "unscented": (pgm.Unscented(), unscented),
    "cubature": (pgm.Cubature(), cubature),
}
rules = pytest.mark.parametrize(("rule", "twin"), RULES.values(), ids=RULES.keys())


def bound(v, evidence, parents):
    """A function of the stacked hidden parents alone."""

    def function(x):
        start, given = 0, []
        for parent in parents:
            if parent in evidence:
                given.append(np.atleast_1d(evidence[parent]))
            else:
                given.append(x[start : start + parent.dimension])
                start += parent.dimension
        return FUNCTIONS[v](*given)

    return function


def twin_pass(twin, evidence, at=None):
    """Linearise in topological order at the moments of a dense joint, then condition.

    `at` gives moments of stacked parents in place of those of the prior.
    """
    nodes = [(a, {}, [0.4], np.array(NOISE[a]))]
    for v in FUNCTIONS:
        hidden = [p for p in GIVEN[v] if p not in evidence]
        if at is not None:
            moments = at(hidden)
        else:
            moments = linear_joint(nodes).marginal(*hidden) if hidden else (np.zeros(0), None)
        if hidden:
            F, shift, extra = twin(bound(v, evidence, GIVEN[v]), *moments)
        else:
            F, extra = np.zeros((v.dimension, 0)), 0.0
            shift = bound(v, evidence, GIVEN[v])(np.zeros(0))
        blocks, start = {}, 0
        for p in hidden:
            blocks[p] = F[:, start : start + p.dimension]
            start += p.dimension
        nodes.append((v, blocks, shift, np.array(NOISE[v]) + extra))
    return linear_joint(nodes).given(evidence)


def assert_twin(found, twin, evidence, close):
    joint, log_evidence = twin
    hidden = [v for v in GIVEN if v not in evidence]
    for v in hidden:
        mean, cov = joint.marginal(v)
        np.testing.assert_allclose(found[v].mean, mean, atol=close)
        np.testing.assert_allclose(found[v].cov, cov, atol=close)
    whole = found.joint(*hidden)
    np.testing.assert_allclose(whole.cov, joint.marginal(*hidden)[1], atol=close)
    assert found.log_evidence == pytest.approx(log_evidence, abs=close)


# ---- where CPDs are linearised


@graphs
@rules
@pytest.mark.parametrize("evidence", [{}, {e: 0.9}, EVIDENCE, {a: 0.7, e: 0.2}, {b: [0.3, 1.0]}])
def test_first_at_the_prior_predictive_moments(graph, rule, twin, evidence):
    """Parents with a common cause are correlated there; evidence is not looked at."""
    found = pgm.infer(graph(NET), evidence, lineariser=rule)
    assert_twin(found, twin_pass(twin, evidence), evidence, 1e-8)
    assert found.status.iterations == 1
    assert found.status.residuals.shape == (0,)
    assert not found.status.converged
    assert found.log_evidence_kind == "linearised"


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # a few linearisations
@graphs
@rules
def test_then_at_the_beliefs_of_clusters(graph, rule, twin):
    """The evidence is taken anew from the prior: nothing counts twice."""
    before, _ = twin_pass(twin, EVIDENCE)
    expected = twin_pass(twin, EVIDENCE, at=lambda hidden: before.marginal(*hidden))
    found = pgm.infer(
        graph(NET), EVIDENCE, lineariser=rule, schedule=pgm.Calibration(2, tolerance=0.0)
    )
    assert_twin(found, expected, EVIDENCE, 1e-7)
    joint, std = expected[0], [found[v].std for v in (a, b, d)]
    moves = [
        np.abs(joint.marginal(v)[0] - before.marginal(v)[0]) / s
        for v, s in zip((a, b, d), std, strict=True)
    ]
    np.testing.assert_allclose(found.status.residuals, [np.concatenate(moves).max()], rtol=1e-5)


@graphs
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented(), pgm.MonteCarlo(20)])
def test_first_at_a_start(graph, rule):
    """Its covariance is zero, where every rule is the tangent."""
    start = {a: 0.9, b: [0.5, 1.1], d: [0.8, 0.7]}
    values = {v: np.atleast_1d(value).astype(float) for v, value in start.items()}

    def at(hidden):
        return np.concatenate([values[v] for v in hidden]), None

    found = pgm.infer(graph(NET), EVIDENCE, lineariser=rule, start=start)
    assert_twin(found, twin_pass(taylor, EVIDENCE, at=at), EVIDENCE, 1e-8)


def test_a_start_needs_hidden_parents_alone():
    """A child that nobody depends on may have one or not; it changes nothing."""
    evidence = {c: 1.4}
    start = {a: 0.9, b: [0.5, 1.1], d: [0.8, 0.7]}
    found = pgm.infer(pgm.compile(NET), evidence, start=start)
    more = pgm.infer(pgm.compile(NET), evidence, start=start | {e: 5.0})
    for v in (a, b, d, e):
        np.testing.assert_allclose(more[v].mean, found[v].mean, atol=1e-10)
        np.testing.assert_allclose(more[v].cov, found[v].cov, atol=1e-10)
    with pytest.raises(pgm.EvidenceError, match="start lacks d"):
        pgm.infer(pgm.compile(NET), evidence, start={a: 0.9, b: [0.5, 1.1]})
    with pytest.raises(pgm.EvidenceError, match="start has c, which is not hidden"):
        pgm.infer(pgm.compile(NET), evidence, start=start | {c: 1.0})


def test_a_lineariser_of_a_cpd_wins():
    """Each CPD by its own: the others by the one given to `infer`."""
    cpds = {v: NET.cpd(v) for v in FUNCTIONS}
    own = pgm.NonlinearGaussianCPD(d, (b, c), to_d, NOISE[d], lineariser=pgm.Unscented())
    net = NET.replace(own)
    called = []

    def watched(function, at):
        called.append(function.name)
        return pgm.Taylor()(function, at)

    found = pgm.infer(pgm.compile(net), {e: 0.9}, lineariser=watched)
    assert sorted(called) == sorted(v.name for v in cpds if v != d)

    def twin(function, mean, cov):
        return (unscented if mean.size == 3 else taylor)(function, mean, cov)

    assert_twin(found, twin_pass(twin, {e: 0.9}), {e: 0.9}, 1e-8)


def test_given_jacobians_are_called_for_hidden_parents_alone():
    def by_b(x, y):
        zero = np.zeros_like(y[..., 0])
        rows = [[y[..., 0], zero], [zero, -np.sin(x[..., 1])]]
        return np.stack([np.stack(row, -1) for row in rows], -2)

    def never(x, y):
        raise AssertionError("c is observed")

    jacobians = {b: by_b, c: never}
    net = NET.replace(pgm.NonlinearGaussianCPD(d, (b, c), to_d, NOISE[d], jacobian=jacobians))
    found = pgm.infer(pgm.compile(net), EVIDENCE)
    assert_twin(found, twin_pass(taylor, EVIDENCE), EVIDENCE, 1e-8)


def test_noise_that_depends_on_a_value():
    grow = pgm.noise(lambda y: 0.1 * y[..., None] ** 2 * np.eye(2), given=(c,))
    net = NET.replace(pgm.NonlinearGaussianCPD(d, (b, c), to_d, grow))
    fixed = NET.replace(pgm.NonlinearGaussianCPD(d, (b, c), to_d, 0.1 * 1.4**2 * np.eye(2)))
    found = pgm.infer(pgm.compile(net), EVIDENCE)
    due = pgm.infer(pgm.compile(fixed), EVIDENCE)
    np.testing.assert_allclose(found[a].mean, due[a].mean, rtol=1e-12)
    with pytest.raises(pgm.EvidenceError, match="on which its noise depends"):
        pgm.infer(pgm.compile(net), {e: 0.9})


# ---- random rules


def test_random_points_are_keyed_by_seed_and_name():
    def moments(seed, name="d"):
        child = pgm.Variable(name, ("d0", "d1"))
        cpds = [cpd for cpd in NET.cpds if cpd.child not in (d, e)]
        net = pgm.BayesianNetwork([*cpds, pgm.NonlinearGaussianCPD(child, (b, c), to_d, NOISE[d])])
        found = pgm.infer(pgm.compile(net), {a: 0.5}, lineariser=pgm.MonteCarlo(30, seed=seed))
        return found[child].mean

    np.testing.assert_array_equal(moments(1), moments(1))
    assert np.abs(moments(1) - moments(2)).max() > 1e-6
    assert np.abs(moments(1) - moments(1, "other")).max() > 1e-6


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # a few linearisations
def test_random_points_are_shared_by_runs():
    rng = np.random.default_rng(0)
    evidence = {e: rng.normal(size=(4, 1))}
    rule, schedule = pgm.MonteCarlo(30, seed=3), pgm.Calibration(3, tolerance=0.0)
    graph = pgm.compile(NET)
    found = pgm.infer(graph, evidence, lineariser=rule, schedule=schedule)
    for run in range(4):
        alone = pgm.infer(graph, {e: evidence[e][run]}, lineariser=rule, schedule=schedule)
        np.testing.assert_allclose(found[a].mean[run], alone[a].mean, rtol=1e-12)


# ---- iterating


@crossed(
    ("rule", "graph"),
    {name: rule for name, (rule, _) in RULES.items()},
    {"junction tree": pgm.compile, "hand": hand_made},
)
def test_runs_stop_when_they_have_converged(rule, graph):
    """And are left alone then: a batch is its single runs."""
    rng = np.random.default_rng(1)
    sample = NET.sample((2, 3), rng=rng)
    evidence = {c: sample[c], e: sample[e]}
    schedule = pgm.Calibration(200, 1e-9)
    made = graph(NET)
    found = pgm.infer(made, evidence, lineariser=rule, schedule=schedule)
    status = found.status
    assert status.converged.shape == (2, 3)
    assert status.residuals.shape == (status.iterations - 1, 2, 3)
    np.testing.assert_array_equal(status.converged, (status.residuals <= 1e-9).any(axis=0))
    lengths = set()
    for run in np.ndindex(2, 3):
        alone = pgm.infer(
            made, {v: x[run] for v, x in evidence.items()}, lineariser=rule, schedule=schedule
        )
        lengths.add(alone.status.iterations)
        count = alone.status.iterations - 1
        np.testing.assert_allclose(
            alone.status.residuals, status.residuals[:count, *run], rtol=1e-6, atol=1e-12
        )
        for v in (a, b, d):
            np.testing.assert_allclose(found[v].mean[run], alone[v].mean, rtol=1e-12, atol=1e-13)
            np.testing.assert_allclose(found[v].cov[run], alone[v].cov, rtol=1e-10, atol=1e-13)
        assert found.log_evidence[run] == pytest.approx(float(alone.log_evidence), rel=1e-12)
    assert len(lengths) > 1
    assert status.iterations == max(lengths)


def test_what_does_not_converge_says_so():
    """Gauss–Newton jumps to and fro where the function bends away: arctan is known for it."""
    x, y = pgm.variables("x y")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, 3.0, 1e8),
            pgm.NonlinearGaussianCPD(y, x, lambda v: np.arctan(v), 1e-6),
        ]
    )
    with pytest.warns(
        pgm.ConvergenceWarning, match="after 7 linearisations: the last moved a mean"
    ):
        found = pgm.infer(pgm.compile(net), {y: 0.0}, schedule=pgm.Calibration(7, 1e-9))
    assert not found.status.converged
    assert found.status.iterations == 7
    assert found.status.residuals.shape == (6,)
    assert found.status.residuals[-1] > 1e-9
    assert found.log_evidence_kind == "linearised"
    near = pgm.infer(pgm.compile(net), {y: 0.0}, schedule=pgm.Calibration(30, 1e-9), start={x: 0.5})
    assert near.status.converged
    np.testing.assert_allclose(near[x].mean, 0.0, atol=1e-6)


@pytest.mark.parametrize("seed", slow_after(3, range(8)))
def test_iterated_taylor_is_at_a_map(seed):
    """The cost is level there, and no optimiser that starts there goes elsewhere."""
    rng = np.random.default_rng(seed)
    net = bent(random_network(rng, rng.integers(1, 4, 7)), 0.3)
    evidence = draw_evidence(net, rng, [v for v in net.variables if rng.random() < 0.4])
    found = pgm.infer(pgm.compile(net), evidence, schedule=pgm.Calibration(300, 1e-12))
    assert found.status.converged
    assert found.log_evidence_kind == "laplace"
    assert steepest(net, evidence, found) <= 1e-7
    hidden = [v for v in net.variables if v not in evidence]

    def cost(stacked):
        value, start, left = dict(evidence), 0, []
        for v in hidden:
            value[v] = stacked[start : start + v.dimension]
            start += v.dimension
        for cpd in net.cpds:
            given = [value[v] for v in cpd.given]
            due = cpd.function(*given) if given else cpd.offset
            left.append(np.linalg.solve(np.linalg.cholesky(cpd.cov), value[cpd.child] - due))
        return np.concatenate(left)

    stacked = np.concatenate([found[v].mean for v in hidden])
    best = least_squares(cost, stacked, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    std = np.concatenate([found[v].std for v in hidden])
    assert np.abs((best.x - stacked) / std).max() <= 1e-5
    # Laplace: the density at the mode, and the Gauss–Newton curvature there.
    J = best.jac
    whole = sum(np.linalg.slogdet(2 * np.pi * cpd.cov)[1] for cpd in net.cpds)
    curved = np.linalg.slogdet(J.T @ J / (2 * np.pi))[1]
    due = -best.cost - 0.5 * whole - 0.5 * curved
    assert found.log_evidence == pytest.approx(due, rel=1e-6)
    np.testing.assert_allclose(std**2, np.diagonal(np.linalg.inv(J.T @ J)), rtol=1e-5)


# ---- poses and landmarks, all unknown

POSES = [pgm.Variable(f"x{k}", ("east", "north", "heading"), angles=("heading",)) for k in range(5)]
MARKS = [pgm.Variable(f"m{k}", ("east", "north")) for k in range(2)]
SIGHTS = {
    (i, k): pgm.Variable(f"z{i}{k}", ("range", "bearing"), angles=("bearing",))
    for i in range(5)
    for k in range(2)
}
MARKS_AT = ([2.0, 3.0], [5.0, 1.0])
P, Q, R = (np.diag(s) ** 2 for s in ([0.1, 0.1, 0.05], [0.1, 0.1, 0.05], [0.2, 0.05]))


@dataclass(frozen=True)
class Step:
    """A step ahead and a turn."""

    turn: float

    def __call__(self, pose):
        heading = pose[..., 2] + self.turn / 2
        turn = np.full(heading.shape, self.turn)
        return pose + np.stack([np.cos(heading), np.sin(heading), turn], axis=-1)


def wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def mapping(turn):
    cpds = [pgm.GaussianCPD(POSES[0], [0, 0, 0], P)]
    cpds += [pgm.NonlinearGaussianCPD(POSES[k], POSES[k - 1], Step(turn), Q) for k in range(1, 5)]
    cpds += [pgm.GaussianCPD(v, at, np.eye(2)) for v, at in zip(MARKS, MARKS_AT, strict=True)]
    cpds += [
        pgm.NonlinearGaussianCPD(z, (POSES[i], MARKS[k]), range_bearing, R)
        for (i, k), z in SIGHTS.items()
    ]
    return pgm.BayesianNetwork(cpds)


def misfit(turn, evidence, value):
    """Residuals of the MAP cost, bearings wrapped."""
    left = [value[POSES[0]] / np.sqrt(np.diag(P))]
    for before, after in pairwise(POSES):
        left.append((value[after] - Step(turn)(value[before])) / np.sqrt(np.diag(Q)))
    left += [value[v] - at for v, at in zip(MARKS, MARKS_AT, strict=True)]
    for (i, k), z in SIGHTS.items():
        off = evidence[z] - range_bearing(value[POSES[i]], value[MARKS[k]])
        off[1] = wrap(off[1])
        left.append(off / np.sqrt(np.diag(R)))
    return np.concatenate(left)


@crossed(("seed", "turn"), [0, 1, 2], [0.3, 2.6])
def test_poses_and_landmarks_together(turn, seed):
    """Two hidden parents of each sighting; headings that turn several times."""
    net = mapping(turn)
    sample = net.sample(rng=seed)
    evidence = {z: sample[z] for z in SIGHTS.values()}
    rng = np.random.default_rng(seed)
    turned = {z: s + 2 * np.pi * np.array([0, rng.integers(-2, 3)]) for z, s in evidence.items()}
    schedule = pgm.Calibration(300, 1e-11)
    found = pgm.infer(pgm.compile(net), turned, schedule=schedule)
    assert found.status.converged
    hidden = [*POSES, *MARKS]
    ends = np.cumsum([0, *(v.dimension for v in hidden)])

    def cost(stacked):
        value = {v: stacked[s:t] for v, s, t in zip(hidden, ends[:-1], ends[1:], strict=True)}
        return misfit(turn, evidence, value)

    stacked = np.concatenate([found[v].mean for v in hidden])
    best = least_squares(cost, stacked, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    std = np.concatenate([found[v].std for v in hidden])
    assert np.abs((best.x - stacked) / std).max() <= 1e-5
    level = jacobian(cost, stacked).T @ cost(stacked)
    assert np.abs(level * std).max() <= 1e-5
    # No heading is on a wrong branch: the misfit is that of noise.
    assert 2 * best.cost < 60
    assert np.abs(found[POSES[4]].mean[2] - 4 * turn) < 1.0


# ---- what has nothing hidden


def test_functions_of_known_values_alone():
    x, y, z = pgm.variables("x y z")
    net = pgm.BayesianNetwork(
        [
            pgm.NonlinearGaussianCPD(y, x, np.sin, 0.1),
            pgm.NonlinearGaussianCPD(z, (x, y), lambda p, q: p * q, 0.2),
        ]
    )
    graph = pgm.compile(net)
    found = pgm.infer(graph, {x: [[0.5], [1.0]]})
    np.testing.assert_allclose(found[y].mean, np.sin([[0.5], [1.0]]))
    np.testing.assert_allclose(found[y].cov, np.full((2, 1, 1), 0.1))
    np.testing.assert_allclose(found[z].cov[:, 0, 0], 0.2 + np.array([0.25, 1.0]) * 0.1)
    read = pgm.infer(graph, {x: 0.5, y: 0.7, z: 0.1})
    due = -0.5 * (
        (0.7 - np.sin(0.5)) ** 2 / 0.1
        + (0.1 - 0.35) ** 2 / 0.2
        + np.log(2 * np.pi * 0.1)
        + np.log(2 * np.pi * 0.2)
    )
    assert read.log_evidence == pytest.approx(due, rel=1e-12)
    with pytest.raises(pgm.EvidenceError, match="no evidence for x"):
        pgm.infer(graph, {z: 0.1})


# ---- errors


def test_values_that_are_not_finite_name_the_cpd_and_no_step():
    x, y = pgm.variables("x y")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(x, -1.0, 1.0), pgm.NonlinearGaussianCPD(y, x, np.sqrt, 1.0)]
    )
    with pytest.raises(pgm.LinearisationError, match="NaN or infinite") as caught:
        pgm.infer(pgm.compile(net), {y: 1.0})
    assert "step" not in str(caught.value)
    assert "y | x" in str(caught.value)
    assert caught.value.cpd is net.cpd(y)
    assert caught.value.variable == y
    assert caught.value.step is None


def test_values_that_are_not_finite_in_an_unrolled_network_name_the_step():
    x, y = pgm.variables("x y")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 2.5, 0.01)],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: 1.0}, offset=-1.0, cov=0.01)],
        observation=[pgm.NonlinearGaussianCPD(y, x, np.sqrt, 1.0)],
    )
    net = model.unroll(4)
    with pytest.raises(pgm.LinearisationError, match="at step 3") as caught:
        pgm.infer(pgm.compile(net), {y.at(k): 1.0 for k in range(5)})
    assert caught.value.step == 3


def wrong_length(x):
    return np.concatenate([x, x], axis=-1)


def no_leading_axes(x):
    return np.array([x[0]])


def fails(x):
    return x @ np.ones((7, 7))


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (wrong_length, "returned shape"),
        (no_leading_axes, "returned shape"),
        (fails, "failed on a trial call"),
    ],
)
def test_wrong_shapes_are_found_before_inference(function, message):
    """No lineariser is called before."""
    x, y = pgm.variables("x y")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(x, 1.0, 1.0), pgm.NonlinearGaussianCPD(y, x, function, 1.0)]
    )

    def never(function, at):
        raise AssertionError("linearised")

    with pytest.raises(pgm.ModelError, match=message) as caught:
        pgm.infer(pgm.compile(net), {y: 1.0}, lineariser=never)
    assert caught.value.cpd is net.cpd(y)


@pytest.mark.parametrize("kind", [RuntimeError, pgm.EvidenceError])
def test_an_exception_of_the_user_is_the_cause_of_one_that_names_the_cpd(kind):
    class Refused(kind):
        pass

    def function(x):
        if (x > 0.9).any() and x.ndim < 4:
            raise Refused("too far")
        return x

    x, y = pgm.variables("x y")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(x, 1.0, 1.0), pgm.NonlinearGaussianCPD(y, x, function, 1.0)]
    )
    words = "the function of the CPD of y, run 0, failed: Refused: too far"
    with pytest.raises(pgm.ModelError, match=words) as caught:
        pgm.infer(pgm.compile(net), {y: 1.0})
    assert isinstance(caught.value.__cause__, Refused)
    assert caught.value.cpd is net.cpd(y)
    assert (caught.value.step, caught.value.run) == (None, 0)


class Odd(StatisticalRegression):
    """A rule whose weights of covariances are negative where the function bends."""

    def points(self, dimension, name, step):
        rule = pgm.Unscented().points(dimension, name, step)
        weights = rule.cov_weights.copy()
        weights[0] = -20.0
        return Points(rule.points, rule.mean_weights, weights, True)


@pytest.mark.parametrize("schedule", [None, pgm.Flooding(), pgm.Residual()])
def test_noise_that_is_indefinite_after_linearisation(schedule):
    x, y = pgm.variables("x y")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(x, 1.0, 1.0), pgm.NonlinearGaussianCPD(y, x, np.square, 0.1)]
    )
    with pytest.raises(pgm.NumericalError, match="indefinite") as caught:
        pgm.infer(pgm.compile(net), {y: 1.0}, lineariser=Odd(), schedule=schedule)
    assert caught.value.variable == y
    assert caught.value.cpd is net.cpd(y)


def test_linearisers_that_return_the_wrong_thing():
    with pytest.raises(pgm.LinearisationError, match=r"must return a pgm\.AffineGaussian"):
        pgm.infer(pgm.compile(NET), EVIDENCE, lineariser=lambda function, at: None)
    with pytest.raises(pgm.LinearisationError, match="returned an F of shape"):
        pgm.infer(
            pgm.compile(NET),
            EVIDENCE,
            lineariser=lambda function, at: pgm.AffineGaussian(
                np.zeros((1, 4)), np.zeros(1), np.zeros((1, 1))
            ),
        )
