"""A robot in a building of doors, junctions and ends of corridors, with a place and a heading.

Two states and two sensors a slice. In summary.json ``truth`` and ``actions`` are the drive,
``at_truth.<filter|smoother>.<place|heading>`` the mean probability of the right state over the
steps, and ``path`` the most probable places and headings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import pgm
import pgm.plot
from experiments.kinds import as_table
from experiments.record import Out, Record, Seed
from experiments.textbook import bayes_filter, discrete_bayes_filter, discrete_smoother
from experiments.worlds import at_step
from models import worlds
from models.worlds import Building

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int_]

# Round the building once, the places where the robot turns.
START = ("entrance", "east")
ROUTE = ("junction W", "corner NW", "corner NE", "junction E", "junction W", "entrance")
SHOWN = 5
QUICK: dict[str, Any] = {}


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive of T steps.

    Attributes
    ----------
    place, heading : ndarray
        (T+1,): numbers of the true states.
    action : ndarray
        (T,), of steps 1..T.
    kind, way : ndarray
        (T,): readings of steps 1..T.
    """

    place: Integers
    heading: Integers
    action: Integers
    kind: Integers
    way: Integers


def run(
    out: Out = None,
    seed: Seed = 0,
    steps: Annotated[int, typer.Option(min=1, help="Steps of the drive, at most.")] = 60,
) -> None:
    """A robot finds its place and heading among the doors and junctions of a building."""
    record = Record("topological", out, seed=seed, steps=steps, start=START, route=ROUTE)
    building = worlds.building()
    drive = driven(building, np.random.default_rng(seed), steps)
    model = building.network()
    evidence: dict[pgm.Variable, Any] = {
        building.action: drive.action,
        building.kind: drive.kind,
        building.way: drive.way,
    }
    posterior = pgm.smooth(model, evidence)
    best = pgm.most_probable(pgm.compile(model, steps=len(drive.action)), evidence)
    states = {"place": building.place, "heading": building.heading}
    truth = {"place": drive.place, "heading": drive.heading}
    beliefs = {
        kind: {name: as_table(found[state]) for name, state in states.items()}
        for kind, found in (("filter", posterior.filtered), ("smoother", posterior))
    }
    at_truth = {
        kind: {name: chance(table, truth[name]) for name, table in each.items()}
        for kind, each in beliefs.items()
    }
    due = textbook(building, drive)
    apart = max(
        float(np.abs(beliefs[kind][name].probabilities - due[kind][name]).max())
        for kind in beliefs
        for name in states
    )
    record.table(
        f"Mean probability of the right state over {len(drive.action)} steps",
        ("belief", *states),
        [(kind, *each.values()) for kind, each in at_truth.items()],
        about="1 would be a belief that is sure and right at every step.",
        best=dict.fromkeys(states, np.inf),
    )
    record.note(
        f"largest difference from the textbook, whose states are pairs of place and heading: "
        f"{apart:.2g}"
    )
    record.figure(
        _network(model),
        "network",
        "Two slices of the network: place and heading, what is seen of them (the kind of place, "
        "the ways that are open), and the action. Shaded: known.",
    )
    record.figure(
        _maps(building, drive, beliefs),
        "places",
        "Probabilities of the places of a building at some steps, above given the readings so "
        "far, below given all. Framed: the robot. D: door, J: junction, E: end of a corridor.",
    )
    record.figure(
        _rows(drive, beliefs),
        "over_time",
        "Place and heading through time, every second step a row: bars are probabilities, filtered "
        "and smoothed; dotted: the robot's. The filter takes one end of the building for the other "
        "until a junction tells them apart.",
    )
    record.summary(
        truth={name: [states[name].states[k] for k in truth[name]] for name in states},
        actions=[building.action.states[k] for k in drive.action],
        at_truth=at_truth,
        path={
            name: [state.states[k] for k in np.ravel(best.assignment[state])]
            for name, state in states.items()
        },
        log_evidence=float(posterior.log_evidence),
        largest_difference=apart,
    )


def driven(building: Building, rng: np.random.Generator, steps: int) -> Drive:
    """A robot that knows where it is follows the route, until it is there or the steps are over."""
    place = [building.place.index(START[0])]
    heading = [building.heading.index(START[1])]
    action: list[int] = []
    goals = [building.place.index(name) for name in ROUTE]
    while goals and len(action) < steps:
        down, right = np.sign(building.places[goals[0]] - building.places[place[-1]]).tolist()
        wanted = list(worlds.COMPASS.values()).index((down, right))
        turn = (wanted - heading[-1]) % 4
        action.append({0: 0, 3: 1}.get(turn, 2))  # ahead, left, or right, about-turns too
        u = action[-1]
        heading.append(int(rng.choice(4, p=building.turning[heading[-1], u])))
        place.append(
            int(rng.choice(building.place.size, p=building.going[place[-1], heading[-1], u]))
        )
        if place[-1] == goals[0]:
            goals.pop(0)
    poses = list(zip(place[1:], heading[1:], strict=True))
    return Drive(
        np.array(place),
        np.array(heading),
        np.array(action),
        np.array([rng.choice(building.kind.size, p=building.looks[at]) for at, _ in poses]),
        np.array([rng.choice(2, p=building.ahead[at, towards]) for at, towards in poses]),
    )


def chance(belief: pgm.Table, truth: Integers) -> float:
    """The mean probability of the right states."""
    return float(belief.probabilities[np.arange(len(truth)), truth].mean())


def textbook(building: Building, drive: Drive) -> dict[str, dict[str, Array]]:
    """Beliefs of place and heading by Algorithm 1, with one state for each pair of the two."""
    places, headings = building.place.size, building.heading.size
    pairs = places * headings
    motion = np.einsum("huk,pkuq->phuqk", building.turning, building.going)
    sensor = building.looks[:, None, :, None] * building.ahead[:, :, None, :]
    one_step = partial(
        discrete_bayes_filter,
        motion=motion.reshape(pairs, -1, pairs),
        sensor=sensor.reshape(pairs, -1),
    )
    initial = np.full(pairs, 1.0 / pairs)
    readings = (building.way.size * drive.kind + drive.way).tolist()
    steps = bayes_filter(one_step, initial, drive.action.tolist(), readings)
    found = {
        "filter": np.array([initial, *(step.filtered for step in steps)]),
        "smoother": np.array(discrete_smoother(initial, steps)),
    }
    return {
        kind: {
            "place": belief.reshape(-1, places, headings).sum(axis=2),
            "heading": belief.reshape(-1, places, headings).sum(axis=1),
        }
        for kind, belief in found.items()
    }


def _network(model: pgm.DynamicBayesianNetwork) -> Figure:
    figure, ax = plt.subplots(figsize=(6.0, 4.5), layout="constrained")
    pgm.plot.network(model, steps=1, ax=ax)
    plt.close(figure)
    return figure


def _maps(building: Building, drive: Drive, beliefs: dict[str, dict[str, pgm.Table]]) -> Figure:
    shown = np.linspace(0, len(drive.action), SHOWN).round().astype(int).tolist()
    figure, axes = plt.subplots(
        len(beliefs), len(shown), figsize=(3.4 * len(shown), 4.6), layout="constrained"
    )
    for line, (kind, each) in zip(axes, beliefs.items(), strict=True):
        for ax, step in zip(line, shown, strict=True):
            pgm.plot.belief_map(
                at_step(each["place"], step),
                places=building.places,
                most=1.0,
                truth=int(drive.place[step]),
                numbers=False,
                ax=ax,
            )
            _name_kinds(ax, building, each["place"].probabilities[step])
        line[0].set_ylabel(kind)
    for ax, step in zip(axes[0], shown, strict=True):
        told = f", after {building.action.states[drive.action[step - 1]]}" if step else ""
        ax.set_title(f"step {step}{told}", fontsize="medium")
    figure.colorbar(axes[0, 0].collections[0], ax=axes, label="probability", shrink=0.7)
    plt.close(figure)
    return figure


def _name_kinds(ax: Axes, building: Building, chances: Array) -> None:
    """Letters of the kinds of places, in a corner of the cells, and no frame around the map."""
    kinds = building.looks.argmax(axis=-1)
    for (row, column), kind, p in zip(building.places.tolist(), kinds, chances, strict=True):
        letter = building.kind.states[kind][0].upper()
        colour = "white" if p > 0.5 else "#555555"
        ax.text(column - 0.36, row - 0.36, letter, fontsize="x-small", va="top", color=colour)
    rows, columns = building.places.max(axis=0)
    ax.set(xlim=(-0.55, columns + 0.55), ylim=(rows + 0.55, -0.55))
    for side in ax.spines.values():
        side.set_visible(False)


def _rows(drive: Drive, beliefs: dict[str, dict[str, pgm.Table]]) -> Figure:
    figure, axes = plt.subplots(
        1, 2, figsize=(13.0, 9.0), layout="constrained", width_ratios=(14, 5)
    )
    for ax, name in zip(axes, ("place", "heading"), strict=True):
        filtered, smoothed = (each[name] for each in beliefs.values())
        truth = getattr(drive, name)
        pgm.plot.beliefs_over_time(filtered, label="filtered", truth=truth, full=1.0, ax=ax)
        pgm.plot.beliefs_over_time(smoothed, label="smoothed", ax=ax)
    axes[1].set_ylabel("")
    axes[1].get_legend().remove()  # one is enough
    plt.close(figure)
    return figure
