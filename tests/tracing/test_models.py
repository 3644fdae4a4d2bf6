"""Traced derivatives of the functions in models/ are the Jacobians given there."""

import numpy as np
import pytest

from models import motion, sensors, tracking
from pgm.tracing import Program, trace

WIDTHS = {"state": 3, "control": 3, "other": 3, "bias": 1, "landmark": 2, "sight": 2}
PAIRS = ("turn_after_move",)  # of two components


def collected():
    """Each function with its derivatives, and the components of its arguments."""
    for module in (motion, sensors):
        for name in module.__all__:
            by = {p: getattr(module, f"{name}_by_{p}", None) for p in WIDTHS}
            by = {p: function for p, function in by.items() if function}
            if by:
                widths = [2 if p == "control" and name in PAIRS else WIDTHS[p] for p in by]
                yield name, getattr(module, name), list(by.values()), widths
    drive, wheels = motion.Velocity(0.3), motion.DifferentialDrive(0.8, 0.5, 0.3)
    turn = tracking.CoordinatedTurn(0.7)
    yield "Velocity", drive, [drive.by_state, drive.by_control], [3, 2]
    yield "DifferentialDrive", wheels, [wheels.by_state, wheels.by_control], [3, 2]
    yield "CoordinatedTurn", turn, [turn.by_state], [5]
    yield "steady", tracking.steady, [tracking.steady_by_state, None], [4, 1]
    for kind in ("RANGE", "BEARING", "RANGE_BEARING", "POSITION", "HEADING"):
        plain = getattr(sensors, kind)
        widths = [3, 2][: len(plain.derivatives)]
        for label, sensor, more in (
            ("mounted", sensors.mounted(plain, (1.0, 0.5, 0.3)), []),
            ("mounted anywhere", sensors.mounted(plain), [3]),
            ("calibrated", sensors.calibrated(plain, (1.1, 0.3)), []),
            ("calibrated anyhow", sensors.calibrated(sensors.mounted(plain)), [3, 2]),
        ):
            yield f"{label} {kind}", sensor.function, sensor.derivatives, [*widths, *more]


CASES = {name: case for name, *case in collected()}


def points(widths):
    """Batches (6, 40, width): straight on, nearly so, on the spot, landmarks near and far."""
    rng = np.random.default_rng(3)
    x, *others = (rng.normal(size=(6, 40, width)) for width in widths)
    for other in others:
        if other.shape[-1] > 1:
            other[0, :, 1] = 0.0  # no turn
            other[1, :, 1] *= 1e-9
            other[2, :, 1] = 1e-4 * other[2, :, 1]
            other[3, :, 0] = 0.0
        other[4] *= 1e5
    if widths == [5]:
        x[0, :, 4], x[1, :, 4] = 0.0, 1e-9 * x[1, :, 4]
    if len(others) == 1 and widths[1] == 2:
        others[0][5] = x[5, :, :2] + 1e-4 * others[0][5]
    return [x, *others]


@pytest.mark.parametrize("name", CASES)
def test_traced_derivatives_are_those_given(name):
    function, derivatives, widths = CASES[name]
    arguments = points(widths)
    due = function(*arguments)
    found = trace(function, widths, due.shape[-1:])
    assert isinstance(found, Program), found
    columns = tuple((a, i) for a, width in enumerate(widths) for i in range(width))
    value, slope = found.by(columns).batch(arguments, due.shape[:-1])
    np.testing.assert_allclose(np.moveaxis(value, 0, -1), due, rtol=1e-13, atol=1e-13)
    ends = np.cumsum(widths)
    for end, width, by in zip(ends, widths, derivatives, strict=True):
        if by is not None:
            given, traced = (
                by(*arguments),
                np.moveaxis(slope[:, end - width : end], (0, 1), (-2, -1)),
            )
            scale = np.maximum(np.abs(given).max(axis=(-2, -1), keepdims=True), 1.0)
            np.testing.assert_allclose(traced / scale, given / scale, rtol=0, atol=1e-12)


def test_every_derivative_there_is_compared():
    found = {f for _, derivatives, _ in CASES.values() for f in derivatives}
    for module in (motion, sensors):
        for name in module.__all__:
            assert "_by_" not in name or getattr(module, name) in found
