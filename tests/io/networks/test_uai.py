"""UAI files: the format's own example, every error with its line, evidence."""

import io

import pytest
from files import same
from numpy.testing import assert_array_equal

import pgm

TEXT = """BAYES
3
2 2 3
3
1 0
2 0 1
2 1 2

2
 0.25 0.75
4
 0.2 0.8
 0.4 0.6
6
 0.1 0.2 0.7
 0.3 0.3 0.4
"""
x, y, z = pgm.Discrete("0", 2), pgm.Discrete("1", 2), pgm.Discrete("2", 3)
due = pgm.BayesianNetwork(
    [
        pgm.TableCPD(x, table=[0.25, 0.75]),
        pgm.TableCPD(y, x, table=[[0.2, 0.8], [0.4, 0.6]]),
        pgm.TableCPD(z, y, table=[[0.1, 0.2, 0.7], [0.3, 0.3, 0.4]]),
    ]
)


def read(text, **keywords):
    return pgm.read_uai(io.StringIO(text), **keywords)


@pytest.mark.parametrize(
    "text",
    [TEXT, TEXT.replace("\n", " "), TEXT.replace("0.", "\n."), TEXT.replace("\n", " # 3 x\n")],
)
def test_the_formats_example(text):
    same(due, read(text))
    same(due, pgm.read_uai(io.BytesIO(text.encode())))


def test_tables_in_any_order_and_several_parents():
    network = read("BAYES 3  2 2 3  3  3 2 0 1  1 2  1 0  12 .1 .9 .2 .8 .3 .7 .4 .6 .5 .5 .6 .4 "
                   "3 .2 .3 .5  2 1 0")  # fmt: skip
    cpd = network.cpd(y)
    assert cpd.given == (z, x)
    assert_array_equal(cpd.table[..., 0], [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", 1, "expected BAYES or MARKOV at the start, found ''"),
        ("BAYES3 1", 1, "found 'BAYES3'"),
        (TEXT.replace("0.2 ", "abc "), 12, "'abc' stands where a number is due"),
        (TEXT.replace("0.2 ", "nan "), 12, "'nan' stands where a number is due"),
        (TEXT[:19], 5, "the file ends where the number of variables is due"),
        (TEXT.replace("3\n2 2", "3.5\n2 2"), 2, "3.5 stands where the number of variables is due"),
        (TEXT.replace("3\n2 2", "-3\n2 2"), 2, "-3 stands where"),
        (TEXT.replace("2 2 3", "2 0 3"), 3, "the variable 1 has no states"),
        (TEXT.replace("\n3\n1 0", "\n2\n1 0"), 4, "2 tables of 3 variables"),
        (TEXT.replace("1 0\n", "0\n"), 5, "a table of 0 variables"),
        (TEXT.replace("2 1 2", "2 1 3"), 7, "a table of the variable 3, .* 0 to 2"),
        (TEXT.replace("2 0 1", "2 1 0"), 2, "no table has the variable 1 as its child"),
        (TEXT.replace("2 1 2", "2 2 2"), 14, r"6 entries of the table over \[2, 2\] where 9"),
        (TEXT.replace("\n4\n", "\n3\n"), 11, r"3 entries of the table over \[0, 1\] where 4"),
        (TEXT.replace("0.4\n", ""), 16, "5 numbers are left of 6"),
        ("# BAYES\n", 1, "expected BAYES or MARKOV at the start, found ''"),
        (TEXT + "#\n# 2\n1", 19, "1 numbers follow the last table"),
        (TEXT.replace("0.25", "-.25"), 10, "-0.25 is no probability, of '0'"),
        (TEXT.replace("0.25", "1e999"), 10, "inf is no probability, of '0'"),
        (TEXT.replace(" 0.4 0.6", " 0.4 0.5"), 13, "'1' given '0'='1' sum to 0.9, not to one"),
        ("BAYES 1 1 1 2 0 0 1 1", 1, "'0' is given as its own parent"),
        ("BAYES 0 0", None, "declares no variable"),
        ("BAYES 2 2 3 2 1 0 1 0 2 1 0 2 1 0", 1, "no table has the variable 1"),
        ("BAYES 1\n2147483647 1 1 0 2147483647 1", 1, "more than the limit leaves room for"),
        ("BAYES 1 9 1 1 0 9 1", 1, "1 numbers are left of 9"),
        ("BAYES 2 2 2 2 2 1 0 2 0 1 4 1 0 1 0 4 1 0 1 0", 1, "the CPDs form a cycle"),
        ("BAYES 1 2 1 65" + " 0" * 65, 1, "a table of 65 variables"),
    ],
)
def test_errors_name_the_line(text, line, message):
    with pytest.raises(pgm.FileError, match=message) as error:
        read(text)
    assert error.value.line == line


def test_columns_are_rescaled_when_asked():
    text = TEXT.replace("0.25", "0.2499")
    with pytest.raises(pgm.FileError, match=r"line 10: .* normalise=True"):
        read(text)
    assert_array_equal(read(text, normalise=True).cpds[0].table, [0.2499 / 0.9999, 0.75 / 0.9999])


@pytest.mark.parametrize(
    ("text", "evidence"),
    [
        ("0", {}),
        ("1 2 1", {z: 1}),
        ("2\n2 2\n0 1\n", {z: 2, x: 1}),
        ("1\n1 2 1", {z: 1}),
        ("1\n2 2 1 0 0", {z: 1, x: 0}),
        ("1 0", {}),
        ("2 0 1 0 1", {x: 1}),
    ],
)
def test_evidence(text, evidence):
    assert pgm.read_uai_evidence(io.StringIO(text), due) == evidence


def test_evidence_is_what_infer_takes():
    evidence = pgm.read_uai_evidence(io.StringIO("1 1 0"), due)
    belief = pgm.infer(pgm.compile(due), evidence)[z]
    assert belief["0"] == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", 1, "the file ends where the number of variables observed is due"),
        ("1\n2", 2, "0 numbers follow where 4 are due"),
        ("2\n1 0 1\n1 0 0", 1, "6 numbers follow where 4 are due, .*; one sample is read"),
        ("1\n3 0", 2, "the network has no variable 3; is it that of read_uai"),
        ("1\n2 3", 2, "the variable 2 has the states 0 to 2, not 3"),
        ("1\n2 -1", 2, "-1 stands where a state is due"),
        ("2\n0 1\n0 0", 3, "the variable 0 is observed in two states"),
        ("1 x 1", 1, "'x' stands where a number is due"),
    ],
)
def test_errors_of_evidence_name_the_line(text, line, message):
    with pytest.raises(pgm.FileError, match=message) as error:
        pgm.read_uai_evidence(io.StringIO(text), due)
    assert error.value.line == line


def test_evidence_is_of_a_network():
    with pytest.raises(pgm.ModelError, match="takes a network of tables, not None"):
        pgm.read_uai_evidence(io.StringIO("0"), None)
