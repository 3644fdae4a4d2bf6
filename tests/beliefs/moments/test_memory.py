"""Long drives and large studies fit in 2 GiB."""

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
ROOT = HERE.parents[2]

PROGRAM = """
import resource
import sys
sys.path[:0] = {paths!r}
import numpy as np
from robots import LANDMARKS, SENSORS, drive_along, m, network, u, x
import pgm

T, runs = {steps}, {runs}
sight = SENSORS["range_bearing"]
rng = np.random.default_rng(0)
commands = np.column_stack([np.ones(T), 0.3 * np.sin(0.05 * np.arange(T))])
states, marks = drive_along(commands, rng)[1:], LANDMARKS[np.arange(T) % 3]
shape = runs and (runs,) or ()
evidence = {{
    u: np.broadcast_to(commands, (*shape, T, 2)) + 0.0,
    sight.z: pgm.sightings(
        sight.draw(np.broadcast_to(states, (*shape, T, 3)), marks, rng),
        step=np.arange(1, T + 1),
        given={{m: marks}},
    ),
}}
{study}
assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < 2 * 2**20, "more than 2 GiB"
"""

STUDIES = {
    "a long drive": (
        100_000,
        0,
        """
found = pgm.smooth(network(sight.cpd()), evidence, lineariser=pgm.Taylor())
assert found[x].mean.shape == (T + 1, 3) and np.isfinite(found[x].std).all()
""",
    ),
    "many simulations": (
        25,
        100_000,
        """
filtered = pgm.filter(network(sight.cpd()), evidence, lineariser=pgm.Unscented(), keep=[x])
smoothed = pgm.smooth(network(sight.cpd()), evidence, lineariser=pgm.Unscented(), keep=[x])
assert smoothed[x].mean.shape == (runs, T + 1, 3)
assert np.linalg.det(smoothed[x].cov[:, 10]).mean() < np.linalg.det(filtered[x].cov[:, 10]).mean()
assert np.array_equal(smoothed.log_evidence, filtered.log_evidence)
""",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_it_fits_in_two_gibibytes(name):
    steps, runs, study = STUDIES[name]
    program = PROGRAM.format(paths=[str(HERE), str(ROOT)], steps=steps, runs=runs, study=study)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
