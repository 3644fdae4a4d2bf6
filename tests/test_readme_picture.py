"""The first picture of the README is of the code as it is, and hides nothing."""

import itertools
import runpy
from pathlib import Path

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection
from PIL import Image

from experiments import localisation
from models.networks import pose
from pgm import consistency

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def script():
    return runpy.run_path(str(ROOT / "docs" / "trajectories.py"))


@pytest.fixture(scope="module")
def figure(script):
    found = script["draw"]()
    found.canvas.draw()
    return found


def test_the_picture_is_drawn_by_the_present_code(script, tmp_path):
    script["save"](tmp_path / "drawn.png")
    with Image.open(tmp_path / "drawn.png") as drawn, Image.open(script["PICTURE"]) as kept:
        assert drawn.size == kept.size == (1600, 1060)
        pixels = [np.asarray(each.convert("RGB")).astype(int) for each in (drawn, kept)]
    # Letters differ a little between versions of matplotlib; another path or ellipse does not fit.
    assert np.abs(np.subtract(*pixels)).mean() < 0.5
    assert script["PICTURE"].stat().st_size < 90_000


def test_its_difference_is_that_of_the_table(figure):
    network, drives = localisation.simulate(0, 50, 200)
    results, posteriors = localisation.compare(network, drives)
    names = ("Taylor", "Unscented")
    nees = {
        name: consistency.nees(posteriors[name].filtered[pose], drives.truth).mean(axis=-1)
        for name in names
    }
    for ax, name in zip(figure.axes, names, strict=True):
        assert f"{results['nees'][name]['filter']:.0f} over 50 drives" in ax.get_title()
        assert f"mean NEES {nees[name][nees['Taylor'].argmax()]:,.0f} here" in ax.get_title()


def test_ellipses_are_few_units_are_written_and_the_start_is_marked(figure):
    for ax in figure.axes:
        (ellipses,) = (c for c in ax.collections if isinstance(c, EllipseCollection))
        assert len(ellipses.get_offsets()) == 11
        assert "[m]" in ax.get_xlabel()
        starts = [line for line in ax.lines if line.get_marker() == "s"]
        assert [np.hypot(*line.get_xydata()[0]) < 0.5 for line in starts] == [True]
    assert figure.axes[0].get_ylabel() == "north [m]"


def test_the_legend_hides_nothing(figure):
    (legend,) = figure.legends
    words = [text.get_text() for text in legend.get_texts()]
    assert "start" in words
    assert any("95 % ellipse of the filter" in each for each in words)
    boxes = [legend.get_window_extent(), *(ax.get_tightbbox() for ax in figure.axes)]
    for one, other in itertools.combinations(boxes, 2):
        assert not one.overlaps(other)
    for box in boxes:
        assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.bbox.y1
