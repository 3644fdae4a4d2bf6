"""One page with all outcomes, which needs nothing but itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template

from experiments.report.parts import part, settings
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
        contents="\n".join(map(_entry, outcomes)),
        reproduced=_reproduced({outcome.name for outcome in outcomes}),
        sections="\n".join(map(_section, outcomes)),
    )


def state(outcome: Outcome) -> str:
    """What is wrong with an outcome, in two words; nothing where it is complete."""
    if outcome.error:
        return "failed"
    return "" if outcome.summary else "no results"


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
        lines.append(f"<p class=meta>{settings(outcome.summary['settings'])}</p>")
        lines += [part(entry, outcome.folder) for entry in outcome.summary["page"]]
    elif not outcome.error:
        said = f"It wrote no results. It said: {escape(outcome.said.strip())}"
        lines.append(f"<p class='bad note'>{said}</p>")
    lines.append("<p class=top><a href='#top'>to the top</a></p>\n</section>")
    return "\n".join(lines)
