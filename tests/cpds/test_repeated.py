"""Plates that are declared: the CPDs that are declared one by one, and refusals that name a row."""

import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.cpds.plates import plate as key

POSE = {"components": ("east", "north", "heading"), "angles": ("heading",)}
ROWS, COLUMNS = 4, 3
A, B, D = pgm.variables("a b d")
P, Q, Z = (pgm.Variable(name, **POSE) for name in "pqz")


def turned(x, y):
    """Where y is, as seen from x."""
    cos, sin, off = np.cos(x[..., 2]), np.sin(x[..., 2]), y - x
    seen = (cos * off[..., 0] + sin * off[..., 1], cos * off[..., 1] - sin * off[..., 0])
    return np.stack([*seen, off[..., 2]], axis=-1)


def by_first(x, y):
    cos, sin, off = np.cos(x[..., 2]), np.sin(x[..., 2]), y - x
    out = np.zeros((*x.shape, 3))
    out[..., 0, :] = np.stack([-cos, -sin, cos * off[..., 1] - sin * off[..., 0]], axis=-1)
    out[..., 1, :] = np.stack([sin, -cos, -cos * off[..., 0] - sin * off[..., 1]], axis=-1)
    out[..., 2, 2] = -1.0
    return out


def covariances(rng, *shape, size=3):
    root = rng.normal(size=(*shape, size, size))
    return 0.1 * root @ root.swapaxes(-1, -2) + 0.05 * np.eye(size)


def field():
    """Pixels and differences of neighbours, by plates and one by one, and evidence."""
    rng = np.random.default_rng(1)
    x = np.reshape(
        pgm.variables(f"x{i}_{j}" for i in range(ROWS) for j in range(COLUMNS)), (ROWS, COLUMNS)
    )
    east = np.reshape(pgm.variables(f"e{k}" for k in range(ROWS * (COLUMNS - 1))), (ROWS, -1))
    north = np.reshape(pgm.variables(f"n{k}" for k in range((ROWS - 1) * COLUMNS)), (ROWS - 1, -1))
    mean, cov = rng.normal(size=x.shape), rng.uniform(0.5, 2.0, x.shape)
    shift, slope = rng.normal(size=east.shape), rng.uniform(0.5, 1.5, east.shape)
    difference = pgm.LinearGaussianCPD(D, given={A: -1.0, B: 1.0}, cov=0.1)
    plates = [
        *pgm.plate(pgm.GaussianCPD(A, 0.0, 1.0), {A: x}, mean=mean, cov=cov),
        *pgm.plate(
            difference,
            {D: east, A: x[:, :-1], B: x[:, 1:]},
            cov=0.2 * slope,
            offset=shift,
            given={B: slope},
        ),
        *pgm.plate(difference, {D: north, A: x[:-1], B: x[1:]}),
    ]
    each = [pgm.GaussianCPD(x[k], mean[k], cov[k]) for k in np.ndindex(x.shape)]
    each += [
        pgm.LinearGaussianCPD(
            east[i, j],
            given={x[i, j]: -1.0, x[i, j + 1]: slope[i, j]},
            cov=0.2 * slope[i, j],
            offset=shift[i, j],
        )
        for i, j in np.ndindex(east.shape)
    ]
    each += [
        pgm.LinearGaussianCPD(north[i, j], given={x[i, j]: -1.0, x[i + 1, j]: 1.0}, cov=0.1)
        for i, j in np.ndindex(north.shape)
    ]
    evidence = {z: rng.normal(size=1) for z in (*east.flat, *north.flat)}
    return plates, each, evidence, tuple(x.flat)


def ring(noise=None):
    """Poses on a ring, each seen from the one before and the last from the first."""
    rng = np.random.default_rng(2)
    count = 6
    x = np.array(pgm.variables((f"x{k}" for k in range(count)), **POSE))
    z = np.array(pgm.variables((f"z{k}" for k in range(count)), **POSE))
    true = np.stack([np.array([np.cos(a), np.sin(a), a]) for a in np.arange(count)])
    priors, covs = covariances(rng, count), covariances(rng, count)
    after = np.roll(np.arange(count), -1)

    def sight(child, first, second, cov):
        return pgm.NonlinearGaussianCPD(
            child, (first, second), turned, cov, jacobian={first: by_first}, noise=noise
        )

    plates = [
        *pgm.plate(pgm.GaussianCPD(P, np.zeros(3), 1.0), {P: x}, mean=true, cov=priors),
        *pgm.plate(sight(Z, P, Q, np.eye(3)), {Z: z, P: x, Q: x[after]}, cov=covs),
    ]
    each = [pgm.GaussianCPD(*row) for row in zip(x, true, priors, strict=True)]
    each += [sight(*row) for row in zip(z, x, x[after], covs, strict=True)]
    seen = turned(true, true[after]) + 0.1 * rng.normal(size=(count, 3))
    return plates, each, dict(zip(z, seen, strict=True)), tuple(x)


@pytest.mark.parametrize("made", [field, ring], ids=["field", "poses"])
def test_a_plate_is_the_network_that_is_declared_one_by_one(made):
    plates, each, evidence, variables = made()
    assert [repr(cpd) for cpd in plates] == [repr(cpd) for cpd in each]
    assert [str(cpd) for cpd in plates] == [str(cpd) for cpd in each]
    assert [key(cpd) for cpd in plates] == [key(cpd) for cpd in each]
    for one, other in zip(plates, each, strict=True):
        assert (one.child, one.given, one.origin) == (other.child, other.given, one)
        assert_array_equal(one.cov, other.cov)
    rounds = pgm.Calibration(4, tolerance=0.0)
    found, due = (
        pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), evidence, schedule=rounds)
        for cpds in (plates, each)
    )
    assert found.log_evidence == due.log_evidence
    assert_array_equal(found.means(variables), due.means(variables))
    assert_array_equal(found.covs(variables), due.covs(variables))


@pytest.mark.parametrize(
    "order", [pgm.StochasticMinFill(), pgm.MinDegree(), pgm.NestedDissection(small=2)], ids=repr
)
def test_the_field_has_the_posterior_of_its_normal_equations(order):
    plates, _, evidence, variables = field()
    place = {v: k for k, v in enumerate(variables)}
    information, pull = np.zeros((len(place), len(place))), np.zeros(len(place))
    for cpd in plates:
        row, weight = np.zeros(len(place)), 1.0 / cpd.cov[0, 0]
        if cpd.child in place:
            row[place[cpd.child]], due = 1.0, cpd.mean[0]
        else:
            due = evidence[cpd.child][0] - cpd.offset[0]
            for parent, matrix in cpd.matrices.items():
                row[place[parent]] = matrix[0, 0]
        information += weight * np.outer(row, row)
        pull += weight * row * due
    graph = pgm.compile(pgm.BayesianNetwork(plates), method=pgm.JunctionTree(order))
    found = pgm.infer(graph, evidence)
    cov = np.linalg.inv(information)
    assert_allclose(found.means(variables)[:, 0], cov @ pull, rtol=1e-9, atol=1e-12)
    assert_allclose(found.covs(variables)[:, 0, 0], np.diag(cov), rtol=1e-9)


def test_densities_draws_and_copies_are_those_of_each_alone():
    for plates, each, *_ in (field(), ring(pgm.Huber(1.5))):
        for one, other in zip(plates, each, strict=True):
            again = pickle.loads(pickle.dumps(one))
            at = {v: np.full(v.dimension, 0.3) for v in one.given}
            child = np.full(one.child.dimension, 0.7)
            due = other.log_density(child, at)
            assert one.log_density(child, at) == due == again.log_density(child, at)
            assert_array_equal(one.sample(at, 2, rng=0), other.sample(at, 2, rng=0))
            with pytest.raises(ValueError, match="read-only"):
                one.cov[0, 0] = 7.0


def test_what_was_worked_out_from_the_noise_is_not_that_of_the_rows():
    cpd = pgm.LinearGaussianCPD(D, {A: 1.0}, 1.0)
    nonlinear = pgm.NonlinearGaussianCPD(D, A, np.sin, 1.0)
    for each in (cpd, nonlinear):
        each.log_density(1.0, {A: 0.0})
        row, other = pgm.plate(each, {D: pgm.variables("u v")}, cov=[4.0, 9.0])
        for made, deviation in ((row, 2.0), (other, 3.0)):
            due = -0.5 * (1.0 / deviation) ** 2 - np.log(deviation) - 0.5 * np.log(2 * np.pi)
            assert_allclose(made.log_density(1.0, {A: 0.0}), due, rtol=1e-14)
        assert_allclose(
            each._with_cov(4.0).log_density(1.0, {A: 0.0}), row.log_density(1.0, {A: 0.0})
        )


def test_variables_that_are_left_out_are_the_same_in_all_rows():
    u, v, w = pgm.variables("u v w")
    cpd = pgm.LinearGaussianCPD(D, {A: 1.0, B: 2.0}, 1.0)
    rows = pgm.plate(cpd, {D: [u, v], B: w})
    assert [row.scope for row in rows] == [(u, A, w), (v, A, w)]
    assert all(row.matrices[w] is cpd.matrices[B] for row in rows)
    assert [row.scope for row in pgm.plate(cpd, {D: iter([u]), A: (v,)})] == [(u, v, B)]
    assert pgm.plate(cpd, {D: [], A: []}, cov=[]) == ()
    assert pgm.plate(cpd, {D: [], A: np.zeros(0, object)}, offset=np.zeros((0, 1))) == ()


def test_the_step_before_follows_its_variable():
    many = pgm.variables("u v w")
    walk = pgm.LinearGaussianCPD(A, {A.previous: 1.0}, 0.1)
    rows = pgm.plate(walk, {A: many}, cov=[0.1, 0.2, 0.3])
    assert [row.given for row in rows] == [(v.previous,) for v in many]
    model = pgm.DynamicBayesianNetwork(pgm.plate(pgm.GaussianCPD(A, 0.0, 1.0), {A: many}), rows)
    covs = [pgm.filter(model, {}, steps=2)[v].cov[-1, 0, 0] for v in many]
    assert_allclose(covs, [1.2, 1.4, 1.6])
    placed = pgm.plate(walk.at(3), {A.at(3): [v.at(3) for v in many], A.at(2): many[0].at(2)})
    assert [row.scope for row in placed] == [(v.at(3), many[0].at(2)) for v in many]
    assert all(row.origin is row for row in placed)


def test_noise_of_inputs_is_of_each_rows_input():
    u, v, s, t = pgm.variables("u v s t")
    noise = pgm.noise(lambda b: b**2, given=B, diagonal=True)
    rows = pgm.plate(pgm.LinearGaussianCPD(D, {A: 1.0}, noise), {D: [u, v], B: [s, t]})
    assert [row.scope for row in rows] == [(u, A, s), (v, A, t)]
    due = pgm.LinearGaussianCPD(v, {A: 1.0}, pgm.noise(noise.function, t, diagonal=True))
    at = {A: 0.5, t: 3.0}
    assert rows[1].log_density(1.0, at) == due.log_density(1.0, at)


def test_priors_may_be_flat_and_have_runs():
    flat = pgm.plate(pgm.GaussianCPD(A, 0.0, 1.0), {A: pgm.variables("u v")}, cov=[np.inf, 2.0])
    assert [row.cov.item() for row in flat] == [np.inf, 2.0]
    mean, cov = np.arange(30.0).reshape(2, 5, 3), covariances(np.random.default_rng(0), 2, 5)
    rows = pgm.plate(
        pgm.GaussianCPD(P, np.zeros(3), 1.0),
        {P: pgm.variables("u v", **POSE)},
        mean=mean,
        cov=cov,
    )
    for row, *due in zip(rows, mean, cov, strict=True):
        assert row._lead() == (5,)
        assert_array_equal(row.mean, due[0])
        assert_array_equal(row.cov, pgm.GaussianCPD(P, *due).cov)


def test_numbers_are_told_by_their_axes():
    x = pgm.variables("u v w", **POSE)
    cpd = pgm.LinearGaussianCPD(Z, {P: 1.0}, 1.0)
    assert [row.cov[2, 2] for row in pgm.plate(cpd, {Z: x}, cov=[1.0, 2.0, 3.0])] == [1.0, 2.0, 3.0]
    rows = pgm.plate(cpd, {Z: x}, cov=np.arange(1.0, 10.0).reshape(3, 3), offset=[1.0, 2.0, 3.0])
    assert_array_equal(rows[1].cov, np.diag([4.0, 5.0, 6.0]))
    assert_array_equal(rows[1].offset, [2.0, 2.0, 2.0])
    matrices = np.random.default_rng(3).normal(size=(3, 3, 3))
    rows = pgm.plate(cpd, {Z: x}, offset=matrices[0], given={P: matrices})
    assert_array_equal(rows[2].offset, matrices[0, 2])
    assert_array_equal(rows[2].matrices[P], matrices[2])
    nearly = np.eye(3) + 1e-12 * np.triu(np.ones((3, 3)), 1)
    due = pgm.LinearGaussianCPD(x[0], {P: 1.0}, nearly).cov
    assert_array_equal(pgm.plate(cpd, {Z: x}, cov=[nearly] * 3)[0].cov, due)


U, V = pgm.variables("u v", **POSE)
LINEAR = pgm.LinearGaussianCPD(Z, {P: 1.0}, 1.0)
PRIOR = pgm.GaussianCPD(P, np.zeros(3), 1.0)
SIGHT = pgm.NonlinearGaussianCPD(Z, (P, Q), turned, 1.0, noise=pgm.Huber(1.5))
INDEFINITE = np.array([np.eye(3), np.eye(3) - 2.0 * np.diag([1.0], 2) - 2.0 * np.diag([1.0], -2)])
STATES = pgm.Discrete("s", states=2)


@pytest.mark.parametrize(
    ("cpd", "over", "numbers", "text", "about"),
    [
        (pgm.TableCPD(STATES, table=[0.5, 0.5]), {}, {}, "a plate is of a GaussianCPD", None),
        (LINEAR, [U, V], {}, "is a mapping of variables", None),
        (LINEAR, {Q: [U, V]}, {}, r"q is none of its variables \(z, p\)", Q),
        (LINEAR, {"z": [U, V]}, {}, r"'z' is none of its variables", None),
        (LINEAR, {P: [U, V]}, {}, "no row has a child of its own", Z),
        (LINEAR, {Z: U}, {}, "no row has a child of its own", Z),
        (LINEAR, {Z: {U, V}}, {}, "a list or array of variables, in order", Z),
        (LINEAR, {Z: 3}, {}, "a list or array of variables, in order, or to one variable", Z),
        (LINEAR, {Z: [U, V], P: [U]}, {}, r"for p have shape \(1,\), and those for z \(2,\)", P),
        (LINEAR, {Z: [U, "v"]}, {}, "in place of z, .* stands 'v', which is no variable", Z),
        (LINEAR, {Z: [[U, V], [U]]}, {}, r"stands \[u, v\], which is no variable", Z),
        (LINEAR, {Z: [U, A]}, {}, r"stands a, with components \('a'\)", A),
        (LINEAR, {Z: [U, STATES]}, {}, r"stands s, with states \('0', '1'\)", STATES),
        (LINEAR, {Z: [U, pgm.Variable("v", POSE["components"])]}, {}, "angles \\(\\); give", None),
        (LINEAR, {Z: [U, V], P: [V, V]}, {}, "v is given as its own parent", V),
        (LINEAR, {Z: [U, V.previous]}, {}, r"child of a CPD cannot be v\[t-1\]", V.previous),
        (SIGHT, {Z: [U, V], P: [Q, P]}, {}, "holds q twice", Q),
        (
            pgm.NonlinearGaussianCPD(D, (A, P), turned, 1.0),
            {D: [A.at(1), pgm.Variable("p")], A: D},
            {},
            "two different variables are called 'p'",
            None,
        ),
        (LINEAR, {Z: [U, V]}, {"mean": [0.0, 1.0]}, "mean is a number of a GaussianCPD", None),
        (SIGHT, {Z: [U, V]}, {"offset": [0.0, 1.0]}, "offset is a number of a Linear", None),
        (PRIOR, {P: [U, V]}, {"given": {P: [1.0, 1.0]}}, "given is a number of a Linear", None),
        (LINEAR, {Z: [U, V]}, {"given": {Q: [1, 1]}}, "given has a matrix of q, which is none", Q),
        (LINEAR, {Z: [U, V]}, {"given": 3.0}, "given is a mapping", None),
        (LINEAR, {Z: [U, V]}, {"cov": 1.0}, r"its first axes are those of the rows, \(2,\)", Z),
        (LINEAR, {Z: [U, V]}, {"cov": np.ones((2, 2))}, r"\(2, 2\); behind the axes .* needs", Z),
        (LINEAR, {Z: [U, V]}, {"cov": np.ones((2, 5, 3, 3))}, "behind the axes of the rows", Z),
        (LINEAR, {Z: [U, V]}, {"cov": INDEFINITE}, r"v \| p\) is indefinite: .*eigenvalue -1", V),
        (LINEAR, {Z: [U, V]}, {"cov": [1.0, -1.0]}, r"v \| p\) has the negative variance -1", V),
        (LINEAR, {Z: [U, V]}, {"cov": [1.0, np.inf]}, r"v \| p\) has entries that are NaN", V),
        (LINEAR, {Z: [U, V]}, {"cov": ["a", "b"]}, r"cov must be numbers, not texts", Z),
        (PRIOR, {P: [U, V]}, {"cov": [1.0, np.nan]}, r"v\) has entries that are NaN", V),
        (PRIOR, {P: [U, V]}, {"mean": [0.0, 1.0]}, r"mean has shape \(2,\); behind the axes", P),
        (PRIOR, {P: [U, V]}, {"mean": [[0, 0, 0], [0, 0, np.nan]]}, "v: the mean has entries", V),
        (
            PRIOR,
            {P: [U, V]},
            {"mean": np.zeros((2, 4, 3)), "cov": np.ones((2, 5, 1, 1)) * np.eye(3)},
            "the axes of runs of the means and of the covariances do not broadcast",
            P,
        ),
        (LINEAR, {Z: [U, V]}, {"offset": np.zeros((2, 2))}, r"needs \(\) or \(3,\)", Z),
        (LINEAR, {Z: [U, V]}, {"offset": [0.0, np.inf]}, r"v \| p\): the offset has entries", V),
        (LINEAR, {Z: [U, V]}, {"given": {P: np.ones((2, 2))}}, r"needs \(\) or \(3, 3\)", Z),
        (
            pgm.LinearGaussianCPD(D, {P: np.ones((1, 3))}, 1.0),
            {D: [A, B]},
            {"given": {P: [1.0, 2.0]}},
            r"shape \(2,\); behind the axes of the rows, \(2,\), it needs \(1, 3\)",
            D,
        ),
        (LINEAR, {Z: [U, V]}, {"given": {P: [1.0, np.nan]}}, r"v \| p\): the matrix of p has", V),
        (SIGHT, {Z: [U, V]}, {"cov": [1.0, 0.0]}, r"v \| p, q\): Huber.*singular covariance", V),
        (
            pgm.LinearGaussianCPD(D, {A: 1.0}, pgm.noise(np.abs, B, diagonal=True)),
            {D: [U, V]},
            {},
            "stands u, with components",
            None,
        ),
        (
            pgm.LinearGaussianCPD(D, {}, pgm.noise(np.abs, B, diagonal=True)),
            {D: [A]},
            {"cov": [1.0]},
            "its noise is a function, and cov gives numbers",
            D,
        ),
    ],
)
def test_what_does_not_fit_is_refused_and_the_row_is_named(cpd, over, numbers, text, about):
    with pytest.raises(pgm.ModelError, match=text) as caught:
        pgm.plate(cpd, over, **numbers)
    if about is not None:
        assert caught.value.variable == about


def test_one_cpd_for_each_child_is_the_networks_to_see():
    rows = pgm.plate(PRIOR, {P: [U, U]})
    with pytest.raises(pgm.ModelError, match="u has two CPDs"):
        pgm.BayesianNetwork(rows)
