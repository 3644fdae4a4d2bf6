"""Estimates, and their verdicts, against grids, quadrature and exact answers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from crossed import slow_after

import pgm
from experiments.iterated import growth
from experiments.nonlinear_measurement import cases, truth
from pgm.beliefs.modes.chain import ChainSearch
from pgm.examples import rainy, square, squares, walk, wet, x, y, z
from pgm.inference.vouching import climbing, judging
from tests.beliefs.modes.test_modes_of_chains import ASKED, MIRROR, STEPS, P, divergence, drive

# The bound on the mean KL of the pose's moments from exact ones, by sensor [nats].
MEAN = {"far": 0.002, "near": 0.006, "two_ranges": 0.015, "position": 0.015, "collinear": 0.05}


@pytest.mark.parametrize("sensor", slow_after(2, MEAN))
def test_moments_of_a_pose_are_those_of_many_points(sensor):
    case = cases.simulate(cases.SENSORS[sensor], 0.6, 20, 5)
    exact = truth.posterior(case, 14, 500, 5)
    found = pgm.estimate(case.model, case.evidence, steps=1)
    belief = found[cases.pose.at(1)]
    own = pgm.Gaussian(cases.pose, belief.mean, belief.cov)
    off = pgm.Gaussian(cases.pose, exact.mean, exact.cov).kl(own)
    assert off.mean() <= MEAN[sensor]
    verdict = found.verdict
    assert verdict.vouched.mean() >= 0.8
    assert (off <= 2 * verdict.within)[verdict.vouched].mean() >= 0.95
    if sensor == "far":
        assert verdict.draws.max() <= 1000
        assert verdict.starts.max() <= 40
        assert set(verdict.of.tolist()) == {"density"}


def judged_drives(seeds):
    """How far estimates of mirror drives are from a grid, and whether they are vouched for."""
    off, vouched = [], []
    for seed in seeds:
        evidence = drive(seed)
        found = pgm.estimate(MIRROR, evidence)
        off.append(divergence(evidence, found[P.at(STEPS)]))
        vouched.append(bool(found.verdict.vouched))
        assert vouched[-1] == ("NOT vouched for" not in repr(found))
    return np.array(off), np.array(vouched)


def test_mirror_drives_are_vouched_for_only_where_they_are_right():
    off, vouched = judged_drives((1, 10))
    assert off.max() < 0.05
    assert vouched[0]


def test_another_rule_that_loses_a_mode_is_not_believed(monkeypatch):
    """The rule of a drive whose draws do not vouch for it, made to find one mode of two."""

    class Blind(ChainSearch):
        def chosen(self, parts, count):
            return super().chosen(parts, 1)

    def blind(search):
        return Blind(search.graph, search.bound, search.call)

    weigh, calls = climbing.weigh, []

    def flattering(*asked):
        """The first answer is not vouched for, the other is."""
        answer = weigh(*asked)
        calls.append(answer)
        good = np.full(answer.of.shape, len(calls) > 1)
        return replace(answer, of=good.astype(int), sound=good, usable=good)

    monkeypatch.setattr(ChainSearch, "otherwise", blind)
    monkeypatch.setattr(climbing, "weigh", flattering)
    found = pgm.estimate(MIRROR, drive(10), effort=1000)
    assert len(calls) == 2
    assert not found.verdict.vouched
    assert found[P.at(STEPS)].weights.min() > 0.1


def test_the_verdict_names_the_other_rule_where_its_modes_were_chosen():
    """Of a mirror drive whose draws do not vouch for the modes of slopes."""
    found = pgm.estimate(MIRROR, drive(0))
    verdict = found.verdict
    assert verdict.tried_otherwise == 9
    assert verdict.starts == 33 + 9
    assert verdict.otherwise
    told = " ".join(repr(verdict).split())
    assert "9 of the starts by a rule that takes means" in told
    assert "2 Gaussians, by the rule that takes means, with moments" in told
    assert "42 iterated answers in two batches" in told


@pytest.mark.slow
def test_all_of_forty_mirror_drives():
    off, vouched = judged_drives(range(40))
    assert off.mean() <= 0.03
    assert vouched.sum() >= 20
    assert off[vouched].max() <= 0.05


@pytest.mark.slow
def test_a_hundred_runs_of_the_growth_model_by_its_cube():
    model = growth.network(growth.POWERS["cubic"])
    steps = np.arange(1, 51)
    inputs = {
        growth.clock: steps[:, None] * 1.0,
        growth.reading: pgm.sightings(step=steps),
    }
    drawn = model.sample(inputs, runs=100, rng=3)
    found = pgm.estimate(model, drawn.evidence)
    grid = pgm.Grid({growth.state: (-30.0, 30.0, 5000)})
    exact = pgm.smooth(model, drawn.evidence, belief=grid)[growth.state].mean
    mean = found[growth.state].mean
    assert np.sqrt(np.mean((mean - drawn[growth.state]) ** 2)) <= 0.40
    off = np.abs(mean - exact).max(axis=(1, 2))[found.verdict.vouched]
    assert off.size
    assert (off > 1.0).mean() <= 0.01


def judged_wide_starts(runs):
    """Verdicts on robots begun 3 m and 1.5 rad off, and their NEES, of ranges alone."""
    pose = pgm.Variable("pose", components=("east", "north", "turn"), angles=("turn",))
    push, where = pgm.Variable("push", components=("v", "w")), pgm.Variable("where", ("e", "n"))
    heard = pgm.Variable("heard")

    def moved(pose, push):
        east, north, turn = np.moveaxis(pose, -1, 0)
        speed, rate = np.moveaxis(push, -1, 0) / 2.0
        there = east + speed * np.cos(turn), north + speed * np.sin(turn), turn + rate
        return np.stack(np.broadcast_arrays(*there), -1)

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(pose, np.zeros(3), np.diag([3.0, 3.0, 1.5]) ** 2)],
        [
            pgm.NonlinearGaussianCPD(
                pose, (pose.previous, push), moved, cov=np.diag([0.05, 0.05, 0.03]) ** 2
            )
        ],
        [
            pgm.NonlinearGaussianCPD(
                heard,
                (pose, where),
                lambda pose, where: np.hypot(
                    pose[..., :1] - where[..., :1], pose[..., 1:2] - where[..., 1:]
                ),
                cov=0.04,
            )
        ],
    )
    beacons = np.resize([(7.0, 1.0), (-6.0, 8.0), (4.0, 12.0)], (21, 2))
    ranges = pgm.sightings(step=np.arange(0, 61, 3), given={where: beacons})
    drawn = model.sample({push: np.tile([1.0, 0.2], (60, 1)), heard: ranges}, runs=runs, rng=77)
    found = pgm.estimate(model, drawn.evidence)
    belief, off = found[pose], np.asarray(drawn[pose]) - found[pose].mean
    off[..., 2] = np.arctan2(np.sin(off[..., 2]), np.cos(off[..., 2]))
    nees = np.einsum("rti,rti->rt", off, np.linalg.solve(belief.cov, off[..., None])[..., 0])
    return found.verdict, nees.mean(axis=1) / 3.0


def test_starts_that_creep_far_below_the_mode_do_not_count():
    """Of ranges from a wide start some in nine in ten runs stop a thousand nats below."""
    verdict, nees = judged_wide_starts(8)
    assert verdict.vouched.all()
    assert nees.max() < 5.0
    assert verdict.starts.max() <= 40


@pytest.mark.slow
def test_two_hundred_wide_starts():
    verdict, nees = judged_wide_starts(200)
    assert verdict.vouched.sum() >= 190
    assert not (verdict.vouched & (nees > 5.0)).any()


def test_modes_that_the_noise_of_a_motion_makes_are_found():
    """From a narrow prior a walk goes to either root of what is read: against quadrature."""
    step = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)
    read = pgm.NonlinearGaussianCPD(y, x, lambda x: x**2, cov=0.05)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(x, 0.5, 1e-4)], [step], [read])
    found = pgm.estimate(model, {y: pgm.sightings([[4.0]], [4])}, steps=4)
    grid = np.linspace(-4.0, 4.0, 80_001)
    logs = -0.5 * (grid - 0.5) ** 2 / 4.0001 - 0.5 * (4.0 - grid**2) ** 2 / 0.05
    weights = np.exp(logs - logs.max())
    last = found[x.at(4)]
    assert found.verdict.vouched
    assert last.mean[0] == pytest.approx(weights @ grid / weights.sum(), abs=0.01)
    below = last.components.mean[:, 0] < 0.0
    share = weights[grid < 0.0].sum() / weights.sum()
    assert last.weights[below].sum() == pytest.approx(share, abs=0.01)


def test_exact_answers_are_vouched_for():
    for model, evidence in ((walk, {z: [[4.0]]}), (rainy, {wet: "yes"})):
        verdict = pgm.estimate(model, evidence).verdict
        assert verdict.vouched
        assert verdict.within == 0.0
        assert verdict.of == "exact"
        assert "exact" in repr(verdict)


def test_a_network_without_time_has_both_modes():
    """Of x² read as 9, under N(3, 1): against quadrature."""
    found = pgm.estimate(square, {y: [9.0]})
    grid = np.linspace(-12.0, 12.0, 200_001)
    logs = -0.5 * (grid - 3.0) ** 2 - 0.5 * (9.0 - grid**2) ** 2
    weights = np.exp(logs - logs.max())
    step = grid[1] - grid[0]
    evidence = np.log(weights.sum() * step) + logs.max() - np.log(2.0 * np.pi)
    weights /= weights.sum()
    mean = weights @ grid
    assert found[x].mean[0] == pytest.approx(mean, abs=2e-3)
    assert found[x].std[0] == pytest.approx(np.sqrt(weights @ (grid - mean) ** 2), rel=0.02)
    assert found.log_evidence == pytest.approx(evidence, abs=0.01)


def test_runs_are_judged_each_by_itself_in_parts_of_any_size(monkeypatch):
    seen = squares.sample(steps=3, runs=(2, 3), rng=0).evidence
    whole = pgm.estimate(squares, seen)
    assert whole.verdict.vouched.shape == (2, 3)
    assert whole[x].mean.shape == (2, 3, 4, 1)
    climbing = pytest.importorskip("pgm.inference.vouching.climbing")
    monkeypatch.setattr(climbing, "ROOM", 1)
    parts = pgm.estimate(squares, seen)
    both = whole.verdict.vouched & parts.verdict.vouched
    near = np.abs(whole[x].mean - parts[x].mean)[both] / whole[x].std[both]
    assert near.max() < 0.3


def test_a_run_whose_draws_are_refused_leaves_the_others_theirs(monkeypatch):
    weighed = climbing._weighed

    def refusing(search, laws, *asked):
        if (np.abs(laws.mean) > 4.0).any():
            raise pgm.NumericalError("no draw has a density", run=0)
        return weighed(search, laws, *asked)

    monkeypatch.setattr(climbing, "_weighed", refusing)
    monkeypatch.setattr(
        climbing, "_recombined", lambda search, sought, answer, *asked: (sought, answer)
    )
    seen = np.array([[[1.0]], [[4.0]], [[36.0]], [[2.0]]])
    found = pgm.estimate(squares, {z: seen}, steps=1)
    assert found.verdict.vouched.tolist() == [True, True, False, True]
    assert np.isnan(found.verdict.within[2])
    assert found.verdict.draws[2] == 0
    assert "too few draws count (1)" in found.verdict.headline
    assert np.abs(found[x].components.mean[2, -1]).max() == pytest.approx(6.0, abs=0.3)
    alone = pgm.estimate(squares, {z: seen[2]}, steps=1)
    assert alone.verdict.reason == "nothing is weighed: no draw has a density"


def test_control_variates_that_lead_astray_are_not_used():
    """Of x² read as −5: draws worth some two hundred, and a control whose slope is cut."""
    read = pgm.NonlinearGaussianCPD(y, x, lambda x: x**2, cov=0.01)
    model = pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.0, 1.0), read])
    grid = np.linspace(-1.0, 1.0, 200_001)
    logs = -0.5 * grid**2 - 0.5 * (5.0 + grid**2) ** 2 / 0.01
    weights = np.exp(logs - logs.max())
    std = np.sqrt(weights @ grid**2 / weights.sum())
    for effort in (3000, 8000):
        found = pgm.estimate(model, {y: [-5.0]}, effort=effort)
        assert found.verdict.vouched
        assert found[x].std[0] == pytest.approx(std, rel=0.1)


@pytest.mark.parametrize("rng", [0, 10])
def test_modes_that_measurements_do_not_fit_are_not_vouched_for(rng):
    """A place by two heights of a terrain: of its many modes one start in thirty finds the best."""
    q = pgm.Variable("q", components=("here", "there"))
    drawn = np.random.default_rng(0)
    waves, phases = drawn.uniform(0.3, 3.0, 5), drawn.uniform(0, 6, 5)

    def terrain(x):
        heights = [
            sum(np.sin(k * at + p) / np.sqrt(k) for k, p in zip(waves, phases, strict=True))
            for at in (x, x + 0.7)
        ]
        return np.concatenate(heights, -1)

    place = drawn.normal(0.0, 3.0, (60, 1))
    seen = (terrain(place) + drawn.normal(0.0, 0.1, (60, 2)))[2]
    read = pgm.NonlinearGaussianCPD(q, x, terrain, cov=0.01)
    model = pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.0, 9.0), read])
    found = pgm.estimate(model, {q: seen}, rng=rng)
    right = abs(found[x].mean[0] - place[2, 0]) < 0.2
    assert right == bool(found.verdict.vouched)
    assert right != bool(found.verdict.unlikely)
    assert right or "measurements fit none of the modes" in found.verdict.headline


@pytest.mark.parametrize(
    ("model", "size"), slow_after(2, [(squares, 11), (square, 2), (MIRROR, 82)])
)
def test_noises_are_as_large_as_the_model_says(model, size, monkeypatch):
    """Of what is drawn from the model, the square of all noises is χ²."""
    squared = []

    def spy(pool, weighed):
        some = weighed.weights > 0.0
        logs = np.where(some, weighed.weights * np.where(some, pool.log_target, 0.0), 0.0)
        peak = pool.target.peak
        assert (peak.size == size).all()
        squared.append(2.0 * (peak.log_density - logs.sum(1) / weighed.weights.sum(1)))
        return np.full(peak.size.shape, False)

    monkeypatch.setattr(judging, "_unlikely", spy)
    if model is square:
        evidence = {y: square.sample(40, rng=1)[y]}
    else:
        asked = {"steps": 5} if model is squares else {"inputs": ASKED}
        evidence = model.sample(runs=40, rng=1, **asked).evidence
    pgm.estimate(model, evidence, effort=700)
    assert squared[0].mean() == pytest.approx(size, abs=4.0 * np.sqrt(2.0 * size / 40))


def test_a_posterior_without_density_has_its_answer_and_the_reason():
    read = pgm.NonlinearGaussianCPD(y, x, lambda x: x**2, cov=0.0)
    found = pgm.estimate(pgm.BayesianNetwork([pgm.GaussianCPD(x, 3.0, 1.0), read]), {y: [9.0]})
    assert "nothing is weighed: " in found.verdict.reason
    assert found[x].mean[0] == pytest.approx(3.0)
    none, all_seen = "no evidence is given", "all are observed"
    for evidence, told in (({}, none), ({x: [3.0], y: [9.0]}, all_seen)):
        reason = pgm.estimate(square, evidence).verdict.reason
        assert told in reason
        assert "starts=" not in reason


def test_a_start_that_fails_in_one_run_goes_on_in_the_others():
    """Of ln(x + u), which has no value at one start in six where u = −1."""
    u = pgm.Variable("u")

    def read(x, u):
        if (x + u <= 0.0).any():
            raise ValueError("no logarithm")
        return np.log(x + u)

    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 2.0, 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.01)],
        [pgm.NonlinearGaussianCPD(y, (x, u), read, cov=0.1)],
    )
    shift = np.array([10.0, -1.0, 10.0])[:, None, None]
    found = pgm.estimate(model, {u: shift, y: np.log(2.0 + shift)}, steps=1)
    starts = found.verdict.starts.tolist()
    assert starts[0] == starts[2] == 33
    assert starts[1] < 33
    assert found.verdict.vouched[[0, 2]].all()


def test_a_verdict_counts_starts_that_went_on_and_is_asked_by_run():
    read = pgm.NonlinearGaussianCPD(y, x, lambda x: x**2, cov=0.5)
    model = pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.0, 4.0), read])
    found = pgm.estimate(model, {y: [[4.0], [-1.0], [9.0]]})
    assert found.verdict.resumed[[0, 2]].tolist() == [0, 0]
    assert found.verdict.resumed[1] > 0  # where x² is to be −1, Gauss–Newton overshoots
    assert "more of starts that went on" in repr(found.verdict)
    alone = found.verdict[1]
    assert alone.within == found.verdict.within[1]
    assert np.shape(alone.vouched) == ()
    assert "at 1 mode\n" in repr(alone)
    assert found.verdict[:2].modes.tolist() == [2, 1]
    with pytest.raises(pgm.ModelError, match=r"Verdict\(.*0 leading axes"):
        alone[0]
    with pytest.raises(TypeError, match="not iterable"):
        iter(alone)
    assert "1 of no weight" in repr(found[x][1])
    assert "of no weight" not in repr(found[x][0])


def test_a_verdict_says_whether_moments_are_of_draws():
    read = pgm.NonlinearGaussianCPD(y, x, lambda x: x**2, cov=1e-6)
    model = pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.0, 4.0), read])
    seen = {y: [[1.0], [2.0]]}
    assert "with moments of the draws\n" in repr(pgm.estimate(model, seen).verdict)
    few = pgm.estimate(model, seen, effort=40).verdict
    assert "as iterations found them, since too few draws count" in repr(few)


@pytest.mark.parametrize("shape", [(3,), (3, 1)])
def test_runs_of_a_model_are_answered_each_by_itself(shape):
    """Where CPDs differ by run, of which some need more starts or draws than others."""
    means, covs = np.array([-1.0, 0.6, 3.0]), np.array([0.12, 0.6, 1.2])

    def model(mean, cov):
        seen = pgm.NonlinearGaussianCPD(y, x, lambda x: np.sin(2.0 * x), cov=0.05)
        return pgm.BayesianNetwork([pgm.GaussianCPD(x, mean, cov), seen])

    whole = pgm.estimate(model(means.reshape(*shape, 1), covs.reshape(*shape, 1, 1)), {y: [0.5]})
    assert whole.verdict.vouched.shape == shape
    for k, (mean, cov) in enumerate(zip(means, covs, strict=True)):
        own = pgm.estimate(model(mean, cov), {y: [0.5]})
        assert whole.verdict.vouched.ravel()[k]
        near = abs(whole[x].mean.ravel()[k] - own[x].mean[0]) / own[x].std[0]
        assert near < 0.1


def test_what_comes_before_a_state_in_its_step_is_known_by_its_place():
    """A push without noise beside it, of a state whose square is read: against a grid."""
    push, state, seen = pgm.variables("push state seen")
    moved = pgm.LinearGaussianCPD(state, {state.previous: 1.0, push: 1.0}, cov=0.0)
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(state, 1.0, 1.0)],
        transition=[pgm.GaussianCPD(push, 0.5, 0.5), moved],
        observation=[pgm.NonlinearGaussianCPD(seen, state, lambda x: x**2, cov=0.5)],
    )
    found = pgm.estimate(model, {seen: [[4.0]]})
    before, own = np.meshgrid(*[np.linspace(-8.0, 8.0, 801)] * 2, indexing="ij")
    after = before + own
    logs = (before - 1.0) ** 2 + (own - 0.5) ** 2 / 0.5 + (4.0 - after**2) ** 2 / 0.5
    weights = np.exp(-0.5 * logs)
    weights /= weights.sum()
    for variable, values in ((push.at(1), own), (state.at(0), before), (state.at(1), after)):
        mean = (weights * values).sum()
        std = np.sqrt((weights * (values - mean) ** 2).sum())
        assert found[variable].mean[0] == pytest.approx(mean, abs=0.05 * std)
        assert found[variable].std[0] == pytest.approx(std, rel=0.05)


def test_robust_readings_of_a_network_without_time():
    """Student's t: against quadrature."""
    read = pgm.LinearGaussianCPD(y, {x: 1.0}, cov=1.0, noise=pgm.StudentT(3.0))
    found = pgm.estimate(pgm.BayesianNetwork([pgm.GaussianCPD(x, 0.0, 9.0), read]), {y: [4.0]})
    grid = np.linspace(-20.0, 20.0, 20_001)
    weights = np.exp(-(grid**2) / 18.0) * (1.0 + (4.0 - grid) ** 2 / 3.0) ** -2.0
    weights /= weights.sum()
    mean = weights @ grid
    assert found.verdict.vouched
    assert found[x].mean[0] == pytest.approx(mean, abs=0.05)
    assert found[x].std[0] == pytest.approx(np.sqrt(weights @ (grid - mean) ** 2), rel=0.05)


def test_what_cannot_be_weighed_says_why():
    assert "no evidence is given" in pgm.estimate(square, {}).verdict.reason
    assert "all are observed" in pgm.estimate(square, {x: [3.0], y: [9.0]}).verdict.reason
    flat = walk.replace(prior=[pgm.GaussianCPD(x, 0.0, np.inf)])
    cubic = pgm.NonlinearGaussianCPD(z, given=x, function=lambda x: x + x**3, cov=1.0)
    model = flat.replace(observation=[cubic])
    found = pgm.estimate(model, {z: [[10.0], [10.0]]})
    assert not found.verdict.vouched
    assert "infinite variance" in found.verdict.reason
    assert "NOT vouched for" in repr(found)
    assert found[x].mean[-1, 0] == pytest.approx(2.0, abs=0.05)


def test_there_are_no_draws_of_an_estimate_and_no_loop():
    with pytest.raises(pgm.errors.Unanswered, match=r"pgm\.smooth or pgm\.infer"):
        pgm.estimate(square, {y: [9.0]}).sample(3, rng=0)
    with pytest.raises(TypeError, match="no argument online="):
        pgm.estimate(square, {y: [9.0]}, online=True)


def test_arguments_are_checked():
    with pytest.raises(pgm.ModelError, match="effort is a number of draws"):
        pgm.estimate(walk, {z: [[4.0]]}, effort=3)
    with pytest.raises(pgm.ModelError, match="takes a network"):
        pgm.estimate("walk", {z: [[4.0]]})
    with pytest.raises(pgm.ModelError, match="has no steps"):
        pgm.estimate(square, {y: [9.0]}, steps=3)
    with pytest.raises(pgm.EvidenceError):
        pgm.estimate(square, {x: [[1.0, 2.0]]})
    assert pgm.smooth(walk, {z: [[4.0]]}).verdict is None


@pytest.mark.parametrize(
    ("together", "answered"), [(False, [0, 1, 3, 4]), (True, [])], ids=["apart", "together"]
)
def test_a_run_that_a_way_refuses_keeps_its_answer_alone(together, answered):
    def way(search, sought, answer, left, effort, rng):
        if 2 in left:
            raise pgm.PgmError("run 2")
        return sought, [*answer, *left.tolist()]

    search = SimpleNamespace(together=together)
    _, found = climbing._tried(way, search, None, [], np.arange(5), 1000, None)
    assert found == answered


@pytest.mark.parametrize("question", ["innovations", "lost", "filtered", "nonlinearity", "weights"])
def test_modes_name_the_posteriors_that_have_what_they_lack(question):
    found = pgm.estimate(squares, {z: [[9.0], [9.1]]}, effort=200)
    with pytest.raises(pgm.PgmError, match=r"mixtures of modes have none; a posterior of one lin"):
        getattr(found, question)
    with pytest.raises(pgm.PgmError, match=r"posterior\.verdict tells how well"):
        pgm.audit(found, rng=1)


def test_a_model_that_measurements_do_not_fit_is_told_of_with_one_mode_too():
    """The answer is that model's own, and vouched for as such."""
    curved = pgm.NonlinearGaussianCPD(z, x, lambda x: 30.0 * np.sinh(x / 30.0), cov=2.0)
    model = walk.replace(observation=[curved])
    right = model.sample(runs=20, steps=4, rng=1).evidence[z]
    wrong = np.array([[[0.0], [20.0], [0.0], [20.0]]])
    found = pgm.estimate(model, {z: np.concatenate([right, wrong])}, effort=1000)
    verdict = found.verdict
    assert verdict.unlikely.tolist() == [False] * 20 + [True]
    assert verdict.vouched.all()
    assert verdict.modes.max() == 1
    assert "by a model that the measurements do not fit (in 1 of 21 runs)" in verdict.headline
    assert "the measurements do not fit" in " ".join(repr(found).split())
    assert "do not fit" not in repr(pgm.estimate(model, {z: right[0]}, effort=1000))
