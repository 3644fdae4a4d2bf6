"""Libraries must agree before their times mean anything."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

import pgm
from benchmarks.work.asked import Beliefs

Array = npt.NDArray[np.float64]

# In standard deviations of our beliefs. dynamax adds 1e-9 to what it solves with; Stone Soup's mean
# of bearings is that of their unit vectors; gtsam's filter has another sensor.
TOLERANCES = {"dynamax": 1e-3, "dynamax_sequential": 1e-3, "stonesoup": 1e-4, "gtsam": 1.0}
TOLERANCE = 1e-6
LOGARITHM = 0.05, 0.1  # of means, in deviations, and of covariances: see `maps`
POSE = 3  # components: east, north, heading


def beliefs(library: str, ours: tuple[Array, Array], theirs: tuple[Array, Array | None]) -> None:
    """Means and covariances, where there are any, in units of our standard deviations.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    within = TOLERANCES.get(library, TOLERANCE)
    mean, cov = ours
    std = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    _require(library, "means", (theirs[0] - mean) / std, within)
    if theirs[1] is not None:
        scale = std[..., :, None] * std[..., None, :]
        _require(library, "covariances", (theirs[1] - cov) / scale, within)


def first_beliefs(library: str, ours: tuple[Array, Array], theirs: tuple[Array, Array]) -> None:
    """As `beliefs`, where they are of the first of our runs alone.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    count = len(theirs[0])
    beliefs(library, (ours[0][:count], ours[1][:count]), theirs)


def drawn_beliefs(library: str, ours: tuple[Array, Array], theirs: tuple[Array, Array]) -> None:
    """Means to a tenth of a standard deviation, deviations to a tenth: both are of draws.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    std, other = (np.sqrt(np.diagonal(each[1], axis1=-2, axis2=-1)) for each in (ours, theirs))
    _require(library, "means", (theirs[0] - ours[0]) / std, 0.1)
    _require(library, "deviations", other / std - 1.0, 0.1)


def places(library: str, ours: Array, theirs: Array) -> None:
    """Poses to .3 m and .1 rad: both are means of draws, of models that are not the same.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    _require(library, "poses, in units of .3 m and .1 rad,", (theirs - ours) / [0.3, 0.3, 0.1], 1.0)


def optima(library: str, ours: tuple[Array, Array], theirs: tuple[Array, Array]) -> None:
    """Means to 1e-5 [m, rad], the covariance of each pose to 1e-4 of its size.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    _require(library, "means", theirs[0] - ours[0], 1e-5)
    change, size = (np.linalg.norm(each, axis=(-2, -1)) for each in (theirs[1] - ours[1], ours[1]))
    _require(library, "covariances", change / size, 1e-4)


def maps(library: str, ours: Sequence[Beliefs], theirs: Sequence[Beliefs]) -> None:
    """Means in units of our deviations, covariances to a share of each one's size, kind by kind.

    To a millionth; of gtsam to a twentieth, covariances to a tenth. Its error of a measured motion
    is a logarithm, ours a difference, and its covariances leave the logarithm's derivative out: the
    optima of a published graph are a fiftieth of a deviation apart, and covariances of a map of 300
    landmarks 6 %. Of three components the third is an angle.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    near, alike = LOGARITHM if library == "gtsam" else (TOLERANCE, TOLERANCE)
    for (mean, cov), (other, spread) in zip(ours, theirs, strict=True):
        assert cov is not None
        away = other - mean
        if away.shape[-1] == POSE:
            away[..., 2] = np.remainder(away[..., 2] + np.pi, 2.0 * np.pi) - np.pi
        deviations = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
        _require(library, "means, in deviations,", away / deviations, near)
        if spread is not None:
            change, size = (np.linalg.norm(each, axis=(-2, -1)) for each in (spread - cov, cov))
            _require(library, "covariances", change / size, alike)


def ways(library: str, ours: Array, theirs: Array) -> None:
    """Poses (N, 3) to a metre and a fifth of a radian: some are linearised elsewhere.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    away = theirs - ours
    away[:, 2] = np.remainder(away[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    _require(library, "places and headings", away / np.array([1.0, 1.0, 0.2]), 1.0)


def modes(library: str, ours: tuple[Array, Array], theirs: tuple[Array, Array]) -> None:
    """Probabilities of modes to 1e-9, means of states to 1e-7 of their units.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    _require(library, "probabilities of modes", theirs[0] - ours[0], 1e-9)
    _require(library, "means", theirs[1] - ours[1], 1e-7)


def marginals(library: str, ours: list[Array], theirs: list[Array]) -> None:
    """Probabilities.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    for mine, other in zip(ours, theirs, strict=True):
        _require(library, "probabilities", other - mine, 1e-12)


def beliefs_of_states(library: str, ours: Array, theirs: Array) -> None:
    """Probabilities of states by step, of our first runs where there are fewer of theirs.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    marginals(library, [ours[: len(theirs)]], [theirs])


def networks(library: str, ours: pgm.BayesianNetwork, theirs: Any) -> None:
    """Variables, states and parents, and probabilities to the last digit.

    Raises
    ------
    AssertionError
        Where they differ.
    """
    other = theirs if library == "pgm" else pgm.from_pgmpy(theirs)
    if not isinstance(other, pgm.BayesianNetwork):
        raise AssertionError(f"{library} finds a network of another kind than pgm, {other!r}")
    if set(other.variables) != set(ours.variables):
        raise AssertionError(f"{library} finds other variables than pgm, or other states of them")
    for mine in ours.cpds:
        cpd = other.cpd(mine.child)
        if not isinstance(mine, pgm.TableCPD) or not isinstance(cpd, pgm.TableCPD):
            raise AssertionError(f"{mine.child!r} has no table")
        if cpd.given != mine.given:
            raise AssertionError(f"{library} finds other parents of {mine.child!r} than pgm")
        _require(library, f"the probabilities of {mine.child!r}", cpd.table - mine.table, 0.0)


def _require(library: str, what: str, difference: Array, within: float) -> None:
    worst = float(np.abs(difference).max())
    if not worst <= within:
        raise AssertionError(
            f"{what} of {library} differ from pgm's by up to {worst:.3g}, more than {within:g}"
        )
