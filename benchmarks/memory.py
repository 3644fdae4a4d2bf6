"""Time and memory of one large network, each library in a process of its own."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks import agreement
from benchmarks.work import repository
from benchmarks.work.tables import Task
from experiments.record import note, table

NAMES = ("munin1",)
LIBRARIES = ("pgm", "pyagrum")


def measure(name: str) -> tuple[dict[str, float], dict[str, int]]:
    """Seconds from a network and evidence to all marginals, and peak bytes, by library.

    None, where the network or a library other than pgm is not here.

    Raises
    ------
    AssertionError
        Where the libraries differ.
    """
    times: dict[str, float] = {}
    peaks: dict[str, int] = {}
    ours: list[np.ndarray] = []
    for library in LIBRARIES:
        command = [sys.executable, "-m", "benchmarks.memory", library, name]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        found = json.loads(done.stdout)
        if "missing" in found:
            note(f"{name}: {library} is left out, {found['missing']}")
            continue
        marginals = [np.array(values) for values in found["marginals"]]
        ours = ours or marginals
        agreement.marginals(library, ours, marginals)
        times[library], peaks[library] = found["seconds"], found["peak"]
    table(
        f"{name}: from the network to all marginals",
        ("library", "s", "peak [MiB]"),
        [(library, times[library], peaks[library] / 2**20) for library in times],
    )
    return times, peaks


def _pgm(task: Task) -> list[np.ndarray]:
    import pgm

    posterior = pgm.infer(pgm.compile(task.network), task.evidence)
    return [posterior[v].values for v in task.hidden]


def _pyagrum(task: Task) -> list[np.ndarray]:
    from benchmarks.libraries import pyagrum_tables

    found: list[np.ndarray] = pyagrum_tables.marginals([task]).call()
    return found


ASKED: dict[str, Callable[[Task], list[np.ndarray]]] = {"pgm": _pgm, "pyagrum": _pyagrum}


def main(library: str, name: str) -> None:
    """Print what one library needs, and finds, as JSON."""
    try:
        (task,) = repository.several(name, 1)
        begin = time.process_time()
        marginals = ASKED[library](task)
        seconds = time.process_time() - begin
    except ImportError as error:
        print(json.dumps({"missing": str(error)}))
        return
    found = [values.tolist() for values in marginals]
    print(json.dumps({"seconds": seconds, "peak": _peak(), "marginals": found}))


def _peak() -> int:
    """The most memory that this process has held, in bytes."""
    told = Path("/proc/self/status")
    if told.exists():  # else a process inherits the peak of the one that started it
        (line,) = (x for x in told.read_text(encoding="utf-8").splitlines() if "VmHWM" in x)
        return 1024 * int(line.split()[1])
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main(*sys.argv[1:])
