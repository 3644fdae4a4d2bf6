"""Random Gaussian networks with dense twins: regular ones in floats, singular ones in fractions."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from textbooks import ExactJoint, assert_log, floats, rational

import pgm
from tests.dense import linear_joint


def scalars_and_vectors(rng, count, most):
    """Draw variables of 1 to `most` components."""
    sizes = rng.integers(1, most + 1, size=count)
    return [
        pgm.Variable(f"v{k}", tuple(f"v{k}_{part}" for part in range(size)))
        for k, size in enumerate(sizes)
    ]


def conditional(child, given, offset, cov):
    """Make a CPD of the kind that fits."""
    if given:
        return pgm.LinearGaussianCPD(child, given, offset=offset, cov=cov)
    return pgm.GaussianCPD(child, offset, cov)


@dataclass(frozen=True)
class Drawn:
    """CPDs, parents first, and a value of each variable that they allow."""

    cpds: tuple
    values: dict

    @property
    def variables(self):
        return [cpd.child for cpd in self.cpds]

    def network(self, rng=None):
        cpds = self.cpds if rng is None else [self.cpds[k] for k in rng.permutation(len(self.cpds))]
        return pgm.BayesianNetwork(cpds)

    def observe(self, rng, share):
        """Draw some variables, with their values, and the others."""
        seen = [v for v in self.variables if rng.random() < share]
        return {v: floats(self.values[v]) for v in seen}, [
            v for v in self.variables if v not in seen
        ]

    def dense(self):
        return linear_joint(
            [(cpd.child, dict(cpd.matrices), cpd.offset, cpd.cov) for cpd in self.cpds]
        )


def regular(seed, count, most=3, parents=3, reach=None, std=(0.3, 2.0)):
    """Draw a network of proper CPDs; parents are among the last `reach` variables."""
    rng = np.random.default_rng(seed)
    found = scalars_and_vectors(rng, count, most)
    cpds, values = [], {}
    for k, child in enumerate(found):
        size = child.dimension
        pool = np.arange(max(0, k - (reach or k)), k)
        chosen = rng.choice(pool, min(pool.size, int(rng.integers(0, parents + 1))), replace=False)
        given = {
            found[j]: rng.normal(size=(size, found[j].dimension)) / np.sqrt(2 * chosen.size)
            for j in chosen
        }
        root = np.tril(0.5 * rng.normal(size=(size, size)), -1) + np.eye(size)
        root = rng.uniform(*std, size=(size, 1)) * root
        offset = rng.normal(size=size)
        cpds.append(conditional(child, given, offset, root @ root.T))
        mean = offset + sum(matrix @ values[parent] for parent, matrix in given.items())
        values[child] = mean + root @ rng.normal(size=size)
    return Drawn(tuple(cpds), values)


def eighths(rng, *shape, top=16):
    """Draw numbers that floats and their products hold exactly."""
    return rng.integers(-top, top + 1, size=shape) / 8.0


def singular(seed, count, most=3, parents=3, share=0.6):
    """Draw a network where a share of the covariances have any rank, in binary fractions.

    The values are drawn with exact arithmetic, so that they contradict no CPD without noise.
    """
    rng = np.random.default_rng(seed)
    found = scalars_and_vectors(rng, count, most)
    cpds, values = [], {}
    for k, child in enumerate(found):
        size = child.dimension
        rank = int(rng.integers(0, size + 1)) if rng.random() < share else size
        root = eighths(rng, size, rank)
        while rank == size and abs(np.linalg.det(root)) < 0.05:
            root = eighths(rng, size, rank)
        chosen = (
            rng.choice(k, min(k, int(rng.integers(0, parents + 1))), replace=False) if k else []
        )
        given = {}
        for j in chosen:
            shape = size, found[j].dimension
            given[found[j]] = eighths(rng, *shape, top=8) * (rng.random(shape) < 0.8)
        offset = eighths(rng, size)
        cpds.append(conditional(child, given, offset, root @ root.T))
        value = rational(offset)
        if rank:
            value = value + rational(root) @ rational(rng.integers(-8, 9, size=rank) / 8.0)
        for parent, matrix in given.items():
            value = value + rational(matrix) @ values[parent]
        values[child] = value
    return Drawn(tuple(cpds), values)


class Conditioned(ExactJoint):
    """The dense joint in fractions, given evidence; `certain` counts what it knew before."""

    def __init__(self, drawn, evidence):
        super().__init__()
        self.certain = 0
        for cpd in drawn.cpds:
            self.add(cpd.child, dict(cpd.matrices), cpd.offset, cpd.cov)
        for variable, value in evidence.items():
            for k, place in enumerate(self.places[variable]):
                if self.cov[place, place] == 0:
                    assert self.mean[place] == rational(value)[k]
                    self.certain += 1
                else:
                    self._read_one(place, rational(value)[k])

    def _read_one(self, place, number):
        self.places["one"] = [place]
        self.read("one", [float(number)])


def turned(drawn, seed, shift=0.0, units=0.0):
    """The same network in other coordinates, x' = T x + t, and the (T, t) of each variable.

    T is a rotation times `units` orders of e; rounding then leaves no number exact.
    """
    rng = np.random.default_rng(seed)
    turns = {}
    for v in drawn.variables:
        rotation, _ = np.linalg.qr(rng.normal(size=(v.dimension, v.dimension)))
        scale = np.exp(units * rng.normal(size=v.dimension))
        turns[v] = rotation * scale, shift * rng.normal(size=v.dimension)
    cpds = []
    for cpd in drawn.cpds:
        turn, move = turns[cpd.child]
        given = {p: turn @ F @ np.linalg.inv(turns[p][0]) for p, F in cpd.matrices.items()}
        offset = turn @ cpd.offset + move - sum(F @ turns[p][1] for p, F in given.items())
        cov = turn @ cpd.cov @ turn.T
        cpds.append(conditional(cpd.child, given, offset, (cov + cov.T) / 2))
    values = {v: T @ floats(drawn.values[v]) + t for v, (T, t) in turns.items()}
    return Drawn(tuple(cpds), values), turns


def turned_back(gaussian, turns):
    """Moments in the coordinates before `turned`."""
    matrix = np.linalg.inv(block_diag(*(turns[v][0] for v in gaussian.scope)))
    shift = np.concatenate([turns[v][1] for v in gaussian.scope])
    return matrix @ (gaussian.mean - shift), matrix @ gaussian.cov @ matrix.T


def assert_moments(mean, cov, due_mean, due_cov, tolerance=1e-9, digits=0.0):
    """Equal in standard deviations; where there are none, in parts of the mean's size.

    `digits` is the share of a mean's size that its coordinates cannot hold.
    """
    assert mean.shape == due_mean.shape
    assert cov.shape == due_cov.shape
    std = np.sqrt(np.diagonal(due_cov, axis1=-2, axis2=-1))
    unit = np.where(std > 0.0, std, np.maximum(np.abs(due_mean), 1.0))
    far = np.abs(mean - due_mean) - digits * np.abs(due_mean)
    worst = (far / unit).max(initial=0.0)
    assert worst <= tolerance, f"a mean is {worst:.3g} standard deviations off"
    spread = unit[..., :, None] * unit[..., None, :]
    worst = (np.abs(cov - due_cov) / spread).max(initial=0.0)
    assert worst <= tolerance, f"a covariance is {worst:.3g} of the deviations off"


def assert_dense(posterior, dense, evidence, hidden, rng, tolerance=1e-9):
    """Every marginal, some joints in any order, and the log-evidence, of a regular network."""
    due, log_evidence = dense.given(evidence)
    for variable in hidden:
        one = posterior[variable]
        assert one.scope == (variable,)
        assert_moments(one.mean, one.cov, *due.marginal(variable), tolerance)
    for _ in range(4 if hidden else 0):
        scope = [hidden[k] for k in rng.permutation(len(hidden))[: rng.integers(1, 7)]]
        joint = posterior.joint(*scope)
        assert joint.scope == tuple(scope)
        assert_moments(joint.mean, joint.cov, *due.marginal(*scope), tolerance)
    assert_log(posterior.log_evidence, log_evidence, tolerance)
