"""Cases of a test from all combinations of some values, of which few are quick."""

import itertools

import pytest


def crossed(names, *axes):
    """Run a test with all combinations of these values; quick are few that have each value."""
    return pytest.mark.parametrize(names, combinations(*axes))


def combinations(*axes):
    """Cases of all combinations, of which as many are quick as the longest axis has values.

    The others are slow. An axis is values, or a dictionary of names to them.
    """
    known = [axis if isinstance(axis, dict) else named(axis) for axis in axes]
    quick = covering(known)
    return [
        pytest.param(
            *(axis[name] for axis, name in zip(known, case, strict=True)),
            marks=() if case in quick else pytest.mark.slow,
            id="-".join(case),
        )
        for case in itertools.product(*known)
    ]


def covering(axes):
    """As few combinations as have each value, and of shorter axes many pairs.

    They are counted: from one combination to the next the longest axes change, and the others as
    digits do, where there is room for all of them.
    """
    longest, stride, columns = max(map(len, axes)), 1, []
    for axis in axes:
        values, each = list(axis), 1
        if len(values) < longest and stride * len(values) <= longest:
            each, stride = stride, stride * len(values)
        columns.append([values[k // each % len(values)] for k in range(longest)])
    return set(zip(*columns, strict=True))


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
