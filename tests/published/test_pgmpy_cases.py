"""The cases that pgmpy publishes of factors and Markov networks.

Numbers and models: A. Ankan et al., pgmpy, in pgmpy/tests: test_factors/test_discrete/
test_Factor.py, test_models/test_DiscreteMarkovNetwork.py, test_models/test_FactorGraph.py,
test_inference/test_VariableElimination.py and test_inference/test_BeliefPropagation.py.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm


def counted(names, sizes):
    """A factor whose entries are 0, 1, 2, ..., the last variable moving fastest."""
    scope = [pgm.Discrete(name, size) for name, size in zip(names, sizes, strict=True)]
    return pgm.Table(scope, np.arange(np.prod(sizes)).reshape(sizes))


def entries(table):
    return table.values * np.exp(table.log_scale)


# Factors.


def test_sums():
    phi = counted("abc", (2, 3, 2))
    a, b, c = phi.scope
    assert_array_equal(phi.marginalise(a).values, [[6, 8], [10, 12], [14, 16]])
    assert_array_equal(phi.marginalise(a, b).values, [30, 36])
    assert_array_equal(phi.marginalise(a, b, c).values, 66)
    phi = counted("abc", (2, 3, 4))
    a, b, c = phi.scope
    due = [[12, 14, 16, 18], [20, 22, 24, 26], [28, 30, 32, 34]]
    assert_array_equal(phi.marginalise(a).values, due)
    assert_array_equal(phi.marginalise(a, b).values, [60, 66, 72, 78])
    assert_array_equal(phi.marginalise(a, b, c).values, 276)
    assert_array_equal(pgm.Table(a, [0.3, 0.7]).marginalise(a).values, 1.0)


def test_maxima():
    phi = counted("abc", (2, 3, 2))
    a, b, _ = phi.scope
    assert_array_equal(phi.maximise(a).values.ravel(), [6, 7, 8, 9, 10, 11])
    assert_array_equal(phi.maximise(a).maximise(b).values, [10, 11])
    assert_array_equal(phi.maximise(a, b).values, [10, 11])
    phi = counted("abc", (2, 3, 4))
    a, b, _ = phi.scope
    assert_array_equal(phi.maximise(a).values.ravel(), np.arange(12, 24))
    assert_array_equal(phi.maximise(a, b).values, [20, 21, 22, 23])
    a, b, c = (pgm.Discrete(name, size) for name, size in zip("abc", (3, 2, 2), strict=True))
    values = [0.25, 0.35, 0.08, 0.16, 0.05, 0.07, 0.0, 0.0, 0.15, 0.21, 0.08, 0.18]
    found = pgm.Table((a, b, c), np.reshape(values, (3, 2, 2))).maximise(b)
    assert_array_equal(found.values.ravel(), [0.25, 0.35, 0.05, 0.07, 0.15, 0.21])


def test_normalised():
    found = counted("abc", (2, 3, 2)).normalised().values.ravel()
    assert_allclose(
        found[[1, 2, 3, 6, 11]], [0.0151515, 0.0303030, 0.0454545, 0.0909091, 1 / 6], atol=5e-8
    )
    found = counted("abc", (2, 3, 4)).normalised().values.ravel()
    assert_allclose(found[[0, 1, 12, 23]], [0.0, 0.00362319, 0.04347826, 0.08333333], atol=5e-9)
    zero = pgm.Table(pgm.Discrete("a", 2), [0.0, 0.0])
    with pytest.raises(pgm.NumericalError, match="zero"):
        zero.normalised()


def test_states_put_in():
    phi = counted("abc", (2, 3, 2))
    a, b, c = phi.scope
    assert_array_equal(phi.reduce({a: 0, b: 0}).values, [0, 1])
    assert_array_equal(phi.reduce({b: 0, a: 0}).values, [0, 1])
    assert_array_equal(phi.reduce({a: 0, b: 0, c: 1}).values, 1)
    phi = counted("abc", (2, 3, 4))
    a, b, c = phi.scope
    assert_array_equal(phi.reduce({a: 0, c: 1}).values, [1, 5, 9])
    assert_array_equal(phi.reduce({a: 1, b: 0, c: 3}).values, 15)
    with pytest.raises(pgm.ModelError):
        phi.reduce({b: 3})


def test_products():
    found = counted("ab", (2, 2)) * counted("cd", (2, 2))
    assert [v.name for v in found.scope] == list("abcd")
    due = [0, 0, 0, 0, 0, 1, 2, 3, 0, 2, 4, 6, 0, 3, 6, 9]
    assert_array_equal(entries(found).ravel(), due)
    found = counted("ab", (3, 2)) * counted("bc", (2, 2))
    assert_array_equal(entries(found).ravel(), [0, 0, 2, 3, 0, 2, 6, 9, 0, 4, 10, 15])
    a, b, c = (pgm.Discrete(name, size) for name, size in zip("abc", (3, 2, 2), strict=True))
    one = pgm.Table((a, b), [[3, 2], [4, 5], [9, 8]])
    found = one * pgm.Table((b, c), [[2, 1], [5, 6]])
    due = [6, 3, 10, 12, 8, 4, 25, 30, 18, 9, 40, 48]
    assert_array_equal(entries(found).ravel(), due)
    assert_allclose(entries(pgm.Table(b, [0.3, 0.7]) * pgm.Table((), 0.5)), [0.15, 0.35])


def test_quotients():
    a, b = pgm.Discrete("a", 2), pgm.Discrete("b", 2)
    found = pgm.Table((a, b), [[1, 2], [2, 4]]) / pgm.Table(a, [1, 2])
    assert_allclose(entries(found), [[1, 2], [1, 2]])
    c = pgm.Discrete("c", 3)
    found = pgm.Table((c, a), [[3, 2], [4, 5], [9, 8]]) / pgm.Table(a, [3, 6])
    due = [1.0, 0.333333, 1.333333, 0.833333, 3.0, 1.333333]
    assert_allclose(entries(found).ravel(), due, atol=5e-7)
    # Theirs is infinite where a number is divided by zero; here that is refused.
    with pytest.raises(pgm.NumericalError, match="cannot divide"):
        pgm.Table((a, b), [[1, 2], [3, 4]]) / pgm.Table(a, [0, 2])


def test_another_order_of_axes():
    phi = counted("abc", (2, 4, 3))
    a, b, c = phi.scope
    due = [0, 1, 2, 12, 13, 14, 3, 4, 5, 15, 16, 17, 6, 7, 8, 18, 19, 20, 9, 10, 11, 21, 22, 23]
    assert_array_equal(phi.rearrange((b, a, c)).values.ravel(), due)


def test_draws_of_a_factor():
    a, b = pgm.Discrete("a", 2), pgm.Discrete("b", 2)
    drawn = pgm.Table((a, b), [[1, 2], [3, 4]]).sample(100_000, rng=0)
    shares = np.bincount(2 * drawn[:, 0] + drawn[:, 1], minlength=4) / 1e5
    assert_allclose(shares, [0.1, 0.2, 0.3, 0.4], atol=5e-3)


# Markov networks.


def test_a_partition_function():
    network = pgm.MarkovNetwork([counted("ab", (2, 2)), counted("bc", (2, 2))])
    assert_allclose(np.exp(pgm.infer(pgm.compile(network), {}).log_evidence), 22.0, rtol=1e-14)


def test_factors_of_equal_tables():
    a, b, c = (pgm.Discrete(name, 2) for name in "abc")
    network = pgm.MarkovNetwork(
        [pgm.Table((a, b), 2 * np.eye(2)), pgm.Table((a, c), 2 * np.eye(2))]
    )
    found = pgm.infer(pgm.compile(network), {})
    assert_allclose(found[a].probabilities * np.exp(found.log_evidence), [4, 4], rtol=1e-14)


A, R, J, Q, L, G = STUDY = [pgm.Discrete(name, 2) for name in "ARJQLG"]
TABLES = [
    ((A,), [0.2, 0.8]),
    ((R,), [0.4, 0.6]),
    ((J, A, R), [[[0.9, 0.6], [0.7, 0.1]], [[0.1, 0.4], [0.3, 0.9]]]),
    ((Q, J), [[0.9, 0.2], [0.1, 0.8]]),
    ((L, J, G), [[[0.9, 0.45], [0.8, 0.1]], [[0.1, 0.55], [0.2, 0.9]]]),
    ((G,), [0.6, 0.4]),
]


def study(directed):
    """The network as CPDs, the child's axis last, or as factors."""
    if not directed:
        return pgm.MarkovNetwork([pgm.Table(scope, table) for scope, table in TABLES])
    return pgm.BayesianNetwork(
        pgm.TableCPD(scope[0], scope[1:], table=np.moveaxis(np.array(table), 0, -1))
        for scope, table in TABLES
    )


@pytest.fixture(params=[True, False], ids=["directed", "undirected"])
def network(request):
    return study(request.param)


def test_marginals(network):
    found = pgm.infer(pgm.compile(network), {})
    assert_allclose(found.log_evidence, 0.0, atol=1e-14)
    assert_allclose(found[J].probabilities, [0.416, 0.584], rtol=1e-13)
    due = [[0.3744, 0.0416], [0.1168, 0.4672]]
    assert_allclose(found.joint(J, Q).probabilities, due, rtol=1e-13)
    assert_allclose(pgm.query(network, (J, Q)).probabilities, due, rtol=1e-13)


def test_marginals_with_evidence(network):
    """Theirs are not normalised: they sum to the probability of the evidence."""
    graph = pgm.compile(network)
    found = pgm.infer(graph, {A: 0, R: 1})
    assert_allclose(found[J].probabilities, [0.6, 0.4], rtol=1e-13)
    level = np.exp(found.log_evidence)
    assert_allclose(level * found[J].probabilities, [0.072, 0.048], rtol=1e-13)
    known = {A: 0, R: 0, G: 0, L: 1}
    found = pgm.infer(graph, known)
    joint = found.joint(J, Q).probabilities
    due = [[0.73636364, 0.08181818], [0.03636364, 0.14545455]]
    assert_allclose(joint, due, atol=5e-9)
    assert_allclose(pgm.query(network, (J, Q), known).probabilities, due, atol=5e-9)
    due = [[0.003888, 0.000432], [0.000192, 0.000768]]
    assert_allclose(np.exp(found.log_evidence) * joint, due, rtol=1e-12)


def indices(found):
    return {v.name: v.states.index(state) for v, state in found.assignment.items()}


def test_the_most_probable_assignment(network):
    graph = pgm.compile(network)
    found = pgm.most_probable(graph, {})
    assert indices(found) == {"A": 1, "R": 1, "J": 1, "Q": 1, "G": 0, "L": 0}
    assert_allclose(np.exp(found.log_probability), 0.1659, atol=5e-5)
    best = pgm.most_probable(graph, {}, count=2)
    assert {v.name: int(states[0]) for v, states in best.assignment.items()} == indices(found)
    known = {J: 0, Q: 1, G: 0}
    found = pgm.most_probable(graph, known, variables=(A, R, L))
    assert indices(found) == {"A": 1, "R": 0, "L": 0}


def test_marginal_map(network):
    """The largest probability of some variables, the others summed out."""
    graph = pgm.compile(network)
    for some, due in (((G,), 0.6), ((G, R), 0.36), ((G, R, A), 0.288)):
        found = pgm.most_probable(graph, {}, variables=some)
        assert_allclose(np.exp(found.log_probability), due, rtol=1e-13)


def test_beliefs_of_clusters():
    """Of a chain of three factors: each unnormalised, as the product's marginal."""
    factors = [counted("AB", (2, 3)), counted("BC", (3, 2)), counted("CD", (2, 2))]
    joint = np.einsum("ab,bc,cd->abcd", *(f.values for f in factors))
    graph = pgm.compile(pgm.MarkovNetwork(factors))
    found = pgm.infer(graph, {})
    due = {"AB": joint.sum((2, 3)), "BC": joint.sum((0, 3)), "CD": joint.sum((0, 1))}
    assert len(graph) == 3
    for cluster in graph.clusters:
        table = found.belief(cluster.index)
        order = sorted(table.scope, key=lambda v: v.name)
        own = entries(table.rearrange(order))
        assert_allclose(own, due["".join(v.name for v in order)], rtol=1e-12)


def test_beliefs_of_a_longer_chain():
    values = [
        [0.1, 0.9, 0.6, 0.4],
        [0.7, 0.3, 0.2, 0.8],
        [0.5, 0.5, 0.9, 0.1],
        [0.3, 0.7, 0.4, 0.6],
        [0.8, 0.2, 0.1, 0.9],
    ]
    x = [pgm.Discrete(name, 2) for name in "ABCDEF"]
    factors = [pgm.Table(x[k : k + 2], np.reshape(v, (2, 2))) for k, v in enumerate(values)]
    joint = np.einsum("ab,bc,cd,de,ef->abcdef", *(f.values for f in factors))
    network = pgm.MarkovNetwork(factors)
    found = pgm.infer(pgm.compile(network), {})
    assert_allclose(np.exp(found.log_evidence), joint.sum(), rtol=1e-13)
    best = pgm.most_probable(pgm.compile(network), {})
    assert_allclose(np.exp(best.log_probability), joint.max(), rtol=1e-13)
    for k in range(5):
        due = joint.sum(tuple(i for i in range(6) if i not in (k, k + 1)))
        own = found.joint(x[k], x[k + 1]).probabilities * np.exp(found.log_evidence)
        assert_allclose(own, due, rtol=1e-12)


@pytest.fixture(scope="module")
def tree():
    """A factor graph that is a tree."""
    a, b, c, d = (pgm.Discrete(n, s) for n, s in (("A", 2), ("B", 3), ("C", 2), ("D", 3)))
    factors = [
        pgm.Table(a, [0.4, 0.6]),
        pgm.Table((b, a), [[0.2, 0.05], [0.3, 0.15], [0.5, 0.8]]),
        pgm.Table((c, b), [[0.4, 0.5, 0.1], [0.6, 0.5, 0.9]]),
        pgm.Table((d, b), [[0.1, 0.1, 0.2], [0.3, 0.2, 0.1], [0.6, 0.7, 0.7]]),
    ]
    return (a, b, c, d), pgm.MarkovNetwork(factors)


@pytest.mark.parametrize("loopy", [False, True])
def test_a_factor_graph(tree, loopy):
    """By a junction tree, and by messages between factors and variables, exact on a tree."""
    (a, b, c, d), network = tree
    graph = pgm.compile(network, method=pgm.Bethe() if loopy else pgm.JunctionTree())
    schedule = {"schedule": pgm.Flooding(tolerance=1e-12)} if loopy else {}

    def asked(evidence):
        return pgm.infer(graph, evidence, **schedule)

    found = asked({})
    due = {a: [0.4, 0.6], b: [0.11, 0.21, 0.68], c: [0.217, 0.783], d: [0.168, 0.143, 0.689]}
    for variable, probabilities in due.items():
        assert_allclose(found[variable].probabilities, probabilities, atol=1e-10)
    found = asked({a: 1, d: 0})
    assert_allclose(found[b].probabilities, [0.02777778, 0.08333333, 0.88888889], atol=5e-9)
    assert_allclose(found[c].probabilities, [0.14166667, 0.85833333], atol=5e-9)
    found = asked({a: pgm.soft([0.1, 0.9])})
    assert_allclose(found[b].probabilities, [0.06034483, 0.16034483, 0.77931034], atol=5e-9)
    found = asked({d: 0, a: pgm.soft([0.027, 0.972]), b: pgm.soft([0.3, 0.6, 0.1])})
    assert_allclose(found[b].probabilities, [0.05938567, 0.3440273, 0.59658703], atol=5e-9)
    assert_allclose(found[c].probabilities, [0.25542662, 0.74457338], atol=5e-9)
    # Two opinions of one variable are their product, by numbers or by logarithms.
    for both in (pgm.soft([0.03, 0.63]), pgm.soft(np.log([0.03, 0.63]), log=True)):
        found = asked({a: both})
        assert_allclose(found[b].probabilities, [0.05461538, 0.15461538, 0.79076923], atol=5e-9)


def test_virtual_evidence():
    names = ("yes", "no")
    snow, risk, late = (pgm.Discrete(name, names) for name in ("Snow", "Risk", "Late"))
    traffic = pgm.Discrete("Traffic", ("normal", "slow"))
    network = pgm.BayesianNetwork(
        [
            pgm.TableCPD(snow, table=[0.4, 0.6]),
            pgm.TableCPD(risk, given=snow, table=[[0.8, 0.2], [0.4, 0.6]]),
            pgm.TableCPD(traffic, given=snow, table=[[0.4, 0.6], [0.65, 0.35]]),
            pgm.TableCPD(
                late,
                given=(risk, traffic),
                table=[[[0.45, 0.55], [0.85, 0.15]], [[0.1, 0.9], [0.7, 0.3]]],
            ),
        ]
    )
    told = {traffic: pgm.soft([0.3, 0.7])}
    due = {
        "one": [(snow, 0.45), (risk, 0.58), (late, 0.61625), (traffic, 0.34375)],
        "two": [(snow, 0.52443609), (risk, 0.76315789), (late, 0.66480263), (traffic, 0.32730263)],
        "slow": [(snow, 0.533333), (risk, 0.613333), (late, 0.7920)],
    }
    both = {**told, risk: pgm.soft([0.7, 0.3])}
    graph = pgm.compile(network)
    for evidence, key in ((told, "one"), (both, "two"), ({traffic: "slow"}, "slow")):
        found = pgm.infer(graph, evidence)
        for variable, first in due[key]:
            assert_allclose(found[variable].probabilities[0], first, atol=5.1e-7)
            asked = pgm.query(network, variable, evidence)
            assert_allclose(asked.probabilities[0], first, atol=5.1e-7)
            best = pgm.most_probable(graph, evidence, variables=variable)
            assert best.assignment[variable] == variable.states[int(first < 0.5)]


def test_many_children_of_one_parent():
    """The probability of a parent after each of the first of ten children, to two decimals."""
    parent = pgm.Discrete("parent", 2)
    children = [pgm.Discrete(f"child {k}", 2) for k in range(10)]
    table = [[0.9, 0.1], [0.1, 0.9]]
    network = pgm.BayesianNetwork(
        [
            pgm.TableCPD(parent, table=[0.5, 0.5]),
            *(pgm.TableCPD(child, given=parent, table=table) for child in children),
        ]
    )
    graph = pgm.compile(network)
    for seen, due in enumerate((0.5, 0.9, 0.9878, 0.9987)):
        found = pgm.infer(graph, dict.fromkeys(children[:seen], 1))
        assert_allclose(found[parent].probabilities[1], due, atol=2e-4)
