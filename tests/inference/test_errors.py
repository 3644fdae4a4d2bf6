"""Each error that the design names, of CPDs and networks: class, subject, and advice.

Those of functions are in test_function_errors, of graphs, schedules and posteriors in
test_posterior_errors, of evidence and of the online filter in test_evidence_errors.
"""

import numpy as np
import pytest
from refusing import CALLS, I2, I3, a, b, c, linear, model_row, network, pair, prior, w, walk
from robots import x

import pgm
from pgm import EvidenceError, GraphError, LinearisationError, ModelError, NumericalError


def gaussian(cov, mean=(0, 0)):
    return lambda: pgm.GaussianCPD(pair, mean, cov)


NOT_SYMMETRIC, INDEFINITE = [[1, 0.5], [0.4, 1]], [[1, 2], [2, 1]]

CPDS = [
    model_row("a mean of 3", gaussian(I2, [0, 0, 0]), "pair", "(3,)", "('p', 'q')", variable=pair),
    model_row("a mean of NaN", gaussian(I2, [0, np.nan]), "pair", "NaN", variable=pair),
    model_row("a mean of words", gaussian(I2, "here"), "pair", "numbers", variable=pair),
    model_row("a cov of 3", gaussian(I3), "pair", "(3, 3)", "(2, 2)", variable=pair),
    model_row("a negative variance", gaussian(-1.0), "pair", "negative", "-1", variable=pair),
    model_row("asymmetric", gaussian(NOT_SYMMETRIC), "pair", "not symmetric", variable=pair),
    model_row("indefinite", gaussian(INDEFINITE), "pair", "negative", "-1", variable=pair),
    model_row("infinite", gaussian([[1, np.inf], [np.inf, 1]]), "pair", "infinite", variable=pair),
    model_row(
        "infinite in part", gaussian([[np.inf, 1], [1, 1]]), "pair", "must be 0", variable=pair
    ),
    model_row(
        "an infinite noise",
        lambda: pgm.LinearGaussianCPD(pair, {a: [[1], [1]]}, cov=[[np.inf, 0], [0, 1]]),
        "pair",
        "infinite",
        variable=pair,
    ),
    model_row(
        "a negative variance", lambda: pgm.GaussianCPD(a, 0.0, -0.5), "a", "-0.5", variable=a
    ),
    model_row(
        "an asymmetric noise",
        lambda: pgm.LinearGaussianCPD(pair, {a: [[1], [1]]}, cov=NOT_SYMMETRIC),
        "pair",
        "not symmetric",
        variable=pair,
    ),
    model_row(
        "an indefinite noise of a function",
        lambda: pgm.NonlinearGaussianCPD(pair, a, np.sin, INDEFINITE),
        "pair",
        "negative",
        variable=pair,
    ),
    model_row(
        "a matrix of a wrong shape",
        lambda: pgm.LinearGaussianCPD(pair, {a: [[1.0, 2.0]]}, cov=I2),
        "pair",
        "a",
        "(1, 2)",
        "(2, 1)",
        variable=a,
    ),
    model_row(
        "a number for a tall matrix",
        lambda: pgm.LinearGaussianCPD(pair, {a: 1.0}, cov=I2),
        "()",
        "(2, 1)",
        variable=a,
    ),
    model_row(
        "a matrix of NaN",
        lambda: pgm.LinearGaussianCPD(a, {b: np.nan}, cov=1.0),
        "a",
        "matrix of b",
        "NaN",
    ),
    model_row(
        "an offset of 3",
        lambda: pgm.LinearGaussianCPD(pair, {pair.previous: 1.0}, cov=I2, offset=[1, 2, 3]),
        "pair",
        "offset",
        "(3,)",
        "(2,)",
        variable=pair,
    ),
    model_row(
        "parents without matrices",
        lambda: pgm.LinearGaussianCPD(a, (b,), cov=1.0),
        "a",
        "given={x: 1.0}",
        variable=a,
    ),
    model_row(
        "a child before its time",
        lambda: walk(a.previous),
        "a[t-1]",
        "declare it",
        variable=a.previous,
    ),
    model_row(
        "its own parent",
        lambda: pgm.LinearGaussianCPD(a, {a: 1.0}, cov=1.0),
        "a",
        "a.previous",
        variable=a,
    ),
    model_row(
        "no function", lambda: pgm.NonlinearGaussianCPD(a, b, 3.0, 1.0), "a", "function", "callable"
    ),
    model_row(
        "a Jacobian by a stranger",
        lambda: pgm.NonlinearGaussianCPD(a, b, np.sin, 1.0, jacobian={c: np.cos}),
        "a",
        "c",
        "parents",
        variable=c,
    ),
    model_row(
        "a lineariser that cannot be called",
        lambda: pgm.NonlinearGaussianCPD(a, b, np.sin, 1.0, lineariser="Taylor"),
        "a",
        "Taylor",
        "called",
    ),
    model_row("noise of no function", lambda: pgm.noise(I2, given=a), "function"),
    model_row("angles that are no components", lambda: pgm.Variable("v", ("p",), ("q",)), "q", "p"),
    model_row("a component twice", lambda: pgm.Variable("v", ("p", "p")), "v", "repeat"),
    model_row("a step before the first", lambda: x.at(0).previous, "x", "-1"),
]

CYCLE = [prior(a), prior(b)], [linear(a, a.previous, b), linear(b, b.previous, a)]
TWICE = [walk(a), walk(a)]
OTHER_A = pgm.Variable("a", components=("p", "q"))
SEES_PREVIOUS = linear(w, a.previous)
LAG_2 = linear(a, a.previous, b.previous.previous)
AT_3 = linear(a, a.at(3))
OF_READING = linear(a, a.previous, w)
HIDDEN_NOISE = pgm.LinearGaussianCPD(
    w, {a: 1.0}, cov=pgm.noise(lambda v: v[..., None] ** 2, given=a)
)

NETWORKS = [
    model_row("a cycle", network(*CYCLE), "cycle", "a -> b", ".previous"),
    model_row(
        "a cycle in the prior",
        network([linear(a, b), linear(b, a)], [walk(a), walk(b)]),
        "cycle",
        ".previous",
    ),
    model_row(
        "a state without a transition",
        network([prior(a), prior(b)], [walk(a)]),
        "b",
        "no transition",
        "b[t-1]",
        "cov=0",
        variable=b,
    ),
    model_row(
        "a state without a prior",
        network([prior(a)], [walk(a), walk(b)]),
        "b",
        "no prior",
        variable=b,
    ),
    model_row(
        "two transitions of a state",
        network([prior(a)], TWICE),
        "a",
        "two CPDs",
        cpd=TWICE[1],
        variable=a,
    ),
    model_row(
        "two priors of a state",
        network([prior(a), prior(a)], [walk(a)]),
        "a",
        "two CPDs",
        variable=a,
    ),
    model_row(
        "a state that is also read",
        network([prior(a)], [walk(a)], [linear(a, b)]),
        "a",
        "two CPDs",
        variable=a,
    ),
    model_row(
        "two variables of one name",
        network([prior(a)], [walk(a)], [linear(w, OTHER_A)]),
        "'a'",
        "('p', 'q')",
        "rename",
        variable=OTHER_A,
    ),
    model_row(
        "one name, other angles",
        network([prior(a)], [walk(a)], [linear(w, pgm.Variable("a", angles=("a",)))]),
        "'a'",
        "angles",
        "rename",
    ),
    model_row(
        "a sensor of the step before",
        network([prior(a)], [walk(a)], [SEES_PREVIOUS]),
        "a[t-1]",
        "sensor",
        "state",
        variable=a.previous,
        cpd=SEES_PREVIOUS,
    ),
    model_row(
        "two steps back",
        network([prior(a), prior(b)], [LAG_2, walk(b)]),
        "b[t-2]",
        "state of its own",
        variable=b.previous.previous,
        cpd=LAG_2,
    ),
    model_row(
        "a single step",
        network([prior(a)], [AT_3]),
        "a[3]",
        "single step",
        variable=a.at(3),
        cpd=AT_3,
    ),
    model_row(
        "a reading as a parent",
        network([prior(a)], [OF_READING], [linear(w, a)]),
        "w",
        "measurement",
        variable=w,
        cpd=OF_READING,
    ),
    model_row(
        "noise that a state sets",
        network([prior(a)], [walk(a)], [HIDDEN_NOISE]),
        "a",
        "noise",
        "inputs",
        variable=a,
        cpd=HIDDEN_NOISE,
    ),
    model_row(
        "an input in the prior", network([linear(a, b)], [walk(a)]), "b", "prior", variable=b
    ),
    model_row("no CPD", network([a], [walk(a)]), "prior", "CPDs", "a"),
    model_row(
        "replace what is not there",
        lambda: network([prior(a)], [walk(a)])().replace(sensors=[]),
        "sensors",
        "observation",
    ),
]

TABLE = CPDS + NETWORKS


@pytest.mark.parametrize("refused", TABLE, ids=lambda r: r.name)
def test_every_refusal(refused):
    refused.check()


@pytest.mark.parametrize("refused", TABLE, ids=lambda r: r.name)
def test_before_inference_functions_meet_no_data(refused):
    """At the most a trial call, whose leading axes are none of the evidence's."""
    CALLS.clear()
    refused.check()
    assert len(CALLS) <= 5
    assert all(argument.shape[:2] == (2, 3) for call in CALLS for argument in call)


def test_kinds_of_errors():
    for kind in (ModelError, GraphError, EvidenceError, LinearisationError):
        assert issubclass(kind, pgm.PgmError)
        assert issubclass(kind, ValueError)
    assert issubclass(NumericalError, pgm.PgmError)
    assert issubclass(NumericalError, ArithmeticError)
    assert not issubclass(NumericalError, ValueError)
