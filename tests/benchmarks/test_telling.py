import json
import re
import time
from datetime import datetime
from types import SimpleNamespace

import pytest

from benchmarks import (
    choice,
    cliffs,
    command,
    curves,
    figure,
    first_call,
    gains,
    memory,
    neighbours,
    page,
    recorded,
    tables,
    threads,
    timing,
)
from benchmarks.row import part
from benchmarks.timing import Contender, medians
from benchmarks.verdicts import verdicts
from benchmarks.work import targets

EVERY = [page.ROOT / "README.md", *sorted((page.ROOT / "docs").rglob("*.md"))]
SUMMARY = {
    "map": {"pgm": 5.0, "gtsam": 45.0, "gtsam_levenberg_marquardt": 35.0},
    "ekf_one_step": {"pgm": 1.0, "dynamax": 1.4},
    "linear": {"pgm": 2.0, "pgm_compiled": 0.7, "dynamax": 4.0, "dynamax_sequential": 1.0},
    "no_jacobian_one": {"pgm": 1.0, "pgm_differences": 1.9},
    "rts_taylor": {"pgm": 1.3, "filterpy": 1.0},
    "repository_asia": {"pgm": 1.0, "pyagrum": 1.6, "pgmpy": 19.0},
    "cold_asia": {"pgm": 1.0, "pyagrum": 1.6, "pyagrum_shafer_shenoy": 0.8},
    "cold_survey": {"pgm": 1.0, "pyagrum": 1.6},
    "sets_asia": {"pgm": 1.0, "pyagrum": 25.0},
    "reading_alarm": {"pgm": 0.021, "pgmpy": 0.6},
    "munin1": {"pgm": 3.0, "pyagrum": 15.0},
    "repository_cancer": {"pgm": 2.0, "pyagrum": 8.0, "pgmpy": 60.0},
    "repository_survey": {"pgm": 1e-3, "pyagrum": 5e-3, "pgmpy": 2.0},
    "markov_1000": {
        "pgm": 2.0,
        "dynamax": 6.0,
        "dynamax_smoother": 3.0,
        "dynamax_called": 9.0,
        "hmmlearn": 9.0,
    },
    "markov_100": {"pgm": 2.8, "dynamax": 2.5, "dynamax_smoother": 2.0, "hmmlearn": 9.0},
    "markov_runs": {"pgm": 1.0, "pgm_alone": 2.0},
    "markov_shifts": {"pgm": 2e-3},
    "grid_filter": {"pgm": 1e-7, "stonesoup": 5e-7},
    "grid_smoother": {"pgm": 2e-7},
    "cliffs_many": {"pgm": 2.0, "missing": 2.5, "no_jacobian": 9.0, "own_taylor": 2.7},
    "cliffs_few": {"pgm": 1.0, "one_fewer": 1.05},
    "cliffs_online": {"pgm": 1.0, "own_taylor": 1.2},
    "neighbours_filter": {"pgm": 2e-6, "gate": 4e-6, "branch": 16e-6, "branch_alone": 5e-6},
    "neighbours_filter_code": {"pgm": 2e-7, "gate": 14e-7, "branch": 3e-6},
    "neighbours_online": {"pgm": 4e-6, "watch": 36e-6},
    "graph_city": {"pgm": 0.3, "pgm_compiled": 0.19, "gtsam": 1.0},
    "landmarks_300": {"pgm": 0.4, "gtsam": 1.0},
    "field_100": {"pgm": 24.0, "pgm_compiled": 11.0, "scipy": 1.0},
    "field_declared": {"pgm": 1.6},
    "graph_city_memory": {"pgm": 2.0, "gtsam": 9.0},
    "memory": {
        "munin1": {"pgm": 2**30, "pyagrum": 2**29},
        "graph_city_memory": {"pgm": 2**29, "gtsam": 2**27},
    },
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
        ("repository_survey: pgmpy / pgm", 2000.0, True),
        ("cold_asia: pgm / pyagrum's faster engine", 1.25, False),
        ("cold_survey: pgm / pyagrum's faster engine", 0.625, True),
        ("sets_asia: pyagrum / pgm", 25.0, True),
        ("markov_1000: fastest of dynamax / pgm", 1.5, False),
        ("markov_1000: fastest of hmmlearn / pgm", 4.5, True),
        ("markov_100: pgm / fastest of dynamax", 1.4, True),
        ("markov_runs: pgm / fastest of pgm_alone", 0.5, False),
        ("linear: pgm_compiled / fastest of dynamax", 0.7, False),
        ("no_jacobian_one: pgm_differences / pgm", 1.9, False),
        ("grid_filter: pgm / stonesoup", 0.2, True),
        ("grid_filter: steps a second", 1e7 / 482_400, False),
        ("grid_smoother: steps a second", 5e6 / 482_400, False),
        ("cliffs_many: missing / pgm", 1.25, True),
        ("cliffs_many: own_taylor / pgm", 1.35, False),
        ("cliffs_online: own_taylor / pgm", 1.2, True),
        ("cliffs_few: one_fewer / pgm", 1.05, True),
        ("neighbours_filter: gate / pgm", 2.0, True),
        ("neighbours_filter: gate / pgm in machine code", 7.0, False),
        ("neighbours_filter: branch microseconds", 16.0, False),
        ("neighbours_online: watch / pgm", 9.0, False),
        ("reading_alarm: pgmpy / pgm", 0.6 / 0.021, True),
        ("reading_alarm: milliseconds", 21.0, False),
        ("munin1: pyagrum / pgm", 5.0, True),
        ("munin1, peak of memory: pyagrum / pgm", 0.5, False),
        ("graph_city: pgm / gtsam", 0.3, False),
        ("graph_city: pgm_compiled / gtsam", 0.19, True),
        ("landmarks_300: pgm / gtsam", 0.4, True),
        ("field_100: pgm / scipy", 24.0, True),
        ("field_100: pgm_compiled / scipy", 11.0, False),
        ("field_declared: milliseconds", 1600.0, False),
        ("graph_city_memory, peak of memory: gtsam / pgm", 0.25, True),
    ):
        assert every[what].measured == pytest.approx(measured)
        assert every[what].holds == holds
    # Which are only told.
    assert not any("no_jacobian /" in what or "branch_alone" in what for what in every)
    assert len(every) == 7 + 14 + 7 + 3 + 4 + 7


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


def test_each_timed_call_is_handed_something_fresh(monkeypatch):
    monkeypatch.setattr(timing, "SHORTEST", 1e-4)
    made, given = [], []
    contender = Contender(given.append, 1, fresh=lambda: made.append(object()) or made[-1])
    medians({"a": contender}, 3)
    assert len(given) >= 4
    assert given == made
    assert len(set(map(id, given))) == len(given)


def test_making_what_a_call_is_handed_is_not_timed():
    def slow():
        begin = time.process_time()
        while time.process_time() - begin < 0.02:
            pass
        return 1

    assert timing.seconds(lambda one: one, 3, slow) < 0.01


def test_rows_say_which_of_their_turns_count(monkeypatch):
    times = {"a": [5.0, 1.0, 2.0], "b": [4.0, 7.0, 9.0]}
    monkeypatch.setattr(timing, "turns", lambda contenders, repeats: times)
    assert medians({}, 3) == {"a": 2.0, "b": 7.0}
    assert timing.least({}, 3) == {"a": 1.0, "b": 4.0}
    assert all(row.timed is timing.least for row in cliffs.ROWS)


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


def test_the_command_records_a_run(tmp_path, monkeypatch):
    path = tmp_path / "figures.json"
    path.write_text('{"runs": {}, "found": {}}', encoding="utf-8")
    monkeypatch.setattr(recorded, "FILE", path)
    only = "python -m benchmarks --only discrete_asia"
    options = ["--repeats", "1", "--record", "--out", str(tmp_path)]
    command.main([*only.split()[3:], *options])
    (run,) = recorded.read()["runs"].values()
    assert run["command"] == only
    assert recorded.read()["found"]["discrete_asia"]["seconds"].keys() >= {"pgm"}


def test_a_quick_run_leaves_large_work_out():
    names = choice.short().names
    assert {"repository_alarm", "sets_andes", "reading_alarm", "map"} < set(names)
    large = {"repository_child", "sets_hepar2", "reading_munin", "munin1", "field_300"}
    assert not large & set(names)
    assert {"cliffs_many", "cliffs_one", "cliffs_online", "cliffs_few"} < set(names)
    assert {"repository_child", "munin1", "field_300"} < set(choice.Choice().names)


def test_rows_are_chosen_by_name_or_by_the_words_they_begin_with():
    every = choice.Choice()
    assert every.only("map, cliffs").names == [
        "map",
        *("cliffs_many", "cliffs_one", "cliffs_online", "cliffs_few"),
    ]
    assert [row.name for row in every.only("neighbours").rows] == [
        f"neighbours_{each}"
        for each in ("filter", "smoother", "online", "filter_code", "smoother_code")
    ]
    assert every.only("munin1,filter").names == ["munin1", "filter"]
    assert len(every.only("sets").rows) == 12
    for wrong in ("cliff", "sets_", "map,"):
        with pytest.raises(ValueError, match=r"^there is no '.*', but ekf_one_step, ukf_one_step"):
            every.only(wrong)


def test_memory_is_measured_beside_chosen_libraries():
    chosen = choice.Choice().only("munin1,graph_city").against("gtsam")
    assert [row.name for row in chosen.rows] == ["graph_city"]
    assert [(each.name, list(each.libraries)) for each in chosen.networks] == [
        ("graph_city_memory", ["pgm", "gtsam"])
    ]


def test_contenders_are_chosen_beside_pgm():
    chosen = choice.Choice().only("cliffs,ekf").against("missing,filterpy")
    assert {row.name: list(row.contenders) for row in chosen.rows} == {
        "ekf_one_step": ["pgm", "filterpy"],
        "ekf_robots": ["pgm", "filterpy"],
        "cliffs_many": ["pgm", "missing"],
        "cliffs_one": ["pgm", "missing"],
    }
    assert not chosen.curves
    assert not chosen.networks
    assert not choice.Choice().against("filterpy").networks
    assert [each.name for each in choice.Choice().against("pyagrum").networks] == ["munin1"]
    with pytest.raises(ValueError, match="there is no 'filterpy', but one_fewer"):
        choice.Choice().only("cliffs_few").against("filterpy")
    with pytest.raises(ValueError, match="there is no 'jax', but none"):
        choice.Choice().only("filter").against("jax")


def test_memory_is_of_each_library_in_its_own_process():
    pytest.importorskip("pyagrum", reason="pyagrum comes with the extra bench")
    pytest.importorskip("pgmpy", reason="the networks come with pgmpy")
    times, peaks = memory.measure(memory.discrete("asia"))
    assert set(times) == set(peaks) == {"pgm", "pyagrum"}
    assert all(0.0 < each < 60.0 for each in times.values())
    assert all(0 < each < 2**30 for each in peaks.values())


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--only", "discrete_asia,nothing"], "there is no 'nothing', but ekf_one_step"),
        (["--only", ""], "there is no '', but ekf_one_step"),
        (["--only", "linear", "--against", "filterpy"], "there is no 'filterpy', but cuthbert"),
        (["--only", "discrete_asia", "--repeats", "0"], "--repeats must be 1 or more, not 0"),
    ],
)
def test_the_command_names_what_is_wrong(capsys, options, words):
    with pytest.raises(SystemExit):
        command.main(options)
    assert words in capsys.readouterr().err


WHOLE = SUMMARY | {
    "versions": {"processor": "some"},
    "quick": False,
    "compile": {"map": {"jax": 1.5}},
}


def recorded_in(tmp_path, monkeypatch, summary):
    path = tmp_path / "figures.json"
    path.write_text('{"runs": {}, "found": {}}', encoding="utf-8")
    monkeypatch.setattr(recorded, "FILE", path)
    recorded.add(recorded.entries(summary), "make bench", summary["versions"])
    return recorded.read()


def test_tables_take_their_numbers_from_the_recorded_figures(tmp_path, monkeypatch):
    figures = recorded_in(tmp_path, monkeypatch, WHOLE)
    names = "rows", "changes", "neighbours", "what does not hold", "beside other libraries"
    stale = [
        f"{name}\n<!-- figures of speed: {name} -->\nstale\n<!-- end of figures -->\n"
        for name in names
    ]
    text = page.written("before\n" + "".join(stale) + "after\n", figures)
    assert text.startswith("before\nrows\n")
    assert text.endswith("after\n")
    assert "stale" not in text
    assert "| `ekf_one_step` | simulation | 1,000,000 |" in text
    assert "| `repository_…`, 3 networks | set of evidence | 1,000–2,000,000 |" in text
    assert "|  | pyagrum 1.6–5 ×, median 4 ×; pgmpy 19–2,000 ×, median 30 × |" in text
    assert "| `sets_asia` | set of evidence | 1,000,000 |" in text
    assert "| `field_100` | variable | 24,000,000 | 11,000,000 | scipy 1,000,000 |" in text
    assert "repository_asia`" not in text
    assert "| one measurement in 100,000 missing | 1.25 |  |  | 1.3 |" in text
    assert "| the motion without a Jacobian | 4.50 |  |  |  |" in text
    assert "| 31 runs instead of 32 | 1.05 |  |  | 1.1 |" in text
    assert "| 1.35 |  | 1.20 | 1.3 |" in text
    assert "| filter | `gate=0.99` | 4.00 | 2.00 | 1.40 | 7.00 | 6 × | does NOT hold |" in text
    assert "called back | 16.00 | 8.00 | 3.00 | 15.00 | 15 µs | does NOT hold |" in text
    assert "| filter | the branch's function alone | 5.00 | 2.50 |  |  |  |  |" in text
    assert "| online | `watch=True` | 36.00 | 9.00 |  |  | 8 × | does NOT hold |" in text
    assert "`neighbours_filter`" not in text
    assert "| map: gtsam / pgm | 7.00 | ≥ 8 | **does not hold** |" in text
    assert "Of 42 requirements" in text
    assert "≤ 6 | holds |" not in text
    assert "| smoother of one robot, Taylor | 1,300,000 |  | filterpy 1,000,000 |" in text
    assert "`make bench`: some.*" in text
    every = "\n".join([*tables.every(figures), *tables.asked(figures)])
    assert "| `repository_asia` | set of evidence | 1,000,000 |" in every
    assert "`munin1.pgm` 3 s, 1024 MiB, `munin1.pyagrum` 15 s, 512 MiB" in every
    assert "`map.jax` 1.5 s" in every
    assert "| map: gtsam / pgm | 7.00 | ≥ 8 | **does not hold** |" in every
    assert "steps: dearest / cheapest step | 1.15 | ≤ 1.2 | holds |" in every
    assert "`cliffs_many.missing`" not in every


def test_a_run_replaces_its_entries_and_leaves_the_others(tmp_path, monkeypatch):
    before = recorded_in(tmp_path, monkeypatch, WHOLE)
    (run,) = before["runs"]
    old = {"versions": {}, "compile": {}, "memory": {}, "curves": {}}
    times = {"ekf_one_step": {"pgm": 7.0, "dynamax": 7.0}}
    monkeypatch.setattr(recorded, "datetime", SimpleNamespace(now=lambda: datetime(2100, 1, 2)))
    recorded.add(recorded.entries(old | times), "python -m benchmarks --only ekf_one_step", {})
    after = recorded.read()
    assert list(after["runs"]) == [run, "2100-01-02T00:00"]
    assert after["found"]["ekf_one_step"] == {
        "run": "2100-01-02T00:00",
        "seconds": times["ekf_one_step"],
    }
    assert after["found"]["map"] == before["found"]["map"]
    assert recorded.summary(after)["curves"] == SUMMARY["curves"]
    recorded.add({name: {} for name in after["found"]}, "make bench", {})
    assert run not in recorded.read()["runs"]  # of which nothing is left


def test_only_whole_rows_are_recorded(capsys):
    for options in (["--quick"], ["--against", "dynamax", "--only", "ekf"]):
        with pytest.raises(SystemExit):
            command.main([*options, "--record"])
        assert "--record is of whole rows at full size" in capsys.readouterr().err


def test_figures_of_which_all_holds_say_so():
    times = {"run": "2100-01-02T00:00", "seconds": {"pgm": 1.0, "dynamax": 1.4}}
    assert list(tables.broken({"found": {"ekf_one_step": times}})) == [
        "Of 1 requirements all hold."
    ]


@pytest.mark.parametrize("path", page.pages(), ids=lambda path: path.stem)
def test_pages_have_the_recorded_figures(path):
    text = path.read_text(encoding="utf-8")
    try:
        written = page.written(text, recorded.read())
    except FileNotFoundError as error:
        pytest.skip(str(error))
    assert written == text, "run python -m benchmarks.page"


@pytest.mark.parametrize("path", EVERY, ids=lambda path: path.stem)
def test_microseconds_stand_in_tables_of_recorded_figures_alone(path):
    """Else two pages could differ for one row."""
    prose = page.MARKED.sub("", path.read_text(encoding="utf-8"))
    assert not re.search(r"\d (µs|microseconds)", prose)


def test_a_first_call_is_measured_in_processes_of_their_own(monkeypatch):
    started = []

    def run(command, **_):
        started.append(command[-1])
        answer = {"seconds": 2.0} if command[-1] == "pgm_compiled" else {"missing": "no dynamax"}
        return SimpleNamespace(stdout=json.dumps(answer))

    monkeypatch.setattr(first_call.subprocess, "run", run)
    assert first_call.measure("rts_taylor") == {"pgm": 2.0}
    assert started == ["pgm_compiled", "dynamax"]


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_gains_are_timed_beside_numpy_and_compiled(monkeypatch, capsys):
    pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")
    monkeypatch.setattr(gains, "STEPS", 6)
    monkeypatch.setattr(gains, "BY_NUMPY", 6)
    monkeypatch.setattr(gains, "REPEATS", 1)
    monkeypatch.setattr(gains, "least", lambda found, _: dict.fromkeys(found, 1e-6))
    gains.main()
    shown = capsys.readouterr().out
    assert all(words in shown for words in gains.WAYS)
    assert "not compiled" not in shown


def test_the_first_call_of_each_neighbour_is_judged(monkeypatch):
    asked = []

    def answer(*arguments):
        asked.append(arguments)
        return {"missing": "no llvmlite"} if "gate" in arguments else {"seconds": 1.2}

    monkeypatch.setattr(first_call, "_answer", answer)
    lines = list(first_call.nearby())
    limited = [each for each in neighbours.NEIGHBOURS if each.asked is not None]
    assert asked == [(f"neighbours_{each.row}", each.name) for each in limited]
    assert len(lines) == len(limited) - sum(each.name == "gate" for each in limited)
    assert set(lines) >= {("online", "`watch=True`", "1.20", "1", "does NOT hold")}


def test_threads_are_timed_in_turns_and_judged(monkeypatch, capsys):
    pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")
    monkeypatch.setattr(threads, "RUNS", 20)
    monkeypatch.setattr(threads, "STEPS", 3)
    threads.main()
    shown = capsys.readouterr().out
    assert shown.count("smoother") == shown.count("unscented") == 2
    assert "one thread / two: " in shown
