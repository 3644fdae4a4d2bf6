"""Stacked moments of several variables: those of each by itself, in one array."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import pgm
from pgm.examples import walk, x, z

A, B, C = (pgm.Variable(name, ("u", "v")) for name in "abc")
OTHER = pgm.Variable("d")
STATIC = pgm.compile(
    pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(A, [0.0, 1.0], [[1.0, 0.3], [0.3, 2.0]]),
            pgm.LinearGaussianCPD(B, {A: [[1.0, 0.5], [0.0, 1.0]]}, cov=0.5),
            pgm.LinearGaussianCPD(C, {B: np.eye(2)}, cov=[1.0, 1e-12]),
            pgm.LinearGaussianCPD(OTHER, {B: [[1.0, 1.0]]}, cov=1.0),
        ]
    )
)


@pytest.mark.parametrize("runs", [(), (3,), (2, 3)], ids=str)
@pytest.mark.parametrize("seen", [OTHER, None], ids=repr)
def test_of_a_network(runs, seen):
    evidence = {} if seen is None else {seen: np.linspace(0.0, 1.0, 6)[: np.prod(runs, dtype=int)]}
    evidence = {v: values.reshape(*runs, 1) for v, values in evidence.items()}
    check(pgm.infer(STATIC, evidence), [C, A, B])


@pytest.mark.parametrize("runs", [(), (3,)], ids=str)
@pytest.mark.parametrize(
    "belief", [None, pgm.Grid({x: (-15.0, 15.0, 61)}), pgm.Particles(50)], ids=repr
)
def test_over_time(runs, belief):
    evidence = {z: np.linspace(0.0, 1.0, 12)[..., None][: 4 * int(np.prod(runs))]}
    evidence = {z: evidence[z].reshape(*runs, 4, 1)}
    posterior = pgm.filter(walk, evidence, belief=belief)
    check(posterior, [x])
    check(posterior, [x.at(3), x.at(1)])


def check(posterior, variables):
    """The stacked moments are those of the variables' own beliefs, bit for bit."""
    means, covs, stds = (getattr(posterior, name)(variables) for name in ("means", "covs", "stds"))
    for k, variable in enumerate(variables):
        own = posterior[variable]
        assert_array_equal(means[..., k, :], own.mean)
        assert_array_equal(covs[..., k, :, :], own.cov)
        assert_array_equal(stds[..., k, :], own.std)
    assert means.shape[-2] == covs.shape[-3] == len(variables)


def test_one_alone_counts_as_several():
    assert pgm.infer(STATIC, {}).means(A).shape == (1, 2)


@pytest.mark.parametrize(
    ("variables", "words"),
    [
        ([], "one or more variables"),
        ([A, OTHER], r"d has 1 components?, a has 2"),
        ([pgm.Discrete("k", ("yes", "no"))], "k is discrete"),
        ([C, pgm.Variable("e", ("u", "v"))], "e is not in the network"),
        ([A, A], "twice"),
    ],
)
def test_refusals(variables, words):
    with pytest.raises(pgm.PgmError, match=words):
        pgm.infer(STATIC, {}).means(variables)


def test_what_was_observed_has_none():
    with pytest.raises(pgm.EvidenceError, match="c is observed"):
        pgm.infer(STATIC, {C: [0.0, 0.0]}).covs([A, C])
