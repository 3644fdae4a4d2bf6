"""Drawn linear networks over time, and a judge of what the engine says of them.

    PYTHONPATH=.:tests/inference python tests/inference/drawn_chains.py 0 200

All parameters are small integers times powers of two, hence exact in float64, so that what is
singular is exactly so.
"""

import argparse
import time
import warnings
from collections import Counter, defaultdict
from dataclasses import dataclass, field

import numpy as np
from precise import EPS, Reference, floats, precise, zeros

import pgm

MEAN, COV, DETERMINED, EVIDENCE = 1e-6, 1e-6, 1e-9, (1e-6, 1e-9)
# A variance that should be none may be rounding of its scale: the deviation, as a part of the
# largest that the step ever had.
DEVIATION = 3e-8
# And one that should be less than this part of it: there digits are not counted.
TOLD = 1e-9
RANKS = ("right", "floor", "cried", "told", "refused", "miss", "foreign")


# ---- models


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


# ---- the judge


@dataclass(frozen=True)
class Verdict:
    """Of one kind of answer: a category, how wrong as a multiple of the tolerance, and words."""

    kind: str
    category: str
    size: float = 0.0
    words: str = ""


class Judge:
    """The reference of a case, and verdicts about the engine's answers."""

    def __init__(self, case):
        self.case = case
        self.references = [Reference(case.model, case.steps, *run) for run in case.runs]
        first = self.references[0]
        self.places, size = first.places, first.size
        unit = np.ones(size)
        for v, each in case.units.items():
            unit[first.places[v]] = each
        self.due = {
            which: (
                self._stack(lambda r, which=which: [m for m, _ in getattr(r, which)]),
                self._stack(lambda r, which=which: [c for _, c in getattr(r, which)]),
            )
            for which in ("predicted", "filtered", "smoothed")
        }
        means = np.abs(np.stack([mean for mean, _ in self.due.values()])) / unit
        largest = means.max(axis=(0, 3))[..., None]
        self.size = unit * np.maximum(largest, 1.0)  # of the numbers of a step
        scale = self._stack(lambda r: [np.diagonal(row.cov) for row in r.rows])
        top = np.sqrt(scale.max(axis=1, keepdims=True)) / unit
        self.spread = unit * np.maximum(top.max(axis=-1, keepdims=True), 1.0)
        self.spread = np.broadcast_to(self.spread, self.size.shape)
        self.log_evidence = self._stack(lambda r: r.log_evidence)
        self.evidence_floor = self._stack(lambda r: r.evidence_floor)

    @property
    def disagreement(self):
        return max(r.disagreement for r in self.references)

    @property
    def determined(self):
        return sum(r.determined for r in self.references)

    def _stack(self, part):
        return np.stack([floats(part(r)) for r in self.references])

    def _means(self, found, due, var, size):
        """Errors as multiples of the tolerance: (strict, with the floor of rounding)."""
        if not np.isfinite(found).all():
            return np.inf, np.inf
        std = np.sqrt(var)
        error = np.abs(found - due)
        strict = np.where(std > 0, MEAN * std, DETERMINED * size)
        loose = np.maximum(strict, EPS * size + MEAN * std)
        with np.errstate(over="ignore"):
            return (error / strict).max(initial=0.0), (error / loose).max(initial=0.0)

    def _covs(self, found, due, spread):
        """The same of covariances, in units of the deviations of the two."""
        if not np.isfinite(found).all():
            return np.inf, np.inf
        variances = np.diagonal(found, axis1=-2, axis2=-1)
        if (variances < 0).any():
            return np.inf, np.inf
        std = np.sqrt(np.diagonal(due, axis1=-2, axis2=-1))
        edge = np.maximum(np.sqrt(2 * COV) * std, TOLD * spread)
        edge = np.where(std > 0, edge, DEVIATION * spread)
        limit = edge[..., None, :] * edge[..., None]
        size = (np.abs(found - due) / limit).max(initial=0.0)
        return size, size

    def beliefs(self, which, marginals):
        """Worst errors of means and of covariances, over all variables and steps."""
        worst = np.zeros((2, 2))
        mean, cov = self.due[which]
        for v, places in self.places.items():
            first = 0 if v in self.case.model.states else 1
            got = marginals[v]
            shape = (len(self.references), self.case.steps + 1 - first, len(places))
            found = got.mean.reshape(shape), got.cov.reshape(*shape, len(places))
            rows = np.ix_(range(len(self.references)), range(first, self.case.steps + 1), places)
            block = cov[:, first:][:, :, places][..., places]
            var = np.diagonal(block, axis1=-2, axis2=-1)
            worst = np.maximum(
                worst,
                [
                    self._means(found[0], mean[rows], var, self.size[rows]),
                    self._covs(found[1], block, self.spread[rows]),
                ],
            )
        return worst

    def joint(self, posterior, scope):
        got = posterior.joint(*scope)
        due = [r.joint(*scope) for r in self.references]
        mean, cov = np.stack([d[0] for d in due]), np.stack([d[1] for d in due])
        runs = len(due)
        found = got.mean.reshape(runs, -1), got.cov.reshape(runs, *cov.shape[1:])
        size, spread = (
            np.concatenate([a[:, v.step][:, self.places[v.template]] for v in scope], axis=-1)
            for a in (self.size, self.spread)
        )
        var = np.diagonal(cov, axis1=-2, axis2=-1)
        return np.array([self._means(found[0], mean, var, size), self._covs(found[1], cov, spread)])

    def evidence(self, found):
        found = np.asarray(found).reshape(-1)
        if not np.isfinite(found).all():
            return np.inf, np.inf
        error = np.abs(found - self.log_evidence)
        strict = EVIDENCE[0] + EVIDENCE[1] * np.abs(self.log_evidence)
        return (error / strict).max(), (error / (strict + self.evidence_floor)).max()

    def verdicts(self):
        case, out = self.case, []
        rng = np.random.default_rng([case.seed, 7])
        with Watch("filter", out) as watch:
            posterior = pgm.filter(case.model, case.evidence, steps=case.steps)
            watch.tell(posterior.status)
            ahead = self.beliefs("predicted", posterior.predicted)
            watch.beliefs(np.maximum(ahead, self.beliefs("filtered", posterior)))
            watch.found("evidence", self.evidence(posterior.log_evidence))
        scopes = self._scopes(rng)

        def smoothed(kind, solve):
            with Watch(kind, out) as watch:
                posterior = solve()
                watch.tell(posterior.status)
                watch.beliefs(self.beliefs("smoothed", posterior))
                watch.found("evidence", self.evidence(posterior.log_evidence))
                shared = watch.warned
                with Watch(f"{kind} joint", out) as inner:
                    inner.warned = shared
                    parts = [self.joint(posterior, scope) for scope in scopes]
                    inner.beliefs(np.max(parts, axis=0))

        smoothed("smooth", lambda: pgm.smooth(case.model, case.evidence, steps=case.steps))
        tree = pgm.compile(case.model, steps=case.steps, method=pgm.Balanced())
        smoothed("balanced", lambda: pgm.infer(tree, case.evidence, schedule=pgm.Smoothing()))
        if case.steps <= 12:
            with Watch("online", out) as watch:
                watch.beliefs(self._online(watch))
        return out

    def _scopes(self, rng):
        """Neighbours and far pairs of whole slices."""
        steps, model = self.case.steps, self.case.model
        pairs = [(k, k + 1) for k in rng.permutation(steps)[:2]]
        pairs += [tuple(rng.permutation(steps + 1)[:2]) for _ in range(2)]
        return [
            [v.at(int(k)) for k in pair for v in self.places if k or v in model.states]
            for pair in pairs
        ]

    def _online(self, watch):
        """Step by step, readings of a step in one call; of the first run alone."""
        case, reference = self.case, self.references[0]
        inputs, readings = case.runs[0]
        robot = pgm.OnlineFilter(case.model)
        belief = robot.initial()
        worst = np.zeros((2, 2))
        order = [cpd.child for cpd in case.model.observation]
        for step in range(case.steps + 1):
            if step:
                belief = robot.predict(belief, {v: rows[step - 1] for v, rows in inputs.items()})
            now = [r for r in readings if r[1] == step]
            rows = {
                z: pgm.sightings([r[2] for r in now if r[0] == z])
                for z in order
                if any(r[0] == z for r in now)
            }
            if rows:
                belief = robot.update(belief, rows)
            watch.tell(belief.status)
            for v, places in self.places.items():
                if not step and v not in case.model.states:
                    continue
                got = belief[v]
                mean, cov = self.due["filtered"]
                block = cov[0, step][np.ix_(places, places)]
                worst = np.maximum(
                    worst,
                    [
                        self._means(
                            got.mean,
                            mean[0, step][places],
                            np.diagonal(block),
                            self.size[0, step][places],
                        ),
                        self._covs(got.cov, block, self.spread[0, step][places]),
                    ],
                )
        error = abs(float(belief.log_evidence) - float(reference.log_evidence))
        strict = EVIDENCE[0] + EVIDENCE[1] * abs(float(reference.log_evidence))
        watch.found("evidence", (error / strict, error / (strict + reference.evidence_floor)))
        return worst


class Watch:
    """Runs one kind of question; says what came of it."""

    def __init__(self, kind, out):
        self.kind, self.out, self.warned, self.results = kind, out, False, []

    def __enter__(self):
        self.catcher = warnings.catch_warnings(record=True)
        self.caught = self.catcher.__enter__()
        warnings.simplefilter("always")
        return self

    def tell(self, status):
        if status.digits is not None and (status.digits < 6).any():
            self.warned = True

    def found(self, what, errors):
        self.results.append((what, errors))

    def beliefs(self, worst):
        self.found("mean", worst[0])
        self.found("cov", worst[1])

    def __exit__(self, kind, error, trace):
        self.catcher.__exit__(None, None, None)
        alien = [w for w in self.caught if not issubclass(w.category, pgm.PrecisionWarning)]
        self.warned |= len(alien) < len(self.caught)
        if error is not None:
            if not issubclass(kind, Exception):
                return False
            category = "refused" if issubclass(kind, pgm.PgmError) else "foreign"
            self._say(self.kind, category, np.inf, f"{kind.__name__}: {error}")
            return True
        if alien:
            words = f"{alien[0].category.__name__}: {alien[0].message}"
            self._say(f"{self.kind} warning", "foreign", np.inf, words)
        for what, (strict, loose) in self.results:
            category = "right"
            if loose > 1:
                category = "told" if self.warned else "miss"
            elif self.warned:
                category = "cried"
            elif strict > 1:
                category = "floor"
            self._say(f"{self.kind} {what}", category, loose if loose > 1 else strict)
        return True

    def _say(self, kind, category, size, words=""):
        self.out.append(Verdict(kind, category, float(size), words))


def judge(case):
    """All verdicts about a case, and the judge, who knows the reference."""
    found = Judge(case)
    return found.verdicts(), found


# ---- the programme


def table(verdicts, worst):
    kinds = list(dict.fromkeys(v.kind for _, v in verdicts))
    count = Counter((v.kind, v.category) for _, v in verdicts)
    lines = [f"{'':24}" + "".join(f"{c:>9}" for c in RANKS)]
    lines += [f"{k:24}" + "".join(f"{count[k, c] or '·':>9}" for c in RANKS) for k in kinds]
    for category in ("miss", "foreign", "refused", "told"):
        by_kind = defaultdict(list)
        for case, v in verdicts:
            if v.category == category:
                by_kind[v.kind].append((v.size, case.seed, v.words))
        for k, found in by_kind.items():
            found.sort(reverse=True, key=lambda f: f[:2])
            shown = ", ".join(
                f"{seed}" + (f" ({size:.1e})" if np.isfinite(size) else "")
                for size, seed, _ in found[:worst]
            )
            lines.append(f"{category} {k}: {shown}")
            lines += [
                f"      {n} × {w[:150]}"
                for w, n in Counter(f[2] for f in found if f[2]).most_common(2)
            ]
    return "\n".join(lines)


def structure(verdicts):
    """How often cases of a trait are missed, kind by kind."""
    missed = defaultdict(set)
    cases = {case.seed: case for case, _ in verdicts}
    for case, v in verdicts:
        if v.category in ("miss", "foreign"):
            missed[v.kind.split()[0]].add(case.seed)
    kinds = sorted(missed)
    traits = sorted({t for case in cases.values() for t in case.traits})
    lines = [f"{'':24}{'cases':>9}" + "".join(f"{k:>9}" for k in kinds)]
    for trait in traits:
        have = {s for s, case in cases.items() if trait in case.traits}
        lines.append(
            f"{trait:24}{len(have):>9}" + "".join(f"{len(missed[k] & have):>9}" for k in kinds)
        )
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--worst", type=int, default=8, help="seeds named of each kind")
    parser.add_argument("--verbose", action="store_true", help="every verdict of every case")
    arguments = parser.parse_args()
    begun, verdicts, skipped, rounded = time.perf_counter(), [], [], 0
    spent = 0.0
    for seed in range(arguments.first, arguments.last):
        case = draw(seed)
        started = time.perf_counter()
        judged = Judge(case)
        spent += time.perf_counter() - started
        rounded += judged.disagreement > 0
        if judged.disagreement > 1e-12:
            skipped.append(seed)
            continue
        found = judged.verdicts()
        verdicts += [(case, v) for v in found]
        if arguments.verbose:
            print(seed, case.steps, case.lead, sorted(case.traits))
            for v in found:
                print(f"    {v.kind:24}{v.category:9}{v.size:.2e} {v.words}")
    print(table(verdicts, arguments.worst))
    print(structure(verdicts))
    took = time.perf_counter() - begun
    cases = arguments.last - arguments.first
    print(
        f"{cases} cases in {took:.0f} s ({spent:.0f} s the reference); determined readings "
        f"rounded in {rounded}; {len(skipped)} contradict themselves by rounding, left out: "
        f"{skipped[:10]}"
    )


if __name__ == "__main__":
    main()
