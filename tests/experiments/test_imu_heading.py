"""The lecture's example: its corrected numbers, and that its own follow from the slip."""

from fractions import Fraction

import numpy as np
import pytest


@pytest.fixture(scope="module")
def done(quick):
    found = quick("imu_heading")
    return found.folder, found.summary


def update(before):
    """One scalar update in fractions: gain, mean and variance."""
    before, sensor = Fraction(before), Fraction("0.01")
    gain = before / (before + sensor)
    return gain, Fraction("1.6") + gain * Fraction("0.4"), (1 - gain) * before


def test_the_numbers_as_corrected(done):
    gain, mean, variance = update("0.016")
    assert gain == Fraction(8, 13)
    assert (round(float(mean), 3), round(float(variance), 5)) == (1.846, 0.00615)
    for kind in ("ours", "closed_form"):
        found = done[1][kind]
        numbers = [found[key] for key in ("gain", "mean", "variance")]
        assert numbers == pytest.approx([float(gain), float(mean), float(variance)], abs=1e-14)
        assert found["predicted_mean"] == pytest.approx([1.0, 0.0, 1.6], abs=1e-15)


def test_the_printed_numbers_follow_from_the_slip(done):
    gain, mean, variance = (float(value) for value in update("0.16"))
    slip, printed = done[1]["with_the_slip"], done[1]["printed"]
    numbers = [slip[key] for key in ("gain", "mean", "variance")]
    assert numbers == pytest.approx([gain, mean, variance], abs=1e-14)
    assert printed["gain"] == pytest.approx(gain)
    assert (round(mean, 2), round(variance, 2)) == (printed["mean"], printed["variance"])


def test_the_position_learns_nothing(done):
    assert np.allclose(done[1]["ours"]["position_cov"], 0.01 * np.eye(2), atol=1e-16)


def test_the_evidence_is_the_density_of_the_innovation(done):
    """ln N(2.0; 1.6, 0.026)."""
    due = -0.5 * (0.4**2 / 0.026 + np.log(2 * np.pi * 0.026))
    assert done[1]["log_evidence"] == pytest.approx(due, abs=1e-12)


def test_the_singular_start_is_ordinary(done):
    assert done[1]["largest_difference_of_linearisers"] < 1e-14
    assert "no canonical form" in done[1]["canonical_start"]


def test_the_page_shows_ours_beside_the_printed_ones(done):
    out, summary = done
    table, figure = (next(p for p in summary["page"] if kind in p) for kind in ("table", "figure"))
    rows = {row[0]: row[1:] for row in table["rows"]}
    assert rows["ours"] == ["0.016", "0.6154", "1.846", "0.006154"]
    assert rows["ours"] == rows["closed form"]
    assert rows["reference, as printed"] == ["0.16", "16/17", "1.98", "0.01"]
    assert (out / figure["figure"]).read_bytes().startswith(b"\x89PNG")
