"""Time and memory of large networks, each library in a process of its own.

A process holds pgm, which makes the work, and the work itself; what counts is the most that it
holds beyond that, the peer's library and all.
"""

from __future__ import annotations

import pickle
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import agreement
from benchmarks.row import Check, Prepare, part
from benchmarks.work import pose_graphs, repository
from experiments.record import note, table


@dataclass(frozen=True, eq=False)
class Large:
    """A network of which all marginals are asked, once by each library.

    Attributes
    ----------
    name : str
        A key of the summary.
    work : callable
        From the size to the work.
    size : int
    libraries : mapping of str
        What prepares each; pgm first.
    check : callable
        As of a row.
    least : float
        How many times our peak of memory the other's must be.
    """

    name: str
    work: Callable[[int], Any]
    size: int
    libraries: Mapping[str, Prepare]
    check: Check
    least: float


def discrete(name: str) -> Large:
    """A network of the Bayesian network repository."""
    return Large(
        name,
        lambda size: repository.several(name, size)[0],
        1,
        {"pgm": part("pgm_cold", "marginals"), "pyagrum": part("pyagrum_tables", "whole")},
        agreement.marginals,
        least=1.0,
    )


def pose_graph(name: str, work: Callable[[int], pose_graphs.Surveyed], size: int) -> Large:
    """A pose graph."""
    return Large(
        name,
        work,
        size,
        {
            "pgm": part("pgm_maps", "whole"),
            "gtsam": part("gtsam_maps", "whole", "surveyed"),
        },
        agreement.maps,
        least=0.25,
    )


LARGE = (
    discrete("munin1"),
    pose_graph(
        f"{pose_graphs.title('m3500')}_memory",
        lambda size: pose_graphs.published("m3500", size),
        pose_graphs.PUBLISHED["m3500"][0],
    ),
    pose_graph("graph_city_memory", pose_graphs.city, pose_graphs.CITY[0]),
)


def measure(large: Large) -> tuple[dict[str, float], dict[str, int]]:
    """Seconds from a network's numbers to all marginals, and bytes it took, by library.

    None, where the network or a library other than pgm is not here.

    Raises
    ------
    AssertionError
        Where the libraries differ.
    """
    times: dict[str, float] = {}
    peaks: dict[str, int] = {}
    ours: Any = None
    for library in large.libraries:
        command = [sys.executable, "-m", "benchmarks.memory", library, large.name, str(large.size)]
        found = pickle.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
        if "missing" in found:
            note(f"{large.name}: {library} is left out, {found['missing']}")
            continue
        ours = ours or found["marginals"]
        large.check(library, ours, found["marginals"])
        times[library], peaks[library] = found["seconds"], found["peak"]
    table(
        f"{large.name}: from its numbers to all marginals",
        ("library", "s", "peak [MiB]"),
        [(library, times[library], peaks[library] / 2**20) for library in times],
    )
    return times, peaks


def main(library: str, name: str, size: str) -> None:
    """Write what one library needs, and finds; any name but those here is of the repository."""
    large = {each.name: each for each in LARGE}.get(name) or discrete(name)
    try:
        work = large.work(int(size))
        held = _memory("VmRSS")
        contender = large.libraries[library](work)
        begin = time.process_time()
        marginals = contender.call()
        seconds = time.process_time() - begin
    except ImportError as error:
        found: dict[str, Any] = {"missing": str(error)}
    else:
        peak = _memory("VmHWM") - held
        found = {"seconds": seconds, "peak": peak, "marginals": marginals}
    sys.stdout.buffer.write(pickle.dumps(found))


def _memory(which: str) -> int:
    """The memory that this process holds, VmRSS, or has held at the most, VmHWM, in bytes."""
    told = Path("/proc/self/status")
    if told.exists():  # else a process inherits the peak of the one that started it
        (line,) = (x for x in told.read_text(encoding="utf-8").splitlines() if which in x)
        return 1024 * int(line.split()[1])
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main(*sys.argv[1:])
