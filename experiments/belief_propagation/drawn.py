"""Networks drawn at random on which ways to compile are compared: grids, and others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import pgm

Parents = Sequence[Sequence[int]]  # of each variable, by place
Evidence = dict[pgm.Variable, Any]

PARENTS = 3
REACH = 8
# Of a probability in a column, drawn from Dirichlet's distribution: the smaller, the surer.
CONCENTRATION = 0.5
GAIN = 0.7


def grid(side: int, rng: np.random.Generator) -> Parents:
    """Each variable has the one above and the one to the left as parents."""
    return [[k - side] * (k >= side) + [k - 1] * (k % side > 0) for k in range(side**2)]


def scattered(count: int, rng: np.random.Generator) -> Parents:
    """Each variable has up to three of the eight before it as parents."""
    return [
        rng.choice(
            np.arange(max(0, k - REACH), k), rng.integers(0, min(k, PARENTS) + 1), replace=False
        ).tolist()
        for k in range(count)
    ]


def tables(parents: Parents, rng: np.random.Generator) -> pgm.BayesianNetwork:
    """Variables of two states."""
    variables = [pgm.Discrete(f"x{k}", 2) for k in range(len(parents))]
    cpds = []
    for child, places in zip(variables, parents, strict=True):
        table = rng.dirichlet([CONCENTRATION] * 2, (2,) * len(places))
        cpds.append(pgm.TableCPD(child, [variables[p] for p in places], table=table))
    return pgm.BayesianNetwork(cpds)


def gaussians(parents: Parents, rng: np.random.Generator) -> pgm.BayesianNetwork:
    """Numbers with noise of variance 1."""
    variables = pgm.variables(f"x{k}" for k in range(len(parents)))
    cpds: list[pgm.GaussianCPD | pgm.LinearGaussianCPD] = []
    for child, places in zip(variables, parents, strict=True):
        given = {variables[p]: GAIN * rng.normal() for p in places}
        if given:
            cpds.append(pgm.LinearGaussianCPD(child, given=given, cov=1.0))
        else:
            cpds.append(pgm.GaussianCPD(child, 0.0, 1.0))
    return pgm.BayesianNetwork(cpds)


KINDS: dict[str, Callable[[Parents, np.random.Generator], pgm.BayesianNetwork]] = {
    "discrete": tables,
    "gaussian": gaussians,
}


def observe(
    network: pgm.BayesianNetwork, among: Sequence[pgm.Variable], count: int, seed: int
) -> Evidence:
    """Values of some variables, drawn from the network."""
    rng = np.random.default_rng(seed)
    sample = network.sample(rng=rng)
    chosen = rng.choice(len(among), min(count, len(among)), replace=False)
    seen = [among[k] for k in sorted(chosen)]
    return {v: v.states[int(sample[v])] if isinstance(v, pgm.Discrete) else sample[v] for v in seen}


def leaves(network: pgm.BayesianNetwork) -> list[pgm.Variable]:
    """The variables that are nobody's parents."""
    parents = {parent for cpd in network.cpds for parent in cpd.parents}
    return [variable for variable in network.variables if variable not in parents]
