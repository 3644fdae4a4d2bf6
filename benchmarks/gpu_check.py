"""`make gpu-check`: what NVIDIA's card of this machine finds, beside the processor, and how fast.

Without a card it says so, and stops. Else it filters and smooths drawn models on both, whose
answers must agree, with evidence on the card as well; then a million robots over 200 steps, whose
sweep is timed alone, with its numbers on the card, and as a whole call; the same with their
readings on the card, where beliefs stay, beside JAX's filter there; and a study of as many, which
are drawn, filtered, smoothed and summed there. This has not been run on a card yet.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import cycle, islice, product
from time import perf_counter
from typing import Any, TypeVar
from unittest.mock import patch

import numpy as np

import pgm
from benchmarks.work import robots
from pgm.comparison.study_result import Study
from pgm.kernels.machine.emitter.driver import device
from pgm.posteriors.on_card import CardArray

CARD = pgm.Compiled(device="cuda")
MODELS, RUNS, STEPS = 200, 10**6, 200
# Deviations by which answers may differ, and seconds of a million robots' sweep.
AGREES, DUE = 1e-10, 0.02
# By how much figures of a study may differ, and of so many runs.
ALIKE, COMPARED = 1e-12, 4096
# And log-evidence where evidence lies on the card, by parts of it.
SAME = 1e-9
METHODS = {"EKF": pgm.Taylor(), "RTS": pgm.Smoothing()}
RULES = pgm.Taylor(), pgm.Unscented(), pgm.Cubature()
SCHEDULES: tuple[pgm.Filtering | pgm.FixedLag | pgm.Smoothing, ...] = (
    pgm.Filtering(),
    pgm.Smoothing(),
    pgm.Filtering(gate=0.95),
    pgm.FixedLag(3),
)
# The schedules that take evidence on the card.
ALL_THERE = SCHEDULES[:2]
Found = TypeVar("Found")
Model = tuple[pgm.DynamicBayesianNetwork, Mapping[pgm.Variable, Any]]


def drawn(seed: int) -> Model:
    """A model of one to four components, its functions drawn, and evidence of a few runs."""
    rng = np.random.default_rng(seed)
    n, d, steps, runs = (int(rng.integers(*ends)) for ends in ((1, 5), (1, 4), (3, 30), (1, 8)))
    x = pgm.Variable("x", components=tuple(f"x{k}" for k in range(n)))
    z = pgm.Variable("z", components=tuple(f"z{k}" for k in range(d)))
    move, turn = (rng.normal(size=(n, n)) / np.sqrt(n) for _ in range(2))
    see, bend = (rng.normal(size=(d, n)) for _ in range(2))

    def moved(x: Any) -> Any:
        return 0.8 * x @ move.T + 0.2 * np.sin(x @ turn.T) + 0.1 * np.exp(-x * x)

    def seen(x: Any) -> Any:
        return (
            x @ see.T
            + 0.3 * np.arctan2(x @ bend.T, 2.0)
            + 0.1 * np.log1p(np.hypot(x[..., :1], 1.0))
        )

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, rng.normal(size=n), np.diag(rng.uniform(0.1, 1.0, n)))],
        [pgm.NonlinearGaussianCPD(x, (x.previous,), moved, cov=np.diag(rng.uniform(0.01, 0.2, n)))],
        [pgm.NonlinearGaussianCPD(z, (x,), seen, cov=np.diag(rng.uniform(0.05, 0.5, d)))],
    )
    return model, model.sample(steps=steps, runs=runs, rng=rng).evidence


def apart(one: Any, other: Any, model: pgm.DynamicBayesianNetwork) -> float:
    """By how many deviations the answers of two calls differ at most."""
    worst = float(np.abs(one.log_evidence - other.log_evidence).max())
    for variable in model.states:
        ours, theirs = one[variable], other[variable]
        unit = theirs.std
        means = np.abs(ours.mean - theirs.mean) / unit
        covs = np.abs(ours.cov - theirs.cov) / (unit[..., :, None] * unit[..., None, :])
        worst = max(worst, float(means.max()), float(covs.max()))
    return worst


def agreement(count: int) -> bool:
    """Whether the card's answers are the processor's, of so many drawn models."""
    worst, ways = 0.0, islice(cycle(product(SCHEDULES, RULES)), count)
    for seed, (schedule, rule) in enumerate(ways):
        model, evidence = drawn(seed)
        steps = next(iter(evidence.values())).shape[-2]
        card, processor = (
            pgm.infer(
                pgm.compile(model, steps, compiled=choice),
                evidence,
                schedule=schedule,
                lineariser=rule,
            )
            for choice in (CARD, True)
        )
        off = apart(card, processor, model)
        if schedule in ALL_THERE:
            off = max(off, there(model, evidence, steps, schedule, rule, processor))
        if not off <= AGREES:
            _say(f"model {seed}, {schedule!r}, {rule!r}: {off:.1e} deviations apart")
        worst = max(worst, off)
    _say(f"{count} drawn models: at most {worst:.1e} deviations apart; {AGREES:.0e} are allowed")
    return worst <= AGREES


def there(
    model: pgm.DynamicBayesianNetwork,
    evidence: Mapping[pgm.Variable, Any],
    steps: int,
    schedule: Any,
    rule: Any,
    due: Any,
) -> float:
    """By how many deviations means differ at most where evidence lies on the card, and they too."""
    resident = {z: on_the_card(rows, turned=False) for z, rows in evidence.items()}
    graph = pgm.compile(model, steps, compiled=CARD)
    found = pgm.infer(graph, resident, schedule=schedule, lineariser=rule)
    worst = 0.0
    for variable in model.states:
        off = np.abs(found.on_card[variable].mean.home() - due[variable].mean)
        worst = max(worst, float((off / due[variable].std).max()))
    return worst


@contextmanager
def timed_launches() -> Iterator[list[float]]:
    """Seconds of each launch on the card, from its numbers being there to its end."""
    seconds, own = list[float](), device()
    launch = own.launch

    def timed(*given: Any) -> None:
        began = perf_counter()
        launch(*given)
        seconds.append(perf_counter() - began)

    with patch.object(own, "launch", timed):
        yield seconds


def speed(runs: int, steps: int) -> bool:
    """Whether a filter's sweep over so many robots takes no longer than is due."""
    work = robots.draw(runs, steps)
    evidence, calls = work.evidence(), list[float]()
    with timed_launches() as sweeps:
        for _ in range(3):
            calls.append(_seconds(lambda: pgm.filter(work.network, evidence, compiled=CARD)))
    due = DUE * max(runs * steps / (RUNS * STEPS), 0.05)
    _say(
        f"{runs:,} robots over {steps} steps: {1e3 * min(sweeps):.2f} ms on the card "
        f"({1e3 * due:.2f} ms are due); a whole call {min(calls):.2f} s, the first {calls[0]:.2f} s"
    )
    return min(sweeps) <= due


def resident(runs: int, steps: int) -> bool:
    """Whether readings that lie on the card are filtered there with the same log-evidence.

    The whole call is timed, as the readings were given, and with the runs beside each other.
    """
    work = robots.draw(runs, steps)
    evidence = work.evidence()
    seen, due = evidence[robots.sighting], pgm.filter(work.network, evidence, compiled=CARD)
    right = True
    for how, turned in (("run by run", False), ("step by step", True)):
        calls = list[float]()
        readings: Any = on_the_card(seen.values, turned=turned)
        evidence[robots.sighting] = pgm.sightings(readings, step=seen.step, given=seen.given)
        for _ in range(3):
            found, seconds = _timed(lambda: pgm.filter(work.network, evidence, compiled=CARD))
            calls.append(seconds)
        off = float(np.abs(found.log_evidence / due.log_evidence - 1.0).max())
        _say(
            f"{runs:,} robots over {steps} steps, whose readings lie on the card {how}: a whole "
            f"call {min(calls):.3f} s, the first {calls[0]:.2f} s; log-evidence {off:.0e} apart"
        )
        right &= off <= SAME
        del found
    _say(beside(work, due.log_evidence))
    return right


def beside(work: robots.Robots, log_evidence: Any) -> str:
    """What JAX's filter takes for robots whose readings lie on the card, or why it is not timed."""
    # JAX would else take most of the card's memory, whatever it needs.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    try:
        from benchmarks.libraries.jax_card import filtering

        call = filtering(work)
        found, first = _timed(call)
        seconds = [first, *(_seconds(call) for _ in range(2))]
    except ImportError:
        return "JAX's filter is not timed: jax is not installed (pip install 'jax[cuda13]')"
    except RuntimeError as error:  # as JAX's are, where it has no card, or too little memory
        return f"JAX's filter is not timed: {str(error).splitlines()[0]}"
    off = float(np.abs(np.asarray(found[2]) / log_evidence - 1.0).max())
    return (
        f"JAX's filter (lax.scan, vmap, jit; float64) of the same: {min(seconds):.3f} s, the first "
        f"{seconds[0]:.2f} s; log-evidence {off:.0e} apart"
    )


def on_the_card(numbers: Any, *, turned: bool) -> CardArray:
    """Numbers (runs, rows, d), copied to the card, where their runs lie beside each other or not.

    They lie as a library's do that has computed them there.
    """
    here = np.ascontiguousarray(np.moveaxis(numbers, 0, -1) if turned else numbers)
    own = device()
    memory = own.held(here.nbytes)
    with own.current():
        own.put(memory.address, here.ctypes.data, here.nbytes)
    strides = (np.moveaxis(here, -1, 0) if turned else here).strides
    return CardArray(memory, 0, np.shape(numbers), strides)


def study(runs: int, steps: int) -> bool:
    """Whether a study of so many robots is drawn and summed on the card, with the same figures."""
    work = robots.draw(1, steps)
    seen = pgm.sightings(
        step=np.arange(1, steps + 1), given={robots.landmark: work.landmarks[:, 0]}
    )
    inputs = {robots.velocity: work.controls, robots.sighting: seen}

    def call(count: int, choice: Any) -> Study:
        given = {"runs": count, "methods": METHODS, "seed": 1, "compiled": choice}
        return pgm.study(work.network, inputs, **given)

    few, found, seconds = min(runs, COMPARED), list[Study](), list[float]()
    for _ in range(3):
        with timed_launches() as launches:
            seconds.append(_seconds(lambda: found.append(call(runs, CARD))))
    _say(
        f"a study of {runs:,} robots over {steps} steps by {' and '.join(METHODS)}: "
        f"{min(seconds):.2f} s, the first {seconds[0]:.2f} s, of the last {sum(launches):.3f} s on "
        f"the card; {found[0].compilation}"
    )
    off = unlike(call(few, CARD), call(few, True))
    _say(f"a study's figures of {few:,} runs: at most {off:.1e} apart; {ALIKE:.0e} are allowed")
    return off <= ALIKE and "by the processor" not in found[0].compilation


def unlike(one: Study, other: Study) -> float:
    """By how much figures of studies differ, beside the largest of their kind or one."""
    worst = 0.0
    for row, its in zip(one.rows, other.rows, strict=True):
        pairs = [(row.rmse, its.rmse), (row.bias, its.bias), (row.nees, its.nees)]
        pairs += [(row.coverage, its.coverage), *((nis, its.nis[z]) for z, nis in row.nis.items())]
        for ours, theirs in pairs:
            for name in ("value", "error", "by_step", "error_by_step"):
                a, b = getattr(ours, name), getattr(theirs, name)
                if not np.array_equal(np.isnan(a), np.isnan(b)):
                    return float("inf")
                scale = max(float(np.abs(np.nan_to_num(b)).max()), 1.0)
                worst = max(worst, float(np.abs(np.nan_to_num(a - b)).max()) / scale)
    return worst


def _timed(call: Callable[[], Found]) -> tuple[Found, float]:
    began = perf_counter()
    found = call()
    return found, perf_counter() - began


def _seconds(call: Callable[[], object]) -> float:
    return _timed(call)[1]


def _say(words: str) -> None:
    sys.stdout.write(f"{words}\n")
    sys.stdout.flush()


def main(given: Sequence[str] | None = None) -> int:
    """Check agreement and speed; the result is 1 where something does not hold."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("--models", type=int, default=MODELS)
    words.add_argument("--runs", type=int, default=RUNS)
    words.add_argument("--steps", type=int, default=STEPS)
    asked = words.parse_args(given)
    model, _ = drawn(0)
    try:
        pgm.compile(model, 1, compiled=CARD)
    except (ImportError, pgm.ExecutorError) as error:
        _say(f"no card: {error}")
        return 0
    _say(f"{device().name}, compute capability {'.'.join(map(str, device().capability))}")
    agrees = agreement(asked.models)
    checks = speed, resident, study
    found = [agrees, *(check(asked.runs, asked.steps) for check in checks)]
    return 0 if all(found) else 1


if __name__ == "__main__":
    sys.exit(main())
