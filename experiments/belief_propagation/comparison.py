"""The part of the experiment that compares ways to compile a network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from experiments.belief_propagation import figures
from experiments.belief_propagation.drawn import KINDS, Parents, grid, leaves, observe, scattered
from experiments.belief_propagation.loops import Numbers
from experiments.belief_propagation.methods import ROOMS, averaged, compare
from experiments.belief_propagation.repository import stored
from experiments.record import Record, progress

By = Mapping[str, Mapping[str, Numbers]]  # network and method

OBSERVED = 5
_GRAPH = {"clusters": "clusters", "sepsets": "sepsets", "largest": "largest"}
_RUN = {"log_evidence_error": "Δ ln p(e)", "iterations": "iter.", "converged": "conv."}
_COLUMNS = {
    "discrete": {"error_mean": "mean error", "error_max": "max error"},
    "gaussian": {
        "mean_error_max": "means",
        "variance_error_mean": "variances",
        "variance_error_max": "max",
    },
}
_LOOPS = (
    "Largest: the largest cluster, in entries or components; Δ ln p(e): the log-evidence less the "
    "exact one; iter.: iterations until messages rest; conv.: whether they do, or in what share of "
    "networks; ms: from the network to all marginals."
)
_ABOUT = {
    "discrete": f"Errors are those of a probability in a marginal. {_LOOPS}",
    "gaussian": "Means: their largest error, in exact standard deviations; variances and max: the "
    f"mean and the largest error of a variance, relative to the exact one. {_LOOPS}",
}


def compare_methods(
    record: Record, names: Sequence[str], *, seed: int, side: int, count: int, draws: int
) -> dict[str, By]:
    """Write tables and a figure; the numbers by kind of network, network and method."""
    shapes = {
        f"grid {side}×{side}": partial(grid, side),
        f"random, {count} variables": partial(scattered, count),
    }
    found: dict[str, dict[str, dict[str, Numbers]]] = {}
    for kind, make in KINDS.items():
        found[kind] = {}
        for shape, draw in shapes.items():
            each = []
            for k in progress(range(seed, seed + draws), f"{kind}, {shape}"):
                rng = np.random.default_rng(k)
                parents: Parents = draw(rng)
                network = make(parents, rng)
                each.append(compare(network, observe(network, network.variables, OBSERVED, k)))
            found[kind][shape] = averaged(each)
        _table(record, f"{kind} networks, means of {draws}", kind, found[kind])
    _note_columns(record)
    found["repository"] = _repository(record, seed, names)
    record.figure(
        figures.methods(found["discrete"], found["gaussian"]),
        "methods",
        "Errors against the size of the largest cluster, of networks drawn at random: left, the "
        "mean error of a probability in a marginal of discrete ones, right, the mean relative "
        "error of a variance of Gaussian ones. Join graphs have larger and larger clusters, from "
        "what Bethe and LTRIP do with the smallest to what is exact with the largest.",
    )
    return dict(found)


def _repository(record: Record, seed: int, names: Sequence[str]) -> dict[str, dict[str, Numbers]]:
    """Networks that others made, with evidence on some leaves."""
    found: dict[str, dict[str, Numbers]] = {}
    lost = []
    for name in progress(names, "networks of the repository"):
        network = stored(name)
        if network is None:
            lost.append(name)
        else:
            found[name] = compare(network, observe(network, leaves(network), OBSERVED, seed))
    if found:
        _table(record, f"known networks, {OBSERVED} leaves observed", "discrete", found)
    if lost:
        record.note(f"left out, since pgmpy with its files is not installed: {', '.join(lost)}")
    return found


def _table(record: Record, title: str, kind: str, found: By) -> None:
    columns = {**_GRAPH, **_COLUMNS[kind], **_RUN}
    record.table(
        title,
        ("network", "graph", *columns.values(), "ms"),
        [
            (
                network if k == 0 else "",
                method,
                *(_cell(key, numbers[key]) for key in columns),
                f"{1e3 * numbers['seconds']:.0f}",
            )
            for network, methods in found.items()
            for k, (method, numbers) in enumerate(methods.items())
        ],
        about=_ABOUT[kind],
    )


def _cell(key: str, value: float) -> str:
    if key == "converged":
        return "yes" if value == 1.0 else f"{value:.0%}"
    if key == "mean_error_max":
        return f"{value:.0e}"
    return f"{value:.4f}" if "error" in key else f"{value:.0f}"


def _note_columns(record: Record) -> None:
    rooms = ", ".join(f"{2**room}" for room in ROOMS)
    record.note(
        f"Join graphs have clusters of up to {rooms} times the entries of the largest family, or "
        f"of up to {', '.join(map(str, ROOMS))} components more; largest is the largest cluster, "
        "in entries or components. Errors are the largest of a probability in a marginal; means "
        "in exact standard deviations; variances relative to the exact ones; of ln p(e) as it is. "
        "Time is from the network to all marginals; messages go one after the other where there "
        "are loops. Families of a grid share one variable at most: LTRIP then has the beliefs of "
        "the Bethe graph, with fewer clusters and iterations."
    )
