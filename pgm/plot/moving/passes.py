"""The pictures of a run: which cluster is at work, and what is known of each step by then."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from pgm.inference import Kind

# A pass of more steps than this skips some.
_PICTURES = 100


class Frame(NamedTuple):
    """One picture of a run.

    back: Whether messages flow back, to the left.
    filtered: The last step that is filtered by now; all before are too.
    revised: The first and the last step whose belief later measurements have revised by now; the
        first is beyond the last where there is none.
    """

    step: int
    back: bool
    filtered: int
    revised: tuple[int, int]


def frames(kind: Kind, last: int, every: int | None) -> list[Frame]:
    """The pictures of a run in their order.

    A filter goes forward; a smoother then comes back; with a fixed lag each step forward revises
    the belief of the step so far behind.

    every: Steps from a picture to the next; as many as leave at most 100 a pass without.
    """
    every = every or max(1, math.ceil(last / _PICTURES))
    forward = [*range(0, last, every), last]
    return [*_forward(kind, forward), *_backward(kind, forward)]


def _forward(kind: Kind, steps: list[int]) -> Iterator[Frame]:
    for step in steps:
        behind = -1 if math.isinf(kind.lag) or not kind.lag else step - int(kind.lag)
        if step == steps[-1] and behind >= 0:
            behind = step  # no measurement is to come
        yield Frame(step, False, step, (0, behind))


def _backward(kind: Kind, steps: list[int]) -> Iterator[Frame]:
    if math.isinf(kind.lag):
        for step in reversed(steps):
            yield Frame(step, True, steps[-1], (step, steps[-1]))
