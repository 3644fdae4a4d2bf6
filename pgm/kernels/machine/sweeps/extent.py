"""How much code a sweep is in straight lines, by which it is written in lines or in loops."""

from __future__ import annotations

from pgm.kernels.machine.emitter.processor import PROCESSOR
from pgm.kernels.machine.sweeps.told import Backward, Forward, Linearised, Mixture, Row, Windows

# Operations of a sweep forward and of one back from which on loops are compiled sooner and run no
# slower. Those of packs take twice as long to compile.
_FORWARD, _BACK = 3000, 1500


def is_long(chain: Forward | Backward | Mixture | Windows | Linearised, lanes: int) -> bool:
    """Whether a sweep of so many lanes is to be written in loops."""
    if isinstance(chain, Windows):
        return False  # they are written in lines alone
    if isinstance(chain, Mixture):
        chain = chain.ahead  # whose pairs are swept in a loop
    most = _BACK if isinstance(chain, Backward) else _FORWARD
    return operations(chain, lanes) > (most // 2 if lanes > 1 else most)


def operations(chain: Forward | Backward | Linearised, lanes: int) -> int:
    """The operations of a sweep of so many lanes in straight lines, about."""
    if isinstance(chain, Linearised):
        return sum(_of(row, lanes) + row.height**3 for row in (*chain.motions, *chain.sensors))
    n = chain.size
    if isinstance(chain, Backward):
        states, smooth = len(chain.states), bool(chain.smoothed)
        pushes = (smooth and bool(chain.reversed)) + bool(chain.controls)
        return 8 * states**3 + (smooth + 2 * pushes) * n**3
    found = n**3  # a look at covariances
    for motion in chain.motions:
        found += _of(motion, lanes) + 2 * motion.height * len(motion.parents) * n
    for sensor in chain.sensors:
        # Components on which it does not depend leave zeros, of which nothing is written.
        d, p = sensor.height, len(sensor.parents)
        found += _of(sensor, lanes) + (3 * n**2 * p) // 2 + 2 * d * n * p + 3 * d**2 * n
        if sensor.candidates is not None:  # with which a sighting is compared before it is read
            found += d * n * p + 2 * d**2 * n
    return found


def _of(row: Row, lanes: int) -> int:
    """The operations of a linearisation; a single run's points are worked on pack by pack."""
    if not row.curved:
        return 0
    n, d = len(row.parents), row.height
    # Of a function that is called there are differences.
    count = 16 * n * (n + d) if row.function is None else len(row.function.operations)
    if row.points is None:
        return count
    points = len(row.points.points)
    values = points if lanes > 1 else -(-points // PROCESSOR.registers[0])
    return values * count + points * (n**2 + 2 * n * d + d**2)
