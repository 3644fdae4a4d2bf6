"""M steps: of covariances, of tables, and of parameters of functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pgm.boundary import as_floats
from pgm.cpds import ConditionalGaussian, Noise, TableCPD
from pgm.cpds.by_step import NoiseByStep
from pgm.display import called, number
from pgm.errors import ModelError
from pgm.factors.scope import as_value
from pgm.kernels.arrays import Array, symmetric
from pgm.learning.residuals import Known, residuals
from pgm.learning.values import Covariance, Parameter, Table
from pgm.posteriors.expectations import FamilyBelief
from pgm.variables import Variable

# Smaller parts of the largest variance are none of a singular covariance.
_NONE = 1e-14
# How many times the rounding of readings beliefs may have, and parts of a variance that they lose.
_LOST, _FLAT = 1e4, 1e-12


class ScaledNoise:
    """A noise covariance given by a function of parents, times a factor."""

    def __init__(self, function: Any, factor: float) -> None:
        self.function, self.factor = function, factor
        self.__name__ = f"{factor:.6g} {called(function)}"

    def __call__(self, *given: Array) -> Array:
        """The noise at some values of its parents."""
        return self.factor * np.asarray(self.function(*given))


def _which(noise: Noise) -> str:
    by_step = isinstance(noise, NoiseByStep)
    return "another at each step" if by_step else "a function of parents"


class CovarianceStep:
    """The M step of one covariance, and its coordinates without constraints.

    These are roots: of the factor, of variances, or the Cholesky factor of the covariance on its
    range, where it stays as EM itself keeps it. Where the likeliest variance is zero the
    log-evidence is smooth in its root, while a logarithm would have no end.
    """

    def __init__(self, cpd: ConditionalGaussian, declared: Covariance) -> None:
        self.declared = declared
        self.start: Any = cpd.cov
        kind = declared.kind
        if kind == "scaled":
            self._require_within(cpd, np.ones(1))
        if isinstance(cpd.cov, Noise):
            if kind != "scaled":
                raise ModelError(
                    f"{cpd!r}: its noise is {_which(cpd.cov)}, of which a factor alone can be "
                    f'learnt: pgm.learning.Covariance("scaled"), not "{kind}"',
                    cpd=cpd,
                )
            return
        if cpd.cov.ndim > 2 or not np.isfinite(cpd.cov).all():
            raise ModelError(
                f"{cpd!r}: its covariance differs by run or is infinite, and one finite one is "
                "learnt of all runs; give it one to start with",
                cpd=cpd,
            )
        if not cpd.cov.any():
            raise ModelError(
                f"{cpd!r}: its covariance is zero, and would stay so, as a factor of nothing or "
                "for want of room; give it one to start with",
                cpd=cpd,
            )
        off = cpd.cov - np.diag(np.diagonal(cpd.cov))
        if kind == "diagonal" and off.any():
            raise ModelError(
                f"{cpd!r}: its covariance has correlations, and a diagonal one is to be learnt; "
                'start with one, or learn pgm.learning.Covariance("full")',
                cpd=cpd,
            )
        self.there = np.diagonal(cpd.cov) > 0.0
        values, vectors = np.linalg.eigh(cpd.cov)
        self.range = vectors[:, values > _NONE * values[-1]]
        self._require_rank(cpd)
        if kind != "scaled":
            diagonal = kind == "diagonal"
            inside = (
                np.diagonal(cpd.cov)[self.there] if diagonal else values[-self.range.shape[1] :]
            )
            self._require_within(cpd, inside)
        self.factor_of = np.linalg.pinv(cpd.cov, rcond=_NONE, hermitian=True)

    def _require_rank(self, cpd: ConditionalGaussian) -> None:
        """Refuse variances so far apart that the small ones would be taken for none."""
        if self.declared.kind == "diagonal":
            return
        if self._rank(self.start) > self.range.shape[1]:
            std = np.sqrt(np.diagonal(self.start)[self.there])
            raise ModelError(
                f"{cpd!r}: its deviations go from {number(std.min())} to {number(std.max())}, too "
                "far apart to be learnt together; give its components other units, or learn "
                'pgm.learning.Covariance("diagonal")',
                cpd=cpd,
            )

    def _rank(self, cov: Array, least: float = _NONE) -> int:
        """The directions in which a covariance has noise, its components in units of their own.

        A variance of less than the `least` part of the largest is none.
        """
        std = np.sqrt(np.diagonal(cov)[self.there])
        alike = np.linalg.eigvalsh(cov[np.ix_(self.there, self.there)] / np.outer(std, std))
        return int((alike > least * alike[-1]).sum())

    def vanishes(self, cpd: Any, std: Array, rounding: Array, *, searched: bool) -> bool:
        """Whether noise of deviations `std` (d,) is that of rounding alone, `rounding` (d,).

        So it is of the noise in a direction, as two records leave none of a plane's. Where it is
        `searched` more is taken for rounding, since beliefs of what is hidden lose digits. Readings
        that are all zero have the rounding of the noise at the start.
        """
        if self.declared.lower > 0.0:
            return False
        if isinstance(self.start, Noise):
            factor = self.factor(cpd)
            start = std / np.sqrt(factor) if factor > 0.0 else std
        else:
            start = np.sqrt(np.diagonal(self.start))
        rounding = np.where(rounding > 0.0, rounding, 2.0**-52 * start)
        gone = std <= rounding * (_LOST if searched else 1.0)
        if self.declared.kind == "scaled":
            return bool(gone.all())
        if gone[self.there].any():
            return True
        least = _FLAT if searched else _NONE
        return self.declared.kind == "full" and self._rank(cpd.cov, least) < self.range.shape[1]

    def _require_within(self, cpd: ConditionalGaussian, values: Array) -> None:
        low, high = self.declared.lower, self.declared.upper
        slack = 1e-9 * np.abs(values)
        if ((values < low - slack) | (values > high + slack)).any():
            what = {"full": "eigenvalues", "diagonal": "variances", "scaled": "factor"}
            raise ModelError(
                f"{cpd!r}: at the start the {what[self.declared.kind]}, "
                f"{', '.join(map(number, values))}, are not within {number(low)} to "
                f"{number(high)}, the bounds of its covariance; give it one that is",
                cpd=cpd,
            )

    def likeliest(self, own: Array, count: float) -> Any:
        """The covariance that makes sums E[r rᵀ] of so many residuals likeliest, within bounds.

        −½ (N ln |Q| + tr Q⁻¹ S) is largest at S/N, of which variances, the factor, or eigenvalues
        are moved to the nearest bound.
        """
        declared, mean = self.declared, symmetric(own) / count
        if declared.kind == "scaled":
            rank = self.range.shape[1]
            factor = float(np.sum(self.factor_of * mean)) / rank
            return np.clip(factor, declared.lower, declared.upper) * self.start
        if declared.kind == "diagonal":
            return np.diag(self._bounded(np.diagonal(mean)))
        inner = self.range.T @ mean @ self.range
        values, vectors = np.linalg.eigh(symmetric(inner))
        low = max(declared.lower, 0.0)
        vectors = self.range @ vectors
        return symmetric((vectors * np.clip(values, low, declared.upper)) @ vectors.T)

    def _bounded(self, variances: Array) -> Array:
        found = np.clip(variances, self.declared.lower, self.declared.upper)
        return np.where(self.there, found, 0.0)

    def factor(self, cpd: Any) -> float:
        """The factor on the covariance at the start."""
        if isinstance(cpd.cov, NoiseByStep):
            total = float(np.einsum("kii->", self.start.covs))
            return float(np.einsum("kii->", cpd.cov.covs)) / total if total else 1.0
        if isinstance(cpd.cov, Noise):
            function: Any = cpd.cov.function
            own = isinstance(function, ScaledNoise) and function is not self.start.function
            return float(function.factor) if own else 1.0
        return float(np.trace(cpd.cov) / np.trace(self.start))

    def scaled(self, factor: float) -> Any:
        """The covariance at the start times a factor."""
        factor = float(np.clip(factor, self.declared.lower, self.declared.upper))
        if isinstance(self.start, NoiseByStep):
            return self.start.scaled(factor)
        if isinstance(self.start, Noise):
            function = ScaledNoise(self.start.function, factor)
            return Noise(function, self.start.given, self.start.diagonal)
        return factor * self.start

    def vector(self, cpd: Any) -> Array:
        """The coordinates of a CPD's covariance."""
        if self.declared.kind == "scaled":
            return np.array([np.sqrt(self.factor(cpd))])
        if self.declared.kind == "diagonal":
            deviations: Array = np.sqrt(np.diagonal(cpd.cov)[self.there])
            return deviations
        lower = self._lower(cpd)
        return lower[np.tril_indices(len(lower))]

    def _lower(self, cpd: Any) -> Array:
        """A root of the covariance on its range, lower triangular."""
        values, vectors = np.linalg.eigh(symmetric(self.range.T @ cpd.cov @ self.range))
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        lower: Array = np.transpose(np.linalg.qr(root.T, mode="r"))
        found: Array = lower * np.where(np.diagonal(lower) < 0.0, -1.0, 1.0)
        return found

    def gradient(self, cpd: Any, own: Array, count: float) -> Array:
        """The derivatives of the expected log-density by the coordinates.

        By L that of −½ (N ln |L Lᵀ| + tr (L Lᵀ)⁻¹ S) is L⁻ᵀ (L⁻¹ S L⁻ᵀ − N).
        """
        if self.declared.kind == "scaled":
            factor, rank = self.factor(cpd), self.range.shape[1]
            total = float(np.sum(self.factor_of * own))
            return np.array([(total / factor - count * rank) / np.sqrt(factor)])
        if self.declared.kind == "diagonal":
            variances = np.diagonal(cpd.cov)[self.there]
            slopes: Array = np.diagonal(own)[self.there] / variances - count
            slopes /= np.sqrt(variances)
            return slopes
        lower = self._lower(cpd)
        # At a root of zero, which the M step may reach, nothing is to be gained along it.
        regular = bool(np.diagonal(lower).all())
        inverse = np.linalg.inv(lower) if regular else np.linalg.pinv(lower)
        inner = inverse @ self.range.T @ own @ self.range @ inverse.T
        whole = inverse.T @ (inner - count * np.eye(len(lower)))
        found: Array = whole[np.tril_indices(len(lower))]
        return found

    def at(self, vector: Array) -> Any:
        """The covariance of some coordinates, moved within the bounds."""
        if self.declared.kind == "scaled":
            return self.scaled(float(vector[0]) ** 2)
        if self.declared.kind == "diagonal":
            variances = np.zeros(len(self.there))
            variances[self.there] = vector**2
            return np.diag(self._bounded(variances))
        size = self.range.shape[1]
        lower = np.zeros((size, size))
        lower[np.tril_indices(size)] = vector
        inner = lower @ lower.T
        bounds = self.declared
        if bounds.lower > 0.0 or np.isfinite(bounds.upper):
            values, vectors = np.linalg.eigh(inner)
            inner = (vectors * np.clip(values, bounds.lower, bounds.upper)) @ vectors.T
        return symmetric(self.range @ inner @ self.range.T)


_TINY = 1e-300


class TableStep:
    """The M step of one table in closed form (Baum & Welch).

    Zeros stay zeros. Rows of parents' states that never occur stay as they are.
    """

    def __init__(self, cpd: TableCPD, parts: Sequence[Table]) -> None:
        if cpd._table is None:
            raise ModelError(
                f"{cpd!r}: its table is structured, of independent causes or a function of inputs, "
                "and is learnt as an array, whose entries are free: give the network "
                f"pgm.TableCPD({cpd.child!r}, parents, table=cpd.table)",
                cpd=cpd,
            )
        counts = as_floats(parts[0].prior_counts, f"{cpd!r}: prior_counts", cpd=cpd)
        if counts.shape not in ((), cpd.table.shape):
            raise ModelError(
                f"{cpd!r}: prior_counts has shape {counts.shape}; () or {cpd.table.shape} was due",
                cpd=cpd,
            )
        self.free = cpd.table > 0.0
        self.prior = np.where(self.free, counts, 0.0)

    def log_prior(self, cpd: TableCPD) -> float:
        """The logarithm of the Dirichlet prior, but for a constant."""
        logs = np.log(np.maximum(cpd.table, _TINY))
        return float(np.sum(self.prior * np.where(self.free, logs, 0.0)))

    def maximised(self, cpd: TableCPD, counts: Array) -> TableCPD:
        """The table of expected counts, (parents..., child)."""
        counts = np.where(self.free, counts + self.prior, 0.0)
        total = counts.sum(axis=-1, keepdims=True)
        table = np.where(total > 0.0, counts / np.where(total > 0.0, total, 1.0), cpd.table)
        return TableCPD(cpd.child, cpd.given, table=table)

    def vector(self, cpd: TableCPD) -> Array:
        """The coordinates of a table: √ of the entries that are not zero at the start."""
        return np.sqrt(cpd.table)[self.free]

    def gradient(self, cpd: TableCPD, counts: Array) -> Array:
        """The derivatives of the expected log-density by the roots s, of p = s² / Σ s²."""
        counts = np.where(self.free, counts + self.prior, 0.0)
        roots = np.sqrt(cpd.table)
        told = counts / np.where(roots > 0.0, roots, 1.0)
        found: Array = 2.0 * (told - roots * counts.sum(axis=-1, keepdims=True))
        return found[self.free]

    def at(self, cpd: TableCPD, vector: Array) -> TableCPD:
        """The table of some coordinates."""
        weights = np.zeros(self.free.shape)
        weights[self.free] = vector**2
        total = weights.sum(axis=-1, keepdims=True)
        table = np.where(total > 0.0, weights / np.where(total > 0.0, total, 1.0), cpd.table)
        return TableCPD(cpd.child, cpd.given, table=table)


_HALVINGS = 20
_ROUNDS = 5
_STEP = 1e-4
# The relative fall of V from which on a step is the last.
_SMALL = 1e-12


class ParameterStep:
    """The M step of a parent with one value at all rows of all recordings.

    The expected log-density is, but for constants, −½ V(θ), V(θ) = Σ tr(Q⁻¹ E[r rᵀ]) of all CPDs
    that have the parent, their residuals expected at each θ. Its gradient is taken by central
    differences, its curvature is Gauss and Newton's; a step that does not lower V is halved. It is
    exact where residuals are linear in θ.
    """

    def __init__(self, variable: Variable, declared: Parameter) -> None:
        self.variable = variable
        size = variable.dimension
        self.start = np.array(as_value(variable, declared.start, "start"))
        if self.start.shape != (size,):
            raise ModelError(
                f"{variable!r}: the start of a parameter has shape {self.start.shape}; ({size},) "
                "was due, one value for all runs",
                variable=variable,
            )
        bounds = []
        for name in ("lower", "upper"):
            bound = as_floats(getattr(declared, name), f"{variable!r}: {name}", variable=variable)
            if bound.shape not in ((), (size,)):
                raise ModelError(
                    f"{variable!r}: {name} has shape {bound.shape}; () or ({size},) was due",
                    variable=variable,
                )
            bounds.append(np.broadcast_to(bound, (size,)))
        self.lower, self.upper = bounds

    def clipped(self, value: Array) -> Array:
        """A value moved within the bounds."""
        return np.clip(value, self.lower, self.upper)

    def maximised(self, beliefs: Sequence[FamilyBelief], known: Known) -> tuple[Array, Array]:
        """The value after a few steps, or until none lowers V; and the gradient at the start."""
        value = known[self.variable]
        here = self._parts(beliefs, known, value)
        weights = [np.linalg.pinv(each.noise, hermitian=True) for each in here]
        cost, first = _cost(here, weights), None
        for _ in range(_ROUNDS):
            gradient, curvature = self._derivatives(beliefs, known, value, weights)
            first = gradient if first is None else first
            outward = np.where(gradient > 0.0, value <= self.lower, value >= self.upper)
            free = ~outward & (gradient != 0.0)
            if not free.any():
                break
            step = np.zeros_like(value)
            step[free] = -np.linalg.lstsq(curvature[np.ix_(free, free)], gradient[free])[0]
            moved, there = self._halved(beliefs, known, value, step, cost, weights)
            if not there < cost:
                break
            small = cost - there < _SMALL * abs(cost)
            value, cost = moved, there
            if small:
                break
        assert first is not None
        return value, -first

    def _halved(
        self,
        beliefs: Sequence[FamilyBelief],
        known: Known,
        value: Array,
        step: Array,
        cost: float,
        weights: list[Array],
    ) -> tuple[Array, float]:
        """The longest of the step's halves, within bounds, that lowers V."""
        there = cost
        for k in range(_HALVINGS):
            moved = self.clipped(value + 0.5**k * step)
            there = _cost(self._parts(beliefs, known, moved), weights)
            if there < cost:
                return moved, there
        return value, there

    def _parts(self, beliefs: Sequence[FamilyBelief], known: Known, value: Array) -> list[Any]:
        return [residuals(each, {**known, self.variable: value}) for each in beliefs]

    def _derivatives(
        self, beliefs: Sequence[FamilyBelief], known: Known, value: Array, weights: list[Array]
    ) -> tuple[Array, Array]:
        """Half the gradient of V, and half its curvature."""
        size = value.size
        steps = _STEP * np.maximum(np.abs(value), 1.0)
        gradient, curvature = np.zeros(size), np.zeros((size, size))
        sides = [
            [self._parts(beliefs, known, value + sign * h * unit) for sign in (1.0, -1.0)]
            for h, unit in zip(steps, np.eye(size), strict=True)
        ]
        for k, (ahead, behind) in enumerate(sides):
            gradient[k] = (_cost(ahead, weights) - _cost(behind, weights)) / (4.0 * steps[k])
        for place, weight in enumerate(weights):
            slopes = []
            for (ahead, behind), h in zip(sides, steps, strict=True):
                a, b = ahead[place], behind[place]
                slopes.append(((a.mean - b.mean) / (2.0 * h), (a.line - b.line) / (2.0 * h)))
            cov = sides[0][0][place].cov
            for k, (mean, line) in enumerate(slopes):
                for m, (other, along) in enumerate(slopes[: k + 1]):
                    both = mean[:, :, None] * other[:, None, :]
                    both = both + line @ cov @ np.swapaxes(along, -1, -2)
                    curvature[k, m] += float(np.sum(weight * sides[0][0][place].weighted(both)))
                    curvature[m, k] = curvature[k, m]
        return gradient, curvature


def _cost(parts: list[Any], weights: list[Array]) -> float:
    return float(
        sum(np.sum(weight * each.rows()[0]) for each, weight in zip(parts, weights, strict=True))
    )
