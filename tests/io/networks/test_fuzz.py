"""Damaged files give a network or an error of ours, in little time and memory."""

import io
import random
import time
import tracemalloc

import pytest
from files import written

import pgm
from models.discrete import asia, sprinkler

odd = pgm.Discrete(' "x, é', ("", "a b", "a,b"))
child = pgm.Discrete("table", ("property", "a  b"))
ODD = pgm.BayesianNetwork(
    [pgm.TableCPD(odd, table=[0.2, 0.3, 0.5]), pgm.TableCPD(child, odd, table=[[0.5, 0.5]] * 3)]
)
NETWORKS = (sprinkler(), asia(), ODD)
BIF = [
    *(written(pgm.write_bif, network) for network in NETWORKS),
    b"""network "n" { property "a;b"; }  // a comment
variable a { type discrete [ 2 ] { "x" "y" }; property p = 3; }
variable b { type discrete[3] { u v w }; }
probability ( b a ) { /* another */ default 0.2 0.3 0.5; (y) .1, .2, .7; }
probability (a) { table 1e-1, 0.9; }
""",
]
XMLBIF = [
    *(written(pgm.write_xmlbif, network) for network in NETWORKS),
    b"""<?xml version="1.0" encoding="UTF-8"?>
<!DOCTYPE BIF [ <!ELEMENT BIF (NETWORK)*> <!ATTLIST BIF VERSION CDATA #REQUIRED> ]>
<BIF VERSION="0.3"><NETWORK><NAME>n</NAME><PROPERTY>a</PROPERTY>
<VARIABLE TYPE="nature"><NAME>a</NAME><OUTCOME>x</OUTCOME><OUTCOME>y</OUTCOME></VARIABLE>
<DEFINITION><FOR>a</FOR><TABLE>.5 <!-- c --> .5</TABLE></DEFINITION></NETWORK></BIF>
""",
]
UAI = [
    b"BAYES\n3\n2 2 3\n3\n1 0\n2 0 1\n2 1 2\n\n2\n .4 .6\n4\n .2 .8 .3 .7\n6\n .2 .3 .5 .2 .4 .4\n",
    b"BAYES\n2\n2 1\n2\n1 0\n2 0 1\n2\n1 0\n2\n1 1\n",
]
EVIDENCE = [b"2 0 1 2 2\n", b"1\n3 0 0 1 1 2 0 # one sample\n"]
READ = pgm.read_uai(io.BytesIO(UAI[0]))


def read_evidence(source, normalise):
    """Not normalised: it has no tables."""
    return pgm.read_uai_evidence(source, READ)


KINDS = [
    *((pgm.read_bif, BIF), (pgm.read_xmlbif, XMLBIF), (pgm.read_uai, UAI)),
    (read_evidence, EVIDENCE),
]
PIECES = [
    *(
        b"{",
        b"}",
        b'"',
        b"(",
        b")",
        b";",
        b"|",
        b",",
        b"\\",
        b"\\u12",
        b"/*",
        b"*/",
        b"//",
        b"[ 9 ]",
    ),
    *(
        b"<",
        b">",
        b"&a;",
        b"&#0;",
        b'<!ENTITY a "b">',
        b'<!DOCTYPE BIF SYSTEM "file:///x">',
        b"]]>",
    ),
    *(b'encoding="utf-16"', b'encoding="x"', b'encoding="gb2312"', b"<PROPERTY>", b"<TABLE>"),
    *(
        b"1e999",
        b"nan",
        b"-1",
        b"99999999999999999999",
        b"2147483647",
        b"1_0",
        b".",
        b"0",
        b"\xd9\xa1",
    ),
    *(b"property", b"default", b"table", b"variable", b"probability", b"BAYES", b"MARKOV"),
    *(b"\x00", b"\xff", b"\x1f\x8b\x08", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\r", b"\x0c"),
]


def mutated(draw, data, others):
    """A file with one to eight changes."""
    data = bytearray(data)
    for _ in range(draw.choice([1, 1, 1, 2, 3, 8])):
        i = draw.randrange(len(data) + 1)
        j = min(len(data), i + draw.choice([1, 2, 5, 30, 200]))
        match draw.randrange(8):
            case 0:
                del data[i:j]
            case 1:
                data[i:i] = draw.choice(PIECES)
            case 2:
                data[i:j] *= 2
            case 3:
                data[i : i + 1] = bytes([draw.randrange(256)])
            case 4:
                other = draw.choice(others)
                start = draw.randrange(len(other))
                data[i:i] = other[start : start + draw.choice([3, 20, 100])]
            case 5:
                del data[i:]
            case 6:
                data[i:i] = draw.choice(PIECES) * draw.choice([2, 50, 1000])
            case 7:  # a digit, a letter: what leaves most of the file as it was
                places = [k for k, byte in enumerate(data) if chr(byte).isalnum()]
                if places:
                    data[draw.choice(places)] = draw.choice(b"0123456789abxy")
    return bytes(data)


def attempt(draw):
    """Read a mutation; whether it is a network, or evidence."""
    read, files = draw.choice(KINDS)
    data = mutated(draw, draw.choice(files), files)
    try:
        found = read(io.BytesIO(data), normalise=draw.random() < 0.5)
        assert isinstance(found, dict if read is read_evidence else pgm.BayesianNetwork)
    except pgm.PgmError:
        return False
    except Exception as error:
        error.add_note(f"{read.__name__} of {data!r}")
        raise
    return True


def test_two_hundred_mutations():
    draw = random.Random(1)
    assert 5 < sum(attempt(draw) for _ in range(200)) < 100


@pytest.mark.slow
def test_ten_thousand_mutations():
    draw = random.Random(0)
    tracemalloc.start()
    try:
        for _ in range(10_000):
            tracemalloc.reset_peak()
            start = time.perf_counter()
            attempt(draw)
            assert time.perf_counter() - start < 2.0
            assert tracemalloc.get_traced_memory()[1] < 2**30
    finally:
        tracemalloc.stop()
