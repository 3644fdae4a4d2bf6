"""A study's grid, parts and seeds, and what it refuses before work starts."""

import numpy as np
import pytest

from experiments.catalogue import EXPERIMENTS
from experiments.nonlinear_measurement.rules import rules
from experiments.studies import Study, StudyError
from experiments.studies.settings import declared
from tests.experiments.studies import sweeps

SWEPT = [name for name, module in EXPERIMENTS.items() if hasattr(module, "sweep")]


def test_the_grid_has_all_combinations_and_the_defaults():
    study = Study(
        sweeps.dice, {"name": ["b", "a"], "sides": np.array([4, 20])}, runs=25, part_size=10
    )
    assert [(s["name"], s["sides"], s["seconds"]) for s in study.settings] == [
        ("b", 4, 0.0),
        ("b", 20, 0.0),
        ("a", 4, 0.0),
        ("a", 20, 0.0),
    ]
    assert study.parts == len(list(study.each())) == 12
    assert [study.size(k) for k in range(3)] == [10, 10, 5]


def test_a_part_draws_from_its_own_seed():
    study = Study(sweeps.dice, {"sides": [4, 20]}, runs=25, seed=7, part_size=10)
    rng = np.random.default_rng(np.random.SeedSequence(7, spawn_key=(1, 2)))
    due = sweeps.dice(5, rng, sides=20)
    found = study.part(1, 2)
    assert list(found) == list(due)
    for name, values in due.items():
        np.testing.assert_array_equal(found[name], values)


@pytest.mark.parametrize(
    ("function", "over", "told"),
    [
        (sweeps.dice, {"edges": [4]}, "has no setting 'edges'; it has sides, name, seconds"),
        (sweeps.dice, {"sides": [4.5]}, "sides: found 4.5; its values are of int"),
        (sweeps.dice, {"sides": [True]}, "sides: found True"),
        (sweeps.dice, {"sides": [4, 4]}, "each value once"),
        (sweeps.dice, {"sides": []}, "each value once, one or more"),
        (sweeps.dice, {"sides": 4}, "sides: found 4; give a list"),
        (sweeps.dice, {"name": ["c"]}, "name: found 'c'; its values are one of a, b"),
        (sweeps.dice, {"seconds": [np.nan]}, "seconds: found nan"),
        (sweeps.dice, ["sides"], "over= is a mapping"),
        (sweeps.positional, {}, r"positional takes \(runs, rng, sides\)"),
        (sweeps.undeclared, {}, "keywords with defaults"),
        (sweeps.listed, {}, "setting sides of listed is of"),
        (3, {}, "a study runs a function"),
    ],
)
def test_what_is_no_study_is_refused(function, over, told):
    with pytest.raises(StudyError, match=told):
        Study(function, over, runs=10)


@pytest.mark.parametrize("number", [{"runs": 0}, {"runs": 1.5}, {"runs": 5, "part_size": 0}])
def test_numbers_that_cannot_be_are_refused(number):
    with pytest.raises(StudyError, match="is a whole number, 1 or more"):
        Study(sweeps.dice, **number)
    with pytest.raises(StudyError, match="seed= is a whole number, 0 or more; found -1"):
        Study(sweeps.dice, runs=1, seed=-1)


@pytest.mark.parametrize(
    ("function", "over", "told"),
    [
        (sweeps.no_mapping, {}, "returned ndarray; it returns figures by name"),
        (sweeps.short, {}, r"figure 'x' has the shape \(3,\) and type float64; of 2 runs \(2,\)"),
        (sweeps.words, {}, "type <U1"),
        (sweeps.infinite, {}, "infinite in run 0; where a run has no such figure it is NaN"),
        (sweeps.other_names, {"name": ["a", "b"]}, r"name=b\) has the figures .* all settings"),
        (sweeps.named_run, {}, "the figure run has the name of a column"),
        (EXPERIMENTS["localisation"].sweep, {"noise": [0.0]}, "noise=0.0.* fails: noise and steps"),
        (
            EXPERIMENTS["nonlinear_measurement"].sweep,
            {"heading_std": [-1]},
            "fails: heading_std is",
        ),
        (EXPERIMENTS["particle_counts"].sweep, {"seconds": [0]}, "fails: a drive is of 1 second"),
    ],
)
def test_a_trial_finds_faults_before_work_starts(function, over, told, tmp_path):
    with pytest.raises(StudyError, match=told):
        Study(function, over, runs=10).run(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_declared_rules_are_the_rules():
    sweep = EXPERIMENTS["nonlinear_measurement"].sweep
    assert declared(sweep)["rule"].choices == tuple(rules(0))


@pytest.mark.parametrize("name", SWEPT)
def test_every_sweep_runs_with_each_choice(name):
    sweep = EXPERIMENTS[name].sweep
    for setting in declared(sweep).values():
        for choice in setting.choices:
            steps = {"steps": [4]} if name == "localisation" else {}
            figures = Study(sweep, {setting.name: [choice]} | steps, runs=3).part(0, 0)
            assert all(np.isfinite(values).all() for values in figures.values())


def test_errors_are_those_of_the_beliefs():
    """The robot's filter is right about its errors: NEES has a mean of 3 on a mild drive."""
    study = Study(EXPERIMENTS["localisation"].sweep, {"steps": [10]}, runs=2000)
    figures = study.part(0, 0)
    error = figures["nees"].std() / np.sqrt(2000)
    assert figures["nees"].mean() == pytest.approx(3.0, abs=5 * error)
