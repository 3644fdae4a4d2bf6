"""What leaves machine code is told: by the graph of its CPDs, by the status of a call."""

import numpy as np
import pytest
from zoo import MODELS, recording

import pgm

pytest.importorskip("llvmlite", reason="sweeps are compiled by llvmlite")

A, Z = pgm.Variable("a", components=("p", "q")), pgm.Variable("s")
STEPS = 30
CONTROL = pgm.LevenbergMarquardt()


def swings(state):
    return state + 0.1 * np.sin(state)


def seen(state):
    return np.arctan(state[..., :1])


def network(cov=0.1, **sensor):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(A, [0, 0], 1.0)],
        [pgm.NonlinearGaussianCPD(A, (A.previous,), swings, cov=0.1)],
        [pgm.NonlinearGaussianCPD(Z, (A,), seen, cov=cov, **sensor)],
    )


EVIDENCE = network().sample(steps=STEPS, rng=0).evidence


def told(model, schedule, compiled=True, evidence=EVIDENCE, **options):
    graph = pgm.compile(model, STEPS, compiled=compiled)
    return pgm.infer(graph, evidence, schedule=schedule, **options).status, graph.compilation


@pytest.mark.parametrize(
    ("schedule", "whole", "why"),
    [
        (pgm.Filtering(), True, ""),
        (pgm.Filtering(iterations=3, tolerance=0), True, ""),
        (pgm.FixedLag(5), True, ""),
        (pgm.Smoothing(iterations=4, tolerance=0), True, ""),
        (pgm.Filtering(gate=0.99), True, ""),
        (pgm.Filtering(iterations=3, tolerance=0, damping=CONTROL), True, ""),
        (pgm.Smoothing(gate=0.99), True, ""),
        (pgm.FixedLag(4, gate=0.99), True, ""),
        (pgm.FixedLag(4, iterations=3, tolerance=0), True, ""),
        (pgm.FixedLag(4, iterations=3, tolerance=0, damping=CONTROL), True, "Levenberg"),
        (pgm.Smoothing(iterations=4, tolerance=0, damping=CONTROL), True, ""),
    ],
)
def test_schedules(schedule, whole, why):
    """Beforehand and after the call, of one run and of many."""
    many = {Z: np.stack([EVIDENCE[Z]] * 9)}
    for evidence in (EVIDENCE, many):
        status, compilation = told(network(), schedule, evidence=evidence)
        if not why:
            assert status.compilation == compilation.under(schedule) == "compiled"
            assert "; compiled" in str(status)
            continue
        begin = "not compiled: " if whole else "compiled, but for: "
        assert status.compilation.startswith(begin)
        assert why in status.compilation
        assert status.compilation in str(status)
        assert compilation.under(schedule).startswith("left to NumPy: ")
        assert why in compilation.under(schedule)


def test_slices_of_many_components():
    """Step control and windows of a lag leave machine code; filters and smoothers do not."""
    many = pgm.Variable("many", [f"c{k}" for k in range(12)])
    motion = pgm.NonlinearGaussianCPD(many, many.previous, np.sin, cov=np.eye(12))
    prior, sensor = pgm.GaussianCPD(many, np.zeros(12), np.eye(12)), pgm.Variable("sensor")
    read = pgm.NonlinearGaussianCPD(sensor, many, lambda x: np.sin(x[..., :1]), cov=1.0)
    model = pgm.DynamicBayesianNetwork([prior], [motion], [read])
    for schedule, left in [
        (pgm.Filtering(iterations=2, tolerance=0, damping=CONTROL), True),
        (pgm.FixedLag(2, iterations=2, tolerance=0), True),
        (pgm.Filtering(iterations=2, tolerance=0), False),
        (pgm.FixedLag(2), False),
    ]:
        graph = pgm.compile(model, 3, compiled=True)
        status = pgm.infer(graph, {sensor: np.zeros((3, 1))}, schedule=schedule).status
        assert ("few components" in graph.compilation.under(schedule)) == left
        assert ("few components" in status.compilation) == left


SENSORS = {
    "graduated": ({"noise": pgm.TruncatedLeastSquares(4)}, "graduated"),
    "many points": ({"lineariser": pgm.GaussHermite(12)}, "144 points; up to 128 are compiled"),
    "drawn points": ({"lineariser": pgm.MonteCarlo(20)}, "linearised by MonteCarlo"),
}


@pytest.mark.parametrize("name", SENSORS)
def test_cpds_are_told_by_the_graph_and_the_status(name):
    sensor, why = SENSORS[name]
    model = network(**sensor)
    for schedule in (pgm.Filtering(), pgm.Smoothing(iterations=3, tolerance=0)):
        status, compilation = told(model, schedule)
        assert why in compilation[model.observation[0]]
        assert why in compilation.under(schedule)
        assert why in status.compilation
        # A smoother's functions are called back by its filter, and left when it linearises again.
        assert status.compilation.split("but for: ")[-1].count(why) == 1


def test_the_lineariser_of_a_call():
    status, compilation = told(network(), pgm.Filtering(), lineariser=pgm.GaussHermite(12))
    assert set(compilation.values()) == {"compiled"}
    assert "144 points" in status.compilation
    few = told(network(), pgm.Filtering(), lineariser=pgm.Unscented())[0]
    assert few.compilation == "compiled"
    rule = {"lineariser": pgm.Unscented()}
    again = told(network(), pgm.Smoothing(iterations=3, tolerance=0), **rule)[0]
    assert again.compilation == "compiled"


@pytest.mark.parametrize("name", ["plain", "everything", "an exact range", "noise by landmark"])
def test_the_account_of_a_call_is_that_of_its_cpds(name):
    """The graph judges CPDs without a call, the status by the tables that kernels are given."""
    graph = pgm.compile(MODELS[name], 8, compiled=True)
    status = pgm.infer(graph, recording(name), schedule=pgm.Filtering()).status
    whole = set(graph.compilation.values()) == {"compiled"}
    assert whole == (status.compilation == "compiled")
    if not whole:  # a pass in twice the digits may yet be compiled
        assert status.compilation.startswith(("not compiled: ", "compiled, but for: "))


def test_runs_that_are_left_are_counted():
    """A prior as wide as this makes the reading of a run too sharp where it lies far off."""
    wide = network().replace(prior=[pgm.GaussianCPD(A, [0, 0], 1e5)])
    values = np.stack([EVIDENCE[Z]] * 9)
    values[np.arange(9) != 3] = np.nan
    status, _ = told(wide, pgm.Filtering(), evidence={Z: values})
    assert status.compilation.startswith("compiled, but for: readings are too sharp")
    assert status.compilation.endswith("in 1 of 9 runs")


def test_twice_the_digits():
    flat = network().replace(prior=[pgm.GaussianCPD(A, [0, 0], np.inf)])
    linear = pgm.LinearGaussianCPD(Z, {A: [[1.0, 0.5]]}, cov=0.1)
    status, _ = told(flat.replace(observation=[linear]), pgm.Smoothing())
    assert status.compilation.startswith("not compiled: float64 has too few digits")


def test_machine_code_that_is_not_due(monkeypatch):
    from pgm.beliefs.moments.compiled import sweep

    control = pgm.FixedLag(3, iterations=2, tolerance=0, damping=CONTROL)
    assert told(network(), control, compiled=False)[0].compilation == "by NumPy: compiled=False"
    status, _ = told(network(), control, compiled=None)
    assert "made for longer work" in status.compilation
    assert "NumPy" not in str(status)
    monkeypatch.setattr(sweep, "_LONG", 1)
    assert "Levenberg" in str(told(network(), control, compiled=None)[0])
    monkeypatch.setattr(sweep, "find_spec", lambda name: None)
    status, _ = told(network(), control, compiled=None)
    assert "llvmlite is not installed" in status.compilation
    assert "NumPy" not in str(status)


def test_runs_in_parts_tell_as_one():
    many = {Z: np.stack([EVIDENCE[Z]] * 9)}
    for schedule in (pgm.Filtering(iterations=2, tolerance=0), pgm.Filtering()):
        due = told(network(), schedule, evidence=many)[0]
        kept = told(network(), schedule, evidence=many, keep=[A])[0]
        assert kept.compilation == due.compilation


def test_a_filter_online_tells_of_its_settings_and_its_steps():
    model = network()
    for options, why in (({"schedule": pgm.FixedLag(2, iterations=2)}, "linearised again"),):
        told_of = pgm.OnlineFilter(model, compiled=True, **options).compilation
        assert told_of.startswith("not compiled: ")
        assert why in told_of
    assert pgm.OnlineFilter(model, compiled=False).compilation == "by NumPy: compiled=False"
    assert "would record the model's functions" in pgm.OnlineFilter(model).compilation
    quick = pgm.OnlineFilter(model, compiled=True)
    belief = quick.predict(quick.initial())
    quick.update(belief, {Z: [0.1]})
    assert quick.compilation == "compiled"
    quick.update(quick.initial(), {Z: [0.1]})
    assert quick.compilation == "compiled, but for: 1 × an update at step 0"
    robust = pgm.OnlineFilter(network(noise=pgm.TruncatedLeastSquares(4)), compiled=True)
    robust.update(robust.predict(robust.initial()), {Z: [0.1]})
    assert "noise" in robust.compilation
    slow = pgm.OnlineFilter(
        model, compiled=True, schedule=pgm.Filtering(iterations=2, tolerance=0.0, damping=CONTROL)
    )
    slow.update(slow.predict(slow.initial()), {Z: [0.1]})
    assert "steps are controlled" in slow.compilation
