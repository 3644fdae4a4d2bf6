"""Drawn linear networks over time, with readings drawn from them.

All parameters are small integers times powers of two, hence exact in float64, so that what is
singular is exactly so.
"""

from dataclasses import dataclass, field

import numpy as np
from precise import floats, precise, zeros

import pgm


@dataclass
class Node:
    """A child: Σ M parent + offset + B e, and its unit."""

    child: pgm.Variable
    given: dict
    offset: np.ndarray
    root: np.ndarray

    @property
    def cpd(self):
        cov = self.root @ self.root.T
        if not self.given:
            return pgm.GaussianCPD(self.child, self.offset, cov)
        return pgm.LinearGaussianCPD(self.child, self.given, offset=self.offset, cov=cov)


@dataclass
class Case:
    seed: int
    model: pgm.DynamicBayesianNetwork
    steps: int
    evidence: dict
    runs: list  # (inputs, readings) of each
    lead: tuple
    units: dict
    traits: set = field(default_factory=set)


def integers(rng, rows, columns, top=2):
    return rng.integers(-top, top + 1, (rows, columns)).astype(float)


def root(rng, size, rank):
    """B of B Bᵀ, of a rank at most; diagonal now and then."""
    if rng.random() < 0.4:
        return np.eye(size)[:, rng.permutation(size)[:rank]]
    return integers(rng, size, rank)


def motion(rng, n):
    """A kind, F and B in units of one."""
    kinds = ["static", "walk", "velocity", "moving", "regressive", "turning", "contracting"]
    kinds += ["nilpotent", "unstable", "drawn"]
    kind = kinds[rng.integers(len(kinds))]
    shift = np.eye(n, k=-1)
    push = root(rng, n, int(rng.integers(0, n + 1)))
    push = push * 2.0 ** -rng.choice([0, 0, 0, 2, 5, 10, 16])
    if kind == "static":
        return kind, np.eye(n), np.zeros((n, 0))
    if kind == "walk":
        return kind, np.eye(n), push
    if kind == "velocity":
        moved = np.eye(n) + np.eye(n, k=1) * 2.0 ** -rng.integers(0, 5)
        own = np.eye(n)[:, -1:] if rng.random() < 0.7 else push
        return kind, moved, own
    if kind == "moving":
        return kind, shift, np.eye(n)[:, :1]
    if kind == "regressive":
        shift[0] = rng.integers(-4, 5, n) / 8 * 2.0
        own = integers(rng, n, 1) if rng.random() < 0.5 else np.eye(n)[:, :1]
        return kind, shift, own
    if kind == "turning":
        moved = np.eye(n)
        turns = ([[0, -1], [1, 0]], [[0.75, -0.625], [0.625, 0.75]])
        for k in range(0, n - 1, 2):
            moved[k : k + 2, k : k + 2] = turns[rng.integers(2)]
        return kind, moved, push
    upper = np.triu(integers(rng, n, n, 1), 1)
    if kind == "contracting":
        return kind, upper / 2 + np.diag(rng.choice([0.5, 0.25, 0.75, 0.0], n)), push
    if kind == "nilpotent":
        return kind, upper, push
    if kind == "unstable":
        return kind, upper / 2 + np.diag(rng.choice([1.0, 1.25, 1.5, 2.0], n)), push
    return kind, integers(rng, n, n) / 4, push


def blocks(rng, n):
    """How components are shared among variables: their sizes."""
    if n == 1 or rng.random() < 0.6:
        return [n]
    first = int(rng.integers(1, n))
    rest = n - first
    return [first, rest] if rest == 1 or rng.random() < 0.6 else [first, 1, rest - 1]


def named(name, size):
    return pgm.Variable(name, tuple(f"{name}{k}" for k in range(size)))


def unit(rng, size, mixed):
    return 2.0 ** rng.integers(-20, 21, size) if mixed else np.ones(size)


def scaled(matrix, rows, columns):
    return rows[:, None] * matrix / columns


def states(rng, traits):
    """Prior and motion of one to four components in one to three variables."""
    n = int(rng.integers(1, 5))
    kind, moved, push = motion(rng, n)
    mixed = rng.random() < 0.5
    traits |= {kind, f"n{n}"} | ({"units"} if mixed else set())
    sizes = blocks(rng, n)
    units = unit(rng, n, mixed)
    edges = np.cumsum([0, *sizes])
    names = [named("abc"[k], size) for k, size in enumerate(sizes)]
    place = {v: slice(edges[k], edges[k + 1]) for k, v in enumerate(names)}
    if len(names) > 1:
        traits.add("split")
    prior, transition = [], []
    wide = 2.0 ** rng.choice([0, 0, 0, 3, 10, 20])
    if wide > 8:
        traits.add("wide")
    within = len(names) > 1 and rng.random() < 0.5
    for k, v in enumerate(names):
        own = units[place[v]]
        d = v.dimension
        start = root(rng, d, int(rng.integers(0, d + 1)) if rng.random() < 0.5 else d) * wide
        if np.linalg.matrix_rank(start) < d:
            traits.add("singular prior")
        given = {}
        if k and within and rng.random() < 0.5:
            given[names[0]] = scaled(integers(rng, d, sizes[0], 1), own, units[place[names[0]]])
        mean = own * rng.integers(-3, 4, d)
        prior.append(Node(v, given, mean, own[:, None] * start))
        given = {p.previous: scaled(moved[place[v], place[p]], own, units[place[p]]) for p in names}
        if k and within:
            given[names[0]] = scaled(integers(rng, d, sizes[0], 1), own, units[place[names[0]]])
        noise = push[place[v]]
        if noise.shape[1] == 0 or np.linalg.matrix_rank(noise) < d:
            traits.add("singular motion")
        offset = own * (rng.integers(-1, 2, d) if rng.random() < 0.3 else np.zeros(d))
        transition.append(Node(v, given, offset, own[:, None] * noise))
    return names, dict(zip(names, (units[place[v]] for v in names), strict=True)), prior, transition


def control(rng, names, units, transition, traits):
    """An input of the motion, or a hidden control made of one, or of its CPD alone."""
    which = rng.choice(["none", "input", "hidden", "free"], p=[0.65, 0.15, 0.12, 0.08])
    if which == "none":
        return None, None
    traits.add(f"control {which}")
    u, command = pgm.Variable("u"), pgm.Variable("command")
    for node in transition:
        if node.child in names:
            d = node.child.dimension
            node.given[u] = units[node.child][:, None] * integers(rng, d, 1, 1)
    spread = np.array([[2.0 ** -rng.choice([0, 2, 6])]]) * (rng.random() < 0.8)
    if which == "input":
        return u, None
    if which == "hidden":
        transition.append(Node(u, {command: np.eye(1)}, np.zeros(1), spread))
        return command, u
    transition.append(Node(u, {}, np.ones(1), spread))
    return None, u


def sensors(rng, names, units, hidden, traits):
    """One to three, each of one to three components."""
    out = []
    for k in range(rng.choice([1, 2, 3], p=[0.6, 0.3, 0.1])):
        d = int(rng.choice([1, 2, 3], p=[0.65, 0.25, 0.1]))
        z = named("xyz"[k] + "s", d)
        mixed = "units" in traits and rng.random() < 0.5
        own = unit(rng, d, mixed)
        some = names if rng.random() < 0.7 else [names[rng.integers(len(names))]]
        given = {
            v: scaled(integers(rng, d, v.dimension) / rng.choice([1, 2]), own, units[v])
            for v in some
        }
        if hidden is not None and rng.random() < 0.4:
            given[hidden] = scaled(integers(rng, d, 1, 1), own, np.ones(1))
        kind = rng.choice(["regular", "singular", "exact"], p=[0.5, 0.15, 0.35])
        rank = {"regular": d, "singular": int(rng.integers(0, d)), "exact": 0}[kind]
        if rank < d:
            traits.add("exact sensor")
        sharp = int(rng.choice([0, 0, 1, 3, 6, 10, 20, 30]))
        if rank and sharp >= 20:
            traits.add("sharp")
        elif rank and sharp >= 6:
            traits.add("rather sharp")
        spread = own[:, None] * root(rng, d, rank) * 2.0**-sharp
        out.append(Node(z, given, own * (rng.integers(0, 2, d) if d > 1 else 0.0), spread))
    if rng.random() < 0.15:
        old = out[0]
        traits.add("repeated sensor")
        factor = rng.choice([1.0, -2.0, 0.5])
        given = {v: factor * m for v, m in old.given.items()}
        twin = named("w", old.child.dimension)
        out.append(Node(twin, given, np.zeros(twin.dimension), factor * old.root))
    return out


def value(rng, node, known):
    """A child drawn, exactly: the noise has two bits behind the point."""
    total = precise(node.offset)
    for parent, matrix in node.given.items():
        total = total + precise(matrix) @ known[parent]
    noise = np.clip(np.round(rng.normal(size=node.root.shape[1]) * 4) / 4, -3, 3)
    return total + precise(node.root) @ precise(noise) if noise.size else total


def ordered(nodes, model_cpds):
    by_child = {node.child: node for node in nodes}
    return [by_child[cpd.child] for cpd in model_cpds]


def draw(seed, longest=60):
    """A network, and readings of one run or some."""
    rng = np.random.default_rng([seed, 13])
    traits = set()
    names, units, prior, transition = states(rng, traits)
    known, hidden = control(rng, names, units, transition, traits)
    seen = sensors(rng, names, units, hidden, traits)
    model = pgm.DynamicBayesianNetwork(
        prior=[node.cpd for node in prior],
        transition=[node.cpd for node in transition],
        observation=[node.cpd for node in seen],
    )
    length = rng.choice(["short", "middle", "long"], p=[0.7, 0.2, 0.1])
    low, high = {"short": (1, 8), "middle": (8, 20), "long": (20, 60)}[length]
    steps = min(int(rng.integers(low, high + 1)), longest)
    lead = () if rng.random() < 0.8 or steps > 12 else (int(rng.integers(2, 4)),)
    traits |= {"long"} if steps > 20 else set()
    traits |= {"runs"} if lead else set()
    evidence, runs = {}, [({}, []) for _ in range(lead[0] if lead else 1)]
    if known is not None:
        given = rng.integers(-2, 3, (*lead, steps, 1)) / 2.0
        evidence[known] = given
        for (inputs, _), rows in zip(runs, given.reshape(len(runs), steps, 1), strict=True):
            inputs[known] = rows
    # When each sensor reads, and what is missing in which run.
    times = {}
    for node in seen:
        if rng.random() < 0.6:
            times[node.child] = np.arange(1, steps + 1), False
        else:
            count = int(rng.integers(1, 2 * steps + 2))
            times[node.child] = np.sort(rng.integers(0, steps + 1, count)), True
    values = {
        node.child: np.zeros((len(runs), times[node.child][0].size, node.child.dimension))
        for node in seen
    }
    missing = 0.0 if rng.random() < 0.5 else 0.3
    prior, transition = ordered(prior, model.prior), ordered(transition, model.transition)
    for run, (inputs, readings) in enumerate(runs):
        truth = {}
        for step in range(steps + 1):
            truth = {v.previous: x for v, x in truth.items() if not v.lag}
            if step:
                truth |= {v: precise(rows[step - 1]) for v, rows in inputs.items()}
            for node in transition if step else prior:
                truth[node.child] = value(rng, node, truth)
            if not step and hidden is not None:
                truth[hidden] = zeros(1)
            for node in seen:
                when, _ = times[node.child]
                for k in np.flatnonzero(when == step):
                    if not step and hidden in node.given:
                        values[node.child][run, k] = np.nan  # there is no control at step 0
                        continue
                    if rng.random() < missing:
                        values[node.child][run, k] = np.nan
                        continue
                    number = floats(value(rng, node, truth))
                    values[node.child][run, k] = number
                    readings.append((node.child, step, number, {}))
    for node in seen:
        when, sighted = times[node.child]
        if not step and hidden in node.given:
            continue
        numbers = values[node.child].reshape(*lead, when.size, -1)
        if sighted and hidden in node.given:
            numbers, when = numbers[..., when > 0, :], when[when > 0]
        if when.size:
            evidence[node.child] = pgm.sightings(numbers, step=when) if sighted else numbers
    units = dict(units)
    if hidden is not None:
        units[hidden] = np.ones(1)
    return Case(seed, model, steps, evidence, runs, lead, units, traits)
