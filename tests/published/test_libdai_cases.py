"""The cases that libDAI publishes of factors and Markov networks.

Numbers and models: J. Mooij, libDAI, tests/testfast.fg and tests/testfast.out (a 4 × 4 grid with
the marginals and errors of its methods), tests/unit/factor_test.cpp, tests/unit/daialg_test.cpp,
tests/unit/factorgraph_test.cpp and examples/example_sprinkler.cpp.
"""

from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

# testfast.fg: two neighbours on a torus, and e^J, the entries of their factor for equal states;
# those for different ones are e^−J.
PAIRS = """
0 1 0.50642682706079    0 3 1.2352015396046     0 4 0.56767940536294    0 12 0.55052656590526
1 2 0.43898294556867    1 5 1.831064078623      1 13 1.3903485747176    2 3 0.58481531122247
2 6 1.5596330646909     2 14 0.89768153552837   3 7 1.0462432557883     3 15 0.77279470413231
4 5 1.3105292388585     4 7 0.97355416145559    4 8 0.4047606195496     5 6 0.43500831412106
5 9 0.76229363075105    6 7 0.64752760170748    6 10 2.0478590660831    7 11 0.80739864245046
8 9 2.6310917043359     8 11 1.6723443743364    8 12 2.0658398413315    9 10 0.54424622899323
9 13 1.9870315102311    10 11 1.2190979644608   10 14 2.0968141189151   11 15 2.1866755921376
12 13 0.3686715885806   12 15 1.7567863273152   13 14 0.97446683998919  14 15 0.50751730577226
"""
# Of each variable the entry of the state 0; that of 1 is its inverse.
ALONE = """
0.79829293324787 1.5037120707519  0.75949272564564 0.952586483626
1.0129167360496  0.3884658377108  1.5143199063099  0.58116800722508
0.94791545998362 0.58284868496538 1.2208444069734  0.45700593414142
1.542447604411   1.3432382535607  0.54039818081703 0.43255190550874
"""
# testfast.out: the probabilities of the state 0, to four digits.
EXACT = """
0.3888 0.5556 0.4587 0.5480   0.6660 0.2107 0.8178 0.2327
0.2171 0.2052 0.7665 0.1217   0.4214 0.5348 0.6291 0.1357
"""
LOOPY = """
0.4233 0.5422 0.4662 0.5424   0.6042 0.1845 0.8203 0.2292
0.3119 0.2975 0.7268 0.1485   0.4512 0.5266 0.6033 0.1558
"""
# The largest and the mean error of the loopy marginals, and what the Bethe value exceeds ln Z by.
MAX_ERROR, MEAN_ERROR, LOG_Z_ERROR = 9.483e-2, 3.078e-2, 2.969e-1


def numbers(text):
    return np.array(text.split(), dtype=float)


def variables(*sizes):
    return [pgm.Discrete(f"x{k}", size) for k, size in enumerate(sizes)]


@pytest.fixture(scope="module")
def grid():
    x = variables(*[2] * 16)
    factors = []
    for i, j, same in numbers(PAIRS).reshape(-1, 3):
        table = [[same, 1.0 / same], [1.0 / same, same]]
        factors.append(pgm.Table((x[int(i)], x[int(j)]), table))
    own = zip(x, numbers(ALONE), strict=True)
    factors += [pgm.Table(v, [first, 1.0 / first]) for v, first in own]
    return pgm.MarkovNetwork(factors)


def first_states(posterior, network):
    by_number = sorted(network.variables, key=lambda v: int(v.name[1:]))
    return np.array([posterior[v].probabilities[0] for v in by_number])


def test_the_grids_exact_marginals(grid):
    assert len(grid.factors) == 48
    found = pgm.infer(pgm.compile(grid), {})
    assert found.log_evidence_kind == "exact"
    assert_allclose(first_states(found, grid), numbers(EXACT), atol=5.1e-5)


@pytest.mark.parametrize("schedule", [pgm.Flooding, pgm.Sequential, pgm.Residual])
def test_the_grids_loopy_marginals(grid, schedule):
    """All of libDAI's orders of updates end at the one fixed point, as ours do."""
    found = pgm.infer(pgm.compile(grid, method=pgm.Bethe()), {}, schedule=schedule(tolerance=1e-9))
    assert found.status.converged.all()
    marginals = first_states(found, grid)
    assert_allclose(marginals, numbers(LOOPY), atol=5.1e-5)
    exact = pgm.infer(pgm.compile(grid), {})
    errors = np.abs(marginals - first_states(exact, grid))
    assert_allclose([errors.max(), errors.mean()], [MAX_ERROR, MEAN_ERROR], rtol=2e-4)
    assert_allclose(found.log_evidence - exact.log_evidence, LOG_Z_ERROR, rtol=2e-4)


def test_the_order_of_axes():
    """Given with the last variable moving slowest, over three variables in another order."""
    four, eight, seven = (pgm.Discrete(n, s) for n, s in (("4", 3), ("8", 2), ("7", 2)))
    values = [0.1, 3.5, 2.8, 6.3, 8.4, 0.0, 7.4, 2.4, 8.9, 1.3, 1.6, 2.6]
    factor = pgm.Table((seven, eight, four), np.reshape(values, (2, 2, 3)))
    due = [0.1, 3.5, 2.8, 7.4, 2.4, 8.9, 6.3, 8.4, 0.0, 1.3, 1.6, 2.6]
    assert factor.rearrange((eight, seven, four)).values.ravel().tolist() == due


def test_sums_of_a_factor():
    (v,) = variables(3)
    factor = pgm.Table(v, [2.0, 0.0, 1.0])
    assert_allclose(factor.log_total, np.log(3.0), rtol=1e-15)
    assert_allclose(factor.normalised().values, [2 / 3, 0.0, 1 / 3], rtol=1e-15)
    assert_allclose(pgm.Table(v, [2.0, 0.0, 2.0]).normalised().values, [0.5, 0.0, 0.5])
    for factor in (pgm.Table((), 5.0), pgm.Table((), 1.0)):
        assert factor.scope == ()
        assert factor[()] in (5.0, 1.0)


@pytest.mark.parametrize("states", [1, 2, 3, 10, 99])
def test_the_entropy_of_equal_probabilities(states):
    assert_allclose(pgm.Table.uniform(variables(states)).entropy(), np.log(states), atol=1e-14)


def test_divergences():
    (v,) = variables(3)
    x, y = pgm.Table(v, [0.2, 0.8, 0.0]), pgm.Table(v, [0.0, 0.6, 0.4])
    assert x.kl(x) == y.kl(y) == 0.0
    assert x.kl(y) == y.kl(x) == np.inf
    x, y = pgm.Table(v, [0.2, 0.7, 0.1]), pgm.Table(v, [0.1, 0.5, 0.4])
    forth = 0.2 * np.log(0.2 / 0.1) + 0.7 * np.log(0.7 / 0.5) + 0.1 * np.log(0.1 / 0.4)
    back = 0.1 * np.log(0.1 / 0.2) + 0.5 * np.log(0.5 / 0.7) + 0.4 * np.log(0.4 / 0.1)
    assert_allclose([x.kl(y), y.kl(x)], [forth, back], rtol=1e-14)


def test_slices_sums_and_maxima():
    """Slices, marginals and max-marginals of a random factor over two and three states."""
    one, two = variables(2, 3)
    x = np.random.default_rng(0).random((3, 2))
    factor = pgm.Table((two, one), x)
    for state in range(2):
        assert factor.reduce({one: state}).values.tolist() == x[:, state].tolist()
    for state in range(3):
        assert factor.reduce({two: state}).values.tolist() == x[state].tolist()
    assert_allclose(factor.marginal(one).values, [x[:, 0].sum(), x[:, 1].sum()])
    assert_allclose(factor.marginal(two).normalised().values, x.sum(axis=1) / x.sum())
    assert_allclose(factor.marginal().values, x.sum())
    assert factor.maximise(two).values.tolist() == [x[:, 0].max(), x[:, 1].max()]
    assert factor.maximise(one).values.tolist() == x.max(axis=1).tolist()
    assert factor.maximise(one, two).values == x.max()


def ising(one, other, coupling):
    level = coupling * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return pgm.Table((one, other), np.exp(level))


def field(variable, strength):
    return pgm.Table(variable, np.exp(strength * np.array([-1.0, 1.0])))


@pytest.mark.parametrize("coupling", np.arange(-1.0, 1.01, 0.1))
def test_an_ising_factor(coupling):
    found = ising(*variables(2, 2), coupling).normalised().values
    same, other = np.exp([coupling, -coupling]) / (4.0 * np.cosh(coupling))
    assert_allclose(found, [[same, other], [other, same]], rtol=1e-13)


def test_all_marginals_of_a_ring():
    x = variables(2, 2, 2, 2)
    factors = [ising(x[k], x[(k + 1) % 4], 1.0) for k in range(4)]
    factors += [field(v, level) for v, level in zip(x, (-1.0, -1.0, -1.0, 1.0), strict=True)]
    joint = factors[0]
    for factor in factors[1:]:
        joint = joint * factor
    network = pgm.MarkovNetwork(factors)
    posterior = pgm.infer(pgm.compile(network), {})
    assert_allclose(posterior.log_evidence, joint.log_total, rtol=1e-14)
    for count in range(1, 5):
        for some in combinations(x, count):
            due = joint.marginal(*some).normalised().values
            assert_allclose(posterior.joint(*some).probabilities, due, atol=1e-14)
            assert_allclose(pgm.query(network, some).probabilities, due, atol=1e-14)


def test_log_scores():
    """The logarithm of the product at one assignment, of factors of equal probabilities."""
    x = variables(2, 2, 2, 3)
    scopes = [(0, 1), (1, 2), (1,)]
    for more, due in (((), 32.0), ((0, 2), 128.0), ((3,), 384.0), ((1, 2, 3), 4608.0)):
        scopes += [more] if more else []
        factors = [pgm.Table.uniform([x[k] for k in scope]) for scope in scopes]
        network = pgm.MarkovNetwork(factors)
        found = pgm.infer(pgm.compile(network), dict.fromkeys(network.variables, 0))
        assert_allclose(found.log_evidence, -np.log(due), rtol=1e-14)


def test_the_sprinkler_of_factors():
    """Murphy's network, each table a factor; P(W=1), P(S=1 | W=1) and P(R=1 | W=1)."""
    cloudy, sprinkler, rain, wet = variables(2, 2, 2, 2)
    network = pgm.MarkovNetwork(
        [
            pgm.Table(cloudy, [0.5, 0.5]),
            pgm.Table((rain, cloudy), [[0.8, 0.2], [0.2, 0.8]]),
            pgm.Table((sprinkler, cloudy), [[0.5, 0.9], [0.5, 0.1]]),
            pgm.Table(
                (wet, rain, sprinkler), [[[1.0, 0.1], [0.1, 0.01]], [[0.0, 0.9], [0.9, 0.99]]]
            ),
        ]
    )
    found = pgm.infer(pgm.compile(network), {wet: 1})
    assert_allclose(np.exp(found.log_evidence), 0.6471, atol=1e-12)
    assert_allclose(found[sprinkler].probabilities[1], 0.2781 / 0.6471, rtol=1e-12)
    assert_allclose(found[rain].probabilities[1], 0.4581 / 0.6471, rtol=1e-12)
