"""What `compile` takes and returns."""

import pytest
from dags import chain, continuous, discrete

import pgm
from pgm.compile import SliceGraph

X, Z = pgm.variables("x z")
DYNAMIC = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(X, 0.0, 1.0)],
    transition=[pgm.LinearGaussianCPD(X, given={X.previous: 1.0}, cov=0.1)],
    observation=[pgm.LinearGaussianCPD(Z, given={X: 1.0}, cov=0.5)],
)
STATIC = continuous(chain(4))


def test_a_network_without_time_gives_its_junction_tree():
    for network in (STATIC, discrete(chain(4))):
        graph = pgm.compile(network)
        assert type(graph) is pgm.ClusterGraph
        again = pgm.compile(network, method=pgm.JunctionTree())
        assert [cluster.scope for cluster in graph] == [cluster.scope for cluster in again]
        assert graph.is_tree
        assert graph.width == 1


def test_a_dynamic_network_gives_slices():
    assert isinstance(pgm.compile(DYNAMIC, 3), SliceGraph)


def test_methods_are_values():
    assert {pgm.Bethe(), pgm.Bethe(), pgm.JunctionTree(), pgm.JunctionTree()} == {
        pgm.Bethe(),
        pgm.JunctionTree(),
    }
    with pytest.raises(AttributeError):
        pgm.JunctionTree().order = None


def test_a_function_is_a_method():
    a, b, c, d = STATIC.variables

    def by_hand(network):
        return pgm.ClusterGraph(network, [{a, b}, {b, c, d}])

    assert len(pgm.compile(STATIC, method=by_hand)) == 2


def test_a_method_for_a_dynamic_network_is_refused():
    with pytest.raises(pgm.GraphError, match=r"chain of slices.*model\.unroll\(steps\)"):
        pgm.compile(DYNAMIC, 3, method=pgm.JunctionTree())


@pytest.mark.parametrize("steps", [0, 3])
def test_steps_for_a_network_without_time_are_refused(steps):
    with pytest.raises(pgm.GraphError, match="leave out steps"):
        pgm.compile(STATIC, steps)


@pytest.mark.parametrize("method", ["junction tree", 3, pgm.JunctionTree, pgm.MinFill])
def test_what_is_no_method_is_refused(method):
    with pytest.raises(pgm.GraphError, match="is no method"):
        pgm.compile(STATIC, method=method)


def test_a_function_that_returns_no_graph_is_refused():
    with pytest.raises(pgm.GraphError, match="where a ClusterGraph was due"):
        pgm.compile(STATIC, method=lambda network: None)
    with pytest.raises(pgm.GraphError, match="where a ClusterGraph was due"):
        pgm.compile(STATIC, method=pgm.MinFill())


def test_a_method_compiles_the_network_it_is_given():
    other = continuous(chain(4))

    def stubborn(network):
        return pgm.compile(other)

    for method in (stubborn, lambda network: pgm.compile(DYNAMIC, 3)):
        with pytest.raises(pgm.GraphError, match="not of the network it was given") as caught:
            pgm.compile(STATIC, method=method)
        assert repr(method) in str(caught.value)


@pytest.mark.parametrize("model", [None, "net", STATIC.cpds, STATIC.cpds[0]])
def test_only_networks_are_compiled(model):
    with pytest.raises(pgm.ModelError, match="takes a network"):
        pgm.compile(model)


def test_slices_of_a_dynamic_network_have_sizes():
    graph = pgm.compile(DYNAMIC, steps=100_000)
    assert graph.sizes[:3] == (2, 3, 3)
    assert len(graph.sizes) == 100_001
    assert graph.width == 2
    assert graph.cost == 2**3 + 100_000 * 3**3
    assert graph.is_tree
    first = pgm.compile(DYNAMIC, steps=0)
    assert (first.sizes, first.width, first.cost, first.is_tree) == ((2,), 1, 8, True)
    assert graph.sizes[:5] == tuple(cluster.size for cluster in graph.clusters[:5])
