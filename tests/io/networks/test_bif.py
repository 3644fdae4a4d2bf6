"""BIF as others write it: every form, and every error with its line."""

import io

import numpy as np
import pytest
from files import same
from numpy.testing import assert_array_equal

import pgm

A = "variable a { type discrete [ 2 ] { x, y }; }\n"
B = "variable b { type discrete [ 3 ] { u, v, w }; }\n"
PA = "probability ( a ) { table 0.25, 0.75; }\n"
ROWS = "(x) .1, .2, .7; (y) .3, .3, .4;"
PB = f"probability ( b | a ) {{ {ROWS} }}\n"
due = pgm.BayesianNetwork(
    [
        pgm.TableCPD(a := pgm.Discrete("a", ("x", "y")), table=[0.25, 0.75]),
        pgm.TableCPD(
            pgm.Discrete("b", ("u", "v", "w")), a, table=[[0.1, 0.2, 0.7], [0.3, 0.3, 0.4]]
        ),
    ]
)


def read(text, **keywords):
    return pgm.read_bif(io.StringIO(text), **keywords)


@pytest.mark.parametrize(
    "text",
    [
        A + B + PA + PB,
        PB + PA + A + B,  # in any order; variables come in that of their declarations
        "network n {}" + A + B + PA + PB,
        'network "n; {" { property "a } b; c"; property d = e; }' + A + B + PA + PB,
        'network a longer name { property "say \\"no;\\""; }' + A + B + PA + PB,
        "// }\n" + A + "/* probability ( a ) { */" + B + PA + PB + "// no line end",
        (A + B + "// old line ends\n" + PA + PB).replace("\n", "\r"),
        (A + B + PA + PB).replace(" ", "\n\t "),
        (A + B + PA + PB).replace(" ", "/**/"),
        (A + B + PA + PB).replace("{ ", "{ // } { \n "),
        (A + B + PA + PB).replace(", ", " "),
        (A + B + PA + PB).replace("[ 2 ]", "[2]").replace("x, y", '"x""y"'),
        (A + B + PA + PB).replace("( b | a )", "( b a )"),
        (A + B + PA + PB).replace("( b | a )", "( b, a )"),
        (A + B + PA + PB).replace("( b | a )", '("b"|"a")'),
        (A + B + PA + PB).replace("a {", 'a { property p = "}";', 1),
        A.replace("; }", "; property position = (1, 2) ; }") + B + PA + PB,
        A + B + PA + PB.replace("{", '{ property "}";'),
        A + B + PA + PB.replace(ROWS, "(y) .3, .3, .4; (x) .1, .2, .7;"),
        A + B + PA + PB.replace(ROWS, "default .3, .3, .4; (x) .1, .2, .7;"),
        A + B + PA + PB.replace(ROWS, "(x) .1, .2, .7; default .3, .3, .4;"),
        A + B + PA + PB.replace(ROWS, "(y) 3e-1, +.3, 4.E-1; (x) 0.1, /* , */ .2 // 8\n .7;"),
        A + B + PA + PB.replace(ROWS, "table .1, .3,  .2, .3,  .7, .4;"),  # the child moves slowest
        A + B + PA.replace("table", "()") + PB,
        A + B + PA.replace("table", "default") + PB,
    ],
)
def test_every_form_is_the_same_network(text):
    same(due, read(text))


def test_rows_and_tables_of_several_parents():
    variables = A + B + "variable c { type discrete [ 2 ] { p, q }; }\n"
    roots = PA + "probability ( b ) { table .2 .3 .5; }\n"
    rows = "(w, y) .9, .1; (u, x) .4, .6; (v, x) .3, .7; (v, y) .2, .8; (u, y) .1, .9; (w, x) 1, 0;"
    network = read(variables + roots + f"probability ( c | b, a ) {{ {rows} }}")
    table = [[[0.4, 0.6], [0.1, 0.9]], [[0.3, 0.7], [0.2, 0.8]], [[1.0, 0.0], [0.9, 0.1]]]
    cpd = network.cpds[-1]
    assert [v.name for v in cpd.given] == ["b", "a"]
    assert_array_equal(cpd.table, table)
    flat = " ".join(map(repr, np.moveaxis(table, -1, 0).ravel().tolist()))
    same(network, read(variables + roots + f"probability ( c | b, a ) {{ table {flat}; }}"))


def test_words_without_quotes_are_one_name_where_that_fits():
    text = (
        "variable the weather { type discrete [ 2 ] { very wet, dry }; }"
        "variable mood { type discrete [ 2 ] { good bad }; }"
        "probability ( the weather ) { table .5 .5; }"
        "probability ( mood | the weather ) { (very wet) 0.2 0.8; (dry) 0.9 0.1; }"
    )
    weather, mood = read(text).variables
    assert (weather.name, weather.states) == ("the weather", ("very wet", "dry"))
    assert mood.states == ("good", "bad")


@pytest.mark.parametrize("name", ["<5", ">=7.5", "Asy/Patch", "12+", "Transp.", "1", "-", "5%"])
def test_words_of_the_public_repositories(name):
    assert read(A.replace("x", name) + PA).variables[0].states == (name, "y")


@pytest.mark.parametrize(
    ("quoted", "name"),
    [
        ('"a, b"', "a, b"),
        (r'"\"\\\""', '"\\"'),
        (r'"\u00e9\n"', "é\n"),
        ('"a\nb"', "a\nb"),
        ('"// /* "', "// /* "),
        ('""', ""),
    ],
)
def test_quoted_names(quoted, name):
    assert read(A.replace("x", quoted) + PA).variables[0].states == (name, "y")


def test_numbers_are_the_nearest_doubles():
    digits = ("0.1000000000000000055511151231257827021181583404541015625", "0.90000000000000002")
    assert_array_equal(
        read(A + PA.replace("0.25, 0.75", ", ".join(digits))).cpds[0].table, [0.1, 0.9]
    )


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", None, "declares no variable"),
        ("\nhello", 2, "expected network, variable or probability, found 'hello'; notes go"),
        (A + "}", 2, "found '}'"),
        ("network a {}\nnetwork b {}", 2, "a second network"),
        ("network a { b }", 1, "expected '}' at the end of the network block"),
        ("network a", 1, "expected '{' after the network's name, found the end of the file"),
        (A + "\n/* never", 3, r"comment that starts here is never closed; add \*/"),
        (A + 'variable "a', 2, 'quote that starts here is never closed; add "'),
        ('variable "\\q" {', 1, r"has an escape that is none; a backslash is written \\\\"),
        ("variable a { property b }", 1, "the property has no ';'"),
        ("variable a {}", 1, "'a' has no type"),
        ("variable , { type discrete [1] { x }; }", 1, "a variable has one name, not 0"),
        ("variable a, b { type discrete [1] { x }; }", 1, "a variable has one name, not 2"),
        ('variable "" { type discrete [1] { x }; }', 1, "an empty name"),
        ("variable a { type discrete [1] { x }; type discrete", 1, "end of the variable 'a'"),
        ("variable a { type continuous; }", 1, "of type 'continuous'; only discrete"),
        ("variable a { type discrete { x }; }", 1, r"expected '\[' before the number"),
        ("variable a { type discrete [ n ] { x }; }", 1, "expected the number of states of 'a'"),
        ("variable a { type discrete [ 9999999999 ] { x }; }", 1, "expected the number of states"),
        ("variable a { type discrete [ 0 ] { }; }", 1, "'a' has no states"),
        ("variable a { type discrete [ 3 ] { x, y }; }", 1, "3 states of 'a' .* and 2 named"),
        ("variable a { type discrete [ 2 ] { x, y } }", 1, "expected ';' after the states"),
        (
            "variable a { type discrete [ 2 ] { x, (y) }; }",
            1,
            r"found '\('; quote a name that holds it",
        ),
        ("variable a { type discrete [ 2 ] {\n x,\n x }; }", 1, "two states of 'a' are called 'x'"),
        (A + A + PA, 2, "'a' is declared a second time"),
        (A, 1, "no probabilities are given for 'a'; add them"),
        (A + PA + "\n" + PA, 4, "'a' are given a second time"),
        (A + PA + PB, 3, "the variable 'b' is not declared"),
        (A + B + PA + PB.replace("| a", "| c"), 4, "the variable 'c' is not declared"),
        (A + B + PA + PB.replace("| a", "| b"), 4, "'b' is given as its own parent"),
        (A + B + PA + PB.replace("| a", "| a, a"), 4, "a parent of 'b' is named twice"),
        (A + B + PA + PB.replace("b | a", "b, a | a"), 4, "probabilities of 2 variables"),
        (A + PA.replace("( a )", "()"), 2, "probabilities of no variable"),
        (A + "probability { a", 2, "the block that starts here has no '{', or no '}'"),
        (A + "probability a { }", 2, r"expected '\(' after probability, found 'a'"),
        (A + PA.replace(";", ""), 2, "expected ';' after the numbers, found '}'"),
        (A + PA.replace("0.25", "0.2.5"), 2, "expected ';' after the numbers, found '0.2.5'"),
        (A + PA.replace("0.25", "nan"), 2, "expected ';' after the numbers, found 'nan'"),
        (A + PA.replace("0.25", "1e999"), 2, "inf is no probability, of 'a'"),
        (A + PA.replace("0.25, 0.75", "-.25, 1.25"), 2, "-0.25 is no probability, of 'a'; correct"),
        (A + PA.replace("0.75", "1e308, 1e308"), 2, "3 probabilities of 'a' where 2"),
        (A + PA.replace("0.25, 0.75", "1e308, 1e308"), 2, "1e[+]308 is no probability"),
        (A + PA.replace("0.75", "0.7, 0.05"), 2, "3 probabilities of 'a' where 2 are due"),
        (A + PA.replace("table", "mystery"), 2, "expected '}' at the end of the probabilities"),
        (A + PA.replace("}", "table 1, 0; }"), 2, "expected '}' at the end"),
        (A + PA.replace("}", "default 1, 0; }"), 2, "a table and rows besides"),
        (A + B + PA + PB.replace("(y)", "\n(z)"), 5, "the parent 'a' of 'b' has no state 'z'"),
        (A + B + PA + PB.replace("(y)", "\n(x)"), 5, "row of 'b' given 'a'='x' is given twice"),
        (A + B + PA + PB.replace("(y)", "\n(x, y)"), 5, "names 2 states of its 1 parents"),
        (A + B + PA + PB.replace("(y)", "\n(y) .3, "), 5, "4 probabilities of 'b' where 3"),
        (A + B + PA + PB.replace("}", "(x) 1 0 0; }"), 4, "given 'a'='x' is given twice"),
        (
            A + B + PA + PB.replace("(x) .1, .2, .7;", ""),
            4,
            "1 of the 2 rows .* first given 'a'='x'",
        ),
        (
            A + B + PA + PB.replace("(y) .3, .3, .4;", ""),
            4,
            "1 of the 2 rows .* first given 'a'='y'",
        ),
        (
            A + B + PA + PB.replace("(y)", "\n\n(y) .1 .1 .1; default"),
            6,
            "given 'a'='y' sum to 0.3, ",
        ),
        (A + B + PA + PB.replace("(y) .3", "\n default .1"), 5, "given 'a'='y' sum to 0.8, "),
        (A + B + "probability ( a | b ) { default .5 .5; }\n" + PB, 1, "the CPDs form a cycle"),
    ],
)
def test_errors_name_the_line(text, line, message):
    with pytest.raises(pgm.FileError, match=message) as error:
        read(text)
    assert error.value.line == line
    where = "the file" if line is None else f"the file, line {line}"
    assert str(error.value).startswith(f"{where}: ")


def test_errors_name_the_file(tmp_path):
    path = tmp_path / "odd.bif"
    path.write_text(A)
    with pytest.raises(pgm.FileError, match=r"odd\.bif, line 1: no probabilities") as error:
        pgm.read_bif(path)
    assert error.value.path == str(path)
    with path.open() as file, pytest.raises(pgm.FileError, match=r"odd\.bif, line 1") as error:
        pgm.read_bif(file)
    assert error.value.path == str(path)
    assert isinstance(error.value, ValueError)


def test_messages_do_not_grow_with_the_file():
    name = "n" * 10_000
    with pytest.raises(pgm.FileError) as error:
        read(f"variable {name} {{ type discrete [2] {{ {name}, {name} }}; }}")
    assert len(str(error.value)) < 300


@pytest.mark.parametrize(
    ("numbers", "due"),
    [
        ("0.3333, 0.6666", [1 / 3, 2 / 3]),
        ("0.3300, 0.6600", [1 / 3, 2 / 3]),
        ("0.3000000001, 0.6999999999", [0.3000000001, 0.6999999999]),
        ("0.30000003, 0.7", [0.30000003 / 1.00000003, 0.7 / 1.00000003]),
    ],
)
def test_columns_are_rescaled_when_asked(numbers, due):
    table = read(A + PA.replace("0.25, 0.75", numbers), normalise=True).cpds[0].table
    np.testing.assert_allclose(table, due, rtol=1e-15)
    assert abs(table.sum() - 1.0) < 3e-16


def test_columns_that_do_sum_to_one_stay_as_they_are():
    third = "0.3333333333333333, 0.3333333333333333, 0.3333333333333333"  # their sum is 1 - eps / 2
    rows = f"(x) {third}; (y) 0.1, 0.2, 0.7000001;"
    text = A + B + PA + PB.replace(ROWS, rows)
    plain, rescaled = read(text).cpds[1].table, read(text, normalise=True).cpds[1].table
    assert_array_equal(plain, [[0.3333333333333333] * 3, [0.1, 0.2, 0.7000001]])
    assert_array_equal(plain[0], rescaled[0])
    assert_array_equal(plain[1] / plain[1].sum(), rescaled[1])


def test_a_column_that_is_a_little_off_says_what_helps():
    text = A + PA.replace("0.75", "0.7501")
    message = r"line 2: the probabilities of 'a' sum to 1\.0001, not to one; .* normalise=True"
    with pytest.raises(pgm.FileError, match=message):
        read(text)
    read(text, normalise=True)


def test_a_column_that_is_far_off_is_refused_in_any_case():
    text = A + B + PA + PB.replace(".7;", ".5;\n").replace(".4;", ".39;")
    with pytest.raises(
        pgm.FileError, match=r"line 4: .* given 'a'='x' sum to 0\.8, .* two decimals"
    ):
        read(text, normalise=True)


def wide(parents, entries):
    """A child of many parents, whose table is a default or one row."""
    names = [f"v{k}" for k in range(parents)]
    roots = "".join(A.replace(" a ", f" {n} ") + PA.replace(" a ", f" {n} ") for n in names)
    return f"{roots}{A}probability ( a | {', '.join(names)} ) {{ {entries} }}"


@pytest.mark.parametrize("parents", [23, 40, 63])
@pytest.mark.parametrize("entries", ["default .5 .5;", "table .5 .5;", "(x) .5 .5;"])
def test_a_short_file_does_not_ask_for_a_large_table(parents, entries):
    with pytest.raises(pgm.FileError, match=r"the table of 'a' has [\d,]+ entries, which is more"):
        read(wide(parents, entries))


def test_a_table_has_so_many_axes_at_most():
    with pytest.raises(pgm.FileError, match="'a' has 64 parents; a table has room for 63"):
        read(wide(64, "default .5 .5;"))
    one = wide(63, "default .5 .5;").replace("[ 2 ] { x, y }", "[ 1 ] { x }")
    one = one.replace("0.25, 0.75", "1").replace("default .5 .5", "default 1")
    assert read(one).cpds[-1].table.shape == (1,) * 64


def test_the_limit_is_the_readers_to_set():
    text = wide(4, "default .5 .5;")
    with pytest.raises(pgm.FileError, match=r"holds more than 100 bytes; .*limit="):
        read(text, limit=100)
    assert read(text, limit=len(text)).cpds[-1].table.size == 32
    wider = wide(10, "default .5 .5;")
    with pytest.raises(pgm.FileError, match=r"has 2,048 entries, which is more .*limit="):
        read(wider, limit=len(wider))
    assert read(wider, limit=4 * 3000).cpds[-1].table.size == 2048
