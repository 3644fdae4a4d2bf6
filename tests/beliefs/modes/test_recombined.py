"""Trajectories recombined from draws of each step, against exact smoothers and a grid."""

from dataclasses import replace

import numpy as np
import pytest

import pgm
from experiments.iterated import growth
from pgm.beliefs.modes.chain import ChainSearch
from pgm.beliefs.modes.recombined import Recombination
from pgm.examples import walk, x, z
from pgm.inference.estimating import _over_time
from pgm.inference.vouching import climbing
from pgm.inference.vouching.climbing import seek
from pgm.inference.vouching.recombining import recombined


def recombination(model, evidence):
    """The recombination of a chain about the modes that estimates find."""
    search = _over_time(model, evidence, None).search()
    assert isinstance(search, ChainSearch)
    laws = seek(search).laws
    return Recombination(search.target(laws).chain, laws)


def moments(found, step):
    """The mean and variance of a scalar state at a step by smoothed weights, by run."""
    drawn, weights = found.points[step][..., 0], found.weights[step]
    mean = (weights * drawn).sum(axis=1)
    return mean, (weights * drawn**2).sum(axis=1) - mean**2


def ambiguous(steps, seed):
    """The measurements of three runs of the growth model."""
    asked = {
        growth.clock: 1.0 + np.arange(steps)[:, None],
        growth.reading: pgm.sightings(step=np.arange(1, steps + 1)),
    }
    return growth.network(3).sample(asked, runs=3, rng=seed).evidence


@pytest.mark.parametrize("shift", [0.0, 1.5])
def test_a_linear_chain_is_smoothed_exactly_but_for_chance(shift):
    """Also where the modes that draws are about are off by more than a deviation."""
    evidence = {z: np.random.default_rng(1).normal(0.0, 2.0, (12, 5, 1))}
    exact = pgm.smooth(walk, evidence)
    own = recombination(walk, evidence)
    off = own.laws._replace(first=own.laws.first + shift, mean=own.laws.mean + shift)
    rng = np.random.default_rng(2)
    own = Recombination(own.model, off)
    first = own.run(96, 200, None, rng)
    found = own.run(192, 2000, first, rng)
    for step in range(6):
        mean, var = moments(found, step)
        belief = exact[x.at(step)]
        error = (mean - belief.mean[:, 0]) / belief.std[:, 0]
        assert np.abs(error).max() < 0.35
        assert np.sqrt((error**2).mean()) < 0.12
        np.testing.assert_allclose(var.mean(), belief.cov[:, 0, 0].mean(), rtol=0.1)
        drawn = found.trajectories.values[step][..., -1]
        assert np.abs((drawn.mean(axis=1) - mean) / belief.std[:, 0]).max() < 0.12
    np.testing.assert_allclose(found.log_evidence, exact.log_evidence, atol=0.5)
    assert abs((found.log_evidence - exact.log_evidence).mean()) < 0.08
    # The steps of a trajectory depend on each other as they do under the posterior.
    pairs = found.trajectories.values[3]
    joint = exact.joint(x.at(2), x.at(3)).cov[:, 0, 1]
    cov = ((pairs - pairs.mean(axis=1, keepdims=True)).prod(axis=2)).mean(axis=1)
    np.testing.assert_allclose(cov.mean(), joint.mean(), rtol=0.1)


def test_a_heading_that_is_told_but_for_whole_turns_may_pass_a_turn():
    """A heading that turns on, by a motion that wraps, and is read: linear but for turns."""
    heading = pgm.Variable("h", components=("h",), angles=("h",))
    read = pgm.Variable("c", components=("c",), angles=("c",))

    def onward(h):
        return (h + 1.0 + np.pi) % (2 * np.pi) - np.pi

    def chain(motion):
        return pgm.DynamicBayesianNetwork(
            prior=[pgm.GaussianCPD(heading, [3.0], 0.04)],
            transition=[motion],
            observation=[pgm.LinearGaussianCPD(read, {heading: [[1.0]]}, cov=0.04)],
        )

    wrapped = chain(pgm.NonlinearGaussianCPD(heading, (heading.previous,), onward, cov=0.01))
    steps = np.arange(1.0, 13.0)[:, None]
    noise = np.random.default_rng(0).normal(0.0, 0.2, (12, 1))
    evidence = {read: (3.0 + steps + noise + np.pi) % (2 * np.pi) - np.pi}
    exact = pgm.smooth(wrapped, evidence)
    found = recombination(wrapped, evidence).run(256, 1000, None, np.random.default_rng(0))
    for step in (0, 1, 6, 12):
        drawn = found.trajectories.values[step][0, :, -1]
        off = (drawn - exact[heading.at(step)].mean[0] + np.pi) % (2 * np.pi) - np.pi
        std = exact[heading.at(step)].std[0]
        assert abs(off.mean()) < 0.35 * std
        np.testing.assert_allclose(off.std(), std, rtol=0.2)
    np.testing.assert_allclose(found.log_evidence, exact.log_evidence, atol=0.3)


def test_a_chain_ambiguous_at_many_steps_is_smoothed_as_by_a_grid():
    model, evidence = growth.network(3), ambiguous(15, 11)
    exact = pgm.smooth(model, evidence, belief=pgm.Grid({"x": (-30, 30, 3000)}))
    found = pgm.estimate(model, evidence, effort=1000)
    assert found.verdict.recombined.any()
    belief = exact[growth.state]
    off = pgm.Gaussian(growth.state, belief.mean, belief.cov).kl(
        pgm.Gaussian(growth.state, found[growth.state].mean, found[growth.state].cov)
    )
    worst = off.max(axis=1)[found.verdict.recombined]
    assert worst.max() < 0.3
    assert (worst <= 2 * found.verdict.within[found.verdict.recombined]).all()
    np.testing.assert_allclose(found.log_evidence, exact.log_evidence, atol=0.5)
    assert "recombined from draws of each step" in repr(found.verdict)


def test_moments_that_are_vouched_for_wrongly_are_refuted(monkeypatch):
    """Draws of the modes are made to vouch for a quarter of the deviations."""
    weigh = climbing.weigh

    def flattering(*asked):
        answer = weigh(*asked)
        laws = answer.laws._replace(cov=answer.laws.cov / 16.0)
        within, of = np.full(answer.within.shape, 0.01), np.full(answer.of.shape, 2)
        return replace(answer, laws=laws, within=within, of=of, sound=of > 0, usable=of > 0)

    model, evidence = growth.network(3), ambiguous(6, 3)
    exact = pgm.smooth(model, evidence, belief=pgm.Grid({"x": (-30, 30, 3000)}))
    monkeypatch.setattr(climbing, "weigh", flattering)
    found = pgm.estimate(model, evidence, effort=1000)
    assert found.verdict.recombined.all()
    off = np.abs(found[growth.state].mean - exact[growth.state].mean) / exact[growth.state].std
    assert off.max() < 0.3
    np.testing.assert_allclose(found[growth.state].std, exact[growth.state].std, rtol=0.25)


def test_chains_with_components_without_noise_or_with_many_are_not_recombined():
    def target(size, cov):
        x, seen = (pgm.Variable(name, tuple("abcdefg"[:size])) for name in ("x", "s"))
        model = pgm.DynamicBayesianNetwork(
            prior=[pgm.GaussianCPD(x, np.zeros(size), np.eye(size))],
            transition=[pgm.LinearGaussianCPD(x, {x.previous: np.eye(size)}, cov=cov)],
            observation=[pgm.LinearGaussianCPD(seen, {x: np.eye(size)}, cov=np.eye(size))],
        )
        search = _over_time(model, {seen: np.zeros((2, size))}, None).search()
        laws = seek(search).laws
        return search.target(laws), laws

    rng = np.random.default_rng(0)
    assert recombined(*target(2, np.eye(2)), rng) is not None
    assert recombined(*target(2, np.diag([1.0, 0.0])), rng) is None
    assert recombined(*target(7, np.eye(7)), rng) is None


def test_a_hidden_control_of_each_step_is_recombined_with_the_states():
    x, u, seen = pgm.Variable("x", components=("a", "b")), pgm.Variable("u"), pgm.Variable("s")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 1.0], np.eye(2))],
        transition=[
            pgm.GaussianCPD(u, 1.0, 0.5),
            pgm.LinearGaussianCPD(
                x,
                {x.previous: [[1.0, 0.3], [0.0, 0.9]], u: [[0.5], [1.0]]},
                cov=np.diag([0.2, 0.3]),
            ),
        ],
        observation=[pgm.LinearGaussianCPD(seen, {x: [[1.0, 0.0]]}, cov=0.5)],
    )
    evidence = {seen: np.array([[0.4], [1.6], [2.0]])}
    exact = pgm.smooth(model, evidence)
    found = recombination(model, evidence).run(384, 2000, None, np.random.default_rng(0))
    np.testing.assert_allclose(found.log_evidence, exact.log_evidence, atol=0.1)
    for step in (1, 2, 3):
        drawn = found.trajectories.values[step][0, :, 2:]
        for variable, place in ((u, slice(0, 1)), (x, slice(1, 3))):
            belief = exact[variable.at(step)]
            off = (drawn[:, place].mean(axis=0) - belief.mean) / belief.std
            assert np.abs(off).max() < 0.25
            np.testing.assert_allclose(drawn[:, place].std(axis=0), belief.std, rtol=0.15)
