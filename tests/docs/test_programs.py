"""Every program of README and site runs as written, prints what is shown, draws legibly."""

import ast
import re

import matplotlib
import pytest
from building import programs

matplotlib.use("Agg")
legible = pytest.importorskip("tests.plot.legible")

PAGES = [page.relative_to(programs.ROOT).as_posix() for page in programs.pages()]


def test_agreement_is_of_words_and_of_numbers_but_for_rounding():
    assert programs.agree("mean [1.0 2.0]\n", "mean [1.0001  2.]")
    assert not programs.agree("mean 1.0", "mean 1.1")
    assert not programs.agree("mean 1.0", "std 1.0")
    assert not programs.agree("[1.0 2.0]", "[1.0]")


def test_a_block_and_its_output_are_found():
    text = "a\n\n```python\nx = 1\nprint(x)\n```\n\n```text\n1\n```\n\n```python\ny = 2\n```\n"
    first, second = programs.blocks(text)
    assert (first.line, first.code, first.shown) == (4, "x = 1\nprint(x)\n", "1\n")
    assert (second.line, second.shown) == (13, None)


def test_a_block_names_the_packages_that_it_lacks():
    (block,) = programs.blocks("```python\nimport numpy, no_such_package.part\n```\n")
    assert block.missing == ["no_such_package"]


@pytest.mark.parametrize("name", PAGES)
def test_a_block_that_a_page_does_not_run_is_run_by_a_test(name):
    for block in programs.blocks((programs.ROOT / name).read_text(encoding="utf-8")):
        if block.elsewhere is not None:
            test = (programs.ROOT / block.elsewhere).read_text(encoding="utf-8")
            assert name.rpartition("/")[2] in test
            assert "exec(compile(" in test


@pytest.mark.filterwarnings("ignore::FutureWarning")  # of libraries that a page compares with
@pytest.mark.parametrize("name", PAGES)
def test_the_programs_of_a_page_run_and_print_what_it_shows(name, tmp_path, monkeypatch):
    import matplotlib.pyplot as plt

    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(programs.DOCS)
    skipped = []
    for ran in programs.run(programs.ROOT / name):
        where = f"{name}:{ran.block.line}"
        for number in plt.get_fignums():
            found = legible.faults(plt.figure(number), whole=False)
            assert not found, f"{where} draws: {found}"
        plt.close("all")
        if ran.skipped:
            skipped.append(f"{where} needs {', '.join(ran.skipped)}")
        elif ran.block.shown is not None:
            assert programs.agree(ran.block.shown, ran.printed), f"{where} prints\n{ran.printed}"
    if skipped:
        pytest.skip("; ".join(skipped) + "; all other blocks ran")


@pytest.mark.parametrize("name", PAGES)
def test_no_block_echoes_axes_in_a_notebook(name):
    text = (programs.ROOT / name).read_text(encoding="utf-8")
    for block in programs.blocks(text):
        last = ast.parse(block.code).body[-1]
        if isinstance(last, ast.Expr) and "pgm.plot." in ast.unparse(last):
            ended = re.search(r";\s*(#.*)?$", block.code.rstrip().splitlines()[-1])
            assert ended or "print(" in ast.unparse(last), f"{name}:{block.line} echoes its value"
