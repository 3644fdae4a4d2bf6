"""`python -m benchmarks.studies`: a study by one worker and by two, by the clock.

Each call begins a cluster of its own, which is part of its time. On an idle machine of two cores or
more two workers take 1.7 times less time, or better; the ratio of processor time, of which a busy
machine takes none away, tells how much more the two of them work.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import psutil

from experiments import localisation
from experiments.studies import Study

DUE = 1.7


def timed(study: Study, workers: int, folder: Path) -> tuple[float, float]:
    """Seconds by the clock, and of the processors, workers' included."""
    before, began = _processors(), perf_counter()
    study.run(folder, workers=workers, progress=False)
    return perf_counter() - began, _processors() - before


def _processors() -> float:
    times = psutil.Process().cpu_times()
    return float(times.user + times.system + times.children_user + times.children_system)


def main() -> None:
    """Time both, in turns, and print seconds and ratios."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--runs", type=int, default=500_000, help="of each of two settings")
    words.add_argument("--repeats", type=int, default=2)
    asked = words.parse_args()
    study = Study(
        localisation.sweep,
        {"lineariser": ["Taylor", "Unscented"], "steps": [20]},
        runs=asked.runs,
        part_size=5000,
    )
    least: dict[int, tuple[float, float]] = {}
    place = Path(tempfile.mkdtemp())
    try:
        for k in range(asked.repeats):
            for workers in (1, 2):
                found = timed(study, workers, place / f"{workers}-{k}")
                least[workers] = min(least.get(workers, found), found)
                clock, processors = found
                sys.stdout.write(
                    f"workers: {workers}, {clock:.1f} s by the clock, {processors:.1f} s of "
                    "processors\n"
                )
                sys.stdout.flush()
        tables = [
            study.table(place / f"{w}-{k}").rows for w in (1, 2) for k in range(asked.repeats)
        ]
        same = all(rows == tables[0] for rows in tables)
    finally:
        shutil.rmtree(place)
    clock, processors = (least[1][k] / least[2][k] for k in range(2))
    sys.stdout.write(
        f"two workers are {clock:.2f} times faster ({DUE} is due on an idle machine), and work "
        f"{1.0 / processors:.2f} times as much; figures {'are the same' if same else 'DIFFER'}\n"
    )
    sys.exit(not same)


if __name__ == "__main__":
    main()
