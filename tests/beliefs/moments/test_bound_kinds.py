"""Bound calls of every kind equal those that go the general way, in all that a posterior tells."""

import gc
import pickle
from importlib.util import find_spec

import numpy as np
import pytest

import pgm
from pgm.beliefs.moments.bound import numbers
from pgm.beliefs.moments.bound.bound import Bound
from pgm.beliefs.moments.bound.room import Room
from pgm.beliefs.moments.compiled import sweep
from pgm.kernels.arrays import address
from tests.beliefs.moments.test_bound_calls import OFTEN, STEPS, evidence, robot, u, w, x, z

pytestmark = [
    pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed"),
    pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning"),
]

GATED = {z: 0.9, w: 0.95}
HUBER, STUDENT = pgm.Huber(1.2), pgm.StudentT(4.0)
TAYLOR, UNSCENTED, CUBATURE = pgm.Taylor(), pgm.Unscented(), pgm.Cubature()
# By name the noise of both sensors, the schedule, the rule, the runs, and how much is missing.
KINDS = {
    "gated filter": (None, pgm.Filtering(3, gate=GATED), TAYLOR, None, 0.3),
    "gated smoother of runs": (None, pgm.Smoothing(gate=0.9), TAYLOR, 3, 0.3),
    "filter of packs": (HUBER, pgm.Filtering(3, damping=0.2, gate=GATED), TAYLOR, 9, 0.0),
    "lag of none": (None, pgm.FixedLag(0, 3), TAYLOR, None, 0.0),
    "robust smoother": (STUDENT, pgm.Smoothing(), TAYLOR, None, 0.0),
    "unscented filter of packs": (None, pgm.Filtering(), UNSCENTED, 9, 0.3),
    "unscented smoother": (HUBER, pgm.Smoothing(gate=GATED), UNSCENTED, None, 0.3),
    "iterated smoother": (None, pgm.Smoothing(3), TAYLOR, None, 0.0),
    "iterated smoother of packs": (None, pgm.Smoothing(4, damping=0.1), TAYLOR, 9, 0.3),
    "cubature filter": (STUDENT, pgm.Filtering(3, gate=0.9), CUBATURE, 3, 0.0),
}


class Kind:
    """Calls of a kind."""

    def __init__(self, name):
        noise, self.schedule, self.rule, self.runs, self.missing = KINDS[name]
        self.graph, self.fresh = (
            pgm.compile(robot(noise=noise), STEPS, compiled=True) for _ in range(2)
        )

    def given(self, seed):
        return evidence(seed, self.missing, self.runs)

    def call(self, seed, graph=None):
        rule = {"schedule": self.schedule, "lineariser": self.rule}
        return pgm.infer(graph or self.graph, self.given(seed), **rule)

    @property
    def bound(self):
        """Bound calls of a graph that are all that were made."""
        (found,) = [each for blank in self.graph.layout.plans for each in blank.bound.values()]
        assert isinstance(found, Bound)
        return found

    def general(self, seed):
        """The posterior of a call that goes the general way, as few have been made."""
        for blank in self.fresh.layout.plans:
            blank.bound.clear()
        return self.call(seed, self.fresh)


@pytest.fixture(scope="module")
def kinds():
    return {}


@pytest.fixture(params=KINDS)
def kind(request, kinds):
    """Calls of a kind that are bound."""
    if request.param not in kinds:
        kinds[request.param] = Kind(request.param)
        for seed in range(OFTEN):
            kinds[request.param].call(seed)
    return kinds[request.param]


@pytest.fixture(autouse=True)
def stale(monkeypatch):
    """Memory of calls in which other numbers stood before."""
    rng = np.random.default_rng(0)

    def blocks(self):
        return [rng.choice([np.nan, 1.0, -1e9, 0.0], size) for size in self._sizes]

    monkeypatch.setattr(Room, "blocks", property(blocks))


def told(posterior):
    """All numbers that a posterior tells, by name, and its words."""
    found = {"log evidence": posterior.log_evidence, "residuals": posterior.status.residuals}
    found["converged"] = posterior.status.converged
    for name in ("predicted", "filtered"):
        beliefs = getattr(posterior, name)[x]
        found |= {f"{name} mean": beliefs.mean, f"{name} cov": beliefs.cov}
    found |= {"mean": posterior[x].mean, "cov": posterior[x].cov}
    found["joint"] = posterior.joint(x.at(2), x.at(3)).cov
    for sensor in (z, w):
        found[f"weights of {sensor}"] = posterior.weights[sensor]
        found[f"residual of {sensor}"] = posterior.innovations[sensor].residual
        found[f"spread of {sensor}"] = posterior.innovations[sensor].cov
        if sensor in posterior.rejected:
            found[f"rejected of {sensor}"] = posterior.rejected[sensor].rejected
            found[f"squares of {sensor}"] = posterior.rejected[sensor].square
    return found, (repr(posterior), repr(posterior.status), posterior.log_evidence_kind)


def assert_alike(one, other, rounding=0.0):
    (found, words), (due, due_words) = told(one), told(other)
    assert words == due_words
    assert found.keys() == due.keys()
    for name, each in found.items():
        np.testing.assert_allclose(each, due[name], rounding, rounding, err_msg=name)


def test_it_equals_a_call_that_goes_the_general_way(kind):
    served, threshold = kind.bound.served, gc.get_threshold()
    gc.set_threshold(1)  # so that no memory outlives what owns it
    try:
        posteriors = {seed: kind.call(seed) for seed in (98, 99)}
    finally:
        gc.set_threshold(*threshold)
    assert kind.bound.served == served + 2
    for seed, found in posteriors.items():
        due = kind.general(seed)
        assert due.status.compilation == "compiled"
        assert_alike(found, due)
        if kind.schedule.gate is not None:
            assert any(each.rejected.any() for each in found.rejected.values())
    # And in another process, where memory is laid out in another way.
    assert_alike(pickle.loads(pickle.dumps(kind.call(99))), due, rounding=1e-12)


def test_after_a_call_that_is_refused(kind):
    """A drive beyond all numbers, in the last run alone, is refused as it is the general way."""
    far = dict(kind.given(5))
    far[u] = far[u].copy()
    far[u].reshape(-1, STEPS, 2)[-1, 7] = 1e200
    served, told = kind.bound.served, []
    for graph in (kind.graph, kind.fresh):
        with pytest.raises(pgm.errors.PgmError) as refusal:
            pgm.infer(graph, far, schedule=kind.schedule, lineariser=kind.rule)
        told.append((type(refusal.value), str(refusal.value), refusal.value.step))
    assert told[0] == told[1]
    np.testing.assert_array_equal(kind.call(97)[x].mean, kind.general(97)[x].mean)
    assert kind.bound.served == served + 1


def test_an_array_that_repeats_its_rows_ends_where_its_memory_does():
    """Else it would be taken to have what lies behind it, and that address for one in it."""
    memory = np.zeros(40)
    repeated, behind = np.broadcast_to(memory[:2], (8, 2)), memory[4:]
    table = numbers.Numbers([address(repeated), address(behind), 7], [repeated])
    assert table.at([0]).tolist() == [0, address(behind), 7]


@pytest.mark.filterwarnings("ignore::pgm.PrecisionWarning")
@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
def test_digits_that_one_call_loses_are_not_lost_by_others(call):
    s, y, far = pgm.variables("s y far")
    motion = pgm.LinearGaussianCPD(s, {s.previous: 1.0, far: 1.0}, cov=0.01)
    sensor = pgm.LinearGaussianCPD(y, {s: 1.0}, cov=0.01)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(s, 0.0, 1.0)], [motion], [sensor])
    for place, least, most in [(1e11, 0.0, 6.0)] * 2 + [(0.0, 15.0, np.inf)] * 2:
        start = np.r_[place, np.zeros(STEPS - 1)][:, None]
        given = {far: start, y: np.full((STEPS, 1), place)}
        digits = call(model, given, compiled=True).status.digits
        assert least <= (np.inf if digits is None else digits) <= most


def test_iterations_of_the_general_way_are_told_once(monkeypatch):
    """Their linearisations lie in two ways."""
    graph, told = pgm.compile(robot(), STEPS, compiled=True), []
    of = sweep.told_back
    monkeypatch.setattr(sweep, "told_back", lambda *given: told.append(1) or of(*given))
    for seed in range(3):
        pgm.infer(graph, evidence(seed), schedule=pgm.Smoothing(3))
    assert len(told) == 2
