"""Covariances of a stream's rows: given, cut, turned, written, read, and the noise of sensors."""

import io
from importlib.util import find_spec

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.errors import EvidenceError
from pgm.recordings import Datum, Recording, Stream, read_csv
from pgm.recordings.drives import spreads
from tests.dense import random_covariance

geo = pytest.mark.skipif(find_spec("pymap3d") is None, reason="pip install 'sepset[geo]'")
PLACE = ("east", "north")
x, g = (pgm.Variable(name, components=PLACE) for name in "xg")
r = pgm.Variable("r", components=("east", "north*east", "north"))
flat = pgm.Variable("flat", components=PLACE)
TIMES = np.arange(4.0)
FIXES = np.array([[0.5, -1.0], [2.0, 1.0], [1.0, 4.0]])
COV = random_covariance(np.random.default_rng(7), 2, lead=(3,))


def drive(cov=COV, **more):
    return Recording(fixes=Stream(TIMES[1:], FIXES, PLACE, cov=cov, **more))


def model():
    full = pgm.noise(lambda r: r[..., [[0, 1], [1, 2]]], given=r)
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, [1, 2], [[2.0, 0.3], [0.3, 1.0]])],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=[0.5, 0.2])],
        observation=[pgm.LinearGaussianCPD(g, {x: 1.0}, cov=full)],
    )


def test_beliefs_are_those_of_the_dense_joint_gaussian_of_correlated_fixes():
    log = drive().timeline(TIMES, sensors={g: "fixes"}, variances={g: r})
    found = pgm.smooth(model(), log.evidence, steps=3)
    # The sum of the first place and of the motions up to each, and fixes of all but the first.
    sums = np.kron(np.tril(np.ones((4, 4))), np.eye(2))
    own = np.zeros((8, 8))
    own[:2, :2] = [[2.0, 0.3], [0.3, 1.0]]
    own[2:, 2:] = np.kron(np.eye(3), np.diag([0.5, 0.2]))
    states, mean = sums @ own @ sums.T, np.tile([1.0, 2.0], 4)
    seen = states[2:, 2:].copy()
    for k in range(3):
        seen[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] += COV[k]
    gain = states[:, 2:] @ np.linalg.inv(seen)
    miss = FIXES.ravel() - mean[2:]
    assert_allclose(found[x].mean.ravel(), mean + gain @ miss, rtol=1e-12)
    due = states - gain @ states[2:]
    assert_allclose(found[x].cov, [due[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(4)])
    _, volume = np.linalg.slogdet(2.0 * np.pi * seen)
    log_evidence = -0.5 * (volume + miss @ np.linalg.solve(seen, miss))
    assert_allclose(found.log_evidence, log_evidence, rtol=1e-12)
    # The variances alone say something else.
    assert abs(due[-1, -2]) > 0.01 * np.sqrt(due[-1, -1] * due[-2, -2])


def test_covariances_stay_with_their_rows_and_columns():
    stream = drive().fixes
    assert_array_equal(stream.cov, COV)
    assert_array_equal(stream.variances, np.diagonal(COV, axis1=1, axis2=2))
    assert_array_equal(stream.take([2, 0]).cov, COV[[2, 0]])
    turned = stream.select(y="north", x="east")
    assert_array_equal(turned.cov, COV[:, ::-1, ::-1])
    assert_array_equal(stream.replace(values=FIXES + 1.0).cov, COV)
    assert_array_equal(stream.replace(variances=np.ones((3, 2))).cov, [np.eye(2)] * 3)
    assert stream.replace(cov=None).variances is None
    heard = Recording(sightings={"fix": stream}).calibrated("fix", 2.0, component="north")
    assert_allclose(heard.sightings["fix"].cov, COV / [[1.0, 2.0], [2.0, 4.0]])


def test_covariances_of_the_truth_and_of_velocities_are_cut():
    speeds = Stream(TIMES[1:], FIXES, ("v", "omega"), cov=COV)
    whole = Recording(velocities=speeds, truth=Stream(TIMES[1:], FIXES, PLACE, cov=COV))
    part = whole.between(1.5, 3.0)
    assert_array_equal(part.velocities.cov, COV)  # the first of them is held from 1 s to 1.5 s
    assert_array_equal(part.truth.cov[1:], COV[1:])
    assert np.isnan(part.truth.cov[0]).all()


def test_covariances_are_in_products_of_units():
    z = pgm.Variable("z", ("range", "bearing"), angles=("bearing",), units={"range": "cm"})
    s = pgm.Variable("s", ("range", "range*bearing", "bearing*bearing"))
    cov = [[[4.0, 3.0], [3.0, 9.0]]]
    seen = Stream([0.0], [[1.0, 2.0]], z.components, cov=cov, units=("km", "deg"))
    size = np.array([1e3, np.radians(1.0)])
    assert_allclose(seen.cov, cov * np.outer(size, size))
    log = Recording(sightings={"radio": seen}).timeline(
        [0.0, 1.0], sensors={z: "radio"}, variances={z: s}
    )
    in_z = size * [100.0, 1.0]
    due = [4.0 * in_z[0] ** 2, 3.0 * in_z[0] * in_z[1], 9.0 * in_z[1] ** 2]
    assert_allclose(log.evidence[z].given[s], [due])


NAN = np.nan


def test_rows_may_have_no_covariance():
    cov = COV.copy()
    cov[0], cov[1], cov[2] = NAN, 0.0, [[np.inf, 0.0], [0.0, 4.0]]
    stream = drive(cov).fixes
    assert_array_equal(stream.cov, cov)
    half = drive([[[NAN, 5.0], [5.0, 4.0]]] * 3).fixes
    assert_array_equal(half.cov[0], [[NAN, NAN], [NAN, 4.0]])
    alone = Stream([0.0], [[1.0, 2.0]], PLACE, variances=[[NAN, 4.0]])
    assert_array_equal(alone.cov, half.cov[:1])
    blurred = np.array([[[1.0, 0.5], [0.5 + 1e-12, 1.0]], [[NAN, 0.0], [0.0, 1.0]]])
    whole = Stream([0.0, 1.0], FIXES[:2], PLACE, cov=blurred).cov[0]
    assert_array_equal(whole, whole.T)
    assert Stream([], [], PLACE, cov=[]).cov.shape == (0, 2, 2)
    with pytest.raises(EvidenceError, match=r"no variances in 1 row \(row 0\)"):
        drive(cov).timeline(TIMES, sensors={g: "fixes"}, variances={g: r})


@pytest.mark.parametrize(
    ("matrix", "told"),
    [
        ([[1.0, 2.0], [2.0, 1.0]], r"cov, row 1: .* is indefinite"),
        ([[1.0, 0.5], [0.2, 1.0]], r"cov, row 1: .* is not symmetric"),
        ([[-1.0, 0.0], [0.0, 1.0]], r"cov, row 1: .* negative variance -1"),
        ([[1.0, NAN], [NAN, 1.0]], r"cov, row 1: .* NaN or infinite; .* 0 a covariance"),
        ([[1.0, np.inf], [np.inf, 1.0]], r"cov, row 1: .* NaN or infinite"),
        ([[np.inf, 0.5], [0.5, 1.0]], r"cov, row 1: .* indefinite"),
        ([[0.0, 0.5], [0.5, 1.0]], r"cov, row 1: .* indefinite"),
    ],
)
def test_covariances_that_are_none(matrix, told):
    with pytest.raises(EvidenceError, match=told):
        drive([COV[0], matrix, COV[2]])


def test_covariances_of_another_shape_and_twice():
    with pytest.raises(EvidenceError, match=r"cov has shape \(3, 2\); \(3, 2, 2\) .* variances="):
        drive(np.ones((3, 2)))
    with pytest.raises(EvidenceError, match="leave variances= out"):
        drive(variances=np.ones((3, 2)))


def test_variances_alone_of_correlated_readings_are_refused():
    with pytest.raises(EvidenceError, match=r"correlated in 3 rows .*'east\*north'.*stream.repl"):
        drive().timeline(TIMES, sensors={g: "fixes"}, variances={g: flat})
    faint = np.array([[4.0, 0.009], [0.009, 1.0]])
    log = drive([faint] * 3).timeline(TIMES, sensors={g: "fixes"}, variances={g: flat})
    assert_array_equal(log.evidence[g].given[flat], [[4.0, 1.0]] * 3)


@pytest.mark.parametrize("name", ["east*up", "east*north*up", "up", "*", "east*"])
def test_components_that_are_no_covariance(name):
    odd = pgm.Variable("odd", components=("east", name))
    with pytest.raises(EvidenceError, match=r"they go by name.*'east\*north'"):
        drive().timeline(TIMES, sensors={g: "fixes"}, variances={g: odd})


def test_frames_have_covariances_that_tables_are_read_with():
    pytest.importorskip("pandas")
    frame = drive().fixes.to_frame()
    between = ["variance of east", "variance of north", "covariance of east*north"]
    assert list(frame.columns[2:]) == between
    columns = {"t": "t", **{name: name for name in frame.columns}}
    found = read_csv(io.StringIO(frame.to_csv()), {"fixes": columns}).fixes
    assert_array_equal(found.cov, COV)
    assert between[2] not in Stream([0.0], [[1.0, 2.0]], PLACE, variances=[[1, 2]]).to_frame()


TABLE = "t,r,b,rr,bb,rb\n0,3,10,4,9,-1\n"
RADIO = {"t": "t", "range": ("r", "cm"), "bearing": ("b", "deg")}
SPREAD = {"variance of range": ("rr", "cm"), "variance of bearing": ("bb", "deg")}


@pytest.mark.parametrize(
    ("name", "units"), [("range*bearing", ("cm", "deg")), ("bearing*range", ("deg", "cm"))]
)
def test_columns_of_covariances_have_two_units(name, units):
    asked = {"radio": RADIO | SPREAD | {f"covariance of {name}": ("rb", *units)}}
    size = np.array([0.01, np.radians(1.0)])
    found = read_csv(io.StringIO(TABLE), asked).sightings["radio"]
    assert_allclose(found.cov, [[[4.0, -1.0], [-1.0, 9.0]] * np.outer(size, size)])


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ({"covariance of range*bearing": "rb"}, "whose variances are read, too"),
        (SPREAD | {"covariance of range": "rb"}, "a covariance is of two components"),
        (SPREAD | {"covariance of range*elevation": "rb"}, "a variance is of a component"),
        (SPREAD | {"covariance of range*bearing": ("rb", "cm", "s")}, "'s' is a time"),
        (SPREAD | {"covariance of range*bearing": ("rb", "cm", "deg", "m")}, "several units"),
        (SPREAD | {"variance of range": ("rr", "cm", "m")}, "several units"),
        (
            SPREAD | {"covariance of range*bearing": "rb", "covariance of bearing*range": "rb"},
            "named twice",
        ),
    ],
)
def test_columns_that_are_no_covariance(asked, told):
    with pytest.raises(EvidenceError, match=told):
        read_csv(io.StringIO(TABLE), {"radio": RADIO | asked})


def jacobian(datum, latitude, longitude, height):
    """The plane's coordinates by those of the axes at a place, by differences over 20 m."""
    own = Datum(latitude, longitude, height)
    ahead, behind = (datum.to_plane(own.to_earth(sign * 10.0 * np.eye(3))) for sign in (1.0, -1.0))
    return (ahead - behind).T / 20.0


@geo
@pytest.mark.parametrize("place", [(48.0, 11.0, 500.0), (48.5, 12.5, 0.0), (-40.0, -179.0, 9.0)])
def test_axes_are_turned_as_the_earth_is_bent(place):
    for datum in (Datum(48.0, 11.0, 500.0), Datum(-41.0, 179.5)):
        if abs(datum.latitude - place[0]) < 5.0:
            (found,) = datum.turns(*np.array(place)[:2, None])
            assert_allclose(found, jacobian(datum, *place), atol=2e-8)
            assert_allclose(found @ found.T, np.eye(3), atol=1e-14)
    (same,) = Datum(48.0, 11.0).turns(np.array([48.0]), np.array([11.0]))
    assert_array_equal(same, np.eye(3))


@geo
def test_covariances_of_fixes_are_turned_into_the_plane():
    text = "t,lat,lon,h,e,n,u,en\n0,60,10,0,4,1,0,-1\n1,60,11,0,4,1,0,-1\n2,60.01,10.01,0,9,9,,0\n"
    columns = {
        "t": "t", "latitude": ("lat", "deg"), "heading": "h", "longitude": ("lon", "deg"),
        "altitude": "h", "variance of east": "e", "variance of north": "n",
        "variance of up": "u", "covariance of east*north": "en",
    }  # fmt: skip
    found = read_csv(io.StringIO(text), {"fixes": columns}).fixes
    assert found.components == ("east", "north", "heading", "up")
    seen = found.select(east="east", north="north", up="up").cov
    at_fix = np.array([[4.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    assert_array_equal(seen[0], at_fix)
    turn = jacobian(Datum(60.0, 10.0), 60.0, 11.0, 0.0)
    assert_allclose(seen[1], turn @ at_fix @ turn.T, atol=1e-6)
    assert abs(seen[1] - at_fix).max() > 0.04
    assert np.isnan(seen[2, 2]).all()
    assert_allclose(seen[2, :2, :2], 9.0 * np.eye(2), atol=1e-5)
    assert np.isnan(found.cov[:, 2]).all()


@geo
def test_singular_covariances_stay_covariances_when_they_are_turned():
    """As of receivers that give altitudes no variance, and files that print ten digits."""
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(500, 3, 1)) * np.exp(4.0 * rng.normal(size=(500, 3, 1)))
    cov = np.concatenate([roots @ roots.transpose(0, 2, 1), [np.diag([1e4, 1.0, 0.0])] * 500])
    cov = np.array([float(f"{entry:.10e}") for entry in cov.ravel()]).reshape(-1, 3, 3)
    near = np.array([[48.0], [11.0]]) + 1e-3 * rng.normal(size=(2, 1000))
    turns = Datum(48.0, 11.0).turns(*near)
    found = spreads.turned(cov, turns)
    assert not spreads.faults(found)
    due = turns @ cov @ turns.transpose(0, 2, 1)
    scale = np.sqrt(np.einsum("nii,njj->nij", due, due))
    assert np.abs(found - due).max() < 1e-9 * scale.max()
    assert (np.abs(found - due) < 1e-6 * scale + 1e-9).all()
    assert (found[500:, 2, 2] > 0.0).all()
