"""The networks of the Bayesian network repository, against pyAgrum."""

import gzip
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from discrete.enumeration import Enumeration

import pgm

pyagrum = pytest.importorskip("pyagrum")

TINY = ["asia", "cancer", "earthquake", "survey", "sachs"]
SMALL = [*TINY, "child", "alarm", "insurance", "hailfinder", "win95pts", "hepar2"]
MEDIUM = [*SMALL, "andes", "pigs", "water"]
LARGE = ["munin1", "mildew", "barley", "link"]


def repository():
    """Where pgmpy keeps the networks' files, if it is here; it is not imported."""
    found = find_spec("pgmpy")
    folders = found.submodule_search_locations if found else None
    return Path(folders[0]) / "utils" / "example_models" if folders else Path("nowhere")


pytestmark = pytest.mark.skipif(not repository().is_dir(), reason="pgmpy's networks are not here")


@cache
def compiled(name):
    return pgm.compile(pgm.read_bif(repository() / f"{name}.bif.gz", normalise=True))


def leaves(net):
    parents = {parent for cpd in net.cpds for parent in cpd.given}
    return [v for v in net.variables if v not in parents]


def drawn(net, seed):
    """The states of five leaves, drawn from the network."""
    rng = np.random.default_rng(seed)
    ends = leaves(net)
    seen = net.sample(rng=rng)
    chosen = rng.choice(len(ends), min(5, len(ends)), replace=False)
    return {ends[k]: int(seen[ends[k]]) for k in chosen}


def refilled(net):
    """pyAgrum's network with our doubles."""
    peer = pyagrum.BayesNet()
    for cpd in net.cpds:
        peer.add(pyagrum.LabelizedVariable(cpd.child.name, "", list(cpd.child.states)))
    for cpd in net.cpds:
        for parent in cpd.given:
            peer.addArc(parent.name, cpd.child.name)
    for cpd in net.cpds:
        table = peer.cpt(cpd.child.name)
        axes = [v.name for v in (*cpd.given, cpd.child)]
        # Its arrays have the axes of its variables in reverse.
        order = [axes.index(name) for name in reversed(table.names)]
        table[:] = np.ascontiguousarray(np.transpose(cpd.table, order))
    return peer


def agree(name, seed, peer, tolerance):
    graph = compiled(name)
    evidence = drawn(graph.network, seed)
    posterior = pgm.infer(graph, evidence)
    engine = pyagrum.LazyPropagation(peer)
    engine.setEvidence({v.name: v.states[state] for v, state in evidence.items()})
    engine.makeInference()
    for variable in graph.network.variables:
        if variable in evidence:
            continue
        theirs = engine.posterior(variable.name)
        labels = list(peer.variable(variable.name).labels())
        due = theirs.toarray()[[labels.index(state) for state in variable.states]]
        np.testing.assert_allclose(posterior[variable].values, due, rtol=0.0, atol=tolerance)
    probability = np.log(engine.evidenceProbability())
    np.testing.assert_allclose(posterior.log_evidence, probability, rtol=0.0, atol=10 * tolerance)


@pytest.mark.parametrize("name", MEDIUM)
def test_with_our_numbers_pyagrum_finds_the_same(name):
    peer = refilled(compiled(name).network)
    for seed in range(3):
        agree(name, seed, peer, 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE)
def test_with_our_numbers_pyagrum_finds_the_same_of_large_networks(name):
    agree(name, 0, refilled(compiled(name).network), 1e-12)


@pytest.mark.parametrize("name", [name for name in MEDIUM if name != "child"])
def test_of_the_file_pyagrum_makes_the_same(name, tmp_path):
    """It reads numbers in single precision, and no state of child that has a slash in its name."""
    plain = tmp_path / f"{name}.bif"
    plain.write_bytes(gzip.decompress((repository() / f"{name}.bif.gz").read_bytes()))
    agree(name, 3, pyagrum.loadBN(str(plain)), 1e-6)


@pytest.mark.parametrize("name", MEDIUM)
def test_sets_of_evidence_at_once_are_each_by_itself(name):
    graph = compiled(name)
    net, runs = graph.network, 12
    rng = np.random.default_rng(4)
    seen = net.sample(runs, rng=rng)
    evidence = {v: np.where(rng.random(runs) < 0.5, seen[v], -1) for v in leaves(net)[:8]}
    whole = pgm.infer(graph, evidence)
    best = pgm.most_probable(graph, evidence)
    hidden = [v for v in net.variables if v not in evidence]
    for run in (0, 5, 11):
        own = {v: int(states[run]) for v, states in evidence.items()}
        single = pgm.infer(graph, own)
        for variable in hidden:
            found, due = whole[variable].values[run], single[variable].values
            np.testing.assert_allclose(found, due, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(whole.log_evidence[run], single.log_evidence, atol=1e-12)
        probability = pgm.most_probable(graph, own).log_probability
        np.testing.assert_allclose(best.log_probability[run], probability, atol=1e-11)


def log_probability(cpds, states):
    """The sum of the logarithms of CPDs' entries at some states."""
    with np.errstate(divide="ignore"):
        entries = [cpd.table[tuple(states[v] for v in (*cpd.given, cpd.child))] for cpd in cpds]
        return float(np.log(entries).sum())


def require_best(name):
    """Its probability is what it is said to be, and no change of one variable makes it larger."""
    graph = compiled(name)
    net, evidence = graph.network, drawn(graph.network, 5)
    best = pgm.most_probable(graph, evidence)
    states = {v: v.states.index(state) for v, state in best.assignment.items()}
    assert all(states[v] == state for v, state in evidence.items())
    top = log_probability(net.cpds, states)
    np.testing.assert_allclose(best.log_probability, top, rtol=1e-12)
    touched = {v: [cpd for cpd in net.cpds if v in cpd.scope] for v in net.variables}
    for variable, cpds in touched.items():
        if variable in evidence:
            continue
        own = log_probability(cpds, states)
        for state in range(variable.size):
            assert log_probability(cpds, states | {variable: state}) <= own + 1e-9
    return top, net, evidence


@pytest.mark.parametrize("name", MEDIUM)
def test_the_most_probable_assignment_is_a_summit(name):
    top, net, evidence = require_best(name)
    for seed in range(20):
        seen = net.sample(rng=seed)
        tried = {v: int(seen[v]) for v in net.variables} | evidence
        assert log_probability(net.cpds, tried) <= top


@pytest.mark.slow
@pytest.mark.parametrize("name", LARGE)
def test_the_most_probable_assignment_of_large_networks(name):
    require_best(name)


@pytest.mark.parametrize("name", TINY)
def test_the_most_probable_assignment_is_the_largest_of_all(name):
    graph = compiled(name)
    evidence = drawn(graph.network, 6)
    best = pgm.most_probable(graph, evidence)
    truth = Enumeration(graph.network, evidence)
    np.testing.assert_allclose(best.log_probability, np.log(truth.table.max()), rtol=1e-12)
    posterior = pgm.infer(graph, evidence)
    np.testing.assert_allclose(posterior.log_evidence, np.log(truth.evidence), rtol=1e-12)
    for variable in graph.network.variables:
        if variable not in evidence:
            found = posterior[variable].values
            np.testing.assert_allclose(found, truth.marginal(variable), rtol=0.0, atol=1e-13)
