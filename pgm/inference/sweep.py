"""Sweeps along a chain of slices, and the chain families that they carry.

A family is a kind of belief, moments or tables. It says how a belief starts, is predicted, takes
the measurements of a step, and flows back; a sweep knows nothing else.
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
    """The record of a forward sweep."""

    def keep(self, step: int, predicted: C, known: C, log_density: Array | float) -> None:
        """Keep a step: its beliefs, and the log-density of its measurements, (*runs).

        `predicted` is the belief before these measurements, `known` the belief given them.
        """


class Backwards(Protocol[B]):
    """A reversed chain: the model of the past given the future, for the same evidence."""

    def back(self, step: int, belief: B) -> B:
        """The belief over a step's slice given all evidence, from the slice after."""


def forward(family: Onwards[B], steps: int, record: Record[B]) -> None:
    """Send the messages from cluster 0 to cluster T, and take in the measurements of each step."""
    belief = family.start()
    for step in counted(range(steps + 1), "forward"):
        if step:
            belief = family.predict(step, belief)
        known, log_density = family.take(step, belief)
        record.keep(step, belief, known, log_density)
        belief = known


def backward(family: Backwards[B], steps: int, last: B) -> Iterator[tuple[int, B]]:
    """Pairs of a step and its belief given all evidence, from step T = `steps` down to 0.

    `last` is the belief at T given all evidence.
    """
    belief = last
    yield steps, belief
    for step in counted(range(steps - 1, -1, -1), "back"):
        belief = family.back(step, belief)
        yield step, belief
