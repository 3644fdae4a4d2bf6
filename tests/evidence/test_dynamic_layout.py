"""Evidence laid out by step: the rows of the user's arrays, in memory of its own."""

import pickle
from types import MappingProxyType

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import pgm
from models import networks
from models.networks import landmark, sighting, velocity
from pgm.evidence import bind
from pgm.evidence.dynamic import by_row

MODEL = networks.range_bearing(0.1)
RNG = np.random.default_rng(0)
LANDMARKS = RNG.normal(size=(4, 2))


def bound(lead, step, missing=False):
    values = RNG.normal(size=(*lead, 4, 2))
    if missing:
        values[..., 2, :] = np.nan
        values[..., 1, 1] = np.nan
    controls = RNG.normal(size=(*lead, 5, 2))
    seen = pgm.sightings(values, step=step, given={landmark: LANDMARKS})
    found = bind(MODEL.transition, MODEL.observation, {velocity: controls, sighting: seen}, 5)
    return values, controls, found


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("step", [[0, 2, 2, 5], [3, 0, 5, 3]])
@pytest.mark.parametrize("lead", [(), (1,), (7,), (2, 3)])
def test_rows_are_steps_then_runs(lead, step, missing):
    values, controls, found = bound(lead, step, missing)
    runs = int(np.prod(lead))
    (reading,) = found.readings
    order = np.argsort(step, kind="stable")
    assert reading.step.tolist() == sorted(step)
    assert reading.order.tolist() == order.tolist()
    wide = values.reshape(runs, 4, 2)[:, order].swapaxes(0, 1)
    taken = np.broadcast_to(reading.taken, wide.shape)
    np.testing.assert_array_equal(taken, ~np.isnan(wide))
    np.testing.assert_array_equal(reading.values, np.nan_to_num(wide, nan=0.0))
    np.testing.assert_array_equal(reading.inputs[landmark][:, 0], LANDMARKS[order])
    due = controls.reshape(runs, 5, 2).swapaxes(0, 1)
    np.testing.assert_array_equal(found.transition[0][velocity], due)


def test_components_are_rows_of_runs_in_memory():
    _, _, found = bound((40,), [1, 2, 3, 4])
    for rows in (found.readings[0].values, found.transition[0][velocity]):
        assert rows.strides[1] == rows.itemsize


@pytest.mark.parametrize("lead", [(), (3,)])
def test_it_is_a_copy_that_functions_cannot_write_into(lead):
    values, controls, found = bound(lead, [1, 2, 3, 4])
    before = [rows.copy() for rows in (found.readings[0].values, found.transition[0][velocity])]
    values[...], controls[...] = 7.0, 7.0
    for rows, kept in zip(
        (found.readings[0].values, found.transition[0][velocity]), before, strict=True
    ):
        np.testing.assert_array_equal(rows, kept)
        assert not rows.flags.writeable


def test_sightings_show_what_they_are():
    mark = pgm.Variable("mark")
    told = pgm.sightings(np.zeros((4, 1)), step=range(4), given={mark: np.zeros((4, 1))})
    assert repr(told).splitlines()[0] == "Sightings(of shape (4, 1), given [mark])"
    bare = pgm.sightings([[1.0], [2.0]], step=[0, 1])
    title, *rows = repr(bare).splitlines()
    assert title == "Sightings([[1.0], [2.0]], given [])"
    assert [row.split() for row in rows] == [["step", "value"], ["0", "1"], ["1", "2"]]


def test_sightings_are_not_changed_afterwards():
    mark = pgm.Variable("mark")
    places = np.zeros((1, 1))
    given = {mark: places}
    for mapping in (given, MappingProxyType(given)):
        seen = pgm.sightings([[1.0]], given=mapping)
        given.clear()
        assert dict(seen.given) == {mark: places}
        given[mark] = places
        for name in ("values", "step", "given", "other"):
            with pytest.raises(AttributeError, match=rf"Sightings is immutable.* change {name}"):
                setattr(seen, name, None)
        with pytest.raises(TypeError):
            seen.given[mark] = None
        again = pickle.loads(pickle.dumps(seen))
        assert type(again) is type(seen)
        assert (again.values, again.step, dict(again.given)) == ([[1.0]], None, {mark: places})
    assert dict(pgm.sightings([[1.0]]).given) == {}
    with pytest.raises(pgm.EvidenceError, match="given maps parents"):
        pgm.sightings([[1.0]], given=[mark])


def test_rows_that_lie_by_runs_are_laid_out_alike():
    values = np.random.default_rng(1).normal(size=(6, 4, 2))
    lying = np.asfortranarray(values.transpose(1, 2, 0).copy().transpose(2, 0, 1))
    by_runs = values.transpose(1, 2, 0).copy().transpose(2, 0, 1)
    for given in (values, lying, by_runs):
        rows = by_row(given, (6,))
        assert_array_equal(rows, values.swapaxes(0, 1))
        assert rows.strides[1] == rows.itemsize
        assert not rows.flags.writeable
        assert not np.shares_memory(rows, given)
