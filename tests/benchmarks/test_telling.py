import json

import pytest

from benchmarks import command, curves, figure, memory, page, timing
from benchmarks.row import part
from benchmarks.timing import Contender, medians
from benchmarks.verdicts import verdicts
from benchmarks.work import targets

SUMMARY = {
    "map": {"pgm": 5.0, "gtsam": 45.0, "gtsam_levenberg_marquardt": 35.0},
    "ekf_one_step": {"pgm": 1.0, "dynamax": 1.4},
    "rts_taylor": {"pgm": 1.3, "filterpy": 1.0},
    "repository_asia": {"pgm": 1.0, "pyagrum": 1.6, "pgmpy": 19.0},
    "sets_asia": {"pgm": 1.0, "pyagrum": 25.0},
    "reading_alarm": {"pgm": 0.021, "pgmpy": 0.6},
    "munin1": {"pgm": 3.0, "pyagrum": 15.0},
    "memory": {"munin1": {"pgm": 2**30, "pyagrum": 2**29}},
    "curves": {
        "filter": {"pgm": {100: 9.0, 1_000: 1.0, 10_000: 1.1, 100_000: 1.15}},
        "balanced": {"pgm": {1_000: 9.0, 10_000: 2.0, 100_000: 3.2}},
        "iterated": {"pgm": {1_000: 9.0, 10_000: 2.0}},
    },
}


def test_verdicts_are_ratios_the_right_way_up():
    every = {each.what: each for each in verdicts(SUMMARY)}
    found = {what.split(":")[0]: each for what, each in every.items()}
    # gtsam at its faster is the one to beat; the unscented rows were not run.
    assert found["map"].measured == pytest.approx(7.0)
    assert not found["map"].holds
    assert found["ekf_one_step"].measured == pytest.approx(1.4)
    assert found["ekf_one_step"].holds
    assert found["rts_taylor"].measured == pytest.approx(1.3)
    assert not found["rts_taylor"].holds
    assert found["filter, 1,000 to 100,000 steps"].measured == pytest.approx(1.15)
    assert found["filter, 1,000 to 100,000 steps"].holds
    assert not found["balanced, 10,000 to 100,000 steps"].holds
    for what, measured, holds in (
        ("repository_asia: pyagrum / pgm", 1.6, True),
        ("repository_asia: pgmpy / pgm", 19.0, False),
        ("sets_asia: pyagrum / pgm", 25.0, True),
        ("reading_alarm: pgmpy / pgm", 0.6 / 0.021, True),
        ("reading_alarm: milliseconds", 21.0, False),
        ("munin1: pyagrum / pgm", 5.0, True),
        ("munin1, peak of memory: pyagrum / pgm", 0.5, False),
    ):
        assert every[what].measured == pytest.approx(measured)
        assert every[what].holds == holds
    assert len(every) == 5 + 7


def test_contenders_take_turns(monkeypatch):
    monkeypatch.setattr(timing, "SHORTEST", 0.0)
    order = []
    pair = {name: Contender(lambda name=name: order.append(name), 2) for name in "ab"}
    times = medians(pair, 3)
    assert "".join(order[2:]) == "ababab"[: len(order) - 2]
    assert set(times) == {"a", "b"}


def test_short_calls_are_repeated_and_times_are_of_a_unit(monkeypatch):
    monkeypatch.setattr(timing, "SHORTEST", 0.02)
    clock = iter(range(1_000))
    monkeypatch.setattr(timing.time, "process_time", lambda: 0.004 * next(clock))
    calls = []
    found = medians({"a": Contender(lambda: calls.append(1), 10)}, 2)
    # One to see that it takes 4 ms; then 5 at a time, which the clock takes for one tick.
    assert len(calls) == 1 + 2 * 5
    assert found["a"] == pytest.approx(0.004 / 5 / 10)


def test_curves_have_every_size_of_every_library_that_is_here(tmp_path):
    curve = curves.Curve(
        "balanced",
        targets.draw,
        {"pgm": part("pgm_targets", "smoothing", "balanced"), "other": part("other", "smoothing")},
        sizes=(4, 8),
        quick=(2, 3, 4),
    )
    found = curve.measure(quick=True, repeats=1)
    assert list(found) == ["pgm"]
    assert list(found["pgm"]) == [2, 3, 4]
    assert all(cost > 0.0 for cost in found["pgm"].values())
    figure.draw({"balanced": found}, tmp_path / "curve.png")
    assert (tmp_path / "curve.png").stat().st_size > 10_000


def test_the_command_writes_a_summary(tmp_path, capsys):
    command.main(["--quick", "--only", " discrete_asia", "--repeats", "1", "--out", str(tmp_path)])
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert 1e-6 < summary["discrete_asia"]["pgm"] < 1.0
    assert "numpy" in summary["versions"]
    assert "discrete_asia" in capsys.readouterr().out


def test_a_quick_run_leaves_large_work_out():
    names = command.everything(quick=True)
    assert {"repository_alarm", "sets_andes", "reading_alarm", "map"} < set(names)
    assert not {"repository_child", "sets_hepar2", "reading_munin", "munin1"} & set(names)
    assert {"repository_child", "munin1"} < set(command.everything(quick=False))


def test_memory_is_of_each_library_in_its_own_process():
    pytest.importorskip("pyagrum", reason="pyagrum comes with the extra bench")
    pytest.importorskip("pgmpy", reason="the networks come with pgmpy")
    times, peaks = memory.measure("asia")
    assert set(times) == set(peaks) == {"pgm", "pyagrum"}
    assert all(0.0 < each < 60.0 for each in times.values())
    assert all(2**24 < each < 2**31 for each in peaks.values())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--only", "discrete_asia,nothing"], "there is no 'nothing', but ekf_one_step"),
        (["--only", ""], "there is no '', but ekf_one_step"),
        (["--only", "discrete_asia", "--repeats", "0"], "--repeats must be 1 or more, not 0"),
    ],
)
def test_the_command_names_what_is_wrong(capsys, options, words):
    with pytest.raises(SystemExit):
        command.main(options)
    assert words in capsys.readouterr().err


def test_the_page_takes_its_numbers_from_the_summary(tmp_path, monkeypatch):
    (tmp_path / "images").mkdir()
    (tmp_path / "cost_against_size.png").write_bytes(b"a picture")
    path = tmp_path / "speed.md"
    path.write_text(f"before\n{page.FIRST}\nstale\n{page.LAST}\nafter\n", encoding="utf-8")
    whole = SUMMARY | {"versions": {"numpy": "2"}, "quick": False, "compile": {"map": {"jax": 1.5}}}
    (tmp_path / "summary.json").write_text(json.dumps(whole), encoding="utf-8")
    monkeypatch.setattr(page, "OUT", tmp_path)
    monkeypatch.setattr(page, "PAGE", path)
    page.main()
    text = path.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "stale" not in text
    assert "| `ekf_one_step` | simulation | 1000000 |" in text
    assert "`munin1.pgm` 3 s, 1024 MiB, `munin1.pyagrum` 15 s, 512 MiB" in text
    assert "| map: gtsam / pgm | 7.00 | ≥ 8 | **does not hold** |" in text
    assert "steps: dearest / cheapest step | 1.15 | ≤ 1.2 | holds |" in text
    assert (tmp_path / "images" / "cost_against_size.png").read_bytes() == b"a picture"
