"""The floor plan of a house: what is read, and what is refused."""

import numpy as np
import pytest
from scipy.io import savemat

from experiments import house, packaged
from pgm.errors import FileError

PLACES = {"kitchen": [[320, 190]], "br3": [[50, 50]], "patio": [[200, 350]]}


def written(folder, plan=None, places=PLACES, **others):
    path = folder / "house.mat"
    plan = np.zeros(house.SHAPE, dtype=np.uint8) if plan is None else plan
    savemat(path, {"floorplan": plan, "places": places, **others})
    return path


def test_a_floor_plan_is_read(tmp_path):
    plan = np.zeros(house.SHAPE, dtype=np.uint8)
    plan[100:111, 60:71] = 1  # a box round a box's inside, which no room's place reaches
    plan[103:108, 63:68] = 0
    found = house.load(written(tmp_path, plan))
    assert found.occupied.dtype == float
    assert found.occupied.sum() == plan.sum()
    assert found.occupied[100, 65] == 1.0  # row 0 is the lowest: nothing is turned over
    assert found.places["kitchen"] == pytest.approx((320.5 * 0.045, 190.5 * 0.045))
    assert found.places["patio"] == pytest.approx((200.5 * 0.045, 350.5 * 0.045))
    assert found.origin == (0.0, 0.0)
    assert found.resolution == 0.045
    assert found.indoors[50, 50]
    assert not found.indoors[100:111, 60:71].any()
    assert not found.indoors[350, 200]
    assert not found.indoors[:8].any()


@pytest.mark.parametrize(
    ("plan", "places", "told"),
    [
        (np.zeros((5, 5)), PLACES, r"a floorplan of shape \(5, 5\)"),
        (np.full(house.SHAPE, 2.0), PLACES, "0 and 1 in"),
        (None, {"kitchen": [[1, 2, 3]]}, "for the place kitchen; a column and a row were due"),
        (None, {"kitchen": [[600, 2]]}, "the place kitchen outside of the plan, at 600, 2"),
        (None, np.zeros(3), "no named places"),
    ],
)
def test_another_file_is_refused(plan, places, told, tmp_path):
    path = written(tmp_path, plan, places)
    with pytest.raises(FileError, match=told) as caught:
        house.load(path)
    assert caught.value.path == str(path)


def test_files_that_are_none_are_refused(tmp_path):
    savemat(tmp_path / "other.mat", {"places": [1]})
    with pytest.raises(FileError, match=r"no tables \['floorplan'\]; is it the house's"):
        house.load(tmp_path / "other.mat")
    (tmp_path / "broken.mat").write_bytes(b"no table")
    for name in ("broken.mat", "nowhere.mat"):
        with pytest.raises(FileError, match=r"cannot be read as a \.mat file"):
            house.load(tmp_path / name)


def test_a_floor_plan_that_is_not_installed_is_told(monkeypatch):
    monkeypatch.setattr(packaged.importlib.util, "find_spec", lambda name: None)
    assert house.find() is None
    with pytest.raises(FileError, match=r"floor plan.*pip install 'rtb-data>=2\.0'"):
        house.load()


def test_the_house_s_rooms_are_indoors():
    if house.find() is None:
        pytest.skip("the floor plan comes with rtb-data, which is not installed")
    found = house.load()
    assert found.occupied.shape == found.indoors.shape == house.SHAPE
    assert len(found.places) == 12
    for name, (east, north) in found.places.items():
        row, column = int(north / found.resolution), int(east / found.resolution)
        assert found.indoors[row, column] == (name not in house.OUTDOORS), name
        assert found.occupied[row, column] == 0.0
    # The walls at both ends of the bath's alcove, five feet apart.
    assert found.occupied[[110, 144], 197:217].all()
    assert 33 <= 1.524 / found.resolution <= 34
    assert not (found.indoors & (found.occupied > 0.0)).any()
    assert found.indoors.sum() * found.resolution**2 == pytest.approx(245.0, rel=0.01)  # m²
