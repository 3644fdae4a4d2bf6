"""Linearisers of the user: a plain callable, and a class with a form prepared for many calls."""

from dataclasses import dataclass

import numpy as np
import pytest
from crossed import crossed
from numpy.testing import assert_allclose
from robots import x
from zoo import MODELS, SIGHT, T, assert_same, at_step, of, of_run, recording

import pgm
from pgm.linearisers import ArrayLineariser, Line, apart


def bare(function, at):
    """First order, at a belief (..., n) with everything's own axes last."""
    value, slope = function(at.mean), function.jacobian(at.mean, at.std)
    offset = value - np.einsum("...ij,...j->...i", slope, at.mean)
    return pgm.AffineGaussian(slope, offset, np.zeros((value.shape[-1],) * 2))


def tangent(function, mean, cov):
    """The same of arrays with components first and the batch last."""
    size, *batch = mean.shape
    assert cov.shape[:2] == (size, size)
    points = np.moveaxis(mean, 0, -1)
    value, slope = function(points), function.jacobian(points)
    height = value.shape[-1]
    assert value.shape == (*batch, height)
    assert slope.shape == (*batch, height, size)
    if function.group is not None:
        assert height == function.group * function.template.height
    return Line(np.moveaxis(slope, (-2, -1), (0, 1)), np.moveaxis(value, -1, 0), None)


@dataclass(frozen=True)
class Prepared(ArrayLineariser):
    needs_cov = False

    def prepare(self, template):
        return tangent


class Alone:
    """With no base; what it is asked is told by a log."""

    def __init__(self):
        self.templates, self.batches = [], set()

    def prepare(self, template):
        self.templates.append(template)
        return self._line

    def needs_cov(self, template):
        return bool(template.numerical)

    def _line(self, function, mean, cov):
        self.batches.add(mean.shape[1:])
        return tangent(function, mean, cov)

    def __call__(self, function, at):
        raise AssertionError("the prepared form was not taken")


OWN = {"a callable": lambda: bare, "a class": Prepared, "a class of its own": Alone}
own = pytest.mark.parametrize("make", OWN.values(), ids=OWN)
# The callable is given the deviations that the steps of differences depend on, the others are not.
TOLERANCE = 1e-8
models = pytest.mark.parametrize(
    "name", ["plain", "numerical jacobians", "wrapping drive", "grouped", "everything"]
)


@own
@models
@crossed(("iterations", "run"), [1, 20], {"one": 1, "few": slice(None)})
def test_smoothing(make, name, iterations, run):
    """Its sightings one at a step, and several; of linearisations at all steps in one call."""
    evidence = of_run(recording(name), run)
    found, due = (
        pgm.smooth(MODELS[name], evidence, lineariser=rule, iterations=iterations)
        for rule in (make(), pgm.Taylor())
    )
    for row in [()] if run == 1 else [0, 2]:
        assert_same(of(found, row), of(due, row), TOLERANCE)
    assert found.status.iterations == due.status.iterations


@own
@pytest.mark.parametrize("name", ["plain", "grouped"])
@pytest.mark.parametrize("iterations", [1, 2])
def test_filters_of_many_runs(make, name, iterations):
    evidence = of_run(recording(name), np.arange(40) % 3)
    found, due = (
        pgm.filter(MODELS[name], evidence, lineariser=rule, iterations=iterations, tolerance=0)
        for rule in (make(), pgm.Taylor())
    )
    for run in (0, 38):
        assert_same(of(found, run, ("filtered",)), of(due, run, ("filtered",)), TOLERANCE)


@own
@models
@pytest.mark.parametrize("run", [1, slice(None)], ids=["one", "few"])
def test_online(make, name, run):
    robots = [pgm.OnlineFilter(MODELS[name], rule) for rule in (make(), pgm.Taylor())]
    beliefs = [robot.initial() for robot in robots]
    evidence = of_run(recording(name), run)
    for step in range(T + 1):
        inputs, readings = at_step(evidence, step)
        if step:
            beliefs = [robot.predict(b, inputs) for robot, b in zip(robots, beliefs, strict=True)]
        beliefs = [robot.update(b, readings) for robot, b in zip(robots, beliefs, strict=True)]
        found, due = beliefs
        assert_allclose(found.mean, due.mean, atol=TOLERANCE)
        assert_allclose(found.cov, due.cov, atol=TOLERANCE)
    assert_allclose(found.log_evidence, due.log_evidence, rtol=TOLERANCE)


@own
def test_a_balanced_tree(make):
    """Linearisations of all steps and runs are one call."""
    model = MODELS["plain"]
    evidence = recording("plain")
    graph = pgm.compile(model, T, method=pgm.Balanced())
    found, due = (
        pgm.infer(
            graph, evidence, schedule=pgm.Smoothing(iterations=3, tolerance=0), lineariser=rule
        )
        for rule in (make(), pgm.Taylor())
    )
    assert_allclose(found[x].mean, due[x].mean, atol=TOLERANCE)
    assert_allclose(found[x].cov, due[x].cov, atol=TOLERANCE)


@own
@pytest.mark.parametrize("lead", [(), (4,)])
def test_a_network_without_time(make, lead):
    place, seen = pgm.Variable("place", ("east", "north")), pgm.Variable("seen")
    sight = pgm.NonlinearGaussianCPD(
        seen, place, lambda p: np.hypot(p[..., 0], p[..., 1])[..., None], 0.1
    )
    net = pgm.BayesianNetwork([pgm.GaussianCPD(place, [1.0, 2.0], np.eye(2)), sight])
    evidence = {seen: np.linspace(2.0, 4.0, 4).reshape(4, 1) if lead else [3.0]}
    found, due = (
        pgm.infer(pgm.compile(net), evidence, lineariser=rule) for rule in (make(), pgm.Taylor())
    )
    assert_allclose(found[place].mean, due[place].mean, atol=TOLERANCE)
    assert_allclose(found[place].cov, due[place].cov, atol=TOLERANCE)


def test_what_a_class_is_asked():
    """Prepared once for each function; sightings of a step are one call, their batch last."""
    rule, evidence = Alone(), recording("plain")
    pgm.filter(MODELS["plain"], of_run(evidence, 1), lineariser=rule)
    assert len(rule.templates) == 2
    assert {template.child for template in rule.templates} == {x, SIGHT.z}
    assert rule.batches == {()}
    pgm.filter(MODELS["plain"], evidence, lineariser=rule)
    assert rule.batches == {(), (3,)}
    pgm.smooth(MODELS["plain"], evidence, lineariser=rule, iterations=2, tolerance=0)
    assert len(rule.batches) > 2
    assert all(batch[-1] == 3 for batch in rule.batches if batch)


@pytest.mark.parametrize("run", [1, slice(None)], ids=["one", "few"])
@pytest.mark.parametrize("name", ["plain", "grouped"])
def test_errors_of_sightings_are_joint_where_they_are_grouped(name, run):
    """Two of a step are one call; a prepared form is told whether their errors are one vector."""
    asked = set()

    def spread(function, at):
        line = pgm.Cubature()(function, at)
        return pgm.AffineGaussian(line.F, line.b, line.cov)

    class Regressed(ArrayLineariser):
        def prepare(self, template):
            prepared = pgm.Cubature().prepare(template)

            def line(function, mean, cov):
                asked.add((function.name, function.group, function.joint))
                return prepared(function, mean, cov)

            return line

    evidence = of_run(recording(name), run)
    due = pgm.filter(MODELS[name], evidence, lineariser=pgm.Cubature())
    for rule in (spread, Regressed()):
        found = pgm.filter(MODELS[name], evidence, lineariser=rule)
        assert_allclose(found[x].mean, due[x].mean, atol=1e-10)
        assert_allclose(found[x].cov, due[x].cov, atol=1e-10)
    assert ("z", 2, name == "grouped") in asked
    assert ("x", None, False) in asked


@pytest.mark.parametrize("fault", ["matrix", "value", "error", "nothing"])
@pytest.mark.parametrize("run", [1, slice(None)], ids=["one", "few"])
def test_a_prepared_form_that_returns_something_odd(fault, run):
    class Odd(Prepared):
        def prepare(self, template):
            def line(function, mean, cov):
                matrix, value, error = tangent(function, mean, cov)
                if template.child != SIGHT.z:
                    return Line(matrix, value, error)
                if fault == "matrix":
                    return Line(matrix[:, :2], value, error)
                if fault == "value":
                    return Line(matrix, value[:1], error)
                if fault == "error":
                    return Line(matrix, value, np.zeros((1, 1)))
                return None

            return line

    with pytest.raises(pgm.LinearisationError, match="returned") as caught:
        pgm.filter(MODELS["plain"], of_run(recording("plain"), run), lineariser=Odd())
    assert caught.value.cpd.child == SIGHT.z


@pytest.mark.parametrize("run", [1, slice(None)], ids=["one", "few"])
@pytest.mark.parametrize("argument", ["mean", "cov"])
def test_a_prepared_form_that_writes_into_its_arguments(argument, run):
    class Own(Prepared):
        def prepare(self, template):
            def line(function, mean, cov):
                found = tangent(function, mean.copy(), cov.copy())
                work = mean if argument == "mean" else cov
                work -= 1.0
                return found

            return line

    with pytest.raises(pgm.ModelError, match="read-only"):
        pgm.filter(MODELS["plain"], of_run(recording("plain"), run), lineariser=Own())


@pytest.mark.parametrize("run", [1, slice(None)], ids=["one", "few"])
@pytest.mark.parametrize("prepared", [False, True], ids=["a callable", "prepared"])
def test_an_error_that_is_not_symmetric(prepared, run):
    def error(size):
        return np.eye(size) + np.triu(np.full((size, size), 0.5), 1)

    def uneven(function, at):
        found = bare(function, at)
        return pgm.AffineGaussian(found.F, found.b, error(found.b.shape[-1]))

    class Uneven(Prepared):
        def prepare(self, template):
            def line(function, mean, cov):
                matrix, value, _ = tangent(function, mean, cov)
                batch = value.shape[1:]
                spread = np.multiply.outer(error(len(value)), np.ones(batch))
                return Line(matrix, value, spread)

            return line

    rule = Uneven() if prepared else uneven
    with pytest.raises(pgm.LinearisationError, match="not symmetric"):
        pgm.filter(MODELS["plain"], of_run(recording("plain"), run), lineariser=rule)


def test_a_single_sighting_apart_is_the_sighting():
    class Apart(Prepared):
        def prepare(self, template):
            return lambda *arguments: apart(tangent, *arguments)

    evidence = of_run(recording("plain"), 1)
    found = pgm.filter(MODELS["plain"], evidence, lineariser=Apart())
    due = pgm.filter(MODELS["plain"], evidence, lineariser=Prepared())
    assert_allclose(found[x].mean, due[x].mean, atol=1e-12)


def test_a_need_that_is_no_answer():
    class Odd(Prepared):
        needs_cov = "perhaps"

    evidence = of_run(recording("plain"), 1)
    with pytest.raises(pgm.LinearisationError, match="needs_cov is 'perhaps'; True or False"):
        pgm.smooth(MODELS["plain"], evidence, lineariser=Odd(), iterations=3)


class Tipped(pgm.StatisticalRegression):
    """Points at a distance of ±scale √n along each axis: those of N(0, I) at a scale of one."""

    def __init__(self, scale=1.0, drawn=False):
        self.scale, self._drawn = scale, drawn

    @property
    def drawn(self):
        return self._drawn

    def points(self, dimension, name, step):
        arm = self.scale * np.sqrt(dimension) * np.eye(dimension)
        weights = np.full(2 * dimension, 0.5 / dimension)
        return pgm.linearisers.Points(np.vstack([arm, -arm]), weights, weights, False)


def test_a_rule_of_ones_own_is_told_by_its_parameters():
    one, other = Tipped(), Tipped(2.0)
    assert one != other
    assert one == one
    assert repr(other) == "Tipped(scale=2.0, _drawn=False)"
    evidence = of_run(recording("plain"), 1)
    found = pgm.compare(MODELS["plain"], evidence, linearisers=[one, Tipped(1.0, drawn=True)])
    assert "Tipped(scale=1.0, _drawn=True)" in str(found)


@pytest.mark.parametrize("scale", [1.1, 0.5, np.nan, 0.0])
def test_points_with_other_moments_than_they_stand_for(scale):
    evidence = of_run(recording("plain"), 1)
    with pytest.raises(pgm.LinearisationError, match=r"are not those of N\(0, I\).*`drawn`"):
        pgm.filter(MODELS["plain"], evidence, lineariser=Tipped(scale))


class Lopsided(pgm.StatisticalRegression):
    """Points of N(0, I), with weights of one kind that say otherwise."""

    def __init__(self, kind):
        self.kind = kind

    def points(self, dimension, name, step):
        arm = np.sqrt(dimension) * np.eye(dimension)
        s = np.vstack([np.zeros(dimension), arm, -arm])
        even = np.append(0.0, np.full(2 * dimension, 0.5 / dimension))
        odd = np.append(0.5, 0.5 * even[1:])
        if self.kind == "mean_weights":
            odd[[1, -1]] += [0.1, -0.1]
        pair = {"mean_weights": even, "cov_weights": even, self.kind: odd}
        return pgm.linearisers.Points(s, **pair, centred=True)


@pytest.mark.parametrize(
    ("kind", "fault"), [("mean_weights", "Σ w s is off zero"), ("cov_weights", "is off I by 0.5")]
)
def test_moments_are_of_both_weights(kind, fault):
    with pytest.raises(pgm.LinearisationError, match=f"with their {kind} w, .*{fault}"):
        pgm.filter(MODELS["plain"], of_run(recording("plain"), 1), lineariser=Lopsided(kind))


@pytest.mark.parametrize(
    "rule",
    [
        pgm.Unscented(alpha=1e-6),
        pgm.Unscented(alpha=1e-3, kappa=3.0),
        pgm.Cubature(),
        pgm.GaussHermite(2),
        pgm.GaussHermite(20),
    ],
    ids=repr,
)
@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_points_that_ship_have_the_moments(rule, dimension):
    assert rule.points(dimension, "y", 0).fault is None


def test_an_error_that_is_shared_by_sightings():
    """Where each sighting has an error of its own, a correlated one is none."""

    class Shared(Prepared):
        def __init__(self, grouped):
            object.__setattr__(self, "grouped", grouped)

        def prepare(self, template):
            def line(function, mean, cov):
                if self.grouped and function.group and not function.joint:
                    return apart(line, function, mean, cov)
                matrix, value, _ = tangent(function, mean, cov)
                spread = np.multiply.outer(np.ones((len(value),) * 2), np.ones(value.shape[1:]))
                return Line(matrix, value, spread)

            return line

    evidence = of_run(recording("plain"), 1)
    with pytest.raises(pgm.LinearisationError, match=r"correlated between .* return pgm.linear"):
        pgm.filter(MODELS["plain"], evidence, lineariser=Shared(grouped=False))
    assert pgm.filter(MODELS["plain"], evidence, lineariser=Shared(grouped=True))
