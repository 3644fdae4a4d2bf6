"""Problems drawn at random whose exact posteriors are found by quadrature.

A *group* is one model with evidence of several runs, each of them a problem. Static networks are
made of *blocks*, which are independent: one to three hidden components of which a nonlinear
function is read, with *tails*, variables that are linear in them and are read too. Chains have one
component. All quadratures are sums over even grids of numpy's, and know nothing of pgm's.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

import pgm

Array = Any
# Points of a grid along each axis, by the number of axes; of a chain's.
POINTS = {1: 4001, 2: 361, 3: 61}
CHAIN_POINTS = 1601
# Maxima of a grid's density are one mode if the way between them is no more nats below the lower.
PERSISTENT = 0.1
# The mass from which on a mode counts, and that which a truth may be less of.
COUNTED = 1e-4
ALLOWED = 0.01


class Belief(NamedTuple):
    """A variable's exact marginal on a grid: points (N, d), their mass (N,), a cell's volume."""

    points: Array
    mass: Array
    cell: float

    @property
    def moments(self) -> tuple[Array, Array]:
        mean = self.mass @ self.points
        off = self.points - mean
        return mean, off.T @ (off * self.mass[:, None])

    def divergence(self, of: str, weights: Array, mean: Array, cov: Array) -> float:
        """KL of the marginal, or of its moments, from a mixture of Gaussians (K,), (K, d)."""
        if of == "moments":
            centre = weights @ mean
            off = mean - centre
            spread = np.einsum("k,kij->ij", weights, cov + off[:, :, None] * off[:, None, :])
            own, about = self.moments[::-1]
            ratio = np.linalg.solve(spread, own)
            far = (centre - about) @ np.linalg.solve(spread, centre - about)
            return float(far + np.trace(ratio) - len(about) - np.linalg.slogdet(ratio)[1]) / 2
        some = self.mass > 1e-14
        logs = np.full(some.sum(), -np.inf)
        for weight, centre, spread in zip(weights, mean, cov, strict=True):
            if weight > 0.0:
                logs = np.logaddexp(
                    logs, np.log(weight) + normal(self.points[some], centre, spread)
                )
        mass = self.mass[some]
        return float(mass @ (np.log(mass / self.cell) - logs))


def normal(points: Array, mean: Array, cov: Array) -> Array:
    """The log-density of a Gaussian at points (N, d)."""
    off = points - mean
    squared = np.einsum("ni,ni->n", off, np.linalg.solve(cov, off.T).T)
    level = np.linalg.slogdet(cov)[1] + len(cov) * np.log(2.0 * np.pi)
    return -0.5 * (squared + level)


class Tail(NamedTuple):
    """A variable that is linear in a block's components, and its reading."""

    variable: pgm.Variable
    row: Array
    std: float
    reading: pgm.Variable
    noise: float


class Truth(Protocol):
    """The exact posterior of a run.

    resolved: Whether the grid resolves it.
    count: How many modes have mass that counts; of a chain, at the step that has most.
    modes: The mass of each that can be dropped; of a chain, of those of all steps.
    """

    resolved: bool
    count: int
    modes: Array

    def less(self, dropped: tuple[int, ...]) -> dict[pgm.Variable, Belief]:
        """The marginals, without the modes of some numbers."""
        ...


@dataclass
class Block:
    """Hidden variables of independent components, a nonlinear function of which is read.

    hidden: The variables. mean, std: Of all their components. function: Of points (N, D).
    """

    hidden: list[pgm.Variable]
    mean: Array
    std: Array
    reading: pgm.Variable
    function: Callable[[Array], Array]
    noise: float
    tails: list[Tail]

    @property
    def size(self) -> int:
        return len(self.mean) + len(self.tails)

    @property
    def readings(self) -> list[pgm.Variable]:
        return [self.reading, *(tail.reading for tail in self.tails)]

    def places(self) -> Iterator[tuple[pgm.Variable, slice]]:
        start = 0
        for variable in self.hidden:
            yield variable, slice(start, start + variable.dimension)
            start += variable.dimension

    def cpds(self) -> list[Any]:
        def whole(*parents: Array) -> Array:
            lead = np.broadcast_shapes(*(each.shape[:-1] for each in parents))
            wide = [np.broadcast_to(each, (*lead, each.shape[-1])) for each in parents]
            return self.function(np.concatenate(wide, axis=-1))

        if len(self.hidden) == 1:
            whole = self.function
        size = self.reading.dimension
        found: list[Any] = [
            pgm.GaussianCPD(variable, self.mean[place], np.diag(self.std[place] ** 2))
            for variable, place in self.places()
        ]
        noise = self.noise**2 * np.eye(size)
        found.append(pgm.NonlinearGaussianCPD(self.reading, tuple(self.hidden), whole, cov=noise))
        for tail in self.tails:
            given = {v: tail.row[None, place] for v, place in self.places()}
            found.append(pgm.LinearGaussianCPD(tail.variable, given, cov=tail.std**2))
            seen = pgm.LinearGaussianCPD(tail.reading, {tail.variable: 1.0}, cov=tail.noise**2)
            found.append(seen)
        return found

    def log_density(self, points: Array, seen: dict[pgm.Variable, Array]) -> Array:
        """ln p(x, z) but for a constant, without the tails' own variables."""
        white = (points - self.mean) / self.std
        off = seen[self.reading] - self.function(points)
        mask = self.reading.angle_mask
        off = np.where(mask, np.arctan2(np.sin(off), np.cos(off)), off) / self.noise
        total = -0.5 * ((white**2).sum(-1) + (off**2).sum(-1))
        for tail in self.tails:
            off = seen[tail.reading] - points @ tail.row
            total -= 0.5 * off**2 / (tail.std**2 + tail.noise**2)
        return total

    def truth(self, seen: dict[pgm.Variable, Array]) -> BlockTruth:
        """The exact posterior of a run by its readings."""
        size = len(self.mean)
        low, high = self.mean - 7.0 * self.std, self.mean + 7.0 * self.std
        for _ in range(8):
            axes, logs = self._grid(low, high, POINTS[size] // 2, seen)
            some = np.nonzero(logs > -30.0)
            cell = np.array([axis[1] - axis[0] for axis in axes])
            ends = [
                (axis[own.min()], axis[own.max()]) for axis, own in zip(axes, some, strict=True)
            ]
            new = np.transpose(ends) + np.outer([-1.0, 1.0], cell)
            settled = (new[1] - new[0] > 0.85 * (high - low)).all()
            low, high = np.maximum(new[0], low), np.minimum(new[1], high)
            if settled:
                break
        axes, logs = self._grid(low, high, POINTS[size], seen)
        return BlockTruth(self, seen, axes, logs)

    def _grid(
        self, low: Array, high: Array, count: int, seen: dict[pgm.Variable, Array]
    ) -> tuple[list[Array], Array]:
        """The axes of a grid, and the log-density on it, 0 at the highest."""
        axes = [np.linspace(*ends, count) for ends in zip(low, high, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
        logs = self.log_density(points, seen)
        return axes, logs - logs.max()


class BlockTruth:
    """The exact posterior of a block on a grid."""

    def __init__(self, block: Block, seen: dict[pgm.Variable, Array], axes: Any, logs: Array):
        self._block, self._seen, self._axes = block, seen, axes
        mass = np.exp(logs)
        size = logs.ndim
        half = mass[(slice(None, None, 2),) * size].sum() * 2**size / mass.sum()
        self.resolved = abs(np.log(half)) < 0.01
        self._mass = mass / mass.sum()
        self._labels = basins(logs)
        self.modes = np.bincount(self._labels.ravel(), self._mass.ravel())
        self.count = int((self.modes > COUNTED).sum())

    def less(self, dropped: tuple[int, ...]) -> dict[pgm.Variable, Belief]:
        mass = np.where(np.isin(self._labels, dropped), 0.0, self._mass)
        mass = mass / mass.sum()
        found = {}
        for variable, place in self._block.places():
            kept = range(mass.ndim)[place]
            axes = [self._axes[k] for k in kept]
            own = mass.sum(axis=tuple(k for k in range(mass.ndim) if k not in kept))
            points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes))
            cell = float(np.prod([axis[1] - axis[0] for axis in axes]))
            found[variable] = Belief(points, own.ravel(), cell)
        some = mass > 1e-8 * mass.max()
        points = np.stack(np.meshgrid(*self._axes, indexing="ij"), -1)[some]
        for tail in self._block.tails:
            gain = tail.std**2 / (tail.std**2 + tail.noise**2)
            mean = points @ tail.row
            mean = mean + gain * (self._seen[tail.reading] - mean)
            std = np.sqrt(gain) * tail.noise
            grid = np.linspace(mean.min() - 7.0 * std, mean.max() + 7.0 * std, 1001)
            step = grid[1] - grid[0]
            share, edges = np.histogram(mean, 1000, weights=mass[some])
            centre = (edges[1:] + edges[:-1]) / 2
            centre, share = centre[share > 0.0], share[share > 0.0]
            own = np.exp(-0.5 * ((grid[:, None] - centre) / std) ** 2) @ share
            found[tail.variable] = Belief(grid[:, None], own / own.sum(), step)
        return found


def basins(logs: Array) -> Array:
    """By cell the number of the mode to which steepest ascent leads."""
    size, shape = logs.ndim, logs.shape
    padded = np.pad(logs, 1, constant_values=-np.inf)
    number = np.pad(np.arange(logs.size).reshape(shape), 1)
    best, top = logs.copy(), np.arange(logs.size).reshape(shape)
    middle = tuple(slice(1, -1) for _ in range(size))
    assert number[middle].shape == shape
    for offset in itertools.product((-1, 0, 1), repeat=size):
        at = tuple(slice(1 + o, 1 + o + n) for o, n in zip(offset, shape, strict=True))
        higher = padded[at] > best
        best, top = np.where(higher, padded[at], best), np.where(higher, number[at], top)
    flat = top.ravel()
    while True:
        new = flat[flat]
        if (new == flat).all():
            break
        flat = new
    height = logs.ravel()
    owner = {int(k): int(k) for k in np.unique(flat)}

    def find(k: int) -> int:
        while owner[k] != k:
            k = owner[k]
        return k

    labels = flat.reshape(shape)
    pairs = []
    for axis in range(size):
        one, two = np.moveaxis(labels, axis, 0)[:-1], np.moveaxis(labels, axis, 0)[1:]
        pass_ = np.minimum(np.moveaxis(logs, axis, 0)[:-1], np.moveaxis(logs, axis, 0)[1:])
        here = (one != two) & (pass_ > -14.0)
        pairs.append(np.stack([one[here], two[here], pass_[here]], -1))
    passes = np.concatenate(pairs)
    for one, two, saddle in passes[np.argsort(-passes[:, 2])]:
        first, second = find(int(one)), find(int(two))
        if height[first] < height[second]:
            first, second = second, first
        if first != second and height[second] - saddle < PERSISTENT:
            owner[second] = first
    roots = np.array([find(int(k)) for k in np.unique(flat)])
    names, index = np.unique(roots, return_inverse=True)
    assert len(names)
    return index[np.searchsorted(np.unique(flat), labels)]


@dataclass
class Group:
    """A model, its evidence, and the exact posterior of each run."""

    kind: str
    size: int
    model: Any
    evidence: dict[pgm.Variable, Array]
    runs: int
    truths: Callable[[int], list[Truth]]
    steps: int | None = None


class Judged(NamedTuple):
    """What is true of an estimate of a run.

    off, less: How far its worst marginal is from the truth, and from the truth less 1 % [nats].
    modes: How many modes the truth has.
    resolved: Whether the grid resolves the truth.
    """

    off: float
    less: float
    modes: int
    resolved: bool


def judged(group: Group, found: Any, run: int) -> Judged:
    """How far an estimate of a run is from its truth."""
    of = str(found.verdict.of[run]) or "moments"
    truths = group.truths(run)
    resolved = all(truth.resolved for truth in truths)
    modes = int(np.prod([truth.count for truth in truths]))
    if not resolved or not found.verdict.vouched[run]:
        return Judged(np.nan, np.nan, modes, resolved)

    def worst(dropped: tuple[int, ...], truth: Truth) -> float:
        return max(
            belief.divergence(of, *_components(found, variable, run))
            for variable, belief in truth.less(dropped).items()
        )

    whole = [worst((), truth) for truth in truths]
    off = max(whole)
    if off <= 2.0 * found.verdict.within[run]:
        return Judged(off, off, modes, True)
    options = []
    for truth, own in zip(truths, whole, strict=True):
        choices = [(0.0, own)]
        order = np.argsort(truth.modes)
        for dropped in {*((int(k),) for k in order), *(tuple(order[: k + 1]) for k in range(9))}:
            mass = float(truth.modes[list(dropped)].sum())
            if 1e-9 < mass <= ALLOWED:
                choices.append((mass, worst(dropped, truth)))
        options.append(choices)
    less = min(
        max(each for _, each in choice)
        for choice in itertools.product(*options)
        if sum(mass for mass, _ in choice) <= ALLOWED
    )
    return Judged(off, less, modes, True)


def _components(found: Any, variable: pgm.Variable, run: int) -> tuple[Array, Array, Array]:
    belief = found[variable]
    own = getattr(belief, "components", None)
    if own is None:
        return np.ones(1), belief.mean[run][None], belief.cov[run][None]
    return belief.weights[run], own.mean[run], own.cov[run]


# Blocks ------------------------------------------------------------------------------------------


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


class Shape(NamedTuple):
    """A nonlinear function of components: the dimensions of variables, of a reading, its maker."""

    hidden: tuple[int, ...]
    reading: int
    make: Callable[[np.random.Generator], Callable[[Array], Array]]
    angle: bool = False


def _ranges(count: int, size: int) -> Callable[[np.random.Generator], Callable[[Array], Array]]:
    def make(rng: np.random.Generator) -> Callable[[Array], Array]:
        beacons = rng.normal(size=(count, size)) * _log(rng, 0.8, 5.0)
        return lambda x: np.sqrt(((x[..., None, :] - beacons) ** 2).sum(-1) + 1e-9)

    return make


def _bearings(rng: np.random.Generator) -> Callable[[Array], Array]:
    beacons = rng.normal(size=(2, 2)) * _log(rng, 2.0, 6.0)

    def function(x: Array) -> Array:
        off = x[..., None, :] - beacons
        return np.arctan2(off[..., 1], off[..., 0])

    return function


def _sine(rng: np.random.Generator) -> Callable[[Array], Array]:
    often = _log(rng, 0.5, 3.0)
    return lambda x: np.sin(often * x)


def _distance(rng: np.random.Generator) -> Callable[[Array], Array]:
    height, centre = _log(rng, 0.1, 1.0), rng.normal()
    return lambda x: np.sqrt(height**2 + (x - centre) ** 2)


def _square(rng: np.random.Generator) -> Callable[[Array], Array]:
    centre = rng.normal() * _log(rng, 0.1, 3.0)
    return lambda x: (x - centre) ** 2


def _quartic(rng: np.random.Generator) -> Callable[[Array], Array]:
    apart = _log(rng, 0.5, 2.0)
    return lambda x: (x**2 - apart) ** 2


def _same(function: Callable[[Array], Array]) -> Any:
    return lambda rng: function


def _polar(x: Array) -> Array:
    radius, turn = 4.0 + x[..., :1], 0.7 * x[..., 1:]
    return np.concatenate([radius * np.cos(turn), radius * np.sin(turn)], -1)


def _scaled(rng: np.random.Generator) -> Callable[[Array], Array]:
    ranging = _ranges(3, 2)(rng)
    return lambda x: (1.0 + 0.1 * x[..., :1]) * ranging(x[..., 1:])


SHAPES = {
    "square": Shape((1,), 1, _square),
    "cubic": Shape((1,), 1, _same(lambda x: x + 0.5 * x**3)),
    "exp": Shape((1,), 1, _same(lambda x: np.exp(0.7 * x))),
    "sine": Shape((1,), 1, _sine),
    "distance": Shape((1,), 1, _distance),
    "quartic": Shape((1,), 1, _quartic),
    "range": Shape((2,), 1, _ranges(1, 2)),
    "ranges": Shape((2,), 2, _ranges(2, 2)),
    "three ranges": Shape((2,), 3, _ranges(3, 2)),
    "bearings": Shape((2,), 2, _bearings, angle=True),
    "product": Shape((1, 1), 1, _same(lambda x: x[..., :1] * x[..., 1:])),
    "banana": Shape((1, 1), 1, _same(lambda x: x[..., :1] ** 2 + x[..., 1:])),
    "polar": Shape((1, 1), 2, _same(_polar)),
    "ranges in space": Shape((3,), 3, _ranges(3, 3)),
    "four ranges in space": Shape((3,), 4, _ranges(4, 3)),
    "scale and ranges": Shape((1, 2), 3, _scaled),
    "triple": Shape((1, 1, 1), 2, _same(lambda x: x[..., :2] * x[..., 2:])),
}
BY_SIZE = {n: [s for s, v in SHAPES.items() if sum(v.hidden) == n] for n in (1, 2, 3)}


def block(name: str, prefix: str, tails: int, rng: np.random.Generator) -> Block:
    """A block of a shape, of variables whose names have a prefix."""
    shape = SHAPES[name]
    hidden = []
    for k, size in enumerate(shape.hidden):
        own = tuple(f"{prefix}x{k}{c}" for c in range(size))
        hidden.append(pgm.Variable(f"{prefix}x{k}", components=own))
    size = sum(shape.hidden)
    names = tuple(f"{prefix}z{c}" for c in range(shape.reading))
    reading = pgm.Variable(f"{prefix}z", components=names, angles=names if shape.angle else ())
    unit = _log(rng, 0.01, 100.0)
    wide = np.array([_log(rng, 0.3, 2.0) for _ in range(size)])
    centre = rng.normal(size=size)
    pure = shape.make(rng)
    spread = pure(centre + wide * rng.normal(size=(400, size))).std(0).mean()
    noise = spread * _log(rng, 0.05, 1.0)
    scale = 1.0 if shape.angle else _log(rng, 0.1, 10.0)
    found = []
    for k in range(tails):
        row = rng.normal(size=size) / wide / np.sqrt(size)
        variable, seen = pgm.Variable(f"{prefix}l{k}"), pgm.Variable(f"{prefix}w{k}")
        found.append(Tail(variable, row / unit, _log(rng, 0.3, 1.0), seen, _log(rng, 0.3, 2.0)))
    return Block(
        hidden,
        unit * centre,
        unit * wide,
        reading,
        lambda x: scale * pure(x / unit),
        scale * noise,
        found,
    )


def static(size: int, runs: int, rng: np.random.Generator) -> Group:
    """A network without time, of so many hidden components."""
    blocks: list[Block] = []
    names = []
    left = size
    while left:
        own = int(rng.integers(1, min(left, 3 if size <= 3 else 2) + 1))
        if size <= 3 and rng.random() < 0.7:
            own = left
        name = str(rng.choice(BY_SIZE[own]))
        tails = int(rng.integers(0, left - own + 1)) if size > 1 else 0
        if len(blocks) == 2:
            tails = left - own
        blocks.append(block(name, "abcdef"[len(blocks)], tails, rng))
        names.append(name + f"+{tails}" * bool(tails))
        left -= blocks[-1].size
    model = pgm.BayesianNetwork([cpd for each in blocks for cpd in each.cpds()])
    drawn = model.sample(runs, rng=rng)
    evidence = {z: np.asarray(drawn[z]) for each in blocks for z in each.readings}

    def truths(run: int) -> list[Truth]:
        seen = {z: values[run] for z, values in evidence.items()}
        return [each.truth(seen) for each in blocks]

    return Group(" ".join(names), size, model, evidence, runs, truths)


# Chains ------------------------------------------------------------------------------------------

MOTIONS: dict[str, Callable[[Array], Array]] = {
    "walk": lambda x: x,
    "decay": lambda x: 0.8 * x,
    "growth": lambda x: 0.5 * x + 5.0 * x / (1.0 + x**2),
    "pendulum": lambda x: x + 0.3 * np.sin(x),
}
SENSORS: dict[str, Callable[[Array], Array]] = {
    "square": lambda x: 0.5 * x**2,
    "cube": lambda x: x**3 / 20.0,
    "sine": np.sin,
    "distance": lambda x: np.sqrt(0.1 + (x - 1.0) ** 2),
    "exp": lambda x: np.exp(0.5 * x),
    "bend": lambda x: x + 0.3 * x**2,
}


class ChainTruth:
    """The exact posterior of a chain on a grid: forward and backward sums."""

    resolved = True

    def __init__(self, state: pgm.Variable, grid: Array, first: Array, kernel: Array, read: Array):
        self._state, self._grid, self._first, self._kernel = state, grid, first, kernel
        self._read = np.concatenate([np.ones((1, grid.size)), read])
        beliefs = self._beliefs(self._read)
        with np.errstate(divide="ignore"):
            self._labels = [basins(np.log(own / own.max())) for own in beliefs]
        every = zip(self._labels, beliefs, strict=True)
        masses = [np.bincount(label, own) for label, own in every]
        # Of each step all modes but the largest, then the largest of step 0.
        self._named = [
            (t, k) for t, own in enumerate(masses) for k in range(len(own)) if k != own.argmax()
        ]
        small = [masses[t][k] for t, k in self._named]
        self.modes = np.array([1.0, *small])
        self.count = max(int((own > COUNTED).sum()) for own in masses)

    def _beliefs(self, read: Array) -> Array:
        forward = [self._first * read[0]]
        for own in read[1:]:
            moved = forward[-1] @ self._kernel * own
            forward.append(moved / moved.sum())
        backward = [np.ones(self._grid.size)]
        for own in read[:0:-1]:
            moved = self._kernel @ (own * backward[-1])
            backward.append(moved / moved.sum())
        both = np.array(forward) * np.array(backward[::-1])
        return both / both.sum(axis=1, keepdims=True)

    def less(self, dropped: tuple[int, ...]) -> dict[pgm.Variable, Belief]:
        read = self._read.copy()
        for k in dropped:
            if k:
                step, name = self._named[k - 1]
                read[step] = np.where(self._labels[step] == name, 0.0, read[step])
        cell = self._grid[1] - self._grid[0]
        return {
            self._state.at(t): Belief(self._grid[:, None], own, cell)
            for t, own in enumerate(self._beliefs(read))
        }


def chain(steps: int, runs: int, rng: np.random.Generator) -> Group:
    """A chain of one component, of so many steps."""
    state, reading = pgm.Variable("x"), pgm.Variable("z")
    unit = _log(rng, 0.01, 100.0)
    motion, sensor = str(rng.choice(list(MOTIONS))), str(rng.choice(list(SENSORS)))
    centre, wide = rng.normal(), _log(rng, 0.3, 2.0)
    drift, process, noise = MOTIONS[motion], _log(rng, 0.15, 1.0), _log(rng, 0.15, 1.5)
    read = SENSORS[sensor]
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(state, unit * centre, (unit * wide) ** 2)],
        transition=[
            pgm.NonlinearGaussianCPD(
                state, state.previous, lambda x: unit * drift(x / unit), cov=(unit * process) ** 2
            )
        ],
        observation=[
            pgm.NonlinearGaussianCPD(reading, state, lambda x: read(x / unit), cov=noise**2)
        ],
    )
    evidence = {reading: model.sample(steps=steps, runs=runs, rng=rng).evidence[reading]}
    grid = centre + wide * rng.normal(size=2000)
    low, high = grid.min(), grid.max()
    for _ in range(steps):
        grid = drift(grid) + process * rng.normal(size=2000)
        low, high = min(low, grid.min()), max(high, grid.max())
    margin = 0.35 * (high - low)
    grid = np.linspace(low - margin, high + margin, CHAIN_POINTS)
    first = np.exp(-0.5 * ((grid - centre) / wide) ** 2)
    kernel = np.exp(-0.5 * ((grid - drift(grid)[:, None]) / process) ** 2)

    def truths(run: int) -> list[Truth]:
        own = np.asarray(evidence[reading])[run]
        likelihood = np.exp(-0.5 * ((own - read(grid)) / noise) ** 2)
        return [ChainTruth(state, unit * grid, first, kernel, likelihood)]

    return Group(f"{motion}, {sensor}", steps + 1, model, evidence, runs, truths, steps)


def group(seed: int, number: int, runs: int) -> Group:
    """The group of a number: of every four, three are without time and one is a chain."""
    rng = np.random.default_rng([seed, number])
    round_, place = divmod(number, 4)
    if place == 3:
        return chain(2 + round_ % 5, runs, rng)
    return static(1 + (3 * round_ + place) % 6, runs, rng)
