"""CPDs of continuous children that discrete parents choose."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

GROUP = pgm.Discrete("group", states=("f", "m"))
FAULT = pgm.Discrete("fault", 3)
H, W, U = pgm.variables("h w u")


def by_group(child=H):
    cases = {"f": pgm.GaussianCPD(child, 162, 40), "m": pgm.GaussianCPD(child, 176, 50)}
    return pgm.SwitchingCPD(child, given=GROUP, cases=cases)


def by_both():
    cases = {
        (group, fault): pgm.LinearGaussianCPD(W, {H: 0.1 * fault}, 1.0 + k, offset=10.0 * k)
        if fault
        else pgm.NonlinearGaussianCPD(W, (U, H), lambda u, h: u * h, 2.0)
        for k, group in enumerate(GROUP.states)
        for fault in range(3)
    }
    return pgm.SwitchingCPD(W, (GROUP, FAULT), cases)


def test_parents_are_those_of_all_cases():
    cpd = by_both()
    assert cpd.given == (GROUP, FAULT, U, H)
    assert cpd.switches == (GROUP, FAULT)
    assert list(cpd.cases)[:2] == [(0, 0), (0, 1)]
    assert repr(cpd) == "SwitchingCPD(w | group, fault, u, h)"
    assert "m, 2" in str(cpd)


def test_density_and_draws_are_those_of_the_case():
    cpd, rng = by_both(), np.random.default_rng(0)
    groups, faults = rng.integers(0, 2, (4, 5)), rng.integers(0, 3, 5)
    values = {U: rng.normal(size=(5, 1)), H: rng.normal(size=(4, 1, 1))}
    child = rng.normal(size=(2, 1, 1, 1))
    found = cpd.log_density(child, {GROUP: groups, FAULT: faults, **values})
    assert found.shape == (2, 4, 5)
    for i, j in np.ndindex(4, 5):
        part = cpd.cases[groups[i, j], faults[j]]
        own = {v: {U: values[U][j], H: values[H][i, 0]}[v] for v in part.parents}
        assert_allclose(found[:, i, j], part.log_density(child[:, 0, 0], own))
    drawn = cpd.sample({GROUP: groups, FAULT: faults, **values}, size=20000, rng=1)
    assert drawn.shape == (20000, 4, 5, 1)
    for i, j in np.ndindex(4, 5):
        part = cpd.cases[groups[i, j], faults[j]]
        own = {v: {U: values[U][j], H: values[H][i, 0]}[v] for v in part.parents}
        due = part.sample(own, size=20000, rng=2)
        assert abs(drawn[:, i, j].mean() - due.mean()) < 0.06
        assert abs(drawn[:, i, j].std() - due.std()) < 0.05


def test_a_case_sees_its_own_values_alone():
    """Functions are not asked at values of other cases, where they may have no value."""
    root = pgm.NonlinearGaussianCPD(W, H, np.sqrt, 1.0)
    cpd = pgm.SwitchingCPD(W, GROUP, {"f": root, "m": pgm.LinearGaussianCPD(W, {H: 1.0}, 1.0)})
    found = cpd.log_density([[2.0], [-4.0]], {GROUP: ["f", "m"], H: [[4.0], [-4.0]]})
    assert_allclose(found, -0.5 * np.log(2 * np.pi))


def test_networks_are_drawn_from():
    network = pgm.BayesianNetwork([pgm.TableCPD(GROUP, table=[0.25, 0.75]), by_group()])
    drawn = network.sample(40000, rng=0)
    assert_allclose(drawn[H][drawn[GROUP] == 1].mean(), 176, atol=0.2)
    assert_allclose(drawn[H].mean(), 0.25 * 162 + 0.75 * 176, atol=0.2)
    assert network.mixed
    assert not network.discrete
    assert network.inputs == ()
    parent = by_group().at(3).given[0]
    assert parent == GROUP.at(3)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: pgm.SwitchingCPD(H, GROUP, {"f": pgm.GaussianCPD(H, 1, 1)}), "no case 'm'"),
        (
            lambda: pgm.SwitchingCPD(H, GROUP, dict.fromkeys("fx", pgm.GaussianCPD(H, 1, 1))),
            "no state 'x'",
        ),
        (
            lambda: pgm.SwitchingCPD(H, GROUP, dict.fromkeys(("f", 0), pgm.GaussianCPD(H, 1, 1))),
            "given twice",
        ),
        (
            lambda: pgm.SwitchingCPD(H, GROUP, dict.fromkeys("fm", pgm.GaussianCPD(W, 1, 1))),
            "a CPD of w",
        ),
        (lambda: pgm.SwitchingCPD(H, GROUP, dict.fromkeys("fm", 3.0)), "was due"),
        (lambda: pgm.SwitchingCPD(H, GROUP, dict.fromkeys("fm", by_group())), "was due"),
        (
            lambda: pgm.SwitchingCPD(H, GROUP, dict.fromkeys("fm", pgm.GaussianCPD(H, 1, np.inf))),
            "infinite variance",
        ),
        (
            lambda: pgm.SwitchingCPD(
                H, GROUP, dict.fromkeys("fm", pgm.GaussianCPD(H, [[1.0], [2.0]], 1))
            ),
            "axes of runs",
        ),
        (lambda: pgm.SwitchingCPD(H, (GROUP, FAULT), {"f": pgm.GaussianCPD(H, 1, 1)}), "tuple"),
        (lambda: pgm.SwitchingCPD(H, (), {}), "no discrete parent"),
        (lambda: pgm.SwitchingCPD(H, W, {}), "w is continuous"),
        (lambda: pgm.SwitchingCPD(FAULT, GROUP, {}), "child is discrete"),
        (lambda: pgm.SwitchingCPD(H, GROUP, [1, 2]), "map states"),
        (lambda: pgm.BayesianNetwork([by_group()]), "group has no CPD"),
        (lambda: pgm.TableCPD(GROUP, H, table=[[0.5, 0.5]]), "h is continuous"),
        (lambda: pgm.LinearGaussianCPD(H, {GROUP: 1.0}, 1.0), "SwitchingCPD"),
        (
            lambda: pgm.DynamicBayesianNetwork(
                [pgm.TableCPD(GROUP, table=[0.5, 0.5]), by_group()], [], []
            ),
            "no transition",
        ),
    ],
)
def test_what_does_not_fit_is_refused(made, words):
    with pytest.raises(pgm.ModelError, match=words):
        made()
