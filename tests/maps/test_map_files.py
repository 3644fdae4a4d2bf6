"""Maps of ROS's map_server: read, written, refused."""

import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from pgm.errors import FileError
from pgm.maps import OccupancyMap

KEYS = {
    "image": "plan.pgm",
    "resolution": 0.05,
    "origin": [-1.0, 2.0, 0.5],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
GREY = np.array([[0, 100, 205], [254, 255, 89]], dtype=np.uint8)


@pytest.fixture
def plan(tmp_path):
    """How to write a map's files."""

    def write(grey=GREY, image="plan.pgm", **keys):
        if grey is not None:
            (grey if isinstance(grey, Image.Image) else Image.fromarray(grey)).save(
                tmp_path / image
            )
        path = tmp_path / "plan.yaml"
        path.write_text(yaml.safe_dump(KEYS | {"image": image} | keys))
        return path

    return write


@pytest.mark.parametrize("suffix", [".pgm", ".png"])
def test_what_is_written_is_read(building, tmp_path, suffix):
    path = tmp_path / "deep" / "building.yaml"
    path.parent.mkdir()
    building.write(path, image=suffix)
    found = OccupancyMap.read(path)
    assert_array_equal(found.free, building.free)
    assert_array_equal(found.obstacles, building.obstacles)
    assert_array_equal(found.origin, building.origin)
    assert found.resolution == building.resolution
    found.write(tmp_path / "again.yaml", image=suffix)
    again = OccupancyMap.read(tmp_path / "again.yaml")
    assert_array_equal(again.occupied, found.occupied)
    assert {path.suffix for path in path.parent.iterdir()} == {".yaml", suffix}


def test_trinary_values_first_row_at_the_top(plan):
    found = OccupancyMap.read(plan())
    # 89 is p = .651, 205 p = .1961: above .65, and not below .196.
    assert_array_equal(found.occupied, [[0.0, 0.0, 1.0], [1.0, np.nan, np.nan]])
    negated = OccupancyMap.read(plan(negate=1, mode="trinary"))
    assert_array_equal(negated.occupied, [[1.0, 1.0, np.nan], [0.0, np.nan, 1.0]])
    strict = OccupancyMap.read(plan(occupied_thresh=0.6, free_thresh=0.2))
    assert_array_equal(strict.occupied[1], [1.0, 1.0, 0.0])


def test_scaled_and_raw_values(plan):
    found = OccupancyMap.read(plan(mode="scale"))
    between = ((255 - 100) / 255 - 0.196) / (0.65 - 0.196)
    assert_allclose(found.occupied[1], [1.0, between, (50 / 255 - 0.196) / (0.65 - 0.196)])
    alpha = np.where(GREY == 254, 200, 255).astype(np.uint8)
    opaque = Image.merge("LA", [Image.fromarray(GREY), Image.fromarray(alpha)])
    seen = OccupancyMap.read(plan(opaque, image="plan.png", mode="scale"))
    assert_array_equal(np.isnan(seen.occupied), [[True, False, False], [False, False, False]])
    assert_array_equal(OccupancyMap.read(plan(opaque, image="plan.png")).occupied[0], [0, 0, 1])
    raw = OccupancyMap.read(plan(mode="raw"))
    assert_allclose(raw.occupied, [[np.nan, np.nan, 0.89], [0.0, 1.0, np.nan]])


def test_plain_text_images_and_grey_ones_in_colours(plan, tmp_path):
    path = plan(None)
    (tmp_path / "plan.pgm").write_text("P2\n# a comment\n3 2\n255\n0 100 205\n254 255 89\n")
    due = OccupancyMap.read(plan())
    assert_array_equal(OccupancyMap.read(path).occupied, due.occupied)
    colours = Image.fromarray(GREY).convert("RGB")
    assert_array_equal(OccupancyMap.read(plan(colours, "plan.png")).occupied, due.occupied)
    bits = Image.fromarray(GREY).convert("1", dither=Image.Dither.NONE)
    assert set(np.unique(OccupancyMap.read(plan(bits, "plan.png")).occupied)) == {0.0, 1.0}


@pytest.mark.parametrize("key", KEYS)
def test_missing_keys(plan, key):
    path = plan()
    path.write_text(yaml.safe_dump({k: v for k, v in KEYS.items() if k != key}))
    with pytest.raises(FileError, match=f"plan.yaml: has no {key}") as caught:
        OccupancyMap.read(path)
    assert caught.value.path == str(path)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"resolution": 0.0}, "resolution must be a number above 0"),
        ({"resolution": "fine"}, "resolution is 'fine'; a number was due"),
        ({"origin": [0.0, float("nan"), 0.0]}, "origin .* must be finite"),
        ({"origin": [0.0, 0.0]}, r"origin has shape \(2,\)"),
        ({"origin": "here"}, "origin must be numbers"),
        ({"occupied_thresh": 0.1}, "free_thresh is 0.196 and occupied_thresh 0.1"),
        ({"free_thresh": -0.1}, "free_thresh is -0.1"),
        ({"negate": 2}, "negate is 2; 0 or 1 was due"),
        ({"mode": "grey"}, "mode is 'grey'; one of trinary, scale, raw was due"),
        ({"image": 3}, "image is 3"),
    ],
)
def test_wrong_keys(plan, keys, message):
    path = plan()
    path.write_text(yaml.safe_dump(KEYS | keys))
    with pytest.raises(FileError, match=f"plan.yaml: .*{message}"):
        OccupancyMap.read(path)


def test_images_that_cannot_be_used(plan, tmp_path):
    path = plan(None, image="gone.png")
    with pytest.raises(FileError, match=r"image .*gone.png cannot be read: No such file"):
        OccupancyMap.read(path)
    (tmp_path / "gone.png").write_text("no image")
    with pytest.raises(FileError, match=r"gone.png cannot be read: it is no image"):
        OccupancyMap.read(path)
    colours = np.zeros((2, 2, 3), np.uint8)
    colours[0, 0, 1] = 9
    with pytest.raises(FileError, match="is in colour"):
        OccupancyMap.read(plan(colours, image="red.png"))
    with pytest.raises(FileError, match="more than eight bits"):
        OccupancyMap.read(plan(GREY.astype(np.uint16) * 257, image="deep.png"))


def test_files_that_are_no_maps(tmp_path):
    path = tmp_path / "plan.yaml"
    with pytest.raises(FileError, match="cannot be read: No such file"):
        OccupancyMap.read(path)
    path.write_text("image: plan.pgm\norigin: [1, 2\nnegate: 0\n")
    with pytest.raises(FileError, match=r"plan\.yaml, line 3: no YAML") as caught:
        OccupancyMap.read(path)
    assert caught.value.line == 3
    path.write_text("just words")
    with pytest.raises(FileError, match="has no keys"):
        OccupancyMap.read(path)
    path.write_bytes(b"P5 3 2 255 \xff\xfe\x00")
    with pytest.raises(FileError, match="is no text"):
        OccupancyMap.read(path)


def test_targets_that_cannot_be(building, tmp_path):
    with pytest.raises(FileError, match=r"image is .pgm or .png, not '.jpg'"):
        building.write(tmp_path / "plan.yaml", image=".jpg")
    with pytest.raises(FileError, match="give it another suffix"):
        building.write(tmp_path / "plan.pgm")
