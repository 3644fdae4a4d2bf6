"""A textbook filter and smoother of any dynamic network of one run, written plainly for the tests.

One CPD after another, linearised by the formula of its rule, extends a dense joint; the readings of
a step are one vector. Nothing is the engine's but the CPDs' functions.
"""

from itertools import product
from types import SimpleNamespace

import numpy as np
from textbooks import log_normal, wrap

import pgm
from pgm.evidence import Sightings


def root(cov):
    """The lower triangular root; the column of a component that others determine is zero."""
    rest, lower = cov.copy(), np.zeros_like(cov)
    for j in range(len(cov)):
        if rest[j, j] > 1e-13 * cov[j, j]:
            lower[j:, j] = rest[j:, j] / np.sqrt(rest[j, j])
            rest = rest - np.outer(lower[:, j], lower[:, j])
    return lower


def taylor(function, slope, mean, cov, angles):
    return function(mean), slope(mean), np.zeros(2 * (len(function(mean)),))


def sigma_points(points, weights, cov_weights=None):
    """Regression on points s of N(0, I): x = μ + L s."""
    cov_weights = weights if cov_weights is None else cov_weights

    def rule(function, slope, mean, cov, angles):
        lower, centre, jacobian = root(cov), function(mean), slope(mean)
        moved = points @ lower.T
        off = np.array([function(mean + each) for each in moved]) - centre
        for k in np.flatnonzero(angles):
            if (np.abs(off[:, k]) > np.pi).any():
                line = moved @ jacobian[k]
                off[:, k] = line + wrap(off[:, k] - line)
        middle = weights @ off
        spread = (cov_weights[:, None] * (off - middle)).T
        regression, inverse = spread @ points, np.linalg.pinv(lower)
        matrix = regression @ inverse + jacobian @ (np.eye(len(mean)) - lower @ inverse)
        return centre + middle, matrix, spread @ (off - middle) - regression @ regression.T

    return rule


def unscented(size, alpha2=None, beta=2.0):
    """With κ = 0; α² is that of λ = n − 1 without."""
    alpha2 = (2 * size - 1) / size if alpha2 is None else alpha2
    scale = alpha2 * size  # n + λ
    arms = np.sqrt(scale) * np.eye(size)
    weights = np.full(2 * size + 1, 0.5 / scale)
    weights[0] = 1 - size / scale
    cov_weights = weights.copy()
    cov_weights[0] += 1 - alpha2 + beta
    return sigma_points(np.vstack([np.zeros(size), arms, -arms]), weights, cov_weights)


def cubature(size):
    arms = np.sqrt(size) * np.eye(size)
    return sigma_points(np.vstack([arms, -arms]), np.full(2 * size, 0.5 / size))


def hermite(size):
    one = np.array([-np.sqrt(3), 0.0, np.sqrt(3)])
    points = np.array(list(product(one, repeat=size)))
    each = np.array(list(product([1 / 6, 2 / 3, 1 / 6], repeat=size)))
    return sigma_points(points, each.prod(axis=1))


# By the size of what a function depends on.
RULES = {
    "taylor": lambda size: taylor,
    "unscented": unscented,
    "negative weights": lambda size: unscented(size, 0.64),
    "cubature": cubature,
    "hermite": hermite,
}


def differences(function, at, step=1e-3):
    """The derivative, by central differences of fourth order."""
    columns = []
    for unit in np.eye(len(at)):
        near, far = (
            function(at + k * step * unit) - function(at - k * step * unit) for k in (1, 2)
        )
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, axis=-1)


class Joint:
    """A dense Gaussian over names, to which names are added one by one."""

    def __init__(self):
        self.places, self.mean, self.cov = {}, np.zeros(0), np.zeros((0, 0))

    def index(self, names):
        return np.concatenate([np.zeros(0, int), *(self.places[name] for name in names)])

    def moments(self, names):
        places = self.index(names)
        return self.mean[places], self.cov[np.ix_(places, places)]

    def add(self, name, value, slope, noise):
        """Y = value + F (all − mean) + n."""
        cross, old = slope @ self.cov, len(self.mean)
        self.places[name] = np.arange(old, old + len(value))
        self.mean = np.concatenate([self.mean, value])
        self.cov = np.block([[self.cov, cross.T], [cross, cross @ slope.T + noise]])

    def read(self, slope, residual, noise):
        """Condition on readings of such a residual; return their log-density."""
        predictive = slope @ self.cov @ slope.T + noise
        gain = np.linalg.solve(predictive, slope @ self.cov).T
        keep = np.eye(len(self.mean)) - gain @ slope
        self.mean = self.mean + gain @ residual
        self.cov = keep @ self.cov @ keep.T + gain @ noise @ gain.T
        return log_normal(residual, predictive)

    def only(self, names):
        """The marginal."""
        left = Joint()
        for name in names:
            old = len(left.mean)
            left.places[name] = np.arange(old, old + len(self.places[name]))
            left.mean = np.zeros(old + len(self.places[name]))
        left.mean, left.cov = self.moments(names)
        return left


def linearised(cpd, joint, step, known, rule):
    """The value, F over the whole joint, and the noise with the rule's error.

    `known` has the evidence of each sighting, by parent: several are linearised together.
    """
    hidden = [p for p in cpd.given if p not in known[0]]
    names = [p.at(step) for p in hidden]
    mean, cov = joint.moments(names)
    noise = [np.asarray(_noise(cpd, each)) for each in known]
    angles = np.tile(cpd.child.angle_mask, len(known))
    whole = np.zeros((len(angles), len(joint.mean)))
    whole_noise = np.kron(np.eye(len(known)), np.ones_like(noise[0])) * np.tile(
        np.hstack(noise), (len(known), 1)
    )

    def function(at):
        return np.concatenate([_value(cpd, _split(hidden, at) | each) for each in known])

    def slope(at):
        return np.concatenate([_slope(cpd, hidden, at, each) for each in known])

    if not hidden:
        return function(mean), whole, whole_noise
    size = len(mean)
    if not isinstance(cpd, pgm.NonlinearGaussianCPD):
        rule = taylor
    elif cpd.lineariser is not None:
        rule = cubature(size)  # the only one in the zoo
    else:
        rule = rule(size)
    value, matrix, error = rule(function, slope, mean, cov, angles)
    whole[:, joint.index(names)] = matrix
    return value, whole, whole_noise + error


def _split(hidden, at):
    ends = np.cumsum([p.dimension for p in hidden])
    return dict(zip(hidden, np.split(at, ends)[:-1], strict=True))


def _noise(cpd, known):
    noise = cpd.cov
    return noise.function(*(known[p] for p in noise.given)) if hasattr(noise, "given") else noise


def _value(cpd, values):
    if isinstance(cpd, pgm.NonlinearGaussianCPD):
        return cpd.function(*(values[p] for p in cpd.given))
    return cpd.offset + sum(cpd.matrices[p] @ values[p] for p in cpd.given)


def _slope(cpd, hidden, at, known):
    parts, values = [], _split(hidden, at)
    for parent in hidden:
        if isinstance(cpd, pgm.NonlinearGaussianCPD) and parent in cpd.jacobian:
            both = values | known
            parts.append(cpd.jacobian[parent](*(both[p] for p in cpd.given)))
        else:

            def moved(own, parent=parent):
                return _value(cpd, values | known | {parent: own})

            parts.append(differences(moved, values[parent]))
    return np.concatenate(parts, axis=-1)


def _on_chart(cpd, value, before):
    """Where a function wraps an angle, the turn nearest to where it was."""
    old = {p.at(1): p for p in cpd.given}
    if cpd.child.at(0) in old and cpd.child.angles:
        turns = np.round((value - before) / (2 * np.pi))
        value = value - np.where(cpd.child.angle_mask, turns * 2 * np.pi, 0.0)
    return value


def run(model, evidence, steps, rule):
    """Beliefs over all of a slice: predicted, filtered and smoothed, [(mean, cov)], and names.

    Innovations are the residual and predictive covariance of all readings of a step, {step: ...}.
    """
    rule, joint = RULES[rule], Joint()
    out = SimpleNamespace(predicted=[], filtered=[], smoothed=[], log_evidence=0.0, slices=[])
    out.innovations = {}
    crosses, now = [], []
    for step in range(steps + 1):
        inputs = {v: e[step - 1] for v, e in evidence.items() if v in model.inputs} if step else {}
        before, now = now, []
        for cpd in model.transition if step else model.prior:
            known = {p: inputs[p] for p in cpd.given if p in inputs}
            if cpd.given:
                value, slope, noise = linearised(cpd, joint, step, [known], rule)
            else:
                value, noise = cpd.offset, cpd.cov
                slope = np.zeros((len(value), len(joint.mean)))
            own = [cpd.child.at(step - 1)] if step else []
            if own and own[0] in joint.places:
                value = _on_chart(cpd, value, joint.moments(own)[0])
            joint.add(cpd.child.at(step), value, slope, noise)
            now.append(cpd.child.at(step))
        if step:
            crosses.append(joint.cov[np.ix_(joint.index(before), joint.index(now))])
        joint = joint.only(now)
        out.slices.append(joint.places)
        out.predicted.append((joint.mean, joint.cov))
        seen = _seen(model, joint, evidence, step, rule)
        if seen is not None:
            residual, slope, noise = seen
            out.innovations[step] = residual, slope @ joint.cov @ slope.T + noise
            there = ~np.isnan(residual)
            if there.any():
                noise = noise[np.ix_(there, there)]
                out.log_evidence += joint.read(slope[there], residual[there], noise)
        out.filtered.append((joint.mean, joint.cov))
    mean, cov = out.filtered[-1]
    out.smoothed.append((mean, cov))
    for step in reversed(range(steps)):
        (old, spread), (ahead, wide) = out.filtered[step], out.predicted[step + 1]
        gain = crosses[step] @ np.linalg.pinv(wide, rcond=1e-12, hermitian=True)
        mean, cov = old + gain @ (mean - ahead), spread + gain @ (cov - wide) @ gain.T
        out.smoothed.insert(0, (mean, cov))
    return out


def _seen(model, joint, evidence, step, rule):
    """The readings of a step as one vector: residual, NaN where one is missing, F and noise."""
    parts = []
    for cpd in model.observation:
        given = evidence.get(cpd.child)
        if isinstance(given, Sightings):
            due = np.flatnonzero(given.step == step)
            values = [given.values[k] for k in due]
            known = [{p: rows[k] for p, rows in given.given.items()} for k in due]
        else:
            values = [] if given is None or not step else [given[step - 1]]
            known = [{}] * len(values)
        if not values:
            continue
        grouped = getattr(cpd, "grouped", False)
        groups = [range(len(values))] if grouped else [[k] for k in range(len(values))]
        for group in groups:
            value, slope, noise = linearised(cpd, joint, step, [known[k] for k in group], rule)
            off = np.concatenate([values[k] for k in group]) - value
            angles = np.tile(cpd.child.angle_mask, len(group))
            parts.append((np.where(angles, wrap(off), off), slope, noise))
    if not parts:
        return None
    residual = np.concatenate([part[0] for part in parts])
    slope = np.concatenate([part[1] for part in parts])
    noise, top = np.zeros((len(residual), len(residual))), 0
    for off, _, each in parts:
        rows = slice(top, top := top + len(off))
        noise[rows, rows] = each
    return residual, slope, noise
