"""A robot that is carried elsewhere in the middle of a drive: what finds it again.

World, laser and network are those of `global_localisation`, and so is what is right. The network
knows nothing of being carried: particles are where they were, until some are put elsewhere
(`pgm.Injection`), anywhere, or where the scan may be of. In summary.json ``success.<policy>`` has
the share of drives that end right, with Wilson's interval of 95 %, for ``none``, ``uniform`` and
``likelihood``, and for ``fresh``: a start drawn from the first scan after the robot was put down,
by which ``relative`` divides. ``by_step`` has the shares by step, ``injected`` the share of
particles put elsewhere by step, the mean over drives.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

import pgm
from experiments import house
from experiments.global_localisation import figures, ways
from experiments.global_localisation.experiment import relative
from experiments.global_localisation.filters import Way, follow
from experiments.global_localisation.places import NEAR, TURNED, Share, right
from experiments.global_localisation.world import STEP, World
from experiments.kidnapped.carried import FAR, carried
from experiments.kidnapped.pictures import injected, maps
from experiments.record import Out, Record, Seed, note, progress

QUICK: dict[str, Any] = {
    "runs": 4,
    "before": 3,
    "after": 4,
    "particles": 300,
    "spacing": 0.5,
    "headings": 12,
}
# How soon the averages of a scan's likelihood forget. The likelihood is tempered, and the averages
# are the mean of a beam, which falls little: the faster one has to follow at once.
SLOW, FAST = 0.1, 0.9
POLICIES = ("none", "uniform", "likelihood")
FRESH = "fresh"


def run(
    out: Out = None,
    seed: Seed = 0,
    runs: Annotated[int, typer.Option(min=2, max=10_000, help="Drives.")] = 200,
    before: Annotated[
        int, typer.Option(min=2, max=60, help="Steps until the robot is carried.")
    ] = 12,
    after: Annotated[int, typer.Option(min=2, max=60, help="Steps from there on.")] = 18,
    particles: Annotated[int, typer.Option(min=10, help="Particles of a drive.")] = 2000,
    spacing: Annotated[
        float, typer.Option(min=0.1, help="Between the cells that are drawn from [m].")
    ] = 0.35,
    headings: Annotated[int, typer.Option(min=4, help="Headings of these cells.")] = 18,
) -> None:
    """Carry a robot elsewhere: particles put nowhere, anywhere, or where the scan may be of."""
    if house.find() is None:
        note(f"kidnapped: {house.MISSING}")
        return
    record = Record(
        "kidnapped",
        out,
        seed=seed,
        runs=runs,
        before=before,
        after=after,
        particles=particles,
        spacing=spacing,
        headings=headings,
        slow=SLOW,
        fast=FAST,
    )
    world = World(house.load())
    drives = carried(world, runs, before, after, np.random.default_rng(seed))
    known = policies(world, particles, spacing, headings, seed)
    found = {name: follow(known[name], drives) for name in progress(list(known), "kidnapped")}
    fresh = follow(known["none"], drives.some(slice(None), before))
    poses = {name: each.poses for name, each in found.items()}
    poses[FRESH] = np.full_like(drives.truth, np.nan)
    poses[FRESH][:, before:] = fresh.poses
    correct = {name: right(each, drives.truth) for name, each in poses.items()}
    success = {name: Share.of(each[:, -1]) for name, each in correct.items()}
    shares = {name: each.injected.mean(axis=0) / particles for name, each in found.items()}

    record.note(
        f"{runs} drives of {before + after} steps of {STEP:g} m through a house; at step {before} "
        f"the robot is carried {FAR:g} m or more elsewhere, and its odometer tells of a step like "
        f"any other. {particles} particles, the start drawn from the first scan. Right is the mean "
        f"of the heaviest mode within {NEAR:g} m and {np.rad2deg(TURNED):.0f}° of the truth."
    )
    record.table(
        f"How many of {runs} drives are right after the robot was carried",
        ("policy", "right before", "right at the end", "95 %", "over a fresh start's", "injected"),
        [
            (
                name,
                float(correct[name][:, before - 1].mean()) if name != FRESH else "",
                share.value,
                share.interval,
                relative(share, success[FRESH]),
                f"{shares[name].sum():.0%}" if name in shares else "",
            )
            for name, share in success.items()
        ],
        about="Policies: particles put nowhere, anywhere, where the scan is likely, or all of them "
        "afresh by one who is told. Right: the share of drives, before the robot is carried and at "
        "the end, with its 95 % interval. Injected: particles put elsewhere, over all steps, as a "
        "share of their number.",
        best={"right at the end": np.inf},
    )
    record.note(
        f"Injected is the sum over all steps, as a share of the {particles} particles. Uniform "
        "draws are seldom at places that the next scan is likely at: "
        f"{success['uniform'].value:.1%} of the drives end right with them, "
        f"{success['likelihood'].value:.1%} with draws from the scan's likelihood, "
        f"{success[FRESH].value:.1%} with a start that is told of it. The share put elsewhere is "
        f"how far the likelihood of a beam has fallen: at the step of carrying "
        f"{shares['likelihood'][before]:.0%}, with an average that follows at once (fast={FAST:g})."
    )
    record.figure(
        figures.errors(poses, drives.truth, event=before),
        "errors",
        "At each step, left, the share of drives whose estimate is right, and right, the error of "
        "the place [m] (median, and 90 % quantile dotted); dashed, where the robot is carried, up "
        "to where all policies are the same.",
    )
    record.figure(
        injected(shares, before),
        "injected",
        "The share of particles put elsewhere at each step, the mean over drives; of `none`, none. "
        "Dashed, where the robot is carried: its scans become unlikely, and draws begin.",
    )
    record.figure(
        maps(world, drives.some(slice(0, 1)), known, before),
        "map",
        "The first of the drives, before and after the robot is carried (a policy a row, the house "
        "in metres): dots are particles, the larger the heavier, and the cross is the robot.",
    )
    record.summary(
        success={
            name: vars(share) | {"relative": relative(share, success[FRESH])}
            for name, share in success.items()
        },
        by_step={
            name: each[:, before if name == FRESH else 0 :].mean(axis=0)
            for name, each in correct.items()
        },
        injected=shares,
        seconds={name: each.seconds for name, each in found.items()} | {FRESH: fresh.seconds},
    )


def policies(world: World, count: int, spacing: float, headings: int, seed: int) -> dict[str, Way]:
    """Particles of the likelihood field by what is put elsewhere, their start being the same."""
    network = world.network(ways.field(world))
    likely, anywhere = (ways.cells(world, spacing, headings, temper) for temper in (1.0, 0.0))
    injections = (
        None,
        pgm.Injection(anywhere, slow=SLOW, fast=FAST),
        pgm.Injection(likely, slow=SLOW, fast=FAST),
    )
    return {
        name: (network, pgm.Particles(count, seed=seed, start=likely, injection=injection))
        for name, injection in zip(POLICIES, injections, strict=True)
    }
