"""A robot that knows the house, but not where in it it is: particles beside a grid.

Drives between random places of a house, past which a laser scans. Nothing is known of the first
pose but that it is indoors. Particles are drawn from the likelihood of the first scan over cells;
the grid filter, of the same network, is what they could do at best. In summary.json
``success.<way>`` has the share of drives whose last estimate is right, with Wilson's interval of
95 %, and ``relative``, that share over the grid's; ``by_step`` the shares by step; ``choices`` of
other settings of the particles; ``seconds`` of a processor that each way took; ``number`` the
mean number of particles by step; ``shown`` which drive is drawn.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

import pgm
from experiments import house
from experiments.global_localisation import figures, ways
from experiments.global_localisation.filters import Way, follow
from experiments.global_localisation.places import NEAR, TURNED, Share, right
from experiments.global_localisation.shown import Shown, animate
from experiments.global_localisation.ways import BEAMS, FIELDS, GRID, KLD, Sizes
from experiments.global_localisation.world import ANGLES, LASER, MOST, STEP, Drives, World
from experiments.record import Out, Record, Seed, note, progress

QUICK: dict[str, Any] = {
    "runs": 4,
    "steps": 4,
    "particles": 300,
    "spacing": 0.5,
    "headings": 12,
    "cell": 0.6,
    "turns": 24,
}
# Drives that other choices are judged by.
CHOOSING = 100
LASER_WORDS = (
    f"{len(ANGLES)} beams all round, {MOST:g} m, of which {LASER['short']:.0%} meet what is not on "
    f"the map, {LASER['maximum']:.0%} nothing, and {LASER['random']:.0%} say anything"
)


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=2, max=10_000, help="Drives.")] = 200,
    steps: Annotated[int, typer.Option(min=3, max=60, help="Steps of a drive, of 40 cm.")] = 20,
    particles: Annotated[int, typer.Option(min=10, help="Particles of a drive.")] = 2000,
    spacing: Annotated[
        float, typer.Option(min=0.1, help="Between the cells that a start is drawn from [m].")
    ] = 0.25,
    headings: Annotated[int, typer.Option(min=4, help="Headings of these cells.")] = 24,
    cell: Annotated[float, typer.Option(min=0.05, help="Width of the grid's cells [m].")] = 0.2,
    turns: Annotated[int, typer.Option(min=4, help="Headings of the grid's cells.")] = 48,
) -> None:
    """Find a robot in a house from its laser scans: particles, beside a grid as the ceiling."""
    if house.find() is None:
        note(f"global_localisation: {house.MISSING}")
        return
    sizes = Sizes(particles, spacing, headings, cell, turns)
    record = Record("global_localisation", out, seed=seed, runs=runs, steps=steps, **vars(sizes))
    world = World(house.load())
    drives = world.drives(runs, steps, np.random.default_rng(seed))
    field, beams = (world.network(each) for each in (ways.field(world), ways.beams(world)))
    start = ways.cells(world, spacing, headings)
    wide = ways.cells(world, 2.0 * spacing, headings)
    known: dict[str, Way] = {
        GRID: (field, sizes.grid()),
        FIELDS: (field, pgm.Particles(particles, seed=seed, start=start)),
        KLD: (field, pgm.Particles(particles, seed=seed, start=start, number=sizes.numbers())),
        BEAMS: (beams, pgm.Particles(particles // 4, seed=seed, start=wide)),
    }
    found = {
        name: follow(known[name], drives) for name in progress(list(known), "global_localisation")
    }
    few = drives.some(slice(0, CHOOSING))
    other = choices(world, few, sizes, seed)

    correct = {name: right(each.poses, drives.truth) for name, each in found.items()}
    judged = {name: Share.of(each[:, -1]) for name, each in correct.items()}
    ceiling = judged[GRID]
    lower = Share.of(correct[GRID][:CHOOSING, -1])  # of the drives that choices are judged by

    record.note(
        f"{runs} drives of {STEP * steps:g} m between random places of a house; {LASER_WORDS}. "
        f"Nothing is known of the start but that it is indoors. A drive ends right where the mean "
        f"of the heaviest mode is within {NEAR:g} m and {np.rad2deg(TURNED):.0f}° of the truth."
    )
    record.table(
        f"How many of {runs} drives end right",
        ("way", "particles", "right", "95 %", "over the grid's", "CPU [s]"),
        [
            (
                name,
                f"{found[name].number[:, -1].mean():.0f}" if name != GRID else "",
                share.value,
                share.interval,
                relative(share, ceiling),
                found[name].seconds,
            )
            for name, share in judged.items()
        ],
        about=f"Right: the share of {runs} drives that end right, with its 95 % interval "
        "(Wilson's); over the grid's: divided by the grid's share. Particles: the mean number at "
        "the last step. CPU: seconds for all drives.",
        best={"right": np.inf, "CPU [s]": -np.inf},
    )
    record.table(
        f"{FIELDS}: other choices, on the first {lower.runs} drives",
        ("choice", "right", "95 %", "over the grid's"),
        [
            (name, share.value, share.interval, relative(share, lower))
            for name, share in other.items()
        ],
        about="Each line changes one choice of the first line. Right: the share of drives that end "
        "right, with its 95 % interval; over the grid's: divided by the grid's share of these.",
        best={"right": np.inf},
    )
    record.note(
        "The grid has the same network as the particles of the likelihood field, so that it is "
        "their ceiling. The field is no density of scans: it rates places full of obstacles too "
        "high, and at first there are many that explain a scan better than the true one. A mode "
        "that few particles are left of is lost for good, while the grid comes back to it. A start "
        "drawn of the prior puts too few particles at each place. The beam model, which knows that "
        "beams do not pass walls, tells places apart sooner, at a price in time."
    )
    record.figure(
        figures.success(judged),
        "success",
        f"The share of {runs} drives that end right, by way of looking, with Wilson's intervals of "
        "95 %.",
    )
    record.figure(
        figures.errors({name: each.poses for name, each in found.items()}, drives.truth),
        "errors",
        "At each step, left, the share of drives whose estimate is right, and right, the error of "
        "the place [m]: the median drive, and the 90 % quantile dotted. The horizontal line is the "
        f"{NEAR:g} m within which a place is right.",
    )
    latest = int(found_at(correct[GRID]).argmax())
    alone = drives.some(slice(latest, latest + 1))
    shown = Shown.of(world, alone, known[GRID], known[FIELDS])
    last = max(int(found_at(correct[GRID])[latest]), 2)
    moments = sorted({0, last // 2, last, steps})
    record.figure(
        figures.maps(shown, moments),
        "map",
        "The drive that the grid took longest to find, in a house [m]: the particles' belief "
        "above, the larger a dot the heavier, and the grid's below, the darker the more probable. "
        "The cross or ring is the robot. At first many places explain a scan; moving leaves one.",
    )
    with record.file("drive.gif") as path:
        animate(shown, path)
    record.picture(
        "drive.gif",
        "The same drive, step by step: particles and the grid's belief in the house [m].",
    )
    record.summary(
        shown=latest,
        success={
            name: vars(share) | {"relative": relative(share, ceiling)}
            for name, share in judged.items()
        },
        by_step={name: each.mean(axis=0) for name, each in correct.items()},
        choices={name: vars(share) for name, share in other.items()},
        seconds={name: each.seconds for name, each in found.items()},
        number={name: each.number.mean(axis=0) for name, each in found.items()},
    )


def found_at(correct: npt.NDArray[np.bool_]) -> npt.NDArray[np.int_]:
    """The step from which on each drive (runs, T+1) is right; 0 where it does not end so."""
    from_end = np.argmin(correct[:, ::-1], axis=1)
    always = correct.all(axis=1)
    found: npt.NDArray[np.int_] = np.where(always | ~correct[:, -1], 0, correct.shape[1] - from_end)
    return found


def choices(world: World, drives: Drives, sizes: Sizes, seed: int) -> dict[str, Share]:
    """Particles of the likelihood field with one choice changed at a time."""
    start = ways.cells(world, sizes.spacing, sizes.headings)
    base: dict[str, Any] = {"start": start, "seed": seed}
    tempered = ways.cells(world, sizes.spacing, sizes.headings, temper=0.3)
    half = sizes.particles // 2
    cases: dict[str, tuple[dict[str, float], pgm.Particles]] = {
        "as above": ({}, pgm.Particles(sizes.particles, **base)),
        f"{half} particles": ({}, pgm.Particles(half, **base)),
        "start tempered, 0.3": ({}, pgm.Particles(sizes.particles, start=tempered, seed=seed)),
        "start of the prior": ({}, pgm.Particles(sizes.particles, seed=seed)),
        "weight 1": ({"weight": 1.0}, pgm.Particles(sizes.particles, **base)),
        "weight 0.1": ({"weight": 0.1}, pgm.Particles(sizes.particles, **base)),
        "deviation 0.1 m": ({"std": 0.1}, pgm.Particles(sizes.particles, **base)),
    }
    found = {}
    for name, (changes, particles) in cases.items():
        network = world.network(ways.field(world, **changes))
        followed = follow((network, particles), drives)
        found[name] = Share.of(right(followed.poses, drives.truth)[:, -1])
    return found


def relative(share: Share, ceiling: Share) -> float | None:
    """A share over the ceiling; None where that is zero."""
    return share.value / ceiling.value if ceiling.value else None
