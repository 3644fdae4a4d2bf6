"""`python -m benchmarks.first_call`: what the first call of a process takes over the next one.

Each library has a process of its own. Loading llvmlite and compiling the graph are in the time of
pgm; loading JAX is not in dynamax's. Then smoothers of several lengths are called in processes of
their own, with machine code and without; a pose graph; and each neighbour of the plain compiled
step.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

from benchmarks import neighbours, recorded
from benchmarks.command import known
from benchmarks.rows import ROWS
from benchmarks.verdicts import Verdict
from experiments.record import note, table

NAMES = ("rts_taylor", "rts_unscented", "ekf_robots")
WAYS = {"pgm": "pgm_compiled", "dynamax": "dynamax"}
MOST = 1.0  # seconds
STEPS = 1_000
LENGTHS = (1_000, 10_000, 20_000, 30_000)
CHOICES = {"NumPy": False, "compiled": True}
CALLS = ("NumPy", "first"), ("compiled", "first"), ("compiled", "second")
HEAD = ("steps", *(f"{choice}, {call} call [s]" for choice, call in CALLS))
NAME = "first_call"


def main() -> None:
    """Print tables, and what must hold; `--record` writes the lengths into the file of figures."""
    found = {name: measure(name) for name in NAMES}
    table(
        "the first call of a process over its second one, in seconds of the processor",
        ("row", *WAYS),
        [(name, *(each.get(way, "") for way in WAYS)) for name, each in found.items()],
    )
    graph = _answer("graph")
    over = {name: each["pgm"] for name, each in found.items()}
    over["a pose graph"] = graph["first"] - graph["second"]
    for name, seconds in over.items():
        one = Verdict(f"{name}: seconds", seconds, MOST, False)
        note(f"{one.what}: {one.measured:.2f}, at most {one.asked:g}: {_holds(one)}")
    lengths = {
        str(steps): {choice: _answer("smooth", choice, str(steps)) for choice in CHOICES}
        for steps in LENGTHS
    }
    table(
        "pgm.smooth in a process of its own: seconds of the processor, first and second call",
        HEAD,
        told(lengths),
    )
    if sys.argv[1:] == ["--record"]:
        recorded.add({NAME: {"lengths": lengths}}, "python -m benchmarks.first_call", known())
    table(
        "neighbours of the plain compiled step, a process each: the first call over the second",
        ("of the", "neighbour", "seconds", "at most", ""),
        nearby(),
    )


def told(lengths: Mapping[str, Mapping[str, Mapping[str, float]]]) -> Iterator[tuple[str, ...]]:
    """Lines of a table, under `HEAD`; none of lengths that were not compiled."""
    for steps, choices in lengths.items():
        if "missing" not in choices["compiled"]:
            calls = (choices[choice][call] for choice, call in CALLS)
            yield f"{int(steps):,}", *map(recorded.digits, calls)


def nearby() -> Iterator[tuple[str, str, str, str, str]]:
    """Lines of a table, of neighbours that have a limit."""
    for each in neighbours.NEIGHBOURS:
        answer = {} if each.asked is None else _answer(f"neighbours_{each.row}", each.name)
        if "seconds" in answer:
            one = Verdict(each.name, answer["seconds"], MOST, False)
            yield each.row, each.words, f"{one.measured:.2f}", f"{one.asked:g}", _holds(one)


def _holds(one: Verdict) -> str:
    return "holds" if one.holds else "does NOT hold"


def measure(name: str) -> dict[str, float]:
    """Seconds, by way; of the libraries that are here."""
    found = {}
    for way, library in WAYS.items():
        answer = _answer(name, library)
        if "missing" in answer:
            note(f"{name}: {library} is left out, {answer['missing']}")
        else:
            found[way] = answer["seconds"]
    return found


def _answer(*arguments: str) -> dict[str, Any]:
    """Of a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.first_call", *arguments],
        check=True,
        capture_output=True,
        text=True,
    )
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def smooth(choice: str, steps: str) -> None:
    """Print as JSON the seconds of the first and second call of this process."""
    import pgm
    from benchmarks.timing import seconds
    from benchmarks.work import robots

    work = robots.draw(1, int(steps))
    evidence = work.evidence(0)
    try:
        first, second = (
            seconds(lambda: pgm.smooth(work.network, evidence, compiled=CHOICES[choice]))
            for _ in range(2)
        )
    except ImportError as error:
        print(json.dumps({"missing": str(error)}))
        return
    print(json.dumps({"first": first, "second": second}))


def graph() -> None:
    """Print likewise those of a pose graph: declared, compiled and solved, with all marginals."""
    from benchmarks.libraries import pgm_maps
    from benchmarks.timing import seconds
    from benchmarks.work import pose_graphs

    call = pgm_maps.whole(pose_graphs.city(STEPS)).call
    print(json.dumps({"first": seconds(call), "second": seconds(call)}))


def alone(name: str, library: str) -> None:
    """Print as JSON what a library needs in this process."""
    (row,) = (each for each in ROWS if each.name == name)
    work = row.work(STEPS)
    try:
        if library == "dynamax":
            import_module("dynamax.nonlinear_gaussian_ssm")
            import_module("dynamax.linear_gaussian_ssm")
        else:
            import_module("benchmarks.libraries.pgm_robots")
        begin = time.process_time()
        contender = row.contenders[library](work)
        first = time.process_time() - begin  # preparing calls twice
        begin = time.process_time()
        contender.call()
        again = time.process_time() - begin
    except ImportError as error:
        print(json.dumps({"missing": str(error)}))
        return
    print(json.dumps({"seconds": first - 2 * again}))


if __name__ == "__main__":
    match sys.argv[1:]:
        case [] | ["--record"]:
            main()
        case ["smooth", choice, steps]:
            smooth(choice, steps)
        case ["graph"]:
            graph()
        case [name, library]:
            alone(name, library)
        case words:
            sys.exit(f"first_call takes --record, or no words, not {' '.join(words)}")
