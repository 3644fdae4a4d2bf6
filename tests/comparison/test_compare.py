"""`pgm.compare`: against its pieces one by one, and its errors."""

import pickle
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm import ModelError, consistency, examples
from tests.beliefs.own.ensemble import EnsembleKalman
from tests.beliefs.own.kalman import Kalman

T, RUNS = 12, 3
x = pgm.Variable("x", components=("place", "speed"))
z = pgm.Variable("z")
a = pgm.Variable("a")
EVERY = pgm.sightings(step=np.arange(T + 1))


def linear(start=1.0):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 0.5], start * np.eye(2))],
        [
            pgm.LinearGaussianCPD(
                x, {x.previous: np.array([[1.0, 0.5], [0.0, 0.9]])}, cov=np.diag([0.1, 0.2])
            )
        ],
        [pgm.LinearGaussianCPD(z, {x: np.array([[1.0, 0.0]])}, cov=0.3)],
    )


def drawn(model, runs=RUNS):
    sample = model.sample({z: EVERY}, steps=T, runs=runs, rng=0)
    return {z: pgm.sightings(sample[z], step=np.arange(T + 1))}, {x: sample[x]}


def bent():
    """A scalar whose sensor squares it: a belief of two peaks."""
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, [0.5], 1.0)],
        [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.2)],
        [pgm.NonlinearGaussianCPD(z, a, lambda a: a**2 / 2.0, cov=0.5)],
    )


SQUARES = {z: pgm.sightings(np.linspace(0.2, 1.0, T + 1)[:, None], step=np.arange(T + 1))}
GRID = pgm.Grid({"a": (-8.0, 8.0, 320)})


def test_linear_beliefs_are_those_of_the_oracle():
    model = linear()
    evidence, truth = drawn(model)
    oracle = pgm.smooth(model, evidence, steps=T)
    found = pgm.compare(model, evidence, oracle=oracle, truth=truth, steps=T)
    assert [(row.lineariser, row.schedule) for row in found.rows] == [
        (lineariser, schedule)
        for lineariser in ("Taylor", "Unscented", "Cubature")
        for schedule in ("filter", "smoother")
    ]
    for row in found.rows:
        assert_allclose(row.kl_by_step, 0.0, atol=1e-12)
        belief = (oracle if row.schedule == "smoother" else oracle.filtered)[x]
        average = consistency.anees(belief, truth[x])
        assert_allclose(row.nees_by_step, average.value)
        assert row.nees == pytest.approx(consistency.nees(belief, truth[x]).mean())
        assert row.nees_expected == 2.0
        for name in ("place", "speed"):
            assert row.rmse[name] == pytest.approx(consistency.rmse(belief, truth[x], (name,)))
        assert row.log_evidence == pytest.approx(oracle.log_evidence.mean())
        assert (row.log_evidence_kind, row.left_out, row.error) == ("exact", 0, "")
        assert row.seconds > 0.0
    assert [row.kind.name for row in found.oracle_rows] == ["filtered", "smoothed"]
    assert found.oracle_rows[1].nees == pytest.approx(found["Taylor", "smoother"].nees)
    assert found.oracle_rows[0].kl == 0.0


def test_kl_is_from_the_grid_s_moments_of_the_same_kind():
    """Of one's own grids, with the divergence written out."""
    model, schedules = bent(), [pgm.Filtering(), pgm.FixedLag(2), pgm.Smoothing()]
    found = pgm.compare(model, SQUARES, schedules=schedules, oracle=GRID, steps=T)
    for schedule, word in zip(schedules, ("filter", "fixed lag 2", "smoother"), strict=True):
        graph = pgm.compile(model, T)
        p = pgm.infer(graph, SQUARES, schedule=schedule, belief=GRID)[a]
        q = pgm.infer(graph, SQUARES, schedule=schedule, lineariser=pgm.Unscented())[a]
        (mean, var), (mu, sigma) = ((b.mean[:, 0], b.cov[:, 0, 0]) for b in (p, q))
        due = 0.5 * (np.log(sigma / var) - 1.0 + (var + (mean - mu) ** 2) / sigma)
        row = found["Unscented", word]
        assert_allclose(row.kl_by_step, due, rtol=1e-9, atol=1e-12)
        assert row.kl == pytest.approx(due.mean())
        assert (row.kl_most, row.kl_step) == (pytest.approx(due.max()), int(due.argmax()))
        (own,) = [r for r in found.oracle_rows if r.kind == row.kind]
        # KL(p ‖ q) by the density in cells is the sum of the lineariser's part and the oracle's.
        width = GRID.cells["a"][1] / 160
        density = p.values / width
        normal = np.exp(-((p.centres[0] - mu[:, None]) ** 2) / (2.0 * sigma[:, None]))
        normal /= np.sqrt(2.0 * np.pi * sigma[:, None])
        some = p.values > 0.0
        ratio = np.where(some, np.log(np.where(some, density, 1.0) / normal), 0.0)
        assert_allclose(row.kl_by_step + own.kl_by_step, (p.values * ratio).sum(axis=1), atol=1e-9)
    assert max(row.kl_most for row in found.oracle_rows) > 0.02


def test_rows_are_means_over_runs():
    """Of two runs on grids, and beside one oracle for both of them."""
    values = np.stack([np.linspace(0.2, 1.0, T + 1), np.linspace(1.5, 0.1, T + 1)])[..., None]
    every, truth = np.arange(T + 1), np.stack([np.zeros((T + 1, 1)), np.ones((T + 1, 1))])
    single = [
        pgm.compare(
            bent(),
            {z: pgm.sightings(values[k], step=every)},
            oracle=GRID,
            truth={a: truth[k]},
            steps=T,
        )
        for k in range(2)
    ]
    both = {z: pgm.sightings(values, step=every)}
    found = pgm.compare(bent(), both, oracle=GRID, truth={a: truth}, steps=T)
    assert found.runs == (2,)
    for k, row in enumerate(found.rows + found.oracle_rows):
        one = [(each.rows + each.oracle_rows)[k] for each in single]
        assert_allclose(row.kl_by_step, np.mean([r.kl_by_step for r in one], axis=0), rtol=1e-9)
        assert_allclose(row.nees_by_step, np.mean([r.nees_by_step for r in one], axis=0))
        assert row.rmse["a"] == pytest.approx(np.sqrt(np.mean([r.rmse["a"] ** 2 for r in one])))
        assert row.log_evidence == pytest.approx(np.mean([r.log_evidence for r in one]))
    shared = pgm.smooth(bent(), {z: pgm.sightings(values[0], step=every)}, steps=T, belief=GRID)
    row = pgm.compare(bent(), both, oracle=shared, steps=T)["Cubature", "smoother"]
    beliefs = pgm.smooth(bent(), both, steps=T, lineariser=pgm.Cubature())[a]
    due = consistency.kl(shared[a].gaussian(), beliefs).mean(axis=0)
    assert_allclose(row.kl_by_step, due)


def test_a_smoothed_grid_stands_for_filters_by_its_forward_sweep():
    posterior = pgm.smooth(bent(), SQUARES, steps=T, belief=GRID)
    given = pgm.compare(bent(), SQUARES, oracle=posterior, steps=T)
    run = pgm.compare(bent(), SQUARES, oracle=GRID, steps=T)
    for row, due in zip(given.rows + given.oracle_rows, run.rows + run.oracle_rows, strict=True):
        assert_allclose(row.kl_by_step, due.kl_by_step)
        assert row.log_evidence == due.log_evidence
    assert "Grid(a: 320 of 0.05)" in repr(given)
    assert given.oracle_status == repr(posterior.status)
    assert given.oracle_status in repr(given)


def test_particles_are_an_oracle():
    """As a fine grid is, but for the noise of draws."""
    filters = {"filter": pgm.Filtering()}
    cloud = pgm.filter(bent(), SQUARES, steps=T, belief=pgm.Particles(100_000, seed=0))
    found = pgm.compare(bent(), SQUARES, oracle=cloud, schedules=filters, steps=T)
    due = pgm.compare(bent(), SQUARES, oracle=GRID, schedules=filters, steps=T)
    for row, other in zip(found.rows, due.rows, strict=True):
        assert_allclose(row.kl_by_step, other.kl_by_step, rtol=0.05, atol=0.01)
    (own,) = found.oracle_rows
    assert np.isnan(own.kl_by_step).all()
    assert "it is not known of Particles: beliefs made of draws" in " ".join(repr(found).split())
    assert "non_gaussianity()" not in repr(due)
    assert "oracle Particles(100,000" in repr(found)
    assert found.oracle_status == repr(cloud.status)


def test_the_gaussian_s_own_distance_is_zero_of_a_gaussian():
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, [0.3], 1.0)], [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.5)], []
    )
    belief = pgm.filter(model, {}, steps=3, belief=pgm.Grid({"a": (-14.0, 14.0, 560)}))[a]
    assert_allclose(belief.non_gaussianity(), 0.0, atol=1e-9)


def test_a_truth_may_stand_in_the_oracle_s_place():
    model = linear()
    evidence, truth = drawn(model)
    found = pgm.compare(model, evidence, oracle=truth, schedules=[pgm.Filtering()], steps=T)
    same = pgm.compare(model, evidence, truth=truth, schedules=[pgm.Filtering()], steps=T)
    assert [row.nees for row in found.rows] == [row.nees for row in same.rows]
    assert np.isnan(found["Taylor", "filter"].kl)
    assert found["Taylor", "filter"].kl_step is None
    assert not found.oracle_rows
    assert "KL" not in repr(found)


def test_a_sample_is_a_truth():
    """As the states that it holds are: its measurements and its discrete states are left out."""
    model, _, s = switching()
    sample = model.sample(steps=6, rng=1)
    plans = {"schedules": [pgm.Filtering()]}
    due = pgm.compare(model, sample.evidence, truth={s: sample[s]}, **plans)["Taylor", "filter"]
    for given in ({"truth": sample}, {"oracle": sample}):
        row = pgm.compare(model, sample.evidence, **given, **plans)["Taylor", "filter"]
        assert (row.nees, row.log_score) == (due.nees, due.log_score)
    other = linear().sample({z: EVERY}, steps=T, rng=0)
    with pytest.raises(ModelError, match="the truth, a sample, has x, "):
        pgm.compare(model, sample.evidence, truth=other)


def test_a_truth_that_is_known_in_part():
    model = linear()
    evidence, truth = drawn(model)
    partly = truth[x].copy()
    partly[..., 1], partly[:, :4] = np.nan, np.nan
    found = pgm.compare(model, evidence, truth={x: partly}, steps=T)["Taylor", "filter"]
    belief = pgm.filter(model, evidence, steps=T)[x]
    due = consistency.nees(belief[:, 4:], truth[x][:, 4:], ("place",))
    assert found.nees == pytest.approx(due.mean())
    assert found.nees_expected == 1.0
    assert np.isnan(found.rmse["speed"])
    assert np.isnan(found.nees_by_step[:4]).all()


def test_steps_with_singular_beliefs_are_left_out():
    model = linear(start=0.0)
    evidence, truth = drawn(model)
    oracle = pgm.smooth(model, evidence, steps=T)
    found = pgm.compare(model, evidence, oracle=oracle, truth=truth, steps=T)
    row = found["Taylor", "smoother"]
    assert row.left_out == 1
    assert np.isnan([row.kl_by_step[0], row.nees_by_step[0]]).all()
    assert row.nees == pytest.approx(consistency.nees(oracle[x][:, 1:], truth[x][:, 1:]).mean())
    assert "KL and NEES leave out up to 1 step of 13" in repr(found)


def test_a_belief_that_is_flat_at_first_is_left_out_there():
    flat = bent().replace(prior=[pgm.GaussianCPD(a, [0.0], np.inf)], observation=linear_sensor())
    late = {z: pgm.sightings(np.ones((T, 1)), step=np.arange(1, T + 1))}
    oracle = pgm.smooth(flat, late, steps=T)
    found = pgm.compare(flat, late, oracle=oracle, truth={a: np.ones((T + 1, 1))}, steps=T)
    assert [row.left_out for row in found.rows] == [1, 0] * 3
    assert found["Taylor", "filter"].kl == pytest.approx(0.0, abs=1e-12)
    assert np.isfinite(found["Taylor", "filter"].nees)


def linear_sensor():
    return [pgm.LinearGaussianCPD(z, {a: 1.0}, cov=0.5)]


def test_a_run_that_fails_is_a_row():
    model = bent().replace(
        observation=[pgm.NonlinearGaussianCPD(z, a, lambda a: np.sqrt(4.0 + a), cov=0.5)]
    )
    found = pgm.compare(
        model,
        SQUARES,
        linearisers={"fine": pgm.Taylor(), "far": pgm.Unscented(alpha=10.0)},
        schedules=[pgm.Filtering()],
        truth={a: np.zeros((T + 1, 1))},
        steps=T,
    )
    fine, far = found.rows
    assert fine.error == ""
    assert far.error.startswith("LinearisationError: ")
    assert np.isnan([far.kl, far.nees, far.rmse["a"], far.log_evidence]).all()
    assert f"far, filter, a: {far.error}" in " ".join(repr(found).split())


@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")  # four linearisations need not settle
def test_rows_are_named():
    found = pgm.compare(
        bent(),
        SQUARES,
        linearisers=[pgm.Unscented(), pgm.Unscented(alpha=0.5), pgm.Taylor()],
        schedules=[pgm.Smoothing(), pgm.Smoothing(iterations=4)],
        steps=T,
    )
    assert {row.lineariser for row in found.rows} == {
        "Unscented(alpha=None, beta=2.0, kappa=0.0)",
        "Unscented(alpha=0.5, beta=2.0, kappa=0.0)",
        "Taylor",
    }
    assert {row.schedule for row in found.rows} == {"smoother", "smoother × 4"}
    settled = pgm.smooth(bent(), SQUARES, steps=T, iterations=4).status.converged
    assert found["Taylor", "smoother × 4"].converged == settled.mean()
    assert np.isnan(found["Taylor", "smoother"].converged)
    assert found["Taylor", "smoother", a] is found["Taylor", "smoother"]
    with pytest.raises(ModelError, match=r"no row \('taylor', 'smoother'\); .*'Taylor'"):
        found["taylor", "smoother"]
    with pytest.raises(ModelError, match="no row 0"):
        found[0]


def test_several_states_have_rows_of_their_own():
    drift = pgm.Variable("drift")
    model = pgm.DynamicBayesianNetwork(
        [*linear().prior, pgm.GaussianCPD(drift, [0.0], 1.0)],
        [*linear().transition, pgm.LinearGaussianCPD(drift, {drift.previous: 1.0}, cov=0.1)],
        [pgm.LinearGaussianCPD(z, {x: np.array([[1.0, 0.0]]), drift: 1.0}, cov=0.3)],
    )
    evidence = {z: np.zeros((T, 1))}
    truth = {drift: np.zeros((T + 1, 1))}
    alone = pgm.compare(model, evidence, truth=truth)
    assert alone.states == (drift,)
    assert "–" not in repr(alone)
    found = pgm.compare(model, evidence, truth=truth, states=[x, drift])
    assert found.states == (x, drift)
    assert np.isnan(found["Taylor", "filter", x].nees)
    belief = pgm.filter(model, evidence)[drift]
    due = consistency.nees(belief, np.zeros((T + 1, 1))).mean()
    assert found["Taylor", "filter", drift].nees == pytest.approx(due)
    assert "state" in repr(found).splitlines()[1]
    with pytest.raises(ModelError, match=r"name the state, \['Taylor', 'filter', x\]"):
        found["Taylor", "filter"]
    only = pgm.compare(model, evidence, states=[drift])
    assert {row.state for row in only.rows} == {drift}


def test_a_comparison_is_a_value():
    found = pgm.compare(bent(), SQUARES, oracle=GRID, steps=T)
    with pytest.raises(AttributeError, match="immutable"):
        found.steps = 3
    with pytest.raises(ValueError, match="read-only"):
        found.rows[0].kl_by_step[0] = 1.0
    again = pickle.loads(pickle.dumps(found))
    assert repr(again) == repr(found)
    assert again.rows[0].rmse == {}


def test_the_frame_has_the_rows():
    pytest.importorskip("pandas")
    model = linear()
    evidence, truth = drawn(model)
    oracle = pgm.smooth(model, evidence, steps=T)
    found = pgm.compare(model, evidence, oracle=oracle, truth=truth, steps=T)
    frame = found.to_frame()
    assert len(frame) == 8
    assert frame["oracle"].tolist() == [False] * 6 + [True] * 2
    for column in ("kl", "kl_most", "nees", "log_evidence", "seconds"):
        due = [getattr(row, column) for row in found.rows]
        assert frame[column].tolist()[:6] == due
    assert frame["rmse_place"].tolist()[:6] == [row.rmse["place"] for row in found.rows]


def test_without_pandas_a_frame_says_what_is_missing(monkeypatch):
    found = pgm.compare(bent(), SQUARES, steps=T)
    monkeypatch.setitem(sys.modules, "pandas", None)
    told = r"Comparison\.to_frame\(\) needs pandas: pip install 'sepset\[frames\]'"
    with pytest.raises(ImportError, match=told):
        found.to_frame()


class Own:
    """An oracle of one's own."""

    def __init__(self, belief, kind):
        self.belief, self.kind = belief, kind

    def __getitem__(self, variable):
        return self.belief


def test_an_oracle_of_one_s_own():
    belief = pgm.filter(bent(), SQUARES, steps=T, belief=GRID)[a].gaussian()
    oracle = Own(belief, pgm.Kind(0))
    found = pgm.compare(bent(), SQUARES, oracle=oracle, schedules=[pgm.Filtering()], steps=T)
    due = consistency.kl(belief, pgm.filter(bent(), SQUARES, steps=T)[a])
    assert_allclose(found["Taylor", "filter"].kl_by_step, due)
    assert np.isnan(found.oracle_rows[0].log_evidence)


class Shifted:
    """A marginal that tells of its density by three numbers."""

    def __init__(self, belief):
        self.belief = belief

    def gaussian(self):
        return self.belief

    def non_gaussianity(self):
        return np.zeros(3)


class Mine:
    """A marginal of one's own form, that of a grid."""

    def __init__(self, belief, apart=None):
        self.belief, self.mean, self.cov = belief, belief.mean, belief.cov
        if apart is not None:
            self.non_gaussianity = lambda: apart


def test_a_marginal_of_one_s_own_tells_how_far_it_is_from_a_gaussian():
    """And that of a family of beliefs of one's own is NaN where it does not."""
    grid = pgm.filter(bent(), SQUARES, steps=T, belief=GRID)[a]
    filters = {"filter": pgm.Filtering()}

    class Told(EnsembleKalman):
        def marginal(self, beliefs, asked):
            return Mine(grid, grid.non_gaussianity())

    class Silent(EnsembleKalman):
        def marginal(self, beliefs, asked):
            return Mine(grid)

    due = pgm.compare(bent(), SQUARES, oracle=GRID, schedules=filters, steps=T)
    for family in (Told(50), Silent(50)):
        found = pgm.compare(bent(), SQUARES, oracle=family, schedules=filters, steps=T)
        assert_allclose(found["Taylor", "filter"].kl_by_step, due["Taylor", "filter"].kl_by_step)
        (own,) = found.oracle_rows
        known = due.oracle_rows[0].kl_by_step
        assert_allclose(own.kl_by_step, known if type(family) is Told else known * np.nan)
        assert ("non_gaussianity()" in repr(found)) == (type(family) is Silent)
        assert "members" in found.oracle_status
        assert f"oracle: {type(family).__name__}" in repr(found)


def test_an_oracle_whose_family_has_no_figures_has_no_status_to_show():
    given = {examples.z: [[1.0], [2.0]]}
    for oracle in (Kalman(), pgm.smooth(examples.walk, given)):
        found = pgm.compare(examples.walk, given, oracle=oracle)
        assert found.oracle_status == ""
        assert found.oracle_rows[0].kl == 0.0


FILTERED = pgm.filter(bent(), SQUARES, steps=T)
rain = pgm.Discrete("rain", states=("no", "yes"))
CHAIN = pgm.DynamicBayesianNetwork(
    [pgm.TableCPD(rain, table=[0.5, 0.5])],
    [pgm.TableCPD(rain, (rain.previous,), table=[[0.7, 0.3], [0.3, 0.7]])],
    [],
)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"linearisers": pgm.Taylor()}, r"linearisers= is a sequence of linearisers, or a mapping"),
        ({"linearisers": []}, "linearisers= is empty"),
        ({"linearisers": [pgm.Taylor]}, "is no lineariser"),
        ({"linearisers": [pgm.Taylor(), pgm.Taylor()]}, r"has Taylor\(\) twice"),
        ({"linearisers": {1: pgm.Taylor()}}, "found the name 1"),
        ({"schedules": pgm.Filtering()}, "schedules= is a sequence of schedules"),
        ({"schedules": ["filter"]}, "'filter' is no schedule of a dynamic network"),
        ({"schedules": [pgm.Flooding()]}, "is no schedule of a dynamic network"),
        ({"oracle": 3}, "oracle= is a pgm.Grid.*not int"),
        ({"oracle": FILTERED}, "beliefs are filtered, and a row's are smoothed"),
        (
            {"oracle": Own(FILTERED[a][1:], pgm.Kind(0)), "schedules": [pgm.Filtering()]},
            r"means of shape \(12, 1\); \(13, 1\) was due",
        ),
        (
            {"oracle": Own(np.zeros(3), pgm.Kind(0)), "schedules": [pgm.Filtering()]},
            "marginal of a is a ndarray; a pgm.Gaussian, a pgm.results.GridBelief or",
        ),
        (
            {
                "oracle": Own(Shifted(FILTERED[a]), pgm.Kind(0)),
                "schedules": [pgm.Filtering()],
            },
            r"non_gaussianity\(\) of the oracle's marginal of a has shape \(3,\); \(13,\) was due",
        ),
        ({"truth": np.zeros((T + 1, 1))}, "truth= maps states to their values"),
        ({"truth": {z: np.zeros((T + 1, 1))}}, "given of z, which is no state"),
        ({"truth": {a: np.zeros((T, 1))}}, "of steps, must agree"),
        ({"truth": {a: np.zeros((T + 1, 2))}}, "of components, must agree"),
        ({"truth": {a: np.full((T + 1, 1), np.nan)}}, "truth of a is NaN throughout"),
        ({"truth": {}, "oracle": {a: np.zeros((T + 1, 1))}}, "give the truth once"),
        ({"states": [z]}, "z is no state of the network"),
        ({"states": []}, "states= is empty"),
        ({"model": CHAIN, "evidence": {}, "truth": None}, "a network of tables is exact"),
        ({"model": 3}, "a dynamic network was due, not 3"),
    ],
)
def test_what_does_not_fit_is_refused_before_any_run(given, told, monkeypatch):
    def ran(*_, **__):
        raise AssertionError("work was started")

    monkeypatch.setattr("pgm.comparison.entries.send", ran)
    given = {"model": bent(), "evidence": SQUARES, "steps": T} | given
    with pytest.raises(ModelError, match=told):
        pgm.compare(given.pop("model"), given.pop("evidence"), **given)


def switching():
    """A drift that is calm or wild, as its mode has it."""
    mode, s = pgm.Discrete("mode", states=("calm", "wild")), pgm.Variable("s")
    cases = {
        name: pgm.LinearGaussianCPD(s, {s.previous: 0.9}, cov=cov)
        for name, cov in (("calm", 0.1), ("wild", 4.0))
    }
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(mode, table=[0.6, 0.4]), pgm.GaussianCPD(s, 0.0, 1.0)],
        [
            pgm.TableCPD(mode, mode.previous, table=[[0.8, 0.2], [0.3, 0.7]]),
            pgm.SwitchingCPD(s, mode, cases),
        ],
        [pgm.LinearGaussianCPD(z, {s: 1.0}, cov=0.4)],
    )
    return model, mode, s


def test_mixtures_are_compared_by_their_moments():
    """Those of few Gaussians with an oracle of all sequences, as filter and as smoother."""
    model, mode, s = switching()
    drawn = model.sample(steps=6, rng=1)
    beliefs = [pgm.Gaussians(2), pgm.Gaussians(8), pgm.Gaussians(mix=True)]
    every = pgm.Gaussians(128)
    found = pgm.compare(
        *(model, drawn.evidence), linearisers=beliefs, oracle=every, truth={s: drawn[s]}
    )
    for schedule, run in (("filter", pgm.filter), ("smoother", pgm.smooth)):
        due = run(model, drawn.evidence, belief=every)[s].gaussian()
        for belief in beliefs:
            row = found[repr(belief), schedule]
            own = run(model, drawn.evidence, belief=belief)[s].gaussian()
            ratio = own.cov / due.cov
            away = (own.mean - due.mean)[..., 0] ** 2 / own.cov[..., 0, 0]
            kl = 0.5 * (1 / ratio + np.log(ratio) - 1)[..., 0, 0] + 0.5 * away
            assert_allclose(row.kl_by_step, kl, atol=1e-12)
            assert row.log_evidence_kind == "merged"
        assert found["Gaussians(8)", schedule].kl < found["Gaussians(2)", schedule].kl
    linear = pgm.compare(model, drawn.evidence, truth={s: drawn[s]})
    default = pgm.smooth(model, drawn.evidence)
    assert linear["Taylor", "smoother"].log_evidence == default.log_evidence
    with pytest.raises(ModelError, match="truth=: mode is discrete"):
        pgm.compare(model, drawn.evidence, truth={mode: drawn[mode]})
    with pytest.raises(ModelError, match="states=: mode is discrete"):
        pgm.compare(model, drawn.evidence, truth={s: drawn[s]}, states=[mode])
