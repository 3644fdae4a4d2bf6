"""Audits of chains that lose a mode on the way: against a smoother on a fine grid."""

import numpy as np
import pytest

import pgm
from pgm.beliefs.moments.trajectories import model as trajectories
from pgm.inference.audit.chain import ChainDraws

a, z, glance = pgm.variables("a z glance")
GRID = np.linspace(-12.0, 12.0, 1601)
SPACING = GRID[1] - GRID[0]
STEPS, AT = 12, 6


def normal(value, mean, variance):
    return np.exp(-0.5 * (value - mean) ** 2 / variance) / np.sqrt(2 * np.pi * variance)


def square(x):
    return x**2 / 4


def model(mean):
    """A walk that is seen by its square once, and next to nothing else."""
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, mean, 1.0)],
        transition=[pgm.LinearGaussianCPD(a, {a.previous: 0.95}, cov=0.2)],
        observation=[
            pgm.NonlinearGaussianCPD(z, a, square, 0.04),
            pgm.LinearGaussianCPD(glance, {a: 1.0}, cov=4.0),
        ],
    )


def on_grid(mean, seen, glances):
    """Log-evidence, and smoothed means and variances, (T+1,), forward and back on the grid."""
    move = normal(GRID[:, None], 0.95 * GRID, 0.2) * SPACING
    likelihood = np.ones((STEPS + 1, GRID.size))
    likelihood[AT] *= normal(seen, square(GRID), 0.04)
    for step, value in glances.items():
        likelihood[step] *= normal(value, GRID, 4.0)
    forward = [normal(GRID, mean, 1.0) * likelihood[0]]
    for step in range(1, STEPS + 1):
        forward.append(move @ forward[-1] * likelihood[step])
    back = [np.ones(GRID.size)]
    for step in range(STEPS, 0, -1):
        back.append(move.T @ (back[-1] * likelihood[step]))
    joint = np.array(forward) * np.array(back[::-1])
    share = joint / joint.sum(axis=1, keepdims=True)
    means = share @ GRID
    return np.log(joint[-1].sum() * SPACING), means, share @ GRID**2 - means**2


def smoothed(mean, glances, runs=60):
    evidence = {
        z: pgm.sightings(np.full((runs, 1, 1), 1.0), step=[AT]),
        glance: pgm.sightings([[value] for value in glances.values()], step=list(glances)),
    }
    return pgm.smooth(model(mean), evidence, steps=STEPS, iterations=20)


@pytest.mark.parametrize("lost", [True, False])
def test_a_mode_lost_on_the_way(lost):
    """The square is that of 2 or −2; sign and size are open at first, or known."""
    mean, glances = (0.6, {3: 0.5, 9: 0.4}) if lost else (5.0, {3: 3.0, 9: 3.0})
    posterior = smoothed(mean, glances)
    assert (posterior[a].mean[:, AT, 0] > 1.0).all()
    found = pgm.audit(posterior, rng=3)
    evidence, means, variances = on_grid(mean, 1.0, glances)
    off = np.abs(found.log_evidence - evidence)
    assert (off < 3 * found.standard_error).mean() > 0.9
    assert found.suspect.mean() == pytest.approx(float(lost), abs=0.05)
    exact = found.corrected[a]
    np.testing.assert_allclose(exact.mean[..., 0].mean(0), means, atol=0.12)
    if lost:
        q = posterior[a].run(0)
        shift = (means - q.mean[:, 0]) ** 2 / q.cov[:, 0, 0]
        ratio = variances / q.cov[:, 0, 0]
        due = 0.5 * (ratio - 1.0 - np.log(ratio) + shift)
        told = np.median(found.moment_divergence[a], axis=0)
        np.testing.assert_allclose(told, due, rtol=0.35, atol=0.05)
        assert told.argmax() == AT
        assert "SUSPECT" in repr(found)
        assert f"a[{AT}]" in repr(found)


def test_beliefs_that_know_all_measurements_are_judged():
    evidence = {glance: np.ones((STEPS, 1))}
    runs = {
        1: pgm.filter(model(0.0), evidence),
        4: pgm.smooth(model(0.0), evidence, lag=3),
        STEPS + 1: pgm.smooth(model(0.0), evidence),
    }
    for count, posterior in runs.items():
        judged = ChainDraws.make(posterior._outcome).judged
        assert judged.tolist() == [False] * (STEPS + 1 - count) + [True] * count


def test_linear_chains_have_the_gaussians_moments():
    found = pgm.audit(pgm.smooth(model(0.0), {glance: np.ones((300, 1))}), rng=0)
    assert found.moment_divergence[a].max() < 1e-9
    assert not found.suspect
    assert found.trusted
    assert found.inclusive_divergence < 1e-9
    assert found.effective_draws > 500


def test_headings_a_turn_apart_are_the_same():
    """The prior is of many turns, and a bearing says which way; no copy of it is another mode."""
    heading = pgm.Variable("heading", angles=("heading",))
    compass = pgm.Variable("compass", angles=("compass",))
    net = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(heading, 0.5, 20.0)],
        transition=[pgm.LinearGaussianCPD(heading, {heading.previous: 1.0}, cov=0.01)],
        observation=[pgm.NonlinearGaussianCPD(compass, heading, lambda x: x + 0.0, 0.04)],
    )
    found = pgm.audit(pgm.smooth(net, {compass: np.array([[0.6], [0.7], [0.65]])}), rng=0)
    # The density on the unwrapped chart has several turns, each as the prior weighs it.
    turns = 2 * np.pi * np.arange(-4, 5)
    due = np.log(normal(0.65, 0.5 + turns, 20.02).sum() / normal(0.65, 0.5, 20.02))
    assert due > 0.5
    assert abs(found.correction - due) < 4 * found.standard_error < 1.0
    assert not found.suspect
    assert found.moment_divergence[heading].max() < 0.1


def test_hidden_controls_have_moments_from_step_one():
    u = pgm.Variable("u")
    driven = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 1.0)],
        transition=[
            pgm.GaussianCPD(u, 0.5, 0.1),
            pgm.NonlinearGaussianCPD(a, (a.previous, u), lambda x, u: x + np.sin(u), 0.05),
        ],
        observation=[pgm.LinearGaussianCPD(glance, {a: 1.0}, cov=0.5)],
    )
    posterior = pgm.smooth(driven, {glance: np.ones((5, 1))})
    found = pgm.audit(posterior, rng=0)
    assert found.corrected[u].steps.tolist() == [1, 2, 3, 4, 5]
    assert found.moment_divergence[u].shape == (5,)
    np.testing.assert_allclose(found.corrected[u].mean, posterior[u].mean, atol=0.05)
    assert not found.suspect


@pytest.mark.parametrize("defensive", [False, True])
def test_steps_are_weighed_together_as_one_by_one(monkeypatch, defensive):
    posterior = smoothed(0.0, {3: 0.5, 9: 0.3}, runs=2)
    draws = ChainDraws.make(posterior._outcome)

    def made():
        return draws.draw(50, np.random.default_rng(3), defensive=defensive)

    together = made()
    monkeypatch.setattr(trajectories, "BLOCK", 1)
    alone = made()
    for name in ("target", "gaussian", "defensive"):
        np.testing.assert_allclose(getattr(together, name), getattr(alone, name), rtol=1e-10)
    np.testing.assert_array_equal(together.values, alone.values)
