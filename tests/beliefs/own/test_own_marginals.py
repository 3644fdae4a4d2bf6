"""Marginals in a form of a family's own: shown where they have moments, left out where not."""

import re
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.examples import walk, x, z
from tests.beliefs.own.ensemble import EnsembleKalman
from tests.beliefs.own.kalman import Kalman
from tests.beliefs.own.robot import ROBOT, driven

ONE = {z: [[4.0], [3.0], [np.nan], [5.0]]}
RUNS = {z: np.random.default_rng(0).normal(size=(2, 3, 4, 1))}


@dataclass(frozen=True)
class Table:
    """A user's form, which knows its moments and cannot be indexed."""

    mean: np.ndarray
    cov: np.ndarray
    steps: object


class Tabled(Kalman):
    def marginal(self, beliefs, asked):
        mean = np.stack([mean[:, asked.columns] for mean, _ in beliefs], axis=1)
        cov = np.stack([cov for _, cov in beliefs], axis=1)
        steps = () if asked.steps is None else asked.steps.shape
        shape = *asked.lead, *steps, 1
        return Table(mean.reshape(shape), cov.reshape(*shape, 1), asked.steps)


class Listed(Kalman):
    """Whose form has no moments."""

    def marginal(self, beliefs, asked):
        return [belief[0] for belief in beliefs]


def rows(shown):
    """The lines of a summary that tell of steps or variables."""
    return [line for line in repr(shown).splitlines() if "±" in line]


@pytest.mark.parametrize("evidence", [ONE, RUNS], ids=["one", "runs"])
@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
def test_one_with_moments_is_shown_as_a_gaussian_is(evidence, call, tmp_path):
    found, due = (call(walk, evidence, belief=each) for each in (Tabled(), Kalman()))
    assert type(found[x]) is type(found[x.at(2)]) is Table
    assert_allclose(found[x].mean, due[x].mean, rtol=1e-12)
    assert_allclose(found[x.at(2)].cov, due[x.at(2)].cov, rtol=1e-12)
    assert found[x.at(2)].steps is None
    assert found[x].steps.tolist() == [0, 1, 2, 3, 4]
    assert rows(found) == rows(due) != []
    assert rows(found.predicted) == rows(due.predicted) != []
    assert found.to_xarray().equals(due.to_xarray())
    assert "iframe" in found._repr_html_()
    pages = [pgm.view(each, tmp_path / f"{k}.html") for k, each in enumerate((found, due))]
    # They differ by the names, and by what readings moved, which is told of Gaussians.
    moved = r'"moved":\{.*?\},"sensors"|id="numbers">.*?<'
    sizes = [len(re.sub(moved, "", page.read_text())) for page in pages]
    assert abs(sizes[0] - sizes[1]) < 10


@pytest.mark.parametrize("evidence", [ONE, RUNS], ids=["one", "runs"])
def test_one_without_is_left_out_or_refused_in_words(evidence, tmp_path):
    words = r"Listed\(\) shows x(\[0\])? as a list, which has no .mean and .cov"
    found = pgm.smooth(walk, evidence, belief=Listed())
    assert type(found[x]) is list
    with pytest.raises(pgm.EvidenceError, match=words):
        found.to_xarray()
    for shown in (found, found.predicted):
        assert "x: none: Listed() shows x[0] as a list, which has no .mean and .cov" in repr(shown)
    assert "iframe" in found._repr_html_()
    assert pgm.view(found, tmp_path / "page.html").exists()
    with pytest.raises(pgm.EvidenceError, match=words):
        pgm.compare(walk, ONE, oracle=Listed())


def test_they_are_compared():
    truth = {x: np.zeros((5, 1))}
    methods = {"tabled": Tabled(), "listed": Listed(), "Taylor": pgm.Taylor()}
    found = pgm.compare(walk, ONE, linearisers=methods, truth=truth, oracle=Tabled())
    for schedule in ("filter", "smoother"):
        assert_allclose(found["tabled", schedule].nees, found["Taylor", schedule].nees, rtol=1e-9)
        assert_allclose(found["tabled", schedule].kl, 0.0, atol=1e-9)
        assert "Listed() shows x as a list" in found["listed", schedule].error


@pytest.mark.parametrize("family", [Tabled(), Listed()])
def test_online_too(family):
    robot = pgm.OnlineFilter(walk, belief=family)
    belief = robot.update(robot.initial(), {z: [[3.0], [1.5]]})
    assert belief.lead == (2,)
    assert type(belief[x]) is (Table if isinstance(family, Tabled) else list)
    told = "1.000 ± 0.816" if isinstance(family, Tabled) else "none: Listed() shows x as a list"
    assert told in repr(belief)


@pytest.mark.parametrize("axes", [(2,), (5, 2), (5,)])
def test_moments_of_another_shape_are_refused(axes):
    class Odd(Kalman):
        def marginal(self, beliefs, asked):
            return Table(np.zeros(axes), np.zeros((*axes, axes[-1])), None)

    found = pgm.filter(walk, ONE, belief=Odd())
    with pytest.raises(pgm.ModelError, match=r"\(5, 1\) and \(5, 1, 1\) were due: runs, steps"):
        found.to_xarray()
    assert "x: none: Odd(): the marginal of x[0] has a mean of shape" in repr(found)


class Crowd(EnsembleKalman):
    """Whose marginals are means and covariances of its members."""

    def marginal(self, beliefs, asked):
        each = np.stack([belief[..., asked.columns] for belief in beliefs], axis=1)
        off = each - each.mean(axis=2, keepdims=True)
        cov = off.swapaxes(-1, -2) @ off / off.shape[2]
        shape = each.mean(axis=2).reshape(*asked.axes, -1).shape
        return Table(each.mean(axis=2).reshape(shape), cov.reshape(*shape, shape[-1]), None)


def test_they_are_animated(tmp_path):
    evidence = driven().evidence
    found = pgm.smooth(ROBOT, evidence, belief=Crowd(60))
    assert pgm.plot.animate(found, tmp_path / "crowd.gif").exists()

    class Mute(Crowd):
        def marginal(self, beliefs, asked):
            return list(beliefs)

    found = pgm.filter(ROBOT, evidence, belief=Mute(60))
    with pytest.raises(pgm.EvidenceError, match=r"shows s as a list, which has no .mean and .cov"):
        pgm.plot.animate(found, tmp_path / "mute.gif")


X, U, Z = pgm.variables("x u z")
CONTROLLED = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(X, 0.0, 1.0)],
    [pgm.GaussianCPD(U, 1.0, 0.25), pgm.LinearGaussianCPD(X, {X.previous: 1.0, U: 1.0}, cov=0.1)],
    [pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.5)],
)


@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
@pytest.mark.parametrize("belief", [EnsembleKalman(20), pgm.Particles(20, seed=0)], ids=repr)
def test_a_hidden_control_of_no_steps_has_none(call, belief, tmp_path):
    found, due = (call(CONTROLLED, {}, steps=0, belief=each) for each in (belief, None))
    assert found[U].mean.shape == (0, 1)
    assert "0 steps" in repr(found[U])
    assert found[U].cov.shape == (0, 1, 1)
    assert found.to_xarray()["mean"].shape == due.to_xarray()["mean"].shape
    assert "[x, u]" in repr(found)
    assert pgm.view(found, tmp_path / "page.html").exists()


def test_online_a_hidden_control_begins_at_step_1():
    belief = pgm.OnlineFilter(CONTROLLED, belief=EnsembleKalman(20)).initial()
    with pytest.raises(pgm.EvidenceError, match=r"the belief at step 0 is over \[x\], not u"):
        belief[U]


def test_a_network_of_tables_that_a_family_lets_pass_is_shown_without_marginals():
    door, seen = (pgm.Discrete(name, states=("a", "b")) for name in ("door", "seen"))
    table = [[0.9, 0.1], [0.2, 0.8]]
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(door, table=[0.5, 0.5])],
        [pgm.TableCPD(door, door.previous, table=table)],
        [pgm.TableCPD(seen, door, table=table)],
    )

    class Passing(Kalman):
        def require(self, model):
            pass

        def take(self, at, belief):
            return belief, 0.0

    found = pgm.filter(model, {seen: [0, 1]}, belief=Passing())
    assert "door: none: Passing() shows door[0] as a Gaussian, which has no .prob" in repr(found)
