"""`pgm.plot.animate_beliefs`: a picture a step, whole or not at all."""

import numpy as np
import pytest
from matplotlib.animation import FFMpegWriter
from PIL import Image

import pgm
import pgm.plot
from pgm import ModelError

x = pgm.Variable("x", components=("east", "north"))
MODEL = pgm.DynamicBayesianNetwork(
    [pgm.GaussianCPD(x, [1.0, 2.0], 0.3 * np.eye(2))],
    [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, offset=[0.5, 0.0], cov=0.2 * np.eye(2))],
    [],
)
GRID = pgm.Grid({"east": (-4.0, 9.0, 26), "north": (-4.0, 8.0, 24)})
BELIEF = pgm.filter(MODEL, {}, steps=3, belief=GRID)[x]
TRUTH = np.array([[1.0, 2.0], [1.5, 2.0], [2.0, 2.0], [2.5, 2.0]])

CELL = pgm.Discrete("cell", ("a", "b", "c"))
PLACES = [[0, 0], [0, 1], [0, 2]]
WALK = pgm.Table(CELL, np.eye(3), lead=3)


def test_a_table_over_time_has_a_picture_a_step(tmp_path):
    path = tmp_path / "walk.gif"
    pgm.plot.animate_beliefs(WALK, path, places=PLACES, truth=["a", "b", "c"], dpi=40)
    with Image.open(path) as picture:
        assert picture.n_frames == 3
        pictures = []
        for k in range(3):
            picture.seek(k)
            pictures.append(np.asarray(picture.convert("RGB")).astype(int))
    dark = [p.sum(axis=2) < 200 for p in pictures]  # the dark blue of the one probable cell
    middle = [np.flatnonzero(each.sum(axis=0) > 20).mean() for each in dark]
    assert middle[0] < middle[1] < middle[2]


def test_the_axes_have_units(tmp_path):
    named = []
    pgm.plot.animate_beliefs(
        BELIEF,
        tmp_path / "drive.gif",
        unit={"east": "km", "north": "m"},
        also=lambda ax, step: named.append((ax.get_xlabel(), ax.get_ylabel())),
        figsize=(1.5, 1.5),
        dpi=20,
    )
    assert named == [("east [km]", "north [m]")] * 4
    with pytest.raises(ModelError, match="unit= is given of 'up'"):
        pgm.plot.animate_beliefs(BELIEF, tmp_path / "not.gif", unit={"up": "m"})
    with pytest.raises(ModelError, match="unit= is for a grid"):
        pgm.plot.animate_beliefs(WALK, tmp_path / "not.gif", places=PLACES, unit="m")
    assert not (tmp_path / "not.gif").exists()


def test_a_gif_has_a_picture_a_step(tmp_path):
    drawn = []
    path = pgm.plot.animate_beliefs(
        BELIEF,
        tmp_path / "drive.gif",
        truth=TRUTH,
        landmarks=[[0.0, 0.0]],
        rate=4.0,
        also=lambda ax, step: drawn.append((step, ax.get_title())),
        figsize=(3.0, 2.5),
        dpi=50,
    )
    assert path == tmp_path / "drive.gif"
    assert drawn == [(k, f"step {k}") for k in range(4)]
    with Image.open(path) as picture:
        assert picture.n_frames == 4
        assert picture.size == (150, 125)
        assert picture.info["duration"] == 250
        first = np.asarray(picture.convert("RGB")).astype(int)
        picture.seek(3)
        last = np.asarray(picture.convert("RGB")).astype(int)
    # The belief, in shades of blue, moves to the right.
    blue = [np.clip(p[..., 2] - p[..., 0], 0, None).sum(axis=0) for p in (first, last)]
    middle = [(weight * np.arange(150)).sum() / weight.sum() for weight in blue]
    assert middle[1] > middle[0] + 5.0


@pytest.mark.skipif(not FFMpegWriter.isAvailable(), reason="the program ffmpeg is not here")
def test_an_mp4_is_written_where_ffmpeg_is(tmp_path):
    path = pgm.plot.animate_beliefs(BELIEF, tmp_path / "drive.mp4", dpi=50)
    assert path.read_bytes()[4:8] == b"ftyp"


def test_an_mp4_without_ffmpeg_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(FFMpegWriter, "isAvailable", classmethod(lambda cls: False))
    with pytest.raises(ModelError, match=r"'drive\.mp4' needs the program ffmpeg.*write a \.gif"):
        pgm.plot.animate_beliefs(BELIEF, tmp_path / "drive.mp4")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("belief", "name", "given", "told"),
    [
        (BELIEF, "drive.avi", {}, r"'drive\.avi' is no moving picture.*ends in \.gif"),
        (BELIEF[2], "drive.gif", {}, "is not of one run over steps"),
        (BELIEF.gaussian(), "drive.gif", {}, "a table over time, not a Gaussian"),
        (BELIEF, "drive.gif", {"rate": 0.0}, "rate is a number of pictures a second"),
        (BELIEF, "drive.gif", {"truth": TRUTH[:2]}, r"shape \(2, 2\); \(4, 2\) was due"),
        (BELIEF, "drive.gif", {"landmarks": [1.0]}, r"landmarks have shape \(1,\)"),
        (WALK, "walk.gif", {}, "places are the cells of a table over one variable"),
        (WALK, "walk.gif", {"places": PLACES, "truth": [0, 1]}, r"\(2,\); \(3,\) was due, steps"),
        (
            WALK,
            "walk.gif",
            {"places": PLACES, "landmarks": [[0.0, 0.0]]},
            "landmarks= is for a grid",
        ),
        (pgm.Table(CELL, np.ones(3)), "walk.gif", {"places": PLACES}, "one run over steps"),
    ],
)
def test_what_does_not_fit_is_refused(belief, name, given, told, tmp_path):
    with pytest.raises(ModelError, match=told):
        pgm.plot.animate_beliefs(belief, tmp_path / name, **given)
    assert not list(tmp_path.iterdir())


def test_a_failure_on_the_way_leaves_what_was_there(tmp_path):
    path = tmp_path / "drive.gif"
    path.write_bytes(b"before")

    def also(ax, step):
        if step == 2:
            raise RuntimeError("no picture of step 2")

    with pytest.raises(RuntimeError, match="no picture of step 2"):
        pgm.plot.animate_beliefs(BELIEF, path, also=also, dpi=30)
    assert [each.name for each in tmp_path.iterdir()] == ["drive.gif"]
    assert path.read_bytes() == b"before"
