"""The arrays of a status have the axes of runs, whatever family or schedule it is of."""

import numpy as np
import pytest

import pgm
from pgm.examples import b, pair, rain, rainy, squares, still, walk, wet, x, z
from tests.beliefs.own.ensemble import EnsembleKalman

CELLS = {"x": (-9.0, 12.0, 60)}
LEADS = [(), (2,), (1,), (2, 3)]


def steps(lead):
    """Measurements of three steps."""
    return {z: np.full((*lead, 3, 1), 2.0) + np.arange(3)[:, None]}


def filtered(family):
    """A filter's posterior, by the axes of runs."""
    return lambda lead: pgm.filter(walk, steps(lead), belief=family)


POSTERIORS = {
    "moments": lambda lead: pgm.filter(walk, steps(lead)),
    "relinearised": lambda lead: pgm.smooth(squares, steps(lead), iterations=30),
    "once": lambda lead: pgm.filter(squares, steps(lead)),
    "balanced": lambda lead: pgm.smooth(walk, steps(lead), method=pgm.Balanced()),
    "kept": lambda lead: pgm.filter(walk, steps(lead), keep=x),
    "tables over time": lambda lead: pgm.filter(still, {wet: np.ones((*lead, 3), dtype=int)}),
    "grid": filtered(pgm.Grid(CELLS)),
    "refined": filtered(pgm.Grid(CELLS, refine="log_evidence", tolerance=1.0)),
    "smoothed": lambda lead: pgm.smooth(walk, steps(lead), belief=pgm.Grid(CELLS)),
    "particles": filtered(pgm.Particles(200, seed=0)),
    "own": filtered(EnsembleKalman(40)),
    "tree": lambda lead: pgm.infer(pgm.compile(pair), {b: np.ones((*lead, 1))}),
    "tables": lambda lead: pgm.infer(pgm.compile(rainy), {wet: np.ones(lead, dtype=int)}),
    "loops": lambda lead: pgm.infer(
        pgm.compile(pair, method=pgm.Bethe()), {b: np.ones((*lead, 1))}, schedule=pgm.Flooding()
    ),
    "loops of tables": lambda lead: pgm.infer(
        pgm.compile(rainy, method=pgm.Bethe()),
        {wet: np.ones(lead, dtype=int)},
        schedule=pgm.Flooding(),
    ),
}


def assert_of_runs(status, lead):
    assert status.converged.shape == lead
    assert status.converged.dtype == bool
    assert status.residuals.shape[1:] == lead
    assert status.digits is None or status.digits.shape == lead
    assert not status.converged.flags.writeable


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize("name", POSTERIORS)
def test_of_each_family(name, lead):
    assert_of_runs(POSTERIORS[name](lead).status, lead)


@pytest.mark.parametrize("lead", LEADS)
@pytest.mark.parametrize(
    "family", [None, pgm.Grid(CELLS), pgm.Particles(200, seed=0), EnsembleKalman(40)]
)
def test_online(family, lead):
    robot = pgm.OnlineFilter(walk, belief=family)
    belief = robot.update(robot.initial(), {z: np.full((*lead, 1), 2.0)})
    assert_of_runs(belief.status, lead)
    assert_of_runs(robot.predict(belief).status, lead)


@pytest.mark.parametrize("lead", LEADS)
def test_tables_online(lead):
    robot = pgm.OnlineFilter(still)
    belief = robot.update(robot.predict(robot.initial()), {wet: np.ones(lead, dtype=int)})
    assert_of_runs(belief.status, lead)
    assert belief[rain].values.shape == (*lead, 2)


def test_what_has_not_settled_has_not_in_each_run():
    """Cells are halved until the figure of all runs has settled."""
    with pytest.warns(pgm.GridWarning, match="still changes"):
        found = pgm.filter(
            walk,
            steps((2,)),
            belief=pgm.Grid(CELLS, refine="log_evidence", tolerance=0.0, doublings=1),
        )
    assert found.status.converged.tolist() == [False, False]
