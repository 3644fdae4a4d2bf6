"""What the pages must hold: links that lead somewhere, all public names, all pictures."""

import importlib
import inspect
import re

import pytest
from building import programs

import pgm
from experiments.catalogue import EXPERIMENTS

README = programs.ROOT / "README.md"
PAGES = [README, *sorted(programs.DOCS.rglob("*.md"))]
_FENCE = re.compile(r"^```.*?^```", flags=re.MULTILINE | re.DOTALL)
_API = "\n".join(page.read_text(encoding="utf-8") for page in (programs.DOCS / "api").glob("*.md"))


def text(page):
    return page.read_text(encoding="utf-8")


def name(page):
    return page.relative_to(programs.ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_and_pictures_lead_to_files(page):
    for target in re.findall(r"\]\(([^)]+)\)", _FENCE.sub("", text(page))):
        if "://" not in target and not target.startswith("#"):
            assert (page.parent / target.partition("#")[0]).is_file(), target


def test_the_readme_is_short_and_names_both_commands():
    assert len(text(README).encode()) <= 16_000
    assert "make demo" in text(README)
    assert "make test" in text(README)


def test_the_readme_links_all_that_one_reads():
    linked = set(re.findall(r"\]\((docs/[\w/]+\.md)\)", text(README)))
    folders = [programs.DOCS / folder for folder in ("guide", "tutorials", "coming_from")]
    meant = {name(page) for page in PAGES if page.parent in folders and page.stem != "index"}
    assert meant <= linked


def test_the_home_page_has_the_readmes_program():
    readme, home = (programs.blocks(text(page)) for page in (README, programs.DOCS / "index.md"))
    first, *rest = [(b.code, b.shown) for b in home]
    assert [(b.code, b.shown) for b in readme] == rest
    assert first[0].count("\n") <= 12  # a picture that is seen at once


def documented(module):
    """The names that the reference documents of a module."""
    found = set()
    for part in re.split(r"^\.\. currentmodule:: ", _API, flags=re.MULTILINE)[1:]:
        head, _, rest = part.partition("\n")
        if head == module:
            rest = rest.partition("```")[0]
            listed = set(re.findall(r"^   (\w+)$", rest, flags=re.MULTILINE))
            if f".. automodule:: {head}\n" in _API:  # whose docstring has a table
                told = importlib.import_module(head).__doc__
                listed |= set(re.findall(r"^`(\w+)` ", told, flags=re.MULTILINE))
            entry = r"^\.\. auto(?:class|function|exception):: (\w+)$"
            entries = re.findall(entry, rest, flags=re.MULTILINE)
            assert listed == set(entries), head
            found |= listed
    return found


@pytest.mark.parametrize(
    "module", ["pgm", "pgm.results", "pgm.plot", "pgm.consistency", "pgm.maps"]
)
def test_the_reference_has_every_public_name(module):
    whole = importlib.import_module(module)
    names = {each for each in whole.__all__ if not inspect.ismodule(getattr(whole, each))}
    assert documented(module) == names


@pytest.mark.parametrize(
    ("module", "rest"), [("pgm.linearisers", {"TAYLOR"}), ("pgm.recordings", set())]
)
def test_the_reference_has_every_name_of_what_is_public_in_part(module, rest):
    both = documented(module) | documented("pgm")
    assert set(importlib.import_module(module).__all__) - both == rest


def test_the_gallery_has_every_picture():
    gallery = text(programs.DOCS / "gallery.md")
    headings = set(re.findall(r"^### (\w+)$", gallery, flags=re.MULTILINE))
    assert headings == set(pgm.plot.__all__)
    for each in pgm.plot.__all__:
        assert f"pgm.plot.{each}(" in gallery


def test_the_experiments_are_listed():
    page = text(programs.DOCS / "experiments.md")
    assert {each for each in EXPERIMENTS if f"`{each}`" not in page} == set()


@pytest.mark.parametrize("picture", sorted((programs.DOCS / "images").glob("*")), ids=name)
def test_pictures_are_small_and_shown(picture):
    assert picture.stat().st_size <= 160_000
    assert any(picture.name in text(page) for page in PAGES)


def test_the_log_shown_is_the_log():
    page = text(programs.DOCS / "tutorials" / "own_log.md")
    (head,) = re.findall(r"^```csv\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    assert text(programs.DOCS / "log.csv").startswith(head)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_code_is_no_wider_than_a_page(page):
    for block in programs.blocks(text(page)):
        for line in block.code.splitlines():
            assert len(line) <= 98, line
