"""Figures that experiments draw are looked at by a program, and written coarsely."""

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from experiments import record
from tests.plot import legible

# Experiments whose figures are few; those of the others are looked at by slow tests.
LOOKED_AT = {
    "localisation",
    "smoothing",
    "kalman",
    "imu_heading",
    "differential_drive",
    "cluster_graph",
    "grid_world",
    "hallway",
    "maze",
    "topological",
    "grid_localisation",
}


@pytest.fixture(autouse=True, scope="session")
def coarse():
    fine, record.DPI = record.DPI, 40
    yield
    record.DPI = fine


@pytest.fixture(autouse=True, scope="session")
def looked_at():
    """Whatever runs an experiment draws all of its figures, and fails where one is not legible."""
    written = record.Record.figure

    def look(self, figure, name, caption):
        if self.name in LOOKED_AT:
            FigureCanvasAgg(figure)  # a closed figure has none
            found = legible.faults(figure, whole=False)
            assert not found, f"{self.name}, {name}: {found}"
            figure.set_layout_engine("none")  # it is found
        written(self, figure, name, caption)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(record.Record, "figure", look)
        yield
