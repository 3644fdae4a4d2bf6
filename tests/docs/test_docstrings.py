"""Docstrings are read as they are meant: stars and bars of shapes and norms are no markup."""

import pytest
from building.docstrings import escaped, with_formulas


@pytest.mark.parametrize(
    ("line", "due"),
    [
        ("shapes (*runs, steps, n)", r"shapes (\*runs, steps, n)"),
        ("ln|P| of *one* run", r"ln\|P\| of *one* run"),
        ("``(*runs, n)`` and `a|b` stay", "``(*runs, n)`` and `a|b` stay"),
        ("two `Gaussian`s", r"two `Gaussian`\ s"),
        ("**style", "**style"),
    ],
)
def test_signs_that_mark_nothing_are_escaped(line, due):
    assert escaped([line]) == [due]


def test_formulas_and_examples_are_left_alone():
    lines = [".. math:: |x|", "", "    a * b", "", ">>> 2 * 3", "6", "", "|x| * |y|"]
    assert escaped(lines) == [*lines[:-1], r"\|x\| \* \|y\|"]


def test_an_indented_paragraph_keeps_its_lines():
    lines = [
        "One.",
        "",
        "    p(x) = 1",
        "    p(y) = 2",
        "",
        "Parameters",
        "----------",
        "x",
        "    X",
    ]
    due = [*lines[:2], ".. code-block:: none", "", *lines[2:]]
    assert with_formulas(lines) == due


def test_the_body_of_a_directive_is_no_formula():
    lines = [".. math::", "", "    a = b", "", "    c = d", "", "Text."]
    assert with_formulas(lines) == lines
