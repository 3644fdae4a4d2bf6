"""The guide's robot loop, for an hour: in the same memory, with the answers of recorded data."""

import gc
import tracemalloc
from collections import Counter

import numpy as np
import pytest
from building import programs

import pgm

PAGE = programs.DOCS / "guide" / "robot_loop.md"
LAG = 10


@pytest.fixture(scope="module")
def loop():
    """The names of the page's blocks, all but the last, which runs them."""
    names = {"__name__": "robot_loop"}
    *blocks, _ = programs.blocks(PAGE.read_text(encoding="utf-8"))
    for block in blocks:
        exec(compile(block.code, PAGE.name, "exec"), names)
    return names


def offline(loop, rows, steps):
    """The recorded lines as evidence."""
    u, z, m = (loop[name] for name in "uzm")
    fields = [row.strip().split(",") for row in rows]
    times = np.array([float(each[0]) for each in fields])
    controls = [
        (float(v), float(omega), dt)
        for (_, v, omega, *_), dt in zip(fields, np.diff(times, prepend=0.0), strict=True)
    ]
    seen = [(k, *map(float, each[3:])) for k, each in enumerate(fields, 1) if each[3]]
    at, number, reach, bearing = np.array(seen).T
    places = loop["LANDMARKS"][number.astype(int)]
    sightings = pgm.sightings(
        np.stack([reach, bearing], -1), step=at.astype(int), given={m: places}
    )
    return {u: np.array(controls), z: sightings}


def hold(loop, steps, kept):
    """Follow a stream, and compare a few of its beliefs with those of recorded data."""
    rows, truth = loop["robot_lines"](steps, np.random.default_rng(8))
    refused, now, later, memory = Counter(), {}, {}, []
    x = loop["x"]
    tracemalloc.start()
    for k, (_, belief) in enumerate(loop["follow"](iter(rows), refused, LAG), start=1):
        assert np.isfinite(belief[x].mean).all()
        if k % kept == 0:
            # Copies: views would keep the beliefs.
            lagged = belief.lagged
            now[k] = belief[x].mean.copy(), belief[x].cov.copy(), float(belief.log_evidence)
            later[lagged.step] = lagged[x].mean.copy(), lagged[x].cov.copy()
            del lagged
            gc.collect()
            memory.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert not refused
    assert belief.step == steps
    evidence = offline(loop, rows, steps)
    filtered = pgm.filter(loop["model"], evidence, lineariser=pgm.Unscented())
    waiting = pgm.smooth(loop["model"], evidence, lineariser=pgm.Unscented(), lag=LAG)
    for found, recorded in ((now, filtered[x]), (later, waiting[x])):
        for k, (mean, cov, *_) in found.items():
            assert np.abs(mean - recorded.mean[k]).max() < 1e-7
            np.testing.assert_allclose(cov, recorded.cov[k], rtol=1e-6, atol=1e-12)
    assert now[steps][2] == pytest.approx(float(filtered.log_evidence), rel=1e-9)
    # A robot that sees its landmarks does not get lost.
    assert np.hypot(*(filtered[x].mean - truth)[:, :2].T).max() < 2.0
    return memory


def test_a_stream_is_followed_as_recorded_data_is(loop):
    memory = hold(loop, 300, kept=30)
    assert max(memory[2:]) - min(memory[2:]) < 200_000  # 900 bytes a step, less than a belief


@pytest.mark.slow
def test_an_hour_at_ten_lines_a_second_takes_no_more_memory(loop):
    memory = hold(loop, 36_000, kept=1000)
    assert max(memory[2:]) - min(memory[2:]) < 200_000  # 6 bytes a step


GOOD = ["0.1,1.0,0.2,,,\n", "0.2,1.0,0.2,1,5.0,0.1\n"]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("", "garbled"),
        ("0.3,1.0,0.2\n", "garbled"),
        ("0.3,1.0,0.2,1,5.0,0.1", "garbled"),
        ("0.3,1.0,0.2,,\n", "garbled"),
        ("0.3,1.0,0.2,,,,\n", "garbled"),
        ("0.3,1.0,0.2,1,5.0,\n", "garbled"),
        ("0.3,1.0,,1,5.0,0.1\n", "garbled"),
        ("0.3,1.0,nan,,,\n", "garbled"),
        ("0.3,1.0,0.2,1,inf,0.1\n", "garbled"),
        ("0.3,1.0,0.x2,,,\n", "garbled"),
        ("0.2,1.0,0.2,,,\n", "late"),
        ("-0.1,1.0,0.2,,,\n", "late"),
        ("5.3,1.0,0.2,,,\n", "too early"),
        ("0.3,1.0,0.2,3,5.0,0.1\n", "unknown landmark"),
        ("0.3,1.0,0.2,0.5,5.0,0.1\n", "unknown landmark"),
        ("0.3,1.0,0.2,-1,5.0,0.1\n", "unknown landmark"),
    ],
)
def test_a_line_that_cannot_be_right_is_counted_and_passed_over(line, told, loop):
    refused = Counter()
    after = "0.4,1.0,0.2,,,\n"
    found = list(loop["readings"]([*GOOD, line, after], refused))
    assert refused == {told: 1}
    assert [time for time, *_ in found] == [0.1, 0.2, 0.4]
    assert found[-1][1] == [1.0, 0.2, pytest.approx(0.2)]


def test_a_robot_whose_clock_was_set_ends_the_loop(loop):
    refused = Counter()
    lines = [*GOOD, *(f"{900 + 0.1 * k:.1f},1.0,0.2,,,\n" for k in range(60))]
    with pytest.raises(RuntimeError, match="50 lines in a row are too early or worse: begin anew"):
        list(loop["readings"](lines, refused))
    assert refused == {"too early": 50}
