"""One drive, followed by particles and on a grid, to be looked at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_rgba

import pgm
import pgm.plot
from experiments.global_localisation.filters import Way, beliefs, online, unwarned
from experiments.global_localisation.ways import BOUNDS
from experiments.global_localisation.world import Array, Drives, World
from models.networks import pose
from pgm.plot.drawing.colours import PALETTE
from pgm.plot.moving.movies import GifWriter

_RATE = 2  # pictures a second
WALLS = 0.75  # how dark they are, below beliefs
# From nothing, which shows the map, to the colour of the grid.
_CLEAR = LinearSegmentedColormap.from_list(
    "clear", [to_rgba(PALETTE[1], 0.0), to_rgba(PALETTE[1], 1.0)]
)


@dataclass(frozen=True, eq=False)
class Shown:
    """A drive and its beliefs.

    Attributes
    ----------
    world : World
    truth : ndarray
        (T+1, 3).
    grid : list of GridBelief
        By step, in the plane.
    particles : list of ParticleBelief
        By step.
    """

    world: World
    truth: Array
    grid: list[pgm.results.GridBelief]
    particles: list[pgm.results.ParticleBelief]

    @staticmethod
    def of(world: World, drive: Drives, grid: Way, particles: Way) -> Shown:
        """Follow a drive, the only one of its kind, by both."""
        with unwarned():
            each = [
                [held[pose][0] for held in beliefs(robot, robot.initial(), drive)]
                for robot in map(online, (grid, particles))
            ]
        plane = [belief.marginal("east", "north") for belief in each[0]]
        return Shown(world, drive.truth[0], plane, each[1])

    def draw_particles(self, step: int, ax: Axes) -> None:
        """The particles of a step."""
        draw_particles(self.world, self.particles[step], self.truth[step], ax)

    def draw_grid(self, step: int, ax: Axes) -> None:
        """The grid of a step: darkest where the robot most likely is."""
        pgm.plot.occupancy_map(self.world.map, ax=ax, alpha=WALLS)
        belief = self.grid[step]
        (east, north), values = belief.centres, belief.values
        sides = [c[1] - c[0] for c in (east, north)]
        ends = [
            (c[0] - side / 2, c[-1] + side / 2)
            for c, side in zip((east, north), sides, strict=True)
        ]
        ax.imshow(
            (values / values.max()).T ** 0.25,
            origin="lower",
            extent=(*ends[0], *ends[1]),
            cmap=_CLEAR,
            vmin=0.0,
            vmax=1.0,
        )
        # A ring, since the few cells of a robot that is found would be lost below a cross.
        ax.plot(
            *self.truth[step, :2],
            "o",
            color="black",
            markersize=11,
            markeredgewidth=1.5,
            markerfacecolor="none",
        )
        within(ax)


def draw_particles(
    world: World, belief: pgm.results.ParticleBelief, truth: Array, ax: Axes
) -> None:
    """Particles in the house, and a cross where the robot is."""
    pgm.plot.occupancy_map(world.map, ax=ax, alpha=WALLS)
    pgm.plot.particles(belief, truth=truth, colour=PALETTE[0], ticks=False, ax=ax)
    within(ax)


def within(ax: Axes) -> None:
    """The house alone, all of it."""
    ax.set_aspect("equal", adjustable="box")
    (left, right), (low, high) = BOUNDS.values()
    ax.set(
        xlim=(left - 0.5, right + 0.5),
        ylim=(low - 0.5, high + 0.5),
        xlabel="east [m]",
        ylabel="north [m]",
    )


def animate(shown: Shown, path: Path) -> None:
    """Write a GIF: particles, and the grid beside them."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 3.3), layout="constrained")
    writer = GifWriter(fps=_RATE)
    with writer.saving(figure, str(path), dpi=80):
        for step in range(len(shown.truth)):
            for ax in (left, right):
                ax.clear()
            shown.draw_particles(step, left)
            shown.draw_grid(step, right)
            left.set_title(f"particles, step {step}")
            right.set_title(f"grid, step {step}")
            if not step:
                figure.canvas.draw()  # a layout that is kept: nothing shakes
                figure.set_layout_engine("none")
            writer.grab_frame()
    plt.close(figure)
