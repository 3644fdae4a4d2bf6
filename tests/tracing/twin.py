"""Textbook filters and smoothers of one run, which call the functions themselves."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Array = np.ndarray
Function = Callable[[Array], Array]


class Moments(NamedTuple):
    """Means (T + 1, n) and covariances (T + 1, n, n)."""

    mean: Array
    cov: Array


def tangent(function: Function, mean: Array, cov: Array, finer: float = 1.0) -> tuple:
    """Value, F P Fᵀ and P Fᵀ, with F by fourth-order differences."""
    std = np.sqrt(np.diag(cov))
    left = np.sqrt(1.0 - np.max((cov / np.outer(std, std) - np.eye(len(cov))) ** 2, axis=1))
    step = finer * np.maximum(1e-2 * std * np.clip(10.0 * left, 1e-3, 1.0), 1e-4)
    slope = np.empty((len(function(mean)), len(mean)))
    for j, h in enumerate(step):
        d = np.eye(len(mean))[j] * h
        near, far = _at(function, mean + d, mean - d), _at(function, mean + 2 * d, mean - 2 * d)
        slope[:, j] = (8.0 * (near[0] - near[1]) - (far[0] - far[1])) / (12.0 * h)
    return np.array(function(mean), float), slope @ cov @ slope.T, cov @ slope.T


def _at(function: Function, *points: Array) -> list[Array]:
    return [np.array(function(point), dtype=float) for point in points]


def unscented(function: Function, mean: Array, cov: Array) -> tuple:
    """Mean, covariance and cross-covariance by 2n + 1 points, with λ = n − 1 and β = 2."""
    n = len(mean)
    total = 2.0 * n - 1.0
    lower = np.linalg.cholesky(cov)
    points = [mean, *(mean + s * np.sqrt(total) * lower[:, j] for s in (1, -1) for j in range(n))]
    weights = np.full(2 * n + 1, 0.5 / total)
    weights[0] = (total - n) / total
    spread = weights.copy()
    spread[0] += 1.0 - total / n + 2.0
    values = np.array(_at(function, *points))
    middle = weights @ values
    off, away = values - middle, np.array(points) - mean
    return middle, (spread[:, None] * off).T @ off, (spread[:, None] * away).T @ off


def smooth(
    rule: Callable, prior: Moments, move: Callable, motion: Array, see: Callable, noise: Array,
    inputs: Array, readings: Array,
) -> tuple[Moments, Moments]:  # fmt: skip
    """The filter's and the smoother's moments.

    `move(x, u)` and `see(x)` are the functions, `motion` and `noise` covariances, readings
    (T + 1, d) with NaN where there is none; `rule` linearises.
    """
    filtered: list = []
    ahead: list = []
    mean, cov = prior
    for t, reading in enumerate(readings):
        if t:
            value, spread, cross = rule(lambda x, u=inputs[t - 1]: move(x, u), mean, cov)
            ahead.append((value, spread + motion, cross))
            mean, cov = value, spread + motion
        seen = np.isfinite(reading)
        if seen.any():
            value, spread, cross = rule(see, mean, cov)
            spread = (spread + noise)[np.ix_(seen, seen)]
            gain = np.linalg.solve(spread, cross[:, seen].T).T
            mean, cov = mean + gain @ (reading - value)[seen], cov - gain @ spread @ gain.T
        filtered.append((mean, cov))
    smoothed = [filtered[-1]]
    for (mean, cov), (value, spread, cross) in zip(filtered[-2::-1], ahead[::-1], strict=True):
        gain = np.linalg.solve(spread, cross.T).T
        after, width = smoothed[-1]
        smoothed.append((mean + gain @ (after - value), cov + gain @ (width - spread) @ gain.T))
    return _stacked(filtered), _stacked(smoothed[::-1])


def _stacked(each: list) -> Moments:
    return Moments(np.array([mean for mean, _ in each]), np.array([cov for _, cov in each]))
