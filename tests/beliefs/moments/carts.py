"""Drawn linear networks of a cart with a hidden control, and the joint that is due of them."""

import numpy as np
from dense import unrolled
from numpy.testing import assert_array_equal

import pgm

place, speed, push, fix, gauge = pgm.variables("place speed push fix gauge")


def two_states(rng, nonlinear=False):
    """A cart pushed by a hidden force, its place and its speed two variables, and its readings.

    As a nonlinear CPD a linear function is the same model, linearised wherever it is.
    """
    a, b, c, d = rng.uniform(0.5, 1.2, 4)

    def cpd(child, given, cov):
        if not nonlinear:
            return pgm.LinearGaussianCPD(child, given, cov=cov)
        return pgm.NonlinearGaussianCPD(
            child, tuple(given), lambda *values: sum(
                f * v for f, v in zip(given.values(), values, strict=True)
            ), cov=cov,
        )  # fmt: skip

    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(speed, 0.5, 0.3), pgm.GaussianCPD(place, 1.0, 2.0)],
        transition=[
            pgm.GaussianCPD(push, 0.1, 0.4),
            cpd(speed, {speed.previous: a, push: 1.0}, 0.05),
            cpd(place, {place.previous: b, speed: c}, 0.1),
        ],
        observation=[cpd(fix, {place: d}, 0.3), cpd(gauge, {push: 1.0, speed: -0.5}, 0.2)],
    )


def drawn(seed, nonlinear=False, runs=2, steps=7):
    """A network, its readings, missing ones among them, and who says what is due of a run."""
    rng = np.random.default_rng(seed)
    model = two_states(rng, nonlinear)
    linear = two_states(np.random.default_rng(seed))
    when = np.sort(rng.integers(0, steps + 1, 9))
    later = np.sort(rng.integers(1, steps + 1, 4))
    values = rng.normal(size=(runs, when.size, 1))
    values[rng.random(values.shape) < 0.15] = np.nan
    others = rng.normal(size=(runs, later.size, 1))
    evidence = {fix: pgm.sightings(values, step=when), gauge: pgm.sightings(others, step=later)}
    sightings = [(fix, int(t), {}) for t in when] + [(gauge, int(t), {}) for t in later]
    joint = unrolled(linear, steps, sightings=sightings)

    def due(run, last, *variables):
        """Moments of variables given the readings of a run up to a step, and ln p of these."""
        rows = [*values[run], *others[run]]
        known = {
            (seen[0], k): row
            for k, (seen, row) in enumerate(zip(sightings, rows, strict=True))
            if seen[1] <= last
        }
        after, log_density = joint.given(known)
        return *(after.marginal(*variables) if variables else (None, None)), log_density

    return model, evidence, steps, due


def lagged(model, evidence, lag, steps=None, rule=None, **options):
    """The posterior of a schedule, and of the keyword of `smooth`, which are the same."""
    rule = rule or pgm.Taylor()
    found = pgm.smooth(model, evidence, steps=steps, lineariser=rule, lag=lag, **options)
    graph = pgm.compile(model, found.graph.steps)
    schedule = pgm.FixedLag(lag, **options)
    other = pgm.infer(graph, evidence, schedule=schedule, lineariser=rule)
    hidden = (*model.states, *model.controls)
    for variable in hidden:
        assert_array_equal(found[variable].mean, other[variable].mean)
    assert (found.kind, repr(found).splitlines()[0]) == (other.kind, repr(other).splitlines()[0])
    return found
