"""Drawn chains of any rank and scale against 300 digits: right, or told; never silently wrong."""

import numpy as np
import pytest
from crossed import slow_after
from drawn_chains import draw
from judged_chains import Judge
from precise import Reference, floats
from textbooks import exact_linear

# A reading that an exact model contradicts by rounding alone leaves no answer to compare.
CONSISTENT = 1e-12


def silent(seed, longest=60):
    """What is wrong without a word, or wrong in a foreign one."""
    case = draw(seed, longest)
    judged = Judge(case)
    if judged.disagreement > CONSISTENT:
        return []
    return [
        f"seed {seed}, {v.kind}: {v.category} by {v.size:.1e} {v.words}"
        for v in judged.verdicts()
        if v.category in ("miss", "foreign")
    ]


@pytest.mark.parametrize("seed", slow_after(8, range(25)))
def test_drawn_chains_are_right_or_say_so(seed):
    assert not silent(seed, 10)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(25, 5025, 100))
def test_5000_drawn_chains_are_right_or_say_so(first):
    found = [line for seed in range(first, first + 100) for line in silent(seed)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("seed", [400, 403, 405, 409, 417, 422, 431, 444, 462, 483])
def test_the_reference_agrees_with_rational_numbers(seed):
    """Conditioning of the whole record at once, by another algorithm in fractions."""
    case = draw(seed, 4)
    for run in case.runs:
        found = Reference(case.model, case.steps, *run)
        due = exact_linear(case.model, case.steps, *run)

        def same(mean, cov, exact):
            unit = np.sqrt(np.diag(exact[1]))
            product = np.outer(unit, unit)
            assert (np.abs(mean - exact[0]) <= 1e-12 * (unit + np.abs(exact[0])) + 1e-250).all()
            assert (np.abs(cov - exact[1]) <= 1e-12 * product).all()

        def part(whole, places):
            return floats(whole[0][places]), floats(whole[1][np.ix_(places, places)])

        for step in range(case.steps + 1):
            for v, places in found.places.items():
                if step or v in case.model.states:
                    one = (v.at(step),)
                    same(*part(found.predicted[step], places), due.predicted[step][v])
                    same(*part(found.filtered[step], places), due.filtered[step][v])
                    same(*part(found.smoothed[step], places), due.joint[one])
        every = [v.at(k) for k in range(1, case.steps + 1) for v in found.places]
        same(*found.joint(*every), due.joint[tuple(every)])
        assert abs(float(found.log_evidence) - due.joint.log_evidence) <= 1e-10 * (
            1 + abs(due.joint.log_evidence)
        )
