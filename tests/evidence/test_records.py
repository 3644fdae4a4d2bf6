"""Tables of records as evidence: every form of table, of cell, and of error."""

import numpy as np
import pytest

import pgm
from models.discrete import asia, cancer, either, visit, xray

WEATHER = pgm.Discrete("weather", ("sun", "rain", "snow"))
WET = pgm.Discrete("wet", ("no", "yes"))
BOTH = (WEATHER, WET)
DUE = {WEATHER: [2, 0, -1, 1], WET: [1, -1, 0, 0]}


def same(found, due):
    assert list(found) == list(due)
    for variable, values in due.items():
        np.testing.assert_array_equal(found[variable], values)
        assert found[variable].dtype == np.intp


TEXTS = {"weather": ["snow", "sun", None, "rain"], "wet": ["yes", "", "no", "no"]}
NUMBERS = {"weather": [2, 0, -1, 1], "wet": [1, -1, 0, 0]}


def test_mappings_of_any_cells():
    same(pgm.records(TEXTS, BOTH), DUE)
    same(pgm.records(NUMBERS, BOTH), DUE)
    same(pgm.records({k: np.array(v) for k, v in NUMBERS.items()}, BOTH), DUE)
    same(pgm.records({k: np.array(v, dtype=object) for k, v in TEXTS.items()}, BOTH), DUE)
    floats = {"weather": [2.0, 0.0, np.nan, 1.0], "wet": np.float32([1, np.nan, 0, 0])}
    same(pgm.records(floats, BOTH), DUE)
    mixed = {"weather": ["snow", 0, float("nan"), np.int8(1)], "wet": ("yes", None, 0.0, "no")}
    same(pgm.records(mixed, BOTH), DUE)
    small = {"wet": np.array([1, -1, 0, 0], dtype=np.int8), "weather": np.uint8([2, 0, 0, 1])}
    same(pgm.records(small, BOTH), {WET: DUE[WET], WEATHER: [2, 0, 0, 1]})


def test_structured_arrays():
    rows = [("snow", 1), ("sun", -1), ("", 0), ("rain", 0)]
    table = np.array(rows, dtype=[("weather", "U4"), ("wet", "i1")])
    same(pgm.records(table, BOTH), DUE)
    same(pgm.records(table.view(np.recarray), BOTH), DUE)
    masked = np.ma.array(
        [("snow", 1), ("sun", 1), ("sun", 0), ("rain", 0)],
        dtype=table.dtype,
        mask=[(0, 0), (0, 1), (1, 0), (0, 0)],
    )
    same(pgm.records(masked, BOTH), DUE)


def test_frames():
    pd = pytest.importorskip("pandas")
    texts = pd.DataFrame(TEXTS, index=[7, 3, 3, 0])
    for frame in (
        texts,
        texts.astype(object),
        texts.astype({"weather": "category"}),
        texts.astype("string"),
        pd.DataFrame(NUMBERS),
        pd.DataFrame({"weather": [2, 0, None, 1], "wet": [1, None, 0, 0]}),
        pd.DataFrame({"weather": [2, 0, None, 1], "wet": [1, None, 0, 0]}).astype("Int64"),
        pd.DataFrame(TEXTS).replace({None: pd.NA}),
    ):
        same(pgm.records(frame, BOTH), DUE)
    unused = pd.Categorical(["rain", None], categories=["fog", "rain"])
    same(pgm.records({"weather": unused}, BOTH), {WEATHER: [1, -1]})
    with pytest.raises(pgm.EvidenceError, match="'fog' in record 1"):
        pgm.records({"weather": pd.Categorical(["rain", "fog"])}, BOTH)


def test_a_frame_is_whatever_has_columns():
    class Frame:
        columns = ("wet", "weather")

        def __getitem__(self, name):
            return TEXTS[name]

    same(pgm.records(Frame(), BOTH), {WET: DUE[WET], WEATHER: DUE[WEATHER]})


def test_many_states_are_looked_up():
    many = pgm.Discrete("many", [f"s{k}" for k in range(40)])
    drawn = np.random.default_rng(0).integers(40, size=500)
    table = {"many": np.array(many.states)[drawn]}
    same(pgm.records(table, [many]), {many: drawn})
    table["many"][17] = "s40"
    with pytest.raises(pgm.EvidenceError, match="'s40' in record 17"):
        pgm.records(table, [many])


def test_an_empty_text_may_be_a_state():
    for count in (1, 20):
        odd = pgm.Discrete("odd", ["", *(f"s{k}" for k in range(count))])
        same(pgm.records({"odd": np.array(["s0", ""])}, [odd]), {odd: [1, 0]})
        same(pgm.records({"odd": ["s0", "", None]}, [odd]), {odd: [1, 0, -1]})


def test_columns_chosen_and_copies_at_steps():
    table = {**TEXTS, "station": [4, 4, 4, 4]}
    same(pgm.records(table, BOTH, columns=["wet"]), {WET: DUE[WET]})
    late = WET.at(3)
    same(pgm.records({"wet[3]": TEXTS["wet"]}, [WET.at(2), late]), {late: DUE[WET]})


def test_they_are_evidence_of_a_discrete_network():
    net = asia()
    graph = pgm.compile(net)
    table = {"xray": ["yes", "no", None], "visit": [1, -1, 0]}
    found = pgm.infer(graph, pgm.records(table, net))[cancer].values
    for row, given in enumerate([{xray: "yes", visit: 1}, {xray: "no"}, {visit: 0}]):
        np.testing.assert_allclose(found[row], pgm.infer(graph, given)[cancer].values, atol=1e-12)
    assert pgm.most_probable(graph, pgm.records(table, net)).states(xray).tolist()[:2] == [
        "yes",
        "no",
    ]
    joint = pgm.query(net, (cancer, either), pgm.records(table, net))
    assert joint.values.shape == (3, 2, 2)


def test_they_are_evidence_of_a_gaussian_network():
    a, b = pgm.Variable("a"), pgm.Variable("b", components=("east", "north"))
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, given={a: [[1.0], [2.0]]}, cov=np.eye(2)),
        ]
    )
    rows = np.array([[0.5, 1.0], [-1.0, 0.0]])
    posterior = pgm.infer(pgm.compile(net), pgm.records({"b": rows}, net))
    np.testing.assert_allclose(posterior[a].mean[:, 0], rows @ [1.0, 2.0] / 6.0)
    found = pgm.records({"a": [0.5, 1]}, net)
    np.testing.assert_array_equal(found[a], [[0.5], [1.0]])
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame(rows, columns=["east", "north"])
    np.testing.assert_array_equal(pgm.records({"b": frame}, net)[b], rows)
    np.testing.assert_array_equal(pgm.records({"a": [1.0, None]}, net)[a], [[1.0], [np.nan]])
    frame.loc[1, "east"] = np.nan
    found = pgm.infer(pgm.compile(net), pgm.records({"b": frame}, net))[a]
    np.testing.assert_allclose(found.mean[:, 0], [rows[0] @ [1.0, 2.0] / 6.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(found.cov[:, 0, 0], [1.0 / 6.0, 1.0 / 5.0])
    for column, what in (
        ([1.0, np.inf], "infinity in record 1; finite numbers were due, or NaN"),
        (["x", "y"], "must be numbers"),
        (pd.Categorical([1.0, 2.0]), "must be numbers"),
        ([[1.0], [2.0, 3.0]], "must be numbers"),
        ([1j, 2.0], "must be numbers"),
        ([10**400, 2.0], "must be numbers"),
        (rows, r"column a has shape \(2, 2\); a number for each record was due"),
    ):
        with pytest.raises(pgm.EvidenceError, match=what):
            pgm.records({"a": column}, net)
    with pytest.raises(pgm.EvidenceError, match=r"column b .*put their columns together, {'b': "):
        pgm.records({"b": [1.0, 2.0]}, net)


@pytest.mark.parametrize(
    "cell",
    [
        "sunny",
        "Sun",
        3,
        -2,
        1.5,
        np.inf,
        True,
        np.True_,
        b"sun",
        ["sun"],
        object,
        10**30,
        10**400,
        "-1",
    ],
    ids=repr,
)
def test_a_cell_that_is_no_state(cell):
    for column in (["sun", None, cell, "rain"], [0, -1, cell, 1]):
        with pytest.raises(pgm.EvidenceError, match=r"column weather has .* in record 2, which"):
            pgm.records({"weather": column}, BOTH)


@pytest.mark.parametrize(
    "column",
    [
        np.array(["sun", "sunny"]),
        np.array([0, 3]),
        np.array([0.0, 0.5]),
        np.array([True, False])[::-1].repeat(1),
        np.array([b"sun", b"x"]),
    ],
    ids=lambda column: column.dtype.kind,
)
def test_an_array_with_a_cell_that_is_no_state(column):
    with pytest.raises(pgm.EvidenceError, match=r"none of the states \('sun', 'rain', 'snow'\)"):
        pgm.records({"weather": column}, BOTH)


def test_numbers_for_states_that_are_called_by_other_numbers():
    level = pgm.Discrete("level", ("1", "2", "3"))
    for column in ([1, 2], [1.0, np.nan], [2, None]):
        with pytest.raises(pgm.EvidenceError, match="the states' names are other numbers"):
            pgm.records({"level": column}, [level])
    same(pgm.records({"level": ["1", "3", ""]}, [level]), {level: [0, 2, -1]})
    same(pgm.records({"level": [np.nan, -1]}, [level]), {level: [-1, -1]})
    plain = pgm.Discrete("plain", 3)
    same(pgm.records({"plain": [2, 0]}, [plain]), {plain: [2, 0]})


@pytest.mark.parametrize(
    ("table", "what"),
    [
        ({"rainy": ["no"]}, r"columns \('rainy'\) are of no variable .*'weather', 'wet'.*columns="),
        ({WET: ["no"]}, "column wet is a variable; .* evidence as it is"),
        ({}, "the table has no columns"),
        ({"wet": []}, "no records"),
        ({"wet": ["no", "yes"], "weather": ["sun"]}, "'weather' has 1 records and column 'wet' 2"),
        ({"wet": "yes"}, "not a row of cells"),
        ({"wet": 1}, "not a row of cells"),
        ({"wet": np.array(1)}, "not a row of cells"),
        ({"wet": [[0, 1], [1, 0]]}, r"column wet has shape \(2, 2\)"),
        ({"wet": [[0, 1], [1]]}, r"column wet has \[0, 1\] in record 0"),
        ([{"wet": "yes"}], "a mapping of names to columns, .* not list"),
        (np.zeros((2, 2)), "not ndarray"),
        (np.zeros((2, 2), dtype=[("wet", int)]), r"not an array of shape \(2, 2\)"),
    ],
)
def test_tables_that_are_none(table, what):
    with pytest.raises(pgm.EvidenceError, match=what):
        pgm.records(table, BOTH)


def test_columns_that_the_table_lacks():
    with pytest.raises(pgm.EvidenceError, match=r"no column 'fog'; it has \('weather', 'wet'\)"):
        pgm.records(TEXTS, BOTH, columns=["fog"])
    with pytest.raises(pgm.EvidenceError, match=r"several names, \['wet'\]"):
        pgm.records(TEXTS, BOTH, columns="wet")
    with pytest.raises(pgm.EvidenceError, match=r"takes names, such as \['weather'\], not 3"):
        pgm.records(TEXTS, BOTH, columns=3)
    with pytest.raises(pgm.EvidenceError, match=r"no column \['wet'\]"):
        pgm.records(TEXTS, BOTH, columns=[["wet"]])
    pd = pytest.importorskip("pandas")
    twice = pd.DataFrame([["no", "yes"]], columns=["wet", "wet"])
    with pytest.raises(pgm.EvidenceError, match="two columns are called 'wet'"):
        pgm.records(twice, BOTH)


def test_variables_that_are_none():
    with pytest.raises(pgm.ModelError, match="records: the network holds variables, not 'wet'"):
        pgm.records(TEXTS, ["wet"])


def test_cells_that_are_states_once_they_are_texts():
    """Boolean and binned columns, of which fitted networks have the texts for states."""
    pandas = pytest.importorskip("pandas")
    ages = pandas.cut([5, 20, 40], [0, 10, 30, 99])
    frame = pandas.DataFrame({"age": ages, "ok": [True, False, True]})
    age = pgm.Discrete("age", tuple(map(str, ages.categories)))
    ok = pgm.Discrete("ok", ("False", "True"))
    for name in frame:
        with pytest.raises(pgm.EvidenceError, match=r"column\.astype\(str\)"):
            pgm.records(frame[[name]], (age, ok))
    found = pgm.records(frame.astype(str), (age, ok))
    assert {str(v.name): k.tolist() for v, k in found.items()} == {
        "age": [0, 1, 2],
        "ok": [1, 0, 1],
    }
    with pytest.raises(pgm.EvidenceError, match=r"has 'old' .*an empty text\)$"):
        pgm.records({"age": ["old"]}, (age,))


def test_rows_of_a_list_may_lack_components():
    place = pgm.Variable("place", components=("east", "north"))
    found = pgm.records({"place": [[1, 2], [None, 3]]}, (place,))[place]
    np.testing.assert_array_equal(found, [[1.0, 2.0], [np.nan, 3.0]])
    for rows in ([[1, 2], [3]], [[1, 2], ["a", 3]]):
        with pytest.raises(pgm.EvidenceError, match="must be numbers"):
            pgm.records({"place": rows}, (place,))


def test_components_may_have_a_column_each():
    place = pgm.Variable("place", components=("east", "north"))
    table = {"place.north": [3.0, None], "wet": ["yes", "no"], "place.east": [1.0, 2.0]}
    found = pgm.records(table, (place, WET))
    np.testing.assert_array_equal(found[place], [[1.0, 3.0], [2.0, np.nan]])
    assert found[WET].tolist() == [1, 0]
    alone = pgm.records({"place.north": [3.0]}, (place,))[place]
    np.testing.assert_array_equal(alone, [[np.nan, 3.0]])
    for more, words in (
        ({"place": [[1.0, 2.0]] * 2}, "all components, and 'place.north' one of them again"),
        ({"place.up": [1.0, 2.0]}, "'place.up'.* of no variable"),
        ({"place.east": [1.0, np.inf]}, "place.east has infinity in record 1"),
        ({"place.east": [[1.0, 2.0]] * 2}, r"place.east has shape \(2, 2\); a number for each"),
        ({"place.east": ["far", 1.0]}, "column place.east must be numbers"),
    ):
        with pytest.raises(pgm.EvidenceError, match=words):
            pgm.records(table | more, (place, WET))
    with pytest.raises(pgm.EvidenceError, match=r"\(1, 3\); .* apart, as 'place.east'"):
        pgm.records({"place": [[1.0, 2.0, 3.0]]}, (place,))


def test_a_completed_table_is_read_as_records():
    pytest.importorskip("pandas")
    place = pgm.Variable("place", components=("east", "north"))
    net = pgm.BayesianNetwork([pgm.GaussianCPD(place, [1.0, 2.0], [[2.0, 1.0], [1.0, 3.0]])])
    given = pgm.records({"place": [[4.0, None], [None, None]]}, net)
    whole = pgm.infer(pgm.compile(net), given).to_frame()
    again = pgm.records(whole, net, columns=["place.east", "place.north"])
    np.testing.assert_allclose(again[place], [[4.0, 3.5], [1.0, 2.0]])
