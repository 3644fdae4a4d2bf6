"""How growing maps refuse what does not fit, and stay as they are."""

import numpy as np
import pytest

import pgm

a, b, c, z = pgm.variables("a b c z")
rain = pgm.Discrete("rain", ("no", "yes"))
HERE = pgm.GaussianCPD(a, 0.0, 1.0)
HELD = pgm.GaussianCPD(b, 0.0, 1.0)
SEEN = pgm.LinearGaussianCPD(z, {a: 1.0}, 1.0)


def base():
    return pgm.GrowingMap().add([HERE, HELD], {b: 2.0})


def square(**options):
    return pgm.NonlinearGaussianCPD(z, given=a, function=np.square, cov=1.0, **options)


REFUSED = [
    ([HERE], {}, pgm.ModelError, "a was added before"),
    ([HELD], {}, pgm.ModelError, "b was added before"),
    ([SEEN, SEEN], {}, pgm.ModelError, "two CPDs"),
    (3, {}, pgm.ModelError, "sequence of CPDs"),
    ([pgm.LinearGaussianCPD(z, {c: 1.0}, 1.0)], {z: 1.0}, pgm.EvidenceError, "no evidence for c"),
    ([SEEN], {z: 1.0, a: 2.0}, pgm.EvidenceError, "added without: it stays hidden"),
    ([SEEN], {z: 1.0, b: 2.0}, pgm.EvidenceError, "some since before"),
    ([SEEN], {z: 1.0, c: 2.0}, pgm.EvidenceError, "evidence for c"),
    ([SEEN], {z: [[1.0], [2.0]]}, pgm.EvidenceError, "one run"),
    ([pgm.LinearGaussianCPD(z, {a: 1.0}, 0.0)], {z: 1.0}, pgm.ModelError, "no noise"),
    ([pgm.GaussianCPD(c, [[0.0], [1.0]], 1.0)], {}, pgm.ModelError, "axes of runs"),
    ([pgm.TableCPD(rain, table=[0.5, 0.5])], {}, pgm.ModelError, "Gaussian CPDs alone"),
    ([square(noise=pgm.Huber(1.5))], {z: 1.0}, pgm.ModelError, "robust noise"),
    ([square(lineariser=pgm.Unscented())], {z: 1.0}, pgm.ModelError, "linearises at means"),
    (
        [pgm.LinearGaussianCPD(z, {a.previous: 1.0}, 1.0)],
        {z: 1.0},
        pgm.ModelError,
        "of a step before",
    ),
    (
        [pgm.GaussianCPD(pgm.Variable("a", ("p", "q")), [0.0, 0.0], 1.0)],
        {},
        pgm.ModelError,
        "two different variables are called 'a'",
    ),
    ([pgm.GaussianCPD(c, 0.0, np.inf)], {}, pgm.NumericalError, "direction of c open"),
    (
        [pgm.NonlinearGaussianCPD(z, given=a, function=lambda a: a / 0.0, cov=1.0)],
        {z: 1.0},
        pgm.LinearisationError,
        "z",
    ),
    (
        [pgm.NonlinearGaussianCPD(z, given=a, function=lambda a: a[..., 0], cov=1.0)],
        {z: 1.0},
        pgm.ModelError,
        "returned shape",
    ),
]


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("cpds", "evidence", "error", "words"), REFUSED)
def test_what_does_not_fit_is_refused(cpds, evidence, error, words):
    grown = base()
    with pytest.raises(error, match=words):
        grown.add(cpds, evidence)
    after = grown.add(SEEN, {z: 2.0})
    np.testing.assert_allclose(after[a].mean, [1.0])
    np.testing.assert_allclose(grown[a].mean, [0.0])


def test_starts_are_of_new_hidden_variables():
    with pytest.raises(pgm.EvidenceError, match="start has a, which is no new hidden variable"):
        base().add(pgm.GaussianCPD(c, 0.0, 1.0), start={a: 1.0})
    with pytest.raises(pgm.EvidenceError, match="there is none"):
        base().add(SEEN, {z: 1.0}, start={z: 1.0})
    with pytest.raises(pgm.EvidenceError, match="one run"):
        base().add(pgm.GaussianCPD(c, 0.0, 1.0), start={c: [[1.0], [2.0]]})


def test_a_known_parent_gets_no_cpd_later():
    grown = base().add(pgm.LinearGaussianCPD(z, {a: 1.0, c: 1.0}, 1.0), {z: 1.0, c: 0.5})
    with pytest.raises(pgm.ModelError, match="c has evidence since before"):
        grown.add(pgm.GaussianCPD(c, 0.0, 1.0))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"lineariser": pgm.Unscented()}, "linearises at means"),
        ({"threshold": -1.0}, "threshold=-1.0"),
        ({"threshold": "far"}, "threshold='far'"),
        ({"tolerance": np.nan}, "tolerance=nan"),
        ({"every": 0}, "every=0"),
        ({"compiled": "yes"}, "compiled='yes'"),
    ],
)
def test_options_that_do_not_fit(options, words):
    with pytest.raises(pgm.ModelError, match=words):
        pgm.GrowingMap(**options)


def test_beliefs_that_are_not_there():
    grown = base()
    for asked, words in (
        (b, "b has evidence"),
        (c, "which the map does not have"),
        ("a", "asked for by variable"),
    ):
        with pytest.raises(pgm.EvidenceError, match=words):
            grown[asked]
    with pytest.raises(pgm.EvidenceError, match="there is none"):
        grown.joint()
    with pytest.raises(pgm.EvidenceError, match="there is none"):
        grown.means([])


def test_what_does_not_settle_is_told():
    far = pgm.NonlinearGaussianCPD(z, given=a, function=np.arctan, cov=1e-4)
    grown = pgm.GrowingMap().add([pgm.GaussianCPD(a, 3.0, 1e4), far], {z: 0.0})
    with pytest.raises(pgm.NumericalError, match="a mean still moves"):
        grown.settled(iterations=3)
