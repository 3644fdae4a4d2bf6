"""The size of a page: what it holds at most, and the choice of runs and steps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pgm.boundary import as_tuple, is_whole
from pgm.errors import GraphError

Run = tuple[int, ...]


@dataclass(frozen=True)
class Limits:
    """The most that a page holds.

    entries: Of a table; of larger ones the largest entries are kept, and the marginals.
    refuse: Whether more steps are an error, and not cut.
    """

    runs: int
    steps: int
    clusters: int
    entries: int
    numbers: int
    refuse: bool


FILE = Limits(8, 20_000, 2_000, 4_096, 8_000_000, True)
CELL = Limits(1, 200, 150, 256, 200_000, False)


def chosen_runs(
    run: int | Sequence[int] | Sequence[Run] | None, lead: Run, limits: Limits
) -> tuple[list[Run], str | None]:
    """The runs that a page shows, and a word about the others."""
    total = int(np.prod(lead))
    if run is None:
        count = min(total, limits.runs)
        found = [tuple(int(k) for k in np.unravel_index(r, lead)) for r in range(count)]
        note = f"{count} of {total:,} runs are shown; pgm.view(..., run=(k,)) shows run k"
        return found, note if count < total else None
    given = as_tuple(run)
    several = given is not None and all(as_tuple(each) is not None for each in given) and given
    wanted = [as_tuple(each) or () for each in several] if several else [_index(run)]
    if len(wanted) > limits.runs:
        raise GraphError(f"a page holds {limits.runs} runs, not {len(wanted)}; name fewer")
    for each in wanted:
        fits = len(each) == len(lead) and all(map(is_whole, each))
        if not fits or not all(-n <= k < n for k, n in zip(each, lead, strict=True)):
            raise GraphError(
                f"run={run!r}: there is no run {each}; the axes of runs are {lead}, and a run is "
                "a place along each of them"
            )
    found = [tuple(int(k) % n for k, n in zip(each, lead, strict=True)) for each in wanted]
    note = f"{len(found)} of {total:,} runs {'is' if len(found) == 1 else 'are'} shown"
    return found, note if len(found) < total else None


def _index(run: object) -> Run:
    return (run,) if isinstance(run, int | np.integer) else tuple(as_tuple(run) or ("none",))  # type: ignore[return-value]


def chosen_steps(
    steps: tuple[int, int] | None, last: int, limits: Limits
) -> tuple[range, str | None]:
    """The steps that a page shows, and a word about the others."""
    if steps is None:
        if last < limits.steps:
            return range(last + 1), None
        if limits.refuse:
            raise GraphError(
                f"a page holds {limits.steps:,} steps of a chain, which has {last + 1:,}; give "
                f"steps=(first, last), as steps=(0, {limits.steps - 1})"
            )
        note = f"steps 0 to {limits.steps - 1} of 0 to {last:,} are shown in this small page"
        return range(limits.steps), note
    ends = as_tuple(steps)
    if ends is None or len(ends) != 2 or not all(map(is_whole, ends)):
        raise GraphError(f"steps=(first, last) are two steps, not {steps!r}")
    first, end = map(int, ends)
    if not 0 <= first <= end <= last:
        raise GraphError(f"steps={steps!r}: the chain has the steps 0 to {last}")
    if end - first >= limits.steps:
        raise GraphError(f"a page holds {limits.steps:,} steps, not {end - first + 1:,}")
    note = f"steps {first:,} to {end:,} of 0 to {last:,} are shown"
    return range(first, end + 1), None if (first, end) == (0, last) else note
