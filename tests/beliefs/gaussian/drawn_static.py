"""Drawn linear networks without time, in every declaration, and a judge of what the engine says.

    PYTHONPATH=.:tests:tests/beliefs/moments python tests/beliefs/gaussian/drawn_static.py 0 200

All parameters are small integers times powers of two, hence exact in float64, so that what is
singular is exactly so. CPDs are declared nonlinear at will: every lineariser is exact for them.
"""

import argparse
import time
import warnings
from collections import Counter, defaultdict
from dataclasses import dataclass, field

import numpy as np
from drawn_chains import Node as Linear
from drawn_chains import integers, named, root, scaled, unit
from precise import EPS, NOTHING, eliminated, floats, mp, norms, precise, zeros

import pgm

MEAN, COV, DETERMINED, EVIDENCE = 1e-6, 1e-6, 1e-9, 1e-6
# A variance that should be none may be rounding of the prior's: the deviation, as a part of it.
DEVIATION = 3e-8
# Readings that contradict an exact model by rounding alone leave no answer to compare.
CONSISTENT = 1e-12
LINEARISERS = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "scaled": pgm.Unscented(alpha=0.5),
    "hermite": pgm.GaussHermite(3),
    "cubature": pgm.Cubature(),
    "sampled": pgm.MonteCarlo(samples=40, seed=3),
    "even": pgm.QuasiMonteCarlo(samples=32),
}
METHODS = [
    None,
    pgm.JunctionTree(order=lambda net: net.variables),
    pgm.JunctionTree(order=lambda net: net.variables[::-1]),
    lambda net: pgm.ClusterGraph(net, [set(net.variables)]),
]


@dataclass
class Node(Linear):
    """The same by a linear function, that is declared as any."""

    nonlinear: bool
    derivative: bool

    @property
    def cpd(self):
        if not self.given or not self.nonlinear:
            return super().cpd
        cov = self.root @ self.root.T
        matrices = list(self.given.values())

        def function(*parents):
            return self.offset + sum(p @ m.T for p, m in zip(parents, matrices, strict=True))

        def slope(matrix):
            return lambda *parents: np.broadcast_to(matrix, (*parents[0].shape[:-1], *matrix.shape))

        known = {v: slope(m) for v, m in self.given.items()} if self.derivative else None
        return pgm.NonlinearGaussianCPD(
            self.child, tuple(self.given), function, cov, jacobian=known
        )


@dataclass
class Case:
    seed: int
    nodes: list
    evidence: list  # of each run, {variable: value}; NaN is missing
    lead: tuple
    units: dict
    traits: set = field(default_factory=set)

    @property
    def network(self):
        return pgm.BayesianNetwork([node.cpd for node in self.nodes])

    @property
    def together(self):
        """The evidence of all runs in arrays."""
        if not self.lead:
            return self.evidence[0]
        return {v: np.stack([run[v] for run in self.evidence]) for v in self.evidence[0]}

    @property
    def hidden(self):
        return [node.child for node in self.nodes if node.child not in self.evidence[0]]


def draw(seed):
    rng = np.random.default_rng([seed, 29])
    traits = set()
    count = int(rng.integers(2, 8))
    scalars = rng.random() < 0.6
    mixed = rng.random() < 0.5
    tree = rng.random() < 0.4
    wide = 2.0 ** rng.choice([0, 0, 0, 3, 10, 20, 26])
    exact = rng.choice([0.0, 0.3, 0.6])
    declared = rng.choice([0.0, 0.5, 1.0], p=[0.2, 0.4, 0.4])
    traits |= {"units"} if mixed else set()
    traits |= {"tree"} if tree else {"graph"}
    traits |= {"wide"} if wide > 8 else set()
    traits |= {"exact relations"} if exact else set()
    traits |= {"nonlinear"} if declared else set()
    nodes, units, places = [], {}, []
    for k in range(count):
        d = 1 if scalars else int(rng.choice([1, 2, 3], p=[0.5, 0.35, 0.15]))
        v = named(f"v{k}_", d)
        own = unit(rng, d, mixed)
        most = min(k, 1 if tree else 3)
        parents = rng.choice(k, int(rng.integers(min(k, 1), most + 1)), replace=False) if k else []
        if k and rng.random() < 0.15:
            parents = []
        given = {}
        for j in parents:
            parent = places[j]
            matrix = integers(rng, d, parent.dimension) * 2.0 ** -rng.choice([0, 0, 1, 3])
            given[parent] = scaled(matrix, own, units[parent])
        rank = d if rng.random() >= exact else int(rng.integers(0, d))
        if not given:
            rank = d if rng.random() < 0.85 else rank
        sharp = int(rng.choice([0, 0, 0, 1, 3, 6, 10, 20, 30])) if given else 0
        traits |= {"sharp"} if sharp >= 20 and rank else set()
        spread = own[:, None] * root(rng, d, rank) * 2.0**-sharp * (1.0 if given else wide)
        offset = own * rng.integers(-2, 3, d) * (rng.random() < 0.5)
        if not given:
            offset = own * rng.integers(-3, 4, d)
        nonlinear = bool(given) and rng.random() < declared
        nodes.append(Node(v, given, offset, spread, nonlinear, rng.random() < 0.5))
        units[v] = own
        places.append(v)
    if rng.random() < 0.2 and nodes[-1].given:
        old = nodes[-1]
        traits.add("repeated")
        factor = rng.choice([1.0, -2.0, 0.5])
        twin = named("w", old.child.dimension)
        given = {v: factor * m for v, m in old.given.items()}
        units[twin] = units[old.child]
        nodes.append(Node(twin, given, factor * old.offset, factor * old.root, old.nonlinear, True))
    share = rng.choice([0.0, 0.3, 0.5, 0.7])
    leaves = {n.child for n in nodes} - {p for n in nodes for p in n.given}
    seen = [n.child for n in nodes if rng.random() < (share + 0.3 if n.child in leaves else share)]
    if len(seen) == len(nodes):
        seen = seen[1:]
    lead = (2,) if seen and rng.random() < 0.2 else ()
    traits |= {"runs"} if lead else set()
    missing = rng.random() < 0.2
    runs = []
    for _ in range(2 if lead else 1):
        values = {}
        for node in nodes:
            total = precise(node.offset)
            for parent, matrix in node.given.items():
                total = total + precise(matrix) @ values[parent]
            noise = np.clip(np.round(rng.normal(size=node.root.shape[1]) * 4) / 4, -3, 3)
            if noise.size:
                total = total + precise(node.root) @ precise(noise)
            values[node.child] = total
        run = {}
        for v in seen:
            run[v] = floats(values[v])
            if missing and v in leaves and v.dimension > 1:
                run[v][rng.random(v.dimension) < 0.5] = np.nan
                traits.add("missing")
        runs.append(run)
    return Case(seed, nodes, runs, lead, units, traits)


class Reference:
    """The dense joint of one run, conditioned on all readings at once in 300 digits."""

    def __init__(self, case, run):
        self.places, size = {}, 0
        for node in case.nodes:
            self.places[node.child] = list(range(size, size + node.child.dimension))
            size += node.child.dimension
        self.prior = np.array([mp.mpf(0)] * size, dtype=object)
        cov, scale = zeros(size, size), zeros(size, size)
        value, self.size = zeros(size), zeros(size)
        for node in case.nodes:
            own = self.places[node.child]
            spread = precise(node.root)
            noise = spread @ spread.T if spread.shape[1] else zeros(len(own), len(own))
            slope = zeros(len(own), size)
            for parent, matrix in node.given.items():
                slope[:, self.places[parent]] = precise(matrix)
            self.prior[own] = precise(node.offset) + slope @ self.prior
            self.size[own] = norms(precise(node.offset)) + norms(slope) @ self.size
            for each, noises in ((cov, noise), (scale, norms(noise))):
                by = slope if each is cov else norms(slope)
                cross = by @ each
                each[own] = cross
                each[:, own] = cross.T
                each[np.ix_(own, own)] = cross @ by.T + noises
        edge = np.array([mp.sqrt(s) for s in np.diagonal(scale)], dtype=object)
        cov = np.where(norms(cov) <= NOTHING * np.outer(edge, edge), mp.mpf(0), cov)
        read = []
        for v, number in run.items():
            for place, part in zip(self.places[v], number, strict=True):
                if not np.isnan(part):
                    value[place] = mp.mpf(float(part))
                    read.append(place)
        residual = value - self.prior
        kept, pivots, inverse = eliminated(
            cov[np.ix_(read, read)], NOTHING * np.diagonal(scale)[read]
        )
        self.determined, self.disagreement = len(read) - len(kept), 0.0
        some = [read[k] for k in kept]
        gain = cov[:, some] @ inverse if some else zeros(size, 0)
        self.mean = self.prior + (gain @ residual[some] if some else zeros(size))
        after = cov - gain @ cov[some] if some else cov
        self.cov = np.where(norms(after) <= NOTHING * np.outer(edge, edge), mp.mpf(0), after)
        for place in read:
            number = max(norms(value[place]), self.size[place], norms(self.prior[place]))
            left = norms(value[place] - self.mean[place])
            if left > NOTHING * (number + edge[place]):
                self.disagreement = max(self.disagreement, float(left / (number or edge[place])))
        self.log_evidence, self.evidence_floor = mp.mpf(0), 0.0
        if some:
            weighted = inverse @ residual[some]
            log_det = sum((mp.log(2 * mp.pi * p) for p in pivots), mp.mpf(0))
            self.log_evidence = -(log_det + residual[some] @ weighted) / 2
            numbers = norms(value[some]) + self.size[some]
            self.evidence_floor = float(EPS * (numbers @ norms(weighted)))
        self.edge = floats(edge)
        unit = np.concatenate([case.units[v] for v in self.places])
        self.size = floats(self.size) + floats(edge) + unit

    def part(self, variables):
        places = [p for v in variables for p in self.places[v]]
        return (
            floats(self.mean[places]),
            floats(self.cov[np.ix_(places, places)]),
            self.size[places],
            self.edge[places],
        )


def worst(got_mean, got_cov, due):
    """The error of a mean and of a covariance, as multiples of what is allowed."""
    mean, cov, size, edge = due
    if not (np.isfinite(got_mean).all() and np.isfinite(got_cov).all()):
        return np.inf, np.inf
    std = np.sqrt(np.diagonal(cov))
    # A determined mean to a billionth of its numbers; any mean as float64 holds these.
    allowed = np.where(std > 0, MEAN * std + EPS * (np.abs(mean)), DETERMINED * size)
    limit = np.where(std > 0, np.sqrt(2 * COV) * std, DEVIATION * edge)
    bound = np.outer(limit, limit)
    far = np.abs(got_cov - cov)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(far > 0, far / bound, 0.0)
        moved = np.abs(got_mean - mean)
        off = np.where(moved > 0, moved / allowed, 0.0)
    if (np.diagonal(got_cov) < 0).any():
        share = np.full(1, np.inf)
    return off.max(initial=0.0), share.max(initial=0.0)


@dataclass(frozen=True)
class Verdict:
    kind: str
    category: str  # right, told, cried, refused, miss, foreign
    size: float = 0.0
    words: str = ""


class Judge:
    def __init__(self, case):
        self.case = case
        self.references = [Reference(case, run) for run in case.evidence]

    @property
    def consistent(self):
        return all(r.disagreement <= CONSISTENT for r in self.references)

    def verdicts(self, which=None):
        case, found = self.case, []
        method = METHODS[case.seed % len(METHODS)]
        graph = pgm.compile(case.network, method=method)
        named = LINEARISERS.items() if "nonlinear" in case.traits else [("linear", pgm.Taylor())]
        for name, rule in named:
            if which is None or name in which:
                found += self._one(name, graph, rule)
        return found

    def _one(self, name, graph, rule):
        case, words, told, errors = self.case, "", False, {}
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                posterior = pgm.infer(graph, case.together, lineariser=rule)
                digits = posterior.status.digits
                told = digits is not None and (digits < 6).any()
                errors = self._errors(posterior)
            except pgm.PgmError as error:
                return [Verdict(name, "refused", np.inf, f"{type(error).__name__}: {error}")]
            except Exception as error:
                return [Verdict(name, "foreign", np.inf, f"{type(error).__name__}: {error}")]
        for warning in caught:
            if not issubclass(warning.category, pgm.PrecisionWarning):
                words = f"{warning.category.__name__}: {warning.message}"
                return [Verdict(name, "foreign", np.inf, words)]
        told = told or bool(caught)
        out = []
        for what, size in errors.items():
            wrong = size > 1
            category = ("told" if told else "miss") if wrong else ("cried" if told else "right")
            out.append(Verdict(f"{name} {what}", category, float(size)))
        return out

    def _errors(self, posterior):
        case = self.case
        found = {"mean": 0.0, "cov": 0.0}
        scopes = [(v,) for v in case.hidden] + [tuple(case.hidden[::-1])]
        for scope in scopes:
            got = posterior.joint(*scope) if len(scope) > 1 else posterior[scope[0]]
            for k, reference in enumerate(self.references):
                at = (k,) if case.lead else ()
                mean, cov = worst(got.mean[at], got.cov[at], reference.part(scope))
                found["mean"] = max(found["mean"], mean)
                found["cov"] = max(found["cov"], cov)
        for k, reference in enumerate(self.references):
            if reference.determined:
                continue  # what has no density has one in a unit that depends on the graph
            got = np.asarray(posterior.log_evidence)[(k,) if case.lead else ()]
            due = float(reference.log_evidence)
            allowed = EVIDENCE + 1e-9 * abs(due) + reference.evidence_floor
            off = abs(float(got) - due) / allowed
            found["evidence"] = max(found.get("evidence", 0.0), off if np.isfinite(off) else np.inf)
        return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("first", type=int)
    parser.add_argument("last", type=int)
    parser.add_argument("--worst", type=int, default=8)
    parser.add_argument("--verbose", action="store_true")
    arguments = parser.parse_args()
    begun, spent, skipped, verdicts = time.perf_counter(), 0.0, [], []
    for seed in range(arguments.first, arguments.last):
        case = draw(seed)
        started = time.perf_counter()
        judge = Judge(case)
        spent += time.perf_counter() - started
        if not judge.consistent:
            skipped.append(seed)
            continue
        found = judge.verdicts()
        verdicts += [(case, v) for v in found]
        if arguments.verbose:
            print(seed, sorted(case.traits))
            for v in found:
                print(f"    {v.kind:24}{v.category:9}{v.size:.2e} {v.words}")
    ranks = ("right", "cried", "told", "refused", "miss", "foreign")
    count = Counter((v.kind, v.category) for _, v in verdicts)
    print(f"{'':24}" + "".join(f"{c:>9}" for c in ranks))
    for kind in dict.fromkeys(v.kind for _, v in verdicts):
        print(f"{kind:24}" + "".join(f"{count[kind, c] or '·':>9}" for c in ranks))
    for category in ("miss", "foreign", "refused", "told", "cried"):
        by = defaultdict(list)
        for case, v in verdicts:
            if v.category == category:
                by[v.kind].append((v.size, case.seed, v.words))
        for kind, each in by.items():
            each.sort(reverse=True)
            shown = ", ".join(f"{seed} ({size:.1e})" for size, seed, _ in each[: arguments.worst])
            print(f"{category} {kind}: {shown}")
            for words, n in Counter(w for *_, w in each if w).most_common(2):
                print(f"      {n} × {words[:160]}")
    took = time.perf_counter() - begun
    print(
        f"{arguments.last - arguments.first} cases in {took:.0f} s ({spent:.0f} s the reference); "
        f"{len(skipped)} contradict themselves by rounding, left out: {skipped[:10]}"
    )


if __name__ == "__main__":
    main()
