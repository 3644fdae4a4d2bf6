"""The check on a card, without one, and with a fake one."""

import pytest

from benchmarks import gpu_check
from tests import card
from tests.fake_driver import Driver, install

card.needs_libdevice()


@pytest.fixture
def no_study(monkeypatch):
    """The check without its study, which takes long without a card."""
    asked = []
    monkeypatch.setattr(gpu_check, "study", lambda *given: not asked.append(given))
    return asked


@pytest.fixture(autouse=True)
def forgotten():
    """No card of one test is that of another."""
    card.forget()
    yield
    card.forget()


@pytest.mark.parametrize(
    ("driver", "words"),
    [(None, "pip install 'sepset[gpu]'"), (Driver(cards=0), "this machine has no card")],
)
def test_without_a_card_it_says_so_and_stops(driver, words, monkeypatch, capsys):
    install(monkeypatch, driver)
    assert gpu_check.main([]) == 0
    told = capsys.readouterr().out
    assert told.startswith("no card: ")
    assert words in told
    assert len(told.splitlines()) == 1


def test_with_a_card_answers_and_times_are_told(no_study, monkeypatch, capsys):
    driver = install(monkeypatch, Driver())
    monkeypatch.setattr(gpu_check, "DUE", 1e9)
    assert gpu_check.main(["--models", "4", "--runs", "3", "--steps", "4"]) == 0
    told = capsys.readouterr().out
    assert "an interpreter, compute capability 8.0" in told
    assert "4 drawn models: at most" in told
    assert "3 robots over 4 steps:" in told
    assert len(driver.launched) > 7
    assert no_study == [(3, 4)]


def test_answers_that_differ_are_told(no_study, monkeypatch, capsys):
    install(monkeypatch, Driver())
    monkeypatch.setattr(gpu_check, "AGREES", -1.0)
    monkeypatch.setattr(gpu_check, "DUE", 1e9)
    assert gpu_check.main(["--models", "1", "--runs", "1", "--steps", "2"]) == 1
    assert "model 0, " in capsys.readouterr().out


@pytest.mark.slow
def test_a_study_is_compared_and_timed(monkeypatch, capsys):
    install(monkeypatch, Driver())
    assert gpu_check.study(3, 4)
    told = capsys.readouterr().out
    assert "a study's figures of 3 runs: at most" in told
    assert "a study of 3 robots over 4 steps by EKF and RTS: " in told
    assert "drawn, swept and summed on a card: EKF, RTS" in told


@pytest.mark.slow
def test_figures_of_studies_that_differ_are_told(monkeypatch, capsys):
    install(monkeypatch, Driver())
    monkeypatch.setattr(gpu_check, "ALIKE", -1.0)
    assert not gpu_check.study(2, 1)
    assert "a study's figures of 2 runs: " in capsys.readouterr().out


def test_a_sweep_that_is_slow_is_told(no_study, monkeypatch):
    install(monkeypatch, Driver())
    monkeypatch.setattr(gpu_check, "DUE", 0.0)
    assert gpu_check.main(["--models", "1", "--runs", "1", "--steps", "2"]) == 1
