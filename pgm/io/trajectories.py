"""The trajectory that a belief over time is of: places in metres, angles, and their covariances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from pgm.boundary import as_tuple, is_unordered
from pgm.display import titled
from pgm.errors import EvidenceError, ModelError
from pgm.factors import Gaussian
from pgm.factors.scope import listed
from pgm.io.stamped import as_stamps, clock
from pgm.kernels.arrays import Array
from pgm.units import LENGTH, factor, in_words, of_quantity
from pgm.variables import Variable


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Times (n,), places (n, 3) [m], roll, pitch and yaw (n, 3), and covariances of components."""

    times: Array
    xyz: Array
    angles: Array
    names: tuple[str, ...]
    cov: Array


def trajectory(
    belief: Any,
    times: npt.ArrayLike,
    position: Any,
    heading: str | None,
    pitch: str | None,
    roll: str | None,
) -> Trajectory:
    """The trajectory of a belief of one run; see `Poses.of`."""
    gaussian = _gaussian(belief)
    straight = _position(position)
    names = (*straight, *(name for name in (roll, pitch, heading) if name is not None))
    places = _places(gaussian, names)
    for name in (roll, pitch, heading):
        if name is not None:
            _require_angle(gaussian, name)
    stamps, steps = increasing(times), len(gaussian.mean)
    if stamps.size != steps:
        raise EvidenceError(f"times= has {stamps.size} of them, and the belief {steps} steps")
    sizes = np.ones(len(names))
    sizes[: len(straight)] = [_metres(gaussian, name) for name in straight]
    columns = dict(zip(names, (gaussian.mean[:, places] * sizes).T, strict=True))
    xyz, angles = np.zeros((len(stamps), 3)), np.zeros((len(stamps), 3))
    for k, name in enumerate(straight):
        xyz[:, k] = columns[name]
    for k, angle in enumerate((roll, pitch, heading)):
        if angle is not None:
            angles[:, k] = columns[angle]
    cov = gaussian.cov[:, places][:, :, places] * np.outer(sizes, sizes)
    if not np.isfinite(cov).all():
        step = int(np.argwhere(~np.isfinite(cov))[0, 0])
        raise ModelError(
            f"{gaussian._title} has an infinite variance in row {step}: its mean there means "
            "nothing; take the steps from which on it is known, belief[k:]"
        )
    return Trajectory(stamps, xyz, angles, names, cov)


def along(
    variable: Variable,
    rows: tuple[Array, Array],
    position: Any,
    heading: str | None,
    pitch: str | None,
    roll: str | None,
) -> Array:
    """Values (n, d) of a variable from places and angles (n, 3) each; see `Poses.along`."""
    any_belief = Gaussian(variable, np.zeros(variable.dimension), 1.0)
    straight = _position(position)
    turned = [(k, name) for k, name in enumerate((roll, pitch, heading)) if name is not None]
    places = _places(any_belief, (*straight, *(name for _, name in turned)))
    xyz, angles = rows
    found = np.full((len(xyz), variable.dimension), np.nan)
    for k, name in enumerate(straight):
        found[:, places[k]] = xyz[:, k] / _metres(any_belief, name)
    for place, (k, name) in zip(places[len(straight) :], turned, strict=True):
        _require_angle(any_belief, name)
        found[:, place] = angles[:, k]
    return found


def _require_angle(gaussian: Gaussian, name: str) -> None:
    if not gaussian.angles[gaussian.components.index(name)]:
        raise ModelError(
            f"{name!r} of {gaussian._title} is no angle; declare it as one, in radians: "
            f"pgm.Variable(..., angles=({name!r},))"
        )


def _gaussian(belief: Any) -> Gaussian:
    gaussian = belief.gaussian() if hasattr(belief, "gaussian") else belief
    if not isinstance(gaussian, Gaussian):
        raise ModelError(f"a belief over time, like posterior[x], was due, not {titled(belief)}")
    if gaussian.mean.ndim != 2:
        axes = gaussian.mean.shape[:-1]
        raise ModelError(
            f"{gaussian._title} has the leading axes {axes}; a trajectory is one run over its "
            "steps: pick it with belief.run(0)"
        )
    return gaussian


def _position(position: Any) -> tuple[str, ...]:
    names = as_tuple(position)
    if names is None or len(names) not in (2, 3) or is_unordered(position):
        raise ModelError(
            f"position= names two components or three, like ('east', 'north'); found {position!r}"
        )
    return names


def _places(gaussian: Gaussian, names: Sequence[str]) -> list[int]:
    known = gaussian.components
    for name in names:
        if name not in known:
            raise ModelError(f"{gaussian._title} has no component {name!r}; it has {listed(known)}")
        if names.count(name) > 1:
            raise ModelError(f"the component {name!r} is named twice, of {listed(names)}")
    return [known.index(name) for name in names]


def _metres(gaussian: Gaussian, name: str) -> float:
    """How many metres the unit of a component is; one without a unit is in metres."""
    unit = gaussian.units[gaussian.components.index(name)] or "m"
    size = factor(unit, "m")
    if size is None:
        raise ModelError(
            f"{name!r} of {gaussian._title} is in {in_words(unit)} and no position, whose unit is "
            f"one of {listed(of_quantity(LENGTH), 9)}"
        )
    return size


def increasing(times: npt.ArrayLike) -> Array:
    """The times of some rows, seconds, increasing."""
    stamps = as_stamps("times", times)
    if (late := np.diff(stamps) <= 0.0).any():
        row = int(late.argmax()) + 1
        raise EvidenceError(
            f"times= do not increase: {clock(stamps[row])} in row {row} does not come after "
            f"{clock(stamps[row - 1])}"
        )
    return stamps
