"""The findings of the report: numbers from summaries, and headlines with the figures they name."""

import re

import pytest

from experiments.catalogue import EXPERIMENTS
from experiments.report import findings
from experiments.report.findings import FINDINGS, Finding, answer, value

SUMMARY = {"rmse": {"filter": 0.4, "smoother": 0.3}, "runs": 5, "each": [1.5, -2.5], "a 8×8": 1}


@pytest.fixture
def said(monkeypatch):
    """What a template says of the summary."""

    def say(sentence):
        monkeypatch.setitem(findings.FINDINGS, "it", Finding("Is it?", sentence))
        return answer("it", SUMMARY)

    return say


def test_a_number_is_shown_with_its_place(said):
    assert said("It is {rmse/filter:.2f} m.") == 'It is <data value="rmse/filter">0.40</data> m.'
    assert said("{each/1:.1f}") == '<data value="each/1">−2.5</data>'
    assert said("{runs} < 6") == '<data value="runs">5</data> &lt; 6'


def test_one_number_against_another(said):
    found = said("{rmse/smoother against rmse/filter:+.0%}")
    assert found.endswith(">−25%</data>")
    assert said("{rmse/filter against rmse/smoother:+.0%}").endswith(">+33%</data>")


def test_the_first_of_all_keys():
    assert value("*/smoother", SUMMARY) == 0.3


def test_a_number_that_lacks_is_an_error(said):
    with pytest.raises(KeyError, match="nees"):
        said("{nees/filter:.2f}")


def test_nothing_is_said_of_an_unknown_experiment():
    assert answer("unknown", {}) == ""


def test_every_experiment_has_a_finding():
    assert set(FINDINGS) == set(EXPERIMENTS)
    questions = [finding.question for finding in FINDINGS.values()]
    assert len(set(questions)) == len(questions)
    assert all(question.endswith("?") for question in questions)
    for finding in FINDINGS.values():
        assert finding.sentence.endswith(".")
        # A finding without a number of the run would say the same of every run.
        assert re.search(r"\{(?!settings)[^}]+\}", finding.sentence)


def test_the_headlines_come_first_and_answer_what_readers_ask():
    shown = [name for name, finding in FINDINGS.items() if finding.figure]
    assert shown == list(FINDINGS)[: len(shown)]
    assert {
        "smoothing",
        "plaza",
        "linearisers",
        "nonlinear_measurement",
        "global_localisation",
        "belief_propagation",
    } <= set(shown)
