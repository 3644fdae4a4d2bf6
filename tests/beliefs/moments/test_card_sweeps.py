"""Sweeps printed for a card, without one: interpreted, against the general kernels; assembled."""

import numpy as np
import pytest
from card import CAPABILITIES, assembled, needs_libdevice, on_a_card
from crossed import combinations, slow_after
from numpy.testing import assert_allclose
from robots import sighted
from test_compiled import assert_posterior
from zoo import MODELS, RULES, SIGHT, of_run, plain, recording

import pgm
from pgm.kernels.machine.sweeps import card

needs_libdevice()

# Runs that are few enough for no packs are swept one by one, as by a card.
CHECKED = combinations(list(MODELS), ["taylor", "unscented"])
TIGHT = 1e-12


def fresh(model):
    """The same network, of which no sweep has been made."""
    return pgm.DynamicBayesianNetwork(model.prior, model.transition, model.observation)


def both(infer, model, evidence, **options):
    """The answers of machine code, here or as on a card, and of the general kernels."""
    return [infer(fresh(model), evidence, compiled=c, **options) for c in (True, False)]


@pytest.mark.parametrize(("name", "rule"), CHECKED)
def test_runs_of_all_kinds(name, rule, monkeypatch):
    launched = on_a_card(monkeypatch)
    found = both(pgm.smooth, MODELS[name], recording(name), lineariser=RULES[rule])
    assert_posterior(*found, TIGHT)
    assert launched


@pytest.mark.parametrize("runs", [3, 9])
@pytest.mark.parametrize(("name", "rule"), CHECKED)
def test_the_same_sweeps_for_the_processor(name, rule, runs):
    runs = 3 if name == "a start for each run" else runs
    found = both(pgm.smooth, MODELS[name], recording(name, runs), lineariser=RULES[rule])
    # Very sharp readings leave a sweep fewer digits, of which it makes sure.
    assert_posterior(*found, 1e-9 if name == "sharp readings" else TIGHT)


@pytest.mark.parametrize("rule", ["taylor", "unscented"])
def test_matrices_in_a_threads_own_memory(rule, monkeypatch):
    launched = on_a_card(monkeypatch, loops=True)
    found = both(pgm.smooth, MODELS["everything"], recording("everything"), lineariser=RULES[rule])
    assert_posterior(*found, TIGHT)
    assert len(launched) == 2


SCHEDULES = {
    "gated": pgm.Filtering(gate=0.9),
    "iterated": pgm.Filtering(iterations=40),
    "controlled": pgm.Filtering(iterations=30, damping=pgm.LevenbergMarquardt()),
    "smoothed again": pgm.Smoothing(iterations=20),
    "a lag": pgm.FixedLag(3),
    "iterated lags": pgm.FixedLag(2, iterations=20),
}
NOISES = {"Gaussian": None, "Huber": pgm.Huber(1.0), "Student": pgm.StudentT(4.0)}


@pytest.mark.parametrize(
    ("schedule", "noise"),
    [
        *combinations(SCHEDULES, {"Gaussian": None}),
        *combinations({name: SCHEDULES[name] for name in ("gated", "iterated")}, NOISES),
    ],
)
def test_schedules_and_noises(schedule, noise, monkeypatch):
    launched = on_a_card(monkeypatch)
    model = plain(sensor=SIGHT.cpd(noise=noise))

    def infer(model, evidence, compiled):
        graph = pgm.compile(model, 20, compiled=compiled)
        return pgm.infer(graph, evidence, schedule=schedule)

    found = both(infer, model, sighted(3, steps=20))
    for variable in model.states:
        ours, theirs = (each[variable] for each in found)
        unit = theirs.std
        assert (np.abs(ours.mean - theirs.mean) <= 1e-10 * unit).all()
        scale = unit[..., :, None] * unit[..., None, :]
        assert (np.abs(ours.cov - theirs.cov) <= 1e-10 * scale).all()
    assert launched


def test_mixtures_of_regimes(monkeypatch):
    mode = pgm.Discrete("mode", states=("calm", "wild"))
    place, reading = pgm.Variable("place", components=("p", "v")), pgm.Variable("reading")
    moves = {
        name: pgm.LinearGaussianCPD(place, {place.previous: [[1.0, 0.5], [0.0, 0.9]]}, cov=cov)
        for name, cov in (("calm", 0.1), ("wild", 2.0))
    }
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(mode, table=[0.5, 0.5]), pgm.GaussianCPD(place, [0.0, 0.0], 1.0)],
        [
            pgm.TableCPD(mode, given=mode.previous, table=[[0.9, 0.1], [0.3, 0.7]]),
            pgm.SwitchingCPD(place, mode, moves),
        ],
        [pgm.LinearGaussianCPD(reading, {place: [[1.0, 0.0]]}, cov=0.3)],
    )
    evidence = {reading: 3.0 * np.random.default_rng(4).normal(size=(3, 15, 1))}
    launched = on_a_card(monkeypatch)
    ours, theirs = both(pgm.filter, model, evidence, belief=pgm.Gaussians(2))
    assert_allclose(ours[place].mean, theirs[place].mean, rtol=0, atol=1e-12)
    assert_allclose(ours[place].cov, theirs[place].cov, rtol=0, atol=1e-12)
    assert_allclose(ours[mode].probabilities, theirs[mode].probabilities, rtol=0, atol=1e-12)
    assert_allclose(ours.log_evidence, theirs.log_evidence, rtol=1e-12)
    assert launched


CHAINS = {
    "straight lines": ("plain", "taylor", False),
    "points in straight lines": ("plain", "unscented", False),
    "loops": ("plain", "taylor", True),
    "points in loops": ("plain", "unscented", True),
    "many states": ("everything", "taylor", True),
}


@pytest.mark.parametrize(
    ("name", "capability"),
    slow_after(12, [(name, each) for name in CHAINS for each in CAPABILITIES]),
)
def test_sweeps_assemble(name, capability, tmp_path, monkeypatch):
    of, rule, loops = CHAINS[name]
    launched = on_a_card(monkeypatch)
    evidence = of_run(recording(of), 0)
    pgm.smooth(fresh(MODELS[of]), evidence, compiled=True, lineariser=RULES[rule])
    assert len(launched) == 2
    for chain in launched:
        told, length = assembled(card.kernel(chain, capability, loops), capability, tmp_path)
        assert not told
        assert length > 5_000
