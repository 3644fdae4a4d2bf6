"""Several modes of networks of factors, against integrals on lattices and Bayesian networks."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from two_ranges import FORM, HEARD, PRIOR, RESIDUAL, P, ranges

import pgm

A, B = pgm.variables("a b")


@pytest.mark.parametrize("prior", [PRIOR, FORM, RESIDUAL], ids=["cpd", "form", "residual"])
def test_a_fix_by_two_ranges_is_that_of_the_bayesian_network(prior):
    """Without draws the same to rounding; with them within the draws' error."""
    left, right = pgm.variables("left right")
    twin = pgm.BayesianNetwork(
        [
            PRIOR,
            pgm.NonlinearGaussianCPD(left, P, ranges(-2.0), 0.04),
            pgm.NonlinearGaussianCPD(right, P, ranges(2.0), 0.04),
        ]
    )
    graph = pgm.compile(pgm.MarkovNetwork([prior, *HEARD]))
    for draws, near in ((0, 1e-6), (8000, 0.02)):
        belief = pgm.Gaussians(4, starts=16, draws=draws)
        due = pgm.infer(pgm.compile(twin), {left: [2.5], right: [2.7]}, belief=belief)
        found = pgm.infer(graph, {}, belief=belief)
        assert found.log_evidence == pytest.approx(due.log_evidence, abs=near)
        assert found.log_evidence_kind == due.log_evidence_kind
        order, twins = (np.argsort(p[P].components.mean[:, 1]) for p in (found, due))
        assert len(order) == len(twins) == 2
        assert_allclose(found[P].weights[order], due[P].weights[twins], atol=near)
        for part in ("mean", "cov"):
            own = getattr(found[P].components, part)[order]
            assert_allclose(own, getattr(due[P].components, part)[twins], atol=near)


def test_runs_with_the_constants_of_factors_against_integrals():
    """A form of rank one beside one of a neighbour; three runs of evidence, and the draws of it."""
    graph = pgm.compile(
        pgm.MarkovNetwork(
            [
                pgm.CanonicalForm((A, B), [[1.0, -1.0], [-1.0, 1.0]], [0.2, -0.2], 40.0),
                pgm.CanonicalForm(A, [[0.1]], [0.0], -3.0),
                pgm.NonlinearGaussianFactor((A, B), lambda a, b: a**2 + b, 0.3, value=2.0),
            ]
        )
    )
    seen, axis = np.array([[0.5], [-1.0], [1.5]]), np.linspace(-9.0, 9.0, 20_001)
    found = pgm.infer(graph, {B: seen}, belief=pgm.Gaussians(4, starts=8, draws=8000))
    for run, b in enumerate(seen[:, 0]):
        off = axis - b
        logs = -0.5 * off**2 + 0.2 * off + 40.0 - 0.05 * axis**2 - 3.0
        logs += -0.5 * (axis**2 + b - 2.0) ** 2 / 0.3 - 0.5 * np.log(2.0 * np.pi * 0.3)
        weight = np.exp(logs - 37.0)
        total = np.log(weight.sum() * (axis[1] - axis[0])) + 37.0
        assert found.log_evidence[run] == pytest.approx(total, abs=0.02)
        mean = (weight * axis).sum() / weight.sum()
        assert found[A].mean[run, 0] == pytest.approx(mean, abs=0.03)


def test_where_starts_come_from():
    """A prior, or affine factors with Gaussian noise: else a refusal names what they leave open."""
    belief = pgm.Gaussians(2, starts=4)

    def refused(factors, told, variable, evidence=None):
        graph = pgm.compile(pgm.MarkovNetwork(factors))
        with pytest.raises(pgm.ModelError, match=told) as caught:
            pgm.infer(graph, evidence or {}, belief=belief)
        assert caught.value.variable == variable

    refused(HEARD, "law that affine factors .* make together, and neither bounds p:", P)
    half = pgm.CanonicalForm(P, [[1.0, 0.0], [0.0, 0.0]], [0.0, 0.0])
    refused([half, *HEARD], "neither bounds p:", P)
    # Of two that are told relative to one another neither is known.
    square = pgm.NonlinearGaussianFactor(A, lambda a: a**2, 0.1, value=1.0)
    apart = pgm.LinearGaussianCPD(B, {A: 1.0}, cov=1.0)
    refused([square, apart], "neither bounds a:", A)
    step = pgm.CanonicalForm((A, B), [[1.0, -1.0], [-1.0, 1.0]], [0.0, 0.0])
    refused([square, step], "neither bounds a, b:", A)
    robust = pgm.NonlinearGaussianFactor(A, lambda a: a, 1.0, noise=pgm.Cauchy(2.4))
    refused([square, robust], "neither bounds a:", A)
    # What is told by way of a neighbour is told.
    seen = pgm.GaussianCPD(B, 0.2, 1.0)
    network = pgm.MarkovNetwork([square, step, seen])
    assert (
        len(pgm.infer(pgm.compile(network), {}, belief=pgm.Gaussians(2, starts=8))[A].weights) == 2
    )
    everything = pgm.compile(pgm.MarkovNetwork([pgm.GaussianCPD(A, 0.0, 1.0), square]))
    with pytest.raises(pgm.EvidenceError, match="all are observed"):
        pgm.infer(everything, {A: [1.0]}, belief=belief)
    with pytest.raises(pgm.EvidenceError, match="which the network does not have"):
        pgm.infer(everything, {pgm.Variable("residual 1"): 0.0}, belief=belief)
