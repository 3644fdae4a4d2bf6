"""Gaussian factors are eliminated by the same plans as tables, and one plan makes all sums."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

import pgm
from pgm.elimination import Algebra, Calibrated, by_fill, eliminate
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


PACKAGE = Path(pgm.__file__).parent
# Folders of tables.
TABLES = ("elimination", "beliefs/discrete", "beliefs/markov", "inference/query")


def test_products_of_tables_are_summed_by_one_plan():
    """Nothing but the algebra of tables multiplies and sums; steps of elimination are one class."""
    classes, einsums = [], []
    for folder in TABLES:
        for path in sorted((PACKAGE / folder).glob("*.py")):
            source = path.read_text(encoding="utf-8")
            einsums += [path.name] * len(re.findall(r"np\.(einsum|tensordot)\(", source))
            classes += [
                node.name for node in ast.parse(source).body if isinstance(node, ast.ClassDef)
            ]
    assert classes.count("Step") == 1
    assert [name for name in classes if name.endswith("Contraction")] == []
    assert einsums == ["tables.py"]
