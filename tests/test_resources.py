"""The search for garbage is put off while many values are made, and is then as it was."""

import gc

import pytest

import pgm
from pgm.resources import uncollected


@pytest.mark.parametrize("searched", [True, False])
@pytest.mark.parametrize(("count", "off"), [(10, False), (10**6, True)])
def test_the_search_is_put_off_where_values_are_many_and_then_as_it_was(searched, count, off):
    (gc.enable if searched else gc.disable)()
    try:
        with uncollected(count):
            assert gc.isenabled() == (searched and not off)
        assert gc.isenabled() == searched
        with pytest.raises(KeyError), uncollected(count):
            raise KeyError
        assert gc.isenabled() == searched
    finally:
        gc.enable()


def test_it_is_on_again_behind_networks_and_in_functions_of_a_users():
    def order(network):
        assert gc.isenabled()
        return network.variables[::-1]

    def named(count):
        for k in range(count):
            assert gc.isenabled()
            yield f"x{k}"

    x = pgm.variables(named(3000))
    first, step = pgm.GaussianCPD(x[0], 0.0, 1.0), pgm.LinearGaussianCPD(x[1], {x[0]: 1.0}, 1.0)
    walk = pgm.plate(step, {x[1]: x[1:], x[0]: x[:-1]})
    graph = pgm.compile(pgm.BayesianNetwork([first, *walk]), method=pgm.JunctionTree(order))
    assert len(graph.clusters) == 2999
    with pytest.raises(pgm.ModelError, match="two CPDs"):
        pgm.BayesianNetwork([first, *walk, first])
    assert gc.isenabled()
