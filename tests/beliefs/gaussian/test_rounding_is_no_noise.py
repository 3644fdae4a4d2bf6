"""CPDs without noise, or of very sharp noise, under every rule: rounding is no noise."""

import numpy as np
import pytest
from crossed import slow_after
from gaussian.draws import Conditioned, Drawn, assert_moments, conditional
from numpy.testing import assert_allclose
from textbooks import assert_log, rational

import pgm
from tests.dense import bound_function

RULES = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "scaled": pgm.Unscented(alpha=0.1),
    "cubature": pgm.Cubature(),
    "hermite": pgm.GaussHermite(3),
    "wide": pgm.GaussHermite(5),
    "sampled": pgm.MonteCarlo(samples=60, seed=1),
    "even": pgm.QuasiMonteCarlo(samples=64),
}
every_rule = pytest.mark.parametrize("rule", RULES.values(), ids=RULES)
p, q = (pgm.Variable(name, (f"{name}0", f"{name}1")) for name in "pq")
t = pgm.Variable("t", ("t0", "t1", "t2"))
x, y, z = pgm.variables("x y z")


def declared(cpd):
    """A linear CPD as a function."""
    if not cpd.given:
        return cpd
    matrices = list(cpd.matrices.values())

    def function(*parents):
        return cpd.offset + sum(a @ m.T for a, m in zip(parents, matrices, strict=True))

    return pgm.NonlinearGaussianCPD(cpd.child, cpd.given, function, cpd.cov)


def five(seed):
    """Five scalars of which the later ones are linear functions of earlier ones, mostly exact."""
    rng = np.random.default_rng(seed)
    found = pgm.variables("a b c d e")
    cpds, values = [], {}
    for k, child in enumerate(found):
        chosen = rng.choice(k, int(rng.integers(1, k + 1)), replace=False) if k > 1 else []
        given = {found[j]: np.array([[rng.integers(-12, 13) / 8.0]]) for j in chosen}
        cov = np.array([[0.0 if given and rng.random() < 0.6 else 0.25]])
        offset = rng.integers(-8, 9, 1) / 4.0
        cpds.append(conditional(child, given, offset, cov))
        value = rational(offset) + rational(np.sqrt(cov)) @ rational(rng.integers(-8, 9, 1) / 8.0)
        for parent, matrix in given.items():
            value = value + rational(matrix) @ values[parent]
        values[child] = value
    return Drawn(tuple(cpds), values)


@every_rule
@pytest.mark.parametrize("seeds", slow_after(1, [range(10), range(10, 40)]))
def test_exact_functions_that_are_linear(rule, seeds):
    for seed in seeds:
        drawn = five(seed)
        evidence, hidden = drawn.observe(np.random.default_rng(seed), 0.4)
        net = pgm.BayesianNetwork([declared(cpd) for cpd in drawn.cpds])
        posterior = pgm.infer(pgm.compile(net), evidence, lineariser=rule)
        due = Conditioned(drawn, evidence)
        if hidden:
            joint = posterior.joint(*hidden)
            assert_moments(joint.mean, joint.cov, *due[hidden])
        if not due.certain:
            assert_log(posterior.log_evidence, due.log_evidence)


@every_rule
@pytest.mark.parametrize("cov", [1e-20, 1e-30, 1e-60])
def test_very_sharp_noise(rule, cov):
    """A sum known to within 1e-10 to 1e-30 deviations, its summands not."""
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, 1.0, 4.0),
            pgm.GaussianCPD(y, -2.0, 1.0),
            declared(pgm.LinearGaussianCPD(z, {x: 1.0, y: 1.0}, cov=cov)),
        ]
    )
    posterior = pgm.infer(pgm.compile(net), {z: 1.5}, lineariser=rule)
    joint = posterior.joint(x, y)
    assert_allclose(joint.mean, [1.0 + 4 * 2.5 / 5, -2.0 + 2.5 / 5], rtol=1e-12)
    assert_allclose(joint.cov, 0.8 * np.array([[1, -1], [-1, 1]]), rtol=1e-12)
    assert_allclose(posterior.log_evidence, -0.5 * (np.log(10 * np.pi) + 2.5**2 / 5), rtol=1e-12)


@pytest.mark.parametrize("prior", [1.0, 1e6])
def test_a_sharp_reading_of_a_sharp_copy(prior):
    """Two readings of one scalar, each 1e15 times sharper than it or more: their mean."""
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(x, 0.0, prior),
            pgm.LinearGaussianCPD(y, {x: 1.0}, cov=1e-30),
            pgm.LinearGaussianCPD(z, {x: 1.0}, cov=1e-30),
        ]
    )
    posterior = pgm.infer(pgm.compile(net), {y: 0.0, z: 2e-15})
    assert_allclose(posterior[x].mean, [1e-15], rtol=1e-12)
    assert_allclose(posterior[x].std, [np.sqrt(0.5) * 1e-15], rtol=1e-12)


@every_rule
@pytest.mark.parametrize("origin", [0.0, 1e4])
def test_an_exact_linear_function_leaves_no_error(rule, origin):
    """Far from the origin values round by more."""
    matrix = np.array([[0.1, -0.7], [1e-6, 0.3], [3e5, 0.2]])
    cpd = declared(pgm.LinearGaussianCPD(t, {p: matrix}, offset=0.7, cov=np.zeros((3, 3))))
    at = pgm.Gaussian(p, [origin + 0.3, -1.7], [[1.1, 0.3], [0.3, 0.2]])
    affine = rule(bound_function(cpd), at)
    assert_allclose(affine.cov, 0.0, atol=0.0)
    assert_allclose(affine.F, matrix, rtol=1e-3, atol=1e-6)


@pytest.mark.parametrize("bend", [1e-2, 1e-6])
def test_a_slight_bend_is_an_error(bend):
    """Of x + c x² about 0 the error is that of c x², of variance 2 c²; x has none."""
    cpd = pgm.NonlinearGaussianCPD(
        p,
        q,
        lambda q: np.stack([q[..., 0] + bend * q[..., 0] ** 2, q[..., 1]], -1),
        np.zeros((2, 2)),
    )
    at = pgm.Gaussian(q, [0.0, 0.0], np.eye(2))
    affine = pgm.GaussHermite(3)(bound_function(cpd), at)
    assert_allclose(affine.cov[0, 0], 2 * bend**2, rtol=1e-6)
    assert_allclose(affine.cov[[0, 1, 1], [1, 0, 1]], 0.0, atol=0.0)


def test_cubature_of_functions_of_several_components():
    """2 n points leave n − 1 squares of an error: of rank 1 here, for three components."""

    def function(p):
        a, b = p[..., 0], p[..., 1]
        return np.stack([np.sin(a), a + 2 * b, np.sin(a) - b], axis=-1)

    def solved(cov):
        cpds = [pgm.GaussianCPD(p, [0.5, 1.0], np.eye(2))]
        cpds.append(pgm.NonlinearGaussianCPD(t, p, function, cov * np.eye(3)))
        cpds.append(pgm.LinearGaussianCPD(x, {t: [[1.0, 1.0, 1.0]]}, cov=0.1))
        graph = pgm.compile(pgm.BayesianNetwork(cpds))
        return pgm.infer(graph, {x: 3.0}, lineariser=pgm.Cubature())

    exact, nearly = solved(0.0), solved(1e-12)
    assert_allclose(exact.joint(p, t).mean, nearly.joint(p, t).mean, rtol=1e-9)
    assert_allclose(exact.joint(p, t).cov, nearly.joint(p, t).cov, atol=1e-9)
    assert_allclose(exact.log_evidence, nearly.log_evidence, rtol=1e-9)


@every_rule
def test_a_robot_with_a_noiseless_heading(rule):
    """Unrolled, its heading known but for the first: as if that were the only one."""
    pose = [pgm.Variable(f"pose{k}", ("east", "north")) for k in range(5)]
    heading = pgm.variables(" ".join(f"heading{k}" for k in range(4)))
    fixes = [pgm.Variable(f"fix{k}", ("east", "north")) for k in range(1, 5)]
    turns = [0.3, -0.2, 0.5]

    def step(by):
        def moved(pose, heading):
            angle = heading[..., 0] + by
            return pose + 2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)

        return moved

    def network(every):
        cpds = [pgm.GaussianCPD(pose[0], [0.0, 0.0], 0.1 * np.eye(2))]
        cpds.append(pgm.GaussianCPD(heading[0], 0.2, 0.04))
        for k, by in enumerate(turns if every else ()):
            cpds.append(
                pgm.NonlinearGaussianCPD(heading[k + 1], heading[k], lambda h, by=by: h + by, 0.0)
            )
        for k in range(4):
            known = heading[k if every else 0]
            by = 0.0 if every else sum(turns[:k])
            cpds.append(
                pgm.NonlinearGaussianCPD(pose[k + 1], (pose[k], known), step(by), 0.01 * np.eye(2))
            )
            cpds.append(pgm.LinearGaussianCPD(fixes[k], {pose[k + 1]: 1.0}, cov=0.04 * np.eye(2)))
        return pgm.BayesianNetwork(cpds)

    evidence = dict(zip(fixes, [[1.9, 0.5], [3.6, 1.5], [5.4, 2.2], [6.9, 3.8]], strict=True))
    found, due = (
        pgm.infer(pgm.compile(network(every)), evidence, lineariser=rule) for every in (True, False)
    )
    # Points that are drawn are drawn for each CPD, by its name: the same for both networks.
    joint, plain = found.joint(heading[0], *pose), due.joint(heading[0], *pose)
    tolerance = 1e-6 if isinstance(rule, pgm.Taylor) else 1e-9
    assert_allclose(joint.mean, plain.mean, rtol=0, atol=tolerance)
    assert_allclose(joint.cov, plain.cov, rtol=0, atol=tolerance)
    last = found[heading[3]]
    assert_allclose(last.mean, due[heading[0]].mean + sum(turns), atol=tolerance)
    assert_allclose(last.cov, due[heading[0]].cov, atol=tolerance)
    assert_log(found.log_evidence, due.log_evidence, 1e-6)


@every_rule
def test_a_pose_whose_heading_has_no_noise(rule):
    """One vector with a noise of rank 2 and landmarks: the limit of a heading of little noise."""
    pose = [pgm.Variable(f"pose{k}", ("east", "north", "heading")) for k in range(4)]
    mark = [
        pgm.Variable(f"mark{k}", ("range", "bearing"), angles=("bearing",)) for k in range(1, 4)
    ]

    def move(pose):
        angle = pose[..., 2]
        speed = np.stack([np.cos(angle), np.sin(angle), np.full_like(angle, 0.2)], axis=-1)
        return pose + speed

    def look(pose):
        east, north = 4.0 - pose[..., 0], 3.0 - pose[..., 1]
        bearing = np.arctan2(north, east) - pose[..., 2]
        return np.stack([np.hypot(east, north), bearing], axis=-1)

    def solved(noise):
        cpds = [pgm.GaussianCPD(pose[0], [0.0, 0.0, 0.1], np.diag([0.1, 0.1, 0.01]))]
        for k in range(3):
            cov = np.diag([0.01, 0.01, noise])
            cpds.append(pgm.NonlinearGaussianCPD(pose[k + 1], pose[k], move, cov))
            cov = np.diag([0.01, 1e-4])
            cpds.append(pgm.NonlinearGaussianCPD(mark[k], pose[k + 1], look, cov))
        evidence = dict(zip(mark, [[4.2, 0.45], [3.3, 0.42], [2.5, 0.49]], strict=True))
        graph = pgm.compile(pgm.BayesianNetwork(cpds))
        return pgm.infer(graph, evidence, lineariser=rule)

    exact, nearly = solved(0.0), solved(1e-11)
    joint, due = exact.joint(*pose), nearly.joint(*pose)
    assert_allclose(joint.mean, due.mean, atol=1e-6)
    assert_allclose(joint.cov, due.cov, atol=1e-7)
    assert_allclose(exact.log_evidence, nearly.log_evidence, rtol=1e-5)
