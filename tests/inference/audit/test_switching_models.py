"""Audits of switching models, against the sum over all sequences of modes."""

from itertools import pairwise, product

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm
from pgm.beliefs.hypotheses.paths import PathLaw
from pgm.beliefs.hypotheses.records import Asked
from pgm.beliefs.hypotheses.run import passes
from pgm.schedules.options import Call
from tests.beliefs.hypotheses import enumerated


def drawn(seed, steps=6, **form):
    rng = np.random.default_rng(seed)
    found = enumerated.drawn(rng, **form)
    return found, found.drawn(rng, steps)


@pytest.mark.parametrize("belief", [None, pgm.Gaussians(mix=True), pgm.Gaussians(300)])
@pytest.mark.parametrize("form", [{}, {"modes": 3, "zeros": True}], ids=["two", "three"])
def test_an_audit_finds_what_enumeration_does(form, belief):
    """Whatever was merged: the log-evidence, and moments and probabilities at all steps."""
    model, values = drawn(3, steps=5, **form)
    total, modes, mean, cov = model.enumerated(values)
    posterior = pgm.smooth(model.model, {model.z: values}, belief=belief)
    found = pgm.audit(posterior, samples=8000, rng=1)
    assert found.trusted
    assert not found.suspect
    assert abs(found.log_evidence - total) < 5.0 * found.standard_error + 1e-6
    assert_allclose(found.corrected[model.mode].probabilities, modes, atol=0.03)
    std = np.sqrt(np.diagonal(cov, axis1=-2, axis2=-1))
    assert (np.abs(found.corrected[model.x].mean - mean) < 0.06 * std).all()
    own = found.corrected[model.x].std
    assert_allclose(own, std, rtol=0.06)
    assert found.effective_sample_size > 4000.0


def test_an_answer_that_is_wrong_is_suspect():
    """A single Gaussian for a mode that is told nats apart: log-evidence and beliefs are off."""
    x, z = pgm.variables("x z")
    mode = pgm.Discrete("mode", states=("left", "right"))
    cases = {
        name: pgm.LinearGaussianCPD(x, {x.previous: 1.0}, offset=off, cov=0.1)
        for name, off in (("left", -3.0), ("right", 3.0))
    }
    even = pgm.TableCPD(mode, table=[0.5, 0.5])
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 0.1)],
        [even, pgm.SwitchingCPD(x, mode, cases)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1)],
    )
    given = {z: [[np.nan], [np.nan], [9.0]]}
    right = pgm.audit(pgm.smooth(model, given, belief=pgm.Gaussians(8)), samples=500, rng=0)
    wrong = pgm.audit(pgm.smooth(model, given), samples=500, rng=0)
    assert right.trusted
    assert not right.suspect
    assert wrong.suspect
    assert "SUSPECT" in repr(wrong)


def test_a_filter_is_judged_by_its_last_step_and_runs_by_themselves():
    model, _ = drawn(4)
    rng = np.random.default_rng(4)
    values = np.stack([model.drawn(rng, 6) for _ in range(3)])
    values[1, 2] = np.nan
    posterior = pgm.filter(model.model, {model.z: values})
    found = pgm.audit(posterior, samples=2000, rng=1)
    for run in range(3):
        total, modes, mean, _ = model.enumerated(values[run])
        assert abs(found.log_evidence[run] - total) < 5.0 * found.standard_error[run] + 1e-6
        assert_allclose(found.corrected[model.mode].probabilities[run], modes, atol=0.06)
        assert_allclose(found.corrected[model.x].mean[run], mean, atol=0.2)
    assert not found.suspect.any()
    assert "x[6]" in repr(found) or "mode[6]" in repr(found)


def test_the_law_of_paths_has_the_probabilities_that_it_draws_by():
    """Sums over all paths are one; draws are as frequent as they are probable; both laws."""
    model, values = drawn(5, steps=3, modes=3, zeros=True)
    graph = pgm.compile(model.model, 3)
    bound = graph and pgm.smooth(model.model, {model.z: values})._outcome._asked[0]
    call = Call(pgm.Smoothing())
    _, backward = passes(graph, bound, call, Asked(None, mix=False))
    law, rng = PathLaw(backward), np.random.default_rng(0)
    every = np.array(list(product(range(3), repeat=4))).T[..., None]
    for wide in (False, True):
        share = np.exp(law.log_probability(every, defensive=wide)[:, 0])
        assert share.sum() == pytest.approx(1.0)
        paths = law.drawn(20_000, rng, defensive=wide)[..., 0]
        number = np.ravel_multi_index(tuple(paths), (3,) * 4)
        counts = np.bincount(number, minlength=81) / 20_000
        assert_allclose(counts, share, atol=5.0 * np.sqrt(0.25 / 20_000))
        assert not counts[share == 0.0].any()


def test_controls_inputs_observed_modes_and_tables():
    """The correction is that of an answer which keeps all sequences."""
    m, w = pgm.Discrete("m", states=("a", "b")), pgm.Discrete("w", states=("p", "q"))
    y = pgm.Discrete("y", states=("n", "o"))
    x, z, u, h = pgm.variables("x z u h")
    line = pgm.LinearGaussianCPD
    moves = {
        (i, j): line(x, {x.previous: 0.9, u: 1.0, h: 0.5}, cov=0.1 + i + 2 * j)
        for i in range(2)
        for j in range(2)
    }
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(m, table=[0.4, 0.6]), pgm.GaussianCPD(x, 0.0, 1.0)],
        [
            pgm.TableCPD(m, m.previous, table=[[0.8, 0.2], [0.3, 0.7]]),
            pgm.GaussianCPD(h, 0.0, 1.0),
            pgm.SwitchingCPD(x, (m, w), moves),
        ],
        [line(z, {x: 1.0}, cov=0.3), pgm.TableCPD(y, m, table=[[0.9, 0.1], [0.3, 0.7]])],
    )
    given = {
        u: np.linspace(-1.0, 1.0, 6)[:, None],
        w: ["p", "q", "q", "p", "p", "q"],
        z: np.array([0.0, 1.0, np.nan, -2.0, 0.5, 1.0])[:, None],
        y: [0, 1, 1, 0, 0, 1],
    }
    due = pgm.smooth(model, given, belief=pgm.Gaussians(200))
    found = pgm.audit(pgm.smooth(model, given), samples=4000, rng=2)
    assert abs(found.log_evidence - due.log_evidence) < 5.0 * found.standard_error
    for variable in (x, h):
        assert_allclose(found.corrected[variable].mean, due[variable].mean, atol=0.1)
    assert_allclose(found.corrected[m].probabilities, due[m].probabilities, atol=0.05)
    assert found.moment_divergence[h].shape == (6,)
    assert found.moment_divergence[m].shape == (7,)


def test_what_is_not_audited():
    model, values = drawn(6)
    x, z = model.x, model.z
    push = pgm.Variable("push")
    bent = pgm.NonlinearGaussianCPD(x, (x.previous, push), lambda x, u: x + np.sin(u), cov=0.1)
    other = [cpd for cpd in model.model.transition if cpd.discrete]
    pushed = model.model.replace(transition=[*other, pgm.GaussianCPD(push, 0.0, 1.0), bent])
    with pytest.raises(pgm.ModelError, match="push is a hidden control"):
        pgm.audit(pgm.smooth(pushed, {z: values}), rng=0)
    bare = pgm.NonlinearGaussianCPD(x, x.previous, np.sin, cov=np.zeros((x.dimension,) * 2))
    exact = model.model.replace(transition=[*other, bare])
    with pytest.raises(pgm.NumericalError, match="has no noise of its own"):
        pgm.audit(pgm.smooth(exact, {z: values}), rng=0)
    fork = pgm.Discrete("fork", states=("l", "r"))
    cases = {k: pgm.GaussianCPD(A, float(k), 0.0) for k in range(2)}
    certain = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(fork, table=[0.5, 0.5]), pgm.SwitchingCPD(A, fork, cases)],
        [
            pgm.TableCPD(fork, fork.previous, table=np.eye(2)),
            pgm.LinearGaussianCPD(A, {A.previous: 1.0}, cov=0.0),
        ],
        [pgm.LinearGaussianCPD(C, {A: 1.0}, cov=0.0)],
    )
    with pytest.raises(pgm.NumericalError, match="sensors without noise were read"):
        pgm.audit(pgm.smooth(certain, {C: [[1.0]]}), rng=0)
    several = pgm.smooth(curved_alone(), {C: [[1.0]]}, belief=pgm.Gaussians(2, starts=4))
    with pytest.raises(pgm.ModelError):
        pgm.audit(several, rng=0)


A, C = pgm.variables("a c")


def curved_alone():
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(A, 0.1, 1.0)],
        [pgm.LinearGaussianCPD(A, {A.previous: 1.0}, cov=0.1)],
        [pgm.NonlinearGaussianCPD(C, A, lambda a: a**2, cov=0.1)],
    )


@pytest.mark.parametrize("seed", range(5))
def test_modes_of_which_the_readings_say_nothing(seed):
    """All weights are equal but for rounding: the estimate is the answer, without an error."""
    x, z = pgm.variables("x z")
    fault = pgm.Discrete("fault", states=("no", "yes"))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [
            pgm.TableCPD(fault, table=[0.3, 0.7]),
            pgm.LinearGaussianCPD(x, {x.previous: 0.9}, cov=0.1),
        ],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.3)],
    )
    readings = 3.0 * np.random.default_rng(seed).standard_normal((3, 1))
    posterior = pgm.smooth(model, {z: readings})
    found = pgm.audit(posterior, samples=2000, rng=seed)
    assert found.trusted
    assert found.log_evidence == pytest.approx(posterior.log_evidence, abs=1e-9)
    assert found.standard_error < 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_trusted_of_exact_answers(seed):
    """Where nothing was merged, no seed of the draws makes an audit doubt the answer."""
    model, values = drawn(seed, steps=5)
    posterior = pgm.smooth(model.model, {model.z: values}, belief=pgm.Gaussians(100))
    found = pgm.audit(posterior, samples=1000, rng=seed)
    assert found.trusted
    assert not found.suspect
    assert abs(found.log_evidence - posterior.log_evidence) < 5.0 * found.standard_error + 1e-9


RARE = 1e-4


def rare(steps, reading, *, remembered):
    """A jump of probability 1e-4 a step, one reading at the end, and ln p of the enumeration."""
    x, z = pgm.variables("x z")
    fault = pgm.Discrete("fault", states=("no", "yes"))
    line = pgm.LinearGaussianCPD
    cases = {
        "no": line(x, {x.previous: 1.0}, cov=0.1),
        "yes": line(x, {x.previous: 1.0}, offset=5.0, cov=0.1),
    }
    first = pgm.TableCPD(fault, table=[1 - RARE, RARE])
    table, prior = [[1 - RARE, RARE], [0.3, 0.7]], [pgm.GaussianCPD(x, 0.0, 0.1)]
    model = pgm.DynamicBayesianNetwork(
        [first, *prior] if remembered else prior,
        [
            pgm.TableCPD(fault, fault.previous, table=table) if remembered else first,
            pgm.SwitchingCPD(x, fault, cases),
        ],
        [line(z, {x: 1.0}, cov=0.1)],
    )
    values = np.full((steps, 1), np.nan)
    values[-1] = reading
    start, total = np.array([1 - RARE, RARE]), 0.0
    for path in product(range(2), repeat=steps + 1 if remembered else steps):
        weight = start[path[0]]
        for before, after in pairwise(path):
            weight *= table[before][after] if remembered else start[after]
        jumps = sum(path[1:] if remembered else path)
        var = 0.1 * (steps + 2)
        gone = reading - 5.0 * jumps
        total += weight * np.exp(-0.5 * gone**2 / var) / np.sqrt(2.0 * np.pi * var)
    return model, {z: values}, np.log(total), fault


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("remembered", [False, True])
@pytest.mark.parametrize(("steps", "reading"), [(3, 5.0), (5, 5.0), (4, 10.0), (4, 15.0)])
def test_paths_that_the_answer_left_out_are_seen(seed, remembered, steps, reading):
    """They are as rare as a fault is; by the answer alone they would never be drawn."""
    model, given, total, _ = rare(steps, reading, remembered=remembered)
    found = pgm.audit(pgm.smooth(model, given), samples=4000, rng=seed)
    assert abs(found.log_evidence - total) < 5.0 * found.standard_error + 1e-6
    assert found.standard_error < 0.2


@pytest.mark.parametrize("seed", range(4))
def test_a_control_that_hardly_varies_does_not_carry_an_estimate_away(seed):
    model, given, total, _ = rare(4, 15.0, remembered=True)
    posterior = pgm.smooth(model, given, belief=pgm.Gaussians(300))
    assert posterior.log_evidence == pytest.approx(total, abs=1e-9)
    found = pgm.audit(posterior, samples=1000, rng=seed)
    assert abs(found.log_evidence - total) < 5.0 * found.standard_error


def turned(x):
    return np.sin(x) + x


def bent(x):
    return x + 0.15 * x**2


def test_nonlinear_cases_against_a_grid_of_each_path():
    """Log-evidence, probabilities and means; of two runs, with a reading that is missing."""
    x, z, which = pgm.variables("x z which")
    mode = pgm.Discrete("mode", states=("slow", "fast"))
    first, table = np.array([0.3, 0.7]), np.array([[0.8, 0.2], [0.3, 0.7]])
    line, curve = pgm.LinearGaussianCPD, pgm.NonlinearGaussianCPD
    moves = {0: line(x, {x.previous: 0.5}, cov=0.1), 1: curve(x, x.previous, turned, cov=0.3)}
    sights = {0: curve(z, x, bent, cov=0.2), 1: line(z, {x: 1.0}, cov=0.2)}
    model = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(mode, table=first), pgm.GaussianCPD(x, 1.0, 0.2)],
        [pgm.TableCPD(mode, mode.previous, table=table), pgm.SwitchingCPD(x, mode, moves)],
        [pgm.SwitchingCPD(z, mode, sights)],
    )
    values = np.array([[[1.1], [np.nan], [2.9]], [[0.7], [1.5], [1.9]]])
    noise = pgm.noise(lambda k: np.where(k > 0.5, 0.3, 0.1)[..., None], given=which)
    twin = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 1.0, 0.2)],
        [curve(x, (x.previous, which), lambda x, k: np.where(k > 0.5, turned(x), 0.5 * x), noise)],
        [curve(z, (x, which), lambda x, k: np.where(k > 0.5, x, bent(x)), cov=0.2)],
    )
    paths = np.array(list(product(range(2), repeat=4)))
    cells = pgm.Grid({"x": (-5.0, 9.0, 500)})
    logs = np.log(first[paths[:, 0]]) + np.log(table[paths[:, :-1], paths[:, 1:]]).sum(axis=1)
    found = pgm.audit(pgm.smooth(model, {z: values}), samples=6000, rng=0)
    assert found.trusted.all()
    for run in range(2):
        given = {z: np.broadcast_to(values[run], (16, 3, 1)), which: paths[:, 1:, None] * 1.0}
        exact = pgm.smooth(twin, given, belief=cells)
        each = logs + exact.log_evidence
        total = np.logaddexp.reduce(each)
        share = np.exp(each - total)
        off = abs(found.log_evidence[run] - total)
        assert off < 4.0 * found.standard_error[run]
        assert found.standard_error[run] < 0.02
        fast = found.corrected[mode].probabilities[run, :, 1]
        assert_allclose(fast, share @ paths, atol=0.03)
        mean = np.einsum("p,pti->ti", share, exact[x].mean)
        assert_allclose(found.corrected[x].mean[run], mean, atol=0.04)


def test_functions_that_are_lines_are_audited_as_lines():
    """All densities of trajectories, of partly missing readings and of tables, against the sum."""
    model, values = drawn(7, steps=5)
    values[2] = np.nan
    values[3, 0] = np.nan
    lines = {
        k: pgm.NonlinearGaussianCPD(
            model.z,
            model.x,
            lambda x, k=k: x @ model.h[k].T + model.c[k],
            cov=model.r[k],
        )
        for k in range(2)
    }
    curved = model.model.replace(
        observation=[pgm.SwitchingCPD(model.z, model.mode, lines)],
    )
    total, modes, mean, _ = model.enumerated(values)
    found = pgm.audit(pgm.smooth(curved, {model.z: values}), samples=4000, rng=0)
    assert abs(found.log_evidence - total) < 5.0 * found.standard_error + 1e-6
    assert_allclose(found.corrected[model.mode].probabilities, modes, atol=0.04)
    assert_allclose(found.corrected[model.x].mean, mean, atol=0.15)


def test_nonlinear_cases_by_the_mode_before_beside_observed_ones_and_tables():
    """Functions that are lines: the correction is the answer of the linear model, of two runs."""
    x, z = pgm.variables("x z")
    mode, load = pgm.Discrete("mode", states=("a", "b")), pgm.Discrete("load", states=("p", "q"))
    seen = pgm.Discrete("seen", states=("n", "o"))

    def made(curved):
        def cpd(child, parent, slope, cov):
            if not curved:
                return pgm.LinearGaussianCPD(child, {parent: slope}, cov=cov)
            return pgm.NonlinearGaussianCPD(child, parent, lambda v: slope * v, cov=cov)

        moves = {
            (i, j, k): cpd(x, x.previous, 0.5 + 0.3 * i + 0.2 * j, 0.1 + k)
            for i, j, k in product(range(2), repeat=3)
        }
        return pgm.DynamicBayesianNetwork(
            [pgm.TableCPD(mode, table=[0.4, 0.6]), pgm.GaussianCPD(x, 1.0, 1.0)],
            [
                pgm.TableCPD(mode, mode.previous, table=[[0.8, 0.2], [0.3, 0.7]]),
                pgm.SwitchingCPD(x, (mode.previous, mode, load), moves),
            ],
            [
                cpd(z, x, 1.0, 0.3),
                pgm.TableCPD(seen, mode, table=[[0.9, 0.1], [0.3, 0.7]]),
            ],
        )

    readings = np.array([[0.5, 1.5, np.nan, -1.0], [2.0, 0.3, 0.4, 0.9]])[..., None]
    given = {z: readings, load: [0, 1, 1, 0], seen: [[0, 1, 1, 0], [1, 1, 0, 0]]}
    due = pgm.smooth(made(curved=False), given, belief=pgm.Gaussians(64))
    found = pgm.audit(pgm.smooth(made(curved=True), given), samples=4000, rng=0)
    off = np.abs(found.log_evidence - due.log_evidence)
    assert (off < 5.0 * found.standard_error + 1e-6).all()
    assert (found.standard_error < 0.02).all()
    assert_allclose(found.corrected[x].mean, due[x].mean, atol=0.06)
    assert_allclose(found.corrected[mode].probabilities, due[mode].probabilities, atol=0.04)
