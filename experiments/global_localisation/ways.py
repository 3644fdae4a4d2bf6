"""The ways of finding a robot that may be anywhere: particles and a grid, of two sensor models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import pgm
import pgm.maps
from experiments.global_localisation.world import ANGLES, MOST, World, scan
from models.networks import pose

# The likelihood field: ranges of a start's cells are off by some decimetres, which `std` and
# `weight` allow for; what the map has wrong, and beams that it cannot tell from others, `random`.
FIELD: dict[str, Any] = {"std": 0.2, "hit": 0.5, "random": 0.5, "weight": 0.3}
# The beam model is of every third beam: casting takes its time.
BEAM: dict[str, Any] = {"std": 0.2, "hit": 0.7, "short": 0.1, "maximum": 0.05, "random": 0.15}
EVERY, BEAM_WEIGHT = 3, 0.5
# Where the house is [m].
BOUNDS = {"east": (0.3, 26.7), "north": (0.3, 14.1)}
GRID, FIELDS, KLD, BEAMS = "grid", "particles, field", "particles, field, KLD", "particles, beams"


@dataclass(frozen=True)
class Sizes:
    """How fine everything is.

    Attributes
    ----------
    particles : int
    spacing : float
        Of the cells that a start is drawn from [m].
    headings : int
        Of these cells.
    cell : float
        Of the grid [m].
    turns : int
        Cells of the grid's headings.
    """

    particles: int = 2000
    spacing: float = 0.25
    headings: int = 24
    cell: float = 0.2
    turns: int = 48

    def numbers(self) -> pgm.KLDSampling:
        """As many particles as their spread needs, no more than there were at the start."""
        widths = {"east": 0.25, "north": 0.25, "heading": 0.2}
        return pgm.KLDSampling(widths, least=min(200, self.particles), most=self.particles)

    def grid(self) -> pgm.Grid:
        """The grid."""
        axes: dict[str | pgm.Variable, Any] = {
            name: (low, high, round((high - low) / self.cell))
            for name, (low, high) in BOUNDS.items()
        }
        return pgm.Grid(axes | {"heading": self.turns})


def field(world: World, **changes: float) -> pgm.maps.LikelihoodField:
    """The likelihood field of the laser."""
    settings = FIELD | changes
    return pgm.maps.LikelihoodField(scan, pose, world.map, angles=ANGLES, most=MOST, **settings)


def beams(world: World) -> pgm.maps.BeamModel:
    """The beam model of the laser, of some of its beams."""
    return pgm.maps.BeamModel(
        scan, pose, world.map, angles=ANGLES, most=MOST, every=EVERY, weight=BEAM_WEIGHT, **BEAM
    )


def cells(world: World, spacing: float, headings: int, temper: float = 1.0) -> pgm.CellProposal:
    """Cells of poses indoors, from which particles are drawn by the likelihood of a scan."""
    centres = world.map.poses(spacing, headings, world.indoors)
    widths = (spacing, spacing, 2.0 * np.pi / headings)
    return pgm.CellProposal(pose, centres, widths, temper=temper)
