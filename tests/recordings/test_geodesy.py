"""Places on the earth and on a plane, against high precision; tracks of GPX there and back."""

import io
import pickle
from datetime import UTC, datetime

import mpmath
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.recordings import Datum, Recording, Stream, read_csv, read_gpx, write_gpx

pytest.importorskip("pymap3d")

FIXES = {"t": "t", "latitude": ("lat", "deg"), "longitude": ("lon", "deg")}
MUNICH = Datum(48.1371, 11.5754, 519.0)


def table(rows, **options):
    text = "t,lat,lon\n" + "".join(f"{k},{a!r},{b!r}\n" for k, (a, b) in enumerate(rows))
    return read_csv(io.StringIO(text), {"fixes": FIXES}, **options)


def cartesian(place):
    """A place that turns with the earth, by the ellipsoid's definition."""
    latitude, longitude = (mpmath.radians(mpmath.mpf(float(v))) for v in place[:2])
    a, f, h = mpmath.mpf(6378137), 1 / mpmath.mpf("298.257223563"), mpmath.mpf(float(place[2]))
    e2 = f * (2 - f)
    normal = a / mpmath.sqrt(1 - e2 * mpmath.sin(latitude) ** 2)
    level = (normal + h) * mpmath.cos(latitude)
    return mpmath.matrix(
        [
            level * mpmath.cos(longitude),
            level * mpmath.sin(longitude),
            (normal * (1 - e2) + h) * mpmath.sin(latitude),
        ]
    )


def local(place, datum):
    origin = (datum.latitude, datum.longitude, datum.height)
    b, l = (mpmath.radians(mpmath.mpf(v)) for v in origin[:2])  # noqa: E741
    sb, cb, sl, cl = mpmath.sin(b), mpmath.cos(b), mpmath.sin(l), mpmath.cos(l)
    axes = mpmath.matrix([[-sl, cl, 0], [-sb * cl, -sb * sl, cb], [cb * cl, cb * sl, sb]])
    return [float(v) for v in axes * (cartesian(place) - cartesian(origin))]


@pytest.mark.parametrize("size", [1e-5, 1e-2, 1.0])
def test_places_on_the_plane_are_those_of_high_precision(size):
    rng = np.random.default_rng(0)
    with mpmath.workdps(40):
        for latitude in (0.0, 48.0, -33.9, 89.9, -89.9):
            for longitude in (0.0, 11.5, 179.99999, -180.0):
                datum = Datum(latitude, longitude, rng.uniform(-400, 9000))
                away = size * rng.normal(size=(2, 3)) * [1, 1, 100]
                places = np.array([latitude, longitude, datum.height]) + away
                places[:, 0] = places[:, 0].clip(-90, 90)
                found = datum.to_plane(places)
                assert_allclose(found, [local(p, datum) for p in places], atol=2e-8, rtol=0)
                back = datum.to_earth(found)
                for one, other in zip(back, places, strict=True):
                    assert mpmath.norm(cartesian(one) - cartesian(other)) < 2e-8


def test_places_of_two_numbers_are_at_the_datums_height_both_ways():
    away = np.array([[0.0, 0.0], [1e3, -2e3], [8e4, 9e4], [-1e6, 2e6]])
    world = MUNICH.to_earth(away)
    assert_allclose(MUNICH.to_plane(world), away, atol=1e-5)
    heights = np.full((4, 1), MUNICH.height)
    assert_allclose(MUNICH.to_plane(np.hstack([world, heights]))[:, :2], away, atol=1e-5)
    with pytest.raises(pgm.EvidenceError, match=r"row 1: .* on no place of the earth"):
        MUNICH.to_earth([[0.0, 0.0], [9e6, 0.0]])
    assert MUNICH.to_plane(np.zeros((0, 2))).shape == (0, 2)
    assert np.isnan(MUNICH.to_plane([[np.nan, 11.0]])).any()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((91.0, 0.0), "−90 to 90, were due for latitude, not 91.0"),
        ((0.0, 200.0), "−180 to 180, were due for longitude"),
        ((0.0, 0.0, np.inf), "metres were due for height"),
        ((90.0, 0.0), "at a pole, where no direction is east"),
        ((-89.9995, 0.0), "at a pole"),
        ((1.0,), r"datum= is \(latitude, longitude\)"),
        ("48 N", r"datum= is"),
        (("a", 1.0), "were due for latitude, not 'a'"),
    ],
)
def test_datums_that_are_none(given, said):
    with pytest.raises(pgm.EvidenceError, match=said):
        Recording(datum=given)


def test_the_datum_is_the_first_fix_or_given_and_is_kept():
    rows = [(48.1371, 11.5754), (48.1372, 11.5754)]
    drive = table(rows)
    assert_allclose([drive.datum.latitude, drive.datum.longitude], rows[0], rtol=1e-15)
    assert "datum  48.1371° N, 11.5754° E, 0 m, the first of fixes" in repr(drive)
    other = table(rows[1:], datum=drive.datum)  # another file on the same plane
    assert_allclose(other.fixes.values, drive.fixes.values[1:], atol=1e-8)
    given = table(rows, datum=(48.0, 11.5, 500.0))
    assert given.datum == Datum(48.0, 11.5, 500.0)
    assert "first" not in repr(given.datum.text)
    assert pickle.loads(pickle.dumps(given)).datum == given.datum
    assert given.replace(name="b").datum == given.datum
    assert_allclose(given.datum.to_earth(given.fixes.values), rows, rtol=0, atol=1e-12)


def test_a_drive_over_the_date_line_has_no_jump():
    rows = [(-17.0, 179.9999), (-17.0, -180.0), (-17.0, -179.9999)]
    drive = table(rows)
    steps = np.diff(drive.fixes["east"])
    assert_allclose(steps, steps[0], rtol=1e-6)
    assert 10.0 < steps[0] < 11.2
    back = drive.datum.to_earth(drive.fixes.values)
    assert_allclose(np.abs(back[:, 1]), [179.9999, 180.0, 179.9999], atol=1e-9)


def test_places_far_from_the_datum_are_told_and_beyond_the_plane_refused():
    drive = table([(48.0, 11.0), (50.0, 11.0)])
    (told,) = drive.dropped
    assert told.kept
    assert told.rows.tolist() == [1]
    assert "222 km from the datum, 48° N, 11° E" in told.fate
    with pytest.raises(pgm.FileError, match=r"row 1: .* km from the datum, 48° N.*no plane"):
        table([(48.0, 11.0), (-42.0, -169.0)])
    datum = pgm.recordings.Datum(48.0, 11.0)
    with pytest.raises(pgm.EvidenceError, match=r"row 1: .* km from the datum, 48° N.*no plane"):
        datum.to_plane([(48.0, 11.0), (-48.0, -169.0)])  # whose east and north are nearly zero
    with pytest.raises(pgm.FileError, match="no direction is east"):
        table([(90.0, 11.0), (89.0, 11.0)])
    assert table([(90.0, 11.0)], datum=(89.5, 0.0)).fixes["north"][0] == pytest.approx(
        0.5 * 111.7e3, rel=1e-3
    )


def test_what_a_filter_finds_goes_back_to_the_earth():
    """A robot that drives north at 10 m/s: its smoothed places, written and read again."""
    rows = [(48.0 + 9e-5 * k, 11.0) for k in range(6)]
    drive = table(rows)
    x = pgm.Variable("x", components=("east", "north"), units=("km", "km"))
    z = pgm.Variable("z", components=("east", "north"))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0, 0], 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)],
        [pgm.LinearGaussianCPD(z, {x: 1000.0}, cov=1e-8)],
    )
    log = drive.timeline(np.arange(6.0), sensors={z: "fixes"})
    found = pgm.smooth(model, log.evidence, steps=log.steps)
    path = pgm.Poses.of(found[x], times=log.times, position=("east", "north"), heading=None)
    file = io.StringIO()
    write_gpx(file, path, datum=drive.datum, begin=datetime(2024, 5, 1, tzinfo=UTC), name="a <b>")
    assert "<time>2024-05-01T00:00:03Z</time>" in file.getvalue()
    assert "&lt;b&gt;" in file.getvalue()
    file.seek(0)
    again = read_gpx(file, datum=drive.datum)
    assert_allclose(again.fixes.values, drive.fixes.values, atol=1e-5)
    assert_allclose(np.diff(again.fixes.stamps), 1.0)


def gpx(points, more="", version="1/1"):
    return io.StringIO(
        f'<?xml version="1.0"?><gpx xmlns="http://www.topografix.com/GPX/{version}">{more}<trk>'
        f"<trkseg>{points}</trkseg></trk></gpx>"
    )


def point(time, lat="48.0", lon="11.0", more=""):
    when = f"<time>{time}</time>" if time else ""
    return f'<trkpt lat="{lat}" lon="{lon}">{more}{when}</trkpt>'


def test_a_track_in_its_odd_forms():
    points = [
        point("2024-05-01T10:00:01Z", more="<ele>500</ele>"),
        point("2024-05-01T10:00:00.250Z", "48.0001"),  # before the row above, no elevation
        point("", "48.1"),
        point("2024-05-01T12:00:03+02:00", "48.0002", more="<ele>501</ele><fix>3d</fix>"),
        point("2024-05-01T10:00:04", "0", "0"),
        point("2024-05-01T10:00:05", "0", "0", more="<fix>none</fix>"),
    ]
    more = '<wpt lat="1" lon="2"/><rte><rtept lat="1" lon="2"/><rtept lat="1" lon="3"/></rte>'
    drive = read_gpx(gpx("".join(points), more, version="1/0"))
    base = datetime(2024, 5, 1, 10, tzinfo=UTC).timestamp()
    assert_allclose(drive.fixes.stamps - base, [0.25, 1.0, 3.0])
    assert_allclose(drive.fixes["up"], [np.nan, 0.0, 1.0], atol=1e-3)
    told = {(each.stream, each.fate): each.rows.size for each in drive.dropped}
    assert told[("fixes", "without a fix")] == 1
    assert told[("fixes", "without a time")] == 1
    assert told[("wpt", "of no track")] == 1
    assert told[("rtept", "of no track")] == 2
    assert any("0°, 0°" in fate for _, fate in told)
    assert read_gpx(gpx(point("2024-05-01T10:00:01Z"))).fixes.components == ("east", "north")


@pytest.mark.parametrize(
    ("file", "said"),
    [
        (gpx(""), "no track"),
        (gpx(point("")), "no point of its tracks has a fix and a time"),
        (gpx(point("noon")), "point 0 has the time 'noon'"),
        (gpx(point("2024-05-01T10:00:01Z", "north")), "point 0 has 'north'"),
        (gpx('<trkpt lat="1"/>'), "point 0 has no lon"),
        (gpx(point("2024-05-01T10:00:01Z", "95")), "latitude 95°"),
        (io.StringIO("<kml></kml>"), "its root is <kml>"),
        (io.StringIO("<gpx>"), "no well-formed XML"),
        (io.StringIO('<!DOCTYPE a [<!ENTITY b "c">]><gpx>&b;</gpx>'), "defines entities"),
    ],
)
def test_tracks_that_are_refused(file, said):
    with pytest.raises(pgm.FileError, match=said):
        read_gpx(file)


def test_places_that_cannot_be_written():
    track = Stream([1.7e9], [[0.0, 1.0]], ("east", "north"))
    for places, options, said in (
        (track, {"datum": None}, "datum= is needed"),
        (track.replace(stamps=[5.0]), {}, "begin=datetime"),
        (track, {"begin": datetime(2024, 5, 1)}, "with its tzinfo"),
        (Stream([1.7e9], [[1.0]], ("range",)), {}, "no component 'east'"),
        (track.replace(values=[[np.nan, 1.0]]), {}, "row 0"),
        ([[0.0, 1.0]], {}, "Poses.of"),
    ):
        with pytest.raises(pgm.EvidenceError, match=said):
            write_gpx(io.StringIO(), places, **{"datum": MUNICH} | options)
    file = io.StringIO()
    write_gpx(file, Stream([1.7e9], [[0.0, 1.0, 2.0]], ("east", "north", "up")), datum=MUNICH)
    assert "<ele>521.0" in file.getvalue()
    file.seek(0)
    assert_array_equal(read_gpx(file).fixes.stamps, [1.7e9])
