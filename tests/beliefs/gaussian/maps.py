"""A drawn map: a robot drives past landmarks that nobody knows, with twins that solve it whole."""

from dataclasses import dataclass, field

import numpy as np

import pgm
from models import motion
from models.pose_graphs import pose_graph_network
from models.sensors import range_bearing
from pgm.recordings import PoseGraph

MOVED, SEEN, KNOWN = np.array([0.1, 0.1, 0.05]), np.array([0.1, 0.05]), 5.0


def wrapped(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@dataclass
class Map:
    """Poses of a drive along a circle, each but the first a child of the one before.

    Each sees the landmarks, in range and bearing; `turn` is how far off the wheels are a step.
    """

    steps: int = 8
    landmarks: int = 3
    seed: int = 0
    turn: float = 0.0
    noise: pgm.RobustNoise | None = None
    poses: list = field(init=False)
    marks: list = field(init=False)

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        kinds = {"components": ("east", "north", "heading"), "angles": ("heading",)}
        self.poses = [pgm.Variable(f"x{k}", **kinds) for k in range(self.steps + 1)]
        self.marks = [
            pgm.Variable(f"m{k}", components=("east", "north")) for k in range(self.landmarks)
        ]
        true, told = [np.array([0.0, 0.0, 2.9])], np.array([1.0, 0.0, 0.4])
        off = np.array([0.0, 0.0, self.turn])
        for _ in range(self.steps):
            true.append(motion.increment(true[-1], told + MOVED * rng.normal(size=3)))
        self.true = np.array(true)
        self.places = rng.normal(0.0, 3.0, (self.landmarks, 2))
        self.guesses = self.places + KNOWN * rng.normal(size=self.places.shape)
        self.told = np.tile(told + off, (self.steps, 1))
        self.pairs = [(k, m) for k in range(self.steps + 1) for m in range(self.landmarks)]
        seen = np.array([range_bearing(self.true[k], self.places[m]) for k, m in self.pairs])
        self.seen = seen + SEEN * rng.normal(size=seen.shape)
        self.seen[:, 1] = wrapped(self.seen[:, 1])

    @property
    def readings(self):
        kinds = {"components": ("range", "bearing"), "angles": ("bearing",)}
        return [pgm.Variable(f"z{k}_{m}", **kinds) for k, m in self.pairs]

    @property
    def network(self):
        u = [pgm.Variable(f"u{k}", components=("a", "b", "c")) for k in range(self.steps)]
        cpds = [pgm.GaussianCPD(self.poses[0], self.true[0], np.square(MOVED))]
        for mark, guess in zip(self.marks, self.guesses, strict=True):
            cpds.append(pgm.GaussianCPD(mark, guess, KNOWN**2))
        for k in range(self.steps):
            parents = self.poses[k], u[k]
            step = pgm.NonlinearGaussianCPD(
                self.poses[k + 1], parents, motion.increment, np.square(MOVED)
            )
            cpds.append(step)
        for z, (k, m) in zip(self.readings, self.pairs, strict=True):
            parents = self.poses[k], self.marks[m]
            cpds.append(
                pgm.NonlinearGaussianCPD(
                    z, parents, range_bearing, np.square(SEEN), noise=self.noise
                )
            )
        return pgm.BayesianNetwork(cpds)

    @property
    def evidence(self):
        found = {
            pgm.Variable(f"u{k}", components=("a", "b", "c")): row
            for k, row in enumerate(self.told)
        }
        return found | dict(zip(self.readings, self.seen, strict=True))

    def split(self, x):
        """Poses and landmarks of a vector of all unknowns."""
        size = 3 * (self.steps + 1)
        return x[:size].reshape(-1, 3), x[size:].reshape(-1, 2)

    def reckoned(self):
        """Where the network is linearised first: at dead reckoning, and guesses of landmarks."""
        poses = [self.true[0]]
        for told in self.told:
            poses.append(motion.increment(poses[-1], told))
        return np.concatenate([np.ravel(poses), self.guesses.ravel()])

    def known(self, x):
        """Whitened residuals of all that is not read."""
        poses, marks = self.split(x)
        first = (poses[0] - self.true[0]) / MOVED
        moved = poses[1:] - motion.increment(poses[:-1], self.told)
        moved[:, 2] = wrapped(moved[:, 2])
        return np.concatenate(
            [first, (moved / MOVED).ravel(), (marks - self.guesses).ravel() / KNOWN]
        )

    def read(self, x):
        """Whitened residuals of the readings, (readings, 2)."""
        poses, marks = self.split(x)
        k, m = np.transpose(self.pairs)
        left = self.seen - range_bearing(poses[k], marks[m])
        left[:, 1] = wrapped(left[:, 1])
        return left / SEEN

    def residual(self, x):
        return np.concatenate([self.known(x), self.read(x).ravel()])

    def means(self, posterior):
        poses, marks = posterior.means(self.poses), posterior.means(self.marks)
        lead = poses.shape[:-2]
        return np.concatenate([poses.reshape(*lead, -1), marks.reshape(*lead, -1)], axis=-1)


def measurement(name, factor):
    """A variable of what a pose graph's factor is of: a motion, or a place as it is seen."""
    kind = [("forward", "left"), ("forward", "left", "turn")][len(factor.value) - 2]
    return pgm.Variable(name, kind, kind[2:])


@dataclass
class Motions:
    """A pose graph of which a tree's edges are hidden motions, that poses follow without noise."""

    graph: PoseGraph
    network: pgm.BayesianNetwork
    evidence: dict
    poses: list
    landmarks: list
    told: dict

    @classmethod
    def of(cls, graph, noise=None):
        made = pose_graph_network(graph)
        left = {f"z{k}": factor for k, factor in enumerate(made.edges)}
        left |= {f"s{k}": factor for k, factor in enumerate(made.sightings)}
        known = [pgm.GaussianCPD(made.poses[row], graph.poses[row], 0.0) for row in made.held]
        told, cpds, evidence = {}, [], {}
        for branch in made.branches:
            name = f"{'zs'[branch.sees]}{branch.edge}"
            u = measurement(f"u_{name}", factor := left.pop(name))
            told[u] = branch.edges.motions[branch.edge]
            child = (made.landmarks if branch.sees else made.poses)[branch.child]
            leads = motion.increment if branch.onward else motion.retreat
            leads = motion.place if branch.sees else leads
            parents = made.poses[branch.parent], u
            cpds.append(pgm.GaussianCPD(u, told[u], factor.cov))
            cpds.append(pgm.NonlinearGaussianCPD(child, parents, leads, 0.0))
        for name, factor in left.items():
            z = measurement(name, factor)
            evidence[z] = factor.value
            cpds.append(
                pgm.NonlinearGaussianCPD(z, factor.scope, motion.relative, factor.cov, noise=noise)
            )
        network = pgm.BayesianNetwork([*known, *cpds])
        return cls(graph, network, evidence, list(made.poses), list(made.landmarks), told)

    def start(self, poses, landmarks):
        """Means to begin at, of motions as they are told, which need not lead there."""
        vertices = zip([*self.poses, *self.landmarks], [*poses, *landmarks], strict=True)
        return {**self.told, **dict(vertices)}

    def means(self, posterior):
        return posterior.means(self.poses), posterior.means(self.landmarks)


def slope(function, x, step=1e-6):
    """The Jacobian of residuals by central differences."""
    columns = [(function(x + d) - function(x - d)) / (2 * step) for d in step * np.eye(x.size)]
    return np.transpose(columns)


def controlled(residual, x, iterations, rule):
    """Levenberg–Marquardt on dense matrices, as `pgm.LevenbergMarquardt` tells it."""
    weight = rule.start
    for _ in range(iterations):
        left, jacobian = residual(x), slope(residual, x)
        information, gradient = jacobian.T @ jacobian, jacobian.T @ left
        variance = np.diag(np.linalg.inv(information))
        limit = (left @ left) * (1.0 + 1e-13)
        tried, number = x - np.linalg.solve(information, gradient), 0
        while np.sum(residual(tried) ** 2) > limit and number < rule.tries:
            weight *= rule.factor if number else 1.0
            held = information + weight * np.diag(1.0 / variance)
            tried, number = x - np.linalg.solve(held, gradient), number + 1
        if np.sum(residual(tried) ** 2) <= limit:
            x, weight = tried, weight / rule.factor
        else:
            weight *= rule.factor
        weight = max(weight, rule.start)
    return x
