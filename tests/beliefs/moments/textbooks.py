"""Ten-line twins of the engine: textbook filters and smoothers, dense conditioning, least squares.

One run at a time, from the textbooks' equations alone (Särkkä, Bayesian Filtering and Smoothing,
2013): moments of functions, predict, update, smooth. Nothing here calls the engine.
"""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import block_diag


def wrap(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def wrapped(difference, angles):
    """The difference with the components that are angles in [−π, π)."""
    return np.where(angles, wrap(difference), difference)


def taylor(function, mean, cov, jacobian, angles):
    """Mean and covariance of f(x), and the covariance of x and f(x), to first order."""
    slope = jacobian(mean)
    return function(mean), slope @ cov @ slope.T, cov @ slope.T


def root(cov):
    """Its lower triangular root, where components may be known: they have no variance."""
    lower, some = np.zeros_like(cov), np.ix_(*2 * [np.flatnonzero(cov.diagonal())])
    lower[some] = np.linalg.cholesky(cov[some])
    return lower


def unscented(function, mean, cov, jacobian, angles):
    """The same from 2n + 1 points with λ = n − 1, κ = 0, β = 2, hence α² = (2n − 1)/n."""
    n = mean.size
    arms = np.sqrt(2 * n - 1) * root(cov).T
    points = mean + np.vstack([np.zeros(n), arms, -arms])
    weights = np.full(2 * n + 1, 0.5 / (2 * n - 1))
    weights[0] = (n - 1) / (2 * n - 1)
    cov_weights = weights + np.eye(2 * n + 1)[0] * (1 - (2 * n - 1) / n + 2)
    values = function(points)
    offset = wrapped(values - values[0], angles)
    deviation = offset - weights @ offset
    weighted = cov_weights[:, None] * deviation
    return values[0] + weights @ offset, weighted.T @ deviation, (points - mean).T @ weighted


def no_angles(size):
    return np.zeros(size, dtype=bool)


def motion(function, jacobian, cov, disturbance=None):
    """x' = f(x, w) + n: noise n of a covariance, and w ~ N(mean, cov) inside the function."""
    return SimpleNamespace(
        function=function, jacobian=jacobian, cov=np.asarray(cov, float), disturbance=disturbance
    )


def reading(function, jacobian, cov, value, angles=None):
    value = np.asarray(value, float)
    angles = no_angles(value.size) if angles is None else np.asarray(angles)
    return SimpleNamespace(
        function=function, jacobian=jacobian, cov=np.asarray(cov), value=value, angles=angles
    )


def stacked(readings):
    """Several readings of a step as one."""
    sizes = np.cumsum([0, *(r.value.size for r in readings)])
    cov = np.zeros((sizes[-1], sizes[-1]))
    for r, a, b in zip(readings, sizes[:-1], sizes[1:], strict=True):
        cov[a:b, a:b] = r.cov
    return reading(
        lambda x: np.concatenate([r.function(x) for r in readings], axis=-1),
        lambda x: np.concatenate([r.jacobian(x) for r in readings], axis=-2),
        cov,
        np.concatenate([r.value for r in readings]),
        np.concatenate([r.angles for r in readings]),
    )


def log_normal(residual, cov):
    _, log_det = np.linalg.slogdet(2 * np.pi * cov)
    return -0.5 * (residual @ np.linalg.solve(cov, residual) + log_det)


def predict(rule, mean, cov, move):
    n = mean.size
    if move.disturbance is not None:
        extra, spread = move.disturbance
        mean = np.concatenate([mean, extra])
        cov = block_diag(cov, spread)
    new, own, cross = rule(move.function, mean, cov, move.jacobian, no_angles(n))
    return new, own + move.cov, cross[:n]


def update(rule, mean, cov, seen):
    value, own, cross = rule(seen.function, mean, cov, seen.jacobian, seen.angles)
    residual, predictive = wrapped(seen.value - value, seen.angles), own + seen.cov
    gain = np.linalg.solve(predictive, cross.T).T
    return mean + gain @ residual, cov - gain @ cross.T, residual, predictive


def run_filter(rule, mean, cov, motions, readings):
    """Predict with motions[k] from step k to k + 1, update with readings[k] at step k, or None."""
    out = SimpleNamespace(predicted=[], filtered=[], cross=[], innovations={}, log_evidence=0.0)
    mean, cov = np.asarray(mean, float), np.asarray(cov, float)
    for step, seen in enumerate(readings):
        if step:
            mean, cov, cross = predict(rule, mean, cov, motions[step - 1])
            out.cross.append(cross)
        out.predicted.append((mean, cov))
        if seen is not None:
            mean, cov, residual, predictive = update(rule, mean, cov, seen)
            out.innovations[step] = residual, predictive
            out.log_evidence += log_normal(residual, predictive)
        out.filtered.append((mean, cov))
    return out


def run_smoother(filtered, invert=np.linalg.inv):
    """Rauch, Tung and Striebel, back from the last filtered belief: (means, covariances)."""
    mean, cov = filtered.filtered[-1]
    result = [(mean, cov)]
    for step in reversed(range(len(filtered.cross))):
        (m, P), (ahead, P_ahead) = filtered.filtered[step], filtered.predicted[step + 1]
        gain = filtered.cross[step] @ invert(P_ahead)
        mean, cov = m + gain @ (mean - ahead), P + gain @ (cov - P_ahead) @ gain.T
        result.append((mean, cov))
    return result[::-1]


def means(beliefs):
    return np.array([mean for mean, _ in beliefs])


def covs(beliefs):
    return np.array([cov for _, cov in beliefs])


# ---- dense conditioning, in rational numbers


def rational(array):
    return np.vectorize(Fraction, otypes=[object])(np.asarray(array, dtype=float))


def floats(array):
    return np.asarray(array, dtype=float)


class ExactJoint:
    """A joint Gaussian in rational numbers: variables are added, then read, a scalar at a time."""

    def __init__(self):
        self.places, self.log_evidence = {}, 0.0
        self.mean, self.cov = rational(np.zeros(0)), rational(np.zeros((0, 0)))

    def add(self, name, given, offset, cov):
        """y = Σ F p + offset + n, given {p: F}."""
        old, offset = len(self.mean), rational(offset)
        slope = rational(np.zeros((len(offset), old)))
        for parent, matrix in given.items():
            slope[:, self.places[parent]] = rational(matrix)
        cross = slope @ self.cov
        own = cross @ slope.T + rational(cov)
        self.mean = np.concatenate([self.mean, slope @ self.mean + offset])
        self.cov = np.vstack([np.hstack([self.cov, cross.T]), np.hstack([cross, own])])
        self.places[name] = list(range(old, old + len(offset)))

    def read(self, name, value):
        for place, number in zip(self.places[name], rational(value), strict=True):
            variance, residual = self.cov[place, place], number - self.mean[place]
            if variance == 0:
                assert abs(residual) < 1e-9, "a reading contradicts the model"
                continue
            column = self.cov[:, place].copy()
            self.mean = self.mean + column * (residual / variance)
            self.cov = self.cov - np.outer(column, column / variance)
            self.log_evidence -= 0.5 * float(residual**2 / variance)
            self.log_evidence -= 0.5 * np.log(2 * np.pi * float(variance))

    def __getitem__(self, names):
        """Mean and covariance of some variables."""
        places = [k for name in names for k in self.places[name]]
        return floats(self.mean[places]), floats(self.cov[np.ix_(places, places)])


def exact_linear(model, steps, inputs, readings):
    """A linear network of one run, unrolled: predicted and filtered beliefs, and the final joint.

    Inputs are {variable: (T, d)}; readings a list of (sensor, step, value, {parent: value}).
    """
    joint, order = ExactJoint(), [cpd.child for cpd in model.observation]
    out = SimpleNamespace(joint=joint, predicted=[], filtered=[])

    def add(cpd, name, step, known):
        offset, given = rational(cpd.offset), {}
        for parent, matrix in cpd.matrices.items():
            if parent in known:
                offset = offset + rational(matrix) @ rational(known[parent])
            else:
                given[parent.at(step)] = matrix
        noise = cpd.cov
        if hasattr(noise, "function"):
            noise = noise.function(*(np.asarray(known[parent], float) for parent in noise.given))
        joint.add(name, given, offset, noise)

    def beliefs(step, hidden):
        return {v: joint[(v.at(step),)] for v in hidden}

    for step in range(steps + 1):
        row = {v: rows[step - 1] for v, rows in inputs.items()} if step else {}
        hidden = [cpd.child for cpd in (model.transition if step else model.prior)]
        for cpd in model.transition if step else model.prior:
            add(cpd, cpd.child.at(step), step, row)
        out.predicted.append(beliefs(step, hidden))
        now = [entry for entry in enumerate(readings) if entry[1][1] == step]
        for k, (sensor, _, value, given) in sorted(now, key=lambda e: order.index(e[1][0])):
            add(model.observation[order.index(sensor)], ("reading", k), step, row | given)
            joint.read(("reading", k), value)
        out.filtered.append(beliefs(step, hidden))
    return out


# ---- comparisons


def assert_means(mean, due, cov, tolerance=1e-9):
    """Equal to a number of standard deviations; where there is none, of the mean's size."""
    std = np.sqrt(np.maximum(np.diagonal(cov, axis1=-2, axis2=-1), 0.0))
    unit = np.where(std > 0, std, np.maximum(np.abs(due), 1.0))
    assert mean.shape == due.shape
    error = np.abs(mean - due) / unit
    worst = error.max(initial=0.0)
    where = np.unravel_index(np.argmax(error), error.shape) if error.size else ()
    assert worst <= tolerance, f"a mean is {worst:.3g} standard deviations off, at {where}"


def assert_covs(cov, due, tolerance=1e-9):
    """Equal to a part of each covariance's largest entry."""
    assert cov.shape == due.shape
    scale = np.abs(due).max(axis=(-2, -1), keepdims=True, initial=0.0)
    error = np.abs(cov - due) / np.where(scale > 0, scale, 1.0)
    worst = error.max(initial=0.0)
    where = np.unravel_index(np.argmax(error), error.shape) if error.size else ()
    assert worst <= tolerance, f"a covariance is {worst:.3g} of its largest entry off, at {where}"


def assert_belief(gaussian, due_mean, due_cov, tolerance=1e-9):
    assert_means(gaussian.mean, due_mean, due_cov, tolerance)
    assert_covs(gaussian.cov, due_cov, tolerance)


def assert_beliefs(gaussian, beliefs, tolerance=1e-9):
    """A stacked Gaussian against a list of (mean, covariance)."""
    assert_belief(gaussian, means(beliefs), covs(beliefs), tolerance)


def assert_same(gaussian, other, tolerance=1e-9):
    assert_belief(gaussian, other.mean, other.cov, tolerance)


def assert_log(value, due, tolerance=1e-9):
    error = np.abs(np.asarray(value) - due) / (1 + np.abs(due))
    assert np.all(error <= tolerance), f"log-evidence {value} where {due} was due"


# ---- errors


@dataclass(frozen=True)
class Refusal:
    """A row of a table of errors: what is done, and what has to be said about it.

    Attributes
    ----------
    name : str
    call : callable
        What is refused.
    error : type
    words : tuple of str
        Each stands in the message: the thing, what was found, what to do.
    attributes : dict
        Of the error: ``variable``, ``cpd``, ``cluster``, ``step``.
    """

    name: str
    call: Callable
    error: type
    words: tuple
    attributes: dict

    def check(self):
        with pytest.raises(self.error) as caught:
            self.call()
        found = caught.value
        assert type(found) is self.error, f"a {type(found).__name__}: {found}"
        message = str(found)
        lost = [word for word in self.words if word not in message]
        assert not lost, f"{lost} not in: {message}"
        for attribute, due in self.attributes.items():
            value = getattr(found, attribute)
            assert value == due, f".{attribute} is {value!r} where {due!r} was due: {message}"
        return found


def refusal(name, call, error, *words, **attributes):
    return Refusal(name, call, error, words, attributes)
