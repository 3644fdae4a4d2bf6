"""Samples of networks without time: moments and frequencies against the exact joint."""

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.cpds.base import Known
from tests.dense import linear_joint, random_covariance

A, B, C, U, W = pgm.variables("a b c u w")


def random_gaussian(rng, count=8):
    """Draw a linear network of scalars and vectors, some covariances singular, with an input."""
    variables = [
        pgm.Variable(f"v{k}", components=[f"{k}.{i}" for i in range(rng.integers(1, 4))])
        for k in range(count)
    ]
    cpds, nodes = [], []
    for k, child in enumerate(variables):
        size = child.dimension
        parents = [v for v in variables[:k] if rng.random() < 0.5]
        matrices = {v: rng.normal(size=(size, v.dimension)) for v in parents}
        by_input, offset = rng.normal(size=(size, 1)), rng.normal(size=size)
        cov = random_covariance(rng, size, rank=rng.integers(0, size + 1))
        cpds.append(pgm.LinearGaussianCPD(child, {**matrices, U: by_input}, offset=offset, cov=cov))
        nodes.append((child, matrices, offset + by_input[:, 0] * 2.0, cov))
    return pgm.BayesianNetwork(cpds[::-1]), linear_joint(nodes)


@pytest.mark.parametrize("seed", range(3))
def test_moments_are_those_of_the_joint(seed):
    net, joint = random_gaussian(np.random.default_rng(seed))
    runs = 20_000
    drawn = net.sample(runs, inputs={U: 2.0}, rng=seed)
    assert set(drawn) == set(joint.places)
    x = np.concatenate([drawn[v] for v in joint.places], axis=-1)
    variance = np.diag(joint.cov)
    assert (np.abs(x.mean(axis=0) - joint.mean) <= 5 * np.sqrt(variance / runs) + 1e-9).all()
    error = np.sqrt((np.outer(variance, variance) + joint.cov**2) / runs)
    assert (np.abs(np.cov(x.T) - joint.cov) <= 5 * error + 1e-9).all()


def random_discrete(rng, count=6):
    """Draw a network of tables with zeros, and the joint table by enumeration."""
    variables = [pgm.Discrete(f"d{k}", int(rng.integers(1, 5))) for k in range(count)]
    cpds = []
    for k, child in enumerate(variables):
        parents = [v for v in variables[:k] if rng.random() < 0.6]
        table = rng.exponential(size=[v.size for v in (*parents, child)])
        table *= rng.random(table.shape) < 0.7
        table[..., rng.integers(child.size)] += 0.2
        cpds.append(pgm.TableCPD(child, parents, table=table / table.sum(axis=-1, keepdims=True)))
    joint = np.zeros([v.size for v in variables])
    for state in itertools.product(*(range(v.size) for v in variables)):
        at = dict(zip(variables, state, strict=True))
        joint[state] = np.prod([c.table[tuple(at[v] for v in (*c.given, c.child))] for c in cpds])
    return pgm.BayesianNetwork(cpds[::-1]), variables, joint


@pytest.mark.parametrize("seed", range(4))
def test_frequencies_are_those_of_the_joint(seed):
    net, variables, joint = random_discrete(np.random.default_rng(seed))
    runs = 50_000
    drawn = net.sample((100, runs // 100), rng=seed)
    count = np.zeros(joint.shape)
    np.add.at(count, tuple(drawn[v].ravel() for v in variables), 1)
    assert_array_equal(count[joint == 0.0], 0)
    spread = np.sqrt(joint * (1 - joint) / runs)
    # The 3 are for rare cells, which are Poisson and have a longer tail.
    assert (np.abs(count - runs * joint) <= 5 * runs * spread + 3).all()


class Uniforms:
    """A generator whose numbers are chosen."""

    def __init__(self, values):
        self.values = np.asarray(values, dtype=float)

    def random(self, count):
        return np.resize(self.values, count)


LAST = np.nextafter(1.0, 0.0)
TABLES = [
    [1.0],
    [0.0, 1.0],
    [1.0, 0.0],
    [0.0, 0.3, 0.0, 0.7, 0.0],
    [0.0, 0.5, 0.5 - 5e-7, 0.0],  # a sum that differs from one, as far as is taken
    [0.0, 0.5, 0.5 + 5e-7, 0.0, 0.0],
    [1 / 3, 1 / 3, 1 / 3, 0.0],
    [0.1] * 10 + [0.0],
    [0.0, 5e-324, 1.0, 0.0],
]


@pytest.mark.parametrize("table", TABLES)
def test_a_state_of_probability_zero_is_never_drawn(table):
    coin = pgm.Discrete("coin", len(table))
    cpd = pgm.TableCPD(coin, table=table)
    edges = np.cumsum(table)
    levels = np.concatenate([[0.0, 5e-324, LAST], edges, np.nextafter(edges, 0), np.linspace(0, 1)])
    levels = levels[levels < 1.0]
    found = cpd._draw(Known({}, (), (levels.size,), None), Uniforms(levels))
    assert (cpd.table[found] > 0.0).all()
    for level, state in zip(levels, found, strict=True):
        assert state == next(k for k, edge in enumerate(edges) if edge > level * edges[-1])


def test_many_states():
    """A bisection of a table with a thousand columns is a search in each row."""
    rng = np.random.default_rng(0)
    row, big = pgm.Discrete("row", 3), pgm.Discrete("big", 1000)
    table = rng.exponential(size=(3, 1000)) * (rng.random((3, 1000)) < 0.5)
    cpd = pgm.TableCPD(big, row, table=table / table.sum(axis=-1, keepdims=True))
    parents, levels = rng.integers(3, size=5000), rng.random(5000)
    found = cpd._draw(Known({row: parents}, (), (5000,), None), Uniforms(levels))
    edges = np.cumsum(cpd.table, axis=-1)
    for k in range(3):
        mine = parents == k
        due = np.searchsorted(edges[k], levels[mine] * edges[k, -1], side="right")
        assert_array_equal(found[mine], due)


def simple():
    x = pgm.Variable("x", components=("east", "north"))
    return x, pgm.BayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 1.0], np.eye(2)), pgm.LinearGaussianCPD(A, {x: [[1, 1]]}, cov=1)]
    )


@pytest.mark.parametrize(
    ("n", "lead"), [(None, ()), (1, (1,)), (4, (4,)), ((2, 3), (2, 3)), (np.int64(2), (2,))]
)
def test_shapes(n, lead):
    x, net = simple()
    drawn = net.sample(n, rng=0)
    assert list(drawn) == [x, A]
    assert drawn[x].shape == (*lead, 2)
    assert drawn[A].shape == (*lead, 1)
    coin, bet = pgm.Discrete("coin", 2), pgm.Discrete("bet", 3)
    toss = pgm.TableCPD(coin, table=[0.5, 0.5])
    net = pgm.BayesianNetwork([toss, pgm.TableCPD(bet, coin, table=[[0.5, 0.5, 0], [0, 0, 1]])])
    drawn = net.sample(n, rng=0)
    assert drawn[coin].shape == drawn[bet].shape == lead
    assert np.issubdtype(drawn[coin].dtype, np.integer)
    assert_array_equal(drawn[bet] == 2, drawn[coin] == 1)


def test_a_seed_draws_the_same_again():
    _, net = simple()
    rng = np.random.default_rng(5)
    first, again, other = (net.sample(3, rng=seed) for seed in (5, 5, 6))
    generated, further = net.sample(3, rng=rng), net.sample(3, rng=rng)
    for variable in net.variables:
        assert_array_equal(first[variable], again[variable])
        assert_array_equal(first[variable], generated[variable])
        assert (first[variable] != other[variable]).all()
        assert (first[variable] != further[variable]).all()


def test_there_is_no_global_random_state():
    np.random.seed(0)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    simple()[1].sample(3, rng=1)
    assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


@pytest.mark.parametrize("rng", [None, True, -1, 1.5, "seed", np.random])
def test_what_draws_is_asked_for(rng):
    with pytest.raises(pgm.ModelError, match=r"rng is a numpy\.random\.Generator or a seed"):
        simple()[1].sample(3, rng=rng)


def doubling(function=lambda u: 2 * u, cov=0.0):
    return pgm.BayesianNetwork([pgm.NonlinearGaussianCPD(A, U, function, cov)])


def test_inputs_broadcast_with_the_draws():
    net, values = doubling(), np.array([[1.0], [2.0], [3.0]])
    assert_array_equal(net.sample(inputs={U: 4}, rng=0)[A], [8.0])
    assert_array_equal(net.sample(inputs={U: values}, rng=0)[A], 2 * values)
    assert_array_equal(net.sample(3, inputs={U: values}, rng=0)[A], 2 * values)
    wide = net.sample((5, 1), inputs={U: values}, rng=0)[A]
    assert_array_equal(wide, np.broadcast_to(2 * values, (5, 3, 1)))


def test_means_and_covariances_of_runs():
    prior = pgm.GaussianCPD(A, [[0.0], [50.0]], np.array([[[0.0]], [[4.0]]]))
    net = pgm.BayesianNetwork([prior, pgm.LinearGaussianCPD(B, {A: 1.0}, cov=0.0)])
    assert net.sample(rng=0)[A].shape == (2, 1)
    drawn = net.sample((20_000, 1), rng=0)
    assert_array_equal(drawn[B], drawn[A])
    assert_array_equal(drawn[A][:, 0], 0.0)
    assert abs(drawn[A][:, 1].mean() - 50.0) < 5 * 2 / np.sqrt(20_000)
    assert abs(drawn[A][:, 1].std() - 2.0) < 5 * 2 / np.sqrt(2 * 20_000)
    with pytest.raises(pgm.ModelError, match=r"n=\(1000, 1\) draws a thousand for each"):
        net.sample(1000, rng=0)


def test_functions_and_noise_of_variables_that_were_drawn():
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(W, 1.0, 0.25),
            pgm.NonlinearGaussianCPD(
                A, (U, W), lambda u, w: u * w**2, pgm.noise(lambda w: w[..., None] ** 2, W)
            ),
        ]
    )
    drawn = net.sample(40_000, inputs={U: -3.0}, rng=0)
    scaled = (drawn[A] + 3.0 * drawn[W] ** 2) / np.abs(drawn[W])
    assert abs(scaled.mean()) < 5 / np.sqrt(40_000)
    assert abs(scaled.std() - 1.0) < 5 / np.sqrt(2 * 40_000)
    near = np.abs(drawn[W]) < 0.5
    assert abs(scaled[near].std() - 1.0) < 5 / np.sqrt(2 * near.sum())


@pytest.mark.parametrize("n", [0, -1, 2.5, "3", True, (2, 0), [2, 3]])
def test_the_number_of_draws_is_checked(n):
    with pytest.raises(pgm.ModelError, match="number of draws"):
        simple()[1].sample(n, rng=0)


def test_inputs_are_asked_for():
    with pytest.raises(pgm.EvidenceError, match="u") as caught:
        doubling().sample(3, rng=0)
    assert caught.value.variable == U
    with pytest.raises(pgm.EvidenceError, match="evidence for c, which the network") as caught:
        doubling().sample(3, inputs={U: 1.0, C: 2.0}, rng=0)
    assert caught.value.variable == C
    with pytest.raises(pgm.EvidenceError, match="a is no input"):
        doubling().sample(3, inputs={U: 1.0, A: 2.0}, rng=0)
    with pytest.raises(pgm.EvidenceError, match=r"'u', which is no variable.* itself, u"):
        doubling().sample(3, inputs={"u": 1.0}, rng=0)
    with pytest.raises(pgm.EvidenceError, match="shape"):
        doubling().sample(3, inputs={U: [1.0, 2.0]}, rng=0)
    with pytest.raises(pgm.EvidenceError, match="NaN"):
        doubling().sample(3, inputs={U: np.nan}, rng=0)
    with pytest.raises(pgm.EvidenceError, match="broadcast"):
        doubling().sample(3, inputs={U: np.zeros((2, 1))}, rng=0)


@pytest.mark.parametrize("n", [None, 3])
@pytest.mark.parametrize("function", [lambda u: u[..., 0], lambda u: np.array(3.0)])
def test_functions_of_wrong_shape_are_refused(function, n):
    with pytest.raises(pgm.ModelError, match="shape") as caught:
        doubling(function).sample(n, inputs={U: 1.0}, rng=0)
    assert caught.value.variable == A
    assert caught.value.cpd.child == A


def test_values_that_are_not_finite_are_refused():
    net = doubling(lambda u: u / 0.0 * 0.0)
    with (
        np.errstate(all="ignore"),
        pytest.raises(pgm.LinearisationError, match=r"NaN or infinite$") as caught,
    ):
        net.sample(inputs={U: 1.0}, rng=0)
    assert caught.value.step is None
    cpd = pgm.NonlinearGaussianCPD(A.at(4), U.at(4), lambda u: np.inf * u, 1.0)
    with pytest.raises(
        pgm.LinearisationError, match=r"a at step 4, run 0, has .* infinite$"
    ) as caught:
        pgm.BayesianNetwork([cpd]).sample(inputs={U.at(4): 1.0}, rng=0)
    assert caught.value.step == 4


def test_malformed_noise_is_refused():
    net = doubling(cov=pgm.noise(lambda u: -(u[..., None] ** 2), given=U))
    with pytest.raises(pgm.ModelError, match="noise") as caught:
        net.sample(inputs={U: 1.0}, rng=0)
    assert caught.value.variable == A


def test_a_kind_of_its_own_cannot_be_drawn_from():
    class Poisson(pgm.cpds.CPD):
        def __init__(self, child):
            self._set_scope(child, ())

    with pytest.raises(pgm.ModelError, match="cannot be drawn from") as caught:
        pgm.BayesianNetwork([Poisson(A)]).sample(rng=0)
    assert isinstance(caught.value.cpd, Poisson)


def test_a_long_chain():
    chain = pgm.variables([f"x{k}" for k in range(1000)])
    cpds = [pgm.GaussianCPD(chain[0], 0.0, 1.0)]
    cpds += [pgm.LinearGaussianCPD(chain[k], {chain[k - 1]: 1.0}, cov=1.0) for k in range(1, 1000)]
    drawn = pgm.BayesianNetwork(cpds).sample(200, rng=0)
    steps = np.diff(np.hstack([drawn[v] for v in chain]), axis=1)
    assert_allclose(steps.std(), 1.0, atol=5 / np.sqrt(2 * steps.size))
