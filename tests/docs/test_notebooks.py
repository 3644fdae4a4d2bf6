"""The tutorials open as notebooks, and run there."""

import nbformat
import pytest
from building import notebooks, programs
from nbclient import NotebookClient

TUTORIALS = {page.stem: page for page in notebooks.TUTORIALS}


@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorials_programs_are_the_cells(name):
    made = notebooks.notebook(TUTORIALS[name])
    nbformat.validate(made)
    cells = [cell.source for cell in made.cells if cell.cell_type == "code"]
    blocks = programs.blocks(TUTORIALS[name].read_text(encoding="utf-8"))
    assert cells == [block.code.rstrip("\n") for block in blocks]
    text = "".join(cell.source for cell in made.cells if cell.cell_type == "markdown")
    assert "../images/" not in text
    assert "<details>" not in text


def test_they_are_written_with_the_recording_that_one_reads(tmp_path):
    notebooks.write(tmp_path)
    assert {path.stem for path in tmp_path.glob("*.ipynb")} == set(TUTORIALS)
    assert (tmp_path / "docs" / "log.csv").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("name", TUTORIALS)
def test_a_tutorial_runs_as_a_notebook(name, tmp_path, monkeypatch):
    notebooks.write(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(programs.ROOT))
    made = notebooks.notebook(TUTORIALS[name])
    client = NotebookClient(made, timeout=300, resources={"metadata": {"path": tmp_path}})
    client.execute()
    for cell in made.cells:
        for output in cell.get("outputs", []):
            assert "<Axes:" not in output.get("data", {}).get("text/plain", ""), cell.source
