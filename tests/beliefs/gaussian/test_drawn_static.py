"""Drawn static networks of any rank and scale against 300 digits: right, or told; never silent."""

from types import SimpleNamespace

import numpy as np
import pytest
from crossed import slow_after
from gaussian.drawn_static import LINEARISERS, Judge, Reference, draw
from gaussian.draws import Conditioned, conditional
from textbooks import floats

NAMES = list(LINEARISERS)


def wrong(seed, which=None):
    """What is wrong without a word, refused, or wrong in a foreign one."""
    judge = Judge(draw(seed))
    assert judge.consistent
    return [
        f"seed {seed}, {v.kind}: {v.category} by {v.size:.1e} {v.words}"
        for v in judge.verdicts(which)
        if v.category in ("miss", "refused", "foreign")
    ]


@pytest.mark.parametrize("seed", slow_after(20, range(60)))
def test_drawn_networks_are_right_or_say_so(seed):
    two = {NAMES[seed % len(NAMES)], NAMES[(seed // 7 + 3 * seed + 1) % len(NAMES)]}
    assert not wrong(seed, {*two, "linear"})


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 2000, 100))
def test_2000_drawn_networks_are_right_or_say_so(first):
    found = [line for seed in range(first, first + 100) for line in wrong(seed)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("seed", [0, 3, 13, 31, 68, 92])
def test_the_reference_agrees_with_rational_numbers(seed):
    """The same networks in fractions, by conditioning on one reading after another."""
    case = draw(seed)
    cpds = [
        conditional(node.child, node.given, node.offset, node.root @ node.root.T)
        for node in case.nodes
    ]
    for run in case.evidence:
        if any(np.isnan(value).any() for value in run.values()):
            continue
        due = Conditioned(SimpleNamespace(cpds=cpds), run)
        found = Reference(case, run)
        hidden = [node.child for node in case.nodes if node.child not in run]
        mean, cov, *_ = found.part(hidden)
        due_mean, due_cov = (floats(part) for part in due[hidden])
        unit = np.sqrt(np.diag(due_cov))
        assert (np.abs(mean - due_mean) <= 1e-12 * (unit + np.abs(due_mean)) + 1e-250).all()
        assert (np.abs(cov - due_cov) <= 1e-12 * np.outer(unit, unit)).all()
        if not due.certain:
            assert found.determined == 0
            assert float(found.log_evidence) == pytest.approx(float(due.log_evidence), rel=1e-10)
