"""Files as others publish them: read with what was mended told, or refused with the way out."""

import ast
import gzip
import io
import os
import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from pgm.errors import EvidenceError, FileError
from pgm.recordings import read_csv, read_freiburg, read_labyrinth, read_pose_graph

DATA = Path(os.environ.get("PGM_DATA") or Path(__file__).parents[3] / "shared" / "data")
POSES = "VERTEX2 0 0 0 0\nVERTEX2 1 1 0 0\nVERTEX2 2 2 0 0\n"
EDGES = "EDGE2 0 1 1 0 0 1 0 1 1 0 0\nEDGE2 1 2 1 0 0 1 0 1 1 0 0\n"


def graph_of(text, **options):
    return read_pose_graph(io.StringIO(text), **options)


def moved(pose, motion):
    """A pose moved on, by homogeneous matrices."""

    def matrix(x, y, turn):
        c, s = np.cos(turn), np.sin(turn)
        return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])

    there = matrix(*pose) @ matrix(*motion)
    return np.array([there[0, 2], there[1, 2], np.arctan2(there[1, 0], there[0, 0])])


def edge(one, other, motion):
    return f"EDGE_SE2 {one} {other} {' '.join(map(repr, motion))} 100 0 0 100 0 400\n"


def test_poses_of_edges_alone_are_composed_along_a_tree():
    """Whatever the tree: edges without noise lead to the poses that they were made of."""
    rng = np.random.default_rng(0)
    true = {7: np.zeros(3)}
    for number in (9, 12, 20, 21):
        true[number] = np.append(rng.normal(size=2) * 5, rng.uniform(-3, 3))
    text = ""
    for one, other in ((9, 7), (9, 12), (20, 12), (21, 20), (7, 21), (12, 7)):
        away, (c, s) = true[other] - true[one], (np.cos(true[one][2]), np.sin(true[one][2]))
        ahead = np.array([[c, s], [-s, c]]) @ away[:2]
        text += edge(one, other, [*ahead.tolist(), float(away[2])])
    graph = graph_of(text.replace("\n", "\r\n"))
    assert graph.names.tolist() == sorted(true)
    assert_allclose(graph.poses[:, :2], [true[n][:2] for n in sorted(true)], atol=1e-12)
    turns = graph.poses[:, 2] - [true[n][2] for n in sorted(true)]
    assert_allclose(np.exp(1j * turns), 1.0, atol=1e-12)
    (told,) = graph.dropped
    assert told.kept
    assert told.rows.size == 5
    assert "along a spanning tree" in repr(graph)
    fixed = graph_of(text + "FIX 12\n")
    assert_array_equal(fixed.poses[2], [0, 0, 0])


def test_landmarks_are_placed_by_their_first_sighting():
    text = edge(0, 1, [1.0, 2.0, 0.7])
    text += "EDGE_SE2_XY 1 4 3.0 -1.0 50 0 50\nEDGE_SE2_XY 0 4 9.0 9.0 50 0 50\n"
    graph = graph_of(text)
    due = moved(moved(np.zeros(3), [1.0, 2.0, 0.7]), [3.0, -1.0, 0.0])[:2]
    assert_allclose(graph.landmarks, [due])
    assert [each.stream for each in graph.dropped] == ["poses", "landmarks"]
    # With poses of the file, landmarks alone are placed.
    graph = graph_of("VERTEX_SE2 0 5 0 0\n" + "EDGE_SE2_XY 0 4 3.0 -1.0 50 0 50\n")
    assert_allclose(graph.landmarks, [[8.0, -1.0]])


@pytest.mark.parametrize(
    ("text", "line", "told"),
    [
        (edge(0, 1, [1, 0, 0]) + edge(5, 6, [1, 0, 0]), 2, "vertex 5, to which no edges lead from"),
        (edge(0, 1, [1, 0, 0]) + "FIX 0\nFIX 1\n", 3, "a second vertex that is fixed, 1"),
        (edge(0, 1, [1, 0, 0]) + "FIX 3\n", 2, "the vertex 3, which the file does not have"),
        (
            edge(0, 1, [1, 0, 0]) + "EDGE_SE2_XY 8 4 3 1 50 0 50\n",
            2,
            "the vertex 8, to which",
        ),
        ("VERTEX_SE2 0 0 0 0\n" + edge(0, 1, [1, 0, 0]), 2, "the vertex 1, which"),
        (POSES + "EDGE_SE2 0 1 1 0 0 1 2 0 1 0 1\n", 4, "information that is indefinite"),
        (POSES + "EDGE_SE2 0 1 1 0 0 -1 0 0 1 0 1\n", 4, "information that has the negative"),
        (POSES + "EDGE_SE2_XY 0 1 1 0 1 2 1\nVERTEX_XY 1 0 0\n", 4, "information that is indef"),
        (POSES + "EDGE2 0 1 1 0 0 3.2 0 0 3.2 0 5\n", 4, "isam=True reads iSAM's"),
    ],
)
def test_graphs_that_cannot_be(text, line, told):
    with pytest.raises(FileError, match=told) as caught:
        graph_of(text)
    assert caught.value.line == line


def test_information_of_no_weight_is_read():
    graph = graph_of(POSES + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 0\n")
    assert graph.edges.information[0, 2, 2] == 0.0
    with pytest.raises(EvidenceError, match="edge 0 is singular"):
        _ = graph.edges.covariances


def test_roots_of_information():
    root = np.array([[3.0, 0.5, -0.2], [0, 2.0, 0.1], [0, 0, 4.0]])
    upper = " ".join(map(str, root[np.triu_indices(3)]))
    graph = graph_of(f"EDGE2 0 1 1 0 0 {upper}\n", isam=True)
    assert_allclose(graph.edges.information[0], root.T @ root)


@pytest.mark.parametrize(
    "line", ["EQUIV 2 0", "BR 0 7 0.5 3.0 0.035 0.1", "LANDMARK2 0 7 1 1 5 0 5"]
)
def test_lines_of_other_kinds_are_skipped_where_asked(line):
    word = line.split()[0]
    text = POSES + EDGES + f"{line}\n{line}\n"
    with pytest.raises(FileError, match=rf"line 6: found '{word}'; .*skip=\('{word}',\) leaves"):
        graph_of(text)
    graph = graph_of(text, skip=(word,))
    assert len(graph.edges) == 2
    (told,) = graph.dropped
    assert told.rows.tolist() == [6, 7]
    assert f"2 dropped: {word}, lines from 1" in repr(graph)
    assert word in repr(graph.recording())


def test_the_words_to_skip_are_told_all_together():
    """Each message's skip= is given, as it stands, until the file is read."""
    text = POSES + EDGES + "FOO 1 2 3\nBAR 2\nFOO 4 5 6\n"
    skip, said = (), []
    while len(said) < 5:
        try:
            graph = graph_of(text, skip=skip)
            break
        except FileError as error:
            said.append(re.search(r"skip=(\(.*?\)) leaves such lines out", str(error))[1])
            skip = ast.literal_eval(said[-1])
    assert said == ["('FOO',)", "('FOO', 'BAR')"]
    assert [each.rows.tolist() for each in graph.dropped] == [[6, 8], [7]]
    with pytest.raises(FileError, match=r"found 'A.*\.\.\.'; VERTEX_SE2.*was due$"):
        graph_of(POSES + "A" * 100, skip=("FOO",))  # a word too long to be told


@pytest.mark.parametrize("skip", ["EQUIV", (1,), ("",), None])
def test_words_to_skip_that_are_none(skip):
    with pytest.raises(EvidenceError, match="skip= names the first words of lines"):
        graph_of(POSES, skip=skip)


def test_other_readers_skip_lines(tmp_path):
    (tmp_path / "world.dat").write_text("1 2 1\n")
    (tmp_path / "sensor_data.dat").write_text("ODOMETRY 0 1 0\nGPS 1 2\nSENSOR 1 1 0\n")
    with pytest.raises(FileError, match=r"line 2: found 'GPS'; .*skip=\('GPS',\)"):
        read_freiburg(tmp_path)
    drive = read_freiburg(tmp_path, skip=["GPS"])
    assert len(drive.sightings["landmark"]) == 1
    assert "1 dropped: GPS, lines from 1" in repr(drive)
    text = "imu3 0 1\nrange2 0.1 2.9 0.01 0 2 105 0\nodom2diff 0.1 0.2 0.4 0 0.08 0 0 0\n"
    with pytest.raises(FileError, match=r"line 1: found 'imu3'; .*skip"):
        read_labyrinth(io.StringIO(text))
    truth = "frame a\npoint2 0.1 1 2 0 0 0 0\n"
    drive = read_labyrinth(io.StringIO(text), io.StringIO(truth), skip=("imu3", "frame"))
    assert [(each.stream, each.rows.tolist()) for each in drive.dropped] == [
        ("input", [1]),
        ("truth", [1]),
    ]


def test_lines_are_counted_as_editors_do():
    text = POSES + "# a form feed \f and \x1c others\rHELLO\n"
    with pytest.raises(FileError, match="HELLO") as caught:
        graph_of(text)
    assert caught.value.line == 5


def test_edges_alone_gzipped(tmp_path):
    path = tmp_path / "edges.g2o.gz"
    path.write_bytes(gzip.compress(("\ufeff" + edge(0, 1, [1.0, 0.0, 0.5])).encode()))
    assert_allclose(read_pose_graph(path).poses, [[0, 0, 0], [1, 0, 0.5]])


def test_csail_is_read():
    path = DATA / "posegraphs" / "CSAIL.g2o"
    if not path.is_file():
        pytest.skip("the pose graph CSAIL is not here; PGM_DATA may name its folder's folder")
    graph = read_pose_graph(path)
    assert (len(graph.poses), len(graph.edges)) == (1045, 1172)
    # Each pose is met exactly by one edge of the tree, at the least.
    ends = graph.poses[graph.edges.first], graph.poses[graph.edges.second]
    off = [moved(a, m) - b for a, m, b in zip(ends[0], graph.edges.motions, ends[1], strict=True)]
    assert (np.abs(np.array(off)[:, :2]).max(axis=1) < 1e-9).sum() >= 1044


@pytest.mark.parametrize(
    ("name", "skip", "options", "sizes"),
    [
        ("w100.graph", ("EQUIV",), {}, (100, 300)),
        ("example.graph", ("BR",), {}, (95, 94)),
        ("victoriaPark_reduced_1k.g2o", ("LANDMARK2",), {}, (1000, 999)),
        ("w100_30.g2o", (), {"isam": True}, (30, 59)),
        ("pose2example.txt", (), {}, (11, 12)),
    ],
)
def test_graphs_of_the_gtsam_wheel(name, skip, options, sizes):
    gtsam = pytest.importorskip("gtsam")
    path = Path(gtsam.findExampleDataFile("Plaza1_.mat")).with_name(name)
    graph = read_pose_graph(path, skip=skip, **options)
    assert (len(graph.poses), len(graph.edges)) == sizes
    assert all(word in repr(graph) for word in skip)


def table(text, columns, **options):
    return read_csv(io.StringIO(text), columns, **options)


EUROC = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m]\n"
    "1403715524907143168,0.5,2.0\n1403715524912143104,0.6,2.1\n"
)  # fmt: skip


@pytest.mark.parametrize("above", ["", "# another comment, of two cells\n"])
@pytest.mark.parametrize("stamp", ["#timestamp", "timestamp"])
def test_names_in_a_comment(stamp, above):
    columns = {"t": (stamp, "ns"), "east": "p_RS_R_x [m]", "north": "p_RS_R_y [m]"}
    for text in (above + EUROC, (above + EUROC).replace("\n", "\r\n"), "\ufeff" + above + EUROC):
        drive = table(text, {"truth": columns})
        assert_array_equal(drive.truth["east"], [0.5, 0.6])
        assert not drive.dropped
    with pytest.raises(FileError, match=rf"no column 'x'; they are '{stamp}'"):
        table(EUROC, {"truth": {**columns, "east": "x"}})


geo = pytest.mark.skipif(find_spec("pymap3d") is None, reason="pip install 'sepset[geo]'")
LOG = "time,lat,lon,alt\n0,48.1371,11.5754,500\n1,0,0,0\n2,48.1372,11.5754,501\n3,,,\n"
WORLD = {"t": "time", "latitude": ("lat", "deg"), "longitude": ("lon", "deg"), "up": "alt"}


@geo
def test_latitudes_and_longitudes_become_metres():
    drive = table(LOG, {"fixes": WORLD})
    assert drive.fixes.components == ("east", "north", "up")
    # A degree of the meridian at this latitude is 111.2 km, by its radius of curvature.
    e2, sin = 6.69437999014e-3, np.sin(np.radians(48.13715))
    meridian = 6378137.0 * (1 - e2) / (1 - e2 * sin**2) ** 1.5 + 500
    assert_allclose(drive.fixes["north"], [0.0, np.radians(1e-4) * meridian], rtol=1e-6)
    assert_allclose(drive.fixes["up"], [0.0, 1.0], atol=1e-4)
    empty, null = drive.dropped
    assert (empty.stream, empty.rows.tolist()) == ("table", [3])
    assert (null.stream, null.rows.tolist()) == ("fixes", [1])
    assert "0°, 0°" in null.fate


@geo
def test_streams_of_a_file_are_on_one_plane():
    text = "t,lat,lon,la,lo,s\n0,48.0,11.0,48.001,11.0,4\n1,48.0,11.0,48.001,11.0,9\n"
    columns = {
        "fixes": {"t": "t", "latitude": ("lat", "deg"), "longitude": ("lon", "deg"),
                  "variance of north": "s"},
        "truth": {"t": "t", "longitude": ("lo", "deg"), "latitude": ("la", "deg")},
    }  # fmt: skip
    drive = table(text, columns)
    assert_allclose(drive.fixes["north"], 0.0)
    assert_allclose(drive.truth["north"], 111.2, rtol=1e-3)
    assert drive.truth.components == ("east", "north")
    assert_array_equal(drive.fixes.variances[:, 1], [4.0, 9.0])
    assert np.isnan(drive.fixes.variances[:, 0]).all()


FIXES = {"t": "t", "latitude": ("lat", "deg"), "longitude": ("lon", "deg")}
AROUND = "are due; they seem to go from 0 to 360: subtract 360 from those beyond 180"


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (["48,11", "48,200"], f"row 1: latitude 48°, longitude 200°, .*{AROUND}"),
        (["48,", "-90,360"], f"row 1: .*longitude 360°, .*{AROUND}"),
        (["48,-179", "48,200"], "row 1: .*longitude 200°, .*are they degrees.$"),
        (["48,11", "48,361"], "row 1: .*longitude 361°, .*are they degrees.$"),
        (["48,-180.001"], "row 0: .*longitude -180.001°, .*are they degrees.$"),
        (["100,200"], "row 0: .*are they degrees.$"),
        (["170,11"], "row 0: .*are latitude and longitude exchanged.$"),
    ],
)
def test_longitudes_that_are_refused(rows, told):
    text = "t,lat,lon\n" + "".join(f"{k},{row}\n" for k, row in enumerate(rows))
    with pytest.raises(FileError, match=told):
        table(text, {"fixes": FIXES})


@geo
def test_longitudes_are_read_up_to_half_a_turn():
    """Either way to write the antimeridian, in degrees and in radians."""
    text = f"t,lat,lon,rad\n0,10,180,{np.pi!r}\n1,10,-180,{-np.pi!r}\n"
    for columns in (FIXES, FIXES | {"longitude": ("rad", "rad")}):
        drive = table(text, {"fixes": columns})
        assert_allclose(drive.fixes.values, 0.0, atol=1e-6)


@pytest.mark.parametrize("part", ["fixes", "truth", "beacons"])
@pytest.mark.parametrize(
    ("east", "north", "told"),
    [
        (
            "lon",
            "lat",
            "'lon' by its name a longitude: .*'longitude': .'lon', 'deg'.*, .'lon', 'm'",
        ),
        ("GPS_Long", "y", "a longitude"),
        ("x", "gpsLat", "a latitude"),
        ("x", "Latitude [deg]", "a latitude"),
        ("x", "LATITUDE", "a latitude"),
    ],
)
def test_latitudes_are_no_metres(part, east, north, told):
    text = f"t,{east},{north}\n0,11.5754,48.1371\n1,11.5755,48.1372\n"
    with pytest.raises(EvidenceError, match=told):
        table(text, {part: {"t": "t", "east": east, "north": north}})
    metres = {"t": "t", "east": (east, "m"), "north": (north, "m")}
    drive = table(text, {part: metres})
    found = drive.sightings[part] if part == "beacons" else getattr(drive, part)
    assert_array_equal(found["north"], [48.1371, 48.1372])


def test_names_that_are_no_latitudes():
    text = "t,plate,belong\n0,1,2\n"
    drive = table(text, {"truth": {"t": "t", "east": "plate", "north": "belong"}})
    assert_array_equal(drive.truth.values, [[1.0, 2.0]])


@pytest.mark.parametrize(
    ("part", "columns", "error", "told"),
    [
        ("fixes", {"east": ("lon", "deg"), "north": ("lat", "deg")}, EvidenceError, "'latitude'"),
        ("fixes", {"east": ("lon", "s")}, EvidenceError, "'s' is a time, and 'east' a length"),
        ("compass", {"heading": ("lat", "s")}, EvidenceError, "a time, and 'heading' an angle"),
        ("fixes", {"t": ("time", "m"), "east": "lon"}, EvidenceError, "a length, and 't' a time"),
        ("velocities", {"v": ("lat", "m"), "omega": "lon"}, EvidenceError, "'v' a speed"),
        ("velocities", {"left": ("lat", "m"), "right": "lon"}, EvidenceError, "'left' a speed"),
        ("odometry", {"left": ("lat", "m/s"), "right": "lon"}, EvidenceError, "'left' a length"),
        ("imu", {"acceleration_x": ("lat", "m/s")}, EvidenceError, "an acceleration, in .m/s"),
        ("fixes", {"latitude": "lat", "longitude": "lon"}, EvidenceError, "has its unit beside"),
        ("fixes", {"latitude": ("lat", "deg")}, FileError, "a latitude and no longitude"),
        ("fixes", {"latitude": ("lon", "rad"), "longitude": ("lat", "rad")}, FileError, "degrees?"),
        ("fixes", {"east": "lon", "variance of esat": "lat"}, EvidenceError, "a variance is of"),
        (
            "fixes",
            {"east": "lon", "variance of east": ("lat", "s")},
            EvidenceError,
            "'s' is a time",
        ),
        ("fixes", {**WORLD, "variance of latitude": "lat"}, EvidenceError, "'north', 'east'"),
        ("fixes", {**WORLD, "north": "alt"}, FileError, "two of one direction"),
        ("fixes", {**WORLD, "north": "lat"}, EvidenceError, "by its name a latitude"),
        ("a", {"x": ("lat", "m", "s")}, EvidenceError, "several units"),
    ],
)
def test_units_that_do_not_fit(part, columns, error, told):
    with pytest.raises(error, match=told):
        table(LOG, {part: {"t": "time", **columns}}, wheelbase=0.5 if "left" in columns else None)


def test_places_beyond_a_pole():
    swapped = WORLD | {"latitude": ("lon", "deg"), "longitude": ("lat", "deg")}
    text = "time,lat,lon,alt\n0,48,95,0\n"
    with pytest.raises(FileError, match=r"row 0: latitude 95°, .* exchanged\?"):
        table(text, {"fixes": swapped})
    with pytest.raises(FileError, match=r"latitude 481371000°, .* are they degrees\?"):
        table("time,lat,lon,alt\n0,481371000,115754000,0\n", {"fixes": WORLD})


def angles(values, name, part, column="a", period=0.1):
    rows = "".join(f"{period * k:.1f},{value}\n" for k, value in enumerate(values))
    return table("t,a\n" + rows, {part: {"t": "t", name: column}})


STEADY = np.cumsum(np.full(200, 0.12))  # an unwrapped heading that turns 24 rad


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("bearing", [-30, 12.5, 44]),
        ("bearing", [3.0, 359.0]),
        ("heading", [90.0, 91.0, 92.0]),
        ("heading", [0.0, 3.0, 6.0, 9.0, 12.0]),  # 30 degrees a second
        ("heading", [358.0, 2.0]),
        ("yaw", [0.1, 5.0, -170.0]),
        ("pitch", [1.0, 9.0]),
        ("rate_z", [0.1, 45.0]),
    ],
)
def test_degrees_are_recognised(name, values):
    with pytest.raises(FileError, match=r"seems to be in degrees: say so, \('a', 'deg"):
        angles(values, name, "sensor")
    unit = "deg/s" if name.startswith("rate") else "deg"
    seen = angles(values, name, "sensor", ("a", unit)).sightings["sensor"]
    assert_allclose(seen[name], np.radians(values))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("heading", STEADY),
        ("heading", -STEADY),
        ("heading", np.mod(STEADY, 2 * np.pi)),
        ("heading", [6.25, 0.03, 6.2]),
        ("bearing", [-3.23, 3.1, 6.28]),
        ("rate_z", [-9.0, 15.0]),
        ("temperature", [20.0, 90.0, 1e4]),
    ],
)
def test_radians_are_no_degrees(name, values):
    assert_allclose(angles(values, name, "sensor").sightings["sensor"][name], values, rtol=1e-12)


def test_turns_in_degrees():
    text = "t,d,a\n0,0,0\n1,0.1,12\n2,0.1,3\n"
    columns = {"t": "t", "distance": "d", "turn": "a"}
    with pytest.raises(FileError, match=r"turn'\] goes to 12 rad, 1.91 turns; .*\('a', 'deg'\)"):
        table(text, {"odometry": columns})
    drive = table(text, {"odometry": columns | {"turn": ("a", "rad")}})
    assert_array_equal(drive.odometry["turn"], [0, 12, 3])


def test_stamps_of_another_unit_name_it():
    text = "t,x\n1403715524907143168,0.5\n1403715524912143104,0.6\n"
    with pytest.raises(FileError, match=r"nanoseconds.*say their unit, \('t', 'ms'\)"):
        table(text, {"a": {"t": "t", "x": "x"}})


def test_decimal_commas():
    text = "t;x\n0;1,5\n0,5;2,25\n"
    columns = {"a": {"t": "t", "x": "x"}}
    drive = table(text, columns, delimiter=";", decimal=",")
    assert_array_equal(drive.sightings["a"]["x"], [1.5, 2.25])
    with pytest.raises(FileError, match=r"line 2: '1,5' is no number; decimal=','"):
        table(text, columns, delimiter=";")
    with pytest.raises(FileError, match=r"one cell, 't;x'; delimiter=';' divides it"):
        table(text, columns)
    with pytest.raises(FileError, match="line 2: it has 3 cells, where 2 columns have names"):
        table(text.replace(";", ","), columns)
    with pytest.raises(EvidenceError, match="decimal= is one letter, another than delimiter="):
        table(text, columns, decimal=",")


def test_cells_that_say_nan_are_missing():
    drive = table("t,x,y\n0,nan,1\n1,NaN,nan\n2,3,4,\n", {"a": {"t": "t", "x": "x", "y": "y"}})
    assert_array_equal(drive.sightings["a"].values, [[np.nan, 1], [3, 4]])
    assert drive.dropped[0].rows.tolist() == [1]
    with pytest.raises(FileError, match="line 2: 'nan' is not finite"):
        table("t,v,w\n0,nan,1\n", {"velocities": {"t": "t", "v": "v", "omega": "w"}})


@pytest.mark.parametrize("text", ["", "\n \n", "# only words\n", ",,\n"])
def test_empty_tables(text):
    with pytest.raises(FileError, match="no lines of values"):
        table(text, {"a": {"t": "t", "x": "x"}})
