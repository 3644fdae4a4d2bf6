"""Noise learnt by each lineariser: shares of the truth, and what the search gains."""

import pytest

import pgm
from experiments.learning.experiment import figure, learnt
from experiments.learning.problems import START, problems


@pytest.mark.parametrize("name", ["growth", "turn"])
def test_shares_are_of_the_truth(name):
    problem = problems()[name]
    for share in problem.shares.values():
        assert share(problem.truth) == pytest.approx(1.0)
        assert share(problem.start) == pytest.approx(START)


def test_a_recording_tells_the_noise_of_its_bearings():
    problem = problems()["turn"]
    found = learnt(problem, pgm.Taylor(), runs=1, steps=60, seed=3)
    assert found["log_evidence"]["end"] > found["log_evidence"]["truth"]
    assert found["log_evidence"]["truth"] > found["log_evidence"]["start"]
    assert found["shares"]["bearing"][0] == pytest.approx(1.0, abs=0.5)  # ± 2 √(2 / 60)
    assert figure({"turn": problem, "growth": problems()["growth"]}, _all(found)).axes


def _all(found):
    rules = dict.fromkeys(("Taylor", "unscented"), found)
    return {"turn": rules, "growth": rules}
