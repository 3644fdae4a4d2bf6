"""Networks of a given shape with random numbers, and shapes without loops."""

import numpy as np

import pgm


def tables(rng, parents, most=3):
    """Draw a discrete network; parents by place."""
    found = [
        pgm.Discrete(f"x{k}", states=int(rng.integers(2, most + 1))) for k in range(len(parents))
    ]
    cpds = []
    for child, places in zip(found, parents, strict=True):
        given = [found[p] for p in places]
        table = rng.dirichlet(np.full(child.size, 0.5), [v.size for v in given])
        cpds.append(pgm.TableCPD(child, given, table=table))
    return pgm.BayesianNetwork(cpds)


def gaussians(rng, parents, gain=0.7):
    """Draw a linear network of numbers; parents by place."""
    found = pgm.variables(f"x{k}" for k in range(len(parents)))
    cpds = []
    for child, places in zip(found, parents, strict=True):
        if places:
            given = {found[p]: gain * rng.normal() for p in places}
            cpds.append(pgm.LinearGaussianCPD(child, given, offset=rng.normal(), cov=1.0))
        else:
            cpds.append(pgm.GaussianCPD(child, rng.normal(), 1.0))
    return pgm.BayesianNetwork(cpds)


def polytree(rng, count):
    """List the parents of a network without loops, whose edges point either way."""
    parents = [[] for _ in range(count)]
    for k in range(1, count):
        ends = k, int(rng.integers(k))
        child, parent = ends if rng.random() < 0.5 else ends[::-1]
        parents[child].append(parent)
    return parents


def windows(rng, count, most=3, reach=6):
    """List the parents of a network each of whose variables has some shortly before it."""
    return [
        sorted(rng.choice(np.arange(max(0, k - reach), k), min(k, most), replace=False).tolist())
        for k in range(count)
    ]


def observed(rng, network, count):
    """Draw evidence on some variables from the network."""
    sample = network.sample(rng=rng)
    seen = [network.variables[k] for k in rng.choice(len(network.variables), count, replace=False)]
    if network.discrete:
        return {v: v.states[int(sample[v])] for v in seen}
    return {v: sample[v] for v in seen}


def hidden(network, evidence):
    """List the variables without evidence."""
    return [v for v in network.variables if v not in evidence]
