"""The report page: complete, self-contained, and not lost where an experiment is."""

import base64
import functools
import json
import re
from html.parser import HTMLParser
from types import SimpleNamespace

import matplotlib.pyplot as plt
import pytest
import typer
from typer.testing import CliRunner

from experiments import cluster_graph, kalman
from experiments.catalogue import EXPERIMENTS
from experiments.record import FolderError, Record, note
from experiments.report import command, report
from experiments.report.command import make_report
from experiments.report.page import page
from experiments.report.parts import part, settings, table
from experiments.report.reproduced import REPRODUCED

VOID = {"meta", "img", "br", "link"}
GIF = b"GIF89a" + bytes(20)


def draws(out=None, seed=0, runs=100):
    """One that draws.

    More of it.
    """
    record = Record("draws", out, seed=seed, runs=runs)
    record.note("a < b & <script>alert(1)</script>\n  its second line")
    figure = plt.figure(figsize=(3, 2))
    record.figure(figure, "plot", "A “caption” <b>")
    plt.close(figure)
    (record.folder / "move.gif").write_bytes(GIF)
    record.picture("move.gif", "It moves.")
    record.table("Numbers", ("what", "value", "why"), [("x", 1.25, "a"), ("y", -3, "b")])
    record.summary(answer=runs)


def fails(out=None):
    """One that fails."""
    raise ValueError("no <evidence>")


def speaks(out=None, seed=0):
    """One without data."""
    note("there are no recordings; install them")


def half(out=None):
    """One whose picture is missing."""
    record = Record("half", out)
    record.picture("nowhere.png")
    record.summary()


GOOD = {"draws": SimpleNamespace(run=draws, QUICK={"runs": 2})}
ALL = {
    "fails": SimpleNamespace(run=fails, QUICK={}),
    "speaks": SimpleNamespace(run=speaks, QUICK={}),
    "half": SimpleNamespace(run=half, QUICK={}),
    **GOOD,
}


class Reader(HTMLParser):
    """Reads a page, and refuses one whose tags do not match."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text, self.ids, self.links, self.sources = [], [], "", [], [], []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag, attrs):
        found = dict(attrs)
        self.tags.append((tag, found))
        if "id" in found:
            self.ids.append(found["id"])
        self.links += [found["href"]] if "href" in found else []
        self.sources += [found["src"]] if "src" in found else []
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("report")
    outcomes = make_report(ALL, out, seed=3, quick=True)
    text = (out / "index.html").read_text(encoding="utf-8")
    return out, {outcome.name: outcome for outcome in outcomes}, text, Reader(text)


def test_one_failure_does_not_lose_the_others(done):
    out, outcomes, _, reader = done
    assert list(outcomes) == list(ALL)
    assert "ValueError: no <evidence>" in outcomes["fails"].error
    assert "It failed: ValueError: no <evidence>" in reader.text
    assert not outcomes["speaks"].error
    assert "It said: there are no recordings; install them" in reader.text
    assert "the page names nowhere.png" in outcomes["half"].error
    assert not outcomes["draws"].error
    assert json.loads((out / "draws" / "summary.json").read_text())["answer"] == 2


def test_contents_lead_to_every_section(done):
    _, _, _, reader = done
    inside = [link[1:] for link in reader.links if link.startswith("#")]
    assert set(ALL) <= set(inside) <= set(reader.ids)
    for title in ("One that draws", "One that fails", "One without data"):
        assert reader.text.count(title) == 2
    assert reader.text.count("(failed)") == 2
    assert reader.text.count("(no results)") == 1
    assert "More of it" not in reader.text


def test_pictures_are_inside_and_nothing_is_outside(done):
    out, _, text, reader = done
    kinds, contents = [], []
    for source in reader.sources:
        kind, data = re.fullmatch(r"data:([a-z/]+);base64,(.+)", source).groups()
        kinds.append(kind)
        contents.append(base64.b64decode(data))
    assert kinds == ["image/png", "image/gif"]
    assert contents == [(out / "draws" / "plot.png").read_bytes(), GIF]
    assert all(link.startswith("#") for link in reader.links)
    assert not re.search(r"https?://|url\(|@import", text)
    assert "script" not in {tag for tag, _ in reader.tags}


def test_texts_are_shown_word_for_word_and_in_order(done):
    _, _, text, reader = done
    parts = ["a < b & <script>alert(1)</script>", "A “caption” <b>", "It moves.", "Numbers"]
    places = [reader.text.index(words) for words in parts]
    assert places == sorted(places)
    assert "<script>" not in text


def test_a_note_keeps_its_lines(done):
    _, _, text, _ = done
    assert re.search(r"<p class=note>a &lt; b .*&gt;\n  its second line</p>", text)
    assert ".note { white-space: pre-wrap; }" in text


def test_each_is_shown_with_the_command_that_makes_it(done, tmp_path):
    assert "python -m experiments draws --seed 3 --runs 2 · " in done[3].text
    assert "python -m experiments fails · " in done[3].text
    assert make_report(GOOD, tmp_path)[0].command == "python -m experiments draws"


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_command_of_an_experiment_has_its_settings(name, tmp_path):
    """What the command line makes of it is what `run` was called with."""
    run, quick, called = EXPERIMENTS[name].run, EXPERIMENTS[name].QUICK, {}
    fake = functools.wraps(run)(lambda **settings: called.update(settings))
    (outcome,) = make_report({name: SimpleNamespace(run=fake, QUICK=quick)}, tmp_path, quick=True)
    python, _, module, word, *options = outcome.command.split()
    assert (python, module, word) == ("python", "experiments", name)
    app = typer.Typer()
    app.command()(run)
    parsed = typer.main.get_command(app).make_context(name, options).params
    assert called.pop("out") == tmp_path / name
    assert called == {key: parsed[key] for key in called}


def test_settings_seed_versions_and_size_are_told(done):
    _, _, _, reader = done
    assert "seed 3 · runs 2" in reader.text
    assert "quick settings" in reader.text
    assert re.search(r"python 3\.\d+", reader.text)
    assert "numpy" in reader.text


def test_numbers_are_set_right(done):
    _, _, text, _ = done
    assert "<tr><td>x</td><td class=number>1.25</td><td>a</td></tr>" in text
    assert "<th class=number>value</th>" in text


@pytest.mark.parametrize(
    ("cell", "right"),
    [
        ("0.0057", True),
        ("-1.2e-05", True),
        ("0.07 ± 0.01", True),
        ("93%", True),
        ("0.1–0.4", True),
        ("nan", True),
        ("–", False),
        ("Taylor", False),
        ("10 samples", False),
        ("2-D", False),
    ],
)
def test_what_a_number_is(cell, right):
    assert ("<td class=number>" in table("t", ("a",), [(cell,)])) == right


def test_a_column_with_a_gap_is_still_of_numbers():
    assert table("t", ("a",), [("1.5",), ("",), ("–",)]).count("class=number") == 4
    assert "class=number" not in table("t", ("a",), [("1.5",), ("filter",)])
    assert "<th>a</th>" in table("t", ("a",), [])


def test_an_unknown_part_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"figures, tables and notes; found \['video'\]"):
        part({"video": "x"}, tmp_path)


def test_settings_are_read_easily():
    found = settings({"a": 0.50, "b": [1, 2.0], "c": {"d": None}, "e": "<"})
    assert found == "a 0.5 · b [1, 2] · c (d none) · e &lt;"


def test_an_earlier_summary_is_not_taken_for_a_new_one(tmp_path):
    make_report(GOOD, tmp_path)
    changed = {"draws": SimpleNamespace(run=fails, QUICK={})}
    outcome = make_report(changed, tmp_path)[0]
    assert outcome.summary is None
    assert "It failed" in (tmp_path / "index.html").read_text()


def test_a_folder_that_cannot_be_is_refused_before_anything_runs(tmp_path):
    taken = tmp_path / "taken"
    taken.write_text("")
    ran = SimpleNamespace(run=lambda out=None: pytest.fail("it ran"), QUICK={})
    for out in (taken, taken / "below"):
        with pytest.raises(FolderError, match=r"cannot be written into .*taken"):
            make_report({"ran": ran}, out)


def test_a_file_in_the_place_of_one_folder_does_not_lose_the_others(tmp_path):
    (tmp_path / "half").write_text("")
    half, draws = make_report({name: ALL[name] for name in ("half", "draws")}, tmp_path)
    assert "half" in half.error
    assert draws.summary is not None


@pytest.fixture
def run(monkeypatch, tmp_path):
    """The command line with few experiments."""
    app = typer.Typer()
    app.command()(report)
    monkeypatch.setattr(command, "EXPERIMENTS", ALL)
    return lambda *words: CliRunner().invoke(app, ["--out", str(tmp_path), *words])


def test_the_command_fails_where_an_experiment_does(run, tmp_path):
    assert run("--quick", "--only", "draws").exit_code == 0
    assert "One that fails" not in (tmp_path / "index.html").read_text()
    assert run("--only", "draws", "--only", "speaks").exit_code == 0
    assert "quick settings" not in (tmp_path / "index.html").read_text().lower()
    assert run("--quick").exit_code == 1
    assert "One that draws" in (tmp_path / "index.html").read_text()


def test_an_unknown_experiment_is_named(run):
    result = run("--only", "drawz")
    assert result.exit_code == 2
    assert "drawz" in result.output


def test_what_is_reproduced():
    assert {item: name for item, _, name in REPRODUCED} == {
        "Figure 2.1": "basics",
        "Figure 2.2": "basics",
        "Figure 3.1": "basics",
        "Figure 3.2": "basics",
        "Figure 4.1": "kalman",
        "Figure 4.2": "kalman",
        "Figure 4.3": "kalman",
        "Figures 5.1 and 5.2": "basics",
        "Figures 5.3–5.5": "seven_nodes",
        "Figure 6.1": "cluster_graph",
        "Figure 6.2": "cluster_graph",
        "Table 8.1": "linearisers",
        "Table 8.2": "linearisers",
        "Figure 8.1": "linearisers",
    }


def test_what_is_reproduced_is_linked_where_it_is_shown(tmp_path):
    chosen = {"kalman": kalman, "cluster_graph": cluster_graph}
    outcomes = make_report(chosen, tmp_path, quick=True)
    assert not any(outcome.error for outcome in outcomes)
    reader = Reader((tmp_path / "index.html").read_text())
    for item, _, name in REPRODUCED:
        assert item in reader.text
        assert (f"#{name}" in reader.links) == (name in chosen)
    assert sum(source.startswith("data:image/png") for source in reader.sources) == 6
    # Every figure that is said to be reproduced has its number in a caption.
    for item, _, name in REPRODUCED:
        assert name not in chosen or f"{item}: " in reader.text


def test_an_empty_page_is_a_page():
    Reader(page([], {"python": "3"}, "today", quick=False))


@pytest.mark.slow
def test_the_whole_report_quickly(tmp_path):
    outcomes = make_report(EXPERIMENTS, tmp_path, quick=True)
    assert {outcome.name for outcome in outcomes if outcome.error} == set()
    reader = Reader((tmp_path / "index.html").read_text())
    assert set(EXPERIMENTS) <= set(reader.ids)
    assert {name for _, _, name in REPRODUCED} <= set(EXPERIMENTS)
