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

from experiments.catalogue import EXPERIMENTS, THEMES
from experiments.record import FolderError, Record, note
from experiments.report import command, report
from experiments.report.command import make_report
from experiments.report.findings import FINDINGS
from experiments.report.page import page
from experiments.report.parts import LONG, WIDE, part, settings, table
from experiments.report.reproduced import REPRODUCED
from experiments.report.running import Outcome

VOID = {"meta", "img", "br", "link"}
# Experiments that take a second or less.
SHORT = (
    "basics",
    "kalman",
    "imu_heading",
    "cluster_graph",
    "seven_nodes",
    "grid_world",
    "hallway",
    "maze",
    "topological",
)
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
    record.table(
        "Numbers",
        ("what", "value", "why"),
        [("x", 1.25, "a"), ("y", -3, "b")],
        about="The <values>.",
        best={"value": -float("inf")},
    )
    record.table("Aside", ("what",), [("z",)], folded=True)
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
    record.picture("nowhere.png", "It is nowhere.")
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
    section = reader.text[reader.text.rindex("One that draws") :]
    places = [section.index(words) for words in parts]
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
    assert '<tr><td>y</td><td class="number best">-3</td><td>b</td></tr>' in text
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
    assert ("<td class=number>" in tabled(("a",), [(cell,)])) == right


def test_a_column_with_a_gap_is_still_of_numbers():
    assert tabled(("a",), [("1.5",), ("",), ("–",)]).count("class=number") == 4
    assert "class=number" not in tabled(("a",), [("1.5",), ("filter",)])
    assert "<th>a</th>" in tabled(("a",), [])


def tabled(columns, rows, **more):
    return table({"table": "t", "columns": columns, "rows": rows, **more})


def test_a_table_says_what_its_columns_are(done):
    _, _, text, reader = done
    assert "The <values>. Bold: best of its column; near ones may differ by chance." in reader.text
    assert "<p class=about>The &lt;values&gt;. Bold" in text
    told = tabled(("s", "KL"), [("1", "2"), ("1", "3")], best=[[0, 1]], within=["s"])
    assert "Bold: best of its column, within rows of one s; near" in told


def test_wide_long_and_supporting_tables_are_folded(done):
    wide, long = [["1"] * WIDE], [["1"]] * LONG
    assert "<details>" not in tabled(["a"] * WIDE, wide)
    assert "<details>" not in tabled(["a"], long)
    assert "<details>" in tabled(["a"] * (WIDE + 1), [["1"] * (WIDE + 1)])
    folded = tabled(["a"], [*long, ["1"]])
    assert folded.startswith("<details>")
    assert f"<span class=meta>{LONG + 1} rows</span></summary>" in folded
    assert re.search(
        r"<details>\n<summary><span class=title>Aside</span> <span class=meta>1 row<", done[2]
    )


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


@pytest.fixture(scope="module")
def short(tmp_path_factory, quick):
    """The report of the experiments that take a second or less."""
    out = tmp_path_factory.mktemp("short")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(command, "run_all", lambda experiments, *_, **__: map(quick, experiments))
        return out, make_report({name: EXPERIMENTS[name] for name in SHORT}, out, quick=True)


def test_what_is_reproduced_is_linked_where_it_is_shown(short):
    out, outcomes = short
    assert not any(outcome.error for outcome in outcomes)
    reader = Reader((out / "index.html").read_text())
    for item, _, name in REPRODUCED:
        assert item in reader.text
        assert (f"#{name}" in reader.links) == (name in SHORT)
    # Every figure that is said to be reproduced has its number in a caption.
    for item, _, name in REPRODUCED:
        if name in ("kalman", "cluster_graph"):
            assert f"{item}: " in reader.text


def test_contents_are_by_theme(short):
    text = Reader((short[0] / "index.html").read_text()).text
    themes = [theme for theme, group in THEMES.items() if set(group) & set(SHORT)]
    places = [text.index(theme) for theme in themes]
    assert places == sorted(places)
    assert "Recorded robots" not in text[text.index("Contents") : text.index("reproduced")]


def test_the_page_can_be_read_by_itself(short):
    readable(*short)


def readable(out, outcomes):
    """Nothing lacks its caption or its columns' meaning, and findings are the summaries' own."""
    text = (out / "index.html").read_text()
    reader = Reader(text)
    shown = [(tag, found) for tag, found in reader.tags if tag == "img"]
    captions = re.findall(r"<figcaption>([^<]+)</figcaption>", text)
    assert len(captions) == len(shown)
    assert all(found["alt"] for _, found in shown)
    for outcome in outcomes:
        for entry in (outcome.summary or {"page": ()})["page"]:
            if "figure" in entry:
                assert len(entry["caption"].split()) >= 3, (outcome.name, entry["figure"])
            if "table" in entry:
                named = (outcome.name, entry["table"])
                assert entry["about"], named
                assert all(entry["columns"]), named
                assert len(set(entry["columns"])) == len(entry["columns"]) or "±" in str(
                    entry["columns"]
                ), named
    # Outside a fold no table is wider or longer than a page.
    for opened in re.sub(r"<details>.*?</details>", "", text, flags=re.S).split("<table>")[1:]:
        head, body = opened.split("</table>")[0].split("</thead>")
        assert head.count("<th") - 1 <= WIDE  # less that of <thead>
        assert body.count("<tr>") <= LONG
    bound = dict.fromkeys(FINDINGS, ())
    for name in bound:
        found = re.search(rf'<section id="{name}">.*?</section>', text, flags=re.S)
        bound[name] = re.findall(r'<data value="([^"]+)">([^<]+)</data>', found[0] if found else "")
    for outcome in outcomes:
        if outcome.summary:
            assert bound[outcome.name], outcome.name
            for path, number in bound[outcome.name]:
                form = re.escape(path) + r"(?::([^}]+))?\}"
                shape = re.search(form, FINDINGS[outcome.name].sentence)[1] or ""
                due = format(number_at(path, outcome.summary), shape)
                assert number.replace("−", "-") == due, (outcome.name, path)


def number_at(path, summary):
    """The number at a path of a summary, found without the report's own code."""
    one, _, other = path.partition(" against ")
    if other:
        return number_at(one, summary) / number_at(other, summary) - 1
    for key in path.split("/"):
        if isinstance(summary, list):
            summary = summary[int(key)]
        else:
            summary = next(iter(summary.values())) if key == "*" else summary[key]
    return summary


def test_headlines_begin_the_page(tmp_path):
    outcomes = [headline_outcome(tmp_path)]
    text = page(outcomes, {"python": "3"}, "today", quick=False)
    reader = Reader(text)
    question = FINDINGS["smoothing"].question
    assert reader.text.index("In short") < reader.text.index(question)
    assert reader.text.index(question) < reader.text.index("Contents")
    before, _, after = text.partition('<nav id="contents">')
    assert re.findall(r'<data value="[^"]+">([^<]+)</data>', before) == [
        "7", "20", "0.300", "0.400", "−25%", "3.10", "4.20",
    ]  # fmt: skip
    assert before.count("<img") == after.count("<img") == 1
    assert "What it <shows>." in reader.text


def test_a_headline_without_results_says_so(tmp_path):
    (lost,) = make_report({"plaza": SimpleNamespace(run=speaks, QUICK={})}, tmp_path)
    assert lost.summary is None
    assert "plaza: no results in this run." in (tmp_path / "index.html").read_text()


def headline_outcome(folder):
    """An outcome as the experiment `smoothing` leaves it."""
    (folder / "rmse.png").write_bytes(b"\x89PNG" + bytes(20))
    each = {"rmse": (0.3, 0.4), "nees": (3.1, 4.2)}
    summary = {
        "settings": {"runs": 7, "steps": 20},
        **{
            key: {"Unscented": {"smoother": smoother, "filter": filtered}}
            for key, (smoother, filtered) in each.items()
        },
        "page": [{"figure": "rmse.png", "caption": "What it <shows>."}],
    }
    return Outcome("smoothing", "Smooth", "python", folder, 1.0, summary, "", "")


def test_an_empty_page_is_a_page():
    Reader(page([], {"python": "3"}, "today", quick=False))


@pytest.mark.slow
def test_the_whole_report_quickly(tmp_path):
    outcomes = make_report(EXPERIMENTS, tmp_path, quick=True)
    assert {outcome.name for outcome in outcomes if outcome.error} == set()
    readable(tmp_path, outcomes)
    reader = Reader((tmp_path / "index.html").read_text())
    assert set(EXPERIMENTS) <= set(reader.ids)
    assert {name for _, _, name in REPRODUCED} <= set(EXPERIMENTS)
