"""A cluster's belief is its potential times the messages to it, whatever the graph and its kind."""

import numpy as np
import pytest
from viewer import posteriors

import pgm
from pgm.beliefs.moments.passes import messages


def product(posterior, cluster):
    found = posterior.potential(cluster)
    for other in posterior.graph.neighbours(cluster):
        found = found * posterior.message(other, cluster)
    return found.rearrange(posterior.belief(cluster).scope)


MADE = {
    "chain": posteriors.smoothed,
    "batch": posteriors.batch,
    "long chain": lambda: pgm.smooth(posteriors.robot(), posteriors.drive(100)),
    "balanced tree": posteriors.balanced,
    "tables": posteriors.tree,
    "chain of tables": posteriors.days,
    "chain of several tables": posteriors.factorial,
    "hidden control": posteriors.driven,
    "loops": posteriors.lattice,
    "Bethe graph": lambda: posteriors.lattice(3, pgm.Bethe()),
}


@pytest.mark.parametrize("made", MADE.values(), ids=MADE)
def test_a_belief_is_its_potential_times_the_messages(made):
    posterior = made()
    for cluster in range(0, len(posterior.graph), 3):
        found, due = product(posterior, cluster), posterior.belief(cluster)
        if isinstance(due, pgm.CanonicalForm):
            for name in ("K", "h"):
                size = np.abs(getattr(due, name)).max()
                np.testing.assert_allclose(
                    getattr(found, name), getattr(due, name), atol=1e-9 * size
                )
            if posterior.graph.is_tree:  # with loops the scale of messages has no meaning
                np.testing.assert_allclose(found.g, due.g, rtol=1e-8, atol=1e-8)
        else:
            np.testing.assert_allclose(
                found.values * np.exp(found.log_scale),
                due.values * np.exp(due.log_scale),
                rtol=1e-9,
            )


def test_a_filter_knows_the_messages_of_the_past():
    posterior = posteriors.filtered()
    found = posterior.potential(7) * posterior.message(6, 7)
    due = posterior.belief(7)
    np.testing.assert_allclose(found.rearrange(due.scope).K, due.K, atol=1e-10)


def test_potentials_of_singular_noise_are_refused():
    with pytest.raises(pgm.NumericalError, match="the potential of cluster 2, over"):
        posteriors.still().potential(2)
    with pytest.raises(pgm.GraphError, match="there is no cluster 9"):
        posteriors.still().potential(9)
    kept = pgm.smooth(posteriors.robot(), posteriors.drive(), keep=[posteriors.x])
    with pytest.raises(pgm.GraphError, match="not kept"):
        kept.potential(1)


@pytest.mark.parametrize("runs", [(), (3,)])
def test_messages_back_by_a_scan_are_those_step_by_step(runs):
    posterior = pgm.smooth(posteriors.robot(), posteriors.drive(120, runs))
    plan, forward = posterior._outcome._plan, posterior._outcome._forward
    last = np.zeros((plan.runs, 3, 3)), np.zeros((plan.runs, 3)), np.zeros(plan.runs)
    stepwise = messages._stepwise(plan, forward, last)
    scanned = messages._scanned(plan, forward, last)
    for found, due in zip(scanned, stepwise, strict=True):
        np.testing.assert_allclose(found, due, rtol=1e-9, atol=1e-12 * np.abs(due).max())


@pytest.mark.parametrize("made", [posteriors.days, posteriors.factorial])
def test_messages_back_of_tables_in_one_pass_are_those_asked_for_singly(made):
    posterior = made()
    steps = range(posterior.graph.steps, -1, -1)
    for step, (values, scale) in zip(steps, posterior.messages_back(), strict=True):
        if step < posterior.graph.steps:
            message = posterior.message(step + 1, step)
            np.testing.assert_allclose(
                values * np.exp(scale), message.values * np.exp(message.log_scale)
            )
        else:
            np.testing.assert_allclose(values * np.exp(scale), np.ones(values.shape))


@pytest.mark.parametrize("schedule", [pgm.Flooding(), pgm.Sequential(), pgm.Residual()])
def test_the_largest_change_along_an_edge_is_the_residual(schedule):
    status = posteriors.lattice(3, schedule=schedule).status
    assert status.edge_residuals.shape == (status.iterations, len(status.by_edge))
    np.testing.assert_array_equal(status.edge_residuals.max(axis=1), status.residuals)
    assert not status.edge_residuals.flags.writeable


def test_changes_along_edges_are_kept_as_long_as_they_take_little_room(monkeypatch):
    monkeypatch.setattr("pgm.schedules.loopy._KEPT", 20)
    assert posteriors.lattice(3).status.edge_residuals is None
