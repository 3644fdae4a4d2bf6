"""Limits of ratios that must hold, all of one run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks import cliffs, memory, neighbours
from benchmarks.work import pose_graphs, repository, rooms

FASTER = (  # row, peer, how many times the peer's cost must be ours
    ("ekf_one_step", "dynamax", 1.3),
    ("ukf_one_step", "dynamax", 1.0),
    ("ekf_robots", "dynamax", 1.5),
    ("ukf_robots", "dynamax", 1.2),
    *(
        (f"repository_{name}", peer, asked)
        for name in repository.NAMES
        for peer, asked in (("pyagrum", 1.5), ("pgmpy", 20.0))
    ),
    *((f"sets_{name}", "pyagrum", 20.0) for name in repository.NAMES),
    ("munin1", "pyagrum", 1.0),
    ("particles_own", "particles", 1.8),
    ("particles_plain", "particles", 1.4),
    ("particles_backwards", "pgm_full", 20.0),
    ("likelihood_field", "amcl", 10.0),
    *((f"no_jacobian_{runs}", "pgm_differences", 2.0) for runs in ("one", "many")),
    *((f"reading_{name}", "pgmpy", 1.0) for name in (*repository.NAMES, *repository.LARGE)),
)
CHEAPER = (  # row, peer, how many times our cost may be the peer's
    ("rts_taylor", "filterpy", 1.2),
    ("rts_unscented", "filterpy", 0.5),
    ("online_taylor", "filterpy", 1.3),
    ("online_unscented", "filterpy", 0.6),
    *((f"imm_{modes}", "filterpy", 0.6) for modes in (2, 3, 5)),
    *((f"gpb2_{modes}", "filterpy", 0.6) for modes in (2, 3)),
    *((name, "stonesoup", 0.4) for name in ("grid_filter", "grid_wide_filter")),
)
FASTEST = (  # row, peer, how many times our cost its fastest way must be
    ("markov_1000", "dynamax", 2.5),
    ("markov_1000", "hmmlearn", 4.0),
)
FLOAT32 = (("particles_own", 1.2),)  # row, how many times the cost with float32 ours must be
NEAR = (  # row, peer, how many times the cost of its fastest way ours may be
    ("markov_100", "dynamax", 1.5),
    ("markov_10", "dynamax", 1.5),
    ("markov_runs", "pgm_alone", 0.4),
)
COMPILED = (  # row, peer, how many times the cost of its fastest way ours in machine code may be
    ("rts_taylor", "dynamax", 0.12),
    ("rts_unscented", "dynamax", 0.2),
    *((f"online_{rule}", "dynamax", 0.4) for rule in ("taylor", "unscented")),
    ("online_taylor", "gtsam", 0.15),
    ("ekf_robots", "dynamax", 0.15),
    ("ukf_robots", "dynamax", 0.5),
    *((name, "dynamax", 0.5) for name in ("ekf_one_step", "ukf_one_step")),
    ("short", "dynamax", 0.8),
    ("linear", "dynamax", 0.3),
    ("linear", "cuthbert", 0.5),
    *((f"components_{n}", "dynamax", most) for n, most in ((12, 0.8), (24, 1.1), (50, 1.35))),
    ("map", "gtsam", 1 / 30),
    *((f"imm_{modes}", "filterpy", 0.1) for modes in (2, 3, 5)),
    *((f"gpb2_{modes}", "filterpy", 0.15) for modes in (2, 3)),
)
MAPS: tuple[tuple[str, str, float | None, float], ...] = (
    # Row, peer, how many times its cost ours may be, by NumPy alone and in machine code.
    *(
        (pose_graphs.title(name), "gtsam", *most)
        for name, most in (("m3500", (0.8, 0.5)), ("intel", (1.0, 0.6)), ("CSAIL", (1.0, 0.6)))
    ),
    *((f"{pose_graphs.title(name)}_whole", "gtsam", 1.5, 1.5) for name in ("m3500", "intel")),
    ("graph_city", "gtsam", 0.2, 0.2),
    (f"{pose_graphs.title('m3500')}_growing", "gtsam", None, 1.0),
    ("landmarks_30", "gtsam", 1.5, 1.5),
    ("landmarks_300", "gtsam", 0.5, 0.5),
    *((f"field_{name}", "scipy", 25.0, 10.0) for name in ("60", "100", "300", "chain")),
)
COLD = [
    f"cold_{name}" for name in repository.NAMES
]  # rows in which no engine of pyAgrum may be faster
WITHIN = (  # row, how many milliseconds it may take
    ("reading_alarm", 20.0),
    ("reading_andes", 150.0),
    ("field_declared", 1_500.0),
)
RATES = (  # row whose unit is a cell and step, how many steps a second it must make
    *((name, 25.0) for name in ("grid_filter", "grid_wide_filter")),
    *((name, 15.0) for name in ("grid_smoother", "grid_wide_smoother")),
)
PARTS = ("gtsam_optimum_alone", "gtsam_building")  # of the work of `map`
LEVEL = (  # curve, from which length on, how many times its highest cost a step may be its lowest
    ("filter", 1_000, 1.2),
    ("smoother", 1_000, 1.2),
    ("balanced", 10_000, 1.5),
    ("iterated", 10_000, 1.5),
)


@dataclass(frozen=True)
class Verdict:
    """One requirement and what was measured.

    Attributes
    ----------
    what : str
    measured, asked : float
        Ratios, milliseconds, or steps a second.
    least : bool
        Whether what is asked is the least; else it is the most.
    """

    what: str
    measured: float
    asked: float
    least: bool

    @property
    def holds(self) -> bool:
        """Whether the requirement is met."""
        return self.measured >= self.asked if self.least else self.measured <= self.asked


def verdicts(summary: Mapping[str, Any]) -> Iterator[Verdict]:
    """One for each requirement whose rows were run with the peers they need."""
    drive = summary.get("map", {})
    optimisers = [drive[key] for key in ("gtsam", "gtsam_levenberg_marquardt") if key in drive]
    if optimisers:
        yield Verdict("map: gtsam / pgm", min(optimisers) / drive["pgm"], 8.0, True)
    for row, peer, asked in FASTER:
        times = summary.get(row, {})
        if peer in times:
            yield Verdict(f"{row}: {peer} / pgm", times[peer] / times["pgm"], asked, True)
    for row, peer, asked in CHEAPER:
        times = summary.get(row, {})
        if peer in times:
            yield Verdict(f"{row}: pgm / {peer}", times["pgm"] / times[peer], asked, False)
    for row, peer, asked in FASTEST:
        for ratio in _to_fastest(summary, row, peer):
            yield Verdict(f"{row}: fastest of {peer} / pgm", 1.0 / ratio, asked, True)
    for row, peer, asked in NEAR:
        for ratio in _to_fastest(summary, row, peer):
            yield Verdict(f"{row}: pgm / fastest of {peer}", ratio, asked, False)
    for row, peer, asked in COMPILED:
        for ratio in _to_fastest(summary, row, peer, "pgm_compiled"):
            yield Verdict(f"{row}: pgm_compiled / fastest of {peer}", ratio, asked, False)
    for row, peer, *limits in MAPS:
        times = summary.get(row, {})
        for ours, most in zip(("pgm", "pgm_compiled"), limits, strict=True):
            if most is not None and {ours, peer} <= times.keys():
                ratio = times[ours] / times[peer]
                yield Verdict(f"{row}: {ours} / {peer}", ratio, most, False)
    for row, asked in FLOAT32:
        times = summary.get(row, {})
        if "pgm_float32" in times:
            ratio = times["pgm"] / times["pgm_float32"]
            yield Verdict(f"{row}: pgm / pgm with float32", ratio, asked, True)
    for row in COLD:
        times = summary.get(row, {})
        engines = [value for library, value in times.items() if library.startswith("pyagrum")]
        if engines:
            ratio = times["pgm"] / min(engines)
            yield Verdict(f"{row}: pgm / pyagrum's faster engine", ratio, 1.0, False)
    for row, asked in WITHIN:
        if "pgm" in summary.get(row, {}):
            yield Verdict(f"{row}: milliseconds", 1e3 * summary[row]["pgm"], asked, False)
    for row, asked in RATES:
        if "pgm" in summary.get(row, {}):
            rate = 1.0 / (summary[row]["pgm"] * math.prod(rooms.CELLS))
            yield Verdict(f"{row}: steps a second", rate, asked, True)
    for each in memory.LARGE:
        peaks = summary.get("memory", {}).get(each.name, {})
        for peer in peaks.keys() - {"pgm"}:
            ratio = peaks[peer] / peaks["pgm"]
            what = f"{each.name}, peak of memory: {peer} / pgm"
            yield Verdict(what, ratio, each.least, True)
    for change, found in cliffs.ratios(summary):
        for kind, ratio in found.items():
            if change.most is not None:
                what = f"cliffs_{kind}: {change.name} / pgm"
                yield Verdict(what, ratio, change.most, False)
    for neighbour, timed in neighbours.found(summary):
        for per, measured in neighbour.measured(timed):
            assert neighbour.asked is not None
            what = f"neighbours_{neighbour.row}: {neighbour.name} {per}"
            yield Verdict(what, measured, neighbour.asked, False)
    for curve, least, asked in LEVEL:
        costs = summary.get("curves", {}).get(curve, {}).get("pgm", {})
        chosen = {int(size): cost for size, cost in costs.items() if int(size) >= least}
        if len(chosen) > 1:
            between = f"{min(chosen):,} to {max(chosen):,} steps"
            ratio = max(chosen.values()) / min(chosen.values())
            yield Verdict(f"{curve}, {between}: dearest / cheapest step", ratio, asked, False)


def _to_fastest(
    summary: Mapping[str, Any], row: str, peer: str, ours: str = "pgm"
) -> Iterator[float]:
    """How many times the cost of a peer's fastest way ours is, if both were run."""
    times = {key: cost for key, cost in summary.get(row, {}).items() if key not in PARTS}
    ways = [value for library, value in times.items() if f"{library}_".startswith(f"{peer}_")]
    if ways and ours in times:
        yield times[ours] / min(ways)
