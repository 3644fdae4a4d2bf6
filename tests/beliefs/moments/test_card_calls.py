"""Calls on a card, whose driver is a fake one with the interpreter of its code behind it."""

import numpy as np
import pytest
from card import forget, needs_libdevice, with_a
from fake_driver import Driver
from numpy.testing import assert_array_equal
from robots import m, sighted
from test_compiled import assert_posterior
from zoo import MODELS, RULES, SIGHT, plain, recording

import pgm
from pgm.beliefs.moments.compiled.spans import spans_of
from pgm.kernels.machine.emitter import card as target

needs_libdevice()
CARD = pgm.Compiled(device="cuda")


@pytest.fixture
def driver(monkeypatch):
    """A machine with a card."""
    return with_a(Driver(), monkeypatch)


@pytest.fixture(autouse=True)
def forgotten():
    """No card of one test is that of another."""
    forget()
    yield
    forget()


def fresh(model):
    return pgm.DynamicBayesianNetwork(model.prior, model.transition, model.observation)


def pair(infer, model, evidence, **options):
    return [infer(fresh(model), evidence, compiled=c, **options) for c in (CARD, False)]


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("plain", "taylor"),
        ("plain", "unscented"),
        ("everything", "taylor"),
        ("noise by control", "taylor"),
        ("grouped", "unscented"),
    ],
)
def test_smoothers_of_all_kinds(name, rule, driver):
    found = pair(pgm.smooth, MODELS[name], recording(name), lineariser=RULES[rule])
    assert_posterior(*found, 1e-12)
    assert driver.launched == [(1, 128), (1, 128)]
    assert not driver.taken
    assert not driver.contexts


@pytest.mark.parametrize("runs", [1, 9, 130])
def test_many_runs(runs, driver):
    evidence = sighted(runs, steps=3)
    found = pair(pgm.filter, plain(), evidence)
    assert_posterior(*found, 1e-12, smooth=False)
    assert set(driver.launched) == {(-(-runs // 128), 128)}


@pytest.mark.parametrize(
    "schedule",
    [pgm.Filtering(gate=0.9), pgm.FixedLag(2, iterations=20), pgm.Smoothing(iterations=9)],
)
def test_schedules(schedule, driver):
    evidence, found = sighted(3, steps=8), []
    for choice in (CARD, False):
        graph = pgm.compile(plain(sensor=SIGHT.cpd(noise=None)), 8, compiled=choice)
        found.append(pgm.infer(graph, evidence, schedule=schedule))
    x = plain().states[0]
    assert (np.abs(found[0][x].mean - found[1][x].mean) <= 1e-9 * found[1][x].std).all()
    assert driver.launched


def test_second_calls_find_the_kernels_of_the_first(driver):
    model, loads = plain(), []
    made = driver.cuModuleLoadData
    driver.cuModuleLoadData = lambda image: loads.append(image) or made(image)
    for _ in range(2):
        found = pgm.smooth(model, sighted(2, steps=3), compiled=CARD)
    assert len(loads) == 2
    assert len(driver.launched) == 4
    assert found.status.compilation == "compiled, on a card"


def test_a_study(driver):
    model = plain()
    evidence = {each: value for each, value in sighted(steps=4).items() if each in model.inputs}
    seen = pgm.sightings(step=np.arange(5), given={m: np.zeros((5, 2)) + 3.0})
    options = {"evidence": {**evidence, SIGHT.z: seen}, "runs": 6, "seed": 1}
    options["methods"] = {"EKF": pgm.Taylor()}
    ours, theirs = (pgm.study(fresh(model), compiled=c, **options)["EKF"] for c in (CARD, False))
    assert ours.nees.value == pytest.approx(theirs.nees.value, rel=1e-12)
    assert ours.nis[SIGHT.z].value == pytest.approx(theirs.nis[SIGHT.z].value, rel=1e-12)
    assert driver.launched


def test_a_function_that_is_called_is_left_to_the_processor(driver):
    def rule(function, at):
        return pgm.Cubature()(function, at)

    found = pair(pgm.filter, plain(sensor=SIGHT.cpd(lineariser=rule)), sighted(2, steps=3))
    assert_posterior(*found, smooth=False)
    assert not driver.launched
    assert "called back" in str(found[0].status.compilation)


# What is refused


def refused(error, words, call=pgm.filter, model=None):
    with pytest.raises(error, match=words):
        call(model or plain(), sighted(2, steps=3), compiled=CARD)


@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
def test_without_the_extra(call, monkeypatch):
    with_a(None, monkeypatch)
    refused(ImportError, r"device='cuda'\)\) needs cuda: pip install 'sepset\[gpu\]'", call)


def test_without_libdevice(driver, monkeypatch):
    monkeypatch.setattr(target, "_LIBRARIES", ())
    refused(ImportError, "libdevice, which is not installed")


def test_without_a_card(monkeypatch):
    with_a(Driver(cards=0), monkeypatch)
    refused(pgm.ExecutorError, "this machine has no card: no CUDA-capable device")


def test_without_a_driver(monkeypatch):
    class Missing(Driver):
        def cuInit(self, flags):
            raise LookupError("libcuda.so is not found")

    with_a(Missing(), monkeypatch)
    refused(pgm.ExecutorError, "this machine has no driver of NVIDIA's cards")


def test_a_driver_that_is_too_old(monkeypatch):
    with_a(Driver(version=11040), monkeypatch)
    refused(pgm.ExecutorError, r"too old: it knows CUDA 11\.4, and 12\.0 was due; update it")


def test_a_card_that_is_too_old(monkeypatch):
    with_a(Driver(capability=(6, 1)), monkeypatch)
    refused(pgm.ExecutorError, r"7\.5 and later, not of 6\.1")


def test_memory_that_does_not_suffice(monkeypatch):
    driver = with_a(Driver(memory=2000), monkeypatch)
    refused(pgm.ExecutorError, "a single run's arrays take .* GiB, and the card has .* GiB .* free")
    assert not driver.taken
    assert not driver.contexts


def test_a_driver_that_fails(monkeypatch):
    class Failing(Driver):
        def cuCtxSynchronize(self):
            return (1,)

    driver = with_a(Failing(), monkeypatch)
    refused(pgm.ExecutorError, "could not be swept on the card: .* failed: invalid argument")
    assert not driver.taken
    assert not driver.contexts


def test_code_that_the_driver_refuses(monkeypatch):
    class Failing(Driver):
        def cuModuleLoadData(self, image):
            return 1, None

    with_a(Failing(), monkeypatch)
    refused(pgm.ExecutorError, "a sweep cannot be made for the card: .* invalid argument")


def test_other_devices_are_refused():
    with pytest.raises(pgm.ModelError, match=r"device='metal'.*'cuda' is known"):
        pgm.Compiled(device="metal")


def test_what_is_no_chain_of_runs_is_refused(driver):
    a = pgm.variables("a b")[0]
    with pytest.raises(pgm.ModelError, match="a card sweeps the runs of a dynamic network"):
        pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(a, 0.0, 1.0)]), compiled=CARD)
    with pytest.raises(pgm.ModelError, match="a card sweeps the runs of a dynamic network"):
        pgm.OnlineFilter(plain(), compiled=CARD)


def test_mixtures_are_left_to_the_processor(driver):
    mode, place = pgm.Discrete("mode", states=("a", "b")), pgm.Variable("place")
    moves = {k: pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=1.0 + k) for k in range(2)}
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(mode, table=[0.5, 0.5]), pgm.GaussianCPD(place, 0.0, 1.0)],
        [
            pgm.TableCPD(mode, given=mode.previous, table=[[0.9, 0.1], [0.3, 0.7]]),
            pgm.SwitchingCPD(place, mode, moves),
        ],
        [pgm.LinearGaussianCPD(SIGHT.z.template, {place: [[1.0], [2.0]]}, cov=0.3)],
    )
    evidence = {SIGHT.z: np.ones((2, 4, 2))}
    ours, theirs = pair(pgm.filter, model, evidence, belief=pgm.Gaussians(2))
    np.testing.assert_allclose(ours[place].mean, theirs[place].mean, rtol=0, atol=1e-12)
    assert ours.status.compilation == "compiled"
    assert not driver.launched


def test_spans_of_arrays_that_share_memory():
    whole, other = np.zeros(100), np.zeros(8)
    fixed = whole[10:20]
    fixed.flags.writeable = False
    parts = [whole[5:12], fixed, other[::-2], np.broadcast_to(whole[90:91], (4,))]
    found = {each.first: each for each in spans_of(parts)}
    first = whole.ctypes.data
    assert_array_equal(sorted(each.length for each in found.values()), [8, 56, 8 * 15])
    assert found[first + 40].length == 8 * 15
    assert found[first + 40].written
    assert not found[first + 720].written
    assert not spans_of([fixed])[0].written


def test_particles_are_moved_by_the_processor(driver):
    few = pgm.Particles(1000, seed=1)
    evidence = recording("plain")
    found = pgm.filter(fresh(MODELS["plain"]), evidence, belief=few, compiled=CARD)
    due = pgm.filter(fresh(MODELS["plain"]), evidence, belief=few, compiled=True)
    assert "a card has no particles" in found.status.compilation
    assert_array_equal(found.log_evidence, due.log_evidence)
    assert not driver.launched
