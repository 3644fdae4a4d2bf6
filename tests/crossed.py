"""Cases of a test from all combinations of some values, of which few are quick."""

import itertools

import pytest


def crossed(names, *axes):
    """Run a test with all combinations of these values; quick are few that have each value.

    The k-th of them has the k-th value of each axis, which begins again at its end. The others are
    slow. An axis is values, or a dictionary of their names to them.
    """
    known = [axis if isinstance(axis, dict) else named(axis) for axis in axes]
    turns = zip(*map(itertools.cycle, known), strict=True)
    quick = set(itertools.islice(turns, max(map(len, known))))
    cases = [
        pytest.param(
            *(axis[name] for axis, name in zip(known, case, strict=True)),
            marks=() if case in quick else pytest.mark.slow,
            id="-".join(case),
        )
        for case in itertools.product(*known)
    ]
    return pytest.mark.parametrize(names, cases)


def named(values):
    """Values by words for them: theirs, or their places where these are long or change."""
    words = [getattr(value, "__name__", str(value)) for value in values]
    fit = all(len(each) < 40 and each.isprintable() and " at 0x" not in each for each in words)
    keys = words if fit and len(set(words)) == len(words) else map(str, range(len(words)))
    return dict(zip(keys, values, strict=True))
