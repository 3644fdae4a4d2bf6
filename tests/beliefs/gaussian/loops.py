"""Random networks whose cluster graphs have loops, and twins that solve them whole."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

import pgm


def variables(sizes):
    """Make variables of given dimensions."""
    return [
        pgm.Variable(f"v{k}", tuple(f"c{i}" for i in range(size))) for k, size in enumerate(sizes)
    ]


def random_network(rng, sizes, most=3, gain=1.0, noise=1.0):
    """Draw a linear network: each variable has up to `most` earlier ones as parents."""
    found = variables(sizes)
    cpds = []
    for k, v in enumerate(found):
        d = v.dimension
        root = rng.normal(size=(d, d))
        cov = root @ root.T + 0.1 * np.eye(d)
        places = rng.choice(k, size=rng.integers(1, min(k, most) + 1), replace=False) if k else ()
        given = {found[j]: gain * rng.normal(size=(d, found[j].dimension)) for j in places}
        if given:
            cpds.append(pgm.LinearGaussianCPD(v, given, offset=rng.normal(size=d), cov=noise * cov))
        else:
            cpds.append(pgm.GaussianCPD(v, rng.normal(size=d), cov))
    return pgm.BayesianNetwork(cpds)


def mixture_network(rng, sources, readings, spread=0.3, noise=1e-2):
    """Draw sources that every reading adds up: the more alike the rows, the tighter the loops."""
    x = [pgm.Variable(f"x{k}") for k in range(sources)]
    z = [pgm.Variable(f"z{k}") for k in range(readings)]
    cpds = [pgm.GaussianCPD(v, rng.normal(), 1.0) for v in x]
    for reading in z:
        given = {v: 1.0 + spread * rng.normal() for v in x}
        cpds.append(pgm.LinearGaussianCPD(reading, given, cov=noise))
    return pgm.BayesianNetwork(cpds), z


def draw_evidence(net, rng, observed):
    """Draw values of some variables from the network."""
    sample = net.sample(rng=rng)
    return {v: sample[v] for v in observed}


@dataclass(frozen=True)
class Solved:
    """Means and covariances of the hidden variables, from one dense factorisation."""

    places: dict
    mean: np.ndarray
    root: np.ndarray

    def means(self, v):
        return self.mean[..., self.places[v]]

    def cov(self, v):
        rows = self.root[..., self.places[v], :]
        return rows @ rows.swapaxes(-1, -2)

    def std(self, v):
        return np.sqrt(np.diagonal(self.cov(v), axis1=-2, axis2=-1))


def solve(net, evidence):
    """Solve min ‖Σ_i^(-1/2) (v_i − Σ_j F_ij v_j − c_i)‖² for what is hidden, by one dense QR."""
    hidden = [v for v in net.variables if v not in evidence]
    ends = np.cumsum([v.dimension for v in hidden])
    places = {v: slice(e - v.dimension, e) for v, e in zip(hidden, ends, strict=True)}
    rows, right = [], []
    for cpd in net.cpds:
        block = np.zeros((cpd.child.dimension, ends[-1]))
        side = np.array(cpd.offset)
        parts = [(cpd.child, -np.eye(cpd.child.dimension)), *getattr(cpd, "matrices", {}).items()]
        for v, matrix in parts:
            if v in places:
                block[:, places[v]] += matrix
            else:
                side = side + np.asarray(evidence[v], float).reshape(-1, v.dimension) @ matrix.T
        lower = np.linalg.cholesky(cpd.cov)
        rows.append(np.linalg.solve(lower, block))
        right.append(np.linalg.solve(lower, np.atleast_2d(side).T))
    runs = max(side.shape[1] for side in right)
    right = np.vstack([np.broadcast_to(side, (side.shape[0], runs)) for side in right])
    q, r = np.linalg.qr(np.vstack(rows))
    mean = -np.linalg.solve(r, q.T @ right).T
    return Solved(places, mean[0] if runs == 1 else mean, np.linalg.inv(r))


def errors(posterior, solved):
    """How far the means of each run are off, in exact standard deviations."""
    off = [
        np.abs((posterior[v].mean - solved.means(v)) / solved.std(v)).max(axis=-1)
        for v in solved.places
    ]
    return np.max(off, axis=0)


def paths(net, rng):
    """Make a graph by hand: families as clusters, those of each variable joined along a path.

    In a random order, so that there are loops; running intersection holds for each variable.
    """
    families = [cpd.scope for cpd in net.cpds]
    clusters = [f for f in families if not any(set(f) < set(g) for g in families)]
    sepsets = {}
    for v in net.variables:
        holders = [k for k, cluster in enumerate(clusters) if v in cluster]
        rng.shuffle(holders)
        for i, j in pairwise(holders):
            sepsets.setdefault((min(i, j), max(i, j)), set()).add(v)
    return pgm.ClusterGraph(net, clusters, sepsets)


class Bent:
    """A line that is bent: y = l + k sin l + c, l = Σ A_j x_j."""

    def __init__(self, matrices, offset, bend):
        self.matrices, self.offset, self.bend = matrices, offset, bend

    def line(self, *xs):
        return sum(x @ a.T for x, a in zip(xs, self.matrices, strict=True))

    def __call__(self, *xs):
        line = self.line(*xs)
        return line + self.bend * np.sin(line) + self.offset

    def slopes(self, *xs):
        slope = 1.0 + self.bend * np.cos(self.line(*xs))
        return [slope[..., None] * a for a in self.matrices]


def bent(net, bend):
    """Bend every CPD of a linear network."""
    cpds = []
    for cpd in net.cpds:
        if cpd.given:
            function = Bent([cpd.matrices[v] for v in cpd.given], cpd.offset, bend)
            cpd = pgm.NonlinearGaussianCPD(cpd.child, cpd.given, function, cpd.cov)
        cpds.append(cpd)
    return pgm.BayesianNetwork(cpds)


def steepest(net, evidence, posterior):
    """Return the largest slope of the MAP cost of a bent network, by a standard deviation."""
    value = {v: evidence[v] if v in evidence else posterior[v].mean for v in net.variables}
    slope = {v: np.zeros(v.dimension) for v in net.variables}
    for cpd in net.cpds:
        given = [value[v] for v in cpd.given]
        function = getattr(cpd, "function", None)
        due = function(*given) if function else cpd.offset
        pull = np.linalg.solve(cpd.cov, value[cpd.child] - due)
        slope[cpd.child] += pull
        for v, matrix in zip(cpd.given, function.slopes(*given) if function else (), strict=True):
            slope[v] -= matrix.T @ pull
    return max(
        np.abs(slope[v] * posterior[v].std).max() for v in net.variables if v not in evidence
    )
