"""A chain of one's own: the Poisson–gamma filter of a drifting rate, in closed form."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import nbinom

import pgm
from pgm.beliefs.own.kept import closed

rate, count, dose = pgm.variables("rate count dose")


class Gamma(pgm.BeliefFamily):
    """Beliefs Γ(a, b) over a rate, which forgets by a share a step (West & Harrison, 1997)."""

    beliefs = "gamma beliefs"

    def __init__(self, a, b, forget=0.9):
        self.a, self.b, self.forget = a, b, forget

    def begin(self, at):
        return np.full((2, at.runs), [[self.a], [self.b]])

    def predict(self, at, belief):
        return self.forget * belief

    def take(self, at, belief):
        (seen,) = at.measurements
        a, b = belief
        times = seen.inputs[dose][:, 0]
        found = np.where(np.isnan(seen.value[:, 0]), 0.0, seen.value[:, 0])
        log_density = nbinom.logpmf(found, a, b / (b + times))
        known = np.array([a + found, b + times])
        missing = np.isnan(seen.value[:, 0])
        return np.where(missing, belief, known), np.where(missing, 0.0, log_density)

    def numbers(self, belief):
        return {"weight": belief[1]}

    def moments(self, belief):
        a, b = belief
        return (a / b)[:, None], (a / b**2)[:, None, None]


def poisson(rate, dose, size, rng):
    return rng.poisson(np.abs(rate * dose)).astype(float)


MODEL = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(rate, 2.0, 1.0)],
    [pgm.LinearGaussianCPD(rate, {rate.previous: 1.0}, cov=0.01)],
    [pgm.SampledCPD(count, (rate, dose), sample=poisson)],
)
COUNTS = np.array([[3.0], [np.nan], [5.0], [0.0]])
DOSES = np.array([[1.0], [2.0], [2.0], [0.5]])
FAMILY = Gamma(2.0, 1.0)


def due(counts):
    """Shapes and rates after each step, and ln p of all counts, one number after another."""
    a, b, total, found = 2.0, 1.0, 0.0, [(2.0, 1.0)]
    for (seen,), (times,) in zip(counts, DOSES, strict=True):
        a, b = 0.9 * a, 0.9 * b
        if not np.isnan(seen):
            total += nbinom.logpmf(seen, a, b / (b + times))
            a, b = a + seen, b + times
        found.append((a, b))
    return np.array(found), total


def test_it_filters_in_closed_form():
    posterior = pgm.filter(MODEL, {count: COUNTS, dose: DOSES}, belief=FAMILY)
    parts, total = due(COUNTS)
    assert_allclose(posterior[rate].mean[:, 0], parts[:, 0] / parts[:, 1], rtol=1e-12)
    assert_allclose(posterior[rate].cov[:, 0, 0], parts[:, 0] / parts[:, 1] ** 2, rtol=1e-12)
    assert_allclose(posterior.log_evidence, total, rtol=1e-12)
    assert isinstance(posterior[rate], pgm.Gaussian)


@pytest.mark.parametrize("runs", [(2,), (2, 3)])
def test_it_filters_many_runs_at_once(runs):
    rng = np.random.default_rng(1)
    counts = rng.poisson(3.0, (*runs, 4, 1)).astype(float)
    posterior = pgm.filter(MODEL, {count: counts, dose: DOSES}, belief=FAMILY)
    for run in np.ndindex(*runs):
        parts, total = due(counts[run])
        assert_allclose(posterior[rate].mean[run][:, 0], parts[:, 0] / parts[:, 1], rtol=1e-12)
        assert_allclose(posterior.log_evidence[run], total, rtol=1e-12)


def test_it_goes_online():
    robot = pgm.OnlineFilter(MODEL, belief=FAMILY)
    belief = robot.initial()
    parts, total = due(COUNTS)
    for step in range(4):
        belief = robot.predict(belief)
        belief = robot.update(belief, {count: COUNTS[step], dose: DOSES[step]})
        assert_allclose(belief[rate].mean, parts[step + 1, :1] / parts[step + 1, 1], rtol=1e-12)
    assert_allclose(belief.log_evidence, total, rtol=1e-12)
    assert_allclose(belief.value[:, 0], parts[-1], rtol=1e-12)


def test_it_cannot_be_smoothed():
    with pytest.raises(pgm.ModelError, match="says not how its beliefs flow back"):
        pgm.smooth(MODEL, {count: COUNTS, dose: DOSES}, belief=FAMILY)


class Faulty(Gamma):
    """One method returns what it should not."""

    def __init__(self, method, value):
        super().__init__(2.0, 1.0)
        setattr(self, method, value if method == "warns" else lambda *_: value)


@pytest.mark.parametrize(
    ("method", "value", "error", "text"),
    [
        ("take", None, pgm.ModelError, "returns the belief and a log-density, not NoneType"),
        ("take", (1, np.zeros(3)), pgm.ModelError, r"has shape \(3,\) at step 1; \(1,\)"),
        ("take", (1, np.nan), pgm.NumericalError, "at step 1, run 0, is nan"),
        ("take", (1, np.inf), pgm.NumericalError, "at step 1, run 0, is inf"),
        ("take", (1,), pgm.ModelError, "returns the belief and a log-density, not a tuple of 1"),
        ("take", (1, "much"), pgm.ModelError, "the log-density of take"),
        ("moments", np.zeros((1, 1)), pgm.ModelError, "a mean and a covariance, not ndarray"),
        ("moments", None, pgm.ModelError, "a mean and a covariance, not NoneType"),
        ("moments", (np.zeros((1, 2)), np.zeros((1, 2, 2))), pgm.ModelError, "were due"),
        ("moments", (np.full((1, 1), np.nan), np.ones((1, 1, 1))), pgm.NumericalError, "of step 0"),
        ("moments", (np.zeros((1, 1)), -np.ones((1, 1, 1))), pgm.NumericalError, "variance -1"),
        (
            "points",
            np.zeros((1, 3, 1)),
            pgm.ModelError,
            "points and their log-weights, not ndarray",
        ),
        (
            "points",
            (np.zeros((1, 3, 1)), np.zeros(3)),
            pgm.ModelError,
            r"log-weights of shape \(3,\)",
        ),
        ("points", (np.zeros((1, 0, 1)), None), pgm.NumericalError, "no points"),
        ("points", (np.full((1, 3, 1), np.nan), None), pgm.NumericalError, "not finite"),
        ("points", (np.zeros((1, 3, 1)), np.full((1, 3), -np.inf)), pgm.NumericalError, "infinite"),
        ("numbers", 3.0, pgm.ModelError, "a mapping of the same names"),
        ("numbers", {"size": np.zeros(4)}, pgm.ModelError, r"size of numbers\(belief\) has shape"),
        ("numbers", {"size": "much"}, pgm.ModelError, "size of numbers"),
        ("numbers", {1: 2.0}, pgm.ModelError, "a mapping of the same names"),
        ("numbers", {"converged": 1.0}, pgm.ModelError, "'converged', which every status has"),
        ("warns", {"much": 1.5}, pgm.ModelError, "maps names of numbers"),
        ("warns", {"much": pgm.Threshold(1.0)}, pgm.ModelError, "maps names of numbers"),
        ("moments", (np.zeros(1), np.eye(1)), pgm.ModelError, r"\(1, 1\) and \(1, 1, 1\) were due"),
        ("points", (np.zeros((2, 3)), None), pgm.ModelError, r"\(1, n, 1\) was due"),
    ],
)
def test_what_a_method_returns_is_checked(method, value, error, text):
    with pytest.raises(error, match=text):
        pgm.filter(MODEL, {count: COUNTS, dose: DOSES}, belief=Faulty(method, value))[rate]


@pytest.mark.parametrize("missing", ["begin", "predict", "take", "moments"])
def test_a_method_that_is_missing_is_named(missing):
    methods = {name: vars(Gamma)[name] for name in ("begin", "predict", "take", "moments")}
    del methods[missing]
    made = type("Half", (pgm.BeliefFamily,), {**methods, "a": 2.0, "b": 1.0, "forget": 0.9})()
    with pytest.raises(pgm.ModelError, match=missing):
        pgm.filter(MODEL, {count: COUNTS, dose: DOSES}, belief=made)[rate]


def test_points_of_a_wrong_shape_are_refused():
    class Flat(Gamma):
        def predict(self, at, belief):
            return at.moved(np.zeros((3, 1)), at.generators(0))

    with pytest.raises(pgm.ModelError, match=r"have shape \(3, 1\); \(1, n, 1\) was due"):
        pgm.filter(MODEL, {count: COUNTS, dose: DOSES}, belief=Flat(2.0, 1.0))


@pytest.mark.parametrize("wrap", [lambda parts: parts, lambda parts: [parts]], ids=["bare", "in"])
def test_an_array_that_is_changed_in_place_is_an_error(wrap):
    class Rash(Gamma):
        def begin(self, at):
            return wrap(super().begin(at))

        def predict(self, at, belief):
            belief[0][...] *= self.forget
            return belief

        def take(self, at, belief):
            return belief, 0.0

    with pytest.raises(ValueError, match="read-only"):
        pgm.filter(MODEL, {count: COUNTS, dose: DOSES}, belief=Rash(2.0, 1.0))


def test_what_is_shared_and_what_is_copied():
    table, cpd, mark = np.eye(3), MODEL.transition[0], object()
    first = closed({"table": table, "of": {cpd: [table]}, "mark": mark, "old": (table, ({},))})
    assert table.flags.writeable
    assert not first["table"].flags.writeable
    second = closed(first)
    assert second["table"] is first["table"]  # read-only before, and not copied again
    assert second["of"] is not first["of"]
    assert list(second["of"]) == [cpd]
    assert second["of"][cpd] is not first["of"][cpd]
    assert second["mark"] is mark
    pair = closed((1.0, table))
    assert closed(pair) is pair


@pytest.mark.parametrize("steps", [1000])
@pytest.mark.parametrize("made", [tuple, list])
def test_a_belief_may_refer_to_the_one_before(made, steps):
    class Remembering(Gamma):
        def begin(self, at):
            return made([super().begin(at), None])

        def predict(self, at, belief):
            return made([super().predict(at, belief[0]), belief])

        def moments(self, belief):
            return super().moments(belief[0])

        def numbers(self, belief):
            return super().numbers(belief[0])

    found, due = (
        pgm.filter(MODEL, {dose: np.ones((steps, 1))}, belief=each)
        for each in (Remembering(2.0, 1.0), FAMILY)
    )
    assert_allclose(found[rate].mean, due[rate].mean, rtol=1e-14)


class Slots:
    __slots__ = ("parts",)

    def __init__(self, parts):
        self.parts = parts


class Plain:
    def __init__(self, parts):
        self.parts = parts


@pytest.mark.parametrize("made", [list, Slots, Plain], ids=["a list", "slots", "an object"])
def test_a_belief_that_is_changed_in_place_shows_each_step_as_it_was(made):
    """It gets other parts by each method, and its parts (2, 1) are views of one buffer."""

    def parts(belief):
        return belief[0] if made is list else belief.parts

    class Rash(Gamma):
        def __init__(self):
            super().__init__(2.0, 1.0)
            self.buffer = np.empty((2, 1))

        def _again(self, belief):
            self.buffer[:] = belief
            view = self.buffer[:]
            return [view] if made is list else made(view)

        def begin(self, at):
            return self._again(super().begin(at))

        def predict(self, at, belief):
            moved = super().predict(at, parts(belief))
            if made is list:
                belief[0] = moved
            else:
                belief.parts = moved
            return belief

        def take(self, at, belief):
            known, log_density = super().take(at, parts(belief))
            return self._again(known), log_density

        def moments(self, belief):
            return super().moments(parts(belief))

        def numbers(self, belief):
            return super().numbers(parts(belief))

    evidence = {count: COUNTS, dose: DOSES}
    due, found = (pgm.filter(MODEL, evidence, belief=each) for each in (FAMILY, Rash()))
    assert_allclose(found[rate].mean, due[rate].mean, rtol=1e-14)
    assert_allclose(found.predicted[rate].mean, due.predicted[rate].mean, rtol=1e-14)
    robot = pgm.OnlineFilter(MODEL, belief=Rash())
    first = robot.initial()
    mean = first[rate].mean
    robot.predict(first)
    assert_allclose(first[rate].mean, mean, rtol=0.0)


class Single:
    def __init__(self):
        self.one = 1

    def __copy__(self):
        raise TypeError("not mine to copy")


@pytest.mark.parametrize(
    ("method", "value", "text"),
    [
        ("begin", None, r"begin\(at\) returned None; a belief was due"),
        ("predict", None, r"predict\(at, belief\) returned None"),
        ("begin", object(), "cannot be copied, as those of all steps are: TypeError: not mine"),
    ],
)
def test_a_belief_is_a_value_that_can_be_copied(method, value, text):
    made = Faulty(method, Single() if value else value)
    with pytest.raises(pgm.ModelError, match=text):
        pgm.filter(MODEL, {count: COUNTS, dose: DOSES}, belief=made)


def test_options_that_no_method_is_told_of_are_not_taken():
    class Taking(Gamma):
        takes = frozenset({"gate"})

    evidence = {count: COUNTS, dose: DOSES}
    with pytest.raises(pgm.ModelError, match="takes names options, 'gate', and is for a family"):
        pgm.filter(MODEL, evidence, belief=Taking(2.0, 1.0))


@pytest.mark.parametrize("back", [None, pgm.BeliefFamily.back], ids=["none", "the base's"])
def test_a_family_whose_back_is_none_is_filtered_alone(back):
    class Ahead(Gamma):
        pass

    Ahead.back = back
    assert not Ahead(2.0, 1.0).flows_back
    with pytest.raises(pgm.ModelError, match="says not how its beliefs flow back"):
        pgm.smooth(MODEL, {count: COUNTS, dose: DOSES}, belief=Ahead(2.0, 1.0))


def test_a_back_of_one_value_alone_is_one():
    family = Gamma(2.0, 1.0)
    family.back = lambda at, known, predicted, later: known
    assert family.flows_back
    smoothed = pgm.smooth(MODEL, {count: COUNTS, dose: DOSES}, belief=family)
    assert_allclose(smoothed[rate].mean, smoothed.filtered[rate].mean, rtol=0.0)


@pytest.mark.parametrize("base", [pgm.Grid, pgm.Particles])
@pytest.mark.parametrize("method", ["begin", "take", "moments", "numbers"])
def test_a_method_that_a_family_would_never_be_asked_is_refused(base, method):
    with pytest.raises(pgm.ModelError, match=f"Mine has {method}, which {base.__name__} never"):
        type("Mine", (base,), {method: lambda *_: None})
    assert issubclass(type("Named", (base,), {"beliefs": "mine"}), base)


def test_an_outcome_is_one():
    class Odd(Gamma):
        def infer(self, graph, bound, call):
            return 3

    with pytest.raises(pgm.ModelError, match="returned 3; an Outcome"):
        pgm.filter(MODEL, {count: COUNTS, dose: DOSES}, belief=Odd(2.0, 1.0))


def test_a_family_is_shown_in_brief():
    family = Gamma(2.0, 1.0)
    family.cells = np.linspace(0.0, 1.0, 400)
    assert "cells=array of shape (400,)" in repr(family)


def test_a_missing_reading_that_a_family_forgot_is_named():
    class Forgetful(Gamma):
        def take(self, at, belief):
            (seen,) = at.measurements
            return belief, seen.value[:, 0]

    counts = np.stack([COUNTS, np.where(np.isnan(COUNTS), 1.0, COUNTS)])
    with pytest.raises(pgm.NumericalError, match="step 2, run 0, is nan; count is missing there"):
        pgm.filter(MODEL, {count: counts, dose: DOSES}, belief=Forgetful(2.0, 1.0))
