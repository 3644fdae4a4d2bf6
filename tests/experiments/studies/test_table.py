"""Tables are those of all runs at once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg

from experiments.studies import Study, StudyError
from experiments.studies.figures import figure
from experiments.studies.quantiles import PASSES, Quantiles
from experiments.studies.table import PROBABILITIES
from tests.experiments.studies import sweeps

legible = pytest.importorskip("tests.plot.legible")
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64)


def quantiles(pieces, probabilities):
    found = Quantiles(probabilities)
    for _ in range(PASSES):
        for piece in pieces:
            found.add(piece)
        found.end_pass()
    return found.values()


@settings(max_examples=40)
@given(
    st.lists(st.lists(NUMBERS.map(lambda x: x / 4), max_size=8), min_size=1, max_size=4),
    st.lists(st.floats(0, 1), min_size=1, max_size=3),
)
def test_quantiles_are_numpys(pieces, probabilities):
    pieces = [np.array(piece, dtype=float) for piece in pieces]
    found = quantiles(pieces, probabilities)
    np.testing.assert_array_equal(found, quantiles(pieces[::-1], probabilities))
    if sum(map(len, pieces)):
        due = np.quantile(np.concatenate(pieces), probabilities)
        np.testing.assert_allclose(found, due, rtol=1e-14, atol=0.0)
    else:
        assert np.isnan(found).all()


def test_extremes_are_exact():
    values = np.array([-np.pi, 5e-324, -5e-324, 1.7e308, -1.7e308, 0.0])
    np.testing.assert_array_equal(quantiles([values], [0.0, 1.0]), [-1.7e308, 1.7e308])


@pytest.fixture(scope="module")
def studied(client, tmp_path_factory):
    study = Study(sweeps.dice, {"sides": [4, 20], "name": ["a", "b"]}, runs=1050, part_size=100)
    folder = tmp_path_factory.mktemp("dice")
    assert study.run(folder, scheduler=client, progress=False) == 44
    return study, folder


def test_a_table_is_that_of_all_runs(studied):
    study, folder = studied
    table = study.table(folder)
    assert table.parts == study.parts
    for k, setting in enumerate(study.settings):
        parts = [study.part(k, p) for p in range(11)]
        for name in ("thrown", "normal", "even"):
            values = np.concatenate([part[name] for part in parts]).astype(float)
            has = values[~np.isnan(values)]
            row = table[name][k]
            assert row.settings == setting
            assert (row.runs, row.without) == (len(has), 1050 - len(has))
            assert row.mean == pytest.approx(has.mean(), rel=1e-13)
            assert row.std == pytest.approx(has.std(ddof=1), rel=1e-12)
            assert row.error == pytest.approx(has.std(ddof=1) / np.sqrt(len(has)), rel=1e-12)
            np.testing.assert_allclose(
                list(row.quantiles.values()), np.quantile(has, PROBABILITIES), rtol=1e-14
            )
    head, *lines = str(table).splitlines()
    assert head.split()[:3] == ["sides", "name", "figure"]
    assert len(lines) == 12
    with pytest.raises(KeyError, match="no figure 'weight'; it has thrown, normal, even"):
        table["weight"]


def test_another_tool_reads_the_parts(studied):
    import pyarrow.dataset as ds

    study, folder = studied
    whole = ds.dataset(folder / "parts").to_table().to_pandas()
    assert len(whole) == 4 * 1050
    assert whole.groupby(["sides", "name"])["run"].nunique().tolist() == [1050] * 4
    mean = whole.groupby(["sides", "name"])["thrown"].mean()
    for row in study.table(folder)["thrown"]:
        assert mean[row.settings["sides"], row.settings["name"]] == pytest.approx(row.mean)


def test_a_table_of_what_is_there_says_so(studied, tmp_path):
    import shutil

    study, folder = studied
    shutil.copytree(folder, tmp_path / "some")
    for file in (tmp_path / "some" / "parts").glob("000[123]-*"):
        file.unlink()
    table = study.table(tmp_path / "some")
    assert table.parts == 11
    assert [row.runs for row in table["thrown"]] == [1050, 0, 0, 0]
    assert np.isnan(table["normal"][1].mean)
    for file in (tmp_path / "some" / "parts").glob("*.parquet"):
        file.unlink()
    with pytest.raises(StudyError, match="has no part yet"):
        study.table(tmp_path / "some")


def test_the_figure_is_legible(studied):
    study, folder = studied
    drawn = figure(study.table(folder))
    FigureCanvasAgg(drawn)  # a closed figure has none
    assert not legible.faults(drawn, whole=False)
