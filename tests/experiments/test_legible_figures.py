"""The experiments' figures: nothing cut, covered, alike or too small that a program can see."""

from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from experiments.catalogue import EXPERIMENTS
from experiments.record import Record

legible = pytest.importorskip("tests.plot.legible")

# Experiments that take a few seconds at most.
SHORT = (
    "localisation",
    "smoothing",
    "kalman",
    "imu_heading",
    "differential_drive",
    "plaza",
    "recordings",
    "wide_start",
    "cluster_graph",
    "grid_world",
    "hallway",
    "maze",
    "topological",
    "grid_localisation",
)
# Drawn over each other on purpose: a robot's axes on its body, factors on their clusters' edges.
OVERLAID = {("basics", "pose"), ("basics", "two_poses"), ("seven_nodes", "boundaries")}
# Its empty panel holds the legend's handles, which are lines without points.
EMPTY = {("nonlinear_measurement", "kl_against_cost")}


def faults(name: str, out: Path, patch: pytest.MonkeyPatch) -> list[str]:
    """What is wrong with the figures of an experiment at its quick settings."""
    found = []

    def look(record, figure, file, caption):
        FigureCanvasAgg(figure)  # a closed figure has none
        if (name, file) not in OVERLAID | EMPTY:
            found.extend(f"{file}: {each}" for each in legible.faults(figure, whole=False))
        record.picture(f"{file}.png", caption)

    patch.setattr(Record, "figure", look)
    EXPERIMENTS[name].run(out=out, **EXPERIMENTS[name].QUICK)
    return found


@pytest.mark.parametrize("name", SHORT)
def test_figures_are_legible(name, tmp_path, monkeypatch):
    assert faults(name, tmp_path, monkeypatch) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(EXPERIMENTS) - set(SHORT)))
def test_the_other_figures_are_legible_too(name, tmp_path, monkeypatch):
    assert faults(name, tmp_path, monkeypatch) == []
