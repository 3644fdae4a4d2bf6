"""What was written for each kind of belief is written once, and asks the family, never the kind."""

import copy
import inspect
import pickle

import numpy as np
import pytest

import pgm
from pgm.beliefs.own import family as belief_family
from pgm.examples import b, pair, rainy, walk, wet, x, z
from pgm.inference import families
from tests.beliefs.own.ensemble import EnsembleKalman

DOOR = pgm.Discrete("door", states=("open", "shut"))


def taking_a_belief():
    """The public functions and classes with an argument `belief`, by name."""
    for name in pgm.__all__:
        value = getattr(pgm, name)
        if callable(value) and not (inspect.isclass(value) and issubclass(value, Exception)):
            try:
                arguments = inspect.signature(value).parameters
            except ValueError:
                continue
            if "belief" in arguments and "BeliefFamily" in str(arguments["belief"].annotation):
                yield name


CALLS = {
    "filter": lambda belief: pgm.filter(walk, {z: [[4.0]]}, belief=belief)[x].mean,
    "smooth": lambda belief: pgm.smooth(walk, {z: [[4.0]]}, belief=belief)[x].mean,
    "infer": lambda belief: pgm.infer(pgm.compile(walk, 1), {z: [[4.0]]}, belief=belief)[x].mean,
    "OnlineFilter": lambda belief: pgm.OnlineFilter(walk, belief=belief).initial()[x].mean,
}

# Which takes beliefs that have expectations alone.
LEARNING = {
    "fit": lambda belief: pgm.fit(
        walk, {z: [[4.0], [2.0]]}, learn={z: pgm.learning.Covariance()}, belief=belief
    )
}


def test_every_entry_point_that_takes_a_belief_is_tried():
    assert set(taking_a_belief()) == {*CALLS, *LEARNING}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.parametrize(
    "belief",
    [
        None,
        pgm.Grid({"x": (-8.0, 12.0, 200)}),
        pgm.Particles(2000, seed=0),
        EnsembleKalman(2000),
    ],
    ids=["moments", "grid", "particles", "ensemble"],
)
def test_a_family_goes_through_every_entry_point(name, belief):
    due = CALLS[name](None)
    np.testing.assert_allclose(CALLS[name](belief), due, atol=0.15)


@pytest.mark.parametrize("call", [*CALLS.values(), *LEARNING.values()], ids=[*CALLS, *LEARNING])
@pytest.mark.parametrize("belief", ["grid", 3, pgm.Grid, EnsembleKalman])
def test_what_is_no_family_is_refused(call, belief):
    with pytest.raises(pgm.ModelError, match=r"belief= is a pgm.Grid\(...\) .* or a family"):
        call(belief)


def test_the_family_is_that_of_the_network():
    assert families.family_of(walk) is families.MOMENTS
    assert isinstance(families.MOMENTS, belief_family.BeliefFamily)
    assert isinstance(families.TABLES, belief_family.BeliefFamily)


ONLINE = {
    "grid": (walk, pgm.Grid({"x": (-8.0, 12.0, 200)}), "beliefs on a grid"),
    "particles": (walk, pgm.Particles(20, seed=0), "particles"),
    "ensemble": (walk, EnsembleKalman(20), "ensembles"),
    "tables": (
        pgm.DynamicBayesianNetwork(
            [pgm.TableCPD(DOOR, table=[0.5, 0.5])],
            [pgm.TableCPD(DOOR, DOOR.previous, table=[[0.9, 0.1], [0.2, 0.8]])],
            [],
        ),
        None,
        "tables",
    ),
}


@pytest.mark.parametrize("name", ONLINE)
def test_online_a_record_of_one_step_refuses_what_its_family_has_not(name):
    model, belief, words = ONLINE[name]
    found = pgm.OnlineFilter(model, belief=belief).initial()
    assert isinstance(found, pgm.results.OnlineBelief)
    assert repr(found).startswith("OnlineBelief(predicted, step 0")
    for asked in ("lost", "lost_since", "rejected", "associations"):
        with pytest.raises(pgm.EvidenceError, match=f"{words} have none online"):
            getattr(found, asked)
    with pytest.raises(pgm.EvidenceError, match=r"lag|have none online"):
        found.lagged  # noqa: B018
    with pytest.raises(AttributeError, match="no attribute 'speed'"):
        found.speed  # noqa: B018
    found = pickle.loads(pickle.dumps(found))
    assert found.step == 0


@pytest.mark.parametrize("name", ONLINE)
def test_online_filters_are_values(name):
    model, belief, _ = ONLINE[name]
    robot = pgm.OnlineFilter(model, belief=belief)
    again = pickle.loads(pickle.dumps(robot))
    assert type(again) is pgm.OnlineFilter
    assert repr(again) == repr(robot)
    assert robot.renewed().predict(robot.initial()).step == 1
    assert robot.compilation == "by NumPy"
    with pytest.raises(AttributeError, match="'OnlineFilter' object has no attribute 'speed'"):
        robot.speed  # noqa: B018


class Counting(pgm.OnlineFilter):
    """A user's filter, which counts its steps."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self._set(steps=[])

    def predict(self, belief, inputs=None):
        self.steps.append(belief.step)
        return super().predict(belief, inputs)


OPTIONS = {"plain": {}, "lag": {"lag": 2}, "gate": {"gate": 0.9}, "compiled": {"compiled": True}}
FILTERS = {
    **{name: (walk, options) for name, options in OPTIONS.items()},
    **{name: (model, {"belief": belief}) for name, (model, belief, _) in ONLINE.items()},
}


@pytest.mark.parametrize("name", FILTERS)
def test_an_online_filter_is_subclassed_patched_and_copied(name, monkeypatch):
    model, options = FILTERS[name]
    robot = Counting(model, **options)
    belief = robot.predict(robot.predict(robot.initial()))
    assert robot.steps == [0, 1]
    for again in (robot.renewed(), pickle.loads(pickle.dumps(robot)), copy.deepcopy(robot)):
        assert type(again) is Counting
        assert repr(again) == repr(robot)
        assert again.steps == []
    for copied in (copy.deepcopy, lambda pair: pickle.loads(pickle.dumps(pair))):
        again, same = copied((robot, belief))
        assert again.predict(same).step == 3
    monkeypatch.setattr(pgm.OnlineFilter, "predict", lambda self, belief, inputs=None: "patched")
    assert robot.predict(belief) == pgm.OnlineFilter(model, **options).predict(belief) == "patched"


HMM = ONLINE["tables"][0]
WALK = pgm.compile(walk, 1)
LOOPS = pgm.compile(pair, method=pgm.Bethe())
ANSWERS = {
    "moments": lambda: pgm.filter(walk, {z: [[4.0]]}),
    "inferred": lambda: pgm.infer(WALK, {z: [[4.0]]}),
    **{
        f"inferred {name}": lambda name=name: pgm.infer(WALK, {z: [[4.0]]}, belief=ONLINE[name][1])
        for name in ("grid", "ensemble")
    },
    "kept": lambda: pgm.smooth(walk, {z: [[4.0]]}, keep=x),
    "smoothed grid": lambda: pgm.smooth(walk, {z: [[4.0]]}, belief=ONLINE["grid"][1]),
    "grid": lambda: pgm.filter(walk, {z: [[4.0]]}, belief=ONLINE["grid"][1]),
    "particles": lambda: pgm.smooth(walk, {z: [[4.0]]}, belief=pgm.Particles(500, seed=0)),
    "inferred particles": lambda: pgm.infer(WALK, {z: [[4.0]]}, belief=pgm.Particles(500, seed=0)),
    "ensemble": lambda: pgm.smooth(walk, {z: [[4.0]]}, belief=ONLINE["ensemble"][1]),
    "tables": lambda: pgm.filter(HMM, {}, steps=2),
    "static": lambda: pgm.infer(pgm.compile(pair), {b: [2.0]}),
    "loops": lambda: pgm.infer(LOOPS, {b: [2.0]}, schedule=pgm.Flooding()),
    "static tables": lambda: pgm.infer(pgm.compile(rainy), {wet: "yes"}),
    "loops of tables": lambda: pgm.infer(
        pgm.compile(rainy, method=pgm.Bethe()), {wet: "yes"}, schedule=pgm.Flooding()
    ),
    "balanced": lambda: pgm.smooth(walk, {z: [[4.0]]}, method=pgm.Balanced()),
    "lagged": lambda: pgm.smooth(HMM, {}, steps=2, lag=1),
    **{f"online {name}": lambda name=name: _at_step_1(*FILTERS[name]) for name in FILTERS},
}
PROPERTIES = ("associations", "filtered", "innovations", "lost", "predicted", "rejected", "weights")
PROPERTIES += ("lagged", "lost_since")


def _at_step_1(model, options):
    robot = pgm.OnlineFilter(model, **options)
    return robot.predict(robot.initial())


@pytest.mark.parametrize("name", [name for name in ANSWERS if not name.startswith("online ")])
def test_every_answer_is_of_one_class_and_so_is_its_status(name):
    found = ANSWERS[name]()
    assert type(found) is pgm.results.Posterior
    assert type(found.status) is pgm.results.Status


@pytest.mark.parametrize("name", FILTERS)
def test_every_online_filter_is_of_one_class(name):
    model, options = FILTERS[name]
    robot = pgm.OnlineFilter(model, **options)
    assert type(robot) is type(robot.renewed()) is pgm.OnlineFilter
    first = robot.initial()
    assert isinstance(first, pgm.results.OnlineBelief)
    assert type(first) is type(robot.predict(first)) is type(robot.update(first, {}))


@pytest.mark.parametrize("name", ANSWERS)
def test_what_a_result_has_not_it_has_not_for_hasattr_too(name):
    found = ANSWERS[name]()
    for asked in PROPERTIES:
        if not hasattr(found, asked):
            assert getattr(found, asked, "none") == "none"
            with pytest.raises(AttributeError) as told:
                getattr(found, asked)
            assert isinstance(told.value, pgm.EvidenceError) or "has no attribute" in str(
                told.value
            )
    inspect.getmembers(found)
    assert not hasattr(found, "speed")


@pytest.mark.parametrize("name", ["moments", "grid", "particles", "ensemble", "tables", "static"])
def test_a_result_has_its_familys_own_attributes_and_nothing_from_inside(name):
    found = ANSWERS[name]()
    for inside in ("form", "called", "silent", "moving", "beliefs", "readings", "refusal"):
        assert not hasattr(found, inside)
        assert inside not in dir(found)
    if name == "ensemble":
        assert found.family is ONLINE["ensemble"][1]
        assert "family" in dir(found)
