"""Gaussian factors are eliminated by the same plans as tables, and one plan makes all sums."""

import numpy as np
import pytest

import pgm
from pgm.elimination import Algebra, Calibrated, by_fill, eliminate
from tests.beliefs.own.structure import classes, modules, sums_of_products
from tests.elimination.test_plans import TREE

SIZES = [1, 2, 1, 2, 1]
VARIABLES = [pgm.Variable(f"x{k}", components=tuple("ab"[:size])) for k, size in enumerate(SIZES)]


class Canonical(Algebra):
    """Canonical forms of variables, which a label picks from a list."""

    def __init__(self, variables):
        self.variables = variables

    def product(self, step, factors):
        found = pgm.CanonicalForm.vacuous([self.variables[x] for x in step.scope])
        for factor in factors:
            found = found * factor
        return found

    def total(self, product, scope, left):
        gone = [self.variables[x] for x in scope if x not in left]
        return product.marginalise(*gone) if gone else product

    def joint(self, step, product, total, outside):
        return product if outside is None else product / total * outside


def drawn(scopes, seed):
    """Draw a proper canonical form for each scope."""
    rng = np.random.default_rng(seed)
    found = []
    for scope in scopes:
        variables = [VARIABLES[x] for x in scope]
        size = sum(v.dimension for v in variables)
        root = rng.normal(size=(size, size + 2))
        gaussian = pgm.Gaussian(variables, rng.normal(size=size), root @ root.T)
        found.append(pgm.CanonicalForm.from_gaussian(gaussian, rng.normal()))
    return found


def dense(scopes, factors):
    """The Gaussian of all variables, from its whole information matrix."""
    ends = np.cumsum([0, *SIZES])
    K, h = np.zeros((ends[-1], ends[-1])), np.zeros(ends[-1])
    for scope, factor in zip(scopes, factors, strict=True):
        at = np.concatenate([np.arange(ends[x], ends[x + 1]) for x in scope])
        order = np.concatenate([factor_places(factor, VARIABLES[x]) for x in scope])
        K[np.ix_(at, at)] += factor.K[np.ix_(order, order)]
        h[at] += factor.h[order]
    cov = np.linalg.inv(K)
    return cov @ h, cov, ends


def factor_places(factor, variable):
    ends = np.cumsum([0, *(v.dimension for v in factor.scope)])
    k = factor.scope.index(variable)
    return np.arange(ends[k], ends[k + 1])


@pytest.mark.parametrize("seed", range(5))
def test_a_plan_of_tables_eliminates_gaussians(seed):
    scopes = [(0, 1), (1, 2), (2, 3), (0, 3), (3, 4)]
    factors = drawn(scopes, seed)
    order, plan = by_fill(scopes, SIZES, [0, 4])
    found = eliminate(plan, factors, Canonical([VARIABLES[x] for x in order])).gaussian()
    mean, cov, ends = dense(scopes, factors)
    for x in (0, 4):
        own = found.marginal(VARIABLES[x])
        at = slice(ends[x], ends[x + 1])
        np.testing.assert_allclose(own.mean, mean[at], rtol=1e-9)
        np.testing.assert_allclose(own.cov, cov[at, at], rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_tree_of_gaussians_is_calibrated(seed):
    factors = drawn(TREE.scopes, seed)
    mean, cov, ends = dense(TREE.scopes, factors)
    for step, joint, _ in Calibrated(TREE, factors, Canonical(VARIABLES)).back():
        for x in step.scope:
            own = joint.marginal(VARIABLES[x]).gaussian()
            at = slice(ends[x], ends[x + 1])
            np.testing.assert_allclose(own.mean, mean[at], rtol=1e-8)
            np.testing.assert_allclose(own.cov, cov[at, at], rtol=1e-8)


# Where products are multiplied and summed without a plan: in the algebra of tables, and in what
# docs/architecture.md lists as laid out for one kind of question.
OWN = {
    "pgm.elimination.tables": {"_fused"},
    "pgm.beliefs.markov.single_state": {"_apply"},
    "pgm.beliefs.discrete.sums": {"sum", "total"},
    "pgm.beliefs.discrete.tree_plan": {"given", "of"},
}
TABLES = ("pgm.elimination", "pgm.beliefs.discrete", "pgm.beliefs.markov", "pgm.inference.query")


def test_products_of_tables_are_summed_by_one_plan():
    found = {name: set(sums_of_products(s)) for name, s in modules() if name.startswith(TABLES)}
    assert {name: functions for name, functions in found.items() if functions} == OWN


def test_steps_of_elimination_are_one_class():
    names = [name for (module, name), _ in classes() if module.startswith(TABLES)]
    assert names.count("Step") == 1
    assert [name for name in names if name.endswith("Contraction")] == []


@pytest.mark.parametrize(
    "line",
    [
        "return (a[:, None] * b).sum(axis=0)",
        "return np.sum(a * b, axis=0)",
        "product = a * b\n    return product.sum(-1)",
        "a *= b\n    return a.sum(-1)",
        "return np.add.reduce(np.multiply(a, b))",
        "return a @ b",
        "return np.dot(a, b)",
        "return einsum('ij,j', a, b)",
    ],
)
def test_the_check_finds_sums_of_products(line):
    assert list(sums_of_products(f"def f(a, b):\n    {line}")) == ["f"]


@pytest.mark.parametrize("line", ["return a.sum(-1)", "return a * b", "return sum(sizes)"])
def test_the_check_lets_other_arithmetic_pass(line):
    assert not list(sums_of_products(f"def f(a, b):\n    {line}"))
