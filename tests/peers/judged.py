"""Beliefs of a chain beside those of statsmodels, or where these lose digits of 300 digits."""

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from precise import Reference, floats

import pgm

TOLERANCE = 1e-6


def made(make):
    """A model whose every step and reading counts, and what statsmodels says of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ssm = make()
        ssm.tolerance = 0.0  # to 0: never take a covariance for its limit
        ssm.loglikelihood_burn = 0
        return ssm, ssm.smooth()


def by_statsmodels(result):
    def part(name):
        return [np.moveaxis(getattr(result, f"{name}{end}"), -1, 0) for end in ("", "_cov")]

    return SimpleNamespace(
        predicted=part("predicted_state"),
        filtered=part("filtered_state"),
        smoothed=part("smoothed_state"),
        neighbours=np.moveaxis(result.smoothed_state_autocov, -1, 0),
        log_evidence=result.llf_obs.sum(),
    )


def by_reference(chain, count):
    """The same in 300 digits, where statsmodels loses them (priors of 1e6, mostly)."""
    sensors, inputs, readings = [], {}, []
    for sensor in chain.model.observation:
        seen = chain.evidence[sensor.child]
        for row, (step, value) in enumerate(zip(seen.step, seen.values, strict=True)):
            here = {v: rows[row] for v, rows in seen.given.items()}
            if isinstance(sensor, pgm.NonlinearGaussianCPD):  # linear, of other matrices every time
                origin, given = np.zeros(chain.x.dimension), list(here.values())
                matrix = sensor.jacobian[chain.x](origin, *given)
                offset, here = sensor.function(origin, *given), {}
                reading = pgm.Variable(f"{sensor.child.name}_{step}", sensor.child.components)
                sensors.append(
                    pgm.LinearGaussianCPD(
                        reading, given={chain.x: matrix}, offset=offset, cov=sensor.cov
                    )
                )
            else:
                reading = sensor.child
                sensors += [] if row else [sensor]
            readings.append((reading, step, value, here))
    for variable, value in chain.evidence.items():
        if isinstance(value, np.ndarray):
            inputs[variable] = value
    model = chain.model.replace(observation=sensors)
    found = Reference(model, chain.steps, inputs, readings)
    first = chain.first

    def part(beliefs, end=0):
        cut = beliefs[first : first + count + end]
        return [floats([belief[k] for belief in cut]) for k in (0, 1)]

    last = min(first + count, chain.steps)
    return SimpleNamespace(
        predicted=part(found.predicted, 1),
        filtered=part(found.filtered),
        smoothed=part(found.smoothed),
        neighbours=floats([found.cross(t, t + 1).T for t in range(first, last)]),
        log_evidence=float(found.log_evidence),
    )


def by_limit(chain, count):
    """Of a flat prior, the limit of wide ones: what exceeds any bound is infinite."""
    x, [prior] = chain.x, chain.model.prior
    flat = np.isinf(prior.cov)

    def widened(variance):
        start = pgm.GaussianCPD(x, prior.mean, np.where(flat, variance, prior.cov))
        return by_reference(replace(chain, model=chain.model.replace(prior=[start])), count)

    found, wider = widened(1e60), widened(1e80)
    # ½ ln κ is lost for every direction that the readings determine.
    unit = 0.5 * np.log(1e20)
    directions = round((found.log_evidence - wider.log_evidence) / unit)
    found.log_evidence += directions * 3.0 * unit
    for _, cov in (found.predicted, found.filtered, found.smoothed):
        lost = np.diagonal(cov, 0, 1, 2) > 1e50
        cov[lost[:, :, None] | lost[:, None, :]] = 0.0
        cov[lost[:, :, None] & np.eye(x.dimension, dtype=bool)] = np.inf
    return found


def faults(chain, due, count, settled=0):
    """The differences that are too large, by what they are in.

    Means may be off by 1e-6 deviations (or 1e-9, of a large mean 1e-9 of it), covariances by 1e-6
    of the product of two; a deviation smaller than a thirtieth of the usual one of its component
    counts as that. The first `settled` steps of predictions, the filter and neighbours do not
    count: they were diffuse, for which statsmodels has its own conventions (zeros, for neighbours).
    """
    found, x, first = chain.smooth(), chain.x, chain.first
    small = typical(due.predicted[1]) / 30.0
    size = x.dimension
    bad = {}

    def note(what, difference):
        worst = np.max(np.nan_to_num(difference, nan=np.inf), initial=0.0)
        if worst > TOLERANCE:
            bad[what] = float(worst)

    def moments(what, belief, due, start):
        last = min(len(due[0]), chain.steps + 1 - first)
        mean, cov = (np.asarray(part)[start:last] for part in due)
        got = slice(first + start, first + last)
        deviation = np.sqrt(np.maximum(np.diagonal(cov, 0, 1, 2), 0.0))
        unit = np.maximum(deviation, small)
        least = np.maximum(deviation, 1e-3 * np.maximum(1.0, np.abs(mean)))
        open_, ours = np.isinf(cov), belief.cov[got]
        note(f"{what} infinite", np.any(open_ != np.isinf(ours)))
        note(f"{what} mean", np.abs(belief.mean[got] - mean) / least)
        difference = np.where(open_, 0.0, ours) - np.where(open_, 0.0, cov)
        note(f"{what} cov", np.abs(difference) / (unit[:, None] * unit[..., None]))
        return unit

    moments("predicted", found.predicted[x], due.predicted, settled)
    moments("filtered", found.filtered[x], due.filtered, settled)
    units = moments("smoothed", found[x], due.smoothed, 0)
    for t in sorted({settled, count // 2, count - 2} & set(range(settled, count - 1))):
        joint = found.joint(x.at(first + t), x.at(first + t + 1)).cov
        difference = np.abs(joint[size:, :size] - due.neighbours[t])
        note(f"neighbours {t}, {t + 1}", difference / np.outer(units[t + 1], units[t]))
    due_evidence = due.log_evidence
    note("log-evidence", abs(found.log_evidence - due_evidence) / max(1.0, abs(due_evidence)))
    return bad


def typical(covs):
    """The usual deviation of each component; of one that comes to be known, a part of others'."""
    deviations = np.sqrt(np.maximum(np.diagonal(covs, 0, 1, 2), 0.0))
    usual, largest = np.median(deviations, axis=0), deviations.max(axis=0)
    others = max(usual.max(), 1e-9)
    return np.maximum(
        usual, 0.01 * np.where(largest > 1e-6 * others, np.minimum(largest, others), others)
    )
