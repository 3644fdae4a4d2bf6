"""The check on a card, without one, and with a fake one."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

import pgm
from benchmarks import gpu_check
from benchmarks.work import robots
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


@pytest.mark.parametrize("models", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_with_a_card_answers_and_times_are_told(models, no_study, monkeypatch, capsys):
    driver = install(monkeypatch, Driver())
    monkeypatch.setattr(gpu_check, "DUE", 1e9)
    assert gpu_check.main(["--models", str(models), "--runs", "2", "--steps", "2"]) == 0
    told = capsys.readouterr().out
    assert "an interpreter, compute capability 8.0" in told
    assert f"{models} drawn models: at most" in told
    assert "2 robots over 2 steps:" in told
    for how in ("run by run", "step by step"):
        assert f"2 robots over 2 steps, whose readings lie on the card {how}: a whole call" in told
    assert "JAX's filter is not timed: " in told
    assert len(driver.launched) > 7
    assert no_study == [(2, 2)]


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


def test_log_evidence_that_differs_is_told(monkeypatch, capsys):
    install(monkeypatch, Driver())
    monkeypatch.setattr(gpu_check, "SAME", -1.0)
    assert not gpu_check.resident(1, 2)
    assert "log-evidence " in capsys.readouterr().out


def test_without_jax_it_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", None)
    monkeypatch.delitem(sys.modules, "benchmarks.libraries.jax_card", raising=False)
    assert "jax is not installed (pip install" in gpu_check.beside(robots.draw(2, 3), None)


def test_where_jax_has_no_card_it_says_so(monkeypatch):
    def filtering(_):
        raise RuntimeError("Unknown backend: 'gpu' requested\nand more")

    fake = SimpleNamespace(filtering=filtering)
    monkeypatch.setitem(sys.modules, "benchmarks.libraries.jax_card", fake)
    told = gpu_check.beside(robots.draw(2, 3), None)
    assert told == "JAX's filter is not timed: Unknown backend: 'gpu' requested"


def test_jax_is_timed_where_it_has_the_card(monkeypatch):
    found = None, None, np.array([-1.0, -2.0])
    fake = SimpleNamespace(filtering=lambda _: lambda: found)
    monkeypatch.setitem(sys.modules, "benchmarks.libraries.jax_card", fake)
    told = gpu_check.beside(robots.draw(2, 3), np.array([-1.0, -2.0]))
    assert "float64) of the same: 0.00" in told
    assert told.endswith("log-evidence 0e+00 apart")


def test_jax_finds_what_pgm_finds():
    jax = pytest.importorskip("jax", reason="jax comes with the extra bench")
    from benchmarks.libraries.jax_card import filtering

    work = robots.draw(3, 20)
    means, covs, log_evidence = filtering(work, jax.devices("cpu")[0])()
    due = pgm.filter(work.network, work.evidence())
    mean, cov = due[robots.pose].mean[:, 1:], due[robots.pose].cov[:, 1:]
    np.testing.assert_allclose(np.asarray(means).swapaxes(0, 1), mean, rtol=0, atol=1e-10)
    np.testing.assert_allclose(np.asarray(covs).swapaxes(0, 1), cov, rtol=0, atol=1e-10)
    np.testing.assert_allclose(log_evidence, due.log_evidence, rtol=1e-10)
