"""Particles that are put where the measurements are: at the start, and after a kidnapping."""

import numpy as np
import pytest
from clouds import cart, x, z
from scipy.stats import norm

import pgm

place = pgm.Variable("place", components=("east", "north"))
speed = pgm.Variable("speed")
fix = pgm.Variable("fix", components=("east", "north"))
SIDE = 40.0
MIDDLES = np.arange(0.5, SIDE, 1.0)
CENTRES = np.stack(np.meshgrid(MIDDLES, MIDDLES), axis=-1).reshape(-1, 2)
CELLS = pgm.CellProposal(place, CENTRES, widths=[1.0, 1.0])


def square():
    """A robot that may be anywhere in a square, and knows where it is to half a metre."""
    inside = pgm.SampledCPD(
        place,
        sample=lambda size, rng: rng.uniform(0.0, SIDE, (*size, 2)),
        log_density=lambda y: np.where(
            ((y >= 0.0) & (y <= SIDE)).all(axis=-1), -2.0 * np.log(SIDE), -np.inf
        ),
    )
    return pgm.DynamicBayesianNetwork(
        prior=[inside, pgm.GaussianCPD(speed, mean=1.0, cov=0.01)],
        transition=[
            pgm.LinearGaussianCPD(speed, given={speed.previous: [[1.0]]}, cov=1e-4),
            pgm.LinearGaussianCPD(
                place,
                given={place.previous: np.eye(2), speed: [[0.0], [0.1]]},
                cov=0.04 * np.eye(2),
            ),
        ],
        observation=[pgm.LinearGaussianCPD(fix, given={place: np.eye(2)}, cov=0.25 * np.eye(2))],
    )


def filtered(values, model=None, **named):
    """The filter of fixes from step 0 on."""
    steps = np.shape(values)[-2] - 1
    given = {fix: pgm.sightings(np.array(values), step=np.arange(steps + 1))}
    return pgm.filter(model or square(), given, steps=steps, **named)


def test_a_start_from_cells_is_weighed_for_its_prior():
    """Exact: the prior is flat where the first fix is, and the rest is linear."""
    values = [[10.3, 20.1], [10.4, 20.4], [10.2, 20.3]]
    flat = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, mean=[10.3, 20.1], cov=1e8 * np.eye(2)), square().prior[1]],
        square().transition,
        square().observation,
    )
    exact = filtered(values, flat)
    found = filtered(values, belief=pgm.Particles(20_000, start=CELLS))
    np.testing.assert_allclose(found[place].mean, exact[place].mean, atol=0.02)
    np.testing.assert_allclose(found[place].std, exact[place].std, rtol=0.03)
    np.testing.assert_allclose(found[speed].mean, exact[speed].mean, atol=0.01)
    # The flat prior has the density 1 / (2 π 1e8) there, the square 1 / 1600.
    apart = np.log(2.0 * np.pi * 1e8) - 2.0 * np.log(SIDE)
    np.testing.assert_allclose(found.log_evidence, exact.log_evidence + apart, atol=0.05)
    assert found.status.effective[0] > 5000


@pytest.mark.parametrize("temper", [0.0, 0.3])
def test_tempered_cells_have_the_same_answer(temper):
    cells = pgm.CellProposal(place, CENTRES, widths=[1.0, 1.0], temper=temper)
    values = [[10.3, 20.1], [10.4, 20.4]]
    sharp = filtered(values, belief=pgm.Particles(20_000, start=CELLS))
    found = filtered(values, belief=pgm.Particles(100_000, start=cells))
    np.testing.assert_allclose(found[place].mean, sharp[place].mean, atol=0.08)
    np.testing.assert_allclose(found.log_evidence, sharp.log_evidence, atol=0.2)
    assert found.status.effective[0] < sharp.status.effective[0] * 5


def test_runs_start_from_their_own_measurements():
    values = np.array([[[10.3, 20.1], [10.4, 20.4]], [[30.3, 5.1], [30.4, 5.2]]])
    both = filtered(values, belief=pgm.Particles(500, start=CELLS))
    np.testing.assert_allclose(both[place].mean, values, atol=0.4)
    alone = filtered(values[0], belief=pgm.Particles(500, start=CELLS))
    np.testing.assert_allclose(both[place][0].states, alone[place].states, atol=1e-12)


def kidnapped(steps=40, at=20):
    values = np.tile([10.0, 10.0], (steps, 1))
    values[:, 1] += 0.1 * np.arange(steps)
    values[at:] = np.array([30.0, 25.0]) + values[at:] - values[at]
    return values + 0.5 * np.random.default_rng(2).standard_normal(values.shape)


def carried(injection, n=300, **named):
    belief = pgm.Particles(n, start=CELLS, injection=injection, impossible="ignore", **named)
    return filtered(kidnapped(), belief=belief)


@pytest.mark.filterwarnings("ignore::pgm.ParticleWarning")
@pytest.mark.parametrize("temper", [1.0, 0.0])
def test_a_kidnapped_robot_is_found_again(temper):
    cells = pgm.CellProposal(place, CENTRES, widths=[1.0, 1.0], temper=temper)
    injection = pgm.Injection(cells, slow=0.05, fast=0.5)
    found = carried(injection, n=2000)
    lost = carried(None, n=2000)
    error = np.linalg.norm(found[place].mean - kidnapped(), axis=-1)
    assert (error[:20] < 2.0).all()
    assert error[-1] < 1.5
    assert np.linalg.norm(lost[place][-1].mean - kidnapped()[-1]) > 5.0
    assert found.status.injected[20:].sum() > 0
    assert lost.status.injected.sum() == 0
    np.testing.assert_allclose(found[place].weights.sum(axis=-1), 1.0)
    # The other state is that of particles drawn anew, not zero.
    assert abs(found[speed][-1].mean[0] - 1.0) < 0.2


def test_averages_are_those_of_the_formula():
    """A twin in plain numbers; runs without measurements keep their averages."""
    injection = pgm.Injection(CELLS, slow=0.1, fast=0.5)
    log_density = np.array([[-4.0, -6.0], [-8.0, -2.0], [-12.0, 0.0]])
    measured = np.array([[2, 2], [4, 0], [4, 2]])
    averages = None
    for density, count in zip(log_density, measured, strict=True):
        averages = injection.averaged(averages, density, count)
    first = [np.exp(-2.0), np.exp(-2.0), np.exp(-3.0)]
    slow = fast = first[0]
    for level in first[1:]:
        slow, fast = slow + 0.1 * (level - slow), fast + 0.5 * (level - fast)
    np.testing.assert_allclose(np.exp(averages[:, 0]), [slow, fast])
    start = np.exp(-3.0)
    later = [start + share * (1.0 - start) for share in (0.1, 0.5)]
    np.testing.assert_allclose(np.exp(averages[:, 1]), later)
    np.testing.assert_allclose(injection.shares(averages), [1.0 - fast / slow, 0.0])


@pytest.mark.filterwarnings("ignore::pgm.ParticleWarning")
def test_online_is_offline():
    values, injection = kidnapped(24), pgm.Injection(CELLS, slow=0.05, fast=0.5)
    belief = pgm.Particles(300, start=CELLS, injection=injection, impossible="ignore")
    offline = filtered(values, belief=belief)
    online = pgm.OnlineFilter(square(), belief=belief)
    now = online.update(online.initial(), {fix: values[0]})
    np.testing.assert_array_equal(now[place].states, offline[place][0].states)
    for step in range(1, 24):
        now = online.update(online.predict(now), {fix: values[step]})
        np.testing.assert_array_equal(now[place].states, offline[place][step].states)
    assert offline.status.injected.sum() > 0


def test_the_likelihood_chooses_the_number():
    """A fix that particles explain takes few of them, one that they do not takes many."""
    number = pgm.LikelihoodSampling(40.0, least=50, most=3000)
    belief = pgm.Particles(500, number=number)
    values = np.array([[1.0], [1.5], [8.0], [np.nan], [3.0]])
    found = pgm.filter(cart(), {z: values}, belief=belief)
    count = found.status.number
    assert count[0] == 500
    assert count[1] < count[3]
    assert count[3] == count[4]  # nothing is measured at step 4
    for step in (1, 2, 3):
        cloud = found[x][step]
        near = norm.pdf(values[step - 1] - cloud.states[:, 0]) / norm.pdf(0.0)
        half = near[: len(near) // 2].sum() if len(near) < 3000 else 0.0
        assert near.sum() >= 40.0 or len(near) == 3000
        assert half < 40.0 or len(near) == 50
    exact = pgm.filter(cart(), {z: values[:2]})
    large = pgm.LikelihoodSampling(20_000.0)
    near = pgm.filter(cart(), {z: values[:2]}, belief=pgm.Particles(50_000, number=large))
    np.testing.assert_allclose(near[x].mean, exact[x].mean, atol=0.02)
    np.testing.assert_allclose(near.log_evidence, exact.log_evidence, atol=0.03)


def test_the_number_online_and_in_batches():
    belief = pgm.Particles(200, number=pgm.LikelihoodSampling(30.0, least=50))
    values = np.array([[1.0], [1.5], [4.0]])
    offline = pgm.filter(cart(), {z: values}, belief=belief)
    online = pgm.OnlineFilter(cart(), belief=belief)
    now = online.initial()
    for step in range(1, 4):
        now = online.update(online.predict(now), {z: values[step - 1]})
        np.testing.assert_array_equal(now[x].states, offline[x][step].states)
    both = pgm.filter(cart(), {z: np.stack([values, values[::-1]])}, belief=belief)
    np.testing.assert_array_equal(both.status.number[0], offline.status.number)
    np.testing.assert_allclose(both[x][0, 3].states, offline[x][3].states, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pgm.CellProposal("place", CENTRES, [1, 1]), "is of a Variable"),
        (lambda: pgm.CellProposal(place, CENTRES[:, :1], [1, 1]), r"\(k, 2\), not of shape"),
        (lambda: pgm.CellProposal(place, CENTRES[:0], [1, 1]), "one or more rows"),
        (lambda: pgm.CellProposal(place, CENTRES * np.nan, [1, 1]), "NaN"),
        (lambda: pgm.CellProposal(place, CENTRES, [1, 0]), "positive number"),
        (lambda: pgm.CellProposal(place, CENTRES, [1, 1], temper=2), "from 0 to 1"),
        (lambda: pgm.CellProposal(place, CENTRES, [1.2, 1.2]), "cells .* overlap"),
        (lambda: pgm.Injection("cells"), "draws from a pgm.CellProposal"),
        (lambda: pgm.Injection(CELLS, slow=0.5, fast=0.1), "slow < fast"),
        (lambda: pgm.Injection(CELLS, most=0), "most is a share"),
        (lambda: pgm.LikelihoodSampling(0), "positive number"),
        (lambda: pgm.LikelihoodSampling(5, least=9, most=5), "least <= most"),
        (lambda: pgm.Particles(5, start="here"), "start is a pgm.CellProposal"),
        (lambda: pgm.Particles(5, injection=CELLS), "injection is a pgm.Injection"),
        (
            lambda: pgm.Particles(
                5, proposal=pgm.Taylor(), number=pgm.LikelihoodSampling(5, least=1)
            ),
            "give one of them",
        ),
    ],
)
def test_settings_that_are_none(make, message):
    with pytest.raises(pgm.ModelError, match=message):
        make()


def test_angles_go_round_the_circle():
    turn = pgm.Variable("turn", components=("heading",), angles=("heading",))
    eighths = np.arange(8)[:, None] * np.pi / 4
    pgm.CellProposal(turn, eighths, [np.pi / 4])
    with pytest.raises(pgm.ModelError, match="overlap"):
        pgm.CellProposal(turn, np.vstack([eighths, [[2 * np.pi]]]), [np.pi / 4])
    with pytest.raises(pgm.ModelError, match="more than a turn"):
        pgm.CellProposal(turn, [[0.0], [1.0]], [7.0])


def test_what_does_not_fit_the_network():
    other = pgm.CellProposal(x, [[0.0, 0.0]], [1.0, 1.0])
    with pytest.raises(pgm.ModelError, match="no state of the network"):
        filtered([[1.0, 1.0]], belief=pgm.Particles(9, start=other))
    with pytest.raises(pgm.ModelError, match="no state of the network"):
        pgm.OnlineFilter(square(), belief=pgm.Particles(9, injection=pgm.Injection(other)))
    with pytest.raises(pgm.EvidenceError, match="measurements at step 0"):
        pgm.filter(square(), {fix: np.ones((2, 2))}, belief=pgm.Particles(9, start=CELLS))
    belief = pgm.Particles(9, injection=pgm.Injection(CELLS))
    with pytest.raises(pgm.ModelError, match="have no past"):
        pgm.smooth(square(), {fix: np.ones((2, 2))}, belief=belief)
    loud = pgm.SampledCPD(z, given=x, log_density=lambda y, x: -np.abs(y)[..., 0])
    model = pgm.DynamicBayesianNetwork(cart().prior, cart().transition, [loud])
    belief = pgm.Particles(9, number=pgm.LikelihoodSampling(5, least=1))
    with pytest.raises(pgm.ModelError, match="how large its density can be"):
        pgm.filter(model, {z: np.ones((2, 1))}, belief=belief)


def test_a_first_fix_that_no_cell_explains():
    never = pgm.SampledCPD(
        fix, given=place, log_density=lambda y, x: np.full(y.shape[:-1], -np.inf)
    )
    model = pgm.DynamicBayesianNetwork(square().prior, square().transition, [never])
    with pytest.raises(pgm.EvidenceError, match="impossible at every centre"):
        filtered([[1.0, 1.0]], model, belief=pgm.Particles(9, start=CELLS))
