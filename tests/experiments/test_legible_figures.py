"""The experiments' figures: nothing cut, covered, alike or too small that a program can see."""

from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from experiments.catalogue import EXPERIMENTS
from experiments.record import Record

legible = pytest.importorskip("tests.plot.legible")

# Drawn over each other on purpose: a robot's axes on its body, factors on their clusters' edges.
OVERLAID = {("basics", "pose"), ("basics", "two_poses"), ("seven_nodes", "boundaries")}
# Its empty panel holds the legend's handles, which are lines without points.
EMPTY = {("nonlinear_measurement", "kl_against_cost")}


# No other test runs these at their quick settings.
RUN_HERE = ("plaza", "recordings", "wide_start")


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


@pytest.mark.parametrize(
    "name",
    # Of the others, tests that run them look at the figures (conftest.py), whatever the settings.
    [
        *RUN_HERE,
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in sorted(EXPERIMENTS.keys() - set(RUN_HERE))
        ),
    ],
)
def test_figures_are_legible(name, tmp_path, monkeypatch):
    assert faults(name, tmp_path, monkeypatch) == []
