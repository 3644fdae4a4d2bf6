"""The report of a posterior: one page that says how far its answer may be trusted."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.inference import Posterior
from pgm.kernels.arrays import Array
from pgm.posteriors.summaries import spread
from pgm.variables import Variable
from pgm.viewer import chain
from pgm.viewer.assembly import REPORT as PAGE
from pgm.viewer.assembly import assembled
from pgm.viewer.numbers import REPORT, Numbers, chosen_runs, chosen_steps
from pgm.viewer.sections import sections, stretches
from pgm.viewer.truth import Truth, truths
from pgm.viewer.view import is_over_time


@public
def report(posterior: Posterior[Any], path: str | PathLike[str], truth: Truth | None) -> Path:
    """Write the page that `Posterior.report` describes."""
    target = Path(path)
    target.write_text(assembled(*_content(posterior, truth), PAGE), encoding="utf-8")
    return target


def _content(posterior: Posterior[Any], truth: Truth | None) -> tuple[dict[str, Any], Numbers]:
    true, numbers = truths(posterior, truth), Numbers()
    evidence = spread(np.asarray(posterior.log_evidence)).replace("-", "−")
    path, notes = _path(posterior, true, numbers)
    return {
        "title": posterior._title.removeprefix("Posterior(").removesuffix(")"),
        "facts": [f"ln p(evidence) {evidence} {posterior.log_evidence_kind}"],
        "sections": sections(posterior, true, numbers),
        "chain": path,
        "notes": notes,
    }, numbers


def _path(
    posterior: Posterior[Any], truth: Mapping[Variable, Array], numbers: Numbers
) -> tuple[dict[str, Any] | None, list[str]]:
    """The path of a chain, with the stretches at which it was lost, and notes on what is cut."""
    outcome = posterior._outcome
    if not is_over_time(outcome):
        return None, []
    runs, few = chosen_runs(None, np.shape(posterior.log_evidence), REPORT)
    span, cut = chosen_steps(None, posterior.graph.steps, REPORT)
    found = chain.page(outcome, numbers, runs, span, REPORT, truth, {})
    lost = stretches(posterior)
    for row in found["runs"]:
        row["lost"] = lost.get(tuple(row["run"]), [])
    return found, [note for note in (few, cut) if note]
