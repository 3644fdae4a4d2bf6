"""Networks whose leaves are observed in part, against dense conditioning on what is known."""

import numpy as np
import pytest
from gaussian.draws import assert_dense, regular, singular
from textbooks import assert_log, assert_same

import pgm

RUNS = 5
a, b = pgm.Variable("a", ("p", "q")), pgm.Variable("b")
z = pgm.Variable("z", ("range", "bearing"), angles=("bearing",))
far, way = pgm.Variable("far"), pgm.Variable("way", ("bearing",), angles=("bearing",))


def holed(drawn, rng, runs):
    """Evidence of all leaves with components missing, of some other variables, and the hidden."""
    parents = {v for cpd in drawn.cpds for v in cpd.parents}
    evidence, hidden = {}, []
    for v in drawn.variables:
        value = np.asarray(drawn.values[v], dtype=float)
        if v not in parents:
            rows = np.broadcast_to(value, (*runs, v.dimension)).copy()
            rows[rng.random(rows.shape) < 0.4] = np.nan
            evidence[v] = rows
        elif rng.random() < 0.2:
            evidence[v] = value
        else:
            hidden.append(v)
    return evidence, hidden


def run_of(posterior, run):
    """One run of a posterior, as `assert_dense` asks of it."""

    class Run:
        log_evidence = posterior.log_evidence[run]

        def __getitem__(self, variable):
            return self.joint(variable)

        def joint(self, *scope):
            found = posterior.joint(*scope) if len(scope) > 1 else posterior[scope[0]]
            return pgm.Gaussian(found.scope, found.mean[run], found.cov[run])

    return Run()


@pytest.mark.parametrize("seed", range(15))
def test_drawn_networks(seed):
    """All runs lack the same components, or each others."""
    rng = np.random.default_rng(seed)
    drawn = regular(seed, 8)
    graph, dense = pgm.compile(drawn.network()), drawn.dense()
    evidence, hidden = holed(drawn, rng, ())
    assert_dense(pgm.infer(graph, evidence), dense, evidence, hidden, rng)
    evidence, hidden = holed(drawn, rng, (RUNS,))
    posterior = pgm.infer(graph, evidence)
    for run in range(RUNS):
        one = {v: value[run] if value.ndim > 1 else value for v, value in evidence.items()}
        assert_dense(run_of(posterior, run), dense, one, hidden, rng)


@pytest.mark.parametrize("seed", range(10))
def test_noise_of_any_rank_is_that_of_a_sub_vector(seed):
    """The same network whose leaves have but the components that are known."""
    rng = np.random.default_rng(seed)
    drawn = singular(seed, 7)
    evidence, hidden = holed(drawn, rng, ())
    cut, known = [], {}
    for cpd in drawn.cpds:
        v = cpd.child
        seen = np.flatnonzero(~np.isnan(evidence.get(v, np.zeros(v.dimension))))
        if seen.size == v.dimension:
            cut.append(cpd)
            known |= {v: evidence[v]} if v in evidence else {}
        elif seen.size:
            part = pgm.Variable(v.name, tuple(f"c{k}" for k in seen))
            known[part] = evidence[v][seen]
            given = {parent: matrix[seen] for parent, matrix in cpd.matrices.items()}
            noise = cpd.cov[np.ix_(seen, seen)]
            if given:
                cut.append(pgm.LinearGaussianCPD(part, given, offset=cpd.offset[seen], cov=noise))
            else:
                cut.append(pgm.GaussianCPD(part, cpd.offset[seen], noise))
    found = pgm.infer(pgm.compile(drawn.network()), evidence)
    due = pgm.infer(pgm.compile(pgm.BayesianNetwork(cut)), known)
    for v in hidden:
        np.testing.assert_allclose(found[v].mean, due[v].mean, atol=1e-9)
        np.testing.assert_allclose(found[v].cov, due[v].cov, atol=1e-9)
    assert_log(found.log_evidence, due.log_evidence)


def sight(pose, shift):
    """Range, off by b, and bearing."""
    reach = np.hypot(pose[..., 0], pose[..., 1])[..., None] + shift
    return np.concatenate([reach, np.arctan2(pose[..., 1], pose[..., 0])[..., None]], axis=-1)


NOISE = np.array([[0.04, 0.02], [0.02, 0.03]])
SOURCES = [pgm.GaussianCPD(a, [-3.0, 0.4], 0.3 * np.eye(2)), pgm.GaussianCPD(b, 0.1, 0.2)]
WHOLE = pgm.BayesianNetwork([*SOURCES, pgm.NonlinearGaussianCPD(z, (a, b), sight, NOISE)])
PARTS = {
    far: pgm.NonlinearGaussianCPD(far, (a, b), lambda *x: sight(*x)[..., :1], NOISE[0, 0]),
    way: pgm.NonlinearGaussianCPD(way, (a, b), lambda *x: sight(*x)[..., 1:], NOISE[1, 1]),
}


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # a few linearisations
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented(), pgm.Cubature()])
@pytest.mark.parametrize("iterations", [1, 4])
@pytest.mark.parametrize(("part", "row"), [(far, [3.1, np.nan]), (way, [np.nan, -3.0])])
def test_a_function_one_component_of_which_is_observed(rule, iterations, part, row):
    rows = np.array([row, [np.nan, np.nan]])
    schedule = pgm.Calibration(iterations)
    found = pgm.infer(pgm.compile(WHOLE), {z: rows}, schedule=schedule, lineariser=rule)
    network = pgm.BayesianNetwork([*SOURCES, PARTS[part]])
    value = {part: [np.nansum(row)]}
    due = pgm.infer(pgm.compile(network), value, schedule=schedule, lineariser=rule)
    for v in (a, b):
        assert_same(pgm.Gaussian(v, found[v].mean[0], found[v].cov[0]), due[v])
        assert_same(pgm.Gaussian(v, found[v].mean[1], found[v].cov[1]), WHOLE_PRIOR[v])
    assert_log(found.log_evidence, [due.log_evidence, 0.0])
    weights = [pgm.audit(posterior, samples=100, rng=2).log_evidence for posterior in (found, due)]
    assert abs(weights[0][0] - weights[1]) < 0.1
    assert_log(weights[0][1], 0.0)


WHOLE_PRIOR = pgm.infer(pgm.compile(pgm.BayesianNetwork(SOURCES)), {})


def test_around_a_loop():
    """A tree with a schedule of loops is exact."""
    drawn = regular(3, 8)
    evidence, hidden = holed(drawn, np.random.default_rng(3), (RUNS,))
    graph = pgm.compile(drawn.network())
    found = pgm.infer(graph, evidence, schedule=pgm.Flooding(tolerance=1e-12))
    due = pgm.infer(graph, evidence)
    for v in hidden:
        assert_same(found[v], due[v])
    assert_log(found.log_evidence, due.log_evidence)


def test_the_network_unrolled_is_what_a_smoother_knows():
    x, seen = pgm.Variable("x", ("p", "q")), pgm.Variable("seen", ("p", "q"))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0, 0], np.eye(2))],
        [pgm.LinearGaussianCPD(x, {x.previous: [[1, 0.5], [0, 0.9]]}, cov=0.1 * np.eye(2))],
        [pgm.LinearGaussianCPD(seen, {x: [[1, 0.2], [0, 1]]}, cov=[[0.4, 0.3], [0.3, 0.5]])],
    )
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(3, 6, 2))
    rows[rng.random(rows.shape) < 0.4] = np.nan
    due = pgm.smooth(model, {seen: rows})
    evidence = {seen.at(k + 1): rows[:, k] for k in range(6)}
    found = pgm.infer(pgm.compile(model.unroll(6)), evidence)
    for step in range(7):
        assert_same(found[x.at(step)], due[x.at(step)])
    assert_log(found.log_evidence, due.log_evidence)
