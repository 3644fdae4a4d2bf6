"""What is kept of runs worked through in parts is what one run of everything gives."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from crossed import crossed
from numpy.testing import assert_allclose, assert_array_equal
from robots import LANDMARKS, P0, SENSORS, controls, drive_along, drive_cpd, m, network, u, x

import pgm
from pgm.beliefs.moments.parts import split as parts

RUNS, T = 23, 8
SIGHT = SENSORS["range_bearing"]
z = SIGHT.z


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    """Make parts of five runs, and a last one of three."""
    monkeypatch.setattr(parts, "MOST", 5)


@pytest.fixture
def noticed(monkeypatch):
    """The parts that were run."""
    found = []
    original = parts.split

    def split(*args):
        for part in original(*args):
            found.append((part.runs.start, part.runs.stop))
            yield part

    monkeypatch.setattr("pgm.beliefs.moments.parts.run.split", split)
    return found


def same(kept, whole, variables=(x,)):
    for variable in variables:
        one, other = kept[variable], whole[variable]
        assert one.mean.shape == other.mean.shape
        assert one.cov.shape == other.cov.shape
        assert_array_equal(one.steps, other.steps)
        assert_allclose(one.mean, other.mean, rtol=1e-12, atol=1e-12)
        assert_allclose(one.cov, other.cov, rtol=1e-11, atol=1e-14)
    assert_allclose(kept.log_evidence, whole.log_evidence, rtol=1e-12, atol=1e-12)
    assert kept.log_evidence.shape == whole.log_evidence.shape
    assert kept.log_evidence_kind == whole.log_evidence_kind
    assert kept.status.iterations == whole.status.iterations
    assert_array_equal(kept.status.converged, whole.status.converged)
    assert_allclose(kept.status.residuals, whole.status.residuals, rtol=1e-6, atol=1e-11)
    assert kept.graph.steps == whole.graph.steps


def recording(lead=(RUNS,), missing=True):
    """Runs that differ in everything that runs may differ in."""
    rng = np.random.default_rng(5)
    commands = controls(rng, T)
    states = drive_along(commands, rng)
    step = np.array([0, 2, 2, 3, 5, 8])
    marks = LANDMARKS[[0, 1, 2, 0, 1, 2]]
    read = SIGHT.draw(np.broadcast_to(states[step], (*lead, 6, 3)), marks, rng)
    if missing:
        read[..., 1, :][rng.random(lead) < 0.3] = np.nan
    own = commands + 0.01 * rng.normal(size=(*lead, T, 2))
    return {u: own, z: pgm.sightings(read, step=step, given={m: marks})}


RULES = {
    "taylor": pgm.Taylor(),
    "unscented": pgm.Unscented(),
    "monte carlo": pgm.MonteCarlo(40, seed=3),
}


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth])
def test_parts_give_what_the_whole_gives(run, rule, noticed):
    model, evidence = network(SIGHT.cpd()), recording()
    whole = run(model, evidence, lineariser=RULES[rule])
    assert not noticed
    same(run(model, evidence, lineariser=RULES[rule], keep=[x]), whole)
    assert noticed == [(0, 5), (5, 10), (10, 15), (15, 20), (20, 23)]


@crossed(("run", "damping"), [pgm.filter, pgm.smooth], [0.0, 0.3, pgm.LevenbergMarquardt()])
def test_a_part_that_is_done_earlier_keeps_its_record(run, damping):
    model, evidence = network(SIGHT.cpd()), recording()
    asked = {"iterations": 30, "tolerance": 1e-6, "damping": damping}
    whole = run(model, evidence, **asked)
    assert whole.status.iterations > 3
    kept = run(model, evidence, **asked, keep=x)
    same(kept, whole)
    if run is pgm.smooth:
        assert kept.log_evidence_kind == "laplace"


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # half of the runs settle
def test_the_kind_is_that_of_all_runs():
    model, evidence = network(SIGHT.cpd()), recording()
    last = pgm.smooth(model, evidence, iterations=4, tolerance=0.0).status.residuals[-1]
    asked = {"iterations": 4, "tolerance": float(np.sort(last)[11:13].mean())}
    whole = pgm.smooth(model, evidence, **asked)
    assert whole.status.converged.any()
    assert not whole.status.converged.all()
    kept = pgm.smooth(model, evidence, **asked, keep=[x])
    same(kept, whole)
    assert kept.log_evidence_kind == "linearised"


def test_parts_shrink_where_many_steps_or_workers_need_room(monkeypatch, noticed):
    model, evidence = network(SIGHT.cpd()), recording()
    sizes = []
    for room, count in ((10**6, 1), (40_000, 1), (40_000, 2), (0, 1)):
        monkeypatch.setattr(parts, "ROOM", room)
        noticed.clear()
        pgm.filter(model, evidence, keep=[], executor=ThreadPoolExecutor(count))
        sizes.append(noticed[0][1])
        assert noticed[-1][1] == RUNS
    assert 5 == sizes[0] > sizes[1] > sizes[2] == sizes[3] == 1


def several_runs_in_the_model(rng):
    """Each run its own prior, mean and covariance; a control whose mean differs too."""
    spread = P0 * rng.uniform(0.5, 2.0, (RUNS, 1, 1))
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.1 * rng.normal(size=(RUNS, 3)), spread)],
        transition=[
            pgm.GaussianCPD(u, rng.uniform(0.5, 1.0, (RUNS, 2)), 0.1 * np.eye(2)),
            drive_cpd(),
        ],
        observation=[SIGHT.cpd()],
    )


def test_the_runs_of_the_model_are_parted_too(noticed):
    model = several_runs_in_the_model(np.random.default_rng(0))
    evidence = {z: recording()[z]}
    whole = pgm.smooth(model, evidence, steps=T)
    kept = pgm.smooth(model, evidence, steps=T, keep=[u, x])
    assert len(noticed) == 5
    same(kept, whole, (x, u))
    assert_array_equal(kept[u].steps, np.arange(1, T + 1))
    assert kept.graph.model is model


def test_runs_of_several_axes_and_one_run(noticed):
    model = network(SIGHT.cpd())
    for lead, count in (((3, 4), 3), ((), 1)):
        noticed.clear()
        evidence = recording(lead)
        kept = pgm.smooth(model, evidence, keep=[x])
        assert len(noticed) == count
        assert kept[x].mean.shape == (*lead, T + 1, 3)
        same(kept, pgm.smooth(model, evidence))


def test_what_is_shared_by_the_runs_stays_shared():
    evidence = recording() | {u: controls(np.random.default_rng(1), T)}
    same(
        pgm.filter(network(SIGHT.cpd()), evidence, keep=[x]),
        pgm.filter(network(SIGHT.cpd()), evidence),
    )


@pytest.mark.parametrize("lead", [(RUNS,), ()])
def test_a_start_is_parted(lead):
    model, evidence = network(SIGHT.cpd()), recording()
    start = {x: np.zeros((*lead, T + 1, 3)) + np.linspace(0.0, 1.0, T + 1)[:, None]}
    if lead:
        start[x] = start[x] + 0.01 * np.arange(RUNS)[:, None, None]
    asked = {"start": start, "iterations": 3, "tolerance": 0}
    same(pgm.smooth(model, evidence, **asked, keep=[x]), pgm.smooth(model, evidence, **asked))
    with pytest.raises(pgm.EvidenceError, match=r"axes of runs \(4,\).*of the evidence, \(23,\)"):
        pgm.smooth(model, evidence, start={x: np.zeros((4, T + 1, 3))}, keep=[x])
    with pytest.raises(pgm.EvidenceError, match="start lacks x"):
        pgm.smooth(model, evidence, start={}, keep=[x])


@pytest.mark.parametrize("own", [False, True])
def test_points_drawn_for_each_run_are_those_of_one_piece(own, noticed):
    rule = pgm.MonteCarlo(40, seed=3, fresh_per_run=True)
    sensor = SIGHT.cpd(lineariser=rule) if own else SIGHT.cpd()
    asked = {} if own else {"lineariser": rule}
    model, evidence = network(sensor), recording()
    same(pgm.filter(model, evidence, **asked, keep=[x]), pgm.filter(model, evidence, **asked))
    assert noticed == [(0, RUNS)]


def test_one_step_of_what_was_kept():
    model = network(SIGHT.cpd())
    kept = pgm.filter(model, recording(), keep=[x])
    belief = kept[x.at(3)]
    assert belief.scope == (x.at(3),)
    assert belief.steps is None
    assert_array_equal(belief.mean, kept[x].mean[:, 3])
    assert_array_equal(belief.cov, kept[x].cov[:, 3])
    with pytest.raises(pgm.EvidenceError, match=r"x has steps 0\.\.8"):
        kept[x.at(9)]


def test_nothing_but_the_log_evidence():
    model, evidence = network(SIGHT.cpd()), recording()
    kept = pgm.filter(model, evidence, keep=[])
    same(kept, pgm.filter(model, evidence), ())
    with pytest.raises(ValueError, match="read-only"):
        kept.log_evidence[0] = 0.0


def test_what_was_not_kept_says_so():
    model = several_runs_in_the_model(np.random.default_rng(0))
    kept = pgm.smooth(model, {z: recording()[z]}, steps=T, keep=[x])
    assert repr(kept).splitlines()[0] == "Posterior(smoothed, kept [x], steps 0..8, runs (23,))"
    with pytest.raises(pgm.EvidenceError, match=r"u was not kept; ask for it, keep=\[x, u\]"):
        kept[u]
    with pytest.raises(pgm.EvidenceError, match="m is an input"):
        kept[m]
    with pytest.raises(pgm.EvidenceError, match="asked for by variable"):
        kept["x"]
    for ask, error in {
        lambda: kept.predicted: pgm.EvidenceError,
        lambda: kept.filtered: pgm.EvidenceError,
        lambda: kept.innovations: pgm.EvidenceError,
        lambda: kept.joint(x.at(1), x.at(2)): pgm.EvidenceError,
        lambda: kept.message(1, 2): pgm.GraphError,
        lambda: kept.belief(1): pgm.GraphError,
    }.items():
        with pytest.raises(error, match=r"not kept.*leave keep= out"):
            ask()
    with pytest.raises(pgm.ModelError, match="kept marginals alone; leave keep= out"):
        pgm.audit(kept, rng=0)


def test_what_keep_refuses():
    model, evidence = network(SIGHT.cpd()), recording()
    for keep in ([z.at(1)], [x, m], [x.previous], [x.at(1)], [pgm.Variable("y")]):
        with pytest.raises(pgm.EvidenceError, match=r"hidden nor measured; it takes x, z$"):
            pgm.filter(model, evidence, keep=keep)
    with pytest.raises(pgm.ModelError, match="keep holds variables, not 'x'"):
        pgm.filter(model, evidence, keep="x")
    with pytest.raises(pgm.ModelError, match="keep holds x twice"):
        pgm.filter(model, evidence, keep=[x, x])
    a, b = pgm.variables("a b")
    net = pgm.BayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, 1.0), pgm.LinearGaussianCPD(b, {a: 1.0}, cov=1.0)]
    )
    with pytest.raises(pgm.GraphError, match=r"keep= and executor= are for .* dynamic networks"):
        pgm.infer(pgm.compile(net), {b: 1.0}, keep=[a])


def test_an_error_in_a_later_part_names_the_run_among_all():
    def careful(x, m):
        value = SIGHT.function(x, m)
        return np.where(x[..., :1] > 50.0, np.nan, value)

    evidence = recording()
    lost = np.zeros((RUNS, 3))
    lost[17, 0] = 90.0
    model = network(SIGHT.cpd(function=careful, jacobian=None), prior=pgm.GaussianCPD(x, lost, P0))
    for asked in ({}, {"keep": [x]}, {"executor": ThreadPoolExecutor(2)}):
        with pytest.raises(pgm.LinearisationError, match="step 0, run 17, has values that are NaN"):
            pgm.filter(model, evidence, **asked)


def test_a_contradiction_in_a_later_part_names_the_run_among_all():
    position = SENSORS["position"]
    sensor = pgm.LinearGaussianCPD(position.z, {x: np.eye(3)[:2]}, cov=np.zeros((2, 2)))
    model = network(sensor, prior=pgm.GaussianCPD(x, [0, 0, 0], np.zeros((3, 3))))
    read = np.zeros((RUNS, 1, 2))
    read[12] = 1.0
    evidence = {
        u: controls(np.random.default_rng(0), T),
        position.z: pgm.sightings(read, step=[0]),
    }
    for asked in ({}, {"keep": [x]}, {"executor": ThreadPoolExecutor(2)}):
        with pytest.raises(pgm.NumericalError, match="run 12, contradicts"):
            pgm.filter(model, evidence, **asked)


def test_balanced_trees_are_parted_too(noticed):
    w = pgm.Variable("w", components=("east", "north"))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, np.random.default_rng(0).normal(size=(RUNS, 3)), P0)],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: np.eye(3)}, cov=P0)],
        observation=[pgm.LinearGaussianCPD(w, {x: np.eye(3)[:2]}, cov=np.eye(2))],
    )
    evidence = {w: np.random.default_rng(1).normal(size=(RUNS, T, 2))}
    graph = pgm.compile(model, steps=T, method=pgm.Balanced())
    whole = pgm.infer(graph, evidence)
    same(pgm.infer(graph, evidence, keep=[x]), whole)
    assert len(noticed) == 5
    shared = pgm.infer(graph, evidence, executor=ThreadPoolExecutor(2))
    same(shared, whole)
    assert_allclose(shared.belief(12).h, whole.belief(12).h, atol=1e-9)


@pytest.mark.parametrize("run", [pgm.filter, pgm.smooth])
def test_sensors_keep_their_forecasts_and_innovations(run, noticed):
    model, evidence = network(SIGHT.cpd()), recording()
    whole = run(model, evidence)
    for asked in ({}, {"executor": ThreadPoolExecutor(2)}):
        noticed.clear()
        kept = run(model, evidence, keep=[z, x], **asked)
        assert len(noticed) > 3
        same(kept, whole)
        one, other = kept.predicted[z], whole.predicted[z]
        assert_array_equal(one.steps, other.steps)
        assert_allclose(one.mean, other.mean, rtol=1e-11, atol=1e-12)
        assert_allclose(one.cov, other.cov, rtol=1e-10, atol=1e-13)
        assert_allclose(kept.predicted[z.at(3)].mean, other.mean[:, 3], rtol=1e-11, atol=1e-12)
        found, due = kept.innovations[z], whole.innovations[z]
        assert_array_equal(found.step, due.step)
        assert_array_equal(found.dof, due.dof)
        assert_array_equal(found.rejected, due.rejected)
        for name in ("residual", "cov", "nis"):
            one, other = getattr(found, name), getattr(due, name)
            assert_allclose(one, other, rtol=1e-9, atol=1e-11)
    assert "kept [x, z]" in repr(kept)
    with pytest.raises(pgm.EvidenceError, match=r"predicted\[x\] was not kept.*\[z\] were"):
        kept.predicted[x]
    with pytest.raises(pgm.EvidenceError, match=r"keeps predicted.* alone; leave keep= out"):
        kept[z.at(1)]


def test_forecasts_of_sensors_that_were_not_read_are_kept():
    model = network(SIGHT.cpd())
    evidence = {u: recording()[u], m: pgm.constant(LANDMARKS[0])}
    kept = pgm.filter(model, evidence, keep=[z])
    assert_allclose(kept.predicted[z].mean, pgm.filter(model, evidence).predicted[z].mean)
    assert not kept.innovations
    with pytest.raises(pgm.EvidenceError, match="no belief, as evidence does not tell"):
        pgm.filter(model, {u: recording()[u]}, keep=[z])
