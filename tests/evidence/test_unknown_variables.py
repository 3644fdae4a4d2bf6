"""Candidates that are variables: for growing maps alone, of one kind, each once."""

import numpy as np
import pytest

import pgm

x, z = pgm.variables("x z")
here, there, far = pgm.variables(["here", "there", "far"], components=("east", "north"))
turned = pgm.Variable("turned", ("east", "north"), angles=("north",))
rain = pgm.Discrete("rain", ("no", "yes"))


@pytest.mark.parametrize(
    "several",
    [[here, there], (here, there), np.array([here, there]), (v for v in (here, there))],
    ids=["list", "tuple", "array", "generator"],
)
def test_candidates_are_variables_in_order(several):
    found = pgm.unknown(
        several, weights=[1.0, 3.0], spurious=0.2, volume=5.0, gate=0.99, association="likelihood"
    )
    assert found.candidates == (here, there)
    np.testing.assert_allclose(np.exp(found.log_shares), [0.2, 0.6, 0.2, 0.0])
    assert repr(found) == "unknown(one of 2, by likelihood)"


def test_scalars_have_any_names():
    assert pgm.unknown([x, z], association="likelihood").candidates == (x, z)


@pytest.mark.parametrize(
    ("several", "error", "words"),
    [
        ([], pgm.EvidenceError, r"found shape \(0,\)"),
        (here, pgm.EvidenceError, "found one alone, here"),
        ([here, [1.0, 2.0]], pgm.EvidenceError, r"found \[1.0, 2.0\] beside variables"),
        ([[1.0, 2.0], here], pgm.EvidenceError, r"found \[1.0, 2.0\] beside variables"),
        ([here, "there"], pgm.EvidenceError, "found 'there' beside variables"),
        ({here, there}, pgm.ModelError, "is a set, which has no order"),
        ([here, there, here], pgm.ModelError, "holds here twice"),
        ([rain], pgm.EvidenceError, "rain is discrete"),
        ([here, rain], pgm.EvidenceError, "rain is discrete"),
        ([here, x], pgm.EvidenceError, "of one kind; here has .* x has components"),
        ([here, turned], pgm.EvidenceError, "of one kind"),
    ],
)
def test_what_is_no_list_of_candidates(several, error, words):
    with pytest.raises(error, match=words):
        pgm.unknown(several, association="likelihood")


def test_shares_are_checked_as_of_values():
    with pytest.raises(pgm.EvidenceError, match="weights are 2 numbers"):
        pgm.unknown([here, there], weights=[1.0], association="likelihood")
    with pytest.raises(pgm.EvidenceError, match="give gate="):
        pgm.unknown([here, there], association="joint")


OPEN = pgm.unknown([here, there], association="likelihood")
MODEL = pgm.DynamicBayesianNetwork(
    prior=[pgm.GaussianCPD(x, 0.0, 1.0)],
    transition=[pgm.LinearGaussianCPD(x, {x.previous: 1.0}, 1.0)],
    observation=[pgm.LinearGaussianCPD(z, {x: 1.0, far: [[1.0, 0.0]]}, 1.0)],
)
SEEN = {"values": [[1.0]], "given": {far: OPEN}}


@pytest.mark.parametrize(
    "asked",
    [
        lambda: pgm.filter(MODEL, {z: pgm.sightings(**SEEN, step=[1])}, steps=2),
        lambda: pgm.smooth(MODEL, {z: pgm.sightings(**SEEN, step=[1])}, steps=2),
        lambda: pgm.filter(
            MODEL, {z: pgm.sightings(**SEEN, step=[1])}, steps=2, belief=pgm.Particles(10)
        ),
        lambda: pgm.filter(MODEL, {z: [[1.0]], far: OPEN}, steps=2),
        lambda: pgm.OnlineFilter(MODEL).update(
            pgm.OnlineFilter(MODEL).initial(), {z: pgm.sightings(**SEEN)}
        ),
        lambda: pgm.infer(
            pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(far, [0, 0], 1.0)])), {far: OPEN}
        ),
    ],
)
def test_other_models_refuse_variables(asked):
    words = r"far is left open among variables \(here, there\), which .* \(k, 2\)"
    with pytest.raises(pgm.EvidenceError, match=words) as told:
        asked()
    assert told.value.variable == far
