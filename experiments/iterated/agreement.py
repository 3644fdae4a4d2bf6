"""Published numbers beside ours, in the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.iterated import growth
from experiments.iterated.methods import WORST, Grid, Score
from experiments.iterated.published import Comparison, furthest
from experiments.record import Record

Comparisons = Mapping[str, Mapping[str, Sequence[Comparison]]]
# Standard errors of the difference within which two numbers agree.
AGREE = 3.0


def comparisons(found: Comparisons) -> dict[str, Any]:
    """Of published numbers, for a summary."""
    return {
        case: {name: [one.as_dict() for one in each] for name, each in by_name.items()}
        for case, by_name in found.items()
    } | {"largest_z": max(furthest(by_name) for by_name in found.values())}


def published_page(
    record: Record, found: Comparisons, other: Mapping[str, Sequence[Comparison]], once: Score
) -> None:
    """Published numbers beside ours, and the case read in other ways.

    Parameters
    ----------
    record : Record
    found : mapping
    other : mapping
        By title of a reading.
    once : Score
        Of the unscented filter of the cubic case, linearised once.
    """
    record.table(
        "Published numbers and ours, plain iteration: RMSE, but where NEES stands",
        ("case and estimator", "n", "publ.", "ours", "s.e.", "z", "median"),
        [
            (
                " ".join((case, name, *_what(one))),
                str(one.number.method[1]),
                f"{one.number.value:g}",
                f"{one.mean:.3f}",
                f"{one.standard_error:.3f}",
                f"{one.z:+.1f}",
                f"{np.mean(one.medians):.3f}",
            )
            for case, by_name in found.items()
            for name, each in by_name.items()
            for one in each
        ],
        about="publ.: the published number; ours: its mean over seeds, with its standard error; z: "
        "ours less it in standard errors of the difference; median: that over runs. n: the number "
        "of linearisations.",
        folded=True,
    )
    everything = [one for by_name in found.values() for each in by_name.values() for one in each]
    inside = sum(abs(one.z) <= AGREE for one in everything)
    record.note(
        f"{inside} of {len(everything)} published numbers lie within {AGREE:g} standard errors of "
        "the difference, the published error taken equal to that of one seed of ours. Means are "
        f"heavy-tailed: the worst {WORST:.0%} of runs make {once.tail:.0%} of the squared errors "
        "of the cubic case's plain unscented filter, so medians over runs stand beside them. "
        "'After k relinearisations' are k + 1 linearisations, n."
    )
    readings = {growth.MAIN.title: found["cubic"]["Unscented"], **other}
    record.table(
        "The cubic case read in other ways: z of the published RMSE (unscented), one seed",
        ("reading", *(_short(one) for one in found["cubic"]["Unscented"])),
        [(title, *(f"{one.z:+.1f}" for one in each)) for title, each in readings.items()],
        about="A line a reading of the published text, a column a number: filter, smoother, and "
        "smoothers of so many linearisations. z within 3 does not speak against a reading.",
        folded=True,
    )
    agreeing = [title for title, each in readings.items() if furthest({title: each}) <= AGREE]
    record.note(
        "The first line, all seeds, is the case as it is taken here: the state before the first "
        "motion is N(5, 4), it is not read and does not count, and 8 cos 1.2k leads to state k. "
        "The authors' own programme reads 50 states, the first among them, with 8 cos 1.2k out of "
        f"the k-th: the second line. The numbers do not decide between readings all of whose |z| "
        f"are at most {AGREE:g}: {'; '.join(agreeing)}."
    )


def linearisations_caption(
    found: Mapping[str, Sequence[Comparison]], by_name: Mapping[str, Grid]
) -> str:
    """How far samples of the square sensor are apart."""
    rmse = (one for one in found["Unscented"] if one.number.quantity == "rmse")
    *_, compared = (one for one in rmse if one.number.method[0] == "smoother")
    count = compared.number.method[1]
    ours = by_name["Unscented"]["smoother"]["plain"][count]
    seeds = ", ".join(f"{value:.2f}" for value in compared.ours)
    medians = ", ".join(f"{value:.2f}" for value in compared.medians)
    return (
        f"The growth model: RMSE by number of linearisations, {len(ours.squares)} runs, with "
        "standard errors. Published, of other runs: × unscented, + Taylor. Ours to compare with "
        "them are in the table of published numbers, of larger samples: the square sensor needs "
        f"them. Its unscented smoother, {count} plain: published {compared.number.value:g}, "
        f"here {ours.score.rmse:.2f} (median run {ours.score.median:.2f}), there {seeds} (median "
        f"runs {medians})."
    )


def _what(one: Comparison) -> tuple[str, ...]:
    kind = one.number.method[0]
    return (kind,) if one.number.quantity == "rmse" else (kind, "NEES")


def _short(one: Comparison) -> str:
    kind, count = one.number.method
    return kind if count == 1 else str(count)
