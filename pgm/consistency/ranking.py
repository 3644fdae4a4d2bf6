"""Sensors ranked by their innovations, with the stretch that speaks most against each."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.consistency.averages import Average, average
from pgm.consistency.errors import check_innovations
from pgm.display import Listing, Shown, Summary, count, number
from pgm.errors import ModelError
from pgm.inference import Innovations
from pgm.kernels import roots, solving
from pgm.kernels.arrays import Array, Integers, Mask, independent
from pgm.variables import Variable

# The group of sightings of which none was told.
NO_LABEL = "no label"
# The alternative of a stretch: innovations with so many times the variance.
_WIDER = 2.0


@dataclass(frozen=True, eq=False, repr=False)
class Ranked(Shown):
    """The NIS of one sensor, or of one labelled group of its sightings.

    Attributes
    ----------
    sensor : Variable
    group : object
        The label of the sightings; None where the sensor is not divided.
    average : Average
        The NIS a degree of freedom, over all steps and runs, with the band of a right model.
    bias : ndarray
        (d,): the mean residual of each component in its own deviations; 0 of a right model.
    bias_error : ndarray
        (d,): the standard error of that, 1/√n.
    first, last : int
        The steps of the stretch that speaks most for innovations of twice the variance.
    in_stretch : float
        The NIS a degree of freedom there.
    probability : float
        A bound on the probability that a right model has such a stretch anywhere.
    steps : ndarray of int
        (S,): where there are readings.
    nis, dof : ndarray
        (..., S): of each.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> filtered = pgm.filter(walk, {z: [[1.0], [9.0], [1.0], [1.0]]})
    >>> found = pgm.consistency.ranking(filtered.innovations)[0]
    >>> found.name, found.first, found.last
    ('z', 2, 3)
    """

    sensor: Variable
    group: Any
    average: Average
    bias: Array
    bias_error: Array
    first: int
    last: int
    in_stretch: float
    probability: float
    steps: Integers
    nis: Array
    dof: Integers

    @property
    def name(self) -> str:
        """The sensor's name, with the label of the group."""
        return self.sensor.name if self.group is None else f"{self.sensor.name}, {self.group}"

    @property
    def _title(self) -> str:
        return (
            f"Ranked({self.name}: NIS {number(float(self.average.value))} a component, band "
            f"{number(float(self.average.low))} to {number(float(self.average.high))}, worst at "
            f"steps {self.first}..{self.last})"
        )

    def _summary(self) -> Summary:
        return Summary(self._title)


@dataclass(frozen=True, eq=False, repr=False)
class Ranking(Shown):
    """Sensors by their normalised innovations, the largest first.

    Attributes
    ----------
    rows : tuple of Ranked

    Examples
    --------
    >>> len(pgm.consistency.ranking({}))
    0
    """

    rows: tuple[Ranked, ...]

    def __getitem__(self, place: int) -> Ranked:
        return self.rows[place]

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def _title(self) -> str:
        outside = sum(not bool(row.average.inside) for row in self.rows)
        return f"Ranking({count(len(self.rows), 'row')}, {outside} outside their band)"

    def _summary(self) -> Summary:
        heads = ("", "read", "NIS/dof", "band", "bias [σ]", "worst stretch", "NIS/dof", "p at most")
        rows = []
        for row in self.rows:
            worst = int(np.argmax(np.abs(row.bias)))
            rows.append(
                (
                    row.name,
                    f"{int(row.average.count):,}",
                    number(float(row.average.value), 3),
                    f"{number(float(row.average.low), 3)} to {number(float(row.average.high), 3)}",
                    f"{row.bias[worst]:+.2f} ± {row.bias_error[worst]:.2f}",
                    f"{row.first}..{row.last}",
                    number(row.in_stretch, 3),
                    f"{row.probability:.2g}",
                )
            )
        return Summary(self._title, [Listing(heads, rows)])


@public
def ranking(
    innovations: Mapping[Variable, Innovations],
    *,
    by: Mapping[Variable, npt.ArrayLike] | None = None,
    confidence: float = 0.99,
) -> Ranking:
    r"""Rank sensors by how far their innovations go beyond their covariances.

    The innovations of a right filter are independent from step to step, so that the sum of their
    NIS is χ². A stretch a..b is weighed against innovations of s = 2 times the variance,

    .. math:: \Lambda_{ab} = \sum_{t=a}^{b} \tfrac12 \epsilon_t (1 - 1/s) - \tfrac12 d_t \ln s,
        \qquad P(\max_{ab} \Lambda_{ab} \ge h) \le N e^{-h},

    N the number of steps with readings in all runs; the bound is Ville's, at each beginning.
    Sightings that a gate has rejected count too.

    Parameters
    ----------
    innovations : mapping of Variable to Innovations
        ``posterior.innovations`` of a filter, or some of it.
    by : mapping of Variable to array_like, optional
        (M,), labels by which a sensor's sightings are divided, such as the landmark seen; None or
        NaN where there is none, and these are a group, too. Sightings of one label at one step
        count as if they were independent.
    confidence : float
        Probability of the band.

    Returns
    -------
    Ranking
        Sensors without a reading are left out.

    Raises
    ------
    ModelError
        If they are no innovations, labels are not one a sighting, or the confidence is not between
        0 and 1.

    References
    ----------
    Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001,
    section 5.4.2. Ville, Étude critique de la notion de collectif, 1939.

    Examples
    --------
    >>> from pgm.examples import walk, z
    >>> filtered = pgm.filter(walk, {z: [[1.0], [9.0], [1.0], [1.0]]})
    >>> found = pgm.consistency.ranking(filtered.innovations)
    >>> found[0].first, found[0].last
    (2, 3)
    """
    if not isinstance(innovations, Mapping):
        raise ModelError(
            "innovations are given by sensor, like posterior.innovations, not as "
            f"{type(innovations).__name__}"
        )
    labels = dict(by or {})
    if lost := [variable for variable in labels if variable not in innovations]:
        raise ModelError(f"by names {lost[0]!r}, of which there are no innovations")
    rows = []
    for sensor, each in innovations.items():
        found = check_innovations(each)
        if sensor not in labels:
            rows.append(_ranked(sensor, None, _by_step(found), found, slice(None), confidence))
            continue
        own = np.asarray(labels[sensor])
        if own.shape != found.step.shape:
            raise ModelError(
                f"by: {sensor!r} has labels of shape {own.shape}; {found.step.shape} was due, one "
                "a sighting"
            )
        for label, chosen in _labelled(own):
            steps = _by_sighting(found, chosen)
            rows.append(_ranked(sensor, label, steps, found, chosen, confidence))
    kept = [row for row in rows if row is not None]
    return Ranking(tuple(sorted(kept, key=lambda row: -float(row.average.value))))


def _labelled(labels: npt.NDArray[Any]) -> list[tuple[Any, Mask]]:
    """Each label with the mask of its sightings; those without one, None or NaN, come last."""
    each = [None if one is None or one != one else one for one in labels.tolist()]
    known = sorted({one for one in each if one is not None}, key=lambda one: (str(type(one)), one))
    found = [(one, np.array([other == one for other in each], dtype=bool)) for one in known]
    if None in each:
        found.append((NO_LABEL, np.array([one is None for one in each], dtype=bool)))
    return found


# Steps with readings, and their NIS and degrees of freedom.
_Steps = tuple[Integers, Array, Integers]


def _by_step(innovations: Innovations) -> _Steps:
    """NIS of each step, from the joint covariance of the accepted sightings.

    A rejected sighting adds its own νᵀS⁻¹ν.
    """
    nis, dof = np.nan_to_num(innovations.nis), innovations.dof
    if innovations.rejected.any():
        own = _by_sighting(innovations, innovations.rejected)
        nis, dof = nis.copy(), dof.copy()
        nis[..., own[0]] += np.nan_to_num(own[1])
        dof[..., own[0]] += own[2]
    read = np.flatnonzero((dof > 0).any(axis=tuple(range(dof.ndim - 1))))
    nis, dof = nis[..., read], dof[..., read]
    return read, np.where(dof > 0, nis, np.nan), dof


def _by_sighting(innovations: Innovations, chosen: Mask) -> _Steps:
    """NIS of each step, Σ νᵀS⁻¹ν over the chosen sightings with their own S, (..., M)."""
    taken = ~np.isnan(innovations.residual) & chosen[..., None]
    residual = np.where(taken, innovations.residual, 0.0)
    white = solving.whiten(roots.root(independent(innovations.cov, taken)), residual)
    steps, place = np.unique(innovations.step, return_inverse=True)
    nis = np.zeros((len(steps), *white.shape[:-2]))
    dof = np.zeros(nis.shape, dtype=np.intp)
    np.add.at(nis, place, np.moveaxis(np.sum(white**2, axis=-1), -1, 0))
    np.add.at(dof, place, np.moveaxis(taken.sum(axis=-1), -1, 0))
    read = np.flatnonzero((dof > 0).any(axis=tuple(range(1, dof.ndim))))
    nis, dof = np.moveaxis(nis[read], 0, -1), np.moveaxis(dof[read], 0, -1)
    return steps[read], np.where(dof > 0, nis, np.nan), dof


def _ranked(
    sensor: Variable,
    group: Any,
    found: _Steps,
    innovations: Innovations,
    chosen: slice | Mask,
    confidence: float,
) -> Ranked | None:
    steps, nis, dof = found
    if not dof.any():
        return None
    mean = average(nis, np.where(dof > 0, dof, 1), confidence=confidence).per_dof()
    residual = innovations.residual[..., chosen, :]
    std = np.sqrt(np.diagonal(innovations.cov[..., chosen, :, :], axis1=-2, axis2=-1))
    exact = std == 0.0  # whose residual is no bias where it is zero
    parts = residual / np.where(exact, 1.0, std)
    parts = np.where(exact & (residual != 0.0), np.copysign(np.inf, residual), parts)
    parts = parts.reshape(-1, residual.shape[-1])
    read = (~np.isnan(parts)).sum(axis=0)
    bias = np.divide(np.nansum(parts, axis=0), read, out=np.zeros(len(read)), where=read > 0)
    error = 1.0 / np.sqrt(np.maximum(read, 1))
    first, last, share, worst = _stretch(nis, dof)
    chance = float(min(1.0, (dof > 0).sum() * np.exp(-worst)))
    ends = int(steps[first]), int(steps[last])
    return Ranked(sensor, group, mean, bias, error, *ends, share, chance, steps, nis, dof)


def _stretch(nis: Array, dof: Integers) -> tuple[int, int, float, float]:
    """First and last place of the heaviest stretch of a run, its NIS a degree, and its Λ."""
    squares = np.nan_to_num(nis).reshape(-1, nis.shape[-1])
    each = dof.reshape(squares.shape)
    gain = 0.5 * squares * (1.0 - 1.0 / _WIDER) - 0.5 * each * np.log(_WIDER)
    total = np.concatenate([np.zeros((len(gain), 1)), np.cumsum(gain, axis=1)], axis=1)
    over = total[:, 1:] - np.minimum.accumulate(total[:, :-1], axis=1)
    run, last = np.unravel_index(int(np.argmax(over)), over.shape)
    # A stretch begins after the last of the lowest sums.
    first = int(last) - int(np.argmin(total[run, : last + 1][::-1]))
    part = slice(first, int(last) + 1)
    share = float(squares[run, part].sum()) / max(int(each[run, part].sum()), 1)
    return first, int(last), share, float(over[run, last])
