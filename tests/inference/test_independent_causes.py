"""Networks with CPDs of independent causes: equal to those of their tables, and where none is."""

import io
import pickle
from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm import CausalIndependence, Discrete, NoisyOr, TableCPD
from pgm.errors import EvidenceError, GraphError, ModelError

NO_YES = ("no", "yes")
CAUSES = [Discrete(f"d{k}", NO_YES) for k in range(6)]
Y, Z = (Discrete(name, NO_YES) for name in "yz")
MANY = [Discrete(f"d{k}", NO_YES) for k in range(30)]


def as_tables(cpds):
    return [
        TableCPD(cpd.child, cpd.given, table=cpd.table)
        if isinstance(cpd, CausalIndependence)
        else cpd
        for cpd in cpds
    ]


def drawn(rng, operation=None):
    """A network with two such CPDs of up to eight causes, among these one another."""
    sizes = rng.integers(2, 4, rng.integers(4, 8))
    found = [Discrete(f"v{k}", int(size)) for k, size in enumerate(sizes)]
    cpds = []
    for k, v in enumerate(found):
        given = [u for u in found[:k] if rng.random() < 0.3]
        table = rng.dirichlet(np.ones(v.size), tuple(u.size for u in given))
        cpds.append(TableCPD(v, given, table=table))
    for name in ("y", "z"):
        child = Discrete(name, int(rng.integers(2, 4)))
        given = [v for v in found if rng.random() < 0.8] or found
        own = [rng.dirichlet(np.full(child.size, 0.5), v.size) for v in given]
        for k in np.flatnonzero(rng.random(len(given)) < 0.3):
            own[k] = np.eye(child.size)[rng.integers(child.size, size=given[k].size)]
        leak = rng.dirichlet(np.ones(child.size)) if rng.random() < 0.5 else None
        how = np.maximum if operation is None else rng.integers(0, child.size, (child.size,) * 2)
        cpds.append(CausalIndependence(child, given, own, how, leak))
        found.append(child)
    return pgm.BayesianNetwork(cpds)


def evidence_of(net, rng, share=0.3):
    """States that are possible together, since they were drawn together."""
    states = net.sample(rng=rng)
    return {v: int(states[v]) for v in net.variables if rng.random() < share}


@pytest.mark.parametrize("seed", range(16))
def test_posteriors_are_those_of_the_tables(seed):
    rng = np.random.default_rng(seed)
    net = drawn(rng, operation=seed % 2 or None)
    twin = pgm.BayesianNetwork(as_tables(net.cpds))
    evidence = evidence_of(net, rng)
    order = [net.variables[k] for k in rng.permutation(len(net.variables))]
    expected = pgm.infer(pgm.compile(twin), evidence)
    hidden = [v for v in net.variables if v not in evidence]
    for method in (pgm.JunctionTree(), pgm.JunctionTree(order), pgm.JoinGraph(10**6)):
        graph = pgm.compile(net, method=method)
        graph.check()
        assert graph.network is net
        found = pgm.infer(graph, evidence)
        assert_allclose(found.log_evidence, expected.log_evidence, atol=1e-11)
        for v in hidden:
            assert_allclose(found[v].values, expected[v].values, atol=1e-12)
            assert_allclose(pgm.query(net, v, evidence).values, expected[v].values, atol=1e-12)
            assert_allclose(pgm.query(graph, v, evidence).values, expected[v].values, atol=1e-12)
        if len(hidden) > 1:
            pair = hidden[0], hidden[-1]
            assert_allclose(found.joint(*pair).values, expected.joint(*pair).values, atol=1e-12)


@pytest.mark.parametrize("seed", range(12))
def test_the_likeliest_assignments_are_those_of_the_tables(seed):
    """Sums over what causes amount to stand inside the maximum."""
    rng = np.random.default_rng(100 + seed)
    net = drawn(rng, operation=seed % 2 or None)
    graph = pgm.compile(net)
    twin = pgm.compile(pgm.BayesianNetwork(as_tables(net.cpds)))
    evidence = evidence_of(net, rng, 0.2)
    weighed = next((v for v in net.variables if v not in evidence), None)
    if weighed is not None and seed % 3 == 0:
        evidence[weighed] = pgm.soft(rng.uniform(0.1, 1.0, weighed.size))
    best, expected = pgm.most_probable(graph, evidence), pgm.most_probable(twin, evidence)
    assert dict(best.assignment) == dict(expected.assignment)
    assert list(best.assignment) == list(net.variables)
    assert_allclose(best.log_probability, expected.log_probability, atol=1e-11)
    assert best.exact
    best = pgm.most_probable(graph, evidence, count=9)
    expected = pgm.most_probable(twin, evidence, count=9)
    assert_allclose(best.log_probability, expected.log_probability, atol=1e-11)
    assert list(best.assignment) == list(net.variables)
    for v in net.variables:
        assert_array_equal(best.assignment[v], expected.assignment[v])
    asked = [v for v in net.variables if v not in evidence][:2]
    if asked:
        best = pgm.most_probable(graph, evidence, variables=asked)
        expected = pgm.most_probable(twin, evidence, variables=asked)
        assert dict(best.assignment) == dict(expected.assignment)
        assert_allclose(best.log_probability, expected.log_probability, atol=1e-11)


def test_maxima_in_place_of_sums_would_be_another_assignment():
    """A case that tells the two apart: each way to the same state is unlikely by itself."""
    four = CAUSES[:4]
    prior = [0.31, 0.35, 0.57, 0.56]
    cpds = [TableCPD(v, table=[1 - p, p]) for v, p in zip(four, prior, strict=True)]
    net = pgm.BayesianNetwork([*cpds, NoisyOr(Y, four, [0.53, 0.37, 0.25, 0.31], leak=0.3)])
    best = pgm.most_probable(pgm.compile(net), {})
    twin = pgm.BayesianNetwork(as_tables(net.cpds))
    joint = pgm.infer(pgm.compile(twin), {}).joint(*twin.variables).values
    at = np.unravel_index(joint.argmax(), joint.shape)
    assert [v.index(best.assignment[v]) for v in net.variables] == list(at)
    assert_allclose(best.log_probability, np.log(joint.max()), atol=1e-12)
    # The intermediate variables as others, which have states of their own in the maximum.
    naive = pgm.most_probable(pgm.compile(net._factorised), {})
    assert any(naive.assignment[v] != best.assignment[v] for v in net.variables)


def test_runs_of_evidence():
    rng = np.random.default_rng(5)
    net = drawn(rng)
    twin = pgm.compile(pgm.BayesianNetwork(as_tables(net.cpds)))
    graph = pgm.compile(net)
    states = net.sample(12, rng=1)
    evidence = {v: np.where(rng.random(12) < 0.5, states[v], -1) for v in net.variables[-3:]}
    found, expected = pgm.infer(graph, evidence), pgm.infer(twin, evidence)
    assert_allclose(found.log_evidence, expected.log_evidence, atol=1e-11)
    for v in net.variables[:2]:
        assert_allclose(found[v].values, expected[v].values, atol=1e-12)
        assert_allclose(pgm.query(net, v, evidence).values, expected[v].values, atol=1e-12)
    best, expected = pgm.most_probable(graph, evidence), pgm.most_probable(twin, evidence)
    assert_allclose(best.log_probability, expected.log_probability, atol=1e-11)
    for v in net.variables:
        assert_array_equal(best.assignment[v], expected.assignment[v])


def test_all_variables_observed():
    net = pair()
    states = {v: int(s) for v, s in net.sample(rng=0).items()}
    graph = pgm.compile(net)
    density = sum(float(c.log_density(states[c.child], states_of(c, states))) for c in net.cpds)
    assert_allclose(pgm.infer(graph, states).log_evidence, density, atol=1e-12)
    best = pgm.most_probable(graph, states)
    assert {v: v.index(s) for v, s in best.assignment.items()} == states
    assert_allclose(best.log_probability, density, atol=1e-12)
    assert pgm.most_probable(graph, states, count=3).log_probability.shape == (1,)


def states_of(cpd, states):
    return {v: states[v] for v in cpd.parents}


def pair():
    """Two children of six causes."""
    return pgm.BayesianNetwork(
        [
            *(TableCPD(v, table=[0.75, 0.25]) for v in CAUSES),
            NoisyOr(Y, CAUSES, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], leak=0.05),
            NoisyOr(Z, CAUSES, [0.6, 0.5, 0.4, 0.3, 0.2, 0.1]),
        ]
    )


def test_samples_of_a_posterior():
    net = pair()
    posterior = pgm.infer(pgm.compile(net), {Y: "yes"})
    drawn = posterior.sample(20_000, rng=0)
    assert list(drawn) == [*CAUSES, Z]
    for v in drawn:
        assert_allclose(drawn[v].mean(), posterior[v]["yes"], atol=5 * 0.5 / np.sqrt(20_000))
    both = posterior.joint(CAUSES[4], CAUSES[5]).values[1, 1]
    found = (drawn[CAUSES[4]] & drawn[CAUSES[5]]).mean()
    assert_allclose(found, both, atol=5 * 0.5 / np.sqrt(20_000))
    forward = net.sample(20_000, rng=1)
    assert_allclose(forward[Y].mean(), pgm.query(net, Y)["yes"], atol=0.02)


@pytest.mark.parametrize("method", [pgm.Bethe(), pgm.LTRIP(), pgm.JoinGraph(8)])
def test_graphs_with_loops(method):
    """One child's factors are a tree: messages around it are exact."""
    net = pgm.BayesianNetwork(pair().cpds[:-1])
    graph = pgm.compile(net, method=method)
    graph.check()
    assert max(graph.sizes) <= 8
    found = pgm.infer(graph, {Y: "yes"}, schedule=pgm.Flooding(iterations=100))
    expected = pgm.infer(pgm.compile(net), {Y: "yes"})
    assert_allclose(found.log_evidence, expected.log_evidence, atol=1e-9)
    for v in CAUSES:
        assert_allclose(found[v].values, expected[v].values, atol=1e-9)


def test_graphs_by_hand_hold_whole_families_or_factors():
    net = pair()
    expected = pgm.infer(pgm.compile(net), {Y: "yes", Z: "no"})
    whole = pgm.ClusterGraph(net, [{*CAUSES, Y}, {*CAUSES, Z}])
    assert whole.sizes == (128, 128)
    made = pgm.compile(net)
    again = pgm.ClusterGraph(net, [c.scope for c in made.clusters], made.sepsets)
    for graph in (whole, again):
        graph.check()
        found = pgm.infer(graph, {Y: "yes", Z: "no"})
        assert_allclose(found.log_evidence, expected.log_evidence, atol=1e-12)
        for evidence in ({Y: "no"}, {Y: "yes", Z: "no"}):
            asked = pgm.query(graph, CAUSES[0], evidence).values
            assert_allclose(asked, pgm.query(net, CAUSES[0], evidence).values, atol=1e-12)
    assert_array_equal(
        pgm.most_probable(whole, {Y: "yes"}).states(CAUSES[5]),
        pgm.most_probable(made, {Y: "yes"}).states(CAUSES[5]),
    )
    with pytest.raises(GraphError, match="whole family of its child and all causes"):
        pgm.ClusterGraph(net, [CAUSES, {Y, Z}])


def test_intermediate_variables_are_told_in_clusters_alone():
    net = pair()
    graph = pgm.compile(net)
    inside = {v for cluster in graph.clusters for v in cluster.scope} - set(net.variables)
    assert {repr(v) for v in inside} == {f"{c} up to d{k}" for c in "yz" for k in range(1, 5)}
    posterior = pgm.infer(graph, {Y: "yes"})
    assert "up to" not in f"{posterior} {net} {net.cpd(Y)} {graph.network}"
    assert set(net.to_networkx()) == set(net.variables)
    some = next(iter(inside))
    for ask in (
        lambda: posterior[some],
        lambda: pgm.query(net, some),
        lambda: pgm.query(graph, some),
        lambda: pgm.infer(graph, {some: 0}),
        lambda: pgm.most_probable(graph, {some: 0}),
    ):
        with pytest.raises(EvidenceError, match="network"):
            ask()
    assert set(pgm.MinFill()(net)) == set(net.variables)
    assert net.separated(CAUSES[0], CAUSES[1])
    assert not net.separated(CAUSES[0], CAUSES[1], given=Y)
    taken = Discrete("y up to d1", NO_YES)
    more = pgm.BayesianNetwork([*net.cpds, TableCPD(taken, table=[0.5, 0.5])])
    assert "y up to d1'" in str(pgm.compile(more))


def test_a_table_that_is_no_larger_stays_one():
    for count, clusters in ((2, 1), (3, 1), (4, 3)):
        cpds = [TableCPD(v, table=[0.5, 0.5]) for v in CAUSES[:count]]
        net = pgm.BayesianNetwork([*cpds, NoisyOr(Y, CAUSES[:count], [0.5] * count)])
        assert len(pgm.compile(net)) == clusters


def test_intervention_copies_and_markov_networks():
    net = pair()
    done = net.do({CAUSES[5]: "yes"})
    off = 0.95 * (1 - 0.6) * np.prod(1 - 0.25 * np.array([0.1, 0.2, 0.3, 0.4, 0.5]))
    assert_allclose(pgm.query(done, Y)["no"], off, rtol=1e-12)
    graph = pickle.loads(pickle.dumps(pgm.compile(net)))
    assert_allclose(pgm.infer(graph, {})[Y].values, pgm.query(net, Y).values, atol=1e-12)
    extra = pgm.Table(CAUSES[:2], [[1.0, 2.0], [2.0, 1.0]])
    found = pgm.compile(pgm.MarkovNetwork([*net.cpds, extra]))
    expected = pgm.compile(pgm.MarkovNetwork([*as_tables(net.cpds), extra]))
    for evidence in ({}, {Y: "yes"}):
        one, other = pgm.infer(found, evidence), pgm.infer(expected, evidence)
        assert_allclose(one.log_evidence, other.log_evidence, atol=1e-12)


def test_beside_continuous_variables():
    x = pgm.Variable("x")
    cases = {"no": pgm.GaussianCPD(x, 0, 1), "yes": pgm.GaussianCPD(x, 3, 1)}
    cpds = [*pair().cpds, pgm.SwitchingCPD(x, Y, cases)]
    found = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), {x: 2.0})
    expected = pgm.infer(pgm.compile(pgm.BayesianNetwork(as_tables(cpds))), {x: 2.0})
    assert_allclose(found.log_evidence, expected.log_evidence, atol=1e-12)
    for v in (*CAUSES, Y, Z):
        assert_allclose(found[v].values, expected[v].values, atol=1e-12)


def chain(made):
    """A dynamic network with such CPDs in its prior, transition and sensor."""
    three = CAUSES[:3]
    cpds = [NoisyOr(Y, three, [0.1, 0.5, 0.3])]
    moves = [NoisyOr(Y, [*three, Y.previous], [0.1, 0.5, 0.3, 0.7])]
    sensor = [NoisyOr(Z, [Y, three[0]], [0.9, 0.5], leak=0.1)]
    stay = [[0.9, 0.1], [0.1, 0.9]]
    return pgm.DynamicBayesianNetwork(
        prior=[*(TableCPD(v, table=[0.8, 0.2]) for v in three), *made(cpds)],
        transition=[*(TableCPD(v, v.previous, table=stay) for v in three), *made(moves)],
        observation=made(sensor),
    )


def test_over_time():
    model, twin = chain(list), chain(as_tables)
    evidence = {Z: ["yes", "no", "yes"]}
    found, expected = pgm.smooth(model, evidence), pgm.smooth(twin, evidence)
    assert_allclose(found.log_evidence, expected.log_evidence, atol=1e-12)
    assert_allclose(found[Y].values, expected[Y].values, atol=1e-12)
    assert model.sample(steps=4, rng=0)[Y].shape == (5,)
    unrolled = {Z.at(2): "yes", Z.at(3): "no"}
    found = pgm.infer(pgm.compile(model.unroll(3)), unrolled)
    expected = pgm.infer(pgm.compile(twin.unroll(3)), unrolled)
    assert_allclose(found.log_evidence, expected.log_evidence, atol=1e-12)
    assert_allclose(found[Y.at(3)].values, expected[Y.at(3)].values, atol=1e-12)
    with pytest.raises(ModelError, match="of independent causes"):
        pgm.fit(model, evidence, learn={Y: pgm.learning.Table()})


def quickscore(prior, probabilities, leak, off, on):
    """Inclusion and exclusion over the findings that are there (Heckerman, 1989)."""
    total = 0.0
    for count in range(len(on) + 1):
        for some in combinations(on, count):
            every = [*off, *some]
            left = np.prod(1 - probabilities[every], axis=0)
            total += (-1) ** count * np.prod(1 - leak[every]) * np.prod(1 - prior + prior * left)
    return total


def findings(count):
    """Diseases and findings, two layers, of the network of QMR."""
    rng = np.random.default_rng(3)
    prior = rng.uniform(0.02, 0.3, 30)
    probabilities, leak = rng.uniform(0, 0.3, (count, 30)), rng.uniform(0.01, 0.05, count)
    found = [Discrete(f"f{k}", NO_YES) for k in range(count)]
    cpds = [TableCPD(v, table=[1 - p, p]) for v, p in zip(MANY, prior, strict=True)]
    rows = zip(found, probabilities, leak.tolist(), strict=True)
    cpds += [NoisyOr(f, MANY, own, share) for f, own, share in rows]
    return pgm.BayesianNetwork(cpds), found, (prior, probabilities, leak)


@pytest.mark.parametrize("on", [0, 1, 2, 3])
def test_diagnosis_with_thirty_diseases(on):
    net, found, (prior, *rest) = findings(12)
    off = range(on, 10)  # two more were not looked for
    evidence = {f: "yes" if k < on else "no" for k, f in enumerate(found[:10])}
    total = quickscore(prior, *rest, off, range(on))
    for k in (0, 17, 29):
        with_it = np.where(np.arange(30) == k, 1.0, prior)
        expected = prior[k] * quickscore(with_it, *rest, off, range(on)) / total
        assert_allclose(pgm.query(net, MANY[k], evidence)["yes"], expected, rtol=1e-9)
    small = pgm.BayesianNetwork([net.cpd(v) for v in (*MANY, *found[:3])])
    graph = pgm.compile(small)
    assert max(graph.sizes) <= 2**8
    some = {f: evidence[f] for f in found[:3]}
    total = quickscore(prior, *rest, range(min(on, 3), 3), range(min(on, 3)))
    assert_allclose(pgm.infer(graph, some).log_evidence, np.log(total), rtol=1e-9)


def test_the_likeliest_diseases():
    """Findings that are not there weigh each disease by itself; one that is joins them."""
    net, found, (prior, probabilities, leak) = findings(2)
    graph = pgm.compile(net)
    best = pgm.most_probable(graph, dict.fromkeys(found, "no"))
    weight = prior * np.prod(1 - probabilities, axis=0)
    expected = np.log(np.maximum(weight, 1 - prior)).sum() + np.log(1 - leak).sum()
    assert_allclose(best.log_probability, expected, rtol=1e-12)
    assert [best.assignment[v] == "yes" for v in MANY] == list(weight > 1 - prior)
    several = pgm.most_probable(graph, dict.fromkeys(found, "no"), count=2)
    odds = np.sort(np.abs(np.log(weight) - np.log(1 - prior)))
    assert_allclose(several.log_probability, [expected, expected - odds[0]], rtol=1e-12)
    best = pgm.most_probable(graph, {found[0]: "yes", found[1]: "no"})
    assert best.exact
    own = [k for k, v in enumerate(MANY) if best.assignment[v] == "yes"]

    def level(some):
        """ln p of some diseases, with the first finding there and the second not."""
        ill = np.isin(np.arange(30), some)
        absent = (1 - leak) * np.prod(np.where(ill, 1 - probabilities, 1.0), axis=1)
        shares = np.log(np.where(ill, prior, 1 - prior)).sum()
        return shares + np.log1p(-absent[0]) + np.log(absent[1])

    assert_allclose(best.log_probability, level(own), rtol=1e-12)
    others = [level(some) for count in range(4) for some in combinations(range(30), count)]
    assert max(others) <= best.log_probability + 1e-12
    assert len(own) <= 3
    second = pgm.most_probable(graph, {found[0]: "yes", found[1]: "no"}, count=2)
    assert_allclose(second.log_probability, sorted(others)[:-3:-1], rtol=1e-12)
    known = dict.fromkeys(MANY[8:], "no")
    best = pgm.most_probable(graph, {found[0]: "yes", **known, found[1]: "no"})
    few = pgm.BayesianNetwork(
        [
            *(net.cpd(v) for v in MANY[:8]),
            *(NoisyOr(f, MANY[:8], probabilities[k, :8], leak[k]) for k, f in enumerate(found)),
        ]
    )
    twin = pgm.most_probable(
        pgm.compile(pgm.BayesianNetwork(as_tables(few.cpds))), {found[0]: "yes", found[1]: "no"}
    )
    assert [best.assignment[v] for v in MANY[:8]] == [twin.assignment[v] for v in MANY[:8]]
    with pytest.raises(GraphError, match="one run after another; leave executor="):
        pgm.most_probable(graph, {}, executor=object())
    with pytest.raises(EvidenceError, match="are of one set of evidence"):
        pgm.most_probable(graph, {found[0]: [0, 0]}, count=2)


def test_three_hundred_causes():
    rng = np.random.default_rng(0)
    causes = [Discrete(f"d{k}", NO_YES) for k in range(300)]
    prior, p = rng.uniform(0, 0.02, 300), rng.uniform(0, 0.5, 300)
    cpds = [TableCPD(v, table=[1 - q, q]) for v, q in zip(causes, prior, strict=True)]
    net = pgm.BayesianNetwork([*cpds, NoisyOr(Y, causes, p, leak=1e-3)])
    graph = pgm.compile(net)
    assert graph.width == 2
    assert graph.cost < 2500
    posterior = pgm.infer(graph, {Y: "yes"})
    off = (1 - 1e-3) * np.prod(1 - prior * p)
    assert_allclose(posterior.log_evidence, np.log1p(-off), rtol=1e-12)
    without = off / (1 - prior * p) * (1 - p)
    expected = prior * (1 - without) / (1 - off)
    assert_allclose([posterior[v]["yes"] for v in causes], expected, rtol=1e-10)


def test_certain_causes_and_impossible_evidence():
    five = CAUSES[:5]
    cpds = [TableCPD(v, table=[0.5, 0.5]) for v in five]
    net = pgm.BayesianNetwork([*cpds, NoisyOr(Y, five, [1.0] * 5)])
    graph = pgm.compile(net)
    assert_allclose(pgm.query(net, Y)["no"], 2.0**-5, rtol=1e-14)
    found = pgm.infer(graph, {Y: "no"})
    assert [found[v]["yes"] for v in five] == [0.0] * 5
    for evidence in (
        {Y: "no", five[2]: "yes"},
        {Y: "no", five[4]: "yes"},
        {Y: "yes", **dict.fromkeys(five[1:], "no"), five[0]: pgm.soft([1.0, 0.0])},
    ):
        for ask in (
            lambda known: pgm.infer(graph, known),
            lambda known: pgm.query(net, five[0], known),
            lambda known: pgm.query(graph, five[0], known),
            lambda known: pgm.most_probable(graph, known),
            lambda known: pgm.most_probable(graph, known, count=2),
        ):
            with pytest.raises(EvidenceError, match="probability zero") as told:
                ask(evidence)
            assert told.value.variable in net.variables
    allowed = pgm.infer(graph, {Y: [0, 1], five[2]: [1, 1]}, impossible="allow")
    assert_array_equal(np.isneginf(allowed.log_evidence), [True, False])


def test_tiny_probabilities():
    five = CAUSES[:5]
    cpds = [TableCPD(v, table=[1 - 1e-9, 1e-9]) for v in five]
    net = pgm.BayesianNetwork([*cpds, NoisyOr(Y, five, [1e-12] * 5)])
    found = pgm.infer(pgm.compile(net), {Y: "yes"})
    assert_allclose(found.log_evidence, np.log(5e-21), rtol=1e-9)
    assert_allclose(pgm.query(net, Y)["yes"], 5e-21, rtol=1e-9)
    assert_allclose([found[v]["yes"] for v in five], 0.2, rtol=1e-8)


@pytest.mark.parametrize(
    ("write", "read"),
    [("write_bif", "read_bif"), ("write_xmlbif", "read_xmlbif"), ("write_uai", "read_uai")],
)
def test_files_have_the_table(write, read):
    file = io.StringIO()
    net = pair()
    getattr(pgm, write)(net, file)
    again = getattr(pgm, read)(io.StringIO(file.getvalue()))
    tables = [cpd.table for cpd in net.cpds]
    for cpd, table in zip(again.cpds, tables, strict=True):
        assert_allclose(cpd.table, table, rtol=1e-12)
    many = [TableCPD(v, table=[0.5, 0.5]) for v in MANY]
    large = pgm.BayesianNetwork([*many, NoisyOr(Y, MANY, [0.5] * 30)])
    with pytest.raises(ModelError, match="2,147,483,648 entries"):
        getattr(pgm, write)(large, io.StringIO())


def test_pictures_and_pages(tmp_path):
    net = pair()
    graph = pgm.compile(net)
    pgm.plot.network(net)
    pgm.plot.factor_graph(net)
    ax = pgm.plot.cluster_graph(graph)
    assert any("up to" in text.get_text() for text in ax.texts)
    file = tmp_path / "page.html"
    pgm.view(pgm.infer(graph, {Y: "yes"}), file)
    assert file.stat().st_size


@pytest.mark.parametrize("combine", [np.maximum, np.bitwise_xor])
def test_assignments_agree_with_what_is_observed(combine):
    """Parts of all assignments that the evidence excludes have no assignment at all."""
    causes = [Discrete(f"c{k}", 2) for k in range(5)]
    child = Discrete("y", 2)
    cpds = [TableCPD(v, table=[0.7, 0.3]) for v in causes]
    cpd = CausalIndependence(child, causes, [np.eye(2)] * 5, combine=combine)
    found = pgm.most_probable(pgm.compile(pgm.BayesianNetwork([*cpds, cpd])), {child: 1}, count=99)
    twin = pgm.compile(pgm.BayesianNetwork(as_tables([*cpds, cpd])))
    expected = pgm.most_probable(twin, {child: 1}, count=99)
    assert_allclose(found.log_probability, expected.log_probability, atol=1e-12)
    assert (found.assignment[child] == 1).all()


def test_questions_that_would_maximise_over_what_causes_amount_to():
    net, found, _ = findings(1)
    graph = pgm.compile(net)
    with pytest.raises(GraphError, match=r"no max-marginals for NoisyOr\(f0.* not summed"):
        pgm.max_marginals(graph, {})
    with pytest.raises(GraphError, match="no max-product by a schedule for NoisyOr"):
        pgm.most_probable(graph, {}, schedule=pgm.Flooding())
    with pytest.raises(GraphError, match="there is no sensitivity for NoisyOr"):
        pgm.sensitivity(net, {MANY[0]: "yes"}, {found[0]: "yes"})
