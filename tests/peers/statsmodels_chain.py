"""A statsmodels state-space model as a chain of this engine.

    α[t+1] = T α[t] + c + R η,  η ~ N(0, Q)          y[t] = Z α[t] + d + ε,  ε ~ N(0, H),

each matrix constant or one for every step. The initial state of statsmodels is that of the first
observation: x[0], with a reading at step 0. With its "alternate timing" it is the state before, and
the first reading is at step 1. There are as many transitions as observations, so that the first
convention has a forecast at its last step, unless an input of the last transition is unknown.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

import pgm


@dataclass(frozen=True)
class Chain:
    """A dynamic network over the state x, its evidence, and the step of the first reading."""

    x: pgm.Variable
    model: pgm.DynamicBayesianNetwork
    evidence: dict[pgm.Variable, Any]
    steps: int
    first: int

    def filter(self, **options):
        return pgm.filter(self.model, self.evidence, steps=self.steps, **options)

    def smooth(self, **options):
        return pgm.smooth(self.model, self.evidence, steps=self.steps, **options)


def statsmodels_chain(ssm):
    """The chain of a bound `Representation`; rows with gaps go to sensors of what is there."""
    x = pgm.Variable("x", components=[f"a{i}" for i in range(ssm.k_states)])
    matrix, intercept = _by_step(ssm["transition"], 2), _by_step(ssm["state_intercept"], 1)
    move, inputs = _affine(x, x.previous, matrix, intercept, _motion_noise(ssm))
    first = 1 if ssm.timing_init_filtered else 0
    foretold = all(np.isfinite(rows[-1]).all() for rows in inputs.values())
    steps = ssm.nobs if first or foretold else ssm.nobs - 1
    evidence = {variable: rows[:steps] for variable, rows in inputs.items()}
    sensors = []
    for seen, parts in _readings(ssm):
        z = pgm.Variable(
            f"z{len(sensors)}", components=[f"y{i}" for i in range(parts[0].shape[-1])]
        )
        sensor, given = _affine(z, x, *parts[1:])
        sensors.append(sensor)
        evidence[z] = pgm.sightings(parts[0], step=seen + first, given=given)
    model = pgm.DynamicBayesianNetwork([_start(x, ssm)], [move], sensors)
    return Chain(x, model, evidence, steps, first)


def _start(x, ssm):
    mean, diffuse, cov = ssm.initialization(model=ssm)
    if np.any(diffuse - np.diag(np.diagonal(diffuse))):
        raise NotImplementedError("a diffuse part along other directions than the axes")
    unknown = np.diagonal(diffuse) > 0
    return pgm.GaussianCPD(x, mean, _symmetric(cov) + np.diag(np.where(unknown, np.inf, 0.0)))


def _motion_noise(ssm):
    selection, noise = _by_step(ssm["selection"], 2), _by_step(ssm["state_cov"], 2)
    return selection @ noise @ np.swapaxes(selection, -1, -2)


def _readings(ssm):
    """For each set of components seen together: steps, and rows, matrix, offset, noise."""
    rows = np.asarray(ssm.endog).reshape(ssm.k_endog, -1).T
    matrix, offset = _by_step(ssm["design"], 2), _by_step(ssm["obs_intercept"], 1)
    noise = _by_step(ssm["obs_cov"], 2)
    seen = ~np.isnan(rows)
    for pattern in np.unique(seen, axis=0)[::-1]:
        if not pattern.any():
            continue
        steps = np.flatnonzero((seen == pattern).all(axis=1))
        parts = matrix[..., pattern, :], offset[..., pattern], noise[..., pattern, :][..., pattern]
        yield (
            steps,
            (
                rows[steps][:, pattern],
                *(_at(p, steps, d) for p, d in zip(parts, (2, 1, 2), strict=True)),
            ),
        )


def _by_step(value, ndim):
    """A system matrix with the steps, if it has them, first."""
    value = np.asarray(value)
    return np.moveaxis(value, -1, 0) if value.ndim > ndim else value


def _at(value, steps, ndim):
    return value[steps] if value.ndim > ndim else value


def _affine(child, parent, matrix, offset, cov):
    """The CPD child = matrix parent + offset + noise; values that differ by step are inputs."""
    inputs = {}
    size = child.dimension

    def varying(name, value):
        flat = value.reshape(len(value), -1)
        variable = pgm.Variable(
            f"{child.name}_{name}", components=[f"e{i}" for i in range(flat.shape[1])]
        )
        inputs[variable] = flat
        return variable

    cov = _symmetric(cov)
    if cov.ndim == 3:
        q = varying("noise", cov)
        cov = pgm.noise(lambda q: q.reshape(*q.shape[:-1], size, size), given=q)
    shift = varying("offset", offset) if offset.ndim == 2 else None
    if matrix.ndim == 2:
        given = {parent: matrix} | ({} if shift is None else {shift: np.eye(size)})
        constant = offset if shift is None else 0.0
        return pgm.LinearGaussianCPD(child, given=given, offset=constant, cov=cov), inputs
    entries = varying("matrix", matrix)

    def slope(x, entries, shift=None):
        return entries.reshape(*entries.shape[:-1], size, parent.dimension)

    def value(x, entries, shift=offset):
        return (slope(x, entries) @ x[..., None])[..., 0] + shift

    given = (parent, entries) if shift is None else (parent, entries, shift)
    return pgm.NonlinearGaussianCPD(child, given, value, cov, jacobian={parent: slope}), inputs


def _symmetric(cov):
    return 0.5 * (cov + np.swapaxes(cov, -1, -2))
