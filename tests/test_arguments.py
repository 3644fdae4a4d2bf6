"""Calls that do not fit a public signature say which argument was meant."""

import inspect
import pickle

import numpy as np
import pytest

import pgm
from pgm.arguments import ELSEWHERE, public

x, z = pgm.variables("x z")
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(x, 0.0, 1.0)], [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, 0.1)]
)
# What a call makes, or hands out, is not made by users; and bases, and what takes no arguments.
UNMARKED = {
    *pgm.results.__all__,
    *("Cells", "Dropped", "Edges", "PoseErrors", "PoseGraph", "Poses"),
    *("BeliefFamily", "Lineariser", "Oracle", "RobustNoise", "StatisticalRegression"),
    *(
        "Balanced",
        "Bethe",
        "Cubature",
        "LTRIP",
        "MinDegree",
        "MinFill",
        "Taylor",
        "WeightedMinFill",
    ),
}
MODULES = (
    pgm,
    *(pgm.comparison, pgm.consistency, pgm.learning, pgm.maps, pgm.plot, pgm.recordings),
    pgm.viewer,
)
CALLED = {
    f"{module.__name__}.{name}": getattr(module, name)
    for module in MODULES
    for name in module.__all__
    if callable(getattr(module, name))
}


def is_marked(thing):
    own = {}
    for each in reversed(inspect.getmro(thing) if inspect.isclass(thing) else ()):
        own |= {k: v for k, v in vars(each).items() if k in ("__new__", "__init__")}
    made = getattr(own.get("__new__"), "__func__", None) or own.get("__init__")
    if hasattr(thing, "__signature__"):  # that of a function which looks for misfits itself
        return True
    return hasattr(made if inspect.isclass(thing) else thing, "__wrapped__")


@pytest.mark.parametrize("name", CALLED)
def test_what_users_call_is_marked(name):
    thing = CALLED[name]
    made = inspect.isclass(thing) and (
        issubclass(thing, Exception)
        or thing.__name__ in UNMARKED
        or thing.__module__.startswith("pgm.consistency")  # whose functions make its classes
    )
    assert made or is_marked(thing)


@pytest.mark.parametrize("name", CALLED)
def test_a_marked_call_tells_of_a_stranger(name):
    thing = CALLED[name]
    if not is_marked(thing):
        return
    signature = inspect.signature(thing)
    kinds = {parameter.kind for parameter in signature.parameters.values()}
    if inspect.Parameter.VAR_KEYWORD in kinds:
        return  # options of matplotlib, say
    with pytest.raises(TypeError, match=r"has no argument strnger=") as caught:
        thing(strnger=1)
    assert caught.value.__cause__ is None


TYPED = {
    "std of a prior": (lambda: pgm.GaussianCPD(x, 0.0, std=1.0), "cov=?", "squares"),
    "sigma of a sensor": (lambda: pgm.LinearGaussianCPD(z, {x: 1.0}, sigma=1.0), "cov=?"),
    "R": (lambda: pgm.NonlinearGaussianCPD(z, x, np.sin, R=1.0), "cov=?"),
    "mu": (lambda: pgm.GaussianCPD(x, mu=0.0, cov=1.0), "mean=?"),
    "F": (lambda: pgm.LinearGaussianCPD(z, F={x: 1.0}, cov=1.0), "given=?"),
    "values of a table": (lambda: pgm.TableCPD(pgm.Discrete("a", 2), values=[1, 0]), "table=?"),
    "American": (lambda: pgm.filter(MODEL, {}, linearizer=pgm.Taylor()), "lineariser=?"),
    "of a rule": (lambda: pgm.OnlineFilter(MODEL, linearizer=pgm.Taylor()), "lineariser=?"),
    "max_iterations": (lambda: pgm.Flooding(max_iterations=5), "iterations=?"),
    "max_iter": (lambda: pgm.smooth(MODEL, {}, max_iter=5), "iterations=?"),
    "n_iter": (lambda: pgm.fit(MODEL, {}, learn={}, n_iter=5), "iterations=?"),
    "tol": (lambda: pgm.Smoothing(tol=1e-3), "tolerance=?"),
    "a typing error": (lambda: pgm.Variable("x", componets=("a",)), "components=?"),
    "the number of states": (lambda: pgm.Discrete("a", card=2), "states=?"),
    "a seed of draws": (lambda: MODEL.sample(steps=3, seed=0), "rng=?"),
    "a generator of a rule": (lambda: pgm.MonteCarlo(100, rng=0), "seed=?"),
    "a number of runs": (lambda: MODEL.sample(steps=3, n_samples=3, rng=0), "runs=?"),
    "nothing like it": (lambda: pgm.compile(MODEL, 3, bogus=1), "it takes method=, compiled="),
    "no more": (lambda: pgm.Huber(1.0, bogus=1), "it takes no more than was given"),
    "a lineariser by place": (
        lambda: pgm.smooth(MODEL, {}, pgm.Taylor()),
        "2 arguments by place (model, evidence), and 3 were given",
        "lineariser=, steps=",
    ),
    "one too many sightings": (
        lambda: pgm.sightings([[1.0]], [0], {}, 1, gate=2),
        "sightings has no argument gate=; it takes no more",
    ),
    "sightings at too many places": (
        lambda: pgm.sightings([[1.0]], None, None, None),
        "sightings takes 3 arguments by place (values, step, given), and 4 were given",
    ),
    "parents of sightings": (lambda: pgm.sightings([[1.0]], parents={}), "given=?"),
    "sightings, nothing like it": (
        lambda: pgm.sightings([[1.0]], bogus=1),
        "has no argument bogus=; it takes step=, given=",
    ),
    "one too many": (lambda: pgm.GaussianCPD(x, 0.0, 1.0, 2.0), "3 arguments by place"),
    "one too few": (lambda: pgm.GaussianCPD(x, 0.0), "GaussianCPD lacks cov="),
    "two too few": (lambda: pgm.fit(MODEL), "fit lacks evidence=, learn="),
}


@pytest.mark.parametrize(("call", "words"), [(c, w) for c, *w in TYPED.values()], ids=TYPED)
def test_the_argument_that_was_meant(call, words):
    with pytest.raises(TypeError) as caught:
        call()
    for word in words:
        assert word in str(caught.value)


def test_what_others_call_an_argument_is_no_argument_beside_it():
    """An alias that a function has as an argument of its own is never taken for another."""
    for name, others in ELSEWHERE.items():
        assert name not in others
        assert len(set(others)) == len(others)


def test_errors_within_stay_as_they_are():
    @public
    def outer(value: int) -> int:
        return inner(value, strnger=1)

    def inner(value: int) -> int:
        return value

    with pytest.raises(TypeError, match=r"inner\(\) got an unexpected keyword argument"):
        outer(1)
    with pytest.raises(TypeError, match="unsupported operand"):
        public(lambda a: a + "b")(1)


def test_signatures_and_pickles_are_those_of_what_is_marked():
    assert list(inspect.signature(pgm.LinearGaussianCPD).parameters)[:3] == [
        "child",
        "given",
        "cov",
    ]
    assert inspect.signature(pgm.filter).parameters["lineariser"].kind.name == "KEYWORD_ONLY"
    for value in (pgm.filter, pgm.FixedLag(3), x, pgm.GaussHermite(5)):
        assert pickle.loads(pickle.dumps(value)) == value


def test_cov_may_stand_third_as_in_other_CPDs():
    by_place = pgm.LinearGaussianCPD(z, {x: 2.0}, 0.5, offset=1.0)
    by_name = pgm.LinearGaussianCPD(z, {x: 2.0}, offset=1.0, cov=0.5)
    at = [[0.3], [-1.0]], {x: 0.7}
    np.testing.assert_array_equal(by_place.log_density(*at), by_name.log_density(*at))
    with pytest.raises(TypeError, match=r"3 arguments by place .*; .* offset=, noise="):
        pgm.LinearGaussianCPD(z, {x: 2.0}, 0.5, 1.0)
