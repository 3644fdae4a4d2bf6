"""Networks whose hidden modes or identities choose: targets that turn or cross, faults, a mirror.

The state of a target is that of `models.tracking`, (east, north, v_east, v_north) [m, m/s].

Sources: Bar-Shalom, Li and Kirubarajan, Estimation with Applications to Tracking and Navigation
(2001), chapter 11; Bar-Shalom and Fortmann, Tracking and Data Association (1988).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pgm
from models import tracking
from models.networks import fix, target

Array = NDArray[np.float64]

mode = pgm.Discrete("mode", states=("straight", "left", "right"))
fault = pgm.Discrete("fault", states=("none", "faulty"))
first, second, either = (
    pgm.Variable(name, components=("place", "speed")) for name in ("first", "second", "either")
)
blip = pgm.Variable("blip")
place = pgm.Variable("place", components=("east", "north"))
beacon = pgm.Variable("beacon", components=("east", "north"))
push = pgm.Variable("push", components=("east", "north"))
range_to = pgm.Variable("range")


def manoeuvring(
    dt: float = 1.0, rate: float = 0.12, densities: Mapping[str, float] | None = None
) -> pgm.DynamicBayesianNetwork:
    """A target that goes straight, or turns left or right, and changes its mind now and then.

    Parameters
    ----------
    dt : float
        Duration of a step [s].
    rate : float
        Of its turns [rad/s].
    densities : mapping of str to float, optional
        By mode the spectral density of its white-noise acceleration [m²/s³]; .01 straight, .1 in
        turns.
    """
    noise = {"straight": 0.01, "left": 0.1, "right": 0.1} | dict(densities or {})
    rates = {"straight": 0.0, "left": rate, "right": -rate}
    stay, change = 0.95, 0.025
    return pgm.DynamicBayesianNetwork(
        prior=[
            pgm.TableCPD(mode, table=[1.0, 0.0, 0.0]),
            pgm.GaussianCPD(target, [0.0, 0.0, 10.0, 0.0], np.diag([100.0, 100.0, 4.0, 4.0])),
        ],
        transition=[
            pgm.TableCPD(
                mode,
                given=mode.previous,
                table=[[stay, change, change], [2 * change, stay, 0.0], [2 * change, 0.0, stay]],
            ),
            pgm.SwitchingCPD(
                target,
                given=mode,
                cases={
                    name: pgm.LinearGaussianCPD(
                        target,
                        given={target.previous: tracking.known_turn(dt, turn)},
                        cov=tracking.white_acceleration(dt, noise[name]),
                    )
                    for name, turn in rates.items()
                },
            ),
        ],
        observation=[_fixes(25.0)],
    )


def one_motion(density: float = 2.0, dt: float = 1.0) -> pgm.DynamicBayesianNetwork:
    """The same target and fixes, as one motion of constant velocity has it, with larger noise."""
    model = manoeuvring(dt)
    return pgm.DynamicBayesianNetwork(
        prior=model.prior[1:],
        transition=[_white_motion(density, dt)],
        observation=model.observation,
    )


def crossing() -> pgm.DynamicBayesianNetwork:
    """Two targets on a line that come towards each other and pass; a blip is of `either`."""
    move = np.array([[1.0, 1.0], [0.0, 1.0]])
    drift = 0.002 * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    start, sure = {first: [-10.0, 0.5], second: [10.0, -0.5]}, np.diag([1.0, 0.01])
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(v, mean, sure) for v, mean in start.items()],
        transition=[pgm.LinearGaussianCPD(v, {v.previous: move}, cov=drift) for v in start],
        observation=[pgm.LinearGaussianCPD(blip, {either: [[1.0, 0.0]]}, cov=0.25)],
    )


class Crossing(NamedTuple):
    """A drawn crossing: places and speeds (runs, T+1, 4), blips (runs, 2T, 1), and their steps."""

    truth: Array
    blips: Array
    step: NDArray[np.intp]


def draw_crossing(runs: int, steps: int, clutter: float, seed: int) -> Crossing:
    """Two blips a step, in any order, each of nothing with the probability `clutter`."""
    rng = np.random.default_rng(seed)
    drawn = crossing().sample(steps=steps, runs=runs, rng=rng)
    truth = np.concatenate([drawn[first], drawn[second]], axis=-1)
    seen = truth[:, 1:, [0, 2]] + 0.5 * rng.standard_normal((runs, steps, 2))
    seen = np.where(rng.random((runs, steps, 2)) < clutter, rng.uniform(-30, 30, seen.shape), seen)
    blips = rng.permuted(seen, axis=-1).reshape(runs, 2 * steps, 1)
    return Crossing(truth, blips, np.repeat(np.arange(1, steps + 1), 2))


def mirrored() -> pgm.DynamicBayesianNetwork:
    """A robot that is pushed along a line of beacons, and hears its distance to each alone."""

    def distance(at: Array, of: Array) -> Array:
        found: Array = np.linalg.norm(of - at, axis=-1, keepdims=True)
        return found

    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(place, [0.0, 0.3], 1.0)],
        transition=[
            pgm.LinearGaussianCPD(place, {place.previous: np.eye(2), push: np.eye(2)}, cov=0.0025)
        ],
        observation=[pgm.NonlinearGaussianCPD(range_to, (place, beacon), distance, cov=0.01)],
    )


def faulty_fixes() -> pgm.DynamicBayesianNetwork:
    """A target whose receiver is now and then faulty for some steps, five in the mean.

    Its fixes have then a standard deviation of 40 m, and 5 m else.
    """
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(fault, table=[1.0, 0.0]), manoeuvring().prior[1]],
        transition=[
            pgm.TableCPD(fault, given=fault.previous, table=[[0.95, 0.05], [0.2, 0.8]]),
            _white_motion(0.3),
        ],
        observation=[
            pgm.SwitchingCPD(
                fix,
                given=fault,
                cases={"none": _fixes(25.0), "faulty": _fixes(1600.0)},
            )
        ],
    )


def plain_fixes(noise: pgm.RobustNoise | None = None) -> pgm.DynamicBayesianNetwork:
    """The same target with fixes of one kind, perhaps of robust noise."""
    return pgm.DynamicBayesianNetwork(
        prior=manoeuvring().prior[1:],
        transition=[_white_motion(0.3)],
        observation=[_fixes(25.0, noise)],
    )


def _white_motion(density: float, dt: float = 1.0) -> pgm.LinearGaussianCPD:
    return pgm.LinearGaussianCPD(
        target,
        given={target.previous: tracking.constant_velocity(dt)},
        cov=tracking.white_acceleration(dt, density),
    )


def _fixes(cov: float, noise: pgm.RobustNoise | None = None) -> pgm.LinearGaussianCPD:
    return pgm.LinearGaussianCPD(fix, given={target: np.eye(2, 4)}, cov=cov, noise=noise)
