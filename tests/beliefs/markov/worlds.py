"""Discrete dynamic networks as plain arrays, and their joint by enumeration of all paths."""

from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import product

import numpy as np
from scipy import sparse

import pgm


def drawn(rng, *shape, zeros=False):
    """Draw conditional tables, whose last axis sums to one; some entries may be zero."""
    table = rng.dirichlet(np.ones(shape[-1]), shape[:-1])
    if zeros and shape[-1] > 1:
        table = np.where(table == table.min(axis=-1, keepdims=True), 0.0, table)
        table /= table.sum(axis=-1, keepdims=True)
    return table


@dataclass(eq=False)
class World:
    """A model, evidence of one run, and the factors of its joint.

    `slices` lists the hidden variables of a step. A factor is a function from the states at two
    steps, dictionaries by name, and the step, to a probability.
    """

    model: pgm.DynamicBayesianNetwork
    evidence: dict
    steps: int
    slices: list
    prior: list = field(default_factory=list)
    transition: list = field(default_factory=list)
    measured: list = field(default_factory=list)

    @cached_property
    def paths(self):
        """All paths: by variable the states (steps + 1, paths); p(path), and p(measured | path)."""
        states = [v for v in self.slices if v in self.model.states]
        spaces = [[*product(*(range(v.size) for v in states))]]
        spaces += [[*product(*(range(v.size) for v in self.slices))]] * self.steps
        found = {v.name: [] for v in self.slices}
        prior, measured = [], []
        for path in product(*spaces):
            at = [
                dict(zip((v.name for v in (self.slices if t else states)), own, strict=True))
                for t, own in enumerate(path)
            ]
            for name, own in found.items():
                own.append([each.get(name, 0) for each in at])
            p = np.prod([factor(at[0]) for factor in self.prior])
            for t in range(1, self.steps + 1):
                p *= np.prod([factor(at[t - 1], at[t], t) for factor in self.transition])
            prior.append(p)
            measured.append(
                [np.prod([f(own, t) for f in self.measured]) for t, own in enumerate(at)]
            )
        return {name: np.array(own).T for name, own in found.items()}, np.array(prior), measured

    @cache  # noqa: B019  # worlds are few
    def marginal(self, *variables, until=None):
        """The joint of variables at steps, given the measurements up to a step, and its sum."""
        states, prior, measured = self.paths
        last = self.steps if until is None else until
        p = prior * np.prod(np.array(measured)[:, : last + 1], axis=1)
        table = np.zeros([v.size for v in variables])
        np.add.at(table, tuple(states[v.name][v.step] for v in variables), p)
        return table / table.sum(), table.sum()

    def best(self):
        """The most probable path, {name: states}, and its probability."""
        states, prior, measured = self.paths
        p = prior * np.prod(measured, axis=1)
        return {name: own[:, p.argmax()] for name, own in states.items()}, p.max()


def plain(rng, kind="dense", zeros=False, steps=4):
    """A hidden Markov model of six states, missing and repeated measurements, and step 0."""
    x, z = pgm.Discrete("x", 6), pgm.Discrete("z", 3)
    prior, seen = drawn(rng, 6), drawn(rng, 6, 3, zeros=zeros)
    motion = drawn(rng, 6, 6, zeros=zeros)
    table = motion
    if kind == "sparse":
        motion = np.where(rng.random((6, 6)) < 0.4, 0.0, motion) + np.eye(6)
        motion /= motion.sum(axis=1, keepdims=True)
        table = sparse.csr_array(motion)
    elif kind == "kronecker":
        east, north = drawn(rng, 2, 2), drawn(rng, 3, 3, zeros=zeros)
        motion, table = np.kron(east, north), pgm.Kronecker([east, sparse.csr_array(north)])
    elif kind == "shifts":
        table = pgm.shifts((2, 3), {(0, 1): 0.5, (1, -1): 0.3, (0, 0): 0.2}, edge=("slide", "wrap"))
        motion = table.toarray()
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(x, table=prior)],
        transition=[pgm.TableCPD(x, given=x.previous, table=table)],
        observation=[pgm.TableCPD(z, given=x, table=seen)],
    )
    due = [0, 1, 1, 3, steps, 2]
    found = model.sample({z: pgm.sightings(step=due)}, steps=steps, rng=rng)[z].tolist()
    evidence = {z: pgm.sightings([*found[:-1], -1], step=due)}
    reads = [*zip(due[:-1], found[:-1], strict=True)]
    return World(
        model,
        evidence,
        steps,
        [x],
        [lambda at: prior[at["x"]]],
        [lambda a, b, t: motion[a["x"], b["x"]]],
        [lambda at, t: np.prod([seen[at["x"], v] for step, v in reads if step == t])],
    )


def several(rng, steps=3):
    """Two states, a hidden control, a command as an input, two sensors of which one is soft."""
    a, b, c = pgm.Discrete("a", 2), pgm.Discrete("b", 3), pgm.Discrete("c", 2)
    u, z, w = pgm.Discrete("u", ("go", "stay")), pgm.Discrete("z", 3), pgm.Discrete("w", 2)
    pa, pb = drawn(rng, 2), drawn(rng, 2, 3)
    tc, ta, tb = drawn(rng, 2, 2), drawn(rng, 2, 2, 2), drawn(rng, 3, 2, 3)
    oz, ow = drawn(rng, 2, 3, 3), drawn(rng, 2, 2, 2)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(a, table=pa), pgm.TableCPD(b, given=a, table=pb)],
        transition=[
            pgm.TableCPD(c, given=u, table=tc),
            pgm.TableCPD(a, given=(c, a.previous), table=ta),
            pgm.TableCPD(b, given=(b.previous, a), table=tb),
        ],
        observation=[
            pgm.TableCPD(z, given=(b, a), table=oz.swapaxes(0, 1)),
            pgm.TableCPD(w, given=(c, u), table=ow),
        ],
    )
    commands = rng.integers(0, 2, steps)
    seen, weights = rng.integers(0, 3, steps), rng.random((steps, 2))
    seen[1] = -1
    evidence = {u: commands, z: seen, w: pgm.soft(weights)}
    return World(
        model,
        evidence,
        steps,
        [c, a, b],
        [lambda at: pa[at["a"]] * pb[at["a"], at["b"]]],
        [
            lambda old, at, t: (
                tc[commands[t - 1], at["c"]]
                * ta[at["c"], old["a"], at["a"]]
                * tb[old["b"], at["a"], at["b"]]
            )
        ],
        [
            lambda at, t: oz[at["a"], at["b"], seen[t - 1]] if t and seen[t - 1] >= 0 else 1.0,
            lambda at, t: ow[at["c"], commands[t - 1]] @ weights[t - 1] if t else 1.0,
        ],
    )


def called(rng, steps=3):
    """Tables that are functions of continuous inputs, and a matrix for each command."""
    x, y, z = pgm.Discrete("x", 3), pgm.Discrete("y", 4), pgm.Discrete("z", 2)
    v, u = pgm.Variable("v"), pgm.Discrete("u", ("left", "right"))
    prior, still = drawn(rng, 3), drawn(rng, 4)
    base, seen = drawn(rng, 3, 3), drawn(rng, 3, 4, 2)
    moves = {"right": pgm.shifts(4, {1: 0.8, 0: 0.2}, edge="wrap"), "left": drawn(rng, 4, 4)}

    def motion(speed):
        share = 1.0 / (1.0 + np.exp(-speed[..., 0]))[..., None, None]
        return share * base + (1.0 - share) * np.eye(3)

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(x, table=prior), pgm.TableCPD(y, table=still)],
        transition=[
            pgm.TableCPD(x, given=x.previous, inputs=v, table=motion),
            pgm.TableCPD(y, given=(y.previous, u), table=moves),
        ],
        observation=[
            pgm.TableCPD(z, given=(x, y), inputs=v, table=lambda speed: _seen(seen, speed))
        ],
    )
    speed, commands = rng.normal(size=(steps, 1)), rng.integers(0, 2, steps)
    reads = rng.integers(0, 2, steps)
    matrices = [np.asarray(moves["left"]), moves["right"].toarray()]
    return World(
        model,
        {v: speed, u: commands, z: reads},
        steps,
        [x, y],
        [lambda at: prior[at["x"]] * still[at["y"]]],
        [
            lambda old, at, t: (
                motion(speed[t - 1])[old["x"], at["x"]]
                * matrices[commands[t - 1]][old["y"], at["y"]]
            )
        ],
        [lambda at, t: _seen(seen, speed[t - 1])[at["x"], at["y"], reads[t - 1]] if t else 1.0],
    )


def _seen(seen, speed):
    """The sensor's table, flatter at high speed."""
    share = np.exp(-np.abs(speed[..., 0]))[..., None, None, None]
    return share * seen + (1.0 - share) * 0.5


WORLDS = {
    "dense": plain,
    "zeros": lambda rng: plain(rng, zeros=True),
    "sparse": lambda rng: plain(rng, "sparse"),
    "kronecker": lambda rng: plain(rng, "kronecker"),
    "kronecker with zeros": lambda rng: plain(rng, "kronecker", zeros=True),
    "shifts": lambda rng: plain(rng, "shifts"),
    "several": several,
    "functions": called,
}
