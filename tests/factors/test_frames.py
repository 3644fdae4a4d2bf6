"""Beliefs and tables as data frames of pandas."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import pgm

pandas = pytest.importorskip("pandas")

x = pgm.Variable("x", components=("east", "heading"), angles=("heading",))
a = pgm.Variable("a")
RNG = np.random.default_rng(0)
rain = pgm.Discrete("rain", states=("no", "yes"))
sky = pgm.Discrete("sky", states=("clear", "cloudy", "dark"))


def test_runs_and_steps_are_in_the_index():
    belief = pgm.Gaussian(x, RNG.normal(size=(3, 4, 2)), [4.0, 1.0], steps=[1, 2, 3, 4])
    frame = belief.to_frame()
    assert list(frame.columns) == ["mean_east", "mean_heading", "std_east", "std_heading"]
    assert frame.index.names == ["run", "step"]
    assert frame.shape == (12, 4)
    for run in range(3):
        for row, step in enumerate([1, 2, 3, 4]):
            assert frame.loc[(run, step), "mean_heading"] == belief.mean[run, row, 1]
    assert_array_equal(frame["std_east"], 2.0)


@pytest.mark.parametrize(
    ("lead", "steps", "names"),
    [
        ((), None, [None]),
        ((5,), None, ["run"]),
        ((5,), range(5), ["step"]),
        ((2, 3), None, ["run_0", "run_1"]),
        ((2, 3, 4), range(4), ["run_0", "run_1", "step"]),
    ],
)
def test_levels_are_named_by_what_they_are(lead, steps, names):
    frame = pgm.Gaussian(x, RNG.normal(size=(*lead, 2)), 1.0, steps=steps).to_frame()
    assert list(frame.index.names) == names
    assert len(frame) == np.prod(lead, dtype=int)


def test_components_of_one_name_have_that_of_their_variable():
    joint = pgm.Gaussian((x.at(3), x.at(4), a.at(3), a.at(4)), np.arange(6), 1.0)
    due = ("x[3].east", "x[3].heading", "x[4].east", "x[4].heading", "a[3]", "a[4]")
    assert joint.components == due
    assert list(joint.to_frame().columns[:6]) == [f"mean_{label}" for label in due]
    assert pgm.Gaussian((x, a), np.zeros(3), 1.0).components == ("east", "heading", "a")


def test_point_masses_have_frames_too():
    z = pgm.Variable("z")
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(a, 0.0, 1.0)],
        transition=[pgm.LinearGaussianCPD(a, given={a.previous: 1.0}, cov=0.1)],
        observation=[pgm.LinearGaussianCPD(z, given={a: 1.0}, cov=0.5)],
    )
    for belief in (pgm.Grid({"a": (-5, 5, 100)}), pgm.Particles(100, seed=0)):
        found = pgm.filter(model, {z: np.ones((3, 1))}, belief=belief)[a]
        frame = found.to_frame()
        assert frame.index.names == ["step"]
        assert_array_equal(frame["mean_a"], found.mean[:, 0])
        assert_array_equal(frame["std_a"], found.std[:, 0])


def test_a_table_has_the_states_of_the_last_variable_as_columns():
    table = pgm.Table((rain, sky), [[0.5, 0.3, 0.2], [0.1, 0.2, 0.7]], log_scale=np.log(2.0))
    frame = table.to_frame()
    assert frame.columns.name == "sky"
    assert list(frame.columns) == ["clear", "cloudy", "dark"]
    assert list(frame.index) == ["no", "yes"]
    assert frame.index.name == "rain"
    for state in rain.states:
        for own in sky.states:
            assert frame.loc[state, own] == pytest.approx(table[state, own])


def test_tables_that_are_stacked():
    values = RNG.dirichlet(np.ones(3), size=(4, 5))
    frame = pgm.Table(sky, values, lead=(4, 5)).to_frame()
    assert frame.index.names == ["axis_0", "axis_1"]
    assert_array_equal(frame.loc[(2, 3)], values[2, 3])
    single = pgm.Table(sky, values[0], lead=5).to_frame()
    assert single.index.name == "axis"
    both = pgm.Table((rain, sky), RNG.random((4, 2, 3)), lead=4).to_frame()
    assert both.index.names == ["axis", "rain"]
    assert both.shape == (8, 3)


def test_the_leading_axes_of_a_table_are_named():
    values = RNG.dirichlet(np.ones(3), size=(4, 5))
    frame = pgm.Table(sky, values, lead=(4, 5)).to_frame(axes=("run", "step"))
    assert frame.index.names == ["run", "step"]
    assert pgm.Table(sky, values[0], lead=5).to_frame(axes="step").index.name == "step"
    with pytest.raises(pgm.ModelError, match=r"axes= has 1 names; .* has axes \(4, 5\)"):
        pgm.Table(sky, values, lead=(4, 5)).to_frame(axes="step")


def test_a_table_of_no_variables():
    frame = pgm.Table((), 0.25).to_frame()
    assert frame.shape == (1, 1)
    assert frame.loc[0, "value"] == 0.25


def test_entries_beyond_numbers_are_refused():
    table = pgm.Table(rain, [0.5, 1.0], log_scale=800.0)
    with pytest.raises(pgm.NumericalError, match=r"over \(rain\) is too large .* log_values"):
        table.to_frame()


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: pgm.Gaussian(a, 0.0, 1.0).to_frame(), "Gaussian"),
        (lambda: pgm.Table(rain, [0.5, 0.5]).to_frame(), "Table"),
    ],
)
def test_without_pandas(call, what, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    told = rf"{what}\.to_frame\(\) needs pandas: pip install 'sepset\[frames\]'"
    with pytest.raises(ImportError, match=told):
        call()


def test_many_variables_in_one_frame():
    x = [pgm.Variable(f"x{k}", ("east", "north")) for k in range(3)]
    net = pgm.BayesianNetwork([pgm.GaussianCPD(v, RNG.normal(size=(2, 2)), 2.0) for v in x])
    posterior = pgm.infer(pgm.compile(net), {})
    frame = posterior.to_frame(x)
    assert frame.index.names == ["run", "variable"]
    assert list(frame.columns) == ["mean_east", "mean_north", "std_east", "std_north"]
    for run in range(2):
        for v in x:
            own = posterior[v]
            due = [*own.mean[run], *own.std[run]]
            np.testing.assert_allclose(frame.loc[(run, repr(v))], due, atol=0)


def test_many_variables_over_time_in_one_frame():
    x, y = pgm.Variable("x"), pgm.Variable("y")
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(v, 0.0, 1.0) for v in (x, y)],
        [pgm.LinearGaussianCPD(v, {v.previous: 1.0}, cov=0.1) for v in (x, y)],
        [],
    )
    posterior = pgm.smooth(model, {}, steps=3)
    frame = posterior.to_frame([x, y])
    assert frame.index.names == ["step", "variable"]
    assert list(frame.columns) == ["mean_value", "std_value"]
    np.testing.assert_allclose(frame.loc[(2, "y"), "std_value"], posterior[y.at(2)].std[0], atol=0)


def test_a_frame_is_of_variables_of_one_kind():
    x, y = pgm.Variable("x", ("a", "b")), pgm.Variable("y", ("c", "d"))
    posterior = pgm.infer(
        pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(v, [0, 0], 1.0) for v in (x, y)])), {}
    )
    with pytest.raises(pgm.EvidenceError, match=r"y has the components .* columns of one kind"):
        posterior.to_frame([x, y])


def test_several_variables_are_one_list():
    x, y = pgm.variables("x y")
    net = pgm.BayesianNetwork([pgm.GaussianCPD(v, 0.0, 1.0) for v in (x, y)])
    posterior = pgm.infer(pgm.compile(net), {})
    with pytest.raises(TypeError, match=r"to_frame\(\[x, y\]\)"):
        posterior.to_frame(x, y)
    for name in ("means", "covs", "stds"):
        with pytest.raises(TypeError, match=rf"{name} takes .* one list: {name}\(\[x, y\]\)"):
            getattr(posterior, name)(x, y)
    assert list(posterior.to_frame([x, y]).index) == ["x", "y"]
