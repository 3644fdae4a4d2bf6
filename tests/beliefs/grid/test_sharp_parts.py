"""Sensors on grids whose Gaussian parts are sharper than the cells: no centre need meet them."""

import numpy as np
import pytest

import pgm

x, z, m = pgm.Variable("x"), pgm.Variable("z"), pgm.Variable("m")
GRID = pgm.Grid({"x": (-9.0, 9.0, 600)})
SEEN = np.array([[1.5], [-1.0]])


def sensor(cov):
    return pgm.LinearGaussianCPD(z, {x: 1.0, m: 1.0}, cov=cov)


def filtered(sensor, given):
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.0, 1.0)],
        [pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.3)],
        [sensor],
    )
    evidence = {z: pgm.sightings(SEEN, step=[1, 2], given={m: given})}
    return pgm.filter(model, evidence, steps=2, belief=GRID).status


@pytest.mark.parametrize("weight", [0.9, 0.1])
def test_the_sharp_part_of_a_mixture_is_told(weight):
    mixed = pgm.MixtureCPD([sensor(0.2), sensor(1e-9)], [1.0 - weight, weight])
    with pytest.warns(pgm.GridWarning, match="too sharp for the cells"):
        status = filtered(mixed, [[0.1], [0.1]])
    # .03 m a cell, and a deviation of √1e-9 m.
    np.testing.assert_allclose(status.sharpest.cells, 0.03 / np.sqrt(1e-9))
    assert status.sharp == z
    assert (
        filtered(pgm.MixtureCPD([sensor(0.2), sensor(0.3)], [0.5, 0.5]), [[0.1]] * 2).sharp is None
    )


@pytest.mark.parametrize("association", ["likelihood", "sum"])
def test_sightings_that_are_spurious_for_want_of_narrow_cells_are_told(association):
    named = {"spurious": 0.1, "volume": 20.0, "association": association}
    with pytest.warns(pgm.GridWarning, match="too sharp for the cells"):
        status = filtered(sensor(1e-9), pgm.unknown([[0.1], [0.77]], **named))
    assert status.sharp == z
    assert filtered(sensor(0.2), pgm.unknown([[0.1], [0.77]], **named)).sharp is None
