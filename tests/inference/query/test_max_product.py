"""Max-product by a schedule, against the table of all assignments and messages kept in dicts."""

import copy
import itertools
import pickle
import warnings

import numpy as np
import pytest
from inference.query.test_max_marginals import drawn, logs
from numpy.testing import assert_allclose

import pgm
from pgm.beliefs.discrete.loopy_messages import TableMessages
from pgm.evidence.static import bind_discrete
from pgm.examples import pair, rain, rainy, side, still, wet
from pgm.kernels.semirings import MAX_PRODUCT
from pgm.schedules.loopy import run_loopy

SCHEDULES = [pgm.Flooding(), pgm.Sequential(), pgm.Residual(), pgm.Flooding(damping=0.3)]
METHODS = [pgm.Bethe(), pgm.LTRIP(), pgm.JoinGraph(27), pgm.JunctionTree()]


def quiet(graph, evidence, schedule):
    """What is found, without a warning of messages that have not settled."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pgm.ConvergenceWarning)
        return pgm.most_probable(graph, evidence, schedule=schedule)


@pytest.mark.parametrize("seed", range(120))
def test_drawn_networks(seed):
    """The value is that of the assignment told; on trees it is the largest, ties and zeros too."""
    rng = np.random.default_rng(seed)
    net, runs, states, weights = drawn(rng)
    given = states | {v: pgm.soft(own) for v, own in weights.items()}
    due = [logs(net, run, states, weights) for run in range(runs)]
    graph = pgm.compile(net, method=METHODS[seed % 4])
    schedule = SCHEDULES[rng.integers(4)]
    impossible = any(table.max() == -np.inf for table in due)
    try:
        found = quiet(graph, given, schedule)
    except pgm.EvidenceError:
        assert impossible
        return
    except pgm.NumericalError:  # no message told it, or another choice might have been possible
        assert not graph.is_tree
        return
    assert not impossible
    assert list(found.assignment) == list(net.variables)
    assert found.log_probability.shape == found.exact.shape == found.status.converged.shape
    for run in range(max(found.log_probability.size, 1)):
        names = [np.reshape(found.states(v), -1)[run] for v in net.variables]
        at = tuple(v.index(str(name)) for v, name in zip(net.variables, names, strict=True))
        level = found.log_probability.reshape(-1)[run]
        assert_allclose(level, due[run][at], rtol=1e-13, atol=1e-11)
        if graph.is_tree and schedule.damping == 0.0:
            assert found.exact.all()
        if found.exact.reshape(-1)[run]:
            assert graph.is_tree
            assert_allclose(level, due[run].max(), rtol=1e-12, atol=1e-9)


def ring(rng, count, size, soft=1.0):
    """Variables in a circle, each tied to the next, and seen."""
    around = [pgm.Discrete(f"v{k}", size) for k in range(count)]
    factors = [pgm.Table(v, np.exp(soft * rng.normal(size=size))) for v in around]
    for k in range(count):
        own = np.exp(rng.normal(size=(size, size)))
        factors.append(pgm.Table((around[k - 1], around[k]), own))
    return pgm.MarkovNetwork(factors)


def test_a_fixed_point_round_one_loop_is_the_maximum():
    """Round a single loop a fixed point without ties is the best (Weiss, 2000): most settle."""
    settled = 0
    for seed in range(40):
        net = ring(np.random.default_rng(seed), 5, 3)
        found = quiet(pgm.compile(net, method=pgm.Bethe()), {}, pgm.Flooding(damping=0.2))
        assert not found.exact
        if found.status.converged:
            settled += 1
            assert_allclose(found.log_probability, logs(net, 0, {}, {}).max(), rtol=1e-12)
    assert settled >= 20


def test_no_single_change_improves_a_fixed_point():
    """Of trees and single loops that differ (Weiss & Freeman, 2001)."""
    settled = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        names = itertools.product(range(3), range(3))
        cells = {at: pgm.Discrete(f"c{at[0]}{at[1]}", 2) for at in names}
        factors = [pgm.Table(v, np.exp(rng.normal(size=2))) for v in cells.values()]
        for (i, j), v in cells.items():
            for other in ((i + 1, j), (i, j + 1)):
                if other in cells:
                    own = np.exp(rng.normal(size=(2, 2)))
                    factors.append(pgm.Table((v, cells[other]), own))
        net = pgm.MarkovNetwork(factors)
        found = quiet(pgm.compile(net, method=pgm.Bethe()), {}, pgm.Flooding(damping=0.5))
        if not found.status.converged:
            continue
        settled += 1
        table = logs(net, 0, {}, {})
        at = [v.index(found.assignment[v]) for v in net.variables]
        for one, other in itertools.combinations(range(9), 2):
            for states in itertools.product(range(2), repeat=2):
                changed = list(at)
                changed[one], changed[other] = states
                assert table[tuple(changed)] <= table[tuple(at)] + 1e-9
    assert settled >= 10


def test_messages_equal_those_kept_in_dicts():
    """Ten floods of max-product on a ring with zeros, each message written out."""
    rng = np.random.default_rng(5)
    around = [pgm.Discrete(f"v{k}", 3) for k in range(4)]
    tables = [rng.random((3, 3)) * (rng.random((3, 3)) > 0.2) for _ in around]
    # Factor k is over variables k and k + 1; the last one over the first and the last.
    scopes = [(0, 1), (1, 2), (2, 3), (0, 3)]
    net = pgm.MarkovNetwork(
        [pgm.Table([around[k] for k in s], t) for s, t in zip(scopes, tables, strict=True)]
    )
    clusters = [{around[k] for k in s} for s in scopes]
    edges = [(0, 1, 1), (1, 2, 2), (2, 3, 3), (0, 3, 0)]
    graph = pgm.ClusterGraph(net, clusters, sepsets={(i, j): {around[v]} for i, j, v in edges})
    schedule = pgm.Flooding(iterations=10, tolerance=0.0)
    messages = TableMessages(graph, bind_discrete(net.variables, {}), 0.0, MAX_PRODUCT)
    run_loopy(messages, schedule, ())
    ways = {(i, j): v for i, j, v in edges} | {(j, i): v for i, j, v in edges}
    kept = {way: np.ones(3) for way in ways}
    for _ in range(10):
        new = {}
        for (i, j), v in ways.items():
            product = tables[i].copy()
            for (k, to), u in ways.items():
                if to == i and k != j:
                    shape = (3, 1) if scopes[i].index(u) == 0 else (1, 3)
                    product = product * kept[k, to].reshape(shape)
            own = product.max(axis=1 - scopes[i].index(v))
            new[i, j] = own / own.max()
        kept = new
    for e, (i, j) in enumerate(graph.sepsets):
        for number, way in ((2 * e, (i, j)), (2 * e + 1, (j, i))):
            first = messages.plan.first[number]
            own = np.exp(messages.logs[first : first + 3, 0])
            assert_allclose(own, kept[way], rtol=1e-12, atol=1e-15)


def test_ties_are_broken_together():
    """Neighbours differ round an even ring: two assignments are best, and one of them is told."""
    around = [pgm.Discrete(f"v{k}", 2) for k in range(6)]
    apart = [pgm.Table((around[k - 1], around[k]), 1.0 - np.eye(2)) for k in range(6)]
    graph = pgm.compile(pgm.MarkovNetwork(apart), method=pgm.Bethe())
    found = pgm.most_probable(graph, {}, schedule=pgm.Flooding())
    told = [found.assignment[v] for v in around]
    assert all(told[k - 1] != told[k] for k in range(6))
    assert found.log_probability == 0.0
    assert found.status.converged
    assert not found.exact
    assert repr(found).endswith("ln p 0; messages settled, no optimum is vouched for)")


def test_an_assignment_of_probability_zero_is_not_told():
    """Round an odd ring neighbours cannot all differ, which messages do not notice."""
    around = [pgm.Discrete(f"v{k}", 2) for k in range(5)]
    apart = [pgm.Table((around[k - 1], around[k]), 1.0 - np.eye(2)) for k in range(5)]
    graph = pgm.compile(pgm.MarkovNetwork(apart), method=pgm.Bethe())
    with pytest.raises(pgm.NumericalError, match="leads to no assignment of positive probab") as e:
        pgm.most_probable(graph, {}, schedule=pgm.Flooding())
    assert e.value.cluster is not None
    soft = pgm.soft([[1.0, 1.0], [1.0, 1.0]])
    with pytest.raises(pgm.NumericalError, match="first in run 0") as e:
        pgm.most_probable(graph, {around[0]: soft}, schedule=pgm.Flooding())
    assert e.value.run == 0


def test_what_is_next_to_nothing_counts():
    """The first state is 10²⁰ times as good as the others, until v15 forbids it.

    So news of the others, which comes from afar, changes no probability on its way to v15.
    """
    row = [pgm.Discrete(f"v{k}", 3) for k in range(18)]
    factors = [pgm.Table(row[0], [1.0, 1.0, 1e-12])]
    for k, two in enumerate(itertools.pairwise(row)):
        factors.append(pgm.Table(two, np.diag([1.0, 1e-20, 1e-20]) if k == 12 else np.eye(3)))
    factors += [pgm.Table(row[15], [0.0, 1.0, 10.0])]
    for order in (factors, factors[::-1]):
        for schedule in SCHEDULES[:3]:
            graph = pgm.compile(pgm.MarkovNetwork(order), method=pgm.Bethe())
            found = pgm.most_probable(graph, {}, schedule=schedule)
            assert set(found.assignment.values()) == {"1"}
            assert_allclose(found.log_probability, np.log(1e-20))
            assert found.exact


def test_a_tree_after_too_few_rounds():
    row = [pgm.Discrete(f"v{k}", 2) for k in range(30)]
    rng = np.random.default_rng(0)
    factors = [pgm.Table(two, rng.random((2, 2))) for two in itertools.pairwise(row)]
    graph = pgm.compile(pgm.MarkovNetwork(factors), method=pgm.Bethe())
    few = quiet(graph, {row[3]: 1}, pgm.Flooding(iterations=2))
    assert not few.exact
    assert not few.status.converged
    assert pgm.most_probable(graph, {row[3]: 1}, schedule=pgm.Flooding()).exact


def test_too_few_rounds_warn():
    net = ring(np.random.default_rng(0), 6, 3)
    graph = pgm.compile(net, method=pgm.Bethe())
    with pytest.warns(pgm.ConvergenceWarning, match="messages had not settled after 2 rounds"):
        found = pgm.most_probable(graph, {}, schedule=pgm.Flooding(iterations=2))
    assert repr(found).endswith("; messages not settled, no optimum is vouched for)")
    assert found.status.iterations == 2
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pgm.most_probable(graph, {}, schedule=pgm.Flooding(iterations=2, tolerance=0.0))


def test_a_batch_equals_its_runs():
    net = ring(np.random.default_rng(3), 5, 3)
    graph = pgm.compile(net, method=pgm.Bethe())
    first, second = net.variables[:2]
    seen = np.array([[0, 1, 2], [-1, 0, 1]])
    whole = quiet(graph, {first: seen}, pgm.Flooding(damping=0.2))
    assert whole.log_probability.shape == (2, 3)
    for at in np.ndindex(2, 3):
        single = quiet(graph, {first: int(seen[at])}, pgm.Flooding(damping=0.2))
        assert whole.states(second)[at] == single.states(second)
        assert_allclose(whole.log_probability[at], single.log_probability, rtol=1e-13)
    for twin in (copy.deepcopy(whole), pickle.loads(pickle.dumps(whole))):
        assert twin.status.iterations == whole.status.iterations


def test_impossible_evidence():
    sure = pgm.BayesianNetwork(
        [pgm.TableCPD(rain, table=[1, 0]), pgm.TableCPD(wet, rain, table=[[1, 0], [0, 1]])]
    )
    graph = pgm.compile(sure, method=pgm.Bethe())
    with pytest.raises(pgm.EvidenceError, match="probability zero"):
        pgm.most_probable(graph, {wet: "yes"}, schedule=pgm.Flooding())


def test_what_is_refused():
    graph = pgm.compile(rainy)
    flood = pgm.Flooding()
    for wrong in (pgm.Calibration(), pgm.Filtering(), pgm.Loopy(), pgm.Flooding, "flood"):
        with pytest.raises(pgm.ModelError, match="no schedule of messages round loops"):
            pgm.most_probable(graph, {}, schedule=wrong)
    others = {"variables": rain, "memory": 2**20, "count": 2}
    for name, value in others.items():
        with pytest.raises(pgm.GraphError, match=f"leave {name}= out"):
            pgm.most_probable(graph, {}, schedule=flood, **{name: value})
    with pytest.raises(pgm.GraphError, match="has time, whose most probable path"):
        pgm.most_probable(pgm.compile(still, steps=2), {wet: [1, 1]}, schedule=flood)
    with pytest.raises(pgm.GraphError, match="most_probable is for discrete networks"):
        pgm.most_probable(pgm.compile(pair), {}, schedule=flood)
    with pytest.raises(pgm.EvidenceError, match="evidence for side"):
        pgm.most_probable(graph, {side: 0}, schedule=flood)
    loop = pgm.compile(ring(np.random.default_rng(0), 3, 2), method=pgm.Bethe())
    with pytest.raises(pgm.GraphError, match=r"schedule=pgm.Flooding\(\), which vouch for no"):
        pgm.most_probable(loop, {})
