"""Posteriors as data sets of xarray."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import pgm

pytest.importorskip("xarray")

x = pgm.Variable("x", components=("heading", "east"), angles=("heading",))
y = pgm.Variable("y", components=("east", "north"))
u = pgm.Variable("u")
command = pgm.Variable("command")
z = pgm.Variable("z")
T = 5
MODEL = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(x, [0.1, 2.0], [0.1, 1.0])],
    transition=[
        pgm.LinearGaussianCPD(u, given={command: 1.0}, cov=0.2),
        pgm.LinearGaussianCPD(x, given={x.previous: 1.0, u: [[0.1], [1.0]]}, cov=[0.01, 0.1]),
    ],
    observation=[pgm.LinearGaussianCPD(z, given={x: [[0.0, 1.0]]}, cov=0.5)],
)
RNG = np.random.default_rng(0)


def evidence(*runs):
    return {command: RNG.normal(size=(*runs, T, 1)), z: RNG.normal(size=(*runs, T, 1))}


def same(found, belief, own, first):
    """The part of a data set that is a variable's."""
    part = found.isel(component=own, step=slice(first, None))
    assert_array_equal(part["mean"], belief.mean)
    assert_array_equal(part["std"], belief.std)
    assert_array_equal(part["cov"].isel(other_component=own), belief.cov)


@pytest.mark.parametrize("runs", [(), (3,), (2, 3)])
@pytest.mark.parametrize("keep", [None, [x, u]])
def test_a_chain(runs, keep):
    posterior = pgm.smooth(MODEL, evidence(*runs), keep=keep)
    found = posterior.to_xarray()
    names = [[], ["run"], ["run_0", "run_1"]][len(runs)]
    assert found["mean"].dims == (*names, "step", "component")
    assert found["cov"].dims == (*names, "step", "component", "other_component")
    assert found["mean"].shape == (*runs, T + 1, 3)
    assert list(found.component.values) == ["heading", "east", "u"]
    assert list(found.variable.values) == ["x", "x", "u"]
    assert_array_equal(found.step, np.arange(T + 1))
    same(found, posterior[x], slice(0, 2), 0)
    same(found, posterior[u], slice(2, 3), 1)
    assert np.isnan(found["mean"].sel(step=0, component="u")).all()
    assert np.isnan(found["cov"].sel(component="u", other_component="east")).all()
    assert_array_equal(found["log_evidence"], posterior.log_evidence)
    assert found["log_evidence"].dims == tuple(names)
    assert found.attrs == {"kind": "smoothed", "log_evidence_kind": "exact"}
    one = found.sel(component="east", step=3)["mean"]
    assert_array_equal(one, posterior[x].mean[..., 3, 1])


def still():
    """Two states without controls."""
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [0.1, 2.0], [0.1, 1.0]), pgm.GaussianCPD(y, [1.0, 0.0], 0.5)],
        transition=[
            pgm.LinearGaussianCPD(x, given={x.previous: 1.0}, cov=[0.01, 0.1]),
            pgm.LinearGaussianCPD(y, given={y.previous: 1.0}, cov=0.1),
        ],
        observation=[pgm.LinearGaussianCPD(z, given={x: [[0.0, 1.0]]}, cov=0.5)],
    )


@pytest.mark.filterwarnings("ignore::pgm.GridWarning")  # its cells are few
@pytest.mark.parametrize(
    "belief",
    [
        pgm.Particles(500, seed=1),
        pgm.Grid(
            {"x.east": (-3, 6, 30), "north": (-3, 3, 12), "heading": 12, "y.east": (-2, 4, 9)}
        ),
    ],
)
def test_point_masses(belief):
    model = still()
    posterior = pgm.filter(model, {z: np.ones((3, 1))}, belief=belief)
    found = posterior.to_xarray()
    assert list(found.component.values) == ["heading", "x.east", "y.east", "north"]
    same(found, posterior[x].gaussian(), slice(0, 2), 0)
    same(found, posterior[y].gaussian(), slice(2, 4), 0)
    assert found.attrs["kind"] == "filtered"
    assert found.attrs["log_evidence_kind"] == posterior.log_evidence_kind
    assert found["log_evidence"] == posterior.log_evidence


def test_a_network_without_time():
    a, b, c = pgm.variables("a b c")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, given={a: 0.5}, cov=0.3),
            pgm.LinearGaussianCPD(c, given={b: 0.5}, cov=0.3),
        ]
    )
    posterior = pgm.infer(pgm.compile(net), {c: [[0.2], [0.7]]})
    found = posterior.to_xarray()
    assert found["mean"].dims == ("run", "component")
    assert_array_equal(found["mean"].sel(component="b"), posterior[b].mean[:, 0])
    assert found.attrs == {"log_evidence_kind": "exact"}
    everything = pgm.infer(pgm.compile(net), {a: 0.0, b: 0.1, c: 0.2}).to_xarray()
    assert everything["mean"].shape == (0,)


place = pgm.Discrete("place", states=("hall", "door", "kitchen"))
heard = pgm.Discrete("heard", states=("no", "yes"))


def test_a_chain_of_tables():
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(place, table=[1, 0, 0])],
        transition=[pgm.TableCPD(place, given=place.previous, table=np.full((3, 3), 1 / 3))],
        observation=[pgm.TableCPD(heard, given=place, table=[[0.9, 0.1], [0.5, 0.5], [0.1, 0.9]])],
    )
    posterior = pgm.filter(model, {heard: [[1, 0, 1], [0, 0, 0]]})
    found = posterior.to_xarray()
    assert found["place"].dims == ("run", "step", "place_state")
    assert_array_equal(found["place"].sel(place_state="kitchen"), posterior[place]["kitchen"])
    assert found.attrs["kind"] == "filtered"


def test_tables_without_time():
    net = pgm.BayesianNetwork(
        [
            pgm.TableCPD(place, table=[0.2, 0.3, 0.5]),
            pgm.TableCPD(heard, given=place, table=[[0.9, 0.1], [0.5, 0.5], [0.1, 0.9]]),
        ]
    )
    posterior = pgm.infer(pgm.compile(net), {heard: "yes"})
    found = posterior.to_xarray()
    assert list(found.data_vars) == ["place", "log_evidence"]
    assert found["place"].sel(place_state="door") == posterior[place]["door"]
    some = pgm.infer(pgm.compile(net), {heard: [1, -1]}).to_xarray()
    assert set(some.data_vars) == {"place", "heard", "log_evidence"}


def test_without_xarray(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    told = r"Posterior\.to_xarray\(\) needs xarray: pip install 'sepset\[frames\]'"
    with pytest.raises(ImportError, match=told):
        pgm.smooth(MODEL, evidence()).to_xarray()


@pytest.mark.parametrize("runs", [(), (3,), (2, 3)])
def test_of_nothing_that_was_kept(runs):
    posterior = pgm.smooth(MODEL, evidence(*runs), keep=[])
    found = posterior.to_xarray()
    assert found["mean"].shape == found["std"].shape == (*runs, T + 1, 0)
    assert found["cov"].shape == (*runs, T + 1, 0, 0)
    assert list(found.component.values) == []
    assert_array_equal(found.step, np.arange(T + 1))
    assert_array_equal(found["log_evidence"], posterior.log_evidence)
