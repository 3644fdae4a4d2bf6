"""Maps that nobody should give: files that are broken or meant to be, numbers too large."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from pgm import Variable
from pgm.errors import FileError, ModelError
from pgm.maps import BeamModel, FeatureMap, LikelihoodField, OccupancyMap, log_odds_map

PIXELS = b"P5\n3 2\n255\n" + bytes([0, 254, 205, 0, 254, 205])
KEYS = (
    "image: plan.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\n"
    "free_thresh: 0.196\n"
)
# Twelve lines that stand for 9¹² entries.
BOMB = "a0: &a0 [x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 13)
)


@pytest.mark.parametrize(
    "pixels",
    [
        b"P5\n100000 100000\n255\n\0",
        b"P5\n" + b"9" * 100 + b" 2\n255\n",
        b"P5\n3 2\n0\n" + bytes(6),
        b"P2\n3 2\n255\n0 1 2 3 4 300\n",
        b"P2\n3 2\n255\n0 a 2 3 4 3\n",
        b"P2\n3 2\n255\n0 2\n",
        b"P5\n-3 2\n255\n" + bytes(6),
        b"",
    ],
    ids=["huge", "endless", "no grey", "too light", "letters", "short", "negative", "empty"],
)
def test_broken_images(tmp_path, pixels):
    (tmp_path / "plan.pgm").write_bytes(pixels)
    (tmp_path / "plan.yaml").write_text(KEYS)
    with pytest.raises(FileError, match=r"plan\.pgm cannot be read"):
        OccupancyMap.read(tmp_path / "plan.yaml")


def test_a_png_of_which_a_bit_is_flipped(tmp_path):
    """It is refused, or, behind the pixels, changes nothing: never a map of other walls."""
    rng, (plan, image) = np.random.default_rng(0), (tmp_path / "plan.yaml", tmp_path / "plan.png")
    OccupancyMap(rng.integers(0, 2, (20, 30)).astype(float), 0.1).write(plan, image=".png")
    whole, due, refused = image.read_bytes(), OccupancyMap.read(plan).occupied, 0
    for bit in rng.choice(8 * len(whole), 60, replace=False).tolist():
        data = bytearray(whole)
        data[bit // 8] ^= 1 << bit % 8
        image.write_bytes(data)
        try:
            assert_array_equal(OccupancyMap.read(plan).occupied, due)
        except FileError:
            refused += 1
    assert refused > 50


@pytest.mark.parametrize(
    "text",
    [
        "[" * 20_000,
        "image: 2020-13-45",
        "image: " + "9" * 5000,
        KEYS.replace("plan.pgm", '"a\\0b"'),
        KEYS.replace("0.1", "1" + "0" * 400),
        BOMB + KEYS.replace("0.1", "*a12"),
    ],
    ids=["brackets", "date", "number", "path", "resolution", "bomb"],
)
def test_hostile_keys(tmp_path, text):
    (tmp_path / "plan.pgm").write_bytes(PIXELS)
    (tmp_path / "plan.yaml").write_text(text)
    with pytest.raises(FileError) as told:
        OccupancyMap.read(tmp_path / "plan.yaml")
    assert len(str(told.value)) < 1000


def test_a_file_that_cannot_be_written(tmp_path):
    with pytest.raises(FileError, match="cannot be written: No such file"):
        OccupancyMap([[1.0]], 1.0).write(tmp_path / "nowhere" / "plan.yaml")


def test_too_many_places():
    for spacing in (1e-200, 1e-320):
        with pytest.raises(ModelError, match="set them further apart"):
            OccupancyMap(np.zeros((4, 4)), 0.5).poses(spacing, 4)


def test_centres_of_no_cells():
    plan = OccupancyMap(np.zeros((4, 4)), 0.5)
    assert_array_equal(plan.centres([0, 1], 2), [[1.25, 0.25], [1.25, 0.75]])
    with pytest.raises(ModelError, match=r"rows have shape \(2,\) and columns \(3,\)"):
        plan.centres([0, 1], [0, 1, 2])
    with pytest.raises(ModelError, match="rows of cells must be numbers"):
        plan.centres("a", 0)


def test_landmarks_by_what_is_no_name():
    marks = FeatureMap([[0.0, 0.0]], ("door",))
    for names in (5, ["door", ["door"]], [None]):
        with pytest.raises(ModelError, match=r"by name|no landmark called"):
            marks.at(names)


def beam(**given):
    """A map of one beam, along three cells from the first."""
    settings = {"resolution": 1.0, "most": 10.0, **given}
    return log_odds_map([[0.5, 0.5, 0.0]], [[2.0]], [0.0], **settings)


def test_maps_of_any_origin_and_shape():
    """Cells that are looked at from elsewhere are the same ones, where there are any."""
    cells = beam().occupied
    whole = np.full((9, 12), np.nan)
    whole[4, 5:8] = cells
    far = beam(origin=[-5.0, -4.0, 0.0], shape=(9, 12))
    assert_array_equal(far.occupied, whole)
    assert_array_equal(beam(origin=[-5.0, -4.0, 0.0]).occupied, whole[:5, :8])
    assert_array_equal(beam(origin=[1.0, -1.0, 0.0], shape=(3, 1)).occupied, whole[3:6, 6:7])
    assert_array_equal(beam(origin=[1.0, 0.0, 0.0]).occupied, whole[4:5, 6:8])
    unknown = beam(origin=[-1e9, -1e9, 0.0], shape=(2, 3)).occupied
    assert_array_equal(unknown, np.full((2, 3), np.nan))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"origin": [-1e9, -1e9, 0.0]}, "from its origin on, would take"),
        ({"shape": (10**7, 10**7)}, "from its origin on, would take"),
        ({"origin": [100.0, 0.0, 0.0]}, "no beam enters the map"),
        ({"origin": [1e300, 0.0, 0.0], "resolution": 1e-10}, "so far off"),
    ],
)
def test_maps_that_are_too_large_or_elsewhere(given, message):
    with pytest.raises(ModelError, match=message):
        beam(**given)


X = Variable("x", components=("east", "north", "heading"), angles=("heading",))
Z = Variable("z", components=("ahead", "left"))
WALLS = OccupancyMap([[0.0, 1.0], [0.0, 1.0]], 0.5, origin=[1.0, 2.0, 0.4])


def test_poses_far_outside_see_nothing_of_the_map():
    """Also where float32, in which ends of beams are looked up, does not hold their places."""
    field = LikelihoodField(Z, X, WALLS, angles=[0.0, 1.5], most=4.0, std=0.2)
    away = [[1e300, 0.0, 0.0], [1e40, -1e40, 1e20], [-1e9, 5.0, 0.0], [0.0, 9.0, 0.0]]
    found = field.log_density([3.0, 3.0], {X: away})
    assert_allclose(found, 2.0 * np.log(0.05 / 4.0), rtol=1e-6)


def test_deviations_of_beams_beyond_sense():
    scan = {"angles": [0.0, 1.5], "most": 4.0}
    with pytest.raises(ModelError, match="as good as uniform; give random= their share"):
        BeamModel(Z, X, WALLS, std=1e300, **scan)
    sharp = BeamModel(Z, X, WALLS, std=1e-300, **scan)
    at = [1.25, 2.25, 0.4]
    found = sharp.log_density([0.3, 0.6], {X: at})
    # Neither is where the map has it: random both, and short the one, before the wall it misses.
    wide = BeamModel(Z, X, WALLS, std=1e-3, **scan)
    assert_allclose(found, wide.log_density([0.3, 0.6], {X: at}), rtol=1e-9)
