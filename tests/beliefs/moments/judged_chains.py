"""A judge of what the engine says of a drawn network: right, told, refused, or a silent miss."""

import warnings
from dataclasses import dataclass

import numpy as np
from precise import EPS, Reference, floats

import pgm

MEAN, COV, DETERMINED, EVIDENCE = 1e-6, 1e-6, 1e-9, (1e-6, 1e-9)
# A variance that should be none may be rounding of its scale: the deviation, as a part of the
# largest that the step ever had.
DEVIATION = 3e-8
# And one that should be less than this part of it: there digits are not counted.
TOLD = 1e-9
CATEGORIES = ("right", "floor", "cried", "told", "refused", "miss", "foreign")


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
