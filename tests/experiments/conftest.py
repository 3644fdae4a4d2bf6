"""Figures that experiments draw are looked at by a program, and written coarsely."""

import os
import pickle

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from experiments import record
from experiments.catalogue import EXPERIMENTS
from experiments.report.running import run_all
from tests.plot import legible

# Experiments whose figures are few; those of the others are looked at by slow tests.
LOOKED_AT = {
    "localisation",
    "slam",
    "pose_graphs",
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
    "height_and_group",
    "manoeuvre",
    "outlier_cause",
    "two_targets",
    "unknown_landmarks",
    "mirror",
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


@pytest.fixture(scope="session")
def quick(tmp_path_factory):
    """Run experiments at their quick settings, as reports do: each once for all workers' tests."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own

    def outcome(name):
        path = shared / f"{name}.outcome"
        if not path.exists():
            (found,) = run_all({name: EXPERIMENTS[name]}, own / "quick", seed=0, quick=True)
            (own / path.name).write_bytes(pickle.dumps(found))
            (own / path.name).replace(path)
        found = pickle.loads(path.read_bytes())
        assert not found.error, found.error
        return found

    return outcome
