"""A linear network in 300 digits: Kalman filter, adjoint smoother, joints of any two steps.

The equations are those of Bryson & Frazier (1963) and de Jong (1989); only the innovations'
covariance is inverted. Nothing here calls the engine, but for what a model declares.
"""

from dataclasses import dataclass

import mpmath
import numpy as np

mp = mpmath.mp.clone()
mp.dps = 300
# What is smaller, as a part of all that was ever summed up for it, is rounding: parameters are
# exact, so what is not rounding is larger by far.
NOTHING = mp.mpf(10) ** -140
# Rounding of a number that a good algorithm in float64 cannot avoid, as a part of its size.
EPS = 2.0**-52 * 32


def precise(array):
    return np.vectorize(mp.mpf, otypes=[object])(np.asarray(array, dtype=float))


def floats(array):
    return np.asarray(array, dtype=float)


def zeros(*shape):
    return np.full(shape, mp.mpf(0), dtype=object)


def eye(size):
    return precise(np.eye(size))


def norms(array):
    return np.abs(array)


@dataclass
class Step:
    """What the filter leaves of a step: readings as H, S⁻¹ v and S⁻¹ of those that say anything."""

    motion: np.ndarray
    mean: np.ndarray
    cov: np.ndarray
    filtered_mean: np.ndarray
    filtered_cov: np.ndarray
    scale: np.ndarray
    matrix: np.ndarray
    weighted: np.ndarray
    inverse: np.ndarray
    keep: np.ndarray  # I − G H


def sequence(cpds, places, size, known):
    """All children of a slice as F previous + c + n, n ~ N(0, Q): (F, c, Q)."""
    slope, offset, cov = zeros(size, size), zeros(size), zeros(size, size)
    for cpd in cpds:
        rows = places[cpd.child.template]
        from_previous, current = zeros(len(rows), size), zeros(len(rows), size)
        own = precise(np.broadcast_to(cpd.offset, len(rows)))
        for parent, matrix in getattr(cpd, "matrices", {}).items():
            if parent in known:
                own = own + precise(matrix) @ precise(known[parent])
            elif parent.lag:
                from_previous[:, places[parent.template]] = precise(matrix)
            else:
                current[:, places[parent.template]] = precise(matrix)
        slope[rows] = from_previous + current @ slope
        offset[rows] = own + current @ offset
        cross = current @ cov
        cov[rows] = cross
        cov[:, rows] = cross.T
        cov[np.ix_(rows, rows)] = cross @ current.T + precise(cpd.cov)
    return slope, offset, cov


def eliminated(cov, floor):
    """Rows that those before do not determine, their pivots, and the inverse of their block."""
    left, kept, pivots = cov.copy(), [], []
    size = len(cov)
    for k in range(size):
        if left[k, k] <= floor[k]:
            continue
        kept.append(k)
        pivots.append(left[k, k])
        left = left - np.outer(left[:, k], left[k] / left[k, k])
    return kept, pivots, inverted(cov[np.ix_(kept, kept)])


def inverted(matrix):
    """Gauss and Jordan; positive definite, so no pivots are searched for."""
    size = len(matrix)
    work = np.hstack([matrix, eye(size)])
    for k in range(size):
        work[k] = work[k] / work[k, k]
        for i in range(size):
            if i != k:
                work[i] = work[i] - work[i, k] * work[k]
    return work[:, size:]


class Reference:
    """Beliefs of one run in 300 digits.

    Readings that earlier ones and the model determine add nothing, and change nothing.

    Parameters
    ----------
    model : DynamicBayesianNetwork
        Linear, of constant noise.
    steps : int
    inputs : {variable: (T, d)}
    readings : list of (sensor, step, value, {parent: value})
        In the order in which the engine takes those of a step: by sensor, then as listed.

    Attributes
    ----------
    predicted, filtered, smoothed : list of (mean, cov)
        Of the whole slice, in `places`.
    log_evidence : float
    evidence_floor : float
        How far rounding of the readings and means alone may move it.
    determined : int
        Components of readings that add nothing.
    disagreement : float
        The largest difference of one of those from what is known, as a part of its size.
    """

    def __init__(self, model, steps, inputs, readings):
        self.steps, self.places, start = steps, {}, 0
        for cpd in model.transition:
            size = cpd.child.dimension
            self.places[cpd.child.template] = list(range(start, start + size))
            start += size
        self.size = start
        self.log_evidence, self.evidence_floor = mp.mpf(0), 0.0
        self.determined, self.disagreement = 0, 0.0
        self._filter(model, inputs, readings)
        self._smooth()

    def _filter(self, model, inputs, readings):
        order = [cpd.child for cpd in model.observation]
        self.rows = []
        _, mean, cov = sequence(model.prior, self.places, self.size, {})
        scale, motion = norms(cov), eye(self.size)
        for step in range(self.steps + 1):
            row = {v: rows[step - 1] for v, rows in inputs.items()} if step else {}
            if step:
                if step == 1 or inputs:
                    motion, offset, noise = sequence(model.transition, self.places, self.size, row)
                mean = motion @ mean + offset
                cov = motion @ cov @ motion.T + noise
                scale = norms(motion) @ scale @ norms(motion).T + norms(noise)
            cov = self._clean(cov, scale)
            now = [r for r in readings if r[1] == step]
            now.sort(key=lambda r: order.index(r[0]))
            record = Step(motion, mean, cov, mean, cov, scale, *[None] * 4)
            self._read(record, [(model.observation[order.index(r[0])], r, row) for r in now])
            self.rows.append(record)
            mean, cov = record.filtered_mean, record.filtered_cov
        self.predicted = [(r.mean, r.cov) for r in self.rows]
        self.filtered = [(r.filtered_mean, r.filtered_cov) for r in self.rows]

    def _clean(self, cov, scale):
        """Rounding is zero."""
        edge = np.array([mp.sqrt(s) for s in np.diagonal(scale)], dtype=object)
        return np.where(norms(cov) <= NOTHING * np.outer(edge, edge), mp.mpf(0), cov)

    def _read(self, record, now):
        parts = []
        for cpd, (_, _, value, given), row in now:
            known, rows = row | given, cpd.child.dimension
            matrix, offset = zeros(rows, self.size), precise(np.broadcast_to(cpd.offset, rows))
            for parent, each in getattr(cpd, "matrices", {}).items():
                if parent in known:
                    offset = offset + precise(each) @ precise(known[parent])
                else:
                    matrix[:, self.places[parent.template]] = precise(each)
            parts.append((matrix, precise(value) - offset, precise(cpd.cov)))
        total = sum(len(p[1]) for p in parts)
        matrix, value, noise = zeros(total, self.size), zeros(total), zeros(total, total)
        top = 0
        for each, number, cov in parts:
            end = top + len(number)
            matrix[top:end], value[top:end], noise[top:end, top:end] = each, number, cov
            top = end
        residual = value - matrix @ record.mean
        cross = matrix @ record.cov
        size = norms(matrix) @ record.scale @ norms(matrix).T + norms(noise)
        joint = cross @ matrix.T + noise
        kept, pivots, inverse = eliminated(joint, NOTHING * np.diagonal(size))
        weighted = inverse @ residual[kept]
        gain = cross[kept].T @ inverse
        record.matrix, record.inverse, record.weighted = matrix[kept], inverse, weighted
        record.keep = eye(self.size) - gain @ record.matrix
        record.filtered_mean = record.mean + gain @ residual[kept]
        cov = record.keep @ record.cov
        record.filtered_cov = self._clean((cov + cov.T) / 2, record.scale)
        # The rest is determined: what is left of it should be zero.
        rest = [k for k in range(total) if k not in kept]
        magnitude = norms(value) + norms(matrix) @ norms(record.mean)
        for k in np.flatnonzero(magnitude == 0):
            magnitude[k] = mp.sqrt(size[k, k]) or mp.mpf(1)
        if rest:
            left = residual[rest] - joint[np.ix_(rest, kept)] @ weighted
            self.determined += len(rest)
            for part, unit in zip(left, magnitude[rest], strict=True):
                if norms(part) > NOTHING * unit:
                    self.disagreement = max(self.disagreement, float(norms(part) / unit))
        log_det = sum((mp.log(2 * mp.pi * p) for p in pivots), mp.mpf(0))
        self.log_evidence -= (log_det + residual[kept] @ weighted) / 2
        for k, pivot, part in zip(kept, pivots, weighted, strict=True):
            deviation = mp.sqrt(pivot)
            self.evidence_floor += float(
                EPS * magnitude[k] / deviation * (1 + norms(part) * deviation)
            )

    def _smooth(self):
        force, weight = zeros(self.size), zeros(self.size, self.size)
        self.adjoint, self.smoothed = [], []
        for step in reversed(range(self.steps + 1)):
            now = self.rows[step]
            if step < self.steps:
                motion = self.rows[step + 1].motion
                force, weight = motion.T @ force, motion.T @ weight @ motion
            back = now.matrix.T
            force = back @ now.weighted + now.keep.T @ force
            weight = back @ now.inverse @ now.matrix + now.keep.T @ weight @ now.keep
            cov = now.cov - now.cov @ weight @ now.cov
            self.adjoint.append(weight)
            self.smoothed.append((now.mean + now.cov @ force, self._clean(cov, now.scale)))
        self.adjoint.reverse()
        self.smoothed.reverse()

    def cross(self, early, late):
        """Cov(x[early], x[late] | all readings), of whole slices, early ≤ late."""
        if early == late:
            return self.smoothed[early][1]
        first = self.rows[early].cov
        for step in range(early, late):
            first = first @ (self.rows[step + 1].motion @ self.rows[step].keep).T
        last = self.rows[late]
        whole = first - first @ self.adjoint[late] @ last.cov
        edges = [
            np.array([mp.sqrt(s) for s in np.diagonal(self.rows[k].scale)], dtype=object)
            for k in (early, late)
        ]
        return np.where(norms(whole) <= NOTHING * np.outer(*edges), mp.mpf(0), whole)

    def joint(self, *variables):
        """Mean and covariance of variables at steps given all readings, as floats."""
        places = [self.places[v.template] for v in variables]
        mean = np.concatenate(
            [self.smoothed[v.step][0][p] for v, p in zip(variables, places, strict=True)]
        )
        blocks = [
            [
                self.cross(a.step, b.step)[np.ix_(p, q)]
                if a.step <= b.step
                else self.cross(b.step, a.step)[np.ix_(q, p)].T
                for b, q in zip(variables, places, strict=True)
            ]
            for a, p in zip(variables, places, strict=True)
        ]
        return floats(mean), floats(np.block(blocks))
