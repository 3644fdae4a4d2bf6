"""The public names: in `dir`, in completion, to type checkers, and what importing them loads."""

import re
import rlcompleter
import subprocess
import sys
from importlib import resources
from pathlib import Path

import pytest

import pgm

ROOT = Path(__file__).parents[1]
LATER = [
    "comparison",
    "consistency",
    "maps",
    "plot",
    "results",
    "compare",
    "read_bif",
    "write_xmlbif",
]


def test_dir_lists_what_is_public_and_nothing_else():
    assert set(pgm.__all__) == {name for name in dir(pgm) if not name.startswith("__")}
    assert set(LATER) <= set(pgm.__all__)
    assert pgm.__all__ == sorted(pgm.__all__, key=lambda n: (not n.isupper(), n.islower(), n))


def test_dir_of_the_pictures_lists_them_alone():
    shown = {name for name in dir(pgm.plot) if not name.startswith("__")}
    assert shown == set(pgm.plot.__all__)


@pytest.mark.parametrize("name", pgm.__all__)
def test_every_name_is_there(name):
    assert getattr(pgm, name) is not None


@pytest.mark.parametrize(
    ("begun", "completed"),
    [
        ("pgm.plo", "pgm.plot"),
        ("pgm.consi", "pgm.consistency"),
        ("pgm.ma", "pgm.maps"),
        ("pgm.read_b", "pgm.read_bif("),
        ("pgm.plot.traj", "pgm.plot.trajectory("),
    ],
)
def test_completion_knows_what_is_loaded_later(begun, completed):
    found = rlcompleter.Completer({"pgm": pgm}).complete(begun, 0)
    assert found is not None
    assert found.startswith(completed)


def test_an_unknown_name():
    with pytest.raises(AttributeError, match="module 'pgm' has no attribute 'plto'"):
        pgm.plto  # noqa: B018  # the attribute is asked for, and that is all


SCRIPT = """\
import numpy as np
import pgm

x = pgm.Variable("x", components=("east", "north"))
belief = pgm.Gaussian(x, mean=np.zeros((5, 2)), cov=1.0)
ax = pgm.plot.trajectory(belief, confidence=0.9)
pgm.plot.trajectory(belief, confidenze=0.9)
pgm.consistency.anees(belief)
pgm.maps.OccupancyMap(np.zeros((3, 3)), resolution="wide")
pgm.compare(3, {})
pgm.read_bif(3.0)
pgm.plto
pose = {"components": ("east", "north"), "angles": ("north",)}
pgm.Variable("y", **pose)
pgm.results.Comparison.rowz
from pgm.results import Posterior
posterior: Posterior = 3
"""


def test_type_checkers_know_them(tmp_path):
    """Eight deliberate errors are found, in their lines, and no others.

    By the project's settings, so that what `make lint` has found out of the package is known.
    """
    pytest.importorskip("mypy")
    script = tmp_path / "script.py"
    script.write_text(SCRIPT, encoding="utf-8")
    run = subprocess.run(
        [sys.executable, "-m", "mypy", str(script)], cwd=ROOT, capture_output=True, text=True
    )
    found = re.findall(r"script\.py:(\d+): error: (.*)", run.stdout)
    assert [int(line) for line, _ in found] == [7, 8, 9, 10, 11, 12, 15, 17], (
        run.stdout + run.stderr
    )
    words = ["confidenze", "truth", "resolution", "compare", "read_bif", "plto"]
    words += ["rowz", "Posterior"]
    for (_, error), word in zip(found, words, strict=True):
        assert word in error


# What type checkers know of what is returned, in the script below.
TYPES = {
    "pgm.filter(walk, {}, belief=grid)[x]": "GridBelief",
    "pgm.smooth(walk, {}, belief=grid).joint(x)": "GridBelief",
    "pgm.infer(pgm.compile(walk, 3), {}, belief=cloud)[x]": "ParticleBelief",
    "pgm.filter(walk, {}, belief=cloud).filtered[x]": "ParticleBelief",
    "pgm.smooth(walk, {}, belief=own).predicted[x]": "tuple[int, str]",
    "pgm.filter(walk, {}, belief=plain)[x]": "Any",
    "pgm.filter(walk, {}, belief=chosen)": "Posterior[Any]",
    "pgm.filter(walk, {})": "Posterior[Any]",
    "pgm.infer(pgm.compile(walk, 3), {})[x]": "Any",
    "pgm.filter(walk, {}).status": "Status",
    "pgm.filter(walk, {}).filtered.kind": "Kind",
    "pgm.filter(walk, {}, belief=grid).filtered.log_evidence": "Any",
    "pgm.filter(walk, {}).kind": "Kind | None",
    "robot.initial()": "OnlineBelief",
    "robot.predict(robot.initial())": "OnlineBelief",
    "robot.update(robot.initial(), {}).status": "Status",
}
RETURNED = """\
import pgm
from pgm.examples import walk, x

class Own(pgm.BeliefFamily[tuple[int, str]]): ...
class Plain(pgm.BeliefFamily): ...

grid, cloud, own, plain = pgm.Grid({"x": (0.0, 1.0, 9)}), pgm.Particles(9, seed=0), Own(), Plain()
robot = pgm.OnlineFilter(walk, belief=grid)
def of_an_argument(chosen: pgm.BeliefFamily | None) -> None:
"""


def test_type_checkers_know_what_is_returned(tmp_path):
    """The marginals of the family that was given, and Any where the network decides."""
    pytest.importorskip("mypy")
    script = tmp_path / "script.py"
    asked = "".join(f"    reveal_type({each})\n" for each in TYPES)
    script.write_text(RETURNED + asked, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", str(script)]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    told = [re.sub(r"\b(\w+\.)+", "", each) for each in re.findall(r'type is "(.*)"', run.stdout)]
    assert dict(zip(TYPES, told, strict=True)) == TYPES, run.stdout + run.stderr
    assert run.returncode == 0, run.stdout


def test_the_package_says_that_it_is_typed():
    assert resources.files("pgm").joinpath("py.typed").is_file()


def loaded(program: str) -> set[str]:
    """The modules that a program loads, whole names."""
    code = f"{program}; import sys; print(*sys.modules)"
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return set(run.stdout.split())


def test_importing_pgm_loads_nothing_that_is_slow_to_import():
    slow = {"llvmlite", "matplotlib", "networkx", "scipy", "pandas", "xarray", "tqdm", "IPython"}
    slow |= {"typer", "rich", "yaml", "PIL", "defusedxml", "pgmpy", "gtsam", "concurrent.futures"}
    slow |= {"multiprocessing", "experiments", "models", "pgm.plot", "pgm.maps", "pgm.comparison"}
    slow |= {"pgm.results"}
    assert not slow & loaded("import pgm; dir(pgm)")


def test_what_is_asked_for_is_loaded():
    due = {"matplotlib", "pgm.plot", "pgm.io.networks"}
    assert due <= loaded("import pgm; pgm.plot; pgm.read_bif")


def test_a_notebook_draws_what_nobody_has_imported_a_plot_for():
    program = """\
import sys, pgm
a, b = pgm.variables("a b")
net = pgm.BayesianNetwork([pgm.GaussianCPD(a, 0, 1), pgm.LinearGaussianCPD(b, {a: 1}, cov=1)])
assert "pgm.plot" not in sys.modules and "pgm.viewer" not in sys.modules
assert "<svg" in net._repr_html_()
assert "<iframe" in pgm.infer(pgm.compile(net), {b: 0.5})._repr_html_()"""
    assert {"pgm.plot.diagrams.notebook", "pgm.viewer"} <= loaded(program)
