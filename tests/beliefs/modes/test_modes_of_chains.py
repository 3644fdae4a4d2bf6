"""Posteriors of several modes: smoothers from many starts, against a grid."""

import numpy as np
import pytest

import pgm
from pgm.beliefs.modes.chain import ChainSearch
from pgm.inference.dynamic import over_time
from pgm.schedules.options import Call
from tests.beliefs.hypotheses.test_switching_chains import MODE, READ, far, walk

P, R = pgm.Variable("p", components=("e", "n")), pgm.Variable("r")
BEACON, PUSH = (pgm.Variable(name, components=("e", "n")) for name in ("beacon", "push"))
STEPS = 20


def ranging(p, beacon):
    return np.linalg.norm(beacon - p, axis=-1, keepdims=True)


# Two beacons on a line, of which ranges alone are known: the other side is as good.
MIRROR = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(P, [0.0, 0.3], 1.0)],
    transition=[pgm.LinearGaussianCPD(P, {P.previous: np.eye(2), PUSH: np.eye(2)}, cov=0.0025)],
    observation=[pgm.NonlinearGaussianCPD(R, (P, BEACON), ranging, cov=0.01)],
)
WHEN = np.repeat(np.arange(1, STEPS + 1), 2)
WHERE = np.tile([[-3.0, 0.0], [2.0, 0.0]], (STEPS, 1))
ASKED = {PUSH: np.tile([0.05, 0.0], (STEPS, 1)), R: pgm.sightings(step=WHEN, given={BEACON: WHERE})}


def drive(seed):
    return MIRROR.sample(ASKED, rng=seed).evidence


def divergence(evidence, mixture):
    """KL of a grid's belief at the last step from the mixture."""
    edges = np.linspace(-4, 5, 241), np.linspace(-4, 4, 221)
    belief = pgm.Grid({"e": (-4, 5, 240), "n": (-4, 4, 220)})
    found = pgm.filter(MIRROR, evidence, belief=belief)[P.at(STEPS)].values
    centres = np.stack(np.meshgrid(*((e[1:] + e[:-1]) / 2 for e in edges), indexing="ij"), -1)
    cell = np.log(np.prod([e[1] - e[0] for e in edges]))
    some = found > 1e-14
    logs = mixture.log_density(centres) + cell
    return float((found[some] * (np.log(found[some]) - logs[some])).sum())


@pytest.mark.parametrize("seed", [1, 3, 8, 11])
def test_both_modes_of_a_mirror_drive_are_found_and_weighed(seed):
    evidence = drive(seed)
    found = pgm.smooth(MIRROR, evidence, belief=pgm.Gaussians(4, starts=8))
    last = found[P.at(STEPS)]
    assert last.weights.shape == (2,)
    assert found.status.modes == 2
    sides = np.sign(last.components.mean[:, 1])
    assert sorted(sides.tolist()) == [-1.0, 1.0]
    assert divergence(evidence, last) < 0.05
    one = pgm.smooth(MIRROR, evidence, iterations=50)[P.at(STEPS)]
    away = np.abs(last.components.mean - one.mean).max(axis=1).min()
    assert away < 1e-3


@pytest.mark.slow
def test_all_of_twenty_mirror_drives():
    found, adapted = [], []
    for seed in range(20):
        evidence = drive(seed)
        for each, draws in ((found, 0), (adapted, 4000)):
            belief = pgm.Gaussians(4, starts=8, draws=draws)
            posterior = pgm.smooth(MIRROR, evidence, belief=belief)
            assert posterior.status.modes == 2
            each.append(divergence(evidence, posterior[P.at(STEPS)]))
    assert np.mean(found) <= 0.05
    assert np.mean(adapted) <= 0.02
    assert np.max(adapted) <= 0.05


def test_runs_have_modes_of_their_own_and_joints_over_steps():
    many = MIRROR.sample(ASKED, runs=(2, 2), rng=5)
    found = pgm.smooth(MIRROR, many.evidence, belief=pgm.Gaussians(3, starts=8))
    assert found[P].weights.shape == (2, 2, STEPS + 1, 2)
    assert found[P].steps.tolist() == list(range(STEPS + 1))
    joint = found.joint(P.at(3), P.at(4))
    assert joint.components.mean.shape == (2, 2, 2, 4)
    values = np.asarray(many.evidence[R].values)
    for run in np.ndindex(2, 2):
        seen = pgm.sightings(values[run], step=WHEN, given={BEACON: WHERE})
        own = {PUSH: ASKED[PUSH], R: seen}
        alone = pgm.smooth(MIRROR, own, belief=pgm.Gaussians(3, starts=8))
        assert far(found.log_evidence[run], alone.log_evidence) < 1e-6
        assert far(found[P].mean[run], alone[P].mean) < 1e-4


def test_a_linear_model_has_one_mode_the_exact_one():
    model = walk().replace(prior=walk().prior[1:], transition=[walk().transition[1].cases[1,]])
    found = pgm.smooth(model, READ, belief=pgm.Gaussians(4, starts=4))
    wanted = pgm.smooth(model, READ)
    assert found.status.modes == 1
    assert far(found[model.states[0]].mean, wanted[model.states[0]].mean) < 1e-12
    assert far(found.log_evidence, wanted.log_evidence) < 1e-12


def test_modes_a_whole_turn_apart_are_one():
    heading = pgm.Variable("heading", angles=("heading",))
    compass = pgm.Variable("compass", angles=("compass",))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(heading, 0.0, 25.0)],
        transition=[pgm.LinearGaussianCPD(heading, {heading.previous: 1.0}, cov=0.01)],
        observation=[pgm.NonlinearGaussianCPD(compass, heading, lambda h: h, cov=0.04)],
    )
    found = pgm.smooth(model, {compass: [[1.0], [1.1]]}, belief=pgm.Gaussians(4, starts=16))
    assert (found[heading].weights[:, 0] > 1.0 - 1e-12).all()  # none but where readings disagree


def test_starts_that_do_not_settle_are_told():
    evidence = drive(0)
    found = pgm.smooth(
        MIRROR, evidence, iterations=2, tolerance=0.0, belief=pgm.Gaussians(2, starts=8)
    )
    assert found.status.arrived == 0
    assert not found.status.converged
    assert "0 of 8 starts settled" in repr(found.status)


def test_what_cannot_be_is_refused():
    with pytest.raises(pgm.ModelError, match="of which a count is kept"):
        pgm.Gaussians(starts=4)
    with pytest.raises(pgm.ModelError, match="starts is a number"):
        pgm.Gaussians(2, starts=-1)
    with pytest.raises(pgm.ModelError, match="a fixed lag sees a part"):
        pgm.smooth(MIRROR, drive(0), lag=3, belief=pgm.Gaussians(2, starts=4))
    with pytest.raises(pgm.ModelError, match="a filter has none"):
        pgm.filter(MIRROR, drive(0), belief=pgm.Gaussians(2, starts=4, draws=10))
    with pytest.raises(pgm.ModelError, match="too few to cut a prior of 2 components"):
        pgm.filter(MIRROR, drive(0), belief=pgm.Gaussians(2, starts=4))
    with pytest.raises(pgm.ModelError, match="have hypotheses already"):
        pgm.smooth(walk(), READ, belief=pgm.Gaussians(2, starts=4))
    with pytest.raises(pgm.ModelError, match="a filter has none"):
        pgm.OnlineFilter(MIRROR, belief=pgm.Gaussians(2, starts=4, draws=10))


@pytest.mark.parametrize("seed", [0, 4, 10])
def test_draws_adapt_modes_that_are_not_gaussian(seed):
    """Drives whose modes are bent, or of which one is weighed wrongly."""
    evidence = drive(seed)
    plain = pgm.smooth(MIRROR, evidence, belief=pgm.Gaussians(4, starts=8))
    found = pgm.smooth(MIRROR, evidence, belief=pgm.Gaussians(4, starts=8, draws=4000))
    assert divergence(evidence, plain[P.at(STEPS)]) > 0.08
    assert divergence(evidence, found[P.at(STEPS)]) < 0.05
    grid = pgm.Grid({"e": (-4, 5, 240), "n": (-4, 4, 220)})
    exact = pgm.filter(MIRROR, evidence, belief=grid).log_evidence
    assert abs(found.log_evidence - exact) < 0.06
    assert found.log_evidence_kind == "draws"
    assert found.status.effective > 500
    assert "effective draws" in repr(found.status)


def test_draws_leave_a_linear_model_as_it_is():
    """With controls that are hidden, and joints over steps: against the exact smoother."""
    x, u, z = pgm.Variable("x", components=("p", "v")), pgm.Variable("u"), pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.0, 1.0], np.diag([1.0, 0.5]))],
        transition=[
            pgm.GaussianCPD(u, 0.0, 0.3),
            pgm.LinearGaussianCPD(
                x,
                {x.previous: [[1.0, 1.0], [0.0, 1.0]], u: [[0.5], [1.0]]},
                cov=np.diag([0.1, 0.2]),
            ),
        ],
        observation=[pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=0.5)],
    )
    read = {z: model.sample(steps=6, runs=(2,), rng=0)[z]}
    wanted = pgm.smooth(model, read)
    found = pgm.smooth(model, read, belief=pgm.Gaussians(2, starts=2, draws=1000))
    assert far(found.log_evidence, wanted.log_evidence) < 1e-9
    assert found[x].mean.shape == wanted[x].mean.shape
    assert np.abs((found[x].mean - wanted[x].mean) / wanted[x].std).max() < 1e-9
    assert np.abs(found[x].std / wanted[x].std - 1.0).max() < 1e-9
    assert found[u].steps.tolist() == wanted[u].steps.tolist()
    assert np.abs((found[u].mean - wanted[u].mean) / wanted[u].std).max() < 1e-9
    several = x.at(1), u.at(3), x.at(5)
    own, exact = found.joint(*several), wanted.joint(*several)
    scale = np.sqrt(np.einsum("...ii->...i", exact.cov))
    off = (own.cov - exact.cov) / scale[..., :, None] / scale[..., None, :]
    assert np.abs(off).max() < 1e-9
    assert np.all(found.status.effective > 2000)


def test_draws_that_cannot_be_are_refused():
    with pytest.raises(pgm.ModelError, match="draws is a number"):
        pgm.Gaussians(2, starts=4, draws=-1)
    with pytest.raises(pgm.ModelError, match="give both"):
        pgm.Gaussians(2, draws=100)
    with pytest.raises(pgm.GraphError, match="draws=10,000,000,000"):
        pgm.smooth(MIRROR, drive(1), belief=pgm.Gaussians(2, starts=2, draws=10**10))
    x, z = pgm.Variable("x"), pgm.Variable("z")
    exact = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [pgm.NonlinearGaussianCPD(x, x.previous, np.tanh, cov=0.1)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.0)],
    )
    with pytest.raises(pgm.NumericalError, match="these have none"):
        pgm.smooth(exact, {z: [[0.1], [0.3]]}, belief=pgm.Gaussians(2, starts=2, draws=100))


@pytest.mark.parametrize("seed", [0, 3, 6, 8])
def test_a_filter_whose_prior_is_cut_finds_both_modes(seed):
    evidence = drive(seed)
    found = pgm.filter(MIRROR, evidence, belief=pgm.Gaussians(16, starts=256))
    assert divergence(evidence, found[P.at(STEPS)]) < 0.15
    grid = pgm.Grid({"e": (-4, 5, 240), "n": (-4, 4, 220)})
    exact = pgm.filter(MIRROR, evidence, belief=grid).log_evidence
    assert abs(found.log_evidence - exact) < 0.5
    assert found[P].weights.shape[0] == STEPS + 1
    first = found[P.at(0)]
    assert far(first.mean, [0.0, 0.3]) < 1e-12
    assert far(first.cov, np.eye(2)) < 1e-12


def test_cutting_the_prior_of_a_linear_model_changes_it_by_its_pieces_alone():
    """All pieces kept: a mixture whose first two moments are the prior's, which is nearly it."""
    x, z = pgm.Variable("x", components=("p", "v")), pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [1.0, -1.0], [[4.0, 1.0], [1.0, 2.0]])],
        [pgm.LinearGaussianCPD(x, {x.previous: [[1.0, 1.0], [0.0, 1.0]]}, cov=0.1 * np.eye(2))],
        [pgm.LinearGaussianCPD(z, {x: [[1.0, 0.0]]}, cov=4.0)],
    )
    read = {z: model.sample(steps=5, runs=(3,), rng=0)[z]}
    wanted = pgm.filter(model, read)
    found = pgm.filter(model, read, belief=pgm.Gaussians(64, starts=64))
    assert np.abs((found[x].mean - wanted[x].mean) / wanted[x].std).max() < 0.1
    assert np.abs(found[x].std / wanted[x].std - 1.0).max() < 0.1
    assert far(found.log_evidence, wanted.log_evidence) < 0.05


def test_a_mixed_networks_prior_is_cut_too():
    few = pgm.filter(walk(), READ, belief=pgm.Gaussians(64))
    cut = pgm.filter(walk(), READ, belief=pgm.Gaussians(64, starts=8))
    assert far(few[MODE].probabilities, cut[MODE].probabilities) < 0.02


def test_readings_of_angles_are_of_all_branches():
    """Two modes on either side of the half turn: a linear sensor's as a nonlinear one's."""
    h, z = pgm.Variable("h", angles=("h",)), pgm.Variable("z", angles=("z",))
    found = []
    for sensor in (
        pgm.LinearGaussianCPD(z, {h: 1.0}, cov=0.01),
        pgm.NonlinearGaussianCPD(z, h, lambda h: h, cov=0.01),
    ):
        model = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(h, 0.0, 1.0)],
            [pgm.LinearGaussianCPD(h, {h.previous: 1.0}, cov=0.05)],
            [sensor],
        )
        asked = {z: [[3.1], [3.1]]}
        for draws in (0, 8000):
            belief = pgm.Gaussians(4, starts=8, draws=draws)
            found.append(pgm.smooth(model, asked, belief=belief))
    for each in found:
        assert each.log_evidence == pytest.approx(found[0].log_evidence, abs=0.02)
        weights = each[h.at(2)].weights
        assert np.sort(weights) == pytest.approx([0.4386, 0.5614], abs=0.02)


def test_an_angle_that_nothing_reads_changes_no_mode():
    """It is a function of the state, whose branches differ from mode to mode."""
    x, z = pgm.Variable("x", components=("e", "n")), pgm.Variable("z", components=("u", "v"))
    b = pgm.Variable("b", angles=("b",))
    states = [
        pgm.LinearGaussianCPD(x, {x.previous: np.eye(2)}, cov=0.02 * np.eye(2)),
        pgm.NonlinearGaussianCPD(b, x, lambda x: np.arctan2(x[..., 1:], x[..., :1]), cov=0.02),
    ]
    read = pgm.NonlinearGaussianCPD(
        z, x, lambda x: np.stack([x[..., 0] ** 2, x[..., 0] * x[..., 1]], -1), cov=0.02 * np.eye(2)
    )
    prior = [pgm.GaussianCPD(x, [0.05, 0.1], np.eye(2))]
    asked = {z: [[1.0, 1.0]]}
    belief = pgm.Gaussians(4, starts=16, draws=20_000)
    plain = pgm.smooth(pgm.DynamicBayesianNetwork(prior, states[:1], [read]), asked, belief=belief)
    found = pgm.smooth(
        pgm.DynamicBayesianNetwork([*prior, pgm.GaussianCPD(b, 0.0, 1.0)], states, [read]),
        asked,
        belief=belief,
    )
    assert found.log_evidence == pytest.approx(plain.log_evidence, abs=0.02)
    assert np.sort(found[x].weights[-1]) == pytest.approx(np.sort(plain[x].weights[-1]), abs=0.02)
    assert found.status.effective > 10_000
    own = found[b.at(1)].components
    wanted = np.arctan2(*found[x.at(1)].components.mean[:, ::-1].T)
    assert far(np.angle(np.exp(1j * (own.mean[:, 0] - wanted))), 0.0) < 0.05


def test_questions_of_adapted_modes_are_checked():
    found = pgm.smooth(MIRROR, drive(1), belief=pgm.Gaussians(4, starts=8, draws=500))
    with pytest.raises(pgm.EvidenceError, match="at steps"):
        found.joint()
    with pytest.raises(pgm.EvidenceError, match=r"write p\.at"):
        found.joint(P)
    with pytest.raises(pgm.EvidenceError, match="step"):
        found.joint(P.at(1), P.at(STEPS + 1))
    with pytest.raises(pgm.ModelError, match="twice"):
        found.joint(P.at(1), P.at(1))


def test_no_steps_at_all_and_exact_sensors_that_are_silent():
    model = walk().replace(prior=walk().prior[1:], transition=[walk().transition[1].cases[1,]])
    x = model.states[0]
    belief = pgm.Gaussians(2, starts=4, draws=1000)
    found = pgm.smooth(model, {}, steps=0, belief=belief)
    assert found[x].mean == pytest.approx(0.0, abs=0.1)
    y = pgm.Variable("y")
    sure = model.replace(observation=[*model.observation, pgm.LinearGaussianCPD(y, {x: 1.0}, 0.0)])
    silent = {**READ, y: np.full((len(READ[next(iter(READ))]), 1), np.nan)}
    wanted = pgm.smooth(model, READ)
    assert far(pgm.smooth(sure, silent, belief=belief)[x].mean, wanted[x].mean) < 0.1


def test_draws_that_are_too_few_are_told_of():
    with pytest.warns(pgm.BeliefWarning, match="too few to adapt"):
        pgm.smooth(MIRROR, drive(1), belief=pgm.Gaussians(2, starts=8, draws=20))


def test_damping_that_is_asked_for_is_taken():
    """Motions without noise that are not linear have no cost that steps could be controlled by."""
    x, z = pgm.Variable("x"), pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.5, 0.1)],
        [pgm.NonlinearGaussianCPD(x, x.previous, np.sin, cov=0.0)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1)],
    )
    read = {z: [[0.4], [0.45]]}
    found = pgm.smooth(model, read, belief=pgm.Gaussians(2, starts=2), damping=0.5)
    assert found[x].mean.shape == (3, 1)


def test_starts_of_which_none_settles_are_told_of():
    """A chain that its readings of a square bend at each of very many steps."""
    x, z = pgm.Variable("x"), pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 0.95}, cov=0.05)],
        [pgm.NonlinearGaussianCPD(z, x, np.square, cov=0.05)],
    )
    read = {z: model.sample(steps=300, rng=0)[z]}
    with pytest.warns(pgm.ConvergenceWarning, match="nothing had settled from any start"):
        found = pgm.smooth(model, read, belief=pgm.Gaussians(2, starts=4))
    assert not found.status.converged.all()


def precise(cov, function=lambda x: x**2):
    """A walk whose sensor is so precise that float64 has too few digits for it."""
    s, seen = pgm.variables("s seen")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, 2.0, 100.0)],
        [pgm.LinearGaussianCPD(s, {s.previous: 1.0}, cov=1.0)],
        [pgm.NonlinearGaussianCPD(seen, s, function, cov=cov)],
    )
    values = np.arange(3.0, 7.0)[:, None] ** 2
    _, (graph, bound, call) = over_time(model, {seen: values}, Call(pgm.Smoothing(50)), 4)
    search = ChainSearch.make(graph, bound, call)
    return s, search, search._by_trial()


def test_a_trial_has_the_answer_of_twice_the_digits_where_it_settles():
    s, whole, trial = precise(1e-16)
    start = {s: np.full((1, 5, 1), 4.0)}
    careful, tried = whole._inferred(1, start), trial._inferred(1, start)
    assert careful._careful is not None
    assert tried._careful is not None
    assert tried.status.converged.all()
    assert tried.status.iterations <= 5 < careful.status.iterations
    off = np.abs(tried[s].mean - careful[s].mean) / careful[s].std
    assert off.max() < 1e-6
    assert tried[s].std == pytest.approx(careful[s].std, rel=1e-6)


def test_starts_that_fail_by_trial_are_tried_with_care_if_they_are_many(monkeypatch):
    s, whole, _ = precise(1.0)
    asked, inferred = [], ChainSearch._inferred

    def failing(least):
        def infer(self, count, start):
            asked.append(self.call.trial)
            if self.call.trial and (start[s][:, 0, 0] > least).any():
                raise pgm.NumericalError("float64 has no answer", run=0)
            return inferred(self, count, start)

        return infer

    monkeypatch.setattr(ChainSearch, "_inferred", failing(-np.inf))
    assert sum(part.starts.size for part in whole.arrived(16)) == 16
    assert not all(asked)
    asked.clear()
    farthest = np.sort(whole._begun(16)[s][:, 0, 0])[-2]
    monkeypatch.setattr(ChainSearch, "_inferred", failing(farthest))  # one of them
    assert sum(part.starts.size for part in whole.arrived(16)) == 15
    assert all(asked)


def test_an_online_filter_of_pieces_is_the_filter():
    evidence, belief = drive(3), pgm.Gaussians(16, starts=64)
    wanted = pgm.filter(MIRROR, evidence, belief=belief)
    online = pgm.OnlineFilter(MIRROR, belief=belief)
    found = online.initial()
    assert found[P].weights.shape == (64,)
    assert far(found[P].mean, [0.0, 0.3]) < 1e-12
    values = np.asarray(evidence[R].values)
    for step in range(1, 4):
        found = online.predict(found, {PUSH: ASKED[PUSH][step - 1]})
        here = step == WHEN
        seen = pgm.sightings(values[here], given={BEACON: WHERE[here]})
        found = online.update(found, {R: seen})
        assert far(found[P].mean, wanted[P.at(step)].mean) < 1e-9
        assert far(found[P].cov, wanted[P.at(step)].cov) < 1e-9
    total = pgm.filter(
        MIRROR,
        {
            PUSH: ASKED[PUSH][:3],
            R: pgm.sightings(
                values[WHEN <= 3], step=WHEN[WHEN <= 3], given={BEACON: WHERE[WHEN <= 3]}
            ),
        },
        belief=belief,
    ).log_evidence
    assert far(found.log_evidence, total) < 1e-9


def test_pieces_of_the_prior_are_weighed_by_open_sightings():
    """A single candidate is the named one: pieces are not merged before it is seen."""
    beacon = np.array([[-3.0, 0.0]])
    step, belief = np.arange(1, 4), pgm.Gaussians(16, starts=256)
    asked = {
        PUSH: ASKED[PUSH][:3],
        R: pgm.sightings(step=step, given={BEACON: np.tile(beacon, (3, 1))}),
    }
    values = MIRROR.sample(asked, rng=4)[R]
    named = asked | {R: pgm.sightings(values, step=step, given={BEACON: np.tile(beacon, (3, 1))})}
    unknown = pgm.unknown(beacon, association="sum")
    hidden = asked | {R: pgm.sightings(values, step=step, given={BEACON: unknown})}
    wanted = pgm.filter(MIRROR, named, belief=belief)
    found = pgm.filter(MIRROR, hidden, belief=belief)
    assert far(found.log_evidence, wanted.log_evidence) < 1e-9
    assert far(found[P].mean[:2], wanted[P].mean[:2]) < 1e-9
    assert far(found[P].cov[:2], wanted[P].cov[:2]) < 1e-9


def test_pieces_that_would_not_fit_are_refused():
    marks = np.random.default_rng(0).normal(size=(50, 2))
    unknown = pgm.unknown(marks, association="sum")
    read = {
        PUSH: ASKED[PUSH][:1],
        R: pgm.sightings([[1.0]], step=[1], given={BEACON: unknown}),
    }
    with pytest.raises(pgm.GraphError, match="fewer pieces"):
        pgm.filter(MIRROR, read, belief=pgm.Gaussians(16, starts=2**14))
