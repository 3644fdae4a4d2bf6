"""Evidence that lies on a card, and beliefs that stay there, by a fake driver's memory."""

import dataclasses
import gc
import pickle
import re
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from card import forget, needs_libdevice, with_a
from cuda_arrays import CudaArray, DlpackArray
from fake_driver import Driver
from numpy.testing import assert_allclose, assert_array_equal
from robots import Q, m, sighted, u, x
from zoo import MODELS, RULES, SIGHT, bias, command, drifting, near_noise, plain, recording

import pgm
from pgm.evidence import Sightings
from pgm.kernels import dlpack
from pgm.posteriors import on_card

needs_libdevice()
CARD = pgm.Compiled(device="cuda")
z = SIGHT.z


@pytest.fixture(autouse=True)
def forgotten():
    """No card of one test is that of another."""
    forget()
    yield
    forget()


@pytest.fixture
def driver(monkeypatch):
    """A machine with a card."""
    return with_a(Driver(), monkeypatch)


def put(driver, evidence, which, kind=CudaArray, **options):
    """The evidence, with the numbers of some variables on the card."""
    made, found = partial(kind, driver, **options), {}
    for variable, value in evidence.items():
        if isinstance(value, Sightings):
            given = {v: made(rows) if v in which else rows for v, rows in value.given.items()}
            values = made(value.values) if variable in which else value.values
            found[variable] = pgm.sightings(values, step=value.step, given=given)
        else:
            found[variable] = made(value) if variable in which else value
    return found


def assert_on_card(found, due, tolerance=1e-10):
    """What lies on the card, and what has come home, are the beliefs that are due."""
    model = due.graph.model
    for variable in (*model.states, *model.controls):
        other = due[variable]
        for one in (found.on_card[variable], found[variable]):
            mean, cov = (
                each.home() if hasattr(each, "home") else each for each in (one.mean, one.cov)
            )
            assert mean.shape == other.mean.shape
            assert cov.shape == other.cov.shape
            assert (np.abs(mean - other.mean) <= tolerance * other.std + 1e-13).all()
            unit = other.std[..., :, None] * other.std[..., None, :]
            assert (np.abs(cov - other.cov) <= tolerance * unit + 1e-15).all()
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-10)


def few(runs=4, steps=3):
    """Evidence of a few runs: controls that all have, and readings of each."""
    return sighted(runs, steps=steps)


# Answers


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("kind", [CudaArray, DlpackArray])
def test_all_evidence_on_the_card(kind, turned, driver):
    """Missing readings, several of a step, at step 0 too; controls and landmarks of each run."""
    evidence = recording("plain")
    there = put(driver, evidence, {u, z, m}, kind, turned=turned)
    found = pgm.filter(plain(), there, compiled=CARD)
    launched = len(driver.launched)
    assert_on_card(found, pgm.filter(plain(), evidence, compiled=False))
    assert len(driver.launched) > launched  # since all else came home by a call of its own
    assert found.status.compilation == "compiled, on a card"
    assert not driver.contexts


@pytest.mark.parametrize("turned", [False, True])
def test_smoothers(turned, driver):
    evidence = recording("plain")
    found = pgm.smooth(plain(), put(driver, evidence, {u, z, m}, turned=turned), compiled=CARD)
    assert_on_card(found, pgm.smooth(plain(), evidence, compiled=False))
    assert str(found.kind) == "smoothed"


@pytest.mark.slow
def test_runs_that_a_smoother_leaves(driver):
    model = plain(sensor=SIGHT.cpd(cov=1e-9 * np.eye(2)))
    evidence = recording("sharp readings")
    found = pgm.smooth(model, put(driver, evidence, {u, z, m}), compiled=CARD)
    assert_on_card(found, pgm.smooth(model, evidence, compiled=False), 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
def test_memory_that_holds_some_runs_at_once(call, monkeypatch):
    """Evidence and beliefs of all runs are there, and what sweeps need beside them, of some."""
    evidence, memory, launched = few(40, 1), 2**30, []
    due = call(plain(), evidence, compiled=False)
    for _ in range(2):
        driver = with_a(Driver(memory=memory), monkeypatch)
        found = call(plain(), put(driver, evidence, {z}), compiled=CARD)
        launched.append(len(driver.launched))
        memory = int(0.9 * driver.peak)
        assert_on_card(found, due)
    assert launched[1] > launched[0]


@pytest.mark.slow
def test_points_and_a_graph(driver):
    evidence, options = few(), {"lineariser": RULES["unscented"], "schedule": pgm.Filtering()}
    found = pgm.infer(pgm.compile(plain(), 3, compiled=CARD), put(driver, evidence, {z}), **options)
    due = pgm.infer(pgm.compile(plain(), 3, compiled=False), evidence, **options)
    assert_on_card(found, due)


def test_one_run(driver):
    evidence = sighted(steps=3)
    found = pgm.filter(plain(), put(driver, evidence, {u, z, m}), compiled=CARD)
    assert_on_card(found, pgm.filter(plain(), evidence, compiled=False))
    assert found.on_card[x].mean.shape == (4, 3)


def test_numbers_that_all_runs_have(driver):
    evidence = few()
    found = pgm.filter(plain(), put(driver, evidence, {u, z, m}), compiled=CARD)
    assert_on_card(found, pgm.filter(plain(), evidence, compiled=False))


@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
def test_linear_motion_and_readings(call, driver):
    """Inputs on the card, and others of the same CPD at home."""
    rng = np.random.default_rng(4)
    slip = pgm.Variable("slip", components=("east", "north"))
    moved = {x.previous: 0.9 * np.eye(3), u: rng.normal(size=(3, 2)), slip: rng.normal(size=(3, 2))}
    seen = {x: rng.normal(size=(2, 3)), bias: [[1.0], [-2.0]]}
    model = pgm.DynamicBayesianNetwork(
        plain().prior,
        [pgm.LinearGaussianCPD(x, moved, offset=[0.1, 0.2, 0.3], cov=0.1 * np.eye(3))],
        [pgm.LinearGaussianCPD(z, seen, cov=0.2 * np.eye(2))],
    )
    evidence = {u: rng.normal(size=(4, 5, 2)), slip: rng.normal(size=(5, 2))}
    evidence |= {bias: rng.normal(size=(4, 5, 1)), z: rng.normal(size=(4, 5, 2))}
    found = call(model, put(driver, evidence, {u, bias, z}), compiled=CARD)
    assert_on_card(found, call(model, evidence, compiled=False))


@pytest.mark.slow
@pytest.mark.parametrize("call", [pgm.filter, pgm.smooth])
def test_several_states(call, driver):
    motion = pgm.NonlinearGaussianCPD(x, (x.previous, bias, u), drifting, Q)
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(bias, [0.01], 0.01), *plain().prior],
        [pgm.LinearGaussianCPD(bias, {bias.previous: 0.9}, cov=1e-4), motion],
        plain().observation,
    )
    evidence = recording("plain")
    found = call(model, put(driver, evidence, {u, z, m}), compiled=CARD)
    assert found.on_card[bias].cov.shape == (3, 9, 1, 1)
    assert_on_card(found, call(model, evidence, compiled=False))


@pytest.mark.slow
def test_hidden_controls_begin_at_step_one(driver):
    model = pgm.DynamicBayesianNetwork(
        plain().prior,
        [pgm.LinearGaussianCPD(u, {command: 1.0}, cov=0.01 * np.eye(2)), *plain().transition],
        plain().observation,
    )
    evidence = {command if v is u else v: rows for v, rows in few().items()}
    found = pgm.filter(model, put(driver, evidence, {z}), compiled=CARD)
    assert found.on_card[u].mean.shape == (4, 3, 2)
    assert_on_card(found, pgm.filter(model, evidence, compiled=False))


def test_runs_that_the_card_leaves(driver):
    """Their beliefs are found at home, and put on the card."""
    model = plain(sensor=SIGHT.cpd(cov=1e-9 * np.eye(2)))
    evidence = recording("sharp readings")
    found = pgm.filter(model, put(driver, evidence, {u, z, m}), compiled=CARD)
    assert_on_card(found, pgm.filter(model, evidence, compiled=False), 1e-5)


def farther(evidence, runs, by):
    """The evidence with the ranges of some runs longer."""
    seen = evidence[z]
    values = np.array(seen.values)
    values[runs] += [by, 0.0]
    return {**evidence, z: pgm.sightings(values, step=seen.step, given=seen.given)}


@pytest.mark.filterwarnings("ignore::pgm.errors.LostWarning")
@pytest.mark.filterwarnings("ignore::pgm.errors.PrecisionWarning")
def test_some_runs_that_the_card_leaves(driver):
    evidence = farther(few(5), slice(2, 4), 1e10)
    found = pgm.filter(plain(), put(driver, evidence, {z}), compiled=CARD)
    due = pgm.filter(plain(), evidence, compiled=False)
    assert (np.abs(due[x].mean[2]) > 1e8).any()
    assert_on_card(found, due, 1e-7)


@pytest.mark.parametrize("run", [7, 19])  # one of those that come home anyway is the last
def test_a_run_that_has_no_belief(run, driver):
    def wrong(x, m):
        far = np.hypot(x[..., :1], x[..., 1:2]) > 1e3
        return np.where(far, np.nan, SIGHT.function(x, m))

    model = plain(sensor=SIGHT.cpd(function=wrong, jacobian=None))
    evidence = farther(few(20), run, 1e7)
    with pytest.raises(pgm.LinearisationError) as due:
        pgm.filter(model, evidence, compiled=False)
    with pytest.raises(pgm.LinearisationError, match=f"run {run}") as found:
        pgm.filter(model, put(driver, evidence, {z}), compiled=CARD)
    assert found.value.step == due.value.step
    assert found.value.run == due.value.run == run


def test_a_card_that_does_nothing_changes_no_answer(monkeypatch):
    class Idle(Driver):
        def cuLaunchKernel(self, kernel, *rest):
            sweeps = kernel[1] == "pgm_sweep"
            return (0,) if sweeps else super().cuLaunchKernel(kernel, *rest)

    evidence = few()
    there = put(with_a(Idle(), monkeypatch), evidence, {z})
    found = pgm.filter(plain(), there, compiled=CARD)
    due = pgm.filter(plain(), evidence, compiled=False)
    assert_allclose(found.on_card[x].mean.home(), due[x].mean, rtol=0, atol=1e-12)
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)


def test_parts_of_the_runs(monkeypatch):
    class Taking(Driver):
        def cuLaunchKernel(self, kernel, x, *rest):
            if kernel[1] == "pgm_sweep" and x > 1:
                return (2,)
            return super().cuLaunchKernel(kernel, x, *rest)

    evidence = few(130, 1)
    found = pgm.filter(plain(), put(with_a(Taking(), monkeypatch), evidence, {z}), compiled=CARD)
    assert_on_card(found, pgm.filter(plain(), evidence, compiled=False))


def test_a_belief_that_is_lost_is_told(driver):
    evidence = farther(few(3, 12), 1, 30.0)
    with pytest.warns(pgm.LostWarning, match=r"posterior\.lost says where"):
        found = pgm.filter(plain(), put(driver, evidence, {z}), compiled=CARD)
    with pytest.warns(pgm.LostWarning):
        due = pgm.filter(plain(), evidence, compiled=False)
    assert str(found.lost) == str(due.lost)


# Other libraries


def test_arrays_are_handed_out_as_they_lie(driver):
    found = pgm.filter(plain(), put(driver, few(), {z}), compiled=CARD)
    mean = found.on_card[x].mean
    told = mean.__cuda_array_interface__
    assert told["shape"] == mean.shape == (4, 4, 3)
    assert told["typestr"] == mean.dtype.str
    assert told["version"] == 3
    # The interpreter's memory is the program's own: NumPy may look at it.
    seen = SimpleNamespace(__array_interface__={**told, "version": 3})
    assert_array_equal(np.asarray(seen), mean.home())
    assert mean.__dlpack_device__() == (2, 0)
    tensor = dlpack.opened(mean.__dlpack__(stream=1, max_version=(1, 0)))
    assert tensor[:5] == (told["data"][0], mean.shape, told["strides"], "<f8", (2, 0))
    for refused in ({"copy": True}, {"dl_device": (1, 0)}):
        with pytest.raises(BufferError, match=r"\.home\(\) copies it"):
            mean.__dlpack__(**refused)
    assert "CardArray(4, 4, 3)" in str(mean)
    assert "x: means (4, 4, 3)" in str(found.on_card)


def test_memory_lasts_as_long_as_anybody_holds_it(driver):
    there = put(driver, few(), {z})
    before = len(driver.taken)
    found = pgm.filter(plain(), there, compiled=CARD)
    mean = found.on_card[x].mean
    tensor = dlpack.opened(mean.__dlpack__())
    del found
    gc.collect()
    assert len(driver.taken) == before + 1
    due = mean.home()
    del mean
    gc.collect()
    assert len(driver.taken) == before + 1
    strides, shape = tensor.strides, tensor.shape
    told = {"data": (tensor.address, False), "strides": strides, "shape": shape}
    seen = SimpleNamespace(__array_interface__={**told, "typestr": "<f8", "version": 3})
    assert_array_equal(np.asarray(seen), due)
    del tensor
    gc.collect()
    assert len(driver.taken) == before


def test_the_program_of_the_guide(driver, monkeypatch):
    """The block of how_fast.md that needs CuPy, with one that has NumPy's arrays on the card."""

    def asarray(array):
        if isinstance(array, np.ndarray):
            return CudaArray(driver, array)
        told = array.__cuda_array_interface__
        return np.asarray(SimpleNamespace(__array_interface__=told))

    monkeypatch.setitem(sys.modules, "cupy", SimpleNamespace(asarray=asarray))
    page = Path(__file__).parents[3] / "docs" / "guide" / "how_fast.md"
    block = re.search(
        r"<!-- run by [^\n]*test_on_card.py -->\n```python\n(.*?)```", page.read_text(), re.DOTALL
    )
    evidence = few()
    seen = evidence[z]
    names = {"pgm": pgm, "robot": plain(), "u": u, "x": x, "z": z, "m": m}
    names |= {"controls": evidence[u], "values": np.asarray(seen.values), "steps": seen.step}
    names |= {"landmarks": seen.given[m]}
    exec(compile(block[1], "how_fast.md", "exec"), names)
    due = pgm.filter(plain(), evidence, compiled=False)
    assert_allclose(names["means"], due[x].mean, rtol=0, atol=1e-12)
    assert_allclose(names["tracked"].log_evidence, due.log_evidence, rtol=1e-12)


def test_what_comes_home_is_pickled(driver):
    model = pgm.DynamicBayesianNetwork(
        plain().prior,
        [pgm.LinearGaussianCPD(x, {x.previous: 0.9 * np.eye(3)}, cov=0.1 * np.eye(3))],
        [pgm.LinearGaussianCPD(z, {x: np.ones((2, 3))}, cov=0.2 * np.eye(2))],
    )
    found = pgm.filter(model, put(driver, {z: np.ones((2, 3, 2))}, {z}), compiled=CARD)
    for copied in (pickle.loads(pickle.dumps(found)), dataclasses.replace(found)):
        assert_array_equal(copied[x].mean, found[x].mean)
        assert_allclose(copied.log_evidence, found.log_evidence, rtol=1e-12)
        with pytest.raises(pgm.EvidenceError, match="lie in this machine's memory"):
            print(copied.on_card)
    with pytest.raises(TypeError, match=r"neither copied nor pickled: \.home\(\)"):
        pickle.dumps(found.on_card[x].mean)


def test_readings_that_a_library_expands_over_the_runs(driver):
    """A stride of zero from run to run, as PyTorch's `expand` makes it."""
    evidence = few()
    seen = evidence[z]
    wide = np.broadcast_to(np.asarray(seen.values)[0], np.shape(seen.values))
    lying = CudaArray(driver, wide[0])
    lying.shape, lying.told = wide.shape, {"strides": (0, 16, 8)}
    given = [pgm.sightings(each, step=seen.step, given=seen.given) for each in (lying, wide)]
    found = pgm.filter(plain(), {**evidence, z: given[0]}, compiled=CARD)
    assert_on_card(found, pgm.filter(plain(), {**evidence, z: given[1]}, compiled=False))


# What is refused


def refused(words, evidence, error=pgm.EvidenceError, model=None, call=pgm.filter, **options):
    with pytest.raises(error, match=words):
        call(model or plain(), evidence, compiled=CARD, **options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"gate": 0.9}, "gate is not taken"),
        ({"iterations": 2}, "iterations is not taken"),
        ({"keep": [x]}, "keep is not taken"),
        ({"belief": pgm.Particles(10, seed=1)}, "has Gaussian beliefs there, not Particles"),
        ({"call": pgm.smooth, "lag": 2}, "filters, and smoothers of all steps, take it there"),
        ({"call": pgm.smooth, "start": {}}, "start is not taken"),
        ({"model": MODELS["a start for each run"]}, "the priors have runs of their own"),
        ({"model": plain(sensor=SIGHT.cpd(noise=pgm.StudentT(4.0)))}, "noise is robust"),
        ({"model": plain(sensor=SIGHT.cpd(cov=pgm.noise(near_noise, given=m)))}, "m"),
    ],
)
def test_other_calls(options, words, driver):
    refused(words, put(driver, few(), {z, m}), **options)


def test_other_models(driver):
    evidence = few()
    noisy = MODELS["noise by control"]
    refused("noise of .* depends on its inputs", put(driver, evidence, {u, z}), model=noisy)

    def branching(x, m):
        return SIGHT.function(x, m) if (x[..., 0] > -1e9).all() else x[..., :2]

    seen = plain(sensor=SIGHT.cpd(function=branching, jacobian=None))
    refused("it branches on a value", put(driver, evidence, {z}), model=seen)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda a: a.astype(np.float32), "lies on a card as numbers of type <f4; float64"),
        (
            lambda a: a[..., :1],
            r"in the shape \(4, \d, 1\); .*its components \('range', 'bearing'\)",
        ),
        (lambda a: a[:0], "and is empty; leave it out"),
        (lambda a: a[None], r"in the shape \(1, 4, \d, 2\)"),
        (lambda a: np.where(a == a[2, 1, 0], np.inf, a), r"infinite.* \(run 2\)"),
    ],
)
def test_other_numbers(change, words, driver):
    evidence = few()
    seen = evidence[z]
    values = CudaArray(driver, change(np.array(seen.values)))
    evidence[z] = pgm.sightings(values, step=seen.step, given=seen.given)
    refused(words, evidence)


def test_other_layouts(driver):
    seen = few()[z]

    def told(**words):
        values = CudaArray(driver, seen.values, **words)
        return {**few(), z: pgm.sightings(values, step=seen.step, given=seen.given)}

    rows = np.asarray(seen.values).shape[1]
    refused("with a mask; let NaN stand", told(mask=object()))
    refused("with the strides .*a copy has such", told(strides=(16 * rows, -16, 8)))
    refused("with the strides", told(strides=(16 * rows + 4, 16, 8)))
    refused("with the strides", told(strides=(16 * rows, 0, 8)))


def test_missing_controls_are_no_evidence(driver):
    evidence = recording("plain")
    turns = evidence[u].copy()
    turns[1, 3, 0] = np.nan
    there = put(driver, {**evidence, u: turns}, {u, z, m})
    refused(r"evidence for u has .* NaN.*first at step 4.*\(run 1\)", there)


def test_runs_that_do_not_fit_together(driver):
    evidence, fewer = recording("plain"), recording("plain", 2)
    there = put(driver, {**evidence, z: fewer[z]}, {u, z, m})
    refused("evidence for u has 3 runs on the card, and for m 2", there)
    refused("evidence for u beside it has runs of its own", put(driver, evidence, {z, m}))
    refused("evidence for m beside it has runs", put(driver, evidence, {u, z}))


def test_constants_and_unsorted_sightings(driver):
    evidence, seen = few(), few()[z]
    there = CudaArray(driver, np.ones(2))
    refused(
        "as a constant; give the numbers of a constant as NumPy's",
        {**put(driver, evidence, {z}), u: pgm.constant(there)},
    )
    turned = pgm.sightings(
        CudaArray(driver, seen.values), step=seen.step[::-1], given={m: seen.given[m][::-1]}
    )
    refused("in the order of their steps", {**evidence, z: turned})


def test_memory_of_another_card(driver):
    driver.ordinal = 1
    refused("does not lie on the card that sweeps, the first", put(driver, few(), {z}))
    driver.ordinal = 0
    seen = few()[z]
    nowhere = CudaArray(driver, seen.values, data=(4096, False))
    values = pgm.sightings(nowhere, step=seen.step, given=seen.given)
    refused("does not lie on the card that sweeps", {**few(), z: values})


def test_beliefs_that_do_not_fit(monkeypatch):
    driver = with_a(Driver(memory=1500), monkeypatch)
    there = put(driver, few(), {z})
    refused("beliefs that stay on the card do not fit there", there, pgm.ExecutorError)
    assert not driver.contexts


def test_evidence_that_has_changed_since(driver):
    seen = few()[z]
    values = CudaArray(driver, seen.values)
    there = {**few(), z: pgm.sightings(values, step=seen.step, given=seen.given)}
    found = pgm.filter(plain(), there, compiled=CARD)
    due = found.on_card[x].mean.home()
    values.write(np.asarray(seen.values) + 0.01)
    with pytest.raises(pgm.EvidenceError, match="is not what it was when the call was made"):
        print(found[x])
    assert_array_equal(found.on_card[x].mean.home(), due)


def test_beliefs_that_are_not_those_of_this_machine(monkeypatch):
    class Wrong(Driver):
        def cuLaunchKernel(self, kernel, *rest):
            found = super().cuLaunchKernel(kernel, *rest)
            if kernel[1] == "pgm_sweep":
                for room in self.taken.values():
                    if len(room) == 8 * 4 * 4 * 3:  # of means
                        room.view(np.float64)[:] += 0.1
            return found

    there = put(with_a(Wrong(), monkeypatch), few(), {z})
    refused("are not those that this machine finds", there, pgm.ExecutorError)


def test_what_lies_at_home_and_unknown_variables(driver):
    with pytest.raises(pgm.EvidenceError, match="they stay on a card if"):
        print(pgm.filter(plain(), few(), compiled=CARD).on_card)
    found = pgm.filter(plain(), put(driver, few(), {z}), compiled=CARD)
    with pytest.raises(pgm.EvidenceError, match=r"no belief of z lies on the card; those of \[x\]"):
        print(found.on_card[z])
    assert isinstance(found, on_card.PosteriorOnCard)


def test_without_a_card_no_memory_is_taken_for_one(monkeypatch):
    driver = with_a(Driver(), monkeypatch)
    there = put(driver, few(), {z})
    with pytest.raises(pgm.EvidenceError, match="evidence for z"):
        pgm.filter(plain(), there, compiled=True)
    with_a(None, monkeypatch)
    refused("needs cuda", there, ImportError)
