"""One page with all outcomes, which needs nothing but itself."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template

from experiments.catalogue import THEMES
from experiments.report.findings import FINDINGS, answer
from experiments.report.parts import figure, part, settings
from experiments.report.reproduced import REPRODUCED
from experiments.report.running import Outcome

TEMPLATE = Path(__file__).with_name("page.html")
_QUICK = (
    "<p class=quick>Quick settings: this page shows that every experiment runs. Its numbers come "
    "from too few runs to conclude anything.</p>"
)


def page(outcomes: Sequence[Outcome], versions: Mapping[str, str], made: str, quick: bool) -> str:
    """The page as HTML.

    Parameters
    ----------
    outcomes : sequence of Outcome
        In the order shown.
    versions : mapping of str to str
        Of Python and of packages.
    made : str
        When, how, and with which seed.
    quick : bool
        Whether the settings were the quick ones.
    """
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        made=escape(made),
        versions=settings(versions),
        warning=_QUICK if quick else "",
        headlines=_headlines({outcome.name: outcome for outcome in outcomes}),
        contents="\n".join(_contents(outcomes)),
        reproduced=_reproduced({outcome.name for outcome in outcomes}),
        sections="\n".join(map(_section, outcomes)),
    )


def state(outcome: Outcome) -> str:
    """The fault of an outcome, in two words; nothing where it is complete."""
    if outcome.error:
        return "failed"
    return "" if outcome.summary else "no results"


def _headlines(outcomes: Mapping[str, Outcome]) -> str:
    """The questions that a reader has first, each with its sentence and its figure."""
    shown = []
    for name, finding in FINDINGS.items():
        if finding.figure and name in outcomes:
            outcome = outcomes[name]
            lines = [f"<article>\n<h3>{escape(finding.question)}</h3>"]
            if outcome.summary is None:
                lines.append(f"<p class=meta>{escape(name)}: {state(outcome)} in this run.</p>")
            else:
                lines.append(f"<p>{answer(name, outcome.summary)}</p>")
                file = f"{finding.figure}.png"
                caption = next(
                    each["caption"]
                    for each in outcome.summary["page"]
                    if each.get("figure") == file
                )
                lines.append(figure(outcome.folder / file, caption))
            lines.append(
                f'<p class=top><a href="#{name}">more of {escape(name)}</a></p>\n</article>'
            )
            shown.append("\n".join(lines))
    return "\n".join(shown) or "<p class=meta>No experiment of this run has a headline.</p>"


def _contents(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Entries by theme; experiments that the catalogue lacks come last."""
    themed = {name: theme for theme, group in THEMES.items() for name in group}
    for theme in (*THEMES, "Others"):
        entries = [_entry(each) for each in outcomes if themed.get(each.name, "Others") == theme]
        if entries:
            yield f"<h4>{escape(theme)}</h4>\n<ul>\n" + "\n".join(entries) + "\n</ul>"


def _entry(outcome: Outcome) -> str:
    wrong = f" <span class=state>({found})</span>" if (found := state(outcome)) else ""
    return (
        f'<li><a href="#{escape(outcome.name)}">{escape(outcome.title)}</a>{wrong} '
        f"<span class=meta>{escape(outcome.name)}</span></li>"
    )


def _reproduced(names: set[str]) -> str:
    rows = []
    for item, shows, name in REPRODUCED:
        where = f'<a href="#{name}">{name}</a>' if name in names else f"{name} (not in this page)"
        rows.append(f"<tr><td>{item}</td><td>{escape(shows)}</td><td>{where}</td></tr>")
    body = "\n".join(rows)
    head = "<thead><tr><th>the report's</th><th>what it shows</th><th>experiment</th></tr></thead>"
    return f'<div class="table wrap"><table>\n{head}\n<tbody>\n{body}\n</tbody></table></div>'


def _section(outcome: Outcome) -> str:
    lines = [
        f'<section id="{escape(outcome.name)}">',
        f"<h2>{escape(outcome.title)}</h2>",
        f"<p class=meta><code>{escape(outcome.command)}</code> · {outcome.seconds:.1f} s</p>",
    ]
    if outcome.error:
        last = outcome.error.strip().splitlines()[-1]
        lines.append(f"<p class=bad>It failed: {escape(last)}</p>")
        lines.append(f"<pre>{escape(outcome.error)}</pre>")
    if outcome.summary:
        if found := answer(outcome.name, outcome.summary):
            question = escape(FINDINGS[outcome.name].question)
            lines.append(f"<p class=finding><b>{question}</b> {found}</p>")
        lines += [part(entry, outcome.folder) for entry in outcome.summary["page"]]
        used = settings(outcome.summary["settings"])
        lines.append(f"<details>\n<summary>Settings</summary>\n<p>{used}</p>\n</details>")
    elif not outcome.error:
        said = f"It wrote no results. It said: {escape(outcome.said.strip())}"
        lines.append(f"<p class='bad note'>{said}</p>")
    lines.append("<p class=top><a href='#top'>to the top</a></p>\n</section>")
    return "\n".join(lines)
