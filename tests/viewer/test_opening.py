"""How long large pages take to open; it is printed, not asserted, since it depends on the machine.

Run with ``python -m pytest tests/viewer/test_opening.py -m slow -s``.
"""

import time
from importlib.util import find_spec
from pathlib import Path

import pytest
from viewer import posteriors

import pgm


def andes():
    found = find_spec("pgmpy")
    folders = found.submodule_search_locations if found else None
    file = Path(folders[0] if folders else "nowhere") / "utils" / "example_models" / "andes.bif.gz"
    if not file.is_file():
        pytest.skip("pgmpy's networks are not here")
    return pgm.infer(pgm.compile(pgm.read_bif(file, normalise=True)), {})


MADE = {
    "a drive of 10,000 steps": lambda: pgm.smooth(posteriors.robot(), posteriors.drive(10_000)),
    "a tree of 1,000 clusters": lambda: posteriors.branches(1_001),
    "the junction tree of andes": andes,
}


@pytest.mark.slow
@pytest.mark.parametrize("made", MADE.values(), ids=MADE)
def test_large_pages_open(made, browser, tmp_path):
    posterior = made()
    start = time.perf_counter()
    page = pgm.view(posterior, tmp_path / "page.html")
    written = time.perf_counter() - start
    assert page.stat().st_size < 5_000_000
    start = time.perf_counter()
    browser.open(page)
    opened = time.perf_counter() - start
    ready = int(browser.run("return document.body.dataset.ready"))
    size = page.stat().st_size / 1e6
    print(
        f"\n{size:.2f} MB, written in {written:.2f} s, opened in {opened:.2f} s, script {ready} ms"
    )
    assert browser.selected.startswith("cluster")
