"""XMLBIF as others write it: every form, and every error with its line."""

import io

import pytest
from files import same
from numpy.testing import assert_array_equal

import pgm

A = "<VARIABLE><NAME>a</NAME><OUTCOME>x</OUTCOME><OUTCOME>y</OUTCOME></VARIABLE>\n"
B = "<VARIABLE><NAME>b</NAME><OUTCOME>u</OUTCOME><OUTCOME>v</OUTCOME></VARIABLE>\n"
PA = "<DEFINITION><FOR>a</FOR><TABLE>.25 .75</TABLE></DEFINITION>\n"
PB = "<DEFINITION><FOR>b</FOR><GIVEN>a</GIVEN><TABLE>.1 .9 .2 .8</TABLE></DEFINITION>\n"
BODY = A + B + PA + PB
DTD = """<!DOCTYPE BIF [
<!ELEMENT BIF ( NETWORK )*> <!ATTLIST BIF VERSION CDATA #REQUIRED>
<!ELEMENT VARIABLE ( NAME, ( OUTCOME | PROPERTY )* ) >
<!ATTLIST VARIABLE TYPE (nature|decision|utility) "nature">
]>"""
a = pgm.Discrete("a", ("x", "y"))
b = pgm.Discrete("b", ("u", "v"))
due = pgm.BayesianNetwork(
    [pgm.TableCPD(a, table=[0.25, 0.75]), pgm.TableCPD(b, a, table=[[0.1, 0.9], [0.2, 0.8]])]
)


def document(body, before='<?xml version="1.0"?>'):
    return f'{before}<BIF VERSION="0.3"><NETWORK><NAME>n</NAME>\n{body}</NETWORK></BIF>'


def read(text, **keywords):
    return pgm.read_xmlbif(io.StringIO(text), **keywords)


@pytest.mark.parametrize(
    "text",
    [
        document(BODY),
        document(BODY, ""),
        document(BODY, DTD),
        document(PB + PA + A + B),
        document(f"<PROPERTY>a <b>c</b> {{</PROPERTY>{BODY}"),
        document(BODY.replace("</NAME>", "</NAME><PROPERTY/>")),
        document(BODY.replace("<VARIABLE>", '<VARIABLE TYPE="nature">')),
        document(BODY.replace("><", ">\n\n<").replace("<", " <").replace("a<", " a <")),
        document(BODY.replace(" ", "\n<!-- 0.3 --> ")),
        document(BODY.replace("x", "<![CDATA[x]]>").replace("y", "&#121;")),
        document(BODY.replace(".9", "9E-1")),
    ],
)
def test_every_form_is_the_same_network(text):
    same(due, read(text))
    same(due, pgm.read_xmlbif(io.BytesIO(text.encode())))


def test_parents_come_in_the_order_they_are_given():
    c = A.replace(">a<", ">c<").replace("</OUTCOME></V", "</OUTCOME><OUTCOME>z</OUTCOME></V")
    root = "<DEFINITION><FOR>c</FOR><TABLE>.2 .3 .5</TABLE></DEFINITION>"
    table = ".1 .9  .2 .8  .3 .7  .4 .6  .5 .5  .6 .4"
    given = "<GIVEN>c</GIVEN><GIVEN>a</GIVEN>"
    child = f"<DEFINITION><FOR>b</FOR>{given}<TABLE>{table}</TABLE></DEFINITION>"
    cpd = read(document(A + B + c + PA + root + child)).cpds[-1]
    assert [v.name for v in cpd.given] == ["c", "a"]
    assert_array_equal(cpd.table[..., 0], [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]])


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1", "utf-16"])
def test_encodings_are_what_the_file_says(encoding):
    text = document(A.replace("x", "é") + PA, f'<?xml version="1.0" encoding="{encoding}"?>')
    assert pgm.read_xmlbif(io.BytesIO(text.encode(encoding))).variables[0].states == ("é", "y")
    # Opened as text it has been decoded, whatever it says.
    assert read(text).variables[0].states == ("é", "y")


def test_white_space_is_dropped_unless_it_is_preserved():
    plain = A.replace(">x<", "> x\n<")
    kept = plain.replace("<OUTCOME>", '<OUTCOME xml:space="preserve">', 1)
    assert read(document(plain + PA)).variables[0].states == ("x", "y")
    assert read(document(kept + PA)).variables[0].states == (" x\n", "y")


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", 1, "no well-formed XML: no element found"),
        ("<BIF>\n<NETWORK></BIF>", 2, "no well-formed XML: mismatched tag"),
        ("<NETWORK/>", 1, "'NETWORK' stands at the top, where XMLBIF 0.3 has BIF"),
        ("<BIF>\n<VARIABLE/></BIF>", 2, "'VARIABLE' stands in BIF, where XMLBIF 0.3 has NETWORK"),
        ("<BIF><NETWORK/>\n<NETWORK/></BIF>", 2, "a second network"),
        ("<BIF/>", None, "declares no variable"),
        (document("text" + BODY), 2, "the text 'text' stands between elements"),
        (document("<VALUE/>"), 2, "'VALUE' stands in NETWORK"),
        (document("<VARIABLE>\n<VALUE/></VARIABLE>"), 3, "'VALUE' stands in VARIABLE"),
        (document("<DEFINITION>\n<NAME/></DEFINITION>"), 3, "'NAME' stands in DEFINITION"),
        (document("<VARIABLE><NAME>\n<b/></NAME></VARIABLE>"), 3, "'b' stands in NAME"),
        (document('<VARIABLE TYPE="utility"/>'), 2, "of type 'utility'; only nature"),
        (document("<VARIABLE><OUTCOME>x</OUTCOME></VARIABLE>"), 2, "a variable has no NAME"),
        (document(A.replace("<OUT", "<NAME>c</NAME>\n<OUT", 1)), 2, "a variable has two names"),
        (document("<VARIABLE><NAME/></VARIABLE>"), 2, "an empty name"),
        (document("<VARIABLE><NAME>a</NAME></VARIABLE>"), 2, "'a' has no states"),
        (document(A.replace("y", "x")), 2, "two states of 'a' are called 'x'"),
        (document(A + A), 3, "'a' is declared a second time"),
        (document(A), 2, "no probabilities are given for 'a'"),
        (document(A + PA + PA), 4, "'a' are given a second time"),
        (document(A + PA + PB), 4, "'b' is not declared"),
        (document(A + "<DEFINITION><FOR>a</FOR></DEFINITION>"), 3, "needs FOR.* and TABLE"),
        (document(A + "<DEFINITION><TABLE>1</TABLE></DEFINITION>"), 3, "needs FOR"),
        (document(A + PA.replace("<TABLE", "<FOR>a</FOR><TABLE")), 3, "is for one variable"),
        (
            document(A + PA.replace("</D", "<TABLE>1</TABLE></D")),
            3,
            "one table, and this is the second",
        ),
        (document(A + PA.replace(" .75", "\n .7.5")), 4, "'.7.5' stands where a number is due"),
        (document(A + PA.replace(" .75", "")), 3, "1 probabilities of 'a' where 2 are due"),
        (document(BODY.replace(".2 ", "")), 5, "3 .* 'b' where 4 are due, 2 for each of 2 rows"),
        (document(A + PA.replace(".75", "-.75")), 3, "-0.75 is no probability, of 'a'"),
        (document(BODY.replace(".8", ".9")), 5, "'b' given 'a'='y' sum to 1.1, not to one"),
        (document(A + B + PB + PA.replace("<T", "<GIVEN>b</GIVEN><T")), 5, "2 .* where 4 are due"),
        (document("<PROPERTY>" * 100), 2, "nested more than 64 deep"),
        (document("&a;"), 2, "no well-formed XML: undefined entity"),
        (document("", '<!DOCTYPE BIF [<!ENTITY a "b">]>\n'), 1, "entities, which are refused"),
        (document("", '<!DOCTYPE BIF [\n<!ENTITY a SYSTEM "/etc/hosts">]>'), 2, "are refused"),
        (document("", '<!DOCTYPE BIF SYSTEM "absent.dtd">'), 1, "outside of the file"),
        (document("", '<!DOCTYPE BIF [\n<!ENTITY % a "b">]>'), 2, "are refused"),
    ],
)
def test_errors_name_the_line(text, line, message):
    with pytest.raises(pgm.FileError, match=message) as error:
        read(text)
    assert error.value.line == line


@pytest.mark.parametrize("encoding", ["absent", "gb2312", "rot13"])
def test_encodings_that_cannot_be_read(encoding):
    text = document(BODY, f'<?xml version="1.0" encoding="{encoding}"?>')
    with pytest.raises(pgm.FileError, match=r"line 1: "):
        pgm.read_xmlbif(io.BytesIO(text.encode()))


def test_a_laugh_is_not_repeated_a_billion_times():
    lines = [f'<!ENTITY l{k + 1} "{f"&l{k};" * 10}">' for k in range(9)]
    dtd = f'<!DOCTYPE BIF [<!ENTITY l0 "ha">{"".join(lines)}]>'
    with pytest.raises(pgm.FileError, match="entities, which are refused"):
        read(document("&l9;", dtd))


def test_columns_are_rescaled_when_asked():
    text = document(A + PA.replace(".75", ".7499"))
    with pytest.raises(pgm.FileError, match=r"line 3: .* sum to 0\.9999.* normalise=True"):
        read(text)
    table = read(text, normalise=True).cpds[0].table
    assert_array_equal(table, [0.25 / 0.9999, 0.7499 / 0.9999])


def test_the_limit_holds():
    with pytest.raises(pgm.FileError, match="holds more than 100 bytes"):
        read(document(BODY), limit=100)
