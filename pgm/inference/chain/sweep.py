"""Sweeps along a chain of slices, forward and back, for any family of beliefs."""

from __future__ import annotations

from collections.abc import Iterator

from pgm.inference.chain.protocol import B, Backwards, Onwards, Record


def forward(family: Onwards[B], steps: int, record: Record[B]) -> None:
    """Send the messages from cluster 0 to cluster T, and take in the measurements of each step."""
    belief = family.start()
    for step in range(steps + 1):
        if step:
            belief = family.predict(step, belief)
        known, log_density = family.take(step, belief)
        record.keep(step, belief, known, log_density)
        belief = known


def backward(family: Backwards[B], steps: int, last: B) -> Iterator[tuple[int, B]]:
    """The steps and beliefs from T down to 0, given the last one: each knows all evidence."""
    belief = last
    yield steps, belief
    for step in range(steps - 1, -1, -1):
        belief = family.back(step, belief)
        yield step, belief
