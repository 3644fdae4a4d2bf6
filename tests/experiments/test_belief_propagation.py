import json
from functools import partial

import numpy as np
import pytest

import pgm
from experiments import belief_propagation
from experiments.belief_propagation import cases
from experiments.belief_propagation.checks import difference
from experiments.belief_propagation.comparison import compare_methods
from experiments.belief_propagation.drawn import grid, leaves, observe, tables
from experiments.belief_propagation.enumeration import enumerate_states
from experiments.belief_propagation.loops import sweep
from experiments.belief_propagation.methods import averaged, compare
from experiments.record import Record
from models.discrete import ANSWERS, asia, rain, smoking, wet, xray
from models.rings import gaussian_ring

SCHEDULES = {"flooding", "sequential", "residual"}


@pytest.fixture(scope="module", params=[pytest.param("quick", marks=pytest.mark.slow)])
def done(tmp_path_factory):
    out = tmp_path_factory.mktemp("belief_propagation")
    belief_propagation.run(out=out, seed=0, **belief_propagation.QUICK)
    return out, json.loads((out / "summary.json").read_text())


@pytest.fixture(scope="module")
def robot():
    """Five poses: two landmarks are seen twice, so that carrying two leaves a loop."""
    return cases.robot(0, 4)[0]


def loopy(found):
    """All entries but the junction tree's."""
    entries = {
        (graph, schedule): numbers
        for graph, schedules in found.items()
        if graph != "junction_tree"
        for schedule, numbers in schedules.items()
    }
    assert {schedule for _, schedule in entries} == SCHEDULES
    return entries


def test_sprinkler_is_exact_on_its_junction_tree_alone(done):
    found = done[1]["sprinkler"]
    exact = found["junction_tree"]
    assert exact["marginals"]["rain"] == pytest.approx([0.2921, 0.7079], abs=5e-5)
    assert exact["log_evidence"] == pytest.approx(np.log(0.6471), abs=1e-12)
    assert exact["log_evidence_kind"] == "exact"
    assert exact["error"] == 0.0
    assert exact["check"] < 1e-12
    entries = loopy(found)
    assert {graph for graph, _ in entries} == {"bethe", "ltrip"}
    for numbers in entries.values():
        assert numbers["converged"]
        # Both graphs have the fixed point of loopy propagation that factors of this size have.
        assert numbers["marginals"]["rain"][1] == pytest.approx(0.78407, abs=1e-5)
        assert numbers["error"] == pytest.approx(0.78407 - 0.70793, abs=2e-5)
        assert numbers["log_evidence_kind"] == "bethe"
        assert abs(numbers["log_evidence"] - exact["log_evidence"]) > 0.1


def test_on_a_four_cycle_means_are_exact_and_marginals_are_not(done):
    spins, places = (done[1]["four_cycle"][kind] for kind in ("discrete", "gaussian"))
    assert max(spins["junction_tree"]["check"], places["junction_tree"]["check"]) < 1e-12
    for numbers in loopy(spins).values():
        assert numbers["converged"]
        assert 0.05 < numbers["error"] < 0.2
    for numbers in loopy(places).values():
        assert numbers["converged"]
        assert numbers["mean_error"] < 1e-9
        assert numbers["std_ratio_max"] < 0.99


def test_localisation_finds_the_most_probable_place_on_every_graph(done):
    found = done[1]["localisation"]
    tree = found["junction_tree"]
    assert tree["check"] < 1e-5
    assert tree["converged"]
    assert tree["log_evidence_kind"] == "laplace"
    entries = loopy(found)
    assert {graph for graph, _ in entries} == {"bethe", "ltrip", "carrying_1", "carrying_2"}
    for (graph, _), numbers in entries.items():
        assert numbers["converged"]
        assert numbers["mean_error"] < 1e-6
        # Of four poses the first and the last see the landmark that is carried: no loop is left.
        if not graph.startswith("carrying"):
            assert numbers["std_ratio_min"] < 0.98
            assert numbers["log_evidence_kind"] == "bethe"
        else:
            assert numbers["std_ratio_min"] == pytest.approx(1.0, abs=1e-6)
            assert numbers["log_evidence"] == pytest.approx(tree["log_evidence"], abs=1e-6)
            assert numbers["log_evidence_kind"] == "laplace"


def test_the_more_landmarks_are_carried_the_less_deviations_are_off(robot):
    found = {
        graph: robot.errors(robot.send(graph, pgm.Sequential()))
        for graph in ("bethe", "carrying_1", "carrying_2")
    }
    for numbers in found.values():
        assert numbers["converged"]
        assert numbers["mean_error"] < 1e-6
        assert numbers["log_evidence_kind"] == "bethe"
    least = [numbers["std_ratio_min"] for numbers in found.values()]
    assert least == sorted(least)
    assert least[0] < least[-1] < 0.97


def test_strong_coupling_ends_convergence_where_theory_says(done):
    """On a ring never; with diagonals, or sums of three, beyond a certain strength."""
    discrete, gaussian = (done[1]["coupling"][kind] for kind in ("discrete", "gaussian"))
    assert [discrete["at"], gaussian["at"]] == [
        belief_propagation.QUICK[name] for name in ("spins", "precisions")
    ]
    assert all(each["converged"] for each in discrete["ring"]["flooding"])
    for J, each in zip(discrete["at"], discrete["with diagonals"]["flooding"], strict=True):
        # Three neighbours, all of which repel each other: |J| above artanh(1/2) = 0.549.
        assert each["converged"] == (J > -0.6)
    assert all(each["converged"] for each in gaussian["sums of two"]["flooding"])
    for at, each in zip(gaussian["at"], gaussian["sums of three"]["flooding"], strict=True):
        assert each["converged"] == (at < 1.0)
    assert all(each["converged"] for each in gaussian["sums of three"]["damped"])


def test_variances_err_to_either_side_and_means_do_not(done):
    gaussian = done[1]["coupling"]["gaussian"]
    half = {"damped": pgm.Flooding(damping=0.5, iterations=cases.LIMITS["gaussian"])}
    two, three = (
        sweep(make, cases.PRECISIONS[-1:], half)["damped"][0]
        for make in (gaussian_ring, partial(gaussian_ring, span=3))
    )
    assert two["converged"]
    assert three["converged"]
    assert max(two["mean_error"], three["mean_error"]) < 1e-6
    assert two["std_ratio_max"] < 0.9
    assert three["std_ratio_min"] > 1.1
    for schedules in (gaussian["sums of two"], gaussian["sums of three"]):
        for each in (*schedules["flooding"], *schedules["damped"]):
            assert not each["converged"] or each["mean_error"] < 1e-6


def by_network(done):
    """The numbers of all ways to compile a network, kind of network by kind."""
    found = done[1]["methods"]
    assert set(found) == {"discrete", "gaussian", "repository"}
    return found


def test_ways_to_compile_differ_in_what_they_make(done):
    for networks in by_network(done).values():
        for by in networks.values():
            bethe, ltrip, exact = by["Bethe"], by["LTRIP"], by["junction tree"]
            assert ltrip["clusters"] < bethe["clusters"]
            assert ltrip["largest"] == bethe["largest"] <= exact["largest"]
            joined = [by[name] for name in by if name.startswith("join graph")]
            sizes = [numbers["largest"] for numbers in joined]
            assert sizes == sorted(sizes)
            assert all(each["converged"] == 1.0 and each["seconds"] > 0.0 for each in by.values())


@pytest.mark.parametrize("kind", ["discrete", "gaussian"])
def test_join_graphs_go_from_loopy_to_exact(done, kind):
    key = {"discrete": "error_mean", "gaussian": "variance_error_mean"}[kind]
    by = by_network(done)[kind]["grid 4×4"]
    joined = [numbers for name, numbers in by.items() if name.startswith("join graph")]
    assert joined[0][key] > 0.01
    assert joined[0]["log_evidence_error"] > 0.01
    assert joined[0]["iterations"] > 1
    assert joined[-1][key] < 1e-9
    assert joined[-1]["log_evidence_error"] < 1e-9
    assert joined[-1]["clusters"] == by["junction tree"]["clusters"]
    # Families of this grid share one variable at most: the fixed point is that of the Bethe graph.
    assert by["LTRIP"][key] == pytest.approx(by["Bethe"][key], abs=1e-7)
    assert by["LTRIP"][key] > 0.01
    if kind == "gaussian":
        assert max(numbers["mean_error_max"] for numbers in by.values()) < 1e-7


def test_averages_are_of_all_draws_and_maxima_the_largest():
    draws = [
        {"a": {"error_mean": 0.1, "error_max": 0.3, "largest": 8, "converged": True}},
        {"a": {"error_mean": 0.3, "error_max": 0.2, "largest": 4, "converged": False}},
    ]
    due = {"error_mean": 0.2, "error_max": 0.3, "largest": 8, "converged": 0.5}
    assert averaged(draws)["a"] == pytest.approx(due)


def test_errors_are_those_of_enumeration():
    """Of marginals and log-evidence, on a grid of nine variables."""
    rng = np.random.default_rng(3)
    network = tables(grid(3, rng), rng)
    evidence = observe(network, leaves(network), 1, 0)
    posterior = pgm.infer(
        pgm.compile(network, method=pgm.LTRIP()), evidence, schedule=pgm.Sequential()
    )
    marginals, log_evidence = enumerate_states(network, evidence)
    errors = [np.abs(posterior[v].probabilities - due).max() for v, due in marginals.items()]
    numbers = compare(network, evidence)["LTRIP"]
    assert numbers["error_mean"] == pytest.approx(np.mean(errors), abs=1e-9)
    assert numbers["error_max"] == pytest.approx(np.max(errors), abs=1e-9)
    assert numbers["error_max"] > 1e-3
    off = abs(float(posterior.log_evidence) - log_evidence)
    assert numbers["log_evidence_error"] == pytest.approx(off, abs=1e-9)


def test_known_networks_that_are_not_installed_are_left_out_with_a_note(tmp_path, monkeypatch):
    monkeypatch.setattr("experiments.belief_propagation.repository.find_spec", lambda name: None)
    record = Record("belief_propagation", tmp_path)
    found = compare_methods(record, ["asia", "alarm"], seed=0, side=3, count=6, draws=1)
    summary = json.loads(record.summary().read_text())
    assert found["repository"] == {}
    notes = [part["note"] for part in summary["page"] if "note" in part]
    assert any(note.startswith("left out") and note.endswith("asia, alarm") for note in notes)
    assert not any("known networks" in part.get("table", "") for part in summary["page"])


def test_asia_of_the_repository(done):
    """Where pgmpy is installed; its loop is one of four families."""
    pytest.importorskip("pgmpy")
    by = by_network(done)["repository"]["asia"]
    assert by["junction tree"]["clusters"] == 6
    assert by["LTRIP"]["clusters"] == by["LTRIP"]["sepsets"] == 6
    assert by["Bethe"]["clusters"] == 11


def test_without_coupling_everything_is_exact(done):
    discrete = done[1]["coupling"]["discrete"]
    for network in ("ring", "with diagonals"):
        errors = [each["error"] for each in discrete[network]["flooding"]]
        assert errors[discrete["at"].index(0.0)] < 1e-12


def test_the_notes_below_the_tables_say_of_which_kind_the_evidence_is(done):
    notes = [part["note"] for part in done[1]["page"] if part.get("note", "").startswith("ln p(e)")]
    assert [note.partition(";")[0] for note in notes] == [
        *["ln p(e) of the tree is exact, of the others bethe"] * 3,
        "ln p(e) of the tree is laplace, of the others bethe or laplace",
    ]


def test_the_page_says_where_messages_do_not_converge(done):
    notes = [part["note"].strip() for part in done[1]["page"] if "note" in part]
    for kind in done[1]["coupling"]:
        assert any(note.startswith(f"{kind}, Bethe, coupling") for note in notes)
    assert "with diagonals, flooding: except at -0.75" in notes
    assert "sums of three, flooding: except at 1" in notes
    assert "sums of three, damped: throughout" in notes


def test_figures_are_png_and_pdf(done):
    graphs = [f"{name}_graphs" for name in ("sprinkler", "four_cycle", "localisation")]
    for name in (*graphs, "coupling", "convergence", "localisation", "methods"):
        assert (done[0] / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (done[0] / f"{name}.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("name", ["table", "linear", "nonlinear"])
def test_the_check_would_notice_a_wrong_answer(name, robot):
    """Beliefs of a loopy graph, or without relinearisation, are not those of the check."""
    case = {"table": cases.wet_grass(), "linear": cases.places(1.0), "nonlinear": robot}[name]
    assert difference(case) < 1e-5
    wrong = (
        pgm.infer(case.exact.graph, case.evidence)
        if case.exact.log_evidence_kind == "laplace"
        else case.send("bethe", pgm.Flooding())
    )
    off = type(case)(case.evidence, wrong, case.graphs)
    assert difference(off) > 1e-3


def test_enumeration_of_a_known_network():
    """Lauritzen and Spiegelhalter's numbers: P(xray) = 0.1103, P(smoking | xray) by Bayes' rule."""
    network = asia()
    marginals, log_evidence = enumerate_states(network, {xray: "yes"})
    assert np.exp(log_evidence) == pytest.approx(0.11029, abs=1e-6)
    either = {"yes": 1 - (1 - 0.0104) * (1 - 0.1), "no": 1 - (1 - 0.0104) * (1 - 0.01)}
    likely = {smoke: 0.5 * (0.05 + 0.93 * p) for smoke, p in either.items()}
    due = [likely[answer] / sum(likely.values()) for answer in ANSWERS]
    assert marginals[smoking] == pytest.approx(due)
    assert rain not in marginals
    assert wet not in marginals
