"""Units of components: kept by variables, converted or refused by readers, shown by pictures."""

import copy
import io
import pickle

import matplotlib
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.recordings import Recording, Stream, read_csv
from pgm.units import UNITS, factor

matplotlib.use("Agg")

NAMES = ("east", "north", "heading")
POSE = {"components": NAMES, "angles": ("heading",)}
METRES = {"east": "m", "north": "m"}
KILOMETRES = {"east": "km", "north": "km"}


def test_units_stand_in_the_components_order_and_angles_are_in_radians():
    x = pgm.Variable("x", **POSE, units=METRES)
    assert x.units == ("m", "m", "rad")
    assert x == pgm.Variable("x", **POSE, units=("m", "m", ""))
    assert [x.unit_of(name) for name in NAMES] == ["m", "m", "rad"]
    assert pgm.Variable("v", units="m/s").units == ("m/s",)
    assert pgm.Variable("t", units="°C").unit_of("t") == "°C"  # a label, which nothing converts
    plain = pgm.Variable("x", **POSE)
    assert plain == pgm.Variable("x", **POSE, units={"heading": "rad"})
    assert [plain.unit_of(name) for name in NAMES] == ["", "", "rad"]


def test_a_variable_in_other_units_is_another_variable():
    x, far, plain = (pgm.Variable("x", **POSE, units=u) for u in (METRES, KILOMETRES, ()))
    assert len({x, far, plain}) == 3
    for other in (far, plain):
        with pytest.raises(pgm.ModelError, match=r"two different variables are called 'x'.*'m'"):
            pgm.BayesianNetwork(
                [
                    pgm.GaussianCPD(x, np.zeros(3), 1.0),
                    pgm.LinearGaussianCPD(
                        pgm.Variable("z", NAMES), given={other: np.eye(3)}, cov=1.0
                    ),
                ]
            )
    (seen,) = pgm.variables("z", NAMES, ("heading",), METRES)
    assert seen.units == x.units


@pytest.mark.parametrize("kept", [lambda v: pickle.loads(pickle.dumps(v)), copy.deepcopy])
def test_copies_and_slices_keep_units(kept):
    x = pgm.Variable("x", **POSE, units=METRES)
    for one in (x, x.previous, x.at(3)):
        found = kept(one)
        assert found == one
        assert hash(found) == hash(one)
        assert found.units == x.units
        assert found.template == x


@pytest.mark.parametrize(
    ("units", "said"),
    [
        ({"east": "m", "up": "m"}, "'up'.*not among its components"),
        (("m", "m"), "a text for each"),
        ("m", "a text for each"),
        ({"m", "km", "s"}, "no order"),
        ({"east": 1}, "a text for each"),
        ({"heading": "deg"}, "angles are in radians, not 'deg'"),
        ({"east": "metres"}, "spelt 'm' here"),
    ],
)
def test_units_that_are_none_are_refused(units, said):
    with pytest.raises(pgm.ModelError, match=said):
        pgm.Variable("x", **POSE, units=units)


def test_factors_are_the_definitions():
    assert factor("km/h", "m/s") == pytest.approx(1000 / 3600, rel=1e-15)
    assert factor("deg", "turn") == pytest.approx(1 / 360, rel=1e-15)
    assert factor("rpm", "deg/s") == pytest.approx(6.0, rel=1e-15)
    assert factor("m", "s") is None
    assert factor("dB", "m") is None
    assert factor("dB", "dB") == 1.0
    for one in UNITS:  # there and back
        for other in UNITS:
            if (there := factor(one, other)) is not None:
                assert there * factor(other, one) == pytest.approx(1.0, rel=1e-14)


def belief(units):
    x = pgm.Variable("x", **POSE, units=units)
    return pgm.Gaussian(x, [[0, 0, 0.1], [1, 2, 0.2]], cov=[0.01, 0.04, 1e-4], steps=[0, 1])


def test_plots_are_labelled_by_the_units():
    ax = pgm.plot.trajectory(belief(KILOMETRES))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east [km]", "north [km]")
    truth = belief(KILOMETRES).mean
    axes = pgm.plot.errors(belief(KILOMETRES), truth, unit="m")  # of those without a unit
    assert [ax.get_ylabel() for ax in axes] == [
        "east error [km]",
        "north error [km]",
        "heading error [rad]",
    ]
    assert pgm.plot.rmse(belief(METRES), truth, components=NAMES[:2]).get_ylabel().endswith("[m]")
    with pytest.raises(pgm.ModelError, match="whose variable is in 'km'"):
        pgm.plot.errors(belief(KILOMETRES), truth, unit={"east": "m"})


def test_grids_and_particles_have_units_and_label_maps():
    place = pgm.Variable("p", components=NAMES[:2], units=("km", "km"))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [0, 0], 1.0)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=0.1)],
        [],
    )
    axes = {"east": (-9, 9, 36), "north": (-9, 9, 36)}
    for family in (pgm.Grid(axes), pgm.Particles(50, seed=0)):
        found = pgm.filter(model, {}, steps=1, belief=family)[place.at(1)]
        assert found.units == ("km", "km")
    ax = pgm.plot.grid_map(pgm.filter(model, {}, steps=1, belief=pgm.Grid(axes))[place.at(1)])
    assert ax.get_xlabel() == "east [km]"


def test_printed_beliefs_and_frames_have_units():
    assert "east [km]" in repr(belief(KILOMETRES))
    frame = belief(KILOMETRES).to_frame()
    assert frame.attrs["units"]["std_north"] == "km"
    assert frame.attrs["units"]["mean_heading"] == "rad"
    assert "units" not in pgm.Gaussian(pgm.Variable("a"), [0.0], cov=1.0).to_frame().attrs


def test_posteriors_frames_are_of_one_unit():
    a, b = pgm.Variable("a", units="m"), pgm.Variable("b", units="km")
    network = pgm.BayesianNetwork([pgm.GaussianCPD(v, 0.0, 1.0) for v in (a, b)])
    posterior = pgm.infer(pgm.compile(network), {})
    assert posterior.to_frame([a]).attrs["units"] == {"mean_a": "m", "std_a": "m"}
    assert posterior.to_xarray()["unit"].values.tolist() == ["m", "km"]
    with pytest.raises(pgm.EvidenceError, match="a column of a frame has one unit"):
        posterior.to_frame([a, b])


def test_trajectories_are_written_in_metres():
    near, far = io.StringIO(), io.StringIO()
    spread = io.StringIO()
    options = {"times": [0, 1], "position": NAMES[:2], "heading": "heading"}
    pgm.write_tum(far, belief(KILOMETRES), **options, covariance=spread)
    pgm.write_tum(near, belief(()), **options)
    far.seek(0), near.seek(0), spread.seek(0)
    poses = pgm.read_tum(far, covariance=spread)
    assert_allclose(poses.position, 1000.0 * pgm.read_tum(near).position, rtol=1e-14)
    assert_allclose(np.diagonal(poses.cov[0]), [1e4, 4e4, 1e-4], rtol=1e-14)
    odd = pgm.Gaussian(pgm.Variable("v", NAMES[:2], units=("m/s", "m/s")), [[0, 0]], 1.0, steps=[0])
    with pytest.raises(pgm.ModelError, match=r"'east'.*in 'm/s', a speed, and no position"):
        pgm.write_tum(io.StringIO(), odd, times=[0], position=NAMES[:2], heading=None)


def test_streams_convert_what_they_are_given():
    stream = Stream(
        [0.0, 1.0],
        [[1.0, 90.0, 3.0], [2.0, 180.0, 4.0]],
        ("range", "bearing", "strength"),
        units=("km", "deg", "dB"),
        variances=[[1.0, 4.0, 9.0]] * 2,
    )
    assert stream.units == ("m", "rad", "dB")
    assert_allclose(stream.values[0], [1000.0, np.pi / 2, 3.0], rtol=1e-15)
    assert_allclose(stream.variances[0], [1e6, 4 * (np.pi / 180) ** 2, 9.0], rtol=1e-15)
    again = stream.replace(begin=None)  # not converted twice
    assert_array_equal(again.values, stream.values)
    assert again.units == stream.units
    assert stream.select(level="strength").units == ("dB",)
    assert stream.to_frame().attrs["units"] == {"range": "m", "bearing": "rad", "strength": "dB"}
    assert Stream([0.0], [[1.0, 2.0]], ("left", "right")).units == ("", "")  # lengths or speeds


@pytest.mark.parametrize(
    ("units", "said"),
    [
        (("s", ""), "no unit of a length"),
        ({"range": "meters"}, "spelt 'm' here"),
        ({"width": "m"}, "units= has 'width'"),
        (("m",), "a text for each"),
    ],
)
def test_streams_refuse_units_of_another_quantity(units, said):
    with pytest.raises(pgm.EvidenceError, match=said):
        Stream([0.0], [[1.0, 0.1]], ("range", "bearing"), units=units)


def test_turns_in_degrees_are_told_where_no_unit_is():
    rows = ([1.0, 2.0], [[0.2, 10.0], [0.2, 12.0]], ("distance", "turn"))
    with pytest.raises(pgm.EvidenceError, match=r"'turn' goes to 12 rad.*units="):
        Stream(*rows)
    assert_allclose(Stream(*rows, units={"turn": "deg"})["turn"], np.radians([10.0, 12.0]))
    assert_array_equal(Stream(*rows, units={"turn": "rad"})["turn"], [10.0, 12.0])


def test_a_recording_is_handed_over_in_the_units_of_the_variables():
    x = pgm.Variable("x", ("forward", "left", "turn", "dt"), units=("km", "km", "deg", "ms"))
    z = pgm.Variable("z", ("range", "bearing"), angles=("bearing",), units={"range": "cm"})
    r = pgm.Variable("r", ("range", "bearing"))
    m = pgm.Variable("m", ("east", "north"), units=("km", "km"))
    drive = Recording(
        odometry=Stream([1.0, 2.0], [[10.0, 0.5, 0.1]] * 2, ("forward", "left", "turn"), begin=0),
        sightings={
            "laser": Stream(
                [1.0], [[2.0, 0.3]], ("range", "bearing"), subject=[7], variances=[[0.04, 0.01]]
            )
        },
        landmarks={7: [3000.0, -500.0]},
    )
    log = drive.timeline(odometry=x, sensors={z: "laser"}, landmark=m, variances={z: r})
    assert_allclose(log.evidence[x][0], [0.01, 0.0005, np.degrees(0.1), 1000.0], rtol=1e-12)
    seen = log.evidence[z]
    assert_allclose(seen.values, [[200.0, 0.3]], rtol=1e-14)
    assert_allclose(seen.given[m], [[3.0, -0.5]], rtol=1e-14)
    assert_allclose(seen.given[r], [[400.0, 0.01]], rtol=1e-14)  # cm², rad²
    wrong = pgm.Variable("z", ("range", "bearing"), angles=("bearing",), units={"range": "s"})
    with pytest.raises(pgm.EvidenceError, match=r"'range' is in 'm', a length, and of z in 's'"):
        drive.timeline(odometry=x, sensors={wrong: "laser"}, landmark=m)
    slow = pgm.Variable("u", ("forward", "left", "turn", "dt"), units={"dt": "m"})
    with pytest.raises(pgm.EvidenceError, match="its unit 'm' is none of a time"):
        drive.timeline(odometry=slow)


def test_a_column_keeps_the_unit_that_it_was_read_in():
    text = "time,depth,level\n0,3,1\n1,4,2\n"
    columns = {"sonar": {"t": "time", "depth": ("depth", "ft"), "level": "level"}}
    drive = read_csv(io.StringIO(text), columns)
    assert drive.sightings["sonar"].units == ("m", "")
    z = pgm.Variable("z", ("depth", "level"), units=("ft", "m"))
    log = drive.timeline([0.0, 1.0], sensors={z: "sonar"})
    assert_allclose(log.evidence[z].values, [[3.0, 1.0], [4.0, 2.0]], rtol=1e-14)
    with pytest.raises(pgm.EvidenceError, match="'depth' is in 'm'"):
        drive.timeline([0.0, 1.0], sensors={pgm.Variable("z", ("depth",), units="m/s"): "sonar"})


def test_degrees_in_plain_arrays_and_truths_are_told():
    x = pgm.Variable("x", ("heading",), angles=("heading",))
    z = pgm.Variable("z", ("heading",), angles=("heading",))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.1)],
    )
    compass = np.array([350.0, 355.0, 2.0, 8.0])[:, None]
    for value in (compass, np.stack([compass, compass]), pgm.sightings(compass, step=range(1, 5))):
        with pytest.raises(pgm.EvidenceError, match=r"'heading' goes to 355 rad.*degrees"):
            pgm.filter(model, {z: value}, steps=4)
    unwrapped = np.linspace(0, 300, 50)[:, None]  # radians of many turns, without jumps
    runs = np.stack([unwrapped, unwrapped])
    assert pgm.filter(model, {z: runs})[x].mean.shape == (2, 51, 1)
    found = pgm.filter(model, {z: np.radians(compass)})[x]
    truth = np.vstack([[[349.0]], compass])
    with pytest.raises(pgm.ModelError, match="degrees"):
        pgm.consistency.error(found, truth)
    with pytest.raises(pgm.ModelError, match="degrees"):
        pgm.plot.errors(found, truth)
    with pytest.raises(pgm.EvidenceError, match="turned by 90 rad"):
        Recording(
            sightings={"a": Stream([0.0], [[1.0]], ("range",))}, mounts={"a": [0.0, 0.0, 90.0]}
        )
