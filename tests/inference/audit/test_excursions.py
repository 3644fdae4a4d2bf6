"""Densities of excursions against a sum over all that there are."""

import numpy as np
import pytest

import pgm
from pgm.beliefs.moments.trajectories.student import FREEDOM, log_ratio
from pgm.inference.audit.chain import ChainDraws
from pgm.inference.audit.excursions import AFTER, BEFORE, END, PREDICTION, TAILS, Excursions

a, z = pgm.variables("a z")


def every(slices, predicted):
    """All (probability, stages) of a draw, by the definition."""
    for first in range(slices):
        begin = 1.0
        if slices > 1:
            begin = 0.5 if first == 0 else 0.5 / (slices - 1)
        for last in range(first, slices):
            length = last - first
            chance = begin * (1 - END) ** length
            if last < slices - 1:
                chance *= END
            for kind, part in ((PREDICTION, predicted), (TAILS, 1 - predicted)):
                stages = [BEFORE] * first + [kind] * (length + 1)
                yield chance * part, tuple(stages + [AFTER] * (slices - last - 1))


@pytest.mark.parametrize("slices", [1, 2, 3, 6])
@pytest.mark.parametrize("predicted", [0.75, 0.0])
def test_the_density_is_the_sum_over_all_excursions(slices, predicted):
    law = Excursions(slices, predicted)
    assert sum(chance for chance, _ in every(slices, predicted)) == pytest.approx(1.0)
    rng = np.random.default_rng(slices)
    gaussian, model, student = rng.normal(size=(3, slices, 2, 5)) * 3.0
    density = law.begin((2, 5))
    for some in (slice(0, 1), slice(1, 3), slice(3, slices)):
        density = law.extend(some.start, density, gaussian[some], model[some], student[some])
    due = 0.0
    for chance, stages in every(slices, predicted):
        logs = sum(
            {PREDICTION: model[k], TAILS: gaussian[k] + student[k]}.get(stage, gaussian[k])
            for k, stage in enumerate(stages)
        )
        due = due + chance * np.exp(logs)
    np.testing.assert_allclose(density.log(), np.log(due), rtol=1e-12, atol=1e-12)


def test_stages_are_drawn_as_often_as_the_law_says():
    law, count = Excursions(3), 200_000
    rng = np.random.default_rng(0)
    stage, seen = law.start(1, count), []
    for k in range(3):
        stage = law.advance(k, stage, rng)
        seen.append(stage[0])
    found = np.stack(seen, axis=-1)
    for chance, stages in every(3, law.predicted):
        share = (found == stages).all(axis=-1).mean()
        assert share == pytest.approx(chance, abs=5 * np.sqrt(chance / count)), stages


def test_what_is_far_away_keeps_its_logarithm():
    law = Excursions(2)
    density = law.begin((1, 1))
    for k in range(2):
        gaussian, model = np.full((1, 1), -1e8), np.full((1, 1), -3.0)
        density = law.extend(k, density, gaussian, model, np.full((1, 1), 10.0))
    staying = 0.5 * law.predicted * (1 - END)
    np.testing.assert_allclose(density.log(), np.log(staying) - 6.0)


def test_students_tails_are_those_of_scipy():
    from scipy.stats import multivariate_normal, multivariate_t

    white = np.random.default_rng(0).normal(size=(1, 50, 3)) * 4.0
    squared = (white**2).sum(-1)
    due = multivariate_t(shape=np.eye(3), df=FREEDOM).logpdf(white[0])
    due = due - multivariate_normal(np.zeros(3)).logpdf(white[0])
    np.testing.assert_allclose(log_ratio(np.array([[3]]), squared)[0], due, rtol=1e-10)


def chain(steps):
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 1.0, 1.0)],
        transition=[pgm.NonlinearGaussianCPD(a, a.previous, lambda x: x + np.sin(x), 0.5)],
        observation=[pgm.NonlinearGaussianCPD(z, a, lambda x: x**2 / 4, 0.3)],
    )
    return pgm.smooth(model, {z: np.linspace(1.0, 2.0, steps)[:, None]})


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_draws_come_from_the_density_that_is_told(steps):
    """The mean of q/d over draws of d is one, and of d/r over draws of both."""
    draws = ChainDraws.make(chain(steps)._outcome)
    rng = np.random.default_rng(1)
    q, d = (draws.draw(40_000, rng, defensive=kind) for kind in (False, True))
    for of in (lambda each: each.gaussian, lambda each: each.defensive):
        shares = [np.exp(of(each) - np.logaddexp(each.gaussian, each.defensive)) for each in (q, d)]
        mean = sum(each.mean() for each in shares)
        error = np.sqrt(sum(each.var() / each.size for each in shares))
        assert 0.0 < error < 0.01
        assert abs(mean - 1.0) < 4 * error
