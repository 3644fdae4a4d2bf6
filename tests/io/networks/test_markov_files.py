"""Markov networks in files, UAI and libDAI's, and answers to problems, published ones too."""

import io
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

import pgm

PROBLEMS = Path(__file__).parents[4] / "shared" / "data" / "uai"
FEW = ["CSP_12", "Grids_11", "Pedigree_11", "Promedus_11", "Segmentation_11"]
LARGE = ["DBN_11", "ObjectDetection_11"]


@st.composite
def networks(draw):
    """Markov networks with zeros, numbers of all magnitudes and repeated scopes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    variables = [pgm.Discrete(str(k), int(rng.integers(1, 4))) for k in range(rng.integers(1, 6))]
    factors = [pgm.Table(variables, rng.random([v.size for v in variables]))]
    for _ in range(rng.integers(0, 5)):
        scope = [variables[k] for k in rng.permutation(len(variables))[: rng.integers(0, 4)]]
        shape = [v.size for v in scope]
        values = 10.0 ** rng.uniform(-30, 30, shape) * (rng.random(shape) > 0.2)
        factors.append(pgm.Table(scope, values))
    return pgm.MarkovNetwork(factors)


@pytest.mark.parametrize(
    ("write", "read"), [(pgm.write_uai, pgm.read_uai), (pgm.write_fg, pgm.read_fg)]
)
@given(network=networks())
def test_what_is_written_is_read_back(write, read, network):
    file = io.StringIO()
    write(network, file)
    again = read(io.StringIO(file.getvalue()))
    assert again.variables == network.variables
    for a, b in zip(network.factors, again.factors, strict=True):
        assert a.scope == b.scope
        assert_array_equal(a.values * np.exp(a.log_scale), b.values * np.exp(b.log_scale))


def test_bayesian_networks_and_names():
    from pgm.examples import rain, rainy, wet

    file = io.StringIO()
    pgm.write_uai(rainy, file)
    again = pgm.read_uai(io.StringIO(file.getvalue()))
    assert isinstance(again, pgm.BayesianNetwork)
    assert_array_equal(again.cpds[1].table, rainy.cpds[1].table)
    posterior = pgm.infer(pgm.compile(rainy), {wet: "yes"})
    answer = io.StringIO()
    pgm.write_uai_result("MAR", posterior, rainy, answer)
    assert answer.getvalue() == "MAR\n2 2 0.25 0.75 2 0.0 1.0\n"
    best = io.StringIO()
    found = pgm.most_probable(pgm.compile(rainy), {wet: "yes"})
    pgm.write_uai_result("MAP", found, rainy, best)
    assert best.getvalue() == f"MAP\n2 {rain.index(found.assignment[rain])} 1\n"
    evidence = io.StringIO()
    pgm.write_uai_evidence({wet: "yes", rain: 0}, rainy, evidence)
    known = pgm.read_uai_evidence(io.StringIO(evidence.getvalue()), again)
    assert {v.name: state for v, state in known.items()} == {"1": 1, "0": 0}


def test_a_log_scale_is_written_as_numbers_or_refused():
    a = pgm.Discrete("0", 2)
    file = io.StringIO()
    pgm.write_uai(pgm.MarkovNetwork([pgm.Table(a, [1.0, 0.0], 5.0)]), file)
    assert_allclose(pgm.read_uai(io.StringIO(file.getvalue())).factors[0].values, [np.exp(5.0), 0])
    for scale in (800.0, -800.0):
        network = pgm.MarkovNetwork([pgm.Table(a, [1.0, 2.0], scale)])
        with pytest.raises(pgm.ModelError, match="give it another log-scale"):
            pgm.write_uai(network, io.StringIO())


def test_variables_without_a_table_and_numbers_that_are_factors():
    network = pgm.read_uai(io.StringIO("MARKOV 3  2 3 2  2  1 1  0  3 1 1 2  1 5.0"))
    assert_allclose(pgm.infer(pgm.compile(network), {}).log_evidence, np.log(4 * 5 * 2 * 2))
    assert {v.name for v in network.variables} == {"0", "1", "2"}


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("MARKOV\n1\n2\n1\n1 1\n2\n1 1", 5, "count from 0 to 0"),
        ("MARKOV\n1\n2\n1\n2 0 0\n4\n1 1 1 1", 5, "a variable twice"),
        ("MARKOV\n1\n2\n1\n1 0\n2\n1 -1", 7, "-1 is no entry"),
        ("MARKOV\n1\n2\n1\n1 0\n2\n1 inf", 7, "a number is due"),
        ("MARKOV\n1\n2\n1\n1 0\n3\n1 1 1", 6, "3 entries of the table over"),
        ("MARKOV\n0\n\n0", None, "declares no variable"),
        ("MARKOV\n1\n2\n1\n1 0\n2\n1 1 5", 7, "1 numbers follow"),
        ("MARKOV\n1\n2\n1\n1 0\n2\n1\n2.1e-308", 8, "'2.1e-308' is too small"),
        (f"MARKOV\n1\n2\n1\n1 0\n2\n1\n0.{'0' * 350}1", 8, "is too small for a number"),
        (f"MARKOV\n61\n{'1 ' * 61}\n1\n61 {' '.join(map(str, range(61)))}\n1 1", 5, "of 0 to 60"),
    ],
)
def test_errors_of_markov_files_name_the_line(text, line, words):
    with pytest.raises(pgm.FileError, match=words) as error:
        pgm.read_uai(io.StringIO(text))
    assert error.value.line == line


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("1\n\n2\n0 0\n2 2\n0", 3, "a variable twice"),
        ("1\n\n1\n0\n0\n0", 3, "has no states"),
        ("2\n\n1\n0\n2\n0\n\n1\n0\n3\n0", 8, "has 3 states here, and 2 before"),
        ("1\n\n1\n0\n2\n1\n2 1.0", 7, "a place 2 of 2 entries"),
        ("1\n\n1\n0\n2\n2\n1 2\n1 3", 8, "the place 1 is given twice"),
        ("1\n\n1\n0\n2\n1\n1 -1.0", 7, "-1 is no entry"),
        ("1\n\n1\n0\n2\n2\n1 1.0", 7, "the file ends"),
        ("1\n\n9\n0 1 2 3 4 5 6 7 8\n99 99 99 99 99 99 99 99 99\n0", 3, "raise the limit"),
        ("0", None, "it has no variable"),
    ],
)
def test_errors_of_factor_graphs_name_the_line(text, line, words):
    with pytest.raises(pgm.FileError, match=words) as error:
        pgm.read_fg(io.StringIO(text))
    assert error.value.line == line


def test_refusals_of_writers():
    from pgm.examples import coin, pair, side

    posterior = pgm.infer(pgm.compile(coin), {side: [0, 1]})
    with pytest.raises(pgm.ModelError, match="a network of tables, not"):
        pgm.write_uai(pair, io.StringIO())
    with pytest.raises(pgm.ModelError, match="one of PR, MAR, MAP, MMAP, not 'SUM'"):
        pgm.write_uai_result("SUM", posterior, coin, io.StringIO())
    with pytest.raises(pgm.ModelError, match=r"is of the runs \(2,\)"):
        pgm.write_uai_result("PR", posterior, coin, io.StringIO())
    with pytest.raises(pgm.EvidenceError, match="has one state, by name or index, not 'edge'"):
        pgm.write_uai_evidence({side: "edge"}, coin, io.StringIO())
    with pytest.raises(pgm.EvidenceError, match="is not in the network"):
        pgm.write_uai_evidence({pgm.Discrete("other", 2): 0}, coin, io.StringIO())


def test_questions():
    """The variables that a marginal MAP asks for; an answer of some is none of all."""
    net = pgm.read_uai(io.StringIO("MARKOV 3  2 2 2  2  2 0 1  2 1 2  4 3 1 1 3  4 1 2 2 1"))
    asked = pgm.read_uai_query(io.StringIO("2  2 0"), net)
    assert [v.name for v in asked] == ["2", "0"]
    found = pgm.most_probable(pgm.compile(net), {}, variables=asked)
    answer = io.StringIO()
    pgm.write_uai_result("MMAP", found, net, answer)
    task, count, *states = answer.getvalue().split()
    assert (task, count) == ("MMAP", "2")
    assert states[0] != states[1]  # 3 · 2 + 1 · 1 of 7, where equal states have 3 + 2
    with pytest.raises(pgm.ModelError, match=r"of 2 of 3 variables, without \(1\); .* 'MMAP'"):
        pgm.write_uai_result("MAP", found, net, io.StringIO())
    for text, line, words in (
        ("2\n0", 1, "1 numbers follow where 2 are due"),
        ("1\n3", 2, "has no variable 3; is it that of read_uai"),
        ("2\n0 0", 2, "0 is asked for twice"),
    ):
        with pytest.raises(pgm.FileError, match=words) as error:
            pgm.read_uai_query(io.StringIO(text), net)
        assert error.value.line == line
    with pytest.raises(pgm.ModelError, match="read_uai_query takes a network of tables, not None"):
        pgm.read_uai_query(io.StringIO("0"), None)


def test_evidence_by_place():
    """A network whose labels are not 0, 1, ... has its variables by place, there and back."""
    net = pgm.read_fg(io.StringIO("1  2  1 2  2 2  4  0 2.0  1 1.0 2 1.0  3 2.0"))
    second = net.variables[1]
    file = io.StringIO()
    pgm.write_uai_evidence({second: 1}, net, file)
    assert pgm.read_uai_evidence(io.StringIO(file.getvalue()), net) == {second: 1}


def test_answers_of_other_kinds():
    from pgm.examples import coin, rainy, wet

    graph = pgm.compile(rainy)
    posterior, best = pgm.infer(graph, {wet: "yes"}), pgm.most_probable(graph, {})
    for task, answer in (("PR", best), ("MAR", 3), ("MAP", posterior), ("MMAP", None)):
        with pytest.raises(pgm.ModelError, match=f"the answer to '{task}' is that of pgm"):
            pgm.write_uai_result(task, answer, rainy, io.StringIO())
    small = pgm.read_uai(io.StringIO("MARKOV 1  2  1  1 0  2 1 3"))
    large = pgm.read_uai(io.StringIO("MARKOV 2  2 2  2  1 0  1 1  2 1 3  2 1 1"))
    with pytest.raises(pgm.ModelError, match="the network has 2 variables, and that of the an"):
        pgm.write_uai_result("PR", pgm.infer(pgm.compile(small), {}), large, io.StringIO())
    from pgm.examples import still

    over = pgm.smooth(still, {wet: [1, 1]})
    with pytest.raises(pgm.ModelError, match=r"the answer to 'MAR' is that of pgm\.infer"):
        pgm.write_uai_result("MAR", over, rainy, io.StringIO())
    with pytest.raises(pgm.ModelError, match="the answer has rain, and the network has not"):
        pgm.write_uai_result("MAR", posterior, coin, io.StringIO())
    with pytest.raises(pgm.EvidenceError, match="evidence maps variables to states"):
        pgm.write_uai_evidence([(wet, 1)], rainy, io.StringIO())


def test_numbers_below_the_smallest_are_refused():
    for text in ("0e-400", "0.0e-999", "2.3e-308", "1e-0300", f"0.{'0' * 400}"):
        network = pgm.read_uai(io.StringIO(f"MARKOV 1  2  1  1 0  2 1 {text}"))
        assert network.factors[0].values[1] == float(text)
    with pytest.raises(pgm.FileError, match="'1e-400' is too small"):
        pgm.read_fg(io.StringIO("1  1  0  2  2  0 1.0  1 1e-400"))
    own = pgm.Discrete("own", 2)
    net = pgm.MarkovNetwork([pgm.Table(own, [1.0, 1.4], -743.9)])
    with pytest.raises(pgm.ModelError, match="that are no numbers of float64"):
        pgm.write_uai(net, io.StringIO())


def numbers(path):
    """The numbers of an answer, whose task may be named before them."""
    words = path.read_text().split()
    return list(map(float, words[1:] if words[0].isalpha() else words))


@pytest.mark.skipif(not PROBLEMS.exists(), reason="no shared/data/uai here")
@pytest.mark.parametrize("name", [*FEW, *(pytest.param(n, marks=pytest.mark.slow) for n in LARGE)])
def test_published_answers(name):
    """PR to the printed digits, MAR to the rounding, and a MAP at least as likely."""
    path = PROBLEMS / f"{name}.uai"
    beside = {task: Path(f"{path}.{task}") for task in ("PR", "MAR", "MAP", "evid")}
    network = pgm.read_uai(path)
    evidence = pgm.read_uai_evidence(os.fspath(beside["evid"]), network)
    graph = pgm.compile(network)
    posterior = pgm.infer(graph, evidence)
    answer = io.StringIO()
    pgm.write_uai_result("PR", posterior, network, answer)
    (due,) = numbers(beside["PR"])
    assert f"{float(answer.getvalue().split()[1]):.6g}" == f"{due:.6g}"
    answer = io.StringIO()
    pgm.write_uai_result("MAR", posterior, network, answer)
    found = np.array(answer.getvalue().split()[1:], dtype=float)
    assert_allclose(found, numbers(beside["MAR"]), atol=6e-7)
    published = list(map(int, numbers(beside["MAP"])))[1:]
    level = sum(
        float(f.log_values[tuple(published[int(v.name)] for v in f.scope)]) for f in network.factors
    )
    assert pgm.most_probable(graph, evidence).log_probability >= level - 1e-9


@pytest.mark.skipif(not PROBLEMS.exists(), reason="no shared/data/uai here")
@pytest.mark.parametrize(
    ("name", "count"),
    [("Segmentation_11", 20), pytest.param("ObjectDetection_11", 1, marks=pytest.mark.slow)],
)
def test_published_questions(name, count):
    """Marginal MAPs, summed in no table: none of another state is better, nor the MAP's states."""
    network = pgm.read_uai(PROBLEMS / f"{name}.uai")
    asked = pgm.read_uai_query(PROBLEMS / f"{name}.uai.query", network)
    graph = pgm.compile(network)
    found = pgm.most_probable(graph, {}, variables=asked)
    assert found.exact
    best = np.array([v.index(found.states(v)) for v in asked])
    every = pgm.most_probable(graph, {})
    states = [[v.index(every.states(v)) for v in asked]]
    for k, v in enumerate(asked[:count]):
        for state in set(range(v.size)) - {int(best[k])}:
            states.append([*best[:k], state, *best[k + 1 :]])
    runs = dict(zip(asked, np.array(states).T, strict=True))
    others = pgm.infer(graph, runs, impossible="allow").log_evidence
    assert (others <= found.log_probability + 1e-9).all()
