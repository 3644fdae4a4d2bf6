"""Networks for the tests of files, and what it means that two are the same."""

import io

import numpy as np
from hypothesis import strategies as st

import pgm

# Names that a format may mistake for something else.
NASTY = (
    *("", " ", "a b", "a  b", "a,b", "a|b", "(a)", "{", "}", ";", '"', "\\", "\\n", "'", "é", "猫"),
    *("//", "/*", "*/", "a/b", "probability", "table", "default", "property", "variable", "BAYES"),
    *("1", "0.5", "-1e5", "nan", "<5", ">=7.5", "&amp;", "]]>", "<!--", " padded ", "\u00a0", "😀"),
)
CONTROLS = ("\n", "\r\n", "\t", "\x00", "\x1b", "\x85", "\u2028", "\ud800", "\ufffe")


def same(a: pgm.BayesianNetwork, b: pgm.BayesianNetwork) -> None:
    """Require variables, states, parents and doubles to be equal, and in the same order."""
    assert a.variables == b.variables
    for p, q in zip(a.cpds, b.cpds, strict=True):
        assert (p.child, p.given) == (q.child, q.given)
        np.testing.assert_array_equal(p.table, q.table, strict=True)


def written(write, network) -> bytes:
    """The bytes of a network."""
    target = io.BytesIO()
    write(network, target)
    return target.getvalue()


@st.composite
def networks(draw, text):
    """Networks of tables with names drawn from `text`, and entries of all magnitudes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    names = draw(st.lists(text.filter(bool), min_size=1, max_size=5, unique=True))
    cpds: list[pgm.TableCPD] = []
    for name in names:
        states = draw(st.lists(text, min_size=1, max_size=4, unique=True))
        child = pgm.Discrete(name, states)
        count = rng.integers(min(len(cpds), 3) + 1)
        given = [cpds[k].child for k in rng.permutation(len(cpds))[:count]]
        shape = (*(v.size for v in given), child.size)
        table = rng.gamma(10.0 ** rng.uniform(-3, 1), size=shape) + 1e-300
        if rng.integers(2):
            table[..., rng.integers(child.size)] = 1e-300
        cpds.append(pgm.TableCPD(child, given, table=table / table.sum(-1, keepdims=True)))
    return pgm.BayesianNetwork(cpds)
