"""Sweeps along a chain of slices, and the chain families that they carry.

A *slice* is the hidden variables of one step; cluster t of the chain has those of step t, and t
runs from 0 to T. A *family* is a kind of belief: moments, tables or particles. It says how a belief
starts, is predicted, takes the measurements of a step, and flows back; a sweep knows nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol, TypeVar

from pgm.kernels.arrays import Array
from pgm.progress import counted

B = TypeVar("B")
C = TypeVar("C", contravariant=True)


class Onwards(Protocol[B]):
    """The forward half of a family: messages from cluster 0 to cluster T."""

    def start(self) -> B:
        """The belief over the slice at step 0, before its measurements."""

    def predict(self, step: int, belief: B) -> B:
        """The belief over a step's slice, predicted from the slice before."""

    def take(self, step: int, belief: B) -> tuple[B, Array | float]:
        """The belief given the measurements of its step, and their log-density, (*runs)."""


class Record(Protocol[C]):
    """The keeper of a forward sweep's beliefs: the sweep calls `keep` once for each step."""

    def keep(self, step: int, predicted: C, known: C, log_density: Array | float) -> None:
        """Keep a step: its beliefs, and the log-density of its measurements, (*runs).

        `predicted` is the belief before these measurements, `known` the belief given them.
        """


class Backwards(Protocol[B]):
    """The backward half of a family, for evidence that a forward sweep has taken in.

    What flows back is, of moments, the belief over a slice given all evidence; of tables, the
    message that later evidence sends to a slice.
    """

    def back(self, step: int, belief: B) -> B:
        """The belief of a step that flows back from `belief`, that of the step after."""


def forward(family: Onwards[B], steps: int, record: Record[B]) -> None:
    """Send the messages from cluster 0 to cluster T = `steps`, with each step's measurements.

    `record` is told each step's beliefs, before and after these, and their log-density.
    """
    belief = family.start()
    for step in counted(range(steps + 1), "forward"):
        if step:
            belief = family.predict(step, belief)
        known, log_density = family.take(step, belief)
        record.keep(step, belief, known, log_density)
        belief = known


def backward(family: Backwards[B], steps: int, last: B) -> Iterator[tuple[int, B]]:
    """Pairs of a step and what flows back to it, from step T = `steps` down to 0.

    For moments the belief given all evidence flows back; for tables it is the message that later
    evidence sends. `last` is that belief, or message, at step T.
    """
    belief = last
    yield steps, belief
    for step in counted(range(steps - 1, -1, -1), "back"):
        belief = family.back(step, belief)
        yield step, belief
