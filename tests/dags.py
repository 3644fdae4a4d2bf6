"""Networks of any shape for tests of structure: their numbers say nothing."""

import numpy as np
from hypothesis import strategies as st

import pgm


def continuous(parents, dimensions=None, inputs=()):
    """Make a network of Gaussian CPDs; parents by place, places in `inputs` have no CPD."""
    sizes = dimensions or [1] * len(parents)
    found = [
        pgm.Variable(f"x{k}", tuple(f"x{k}_{part}" for part in range(size)))
        for k, size in enumerate(sizes)
    ]
    cpds = []
    for k, places in enumerate(parents):
        if k in inputs:
            continue
        child = found[k]
        given = {found[p]: np.ones((child.dimension, found[p].dimension)) for p in places}
        if given:
            cpds.append(pgm.LinearGaussianCPD(child, given, cov=np.eye(child.dimension)))
        else:
            cpds.append(pgm.GaussianCPD(child, np.zeros(child.dimension), np.eye(child.dimension)))
    return pgm.BayesianNetwork(cpds)


def discrete(parents, sizes=None):
    """Make a network of uniform tables; parents by place."""
    sizes = sizes or [2] * len(parents)
    found = [pgm.Discrete(f"x{k}", states=size) for k, size in enumerate(sizes)]
    cpds = []
    for k, places in enumerate(parents):
        table = np.full((*(sizes[p] for p in places), sizes[k]), 1.0 / sizes[k])
        cpds.append(pgm.TableCPD(found[k], [found[p] for p in places], table=table))
    return pgm.BayesianNetwork(cpds)


def chain(count):
    """List the parents of a chain."""
    return [[k - 1] if k else [] for k in range(count)]


def tree(count, branches):
    """List the parents of a tree: each variable but the last ones has as many children."""
    return [[(k - 1) // branches] if k else [] for k in range(count)]


def star(count):
    """List the parents of a variable and its many children, as of a naive Bayes classifier."""
    return [[]] + [[0]] * count


def grid(rows, columns=None):
    """List the parents of a grid: the variables above and to the left."""
    columns = columns or rows
    return [
        [k - columns] * (k >= columns) + [k - 1] * (k % columns > 0) for k in range(rows * columns)
    ]


def random_parents(rng, count, most=3):
    """List the parents of a random graph, connected or not."""
    return [
        sorted(rng.choice(k, size=rng.integers(0, min(k, most) + 1), replace=False).tolist())
        for k in range(count)
    ]


@st.composite
def shapes(draw, most=12):
    """Draw the parents of a graph, connected or not."""
    count = draw(st.integers(1, most))
    return [
        sorted(draw(st.sets(st.integers(0, k - 1), max_size=3))) if k else [] for k in range(count)
    ]


@st.composite
def networks(draw, most=12):
    """Draw a network of either kind, with inputs if it is continuous."""
    parents = draw(shapes(most))
    sizes = draw(st.lists(st.integers(1, 4), min_size=len(parents), max_size=len(parents)))
    if draw(st.booleans()):
        return discrete(parents, sizes)
    roots = [k for k, places in enumerate(parents) if not places]
    inputs = draw(st.sets(st.sampled_from(roots)))
    if len(inputs) == len(parents):
        inputs = set()
    return continuous(parents, sizes, inputs)
