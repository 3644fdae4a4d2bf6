"""The most probable path of modes, against all paths."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import pgm
from tests.beliefs.hypotheses.enumerated import drawn
from tests.beliefs.hypotheses.test_switching_chains import READ, walk


def weigh(world, values, path):
    """ln p(path, values) of a drawn switching model, by the joint of all measurements."""
    n, d, steps = world.f.shape[-1], values.shape[1], len(values)
    weight = np.log(world.first[path[0]])
    mean, rows, noise = np.zeros(n), np.eye(n, n * (steps + 1)), [np.eye(n)]
    seen, expected, extra = [], [], []
    for t, s in enumerate(path[1:], 1):
        weight += np.log(world.table[path[t - 1], s])
        rows = world.f[s] @ rows
        rows[:, n * t : n * (t + 1)] = np.eye(n)
        mean = world.f[s] @ mean + world.b[s]
        noise.append(world.q[s])
        seen.append(world.h[s] @ rows)
        expected.append(world.h[s] @ mean + world.c[s])
        extra.append(world.r[s])
    spread, own = np.zeros((n * (steps + 1),) * 2), np.zeros((d * steps,) * 2)
    for t, each in enumerate(noise):
        spread[n * t : n * (t + 1), n * t : n * (t + 1)] = each
    for t, each in enumerate(extra):
        own[d * t : d * (t + 1), d * t : d * (t + 1)] = each
    h = np.concatenate(seen)
    law = multivariate_normal(np.concatenate(expected), h @ spread @ h.T + own)
    return weight + law.logpdf(values.ravel())


@pytest.mark.parametrize("seed", range(6))
def test_the_likeliest_of_all_paths(seed):
    rng = np.random.default_rng(seed)
    world = drawn(rng, 2, int(rng.integers(1, 3)), 1)
    values = world.drawn(rng, 5)
    with np.errstate(divide="ignore"):
        every = {path: weigh(world, values, path) for path in product(range(2), repeat=6)}
    best = max(every, key=every.get)
    found = pgm.most_probable(pgm.compile(world.model, 5), {world.z: values})
    assert found.exact
    assert tuple(found.assignment[world.mode]) == best
    assert found.log_probability == pytest.approx(every[best], abs=1e-10)


def test_few_paths_that_are_kept_are_told_of():
    rng = np.random.default_rng(1)
    world = drawn(rng, 2, 2, 1)
    values = np.stack([world.drawn(rng, 12) for _ in range(4)]).reshape(2, 2, 12, 1)
    graph = pgm.compile(world.model, 12)
    whole = pgm.most_probable(graph, {world.z: values}, paths=2**13)
    few = pgm.most_probable(graph, {world.z: values}, paths=3)
    assert whole.exact.all()
    assert not few.exact.any()
    assert whole.assignment[world.mode].shape == (2, 2, 13)
    assert np.all(few.log_probability <= whole.log_probability + 1e-9)
    beam = pgm.most_probable(graph, {world.z: values})
    assert np.abs(beam.log_probability - whole.log_probability).max() < 1e-9
    assert np.array_equal(beam.assignment[world.mode], whole.assignment[world.mode])
    assert beam.states(world.mode).shape == (2, 2, 13)


def test_a_control_that_chooses_has_a_path_from_step_one():
    """Of a mode without memory each step's likeliest state is the path's, for the last step."""
    x, z, kick = pgm.Variable("x"), pgm.Variable("z"), pgm.Discrete("kick", states=("no", "yes"))
    cases = {s: pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=q) for s, q in ((0, 0.01), (1, 9))}
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[
            pgm.TableCPD(kick, table=[0.8, 0.2]),
            pgm.SwitchingCPD(
                x, given=kick, cases=dict(zip(kick.states, cases.values(), strict=True))
            ),
        ],
        observation=[pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1)],
    )
    read = {z: [[0.1], [5.0], [5.2]]}
    found = pgm.most_probable(pgm.compile(model, 3), read)
    assert found.assignment[kick].tolist() == [0, 1, 0]
    assert found.exact


def test_what_has_no_path_of_modes_is_refused():
    graph = pgm.compile(walk(), 5)
    with pytest.raises(pgm.GraphError, match="1 or more; found 0"):
        pgm.most_probable(graph, READ, paths=0)
    from pgm.examples import rainy, wet

    with pytest.raises(pgm.GraphError, match="no discrete variables beside"):
        pgm.most_probable(pgm.compile(rainy), {wet: "yes"}, paths=4)


def test_a_path_that_makes_more_certain_later_is_kept():
    """One mode makes the first reading certain, the other the two that follow."""
    x, s = pgm.Variable("x"), pgm.Discrete("s", states=("p", "q"))
    names = pgm.variables("a b c")

    def sensor(child, certain):
        cases = {
            k: pgm.LinearGaussianCPD(child, {x: 0.0}, cov=0.0 if k == certain else 1.0)
            for k in s.states
        }
        return pgm.SwitchingCPD(child, given=s, cases=cases)

    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(s, table=[0.5, 0.5]), pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[
            pgm.TableCPD(s, given=s.previous, table=np.eye(2)),
            pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1),
        ],
        observation=[sensor(v, k) for v, k in zip(names, "pqq", strict=True)],
    )
    steps = 1, 2, 2
    read = {v: pgm.sightings([[0.0]], step=[t]) for v, t in zip(names, steps, strict=True)}
    found = pgm.most_probable(pgm.compile(model, 2), read)
    assert found.states(s).tolist() == ["q", "q", "q"]
    assert found.exact


def test_a_path_of_a_nonlinear_model_is_not_called_exact():
    x, z, s = pgm.Variable("x"), pgm.Variable("z"), pgm.Discrete("s", states=("p", "q"))
    sensor = {k: pgm.NonlinearGaussianCPD(z, x, np.sin, cov=c) for k, c in (("p", 0.1), ("q", 1.0))}
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(s, table=[0.5, 0.5]), pgm.GaussianCPD(x, 0.0, 1.0)],
        transition=[
            pgm.TableCPD(s, given=s.previous, table=[[0.9, 0.1], [0.1, 0.9]]),
            pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1),
        ],
        observation=[pgm.SwitchingCPD(z, given=s, cases=sensor)],
    )
    found = pgm.most_probable(pgm.compile(model, 2), {z: [[0.1], [0.9]]})
    assert not found.exact
