"""What is set, beside what is seen: against sums over the mutilated joint, and by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.examples import rain, rainy, wet


@pytest.mark.parametrize("seed", range(20))
def test_tables(seed):
    """p(x | do(y)) is the product of all CPDs but those of y, at y, divided by nothing."""
    rng = np.random.default_rng(seed)
    variables = [pgm.Discrete(f"x{k}", int(rng.integers(2, 4))) for k in range(5)]
    cpds = []
    for k, child in enumerate(variables):
        given = [p for p in variables[:k] if rng.random() < 0.6]
        table = rng.dirichlet(np.ones(child.size), [p.size for p in given])
        cpds.append(pgm.TableCPD(child, given, table=table))
    network = pgm.BayesianNetwork(cpds)
    setting = variables[int(rng.integers(5))], variables[int(rng.integers(5))]
    values = {v: int(rng.integers(v.size)) for v in setting}
    joint = pgm.Table.vacuous(variables)
    for cpd in cpds:
        if cpd.child not in values:
            joint = joint * pgm.Table(cpd.scope[1:] + cpd.scope[:1], cpd.table)
    due = joint.reduce(values)
    made = network.do(values)
    assert all(made.cpd(v).parents == () for v in values)
    left = [v for v in variables if v not in values]
    found = pgm.query(made, left)
    assert_allclose(found.values, due.rearrange(left).values, atol=1e-14)


def test_continuous_variables():
    """A cause that is set says nothing of its own cause, and all of its effects."""
    a, b, c = pgm.variables("a b c")
    network = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 1.0, 4.0),
            pgm.LinearGaussianCPD(b, {a: 2.0}, cov=1.0),
            pgm.LinearGaussianCPD(c, {a: 1.0, b: -1.0}, cov=0.5),
        ]
    )
    seen = pgm.infer(pgm.compile(network), {b: 3.0})
    done = pgm.infer(pgm.compile(network.do({b: 3.0})), {})
    gain = 8.0 / 17.0
    assert_allclose(seen[a].mean, [1.0 + gain * (3.0 - 2.0)], rtol=1e-12)
    assert_allclose(done[a].mean, [1.0])
    assert_allclose(done[c].mean, [-2.0])
    assert_allclose(done[c].cov, [[4.5]])
    both = pgm.infer(pgm.compile(network.do({b: [[3.0], [0.0]]})), {})
    assert_allclose(both[c].mean, [[-2.0], [1.0]])


def test_what_is_refused():
    a, b = pgm.variables("a b")
    network = pgm.BayesianNetwork([pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0)])
    with pytest.raises(pgm.ModelError, match="no CPD of a, since it is an input"):
        network.do({a: 1.0})
    with pytest.raises(pgm.ModelError, match="no CPD of rain, which the network does not have"):
        network.do({rain: "yes"})
    with pytest.raises(pgm.ModelError, match="b: the mean has entries that are NaN"):
        network.do({b: np.nan})
    with pytest.raises(pgm.ModelError, match="wet has no state 'damp'"):
        rainy.do({wet: "damp"})
    with pytest.raises(pgm.ModelError, match="do is a mapping of variables to values, not list"):
        rainy.do([wet])
