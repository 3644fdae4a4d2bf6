"""How much code a sweep is in straight lines, by which it is written in lines or in loops."""

from __future__ import annotations

from pgm.kernels.machine.told import Backward, Forward, Row

# Operations from which on loops are compiled sooner, and run no slower.
_LONG = 2500


def is_long(chain: Forward | Backward) -> bool:
    """Whether a sweep is to be written in loops."""
    return operations(chain) > _LONG


def operations(chain: Forward | Backward) -> int:
    """The operations of a sweep in straight lines, about."""
    n = chain.size
    if isinstance(chain, Backward):
        states, pushes = len(chain.states), bool(chain.smoothed) + bool(chain.controls)
        return 4 * states**3 + pushes * 2 * n**3
    found = n**3  # a look at covariances
    for motion in chain.motions:
        found += _of(motion) + 2 * motion.height * len(motion.parents) * n
    for sensor in chain.sensors:
        d = sensor.height
        found += _of(sensor) + 2 * n**3 + 3 * d * n**2 + 3 * d**2 * n + d**3
    return found


def _of(row: Row) -> int:
    """The operations of a linearisation."""
    if row.function is None:
        return 0
    count, n, d = len(row.function.operations), len(row.parents), row.height
    if row.points is None:
        return count
    points = len(row.points.points)
    return points * (count + n**2 + 2 * n * d + d**2)
