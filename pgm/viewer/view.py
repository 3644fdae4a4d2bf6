"""The page of a posterior or map, which asks nothing of a network: a file, or in a cell."""

from collections.abc import Sequence
from html import escape
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.compile import DynamicGraph
from pgm.display import Shown
from pgm.errors import GraphError
from pgm.inference import GrowingMap, Posterior
from pgm.posteriors.outcome import (
    BY_PATTERN,
    CHAIN,
    MARGINALS,
    MIXTURES,
    SLICES,
    SWITCHING,
    Outcome,
)
from pgm.viewer import chain, graph, growing
from pgm.viewer.assembly import assembled
from pgm.viewer.moved import moved_by_step
from pgm.viewer.numbers import CELL, FILE, Limits, Numbers, Run, chosen_runs, chosen_steps
from pgm.viewer.truth import Truth, truths

# The forms of beliefs that a page shows step by step, and not cluster by cluster.
_OVER_TIME = (CHAIN, SLICES, MARGINALS, SWITCHING)


def is_over_time(outcome: Outcome[Any]) -> bool:
    """Whether a page shows beliefs step by step: those of a chain."""
    return outcome.kind is not None and outcome.form in _OVER_TIME


def _no_clusters(posterior: Posterior[Any]) -> str:
    """Why a page has no beliefs of clusters to show, for a refusal; empty where it has."""
    outcome = posterior._outcome
    if outcome.form == MIXTURES:
        return (
            f"view shows beliefs of clusters, and {posterior._title} has mixtures over the "
            "configurations of its discrete variables: print it, or plot its beliefs"
        )
    if outcome.form == BY_PATTERN:
        return (
            f"view shows beliefs of clusters, which are over other variables in runs with other "
            f"gaps, and {posterior._title} has several patterns of these: give runs of one to a "
            "call, print it, or plot its beliefs"
        )
    return ""


@public
def view(
    posterior: Posterior[Any] | GrowingMap,
    path: str | PathLike[str],
    *,
    run: int | Sequence[int] | Sequence[Run] | None = None,
    steps: tuple[int, int] | None = None,
    truth: Truth | None = None,
) -> Path:
    """Write a page on which a posterior's cluster graph, or a map's, is looked at in a browser.

    It is one file that needs no network: pan and zoom the graph, find a variable, click a cluster
    for its potential, its belief and the messages it received, or an edge for both messages. A
    chain has a slider over its steps and its trajectory beside it, an iterated schedule one over
    its iterations. Clusters are coloured by how far evidence moved a variable of theirs, in nats:
    of a chain the readings of the step, KL(filtered ‖ predicted); without time all evidence,
    KL(posterior ‖ prior), for which the prior is inferred, too. Clusters of several modes, as
    `pgm.estimate` has them without time, have mixtures, whose Gaussians are drawn beside their
    moments, and no messages and colours.

    Parameters
    ----------
    posterior : Posterior or GrowingMap
        Grids and particles have beliefs and no messages. Of a growing map it is the tree of cliques
        as it is now, with those marked that the last addition touched.
    path : str or path-like
        The file's path, like ``"run.html"``; an old one is replaced.
    run : int, tuple of int, or sequence of these tuples, optional
        Which runs of a batch; the first eight without.
    steps : (int, int), optional
        The first and the last step of a chain to show; all without, 20,000 at most.
    truth : mapping of Variable to array_like, or Sample, optional
        True values, shown beside the beliefs: of a state (*runs, T+1, d), of a hidden control
        (*runs, T, d), without time (*runs, d), or any without the axes of runs, for all of them;
        of discrete variables names or indices of states, without the last axis. NaN, or −1, is not
        known. Variables that were observed are left out, so that `model.sample()` may be given.

    Returns
    -------
    Path
        The file's path.

    Raises
    ------
    GraphError
        If it is neither posterior nor map, there is no such run or step, a page would not hold
        them, or the truth does not fit.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pgm.examples import b, pair
    >>> posterior = pgm.infer(pgm.compile(pair), {b: 0.5})
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     pgm.view(posterior, f"{folder}/run.html").name
    'run.html'
    """
    target = Path(path)
    target.write_text(assembled(*_content(posterior, run, steps, FILE, truth)), encoding="utf-8")
    return target


@public
def html(posterior: Posterior[Any] | GrowingMap) -> str:
    """The page of a posterior or map in a frame, for notebooks: small, and cut where it says so."""
    if isinstance(posterior, Posterior) and _no_clusters(posterior):
        return Shown._repr_html_(posterior)
    whole = assembled(*_content(posterior, None, None, CELL))
    return (
        f'<iframe srcdoc="{escape(whole, quote=True)}" sandbox="allow-scripts" '
        'title="Cluster graph, beliefs and messages" '
        'style="width:100%;height:720px;border:1px solid #8884;border-radius:6px"></iframe>'
    )


def _content(
    posterior: Any,
    run: Any,
    steps: tuple[int, int] | None,
    limits: Limits,
    truth: Truth | None = None,
) -> tuple[dict[str, Any], Numbers]:
    if isinstance(posterior, GrowingMap):
        return _of_map(posterior, run, steps, truth, limits)
    if not isinstance(posterior, Posterior):
        raise GraphError(
            f"view shows a posterior, as pgm.infer, filter and smooth return, or a growing map, "
            f"not {type(posterior).__name__}"
        )
    outcome = posterior._outcome
    if why := _no_clusters(posterior):
        raise GraphError(why)
    lead = np.asarray(posterior.log_evidence).shape
    runs, few = chosen_runs(run, lead, limits)
    numbers, true = Numbers(), truths(posterior, truth)
    if is_over_time(outcome):
        span, cut = chosen_steps(steps, posterior.graph.steps, limits)
        changes = moved_by_step(posterior) if limits.moved else {}
        found = chain.page(outcome, numbers, runs, span, limits, true, changes)
    elif steps is not None:
        raise GraphError("steps=(first, last) cuts a chain; this graph has no steps: leave it out")
    else:
        found = graph.page(outcome, numbers, runs, limits, true)
        cut = found["cut"]
    found["notes"] = [note for note in (few, cut) if note]
    found["evidence"] = str(posterior.log_evidence_kind)
    found["graph"] = _named(posterior)
    return found, numbers


def _of_map(
    grown: GrowingMap, run: Any, steps: Any, truth: Any, limits: Limits
) -> tuple[dict[str, Any], Numbers]:
    for name, value in (("run", run), ("steps", steps), ("truth", truth)):
        if value is not None:
            raise GraphError(f"{name}={value!r}: a growing map has no {name}; leave it out")
    if not len(grown.cliques):
        raise GraphError("view: the growing map has no hidden variable yet; add some CPDs first")
    numbers = Numbers()
    found = growing.page(grown, numbers, limits)
    found["notes"] = [found["cut"]] if found["cut"] else []
    found["graph"] = "growing map"
    return found, numbers


def _named(posterior: Posterior[Any]) -> str:
    outcome = posterior._outcome
    if is_over_time(outcome):
        return outcome.called
    if isinstance(posterior.graph, DynamicGraph):
        return "balanced tree"
    return "cluster tree" if posterior.graph.is_tree else "cluster graph with loops"
