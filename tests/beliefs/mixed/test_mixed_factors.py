"""Markov networks of discrete and continuous variables, against sums of dense Gaussians."""

import pickle

import numpy as np
import pytest
from mixed.enumerated import drawn as drawn_cpds
from mixed.enumerated import enumerated as enumerated_cpds
from mixed.enumerated import observed
from mixed.factors import NUMBER, drawn, enumerated
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.stats import norm, t

import pgm

S, Q = pgm.Discrete("s", states=("calm", "wild")), pgm.Discrete("q", 2)
X, Y, Z = pgm.variables("x y z")
PAIR = pgm.Table((S, Q), [[2.0, 1.0], [1.0, 3.0]])
LEVEL = np.array([3.0, 4.0])  # sums of PAIR over q


def line(child, given, cov, offset=0.0):
    return pgm.LinearGaussianCPD(child, given, cov, offset=offset)


def switched(child, calm, wild):
    return pgm.SwitchingCPD(child, given=S, cases={"calm": calm, "wild": wild})


# Of which one case leaves x open.
READING = switched(Z, line(Z, {X: 1.0}, 1.0), pgm.GaussianCPD(Z, 0.0, 9.0))


def inferred(factors, evidence, **options):
    return pgm.infer(pgm.compile(pgm.MarkovNetwork(factors)), evidence, **options)


def some_evidence(rng, network):
    return {
        v: int(rng.integers(v.size))
        if isinstance(v, pgm.Discrete)
        else rng.normal(size=v.dimension)
        for v in network.variables
        if rng.random() < 0.3
    }


def assert_equal(posterior, total, tables, moments, run=...):
    assert_allclose(posterior.log_evidence[run], total, rtol=1e-10, atol=1e-10)
    for variable, due in tables.items():
        found = np.broadcast_to(
            posterior[variable].probabilities, (*posterior.log_evidence.shape, due.size)
        )
        assert_allclose(found[run], due, atol=1e-12)
    hidden, mean, cov = moments
    if hidden:
        size = np.maximum(np.sqrt(np.diag(cov)), 1e-3 * (1.0 + np.abs(mean)))  # of some none
        joint = posterior.joint(*hidden)
        assert_allclose(joint.mean[run] / size, mean / size, atol=1e-9)
        assert_allclose(
            joint.cov[run] / np.outer(size, size), cov / np.outer(size, size), atol=1e-9
        )


def assert_enumerated(seed, proper=0.85, exact=0.0):
    rng = np.random.default_rng(seed)
    network, terms = drawn(rng, proper, exact)
    evidence = some_evidence(rng, network)
    total, tables, moments, least = enumerated(network, terms, evidence)
    graph = pgm.compile(network)
    if total is None and (exact or least > 1e-12):  # improper, or relations that repeat others,
        return  # but for rounding, or hard to tell from it
    if total is None or total == -np.inf:
        with pytest.raises((pgm.EvidenceError, pgm.NumericalError)):
            pgm.infer(graph, evidence)
        return
    assert_equal(pgm.infer(graph, evidence), total, tables, moments)


@pytest.mark.parametrize("part", range(3))
def test_drawn_networks(part):
    for seed in range(20 * part, 20 * part + 20):
        assert_enumerated(seed)
        assert_enumerated(seed, exact=0.25)


@pytest.mark.slow
@pytest.mark.parametrize(("proper", "exact"), [(0.85, 0.0), (0.3, 0.0), (0.85, 0.25)])
@pytest.mark.parametrize("part", range(6))
def test_many_drawn_networks(part, proper, exact):
    for seed in range(1000 + 50 * part, 1050 + 50 * part):
        assert_enumerated(seed, proper, exact)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("exact", [0.0, 0.25])
def test_a_bayesian_network_is_one(seed, exact):
    network, rng = drawn_cpds(seed, exact)
    evidence = observed(network, rng)
    total, tables, beliefs = enumerated_cpds(network, evidence)
    if total is None:  # evidence repeats itself
        return
    factors = [
        pgm.Table((*cpd.given, cpd.child), cpd.table) if cpd.discrete else cpd
        for cpd in network.cpds
    ]
    found = inferred([factors[k] for k in rng.permutation(len(factors))], evidence)
    assert_allclose(found.log_evidence, total, atol=1e-10, rtol=1e-10)
    for variable, due in tables.items():
        assert_allclose(found[variable].probabilities, due, atol=1e-12)
    for variable, (mean, cov) in beliefs.items():
        size = max(1.0, np.abs(cov).max() ** 0.5)
        assert_allclose(found[variable].mean / size, mean / size, atol=1e-9)
        assert_allclose(found[variable].cov / size**2, cov / size**2, atol=1e-9)


@pytest.mark.parametrize("seed", range(300, 304))
def test_runs_and_soft_evidence(seed):
    """Each run, with weights of its own, is the network with one more table."""
    rng = np.random.default_rng(seed)
    network, terms = drawn(rng, 1.0)
    discrete = [v for v in network.variables if isinstance(v, pgm.Discrete)]
    continuous = [v for v in network.variables if not isinstance(v, pgm.Discrete)]
    values, weights = rng.normal(size=(3, continuous[0].dimension)), rng.uniform(size=(3, 9))
    weights = weights[:, : discrete[0].size]
    evidence = {continuous[0]: values, discrete[0]: pgm.soft(weights)}
    found = pgm.infer(pgm.compile(network), evidence)
    for run, own in enumerate(weights):

        def weigh(at, own=own):
            return [((*NUMBER, np.log(own[at[discrete[0]]])),)]

        due = enumerated(network, [*terms, weigh], {continuous[0]: values[run]})
        assert_equal(found, *due[:3], run)


def test_tables_and_gaussians_apart():
    """ln Z is a sum, numbers of both kinds count, and each is as it is alone."""
    form = pgm.CanonicalForm(X, [[2.0]], [1.0], 0.5)
    numbers = [pgm.Table((), 1.0, 2.0), pgm.CanonicalForm((), np.zeros((0, 0)), [], -1.0)]
    found = inferred([PAIR, form, *numbers], {})
    alone = inferred([form], {})
    assert_allclose(found.log_evidence, np.log(7.0) + alone.log_evidence + 1.0, rtol=1e-14)
    assert_allclose(found[S].probabilities, LEVEL / 7.0, rtol=1e-14)
    assert_allclose(found[X].mean, [0.5], rtol=1e-14)
    assert found.graph.network.mixed
    assert not found.graph.network.discrete
    with pytest.raises(pgm.EvidenceError, match="exclude one another"):
        inferred([PAIR, form, pgm.Table((), 0.0)], {})


def test_causes_that_are_independent():
    fault = pgm.Discrete("fault", states=("no", "yes"))
    causes = [pgm.Discrete(f"c{k}", states=("no", "yes")) for k in range(12)]
    factors = [pgm.Table(cause, [0.9, 0.1]) for cause in causes]
    factors.append(pgm.NoisyOr(fault, causes, [0.8] * 12))
    seen = pgm.SwitchingCPD(
        Z, fault, {"no": pgm.GaussianCPD(Z, 0.0, 1.0), "yes": pgm.GaussianCPD(Z, 3.0, 1.0)}
    )
    found = inferred([*factors, seen], {Z: 2.0})
    none = (1 - 0.1 * 0.8) ** 12 * norm.pdf(2.0)
    some = (1 - (1 - 0.1 * 0.8) ** 12) * norm.pdf(2.0, 3.0)
    assert_allclose(found.log_evidence, np.log(none + some), rtol=1e-12)
    assert_allclose(found[fault].probabilities, np.array([none, some]) / (none + some))


@pytest.mark.parametrize("turned", [False, True])
def test_relations_without_noise_that_states_choose(turned):
    """Of y = 2x the density integrates to a half, whichever CPD of y counts as a residual."""
    chosen = switched(Y, line(Y, {X: 2.0}, 0.0), line(Y, {X: 1.0}, 1.0))
    factors = [pgm.GaussianCPD(Y, 0.0, 1.0), chosen]
    found = inferred(factors[::-1] if turned else factors, {})
    assert_allclose(found.log_evidence, np.log(1.5), rtol=1e-14)
    assert_allclose(found[S].probabilities, [1 / 3, 2 / 3], rtol=1e-14)
    assert_allclose(found[X].cov, [[1 / 3 * 0.25 + 2 / 3 * 2.0]], rtol=1e-14)
    seen = inferred(factors, {X: 1.0})
    each = np.array([norm.pdf(2.0), norm.pdf(1.0, scale=np.sqrt(2.0))])
    assert_allclose(seen.log_evidence, np.log(each.sum()), rtol=1e-14)
    assert_allclose(inferred(factors, {X: 1.0, Y: 2.0})[S].probabilities, [1.0, 0.0])
    twice = [chosen, line(Y, {X: 2.0}, 0.0), line(Y, {X: 2.0}, 0.0), pgm.GaussianCPD(X, 0, 1)]
    with pytest.raises(pgm.NumericalError, match=r"\[LinearGaussianCPD\(y \| x\), .*repeats"):
        inferred(twice, {})


def test_a_state_that_leaves_a_direction_open():
    """It is refused by name, but where tables or evidence exclude it, of whatever kind."""
    with pytest.raises(pgm.NumericalError, match=r"where s is wild, .* the direction 1 x open"):
        inferred([PAIR, READING], {Z: 1.0})
    with pytest.raises(pgm.NumericalError, match="where s is wild"):
        inferred([READING], {Z: 1.0, S: ["calm", "wild"]})
    never = pgm.Table((S, Q), [[2.0, 1.0], [0.0, 0.0]])
    one, many = inferred([READING, never], {Z: 1.0}), {Z: [[1.0], [2.0]]}
    assert_allclose(one.log_evidence, np.log(3.0), rtol=1e-14)
    for known in (0, [0, 0], pgm.soft([1.0, 0.0]), pgm.soft([[1.0, 0.0], [0.5, 0.0]])):
        assert_allclose(inferred([READING], many | {S: known})[X].mean, many[Z])
    with pytest.raises(pgm.EvidenceError, match="probability zero, in run 0"):
        inferred([pgm.GaussianCPD(X, 0.0, 1.0), READING, never], {S: [1, 1]})
    both = inferred([PAIR, READING, pgm.GaussianCPD(X, 0.0, 1.0)], {Z: 1.0})
    each = LEVEL * norm.pdf(1.0, scale=[np.sqrt(2.0), 3.0])
    assert_allclose(both.log_evidence, np.log(each.sum()), rtol=1e-14)
    # What is known needs no belief, and a form without information is a number.
    loose = pgm.CanonicalForm(X, [[0.0]], [0.0], 2.0)
    assert_allclose(inferred([PAIR, loose], {X: 3.0}).log_evidence, np.log(7.0) + 2.0)
    for factors in ([PAIR, loose], [pgm.GaussianCPD(Y, 0.0, 1.0), loose]):
        for nothing in ({}, {X: np.nan}):
            with pytest.raises(pgm.NumericalError, match="the direction 1 x open"):
                inferred(factors, nothing)


def test_robust_residuals_weigh_states():
    far = pgm.NonlinearGaussianFactor(X, lambda x: x, 1.0, value=2.0, noise=pgm.StudentT(4.0))
    chosen = switched(X, pgm.GaussianCPD(X, 0.0, 1.0), pgm.GaussianCPD(X, 3.0, 4.0))
    found = inferred([chosen, far], {})
    each = np.array(
        [
            quad(lambda x, m=m, d=d: norm.pdf(x, m, d) * t.pdf(x - 2.0, 4.0), -60, 60, limit=400)[0]
            for m, d in ((0.0, 1.0), (3.0, 2.0))
        ]
    )
    assert_allclose(found.log_evidence, np.log(each.sum()), atol=1e-7)
    assert_allclose(found[S].probabilities, each / each.sum(), atol=1e-7)
    assert "component of NonlinearGaussianFactor(x)" in str(found)
    wrong = pgm.NonlinearGaussianFactor(X, lambda x: x, 1.0, value=1e9, noise=pgm.StudentT(4.0))
    with pytest.raises(
        pgm.NumericalError, match=r"reading of NonlinearGaussianFactor\(x\) is more"
    ):
        inferred([chosen, wrong], {})
    huber = pgm.NonlinearGaussianFactor(X, lambda x: x, 1.0, noise=pgm.Huber(1.5))
    with pytest.raises(pgm.ModelError, match="no mixture of Gaussians") as told:
        inferred([chosen, huber], {})
    assert told.value.cpd is huber
    assert told.value.variable == X
    rounds = pgm.Calibration(iterations=50)
    assert (
        inferred([chosen, huber], {S: "calm"}, schedule=rounds).log_evidence_kind
        == "linearised bound"
    )


def test_mixtures_of_one_child():
    """Each has a cause of its own; without a discrete variable too."""
    first = pgm.MixtureCPD([pgm.GaussianCPD(X, 0.0, 1.0), pgm.GaussianCPD(X, 5.0, 1.0)], [0.5, 0.5])
    other = pgm.MixtureCPD([pgm.GaussianCPD(X, 1.0, 2.0), pgm.GaussianCPD(X, 4.0, 1.0)], [0.3, 0.7])
    found = inferred([first, other], {})

    def density(x):
        return np.exp(first.log_density([x], {}) + other.log_density([x], {}))

    total = quad(density, -20, 25, limit=400)[0]
    assert_allclose(found.log_evidence, np.log(total), rtol=1e-10)
    assert_allclose(found[X].mean, quad(lambda x: x * density(x), -20, 25, limit=400)[0] / total)
    assert pgm.infer(found.graph, {X: 1.0}).log_evidence == pytest.approx(np.log(density(1.0)))


def bent(y):
    return y**2 / 4.0 + y


NETWORK = pgm.MarkovNetwork(
    [
        PAIR,
        READING,
        pgm.GaussianCPD(X, 0.0, 1.0),
        pgm.CanonicalForm((X, Y), [[1.0, -1.0], [-1.0, 1.0]], [0.0, 0.0]),
        pgm.NonlinearGaussianFactor(Y, bent, 1.0, value=1.0),
    ]
)


def test_every_method_compiles_and_answers_alike():
    graph = pgm.compile(NETWORK)
    due = pgm.infer(graph, {Z: 1.0})
    methods = pgm.LTRIP(), pgm.Bethe(), pgm.JoinGraph(100), pgm.JunctionTree(pgm.NestedDissection())
    graphs = [pgm.compile(NETWORK, method=method) for method in methods]
    graphs += [pgm.ClusterGraph(NETWORK, [{X, Z, S}, {S, Q}, {X, Y}])]
    for each in (*graphs, pickle.loads(pickle.dumps(graph))):
        each.check(jacobians=True)
        found = pgm.infer(each, {Z: 1.0})
        assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-14)
    assert NETWORK.separated(Q, Y, given=S)
    assert not NETWORK.separated(Q, Y)
    assert due.log_evidence_kind == "linearised"
    rounds = pgm.infer(graph, {Z: 1.0}, schedule=pgm.Calibration(iterations=50), start={X: 1, Y: 1})
    assert rounds.status.converged.all()
    again = pickle.loads(pickle.dumps(due))
    assert_allclose(again[X].mean, due[X].mean)
    assert "s  calm 0.617, wild 0.383" in str(again)
    assert "<svg" in NETWORK._repr_html_()


def test_draws():
    found = pgm.infer(pgm.compile(NETWORK), {Z: 1.0})
    drawn = found.sample(200_000, rng=0)
    assert set(drawn) == {S, Q, X, Y}
    assert_allclose(drawn[X].mean(), found[X].mean[0], atol=0.01)
    joint = np.cov(np.hstack([drawn[X], drawn[Y]]).T)
    assert_allclose(joint, found.joint(X, Y).cov, atol=0.02)
    assert_allclose((drawn[S] == 1).mean(), found[S].probabilities[1], atol=0.01)
    calm = drawn[X][drawn[S] == 0].mean()
    assert_allclose(calm, pgm.infer(found.graph, {Z: 1.0, S: "calm"})[X].mean[0], atol=0.01)


@pytest.mark.parametrize(
    ("ask", "error", "words"),
    [
        (lambda p: pgm.query(NETWORK, S), pgm.GraphError, "this one is mixed"),
        (lambda p: pgm.most_probable(p.graph, {}), pgm.GraphError, "has continuous variables too"),
        (lambda p: pgm.max_marginals(p.graph, {}), pgm.GraphError, "this one is mixed"),
        (lambda p: pgm.audit(p, rng=0), pgm.ModelError, "mixed network"),
        (lambda p: pgm.view(p, "page.html"), pgm.GraphError, "mixtures"),
        (lambda p: p.message(0, 1), pgm.GraphError, "mixtures of a mixed network have none"),
        (lambda p: pgm.infer(p.graph, {}, schedule=pgm.Flooding()), pgm.GraphError, "loops"),
        (lambda p: p.joint(S, X), pgm.EvidenceError, "neither a table nor a mixture"),
        (lambda p: p[pgm.Variable("residual 1")], pgm.EvidenceError, "is not in the network"),
        (
            lambda p: pgm.infer(p.graph, {pgm.Variable("residual 1"): 1.0}),
            pgm.EvidenceError,
            "which the network does not have",
        ),
        (
            lambda p: pgm.MarkovNetwork([PAIR, pgm.SampledCPD(X, (), sample=lambda rng: rng)]),
            pgm.ModelError,
            "are tables, or Gaussian, or such that a SwitchingCPD or a MixtureCPD has",
        ),
    ],
)
def test_what_it_cannot_answer_is_refused(ask, error, words):
    posterior = pgm.infer(pgm.compile(NETWORK), {Z: 1.0})
    with pytest.raises(error, match=words):
        ask(posterior)


def test_too_many_configurations():
    """Where nothing known needs what joins them, CPDs are left out; factors never are."""
    modes = [pgm.Discrete(f"m{k}", 4) for k in range(12)]
    each = [pgm.Variable(f"x{k}") for k in range(12)]
    factors = [pgm.Table(mode, [1.0, 2.0, 3.0, 4.0]) for mode in modes]
    for mode, x in zip(modes, each, strict=True):
        cases = {k: pgm.GaussianCPD(x, k, 1.0) for k in range(4)}
        factors.append(pgm.SwitchingCPD(x, mode, cases))
    joined = line(Z, dict.fromkeys(each, 1.0), 1.0)
    found = inferred([*factors, joined], {})
    assert_allclose(found[each[0]].mean, 2.0)
    assert_allclose(found.log_evidence, 12.0 * np.log(10.0), rtol=1e-13)
    with pytest.raises(pgm.GraphError, match="z was left out"):
        found[Z]
    for more in (pgm.GaussianCPD(Z, 0.0, 1.0), pgm.CanonicalForm(Z, [[1.0]], [0.0])):
        with pytest.raises(pgm.GraphError, match="16,777,216 configurations"):
            inferred([*factors, joined, more], {})


def test_nearly_flat_forms_are_told():
    turn = np.array([[1.0, 1.0], [-1.0, 1.0]]) / np.sqrt(2.0)
    form = pgm.CanonicalForm((X, Y), turn.T @ np.diag([1.0, 3e-12]) @ turn, [0.0, 0.0])
    with pytest.warns(pgm.PrecisionWarning, match="nearly flat"):
        assert inferred([form, PAIR], {}).status.digits < 6
