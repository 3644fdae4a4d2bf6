"""Studies on a card, whose driver is a fake one with the interpreter of its code behind it."""

import numpy as np
import pytest
from card import needs_libdevice
from fake_driver import Driver, install
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.beliefs.moments.solvers import laid
from pgm.comparison import card_blocks, drawn_runs, studying
from pgm.comparison.study_methods import methods_of
from pgm.compile.machine import Squared
from pgm.kernels.machine.emitter import driver as drivers
from pgm.networks import card_draws

needs_libdevice()
CARD = pgm.Compiled(device="cuda")
T = 4
x = pgm.Variable("x", components=("east", "heading"), angles=("heading",))
w = pgm.Variable("w")
u = pgm.Variable("u")
m = pgm.Variable("m")
z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
fix = pgm.Variable("fix")


def move(x, u):
    turned = x[..., 1] + u[..., 0]
    return np.stack([x[..., 0] + 0.3 * np.cos(turned), turned], axis=-1)


def sight(x, m):
    away = m[..., 0] - x[..., 0]
    return np.stack([np.hypot(away, 1.0), np.arctan2(away, 1.0) - x[..., 1]], axis=-1)


def robot(sight=sight, noise=None, several=False):
    """A robot with two sensors; with `several` states beside it one that walks."""
    beside = [pgm.LinearGaussianCPD(w, {w.previous: 0.9}, cov=0.1)] if several else []
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0.0, 3.0], [0.04, 0.01]), *[pgm.GaussianCPD(w, 1.0, 0.3)] * several],
        [pgm.NonlinearGaussianCPD(x, (x.previous, u), move, cov=[0.02, 0.01]), *beside],
        [
            pgm.NonlinearGaussianCPD(z, (x, m), sight, cov=[0.1, 0.05]),
            pgm.LinearGaussianCPD(fix, {x: [[1.0, 0.0]]}, cov=0.2, noise=noise),
        ],
    )


def steered():
    """A robot whose control is hidden."""
    model, v = robot(several=True), pgm.Variable("v")
    first, beside = model.transition
    steering = pgm.LinearGaussianCPD(v, {u: 1.0}, cov=0.01)
    moved = pgm.NonlinearGaussianCPD(x, (x.previous, v), move, cov=first.cov)
    return model.replace(transition=[steering, moved, beside])


INPUTS = {
    u: np.linspace(-0.3, 0.3, T)[:, None],
    z: pgm.sightings(step=[4, 1, 1, 0], given={m: [[2.0], [4.0], [6.0], [8.0]]}),
    fix: pgm.sightings(step=[3, 2]),
}


@pytest.fixture(scope="module")
def card():
    """A machine with a card, the same of all tests, so that kernels are loaded once."""
    with pytest.MonkeyPatch.context() as patched:
        drivers.device.cache_clear()
        yield install(patched, Driver())
    drivers.device.cache_clear()


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Blocks of a few runs."""
    monkeypatch.setattr(drawn_runs, "MOST", 3)


@pytest.fixture
def parts(monkeypatch):
    """How many runs each part had that the card has drawn."""
    found, plain = [], card_draws.LaidDraws.draw

    def draw(self, device, first, runs):
        found.append(runs)
        return plain(self, device, first, runs)

    monkeypatch.setattr(card_draws.LaidDraws, "draw", draw)
    return found


def studied(model, methods, compiled=CARD, runs=8, **given):
    options = {"evidence": INPUTS, "steps": T, "seed": 5} | given
    return pgm.study(model, runs=runs, methods=methods, compiled=compiled, **options)


def figures(found):
    """All statistics of a study, by method, state and name."""
    return {
        (row.method, row.state, name, each): getattr(statistic, each)
        for row in found.rows
        for name, statistic in row._statistics().items()
        for each in ("value", "error", "by_step", "error_by_step")
    }


def assert_same(found, other, atol=1e-12):
    ours, theirs = figures(found), figures(other)
    assert ours.keys() == theirs.keys()
    for key, each in ours.items():
        assert_allclose(each, theirs[key], rtol=1e-12, atol=atol, err_msg=str(key))
    for row, its in zip(found.rows, other.rows, strict=True):
        assert row.worst == its.worst
        assert_array_equal(row.diverged, its.diverged)
        assert_array_equal(row.failed, its.failed)
        assert row.runs == its.runs


def test_figures_are_those_of_numpy(card, parts):
    methods = {"F": pgm.Taylor()}
    found = studied(robot(), methods)
    assert found.compilation == "drawn, swept and summed on a card: F"
    assert found.compilation in str(found)
    assert_same(found, studied(robot(), methods, False))
    assert parts == [8]
    assert not card.taken
    assert not card.contexts


@pytest.mark.slow
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented(), pgm.Cubature()], ids=str)
def test_filters_of_several_states(rule, card):
    methods = {"F": rule, "again": (rule, pgm.Filtering())}
    found = studied(robot(several=True), methods)
    assert found.compilation == "drawn, swept and summed on a card: F, again"
    assert_same(found, studied(robot(several=True), methods, False))


@pytest.mark.parametrize(
    ("tolerance", "damping"),
    [(5e-3, 0.0), pytest.param(1e-6, 0.3, marks=pytest.mark.slow)],
)
def test_iterated_filters_too(tolerance, damping, card, parts):
    schedule = pgm.Filtering(iterations=2, tolerance=tolerance, damping=damping)
    found = studied(robot(), {"IEKF": schedule})
    assert found.compilation.endswith("on a card: IEKF")
    other = studied(robot(), {"IEKF": schedule}, False)
    assert_same(found, other)
    assert 0 < found["IEKF"].unsettled == other["IEKF"].unsettled
    assert len(parts) == 1


@pytest.mark.slow
@pytest.mark.parametrize("rule", [pgm.Taylor(), pgm.Unscented()], ids=str)
def test_smoothers_of_several_states(rule, card):
    methods = {"RTS": (rule, pgm.Smoothing())}
    found = studied(robot(several=True), methods)
    assert found.compilation.endswith("on a card: RTS")
    assert_same(found, studied(robot(several=True), methods, False))


@pytest.mark.slow
def test_filters_with_a_hidden_control(card):
    found = studied(steered(), {"F": pgm.Taylor()})
    assert found.compilation.endswith("on a card: F")
    assert_same(found, studied(steered(), {"F": pgm.Taylor()}, False))


@pytest.mark.parametrize(
    "rule", [pgm.Taylor(), pytest.param(pgm.Unscented(), marks=pytest.mark.slow)], ids=str
)
def test_smoothers_too(rule, card, parts):
    methods = {"RTS": (rule, pgm.Smoothing())}
    found = studied(robot(), methods)
    assert found.compilation.endswith("on a card: RTS")
    assert_same(found, studied(robot(), methods, False))


def test_a_single_run(card):
    found = studied(robot(), {"F": pgm.Taylor()}, runs=1)
    assert found.compilation.endswith("on a card: F")
    assert_same(found, studied(robot(), {"F": pgm.Taylor()}, False, runs=1))


def test_how_many_blocks_are_a_part_is_no_matter(card, parts, monkeypatch):
    """Bit for bit, in a study of more runs, in parts, and with little memory."""
    methods = {"F": pgm.Taylor()}
    whole = studied(robot(), methods, runs=11)
    monkeypatch.setattr(card_blocks, "MOST", 2)
    divided = studied(robot(), methods, runs=11)
    for key, each in figures(whole).items():
        assert_array_equal(each, figures(divided)[key])
    assert parts == [11, 6, 5]
    assert whole.compilation == divided.compilation


def test_little_memory_takes_more_parts(parts, monkeypatch):
    drivers.device.cache_clear()
    with monkeypatch.context() as patched:
        install(patched, Driver(memory=42_000))
        found = studied(robot(), {"F": pgm.Taylor()})
    drivers.device.cache_clear()
    assert parts == [3, 3, 2]
    assert_same(found, studied(robot(), {"F": pgm.Taylor()}, False))


def test_a_block_that_does_not_fit_is_drawn_by_the_processor(parts, monkeypatch):
    drivers.device.cache_clear()
    with monkeypatch.context() as patched:
        install(patched, Driver(memory=12_000))
        found = studied(robot(), {"F": pgm.Taylor()}, runs=4)
    drivers.device.cache_clear()
    assert not parts
    assert "F drawn and summed by the processor: 3 runs take " in found.compilation
    assert_same(found, studied(robot(), {"F": pgm.Taylor()}, False, runs=4))


def test_a_driver_that_fails(monkeypatch):
    class Failing(Driver):
        def cuCtxSynchronize(self):
            return (1,)

    drivers.device.cache_clear()
    with monkeypatch.context() as patched:
        driver = install(patched, Failing())
        with pytest.raises(pgm.ExecutorError, match=r"card of the study has failed: .* invalid"):
            studied(robot(), {"F": pgm.Taylor()})
    drivers.device.cache_clear()
    assert not driver.taken
    assert not driver.contexts


def test_beliefs_and_runs_stay_there(card, monkeypatch):
    """Of arrays that grow by runs and steps none comes home; of each block one run does."""
    sizes = {}
    for runs in (4, 8):
        home = []
        plain = card.cuMemcpyDtoH
        with monkeypatch.context() as patched:
            patched.setattr(drawn_runs, "MOST", 4)

            def copied(address, place, count, home=home, plain=plain):
                home.append(count)
                return plain(address, place, count)

            patched.setattr(card, "cuMemcpyDtoH", copied)
            studied(robot(), {"F": pgm.Taylor()}, runs=runs)
        sizes[runs] = sum(home)
    # The sums and one run of a block, and for each run: whether it is finite, how it ended, and
    # the largest and the last NEES.
    each = 8 * (1 + 5 + 2)
    block = 8 * (T + 1) * 8 * 3 + 8 * 8 * 6 + 8 * (T + 1) * (2 + 2 + 4 + 2 + 4)
    assert sizes[4] == pytest.approx(block + 4 * each, abs=8 * 40)
    assert sizes[8] - sizes[4] == pytest.approx(block + 4 * each, abs=8 * 40)


def cubic():
    a, b = pgm.variables("a b")
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, 2.5, 0.5)],
        [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.2)],
        [pgm.NonlinearGaussianCPD(b, (a,), lambda a: a**3, cov=0.04)],
    )


def test_runs_that_need_care_are_done_by_themselves(card, parts, monkeypatch):
    monkeypatch.setattr(drawn_runs, "MOST", 32)
    options = {"evidence": {}, "runs": 64, "steps": 3}
    found = studied(cubic(), {"F": pgm.Taylor()}, **options)
    assert found.compilation.startswith("drawn, swept and summed on a card: F but for ")
    assert "done with care" in found.compilation
    assert_same(found, studied(cubic(), {"F": pgm.Taylor()}, True, **options), atol=1e-9)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_care_of_some_runs_of_a_block_or_of_all(share, card, monkeypatch):
    def sweep(self, device, runs, plain=laid.Laid.sweep):
        fine = plain(self, device, runs)
        fine[[1, 5, 6]] = False
        return fine

    monkeypatch.setattr(laid.Laid, "sweep", sweep)
    monkeypatch.setattr(card_blocks, "_MANY", share)
    found = studied(robot(), {"F": pgm.Taylor()})
    told = "3 runs" if share else "8 runs"
    assert found.compilation == (
        f"drawn, swept and summed on a card: F but for {told}, which had to be done with care"
    )
    assert_same(found, studied(robot(), {"F": pgm.Taylor()}, True))


def known():
    """A state whose second component is known for certain at steps 0 and 1."""
    s, r = pgm.Variable("s", components=("a", "b")), pgm.Variable("r")
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(s, [0.0, 1.0], [1.0, 0.0])],
        [pgm.LinearGaussianCPD(s, {s.previous: [[1.0, 1.0], [0.0, 1.0]]}, cov=[0.1, 0.0])],
        [pgm.LinearGaussianCPD(r, {s: [[1.0, 0.0]]}, cov=0.2)],
    )


def test_covariances_that_are_singular_have_no_nees(card):
    options = {"evidence": {}, "steps": 3}
    found = studied(known(), {"F": pgm.Taylor()}, **options)
    assert np.isnan(found["F"].nees.value)
    assert found["F"].worst is None
    assert_same(found, studied(known(), {"F": pgm.Taylor()}, False, **options))


def words(model, methods, inputs=INPUTS):
    """What a study would say of methods before it begins."""
    drawn = drawn_runs.drawn_runs(model, inputs, T, 4, 5)
    graph = pgm.compile(model, T, compiled=Squared(device="cuda"))
    asked = studying._Asked(graph, graph, model.states, 0.95)
    return studying._on_card(drawn, methods_of(methods, model), asked).words


@pytest.mark.parametrize(
    ("method", "why"),
    [
        (pgm.Smoothing(iterations=3), "it linearises all steps again"),
        (
            pgm.Filtering(iterations=3, damping=pgm.LevenbergMarquardt()),
            "its steps are controlled",
        ),
        (pgm.Filtering(gate=0.9), "it has a gate"),
        (pgm.FixedLag(2), "it has a lag"),
        (pgm.Smoothing(), "it smooths hidden controls"),
        (pgm.Unscented(alpha=1e-3), "the weights of its points cancel"),
        (pgm.Particles(100, seed=1), "it is a family of beliefs"),
        pytest.param(
            lambda function, at: pgm.Cubature()(function, at), "it is linearised by", id="own rule"
        ),
    ],
    ids=str,
)
def test_methods_that_a_card_cannot_do_are_told(method, why, card):
    told = words(steered(), {"EKF": pgm.Taylor(), "it": method})
    assert told.startswith("drawn, swept and summed on a card: EKF; it drawn and summed by the ")
    assert why in told


def test_large_slices_of_several_cpds_are_told(card):
    wide, model = pgm.Variable("wide", components=tuple("abcdefghijk")), robot()
    still = pgm.LinearGaussianCPD(wide, {wide.previous: np.eye(11)}, cov=np.eye(11))
    model = model.replace(
        prior=[*model.prior, pgm.GaussianCPD(wide, np.zeros(11), np.eye(11))],
        transition=[*model.transition, still],
    )
    told = words(model, {"RTS": pgm.Smoothing()})
    assert told.endswith("it smooths several CPDs a step of more than 12 components")


def test_groups_of_sightings_are_told(card):
    model = robot()
    first, second = model.observation
    grouped = pgm.NonlinearGaussianCPD(z, (x, m), sight, cov=first.cov, grouped=True)
    told = words(model.replace(observation=[grouped, second]), {"UKF": pgm.Unscented()})
    assert (
        told == "UKF drawn and summed by the processor: sightings of a step have errors in common"
    )


def test_methods_that_a_card_cannot_do_have_the_same_figures(card, parts):
    methods = {"EKF": pgm.Taylor(), "gated": pgm.Filtering(gate=0.9)}
    found = studied(robot(), methods, runs=4)
    assert parts == [4]
    assert found.compilation == (
        "drawn, swept and summed on a card: EKF; "
        "gated drawn and summed by the processor: it has a gate"
    )
    assert_same(found, studied(robot(), methods, False, runs=4), atol=1e-10)


def test_noise_that_is_not_gaussian_is_drawn_by_the_processor(card):
    model = robot(noise=pgm.StudentT(4.0))
    told = words(model, {"F": pgm.Taylor()})
    assert told == "F drawn and summed by the processor: the noise of fix is StudentT(dof=4.0)"


def test_models_that_switch_are_drawn_by_the_processor(card):
    mode = pgm.Discrete("mode", states=("a", "b"))
    moves = {k: pgm.LinearGaussianCPD(w, {w.previous: 1.0}, cov=1.0 + k) for k in range(2)}
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(mode, table=[0.5, 0.5]), pgm.GaussianCPD(w, 0.0, 1.0)],
        [
            pgm.TableCPD(mode, given=mode.previous, table=[[0.9, 0.1], [0.3, 0.7]]),
            pgm.SwitchingCPD(w, mode, moves),
        ],
        [pgm.LinearGaussianCPD(fix, {w: 1.0}, cov=0.3)],
    )
    given = {"evidence": {}, "runs": 3}
    found = studied(model, {"IMM": pgm.Filtering()}, **given)
    assert "IMM drawn and summed by the processor: TableCPD(mode)" in found.compilation
    assert_same(found, studied(model, {"IMM": pgm.Filtering()}, False, **given), atol=1e-10)


def test_runs_that_are_drawn_one_by_one_are_told(card):
    drawn = drawn_runs.drawn_runs(robot(), INPUTS, T, 4, 5)._replace(counted=False)
    graph = pgm.compile(robot(), T, compiled=Squared(device="cuda"))
    asked = studying._Asked(graph, graph, (x,), 0.95)
    told = studying._on_card(drawn, methods_of({"F": pgm.Taylor()}, robot()), asked).words
    assert (
        told == "F drawn and summed by the processor: each run is drawn by a generator of its own"
    )


def test_functions_that_cannot_be_traced_are_told(card):
    def decides(x, m):
        return sight(x, m) * (2.0 if x[..., 0].max() > 0.3 else 1.0)

    told = words(robot(sight=decides), {"F": pgm.Taylor()})
    assert told.startswith("F drawn and summed by the processor: NonlinearGaussianCPD(z")
    assert "branches on a value" in told


@pytest.mark.parametrize("late", [False, True])
def test_functions_that_change_are_found(late, card, monkeypatch):
    """When their runs are drawn, or swept."""
    scale = [1.0]

    def changes(x, m):
        return sight(x, m) * scale[0]

    owner, name = (laid.Laid, "sweep") if late else (card_draws.LaidDraws, "draw")
    plain = getattr(owner, name)

    def done(*given):
        found = plain(*given)
        scale[0] = 1.5
        return found

    monkeypatch.setattr(owner, name, done)
    found = studied(robot(sight=changes), {"F": pgm.Taylor()}, runs=4)
    assert "other values than its trace" in found.compilation
    assert_same(found, studied(robot(sight=changes), {"F": pgm.Taylor()}, False, runs=4), 1e-9)


def test_a_study_goes_on_with_the_digits_of_one(card, tmp_path):
    methods = {"F": pgm.Taylor()}
    studied(robot(), methods, runs=6, file=tmp_path / "study.npz")
    more = studied(robot(), methods, runs=11, file=tmp_path / "study.npz")
    for key, each in figures(studied(robot(), methods, runs=11)).items():
        assert_array_equal(each, figures(more)[key])


def test_workers_and_oracles_are_without_a_card(card, parts):
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(2) as pool:
        found = studied(robot(), {"F": pgm.Taylor()}, runs=4, executor=pool)
    assert not parts
    assert found.compilation == ""
    assert_same(found, studied(robot(), {"F": pgm.Taylor()}, False, runs=4))


def test_draws_that_are_not_finite_are_refused(card):
    def leaves(x, u):
        return move(x, u) + np.log(x[..., :1] + 0.2)

    model = robot()
    moved = pgm.NonlinearGaussianCPD(x, (x.previous, u), leaves, cov=[0.02, 0.01])
    model = model.replace(transition=[moved])
    texts = []
    for choice in (CARD, False):
        with pytest.raises(pgm.LinearisationError) as found:
            studied(model, {"F": pgm.Taylor()}, choice)
        texts.append(str(found.value))
    assert texts[0] == texts[1]
