"""Cost against size: what a step costs by the length of a drive, a simulation by how many run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.row import Prepare, part
from benchmarks.timing import Contender, medians
from benchmarks.work import robots, targets

STEPS = (100, 300, 1_000, 3_000, 10_000, 30_000, 100_000)
SIMULATIONS = (1, 10, 100, 1_000, 10_000, 100_000)
QUICK_STEPS = (1_000, 10_000, 20_000)
QUICK_SIMULATIONS = (1, 100, 10_000)
SHORT = {"taylor": "ekf", "unscented": "ukf"}


@dataclass(frozen=True, eq=False)
class Curve:
    """A kind of work of many sizes.

    Attributes
    ----------
    name : str
        A key of the summary.
    work : callable
        From a size to the work.
    contenders : mapping
        By library, what prepares its part.
    sizes, quick : tuple of int
    """

    name: str
    work: Callable[[int], Any]
    contenders: Mapping[str, Prepare]
    sizes: tuple[int, ...] = STEPS
    quick: tuple[int, ...] = QUICK_STEPS

    def measure(self, quick: bool, repeats: int) -> dict[str, dict[int, float]]:
        """Seconds a unit, by library and size; all sizes take turns."""
        ready: dict[tuple[str, int], Contender] = {}
        for size in self.quick if quick else self.sizes:
            work = self.work(size)
            for library, prepare in self.contenders.items():
                try:
                    ready[library, size] = prepare(work)
                except ImportError:
                    continue
        found: dict[str, dict[int, float]] = {}
        for (library, size), value in medians(ready, repeats).items():
            found.setdefault(library, {})[size] = value
        return found


def _simulations(rule: str) -> Curve:
    return Curve(
        f"{SHORT[rule]}_simulations",
        lambda size: robots.draw(size, 1, own_controls=True),
        {
            "pgm": part("pgm_robots", "filtering", rule),
            "dynamax": part("dynamax_robots", "one_step", rule),
        },
        SIMULATIONS,
        QUICK_SIMULATIONS,
    )


CURVES = [
    Curve(
        "filter",
        lambda size: robots.draw(1, size),
        {"pgm": part("pgm_robots", "filtering", "taylor")},
    ),
    Curve(
        "smoother",
        lambda size: robots.draw(1, size),
        {
            "pgm": part("pgm_robots", "smoothing", "taylor"),
            "dynamax": part("dynamax_robots", "smoothing", "taylor"),
        },
    ),
    Curve("balanced", targets.draw, {"pgm": part("pgm_targets", "smoothing", "balanced")}),
    Curve("iterated", robots.precise, {"pgm": part("pgm_robots", "thrice")}),
    _simulations("taylor"),
    _simulations("unscented"),
]
