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


m, n, y, l0, l1 = pgm.variables("m n y l0 l1")
OPEN = pgm.LinearGaussianCPD(z, {a: 1.0, m: 1.0}, 1.0)
EITHER = pgm.unknown([l0, l1], gate=0.99)
wide = pgm.Variable("wide", ("p", "q"))
NOISY = pgm.LinearGaussianCPD(
    z, {a: 1.0}, cov=pgm.noise(lambda m: 1.0 + m[..., None] ** 2, given=m)
)

UNKNOWN = [
    ([OPEN], {m: EITHER, z: 1.0, n: EITHER}, "leaves n open, but it is no parent"),
    ([OPEN], {m: EITHER, z: 1.0, a: EITHER}, "leaves a open, but it is a hidden variable"),
    ([OPEN, pgm.GaussianCPD(m, 0, 1)], {m: EITHER, z: 1.0}, "leaves m open, but it has a CPD"),
    ([pgm.LinearGaussianCPD(z, {a: 1.0, b: 1.0}, 1.0)], {b: EITHER, z: 1.0}, "evidence since"),
    ([OPEN], {m: EITHER}, "no evidence for z, by which to tell"),
    ([OPEN], {m: EITHER, z: EITHER}, "leaves z open, but it has a CPD"),
    ([OPEN], {m: pgm.unknown([[0.0], [1.0]]), z: 1.0}, "open among 2 rows of values"),
    ([OPEN], {m: pgm.unknown([l0, l1], association="sum"), z: 1.0}, "to be summed out"),
    (
        [OPEN],
        {m: pgm.unknown([l0, c]), z: 1.0},
        "c, a candidate for m, is a variable which",
    ),
    ([OPEN], {m: pgm.unknown([l0, b]), z: 1.0}, "b, a candidate for m, has evidence"),
    (
        [OPEN],
        {m: pgm.unknown([l0, m]), z: 1.0},
        "leaves m open, but it is among its own candidates",
    ),
    ([OPEN], {m: pgm.unknown([l0, z]), z: 1.0}, "z, a candidate for m, has evidence"),
    ([OPEN], {m: pgm.unknown([l0, a]), z: 1.0}, "of which a is a candidate, and a parent"),
    ([OPEN], {m: pgm.unknown([wide]), z: 1.0}, "among candidates with components"),
    (
        [pgm.LinearGaussianCPD(z, {m: 1.0, n: 1.0}, 1.0)],
        {m: EITHER, n: EITHER, z: 1.0},
        "and n too; candidates are for one parent",
    ),
    ([NOISY], {m: EITHER, z: 1.0}, "on which its noise depends"),
    (
        [OPEN, pgm.LinearGaussianCPD(y, {z: 1.0}, 1.0)],
        {m: EITHER, z: 1.0, y: 1.0},
        "depends on z, which is left out",
    ),
    (
        [pgm.LinearGaussianCPD(wide, {m: [[1.0], [1.0]]}, 1.0)],
        {m: pgm.unknown([l0], spurious=0.1, volume=9.0), wide: [1.0, np.nan]},
        "have components that are NaN",
    ),
    ([OPEN], {m: EITHER, z: [[1.0], [2.0]]}, "one run"),
    ([OPEN], {m: EITHER, z: [1.0, 2.0]}, "has shape"),
]


@pytest.mark.parametrize(("cpds", "evidence", "words"), UNKNOWN)
def test_unknown_parents_that_do_not_fit(cpds, evidence, words):
    grown = base().add([pgm.GaussianCPD(v, k, 1.0) for k, v in enumerate((l0, l1))])
    with pytest.raises(pgm.EvidenceError, match=words):
        grown.add(cpds, evidence)
    assert grown.add(OPEN, {z: 1.0, m: EITHER}).associations[z].variable == l1


@pytest.mark.parametrize(
    ("sensor", "error", "words"),
    [
        (
            pgm.NonlinearGaussianCPD(z, (a, m), lambda a, m: a * m / 0.0, cov=1.0),
            pgm.LinearisationError,
            "z",
        ),
        (
            pgm.NonlinearGaussianCPD(z, (a, m), lambda a, m: a[..., 0] + m[..., 0], cov=1.0),
            pgm.ModelError,
            "returned shape",
        ),
        (
            pgm.NonlinearGaussianCPD(z, (a, m), np.add, cov=1.0, noise=pgm.Huber(1.5)),
            pgm.ModelError,
            "robust noise",
        ),
        (pgm.LinearGaussianCPD(z, {m: 0.0}, cov=0.0), pgm.NumericalError, "innovation has no var"),
        (pgm.LinearGaussianCPD(z, {m: 1.0}, cov=0.0), pgm.ModelError, "no noise in some direction"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_open_sensors_that_do_not_fit(sensor, error, words):
    grown = base().add([pgm.GaussianCPD(v, k, 1.0) for k, v in enumerate((l0, l1))])
    with pytest.raises(error, match=words):
        grown.add(sensor, {z: 1.0, m: EITHER})


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
    for name in ("means", "covs", "stds"):
        with pytest.raises(TypeError, match=rf"one list: {name}\(\[a, c\]\)"):
            getattr(grown, name)(a, c)


def test_what_does_not_settle_is_told():
    far = pgm.NonlinearGaussianCPD(z, given=a, function=np.arctan, cov=1e-4)
    grown = pgm.GrowingMap().add([pgm.GaussianCPD(a, 3.0, 1e4), far], {z: 0.0})
    with pytest.raises(pgm.NumericalError, match="a mean still moves"):
        grown.settled(iterations=3)
