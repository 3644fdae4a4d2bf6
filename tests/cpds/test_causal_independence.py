"""CPDs of independent causes: tables by enumeration, draws, densities, and what is refused."""

import copy
import pickle
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm import CausalIndependence, Discrete, NoisyMax, NoisyOr, TableCPD
from pgm.errors import ModelError

FLU, COLD, ALLERGY = (Discrete(name, states=("no", "yes")) for name in ("flu", "cold", "allergy"))
GRADE = Discrete("grade", states=("none", "slight", "bad"))
FEVER = Discrete("fever", states=("no", "yes"))
CAUSES = (FLU, COLD, ALLERGY)
MANY = [Discrete(f"cause {k}", states=("no", "yes")) for k in range(30)]


def enumerated(cpd, combine):
    """Sum over all contributions of all causes, combination by combination."""
    size = cpd.child.size
    table = np.zeros((*(v.size for v in cpd.given), size))
    every = [range(size) for _ in cpd.given]
    starts = [(None, 1.0)] if cpd.leak is None else list(enumerate(cpd.leak))
    for at in product(*(range(v.size) for v in cpd.given)):
        for start, weight in starts:
            for each in product(*every):
                found, p = start, weight
                for own, x, y in zip(cpd.contributions, at, each, strict=True):
                    p *= own[x, y]
                    found = y if found is None else combine(found, y)
                table[*at, found] += p
    return table


def test_a_noisy_or_is_the_product_of_what_each_cause_leaves_off():
    p, leak = np.array([0.9, 0.5, 0.25]), 0.125
    cpd = NoisyOr(FEVER, CAUSES, p, leak)
    for at in product(range(2), repeat=3):
        off = (1 - leak) * np.prod((1 - p) ** np.array(at))
        assert_allclose(cpd.table[at], [off, 1 - off], rtol=1e-14)
    assert isinstance(cpd, NoisyMax)
    assert isinstance(cpd, TableCPD)


def test_a_noisy_max_is_a_product_of_distribution_functions():
    rng = np.random.default_rng(0)
    given = (FLU, Discrete("stage", 3))
    own = [rng.dirichlet(np.ones(3), v.size) for v in given]
    leak = rng.dirichlet(np.ones(3))
    cpd = NoisyMax(GRADE, given, own, leak)
    below = np.cumsum(own[0], -1)[:, None] * np.cumsum(own[1], -1)[None] * np.cumsum(leak)
    assert_allclose(np.cumsum(cpd.table, -1), below, rtol=1e-14)


@pytest.mark.parametrize("seed", range(8))
def test_any_operation_combines_from_the_left(seed):
    rng = np.random.default_rng(seed)
    size = int(rng.integers(2, 4))
    child = Discrete("child", size)
    given = [Discrete(f"x{k}", int(rng.integers(1, 4))) for k in range(rng.integers(1, 4))]
    operation = rng.integers(0, size, (size, size))
    leak = rng.dirichlet(np.ones(size)) if seed % 2 else None
    own = [rng.dirichlet(np.ones(size), v.size) for v in given]
    cpd = CausalIndependence(child, given, own, operation, leak)
    assert_allclose(cpd.table, enumerated(cpd, lambda a, b: operation[a, b]), atol=1e-14)


@pytest.mark.parametrize(
    ("combine", "function"),
    [
        (np.minimum, min),
        (np.bitwise_xor, lambda *bits: sum(bits) % 2),
        (lambda a, b: np.minimum(a + b, 1), max),
    ],
)
def test_certain_contributions_make_a_function_of_the_parents(combine, function):
    cpd = CausalIndependence(FEVER, CAUSES, [np.eye(2)] * 3, combine)
    for at in product(range(2), repeat=3):
        assert_array_equal(cpd.table[at], np.eye(2)[function(*at)])


def test_a_count_of_thirty():
    total = Discrete("total", 31)
    one = np.eye(31)[:2]
    cpd = CausalIndependence(total, MANY, [one] * 30, lambda a, b: np.minimum(a + b, 30))
    net = pgm.BayesianNetwork([*(TableCPD(v, table=[0.75, 0.25]) for v in MANY), cpd])
    stats = pytest.importorskip("scipy.stats")
    assert_allclose(pgm.query(net, total).values, stats.binom(30, 0.25).pmf(range(31)), rtol=1e-12)


def test_the_order_of_grades_and_the_state_that_is_on():
    own = [[[0.2, 0.8], [0.6, 0.4]], [[0.5, 0.5], [0.0, 1.0]]]
    turned = Discrete("turned", states=("high", "low"))
    lowest = NoisyMax(turned, (FLU, COLD), own, order=("low", "high"))
    assert_allclose(lowest.table[..., 1], np.outer([0.8, 0.4], [0.5, 1.0]))
    wet = Discrete("wet", states=("yes", "no"))
    sun = Discrete("sun", states=("true", "false"))
    cpd = NoisyOr(wet, (sun, FLU), [0.75, 0.5], 0.125, present={wet: "yes", sun: "true"})
    assert_allclose(cpd.table[0, 1], [1 - 0.875 * 0.25 * 0.5, 0.875 * 0.25 * 0.5])
    assert_allclose(cpd.table[1, 0], [0.125, 0.875])


def test_a_cause_of_several_states():
    stage = Discrete("stage", states=("none", "early", "late"))
    cpd = NoisyOr(FEVER, (stage, FLU), [[0.0, 0.25, 0.75], 0.5])
    assert_allclose(cpd.table[:, 0, 1], [0.0, 0.25, 0.75])
    assert_allclose(cpd.table[2, 1, 1], 1 - 0.25 * 0.5)


def test_small_probabilities_keep_their_digits():
    cpd = NoisyOr(FEVER, CAUSES, [1e-12, 3e-13, 1e-300])
    assert_allclose(cpd.table[1, 1, 0, 1], 1.3e-12 - 3e-25, rtol=1e-15)
    assert cpd.table[0, 0, 1, 1] == 1e-300
    assert_array_equal(NoisyOr(FEVER, FLU, [1.0]).table, np.eye(2))
    density = cpd.log_density([1], dict.fromkeys(CAUSES, 1))
    assert_allclose(density, np.log(1.3e-12), rtol=1e-12)


def test_densities_and_draws_need_no_table():
    rng = np.random.default_rng(1)
    p = rng.uniform(0, 0.1, 30)
    cpd = NoisyOr(FEVER, MANY, p, 0.01)
    states = rng.integers(0, 2, (5, 30))
    given = {v: states[:, k] for k, v in enumerate(MANY)}
    off = 0.99 * np.prod((1 - p) ** states, axis=-1)
    assert_allclose(cpd.log_density([0] * 5, given), np.log(off), rtol=1e-12)
    assert_allclose(cpd.log_density(["yes"], given), np.log1p(-off), rtol=1e-12)
    drawn = cpd.sample(given, size=20_000, rng=2)
    assert drawn.shape == (20_000, 5)
    assert_allclose(drawn.mean(axis=0), 1 - off, atol=5 * np.sqrt(0.25 / 20_000))
    one = cpd.sample(dict.fromkeys(MANY, 0), size=7, rng=0)
    assert one.shape == (7,)


def test_densities_are_the_entries_of_the_table():
    rng = np.random.default_rng(3)
    cpd = NoisyMax(GRADE, CAUSES, rng.dirichlet(np.ones(3), (3, 2)), rng.dirichlet(np.ones(3)))
    table = TableCPD(GRADE, CAUSES, table=cpd.table)
    grid = np.arange(2)
    given = {FLU: grid[:, None, None], COLD: grid[:, None], ALLERGY: grid}
    for state in GRADE.states:
        expected = table.log_density(state, given)
        assert_allclose(cpd.log_density(state, given), expected, rtol=1e-13)


def test_copies_and_text():
    cpd = NoisyOr(FEVER, (FLU, COLD), [0.9, 0.5], 0.01)
    assert repr(cpd) == "NoisyOr(fever | flu, cold)"
    assert str(cpd) == (
        "NoisyOr(fever | flu, cold)\n"
        "  cause     fever yes\n"
        "  flu yes         0.9\n"
        "  cold yes        0.5\n"
        "  leak           0.01"
    )
    graded = NoisyMax(GRADE, FLU, [[[1, 0, 0], [0.5, 0.25, 0.25]]])
    assert "flu yes" in str(graded)
    assert "bad" in str(graded)
    for twin in (copy.deepcopy(cpd), pickle.loads(pickle.dumps(cpd)), cpd.at(3)):
        assert type(twin) is NoisyOr
        assert_array_equal(twin.table, cpd.table)
    assert cpd.at(3).scope == (FEVER.at(3), FLU.at(3), COLD.at(3))
    assert not cpd.table.flags.writeable
    assert not cpd.operation.flags.writeable
    assert len(str(NoisyOr(FEVER, MANY, [0.1] * 30)).splitlines()) <= 20


def test_a_large_table_is_refused_with_its_size():
    cpd = NoisyOr(FEVER, MANY, [0.1] * 30)
    with pytest.raises(ModelError, match="2,147,483,648 entries, 16 GiB, where 16,777,216") as told:
        cpd.table  # noqa: B018
    assert told.value.cpd is cpd


GRADES = [[1, 0, 0], [0, 0, 1]]
REFUSED = [
    (lambda: NoisyOr(GRADE, FLU, [0.5]), "has 3 states, and a noisy-or is of two"),
    (lambda: NoisyOr(FEVER, (), []), "has no cause"),
    (lambda: NoisyOr(FEVER, CAUSES, [0.5, 0.5]), "3 in their order; found 2"),
    (lambda: NoisyOr(FEVER, FLU, 0.5), "probabilities has one of each cause"),
    (lambda: NoisyOr(FEVER, FLU, {FLU: 0.5}), "probabilities has one of each cause"),
    (lambda: NoisyOr(FEVER, FLU, [1.5]), "probabilities are from 0 to 1"),
    (lambda: NoisyOr(FEVER, FLU, [np.nan]), "probabilities are from 0 to 1"),
    (lambda: NoisyOr(FEVER, FLU, [[0.1, 0.2, 0.3]]), "a probability, or one of each of its states"),
    (lambda: NoisyOr(FEVER, GRADE, [0.5]), "takes one of each of its states, .none, slight, bad"),
    (lambda: NoisyOr(FEVER, FLU, [0.5], leak=-0.1), "leak is a probability"),
    (lambda: NoisyOr(FEVER, FLU, [0.5], leak=[0.1]), "leak is a probability"),
    (lambda: NoisyOr(FEVER, FLU, [0.5], present={COLD: "yes"}), "none of its variables"),
    (lambda: NoisyOr(FEVER, FLU, [0.5], present={FLU: "maybe"}), "has no state 'maybe'"),
    (lambda: NoisyOr(FEVER, FLU, [0.5], present=("yes",)), "is a mapping"),
    (lambda: NoisyOr(Discrete("w", ("Yes", "No")), FLU, [0.5]), "present={w: 'Yes'}"),
    (lambda: NoisyOr(FEVER, Discrete("w", ("1", "0")), [0.5]), "present={w: '1'}"),
    (lambda: NoisyOr(FEVER, pgm.Variable("x"), [0.5]), "is continuous"),
    (lambda: NoisyOr(FEVER, FEVER, [0.5]), "given as its own parent"),
    (lambda: NoisyMax(GRADE, FLU, [[[1, 0], [0, 1]]]), r"has shape \(2, 2\)"),
    (lambda: NoisyMax(GRADE, FLU, [[[1, 0, 0], [0.5, 0, 0.4]]]), "sum to 0.9"),
    (lambda: NoisyMax(GRADE, FLU, [[[1, 0, 0], [1.5, 0, -0.5]]]), "negative, NaN or infinite"),
    (lambda: NoisyMax(GRADE, FLU, [GRADES], leak=[1, 0]), "has shape"),
    (lambda: NoisyMax(GRADE, FLU, [GRADES], order=("none", "bad")), "each once, from the lowest"),
    (lambda: NoisyMax(GRADE, FLU, [GRADES], order=("none", "bad", "worse")), "has no state"),
    (lambda: CausalIndependence(GRADE, FLU, [GRADES], np.add), "makes 3 of 'slight' and 'bad'"),
    (lambda: CausalIndependence(GRADE, FLU, [GRADES], [[0.5] * 3] * 3), "makes 0.5 of"),
    (lambda: CausalIndependence(GRADE, FLU, [GRADES], np.eye(2)), r"found the shape \(2, 2\)"),
    (lambda: CausalIndependence(GRADE, FLU, [GRADES], lambda a: a), "combine failed"),
    (lambda: CausalIndependence(GRADE, FLU, [GRADES], "max"), "combine"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()
