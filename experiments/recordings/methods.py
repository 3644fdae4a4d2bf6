"""Ways to estimate a recorded drive: each a call of the library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pgm
from experiments.recordings.drives import Drive
from experiments.recordings.settings import Ways
from pgm.cpds.robust import RobustNoise

LINEARISERS: dict[str, pgm.Lineariser] = {
    "Taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "cubature": pgm.Cubature(),
    "Gauss–Hermite 3": pgm.GaussHermite(3),
}


@dataclass(frozen=True)
class Method:
    """A schedule, with a gate or a robust noise.

    Attributes
    ----------
    about : str
        Itself, in words.
    noise : RobustNoise or None
        Of the sensor.
    run : callable
        From a network, its evidence and a lineariser to the posterior.
    """

    about: str
    run: Callable[..., pgm.results.Posterior]
    noise: RobustNoise | None = None

    def __call__(self, drive: Drive, lineariser: pgm.Lineariser) -> pgm.results.Posterior:
        """The posterior of a drive."""
        return self.run(drive.network(noise=self.noise), drive.evidence, lineariser=lineariser)


def _smooth(**settings: Any) -> Callable[..., pgm.results.Posterior]:
    return lambda model, evidence, **more: pgm.smooth(model, evidence, **settings, **more)


def _filter(**settings: Any) -> Callable[..., pgm.results.Posterior]:
    return lambda model, evidence, **more: pgm.filter(model, evidence, **settings, **more)


def methods(ways: Ways) -> dict[str, Method]:
    """All methods, with the settings of a recording."""
    gate, robust, many = ways.gate, ways.robust, ways.iterations
    return {
        "filter": Method("each sighting as it comes", _filter()),
        "gated filter": Method(f"without sightings beyond a gate of {gate:g}", _filter(gate=gate)),
        "robust filter": Method(f"sightings weighed by {robust!r}", _filter(), robust),
        "fixed lag": Method(f"given {ways.lag} more steps", _smooth(lag=ways.lag)),
        "smoother": Method("given all sightings", _smooth()),
        "iterated smoother": Method(
            f"linearised up to {many} times", _smooth(iterations=many, tolerance=1e-4)
        ),
        "robust smoother": Method(
            f"linearised and weighed up to {5 * many} times",
            _smooth(iterations=5 * many, tolerance=1e-3),
            robust,
        ),
    }
