"""Cases of a test from all combinations of some values, of which few are quick."""

import itertools

import pytest


def crossed(names, *axes):
    """Run a test with all combinations of these values; quick are few that have each value."""
    return pytest.mark.parametrize(names, combinations(*axes))


def combinations(*axes):
    """Cases of all combinations; the k-th quick one has the k-th value of each axis.

    An axis that is shorter begins again; the other cases are slow. An axis is values, or a
    dictionary of names to them.
    """
    known = [axis if isinstance(axis, dict) else named(axis) for axis in axes]
    turns = zip(*map(itertools.cycle, known), strict=True)
    quick = set(itertools.islice(turns, max(map(len, known))))
    return [
        pytest.param(
            *(axis[name] for axis, name in zip(known, case, strict=True)),
            marks=() if case in quick else pytest.mark.slow,
            id="-".join(case),
        )
        for case in itertools.product(*known)
    ]


def slow_after(count, cases):
    """Cases of which all but the first so many are slow."""
    found = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [
        *(pytest.param(*case) for case in found[:count]),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in found[count:]),
    ]


def named(values):
    """Values by words for them: theirs, or their places where these are long or change."""
    words = [getattr(value, "__name__", str(value)) for value in values]
    fit = all(len(each) < 40 and each.isprintable() and " at 0x" not in each for each in words)
    keys = words if fit and len(set(words)) == len(words) else map(str, range(len(words)))
    return dict(zip(keys, values, strict=True))
