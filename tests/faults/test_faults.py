"""Faults put into recorded drives: the belief recovers, or its status says that it is lost.

A belief is wrong where its place is `Bounds.wrong` metres from the true one, and confident where
the true place is outside the ellipse that holds all but one in a million.
"""

from typing import NamedTuple

import numpy as np
import pytest
from faults.drives import drive, x
from faults.injected import KINDS, faulty
from scipy.stats import chi2

import pgm

CONFIDENT = chi2.ppf(1.0 - 1e-6, 2)


class Bounds(NamedTuple):
    """The size of faults and of errors that count, metres; the sightings of the longest silence."""

    size: float
    wrong: float
    silent: int


BOUNDS = {
    "Plaza1": Bounds(10.0, 4.0, 15),
    "Plaza2": Bounds(10.0, 4.0, 60),
    "Labyrinth": Bounds(1.5, 0.6, 20),
    "Freiburg": Bounds(3.0, 0.5, 12),
}


def longest(mask, heard):
    """The most sightings that are heard while a mask holds without a break, (runs, T+1)."""
    now, most = np.zeros(len(mask), dtype=int), np.zeros(len(mask), dtype=int)
    for on, count in zip(mask.T, heard, strict=True):
        now = np.where(on, now + count, 0)
        most = np.maximum(most, now)
    return most


def judged(name, kinds, seed, gate, last=None):
    """Drives with faults: how much is heard while each is wrong, and while nothing says so."""
    whole, bounds = drive(name), BOUNDS[name]
    some = whole if last is None else whole.part(last)
    bad = faulty(some, kinds, bounds.size, np.random.default_rng(seed))
    evidence = some.evidence(bad.controls, bad.values, bad.places)
    found = pgm.filter(some.model(bad.start), evidence, gate=gate)
    off = found[x].mean[..., :2] - some.truth
    spread = np.linalg.inv(found[x].cov[..., :2, :2])
    square = np.einsum("rti,rtij,rtj->rt", off, spread, off)
    wrong = (np.linalg.norm(off, axis=-1) > bounds.wrong) & (square > CONFIDENT)
    silent = wrong & ~found.lost.at
    assert np.isfinite(found[x].mean).all()
    heard = np.bincount(some.step, minlength=len(some.times))
    return longest(wrong, heard), longest(silent, heard), silent[:, -1]


@pytest.mark.parametrize("gate", [None, 0.99])
@pytest.mark.parametrize(
    ("name", "last"), [("Plaza2", 1000), ("Labyrinth", None), ("Freiburg", None)]
)
def test_a_fault_of_each_kind_is_told_of(name, last, gate):
    wrong, silent, at_last = judged(name, KINDS, 4, gate, last)
    bounds = BOUNDS[name]
    assert gate is None or wrong.max() > 5 * bounds.silent  # nobody would know of but for it
    assert (silent <= bounds.silent).all(), dict(zip(KINDS, silent, strict=True))
    assert not at_last.any()


@pytest.mark.slow
@pytest.mark.parametrize("gate", [None, 0.99])
@pytest.mark.parametrize("name", BOUNDS)
def test_ten_drawn_faults_are_told_of(name, gate):
    kinds = [*KINDS, *np.random.default_rng(0).choice(KINDS, 3)]
    wrong, silent, at_last = judged(name, kinds, 0, gate)
    bounds = BOUNDS[name]
    assert gate is None or wrong.max() > 5 * bounds.silent
    assert (silent <= bounds.silent).all(), list(zip(kinds, silent, strict=True))
    assert not at_last.any()


@pytest.mark.slow
@pytest.mark.parametrize("name", BOUNDS)
def test_without_a_fault_nobody_cries(name):
    whole = drive(name)
    for gate in (None, 0.99, 0.999):
        assert not pgm.filter(whole.model(), whole.evidence(), gate=gate).lost
