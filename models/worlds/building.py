"""A building as places and passages: doors, junctions and ends of corridors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

import pgm
from models.worlds.world import COMPASS, Array

# What is at each place, and its row and column; places side by side have a passage between them.
PLAN: dict[str, tuple[str, int, int]] = {
    "entrance": ("end", 3, 0),
    "office 1": ("door", 3, 1),
    "junction W": ("junction", 3, 2),
    "office 2": ("door", 3, 3),
    "office 3": ("door", 3, 4),
    "junction E": ("junction", 3, 5),
    "kitchen": ("end", 3, 6),
    "laboratory": ("door", 2, 2),
    "store": ("door", 2, 5),
    "corner NW": ("junction", 1, 2),
    "library": ("door", 1, 3),
    "workshop": ("door", 1, 4),
    "corner NE": ("junction", 1, 5),
    "stairs": ("end", 0, 5),
}
KINDS = ("door", "junction", "end")


@dataclass(frozen=True, eq=False)
class Building:
    """A robot among P places that has one of four headings, in the numbers of its CPDs.

        p(θ_t | θ_{t−1}, u_t),    p(x_t | x_{t−1}, θ_t, u_t),    p(k_t | x_t),    p(w_t | x_t, θ_t)

    Attributes
    ----------
    place, heading : Discrete
        x and θ, the states.
    action : Discrete
        u: ahead, left or right.
    kind, way : Discrete
        k and w, the readings: the kind of place, and whether the way ahead is open.
    turning : ndarray
        (4, actions, 4), the last axis being the heading after the action.
    going : ndarray
        (P, 4, actions, P), the last axis being the place after the action.
    looks : ndarray
        (P, kinds).
    ahead : ndarray
        (P, 4, 2): open and blocked.
    places : ndarray
        (P, 2): row and column of each place, rows from the top.
    neighbour : ndarray
        (P, 4): the number of the next place in each direction, −1 without.
    """

    place: pgm.Discrete
    heading: pgm.Discrete
    action: pgm.Discrete
    kind: pgm.Discrete
    way: pgm.Discrete
    turning: Array
    going: Array
    looks: Array
    ahead: Array
    places: npt.NDArray[np.int_]
    neighbour: npt.NDArray[np.int_]

    def network(self, start: tuple[str, str] | None = None) -> pgm.DynamicBayesianNetwork:
        """The building as a network of two states and two sensors a slice; actions are an input.

        Parameters
        ----------
        start : pair of str, optional
            Place and heading at step 0; without, nothing is known of them.
        """
        x, heading, u = self.place, self.heading, self.action
        first = [np.full(v.size, 1.0 / v.size) for v in (x, heading)]
        if start is not None:
            first = [np.eye(v.size)[v.index(at)] for v, at in zip((x, heading), start, strict=True)]
        return pgm.DynamicBayesianNetwork(
            prior=[pgm.TableCPD(x, table=first[0]), pgm.TableCPD(heading, table=first[1])],
            transition=[
                pgm.TableCPD(heading, given=(heading.previous, u), table=self.turning),
                pgm.TableCPD(x, given=(x.previous, heading, u), table=self.going),
            ],
            observation=[
                pgm.TableCPD(self.kind, given=x, table=self.looks),
                pgm.TableCPD(self.way, given=(x, heading), table=self.ahead),
            ],
        )


def building(
    plan: Mapping[str, tuple[str, int, int]] = PLAN,
    *,
    turns: float = 0.9,
    goes: float = 0.85,
    recognised: float = 0.8,
    way_seen: float = 0.9,
) -> Building:
    """A robot that goes from place to place, sees the kind of place and whether it may go ahead.

    Told to turn it turns by a quarter and stays where it is; told to go ahead it goes to the next
    place in its direction, where there is one.

    Parameters
    ----------
    plan : mapping of str to (str, int, int)
        The kind of each place, its row from the top and its column.
    turns, goes : float
        Probabilities that a turn, and a step ahead, is executed.
    recognised, way_seen : float
        Probabilities that the kind of place, and the way ahead, is read as it is.

    Returns
    -------
    Building

    Raises
    ------
    ValueError
        If a kind is unknown.
    """
    strange = sorted({kind for kind, _, _ in plan.values()} - set(KINDS))
    if strange:
        raise ValueError(f"kinds of places {strange}; found, of {', '.join(KINDS)}")
    number = {(row, column): k for k, (_, row, column) in enumerate(plan.values())}
    neighbour = np.array(
        [
            [number.get((row + down, column + right), -1) for down, right in COMPASS.values()]
            for row, column in number
        ]
    )
    kinds = np.array([KINDS.index(kind) for kind, _, _ in plan.values()])
    mistaken = (1.0 - recognised) / (len(KINDS) - 1)
    seen_open = np.where(neighbour >= 0, way_seen, 1.0 - way_seen)
    return Building(
        place=pgm.Discrete("place", tuple(plan)),
        heading=pgm.Discrete("heading", tuple(COMPASS)),
        action=pgm.Discrete("action", ("ahead", "left", "right")),
        kind=pgm.Discrete("kind", KINDS),
        way=pgm.Discrete("way", ("open", "blocked")),
        turning=_turning(turns),
        going=_going(neighbour, goes),
        looks=np.where(kinds[:, None] == np.arange(len(KINDS)), recognised, mistaken),
        ahead=np.stack([seen_open, 1.0 - seen_open], axis=-1),
        places=np.array(list(number)),
        neighbour=neighbour,
    )


def _turning(turns: float) -> Array:
    """p(heading | heading before, action)."""
    same = np.eye(4)
    right = np.roll(same, 1, axis=1)  # north, east, south, west: the next is to the right
    turned = [same, turns * right.T + (1.0 - turns) * same, turns * right + (1.0 - turns) * same]
    return np.stack(turned, axis=1)


def _going(neighbour: npt.NDArray[np.int_], goes: float) -> Array:
    """p(place | place before, heading, action)."""
    count = len(neighbour)
    here = np.arange(count)
    moved = np.zeros((count, 4, 3, count))
    moved[here, :, 1:, here] = 1.0
    for heading in range(4):
        reached = np.where(neighbour[:, heading] >= 0, neighbour[:, heading], here)
        moved[here, heading, 0, here] += 1.0 - goes
        moved[here, heading, 0, reached] += goes
    return moved
