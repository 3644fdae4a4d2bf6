"""The textbook networks: posteriors that are known, by enumeration."""

import itertools

import numpy as np
import pytest

from models import discrete as d


def probability(net, event, given=()):
    """Compute P(event | given) by summing over every state of the network."""
    joint, known = 0.0, 0.0
    given = dict(given)
    for state in itertools.product(*(v.states for v in net.variables)):
        at = dict(zip(net.variables, state, strict=True))
        if any(at[v] != s for v, s in given.items()):
            continue
        index = {v: v.index(s) for v, s in at.items()}
        p = np.prod([c.table[tuple(index[v] for v in (*c.given, c.child))] for c in net.cpds])
        known += p
        joint += p * all(at[v] == s for v, s in event.items())
    return joint / known


@pytest.mark.parametrize(
    ("event", "given", "value"),
    [
        ({d.wet: "yes"}, {}, 0.6471),
        ({d.rain: "yes"}, {d.wet: "yes"}, 0.7079),
        ({d.sprinkling: "yes"}, {d.wet: "yes"}, 0.4298),
        ({d.sprinkling: "yes"}, {d.wet: "yes", d.rain: "yes"}, 0.1945),  # explained away
        ({d.wet: "yes"}, {d.sprinkling: "no", d.rain: "no"}, 0.0),
    ],
)
def test_the_sprinkler(event, given, value):
    assert probability(d.sprinkler(), event, given) == pytest.approx(value, abs=5e-5)


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        (d.tuberculosis, 0.0104),
        (d.cancer, 0.055),
        (d.bronchitis, 0.45),
        (d.either, 0.0648),
        (d.xray, 0.1103),
        (d.dyspnoea, 0.4360),
    ],
)
def test_asia(variable, value):
    assert probability(d.asia(), {variable: "yes"}) == pytest.approx(value, abs=5e-5)


def patient_with_short_breath():
    """Enumerate a patient back from Asia who is short of breath, without the tables."""
    total, yes = (
        0.0,
        dict.fromkeys((d.smoking, d.tuberculosis, d.cancer, d.bronchitis, d.either, d.xray), 0.0),
    )
    for s, t, c, b in itertools.product((0, 1), repeat=4):
        chance = 0.01 * 0.5 * (0.05 if t else 0.95)
        chance *= abs(1 - c - (0.1 if s else 0.01)) * abs(1 - b - (0.6 if s else 0.3))
        ill = t or c
        chance *= {(0, 0): 0.1, (0, 1): 0.8, (1, 0): 0.7, (1, 1): 0.9}[ill, b]
        total += chance
        xray = 0.98 if ill else 0.05
        for variable, weight in zip(yes, (s, t, c, b, ill, xray), strict=True):
            yes[variable] += weight * chance
    return {variable: chance / total for variable, chance in yes.items()}


def test_asia_after_a_visit_with_short_breath():
    given = {d.visit: "yes", d.dyspnoea: "yes"}
    for variable, value in patient_with_short_breath().items():
        assert probability(d.asia(), {variable: "yes"}, given) == pytest.approx(value, abs=1e-12)


def test_an_x_ray_cannot_tell_tuberculosis_from_cancer():
    net = d.asia()
    assert net.separated(d.xray, (d.tuberculosis, d.cancer), given=d.either)
    assert net.separated(d.visit, d.smoking)
    assert not net.separated(d.visit, d.smoking, given=d.dyspnoea)
    assert d.sprinkler().separated(d.sprinkling, d.rain, given=d.cloudy)
    assert not d.sprinkler().separated(d.sprinkling, d.rain, given=(d.cloudy, d.wet))
