"""What was written for each kind of belief is written once, and asks the family, never the kind."""

import importlib
import re

import numpy as np
import pytest

import pgm
from pgm.beliefs.own.family import BeliefFamily
from pgm.examples import pair, still, walk
from pgm.inference.families import MOMENTS, TABLES
from pgm.posteriors.online_belief import OnlineBelief
from pgm.posteriors.outcome import Outcome
from pgm.schedules import options
from tests.beliefs.own.ensemble import EnsembleKalman
from tests.beliefs.own.structure import (
    MAY_NAME,
    asked_kinds,
    classes,
    modules,
    overloads,
    said,
)

# What has steps: the one online filter, and the steps that families hand it.
STEPPING = {
    ("pgm.inference.online", "OnlineFilter"),
    ("pgm.beliefs.moments.online.moment_steps", "MomentSteps"),
    ("pgm.beliefs.moments.online.compiled", "CompiledSteps"),
    ("pgm.beliefs.markov.online", "TableSteps"),
    ("pgm.beliefs.hypotheses.online", "HypothesisSteps"),
    ("pgm.beliefs.points.filter", "PointFilter"),
}


def test_there_is_one_class_of_results():
    named = {key for key, _ in classes() if re.search("(Posterior|Results?)$", key[1])}
    # The latter is what a worker hands back of its part of the runs.
    assert named == {
        ("pgm.posteriors.posterior", "Posterior"),
        ("pgm.beliefs.moments.parts.run", "Result"),
    }
    answering = [key for key, names in classes() if {"log_evidence", "__getitem__"} <= names]
    kinds = [getattr(importlib.import_module(module), name) for module, name in answering]
    # Outcomes and the records of steps are what families make.
    assert [k for k in kinds if not issubclass(k, Outcome | OnlineBelief)] == [
        pgm.results.Posterior
    ]


def test_there_is_one_online_filter():
    assert {key for key, names in classes() if {"predict", "update"} <= names} == STEPPING


def test_there_is_one_status():
    """The other is of a search for parameters."""
    found = {key for key, names in classes() if {"iterations", "converged"} <= names}
    assert found == {("pgm.posteriors.status", "Status"), ("pgm.learning.values", "FitStatus")}


def test_nobody_asks_what_kind_a_family_is():
    outside = [m for m in modules() if not m[0].startswith("pgm.beliefs.") and m[0] not in MAY_NAME]
    found = [fault for module, source in outside for fault in asked_kinds(module, source)]
    assert not found, "\n".join(found)


def test_a_signature_stands_once():
    """But for `compile`, whose graphs differ by method, and `variables`, by how many they name."""
    found = {name for name, source in modules() if any(overloads(source))}
    assert found == {"pgm.compile.compiling", "pgm.variables"}


@pytest.mark.parametrize(
    "source",
    [
        "from pgm.beliefs.moments.family import Moments as M\nisinstance(f, M)",
        "def f():\n    from pgm.inference import Grid",
        "from pgm import Particles",
        "import pgm\ntype(f) is pgm.Grid",
        "import pgm.beliefs.grid.family",
        "from pgm.beliefs.grid import family",
        "from pgm.beliefs.grid.settings import GridSettings",
        "from pgm.inference.families import TABLES\nfamily_of(f) is TABLES",
        "from pgm.inference import families\nfamily_of(f) is families.TABLES",
        "importlib.import_module('pgm.beliefs.grid.family')",
        "f.beliefs == 'tables'",
        "'tables' in (name, f.beliefs)",
        "name == 'beliefs on a grid'",
        "type(f).__name__ == 'Grid'",
        "kind == 'Grid'",
        "match kind:\n    case 'Grid':\n        pass",
        "from pgm.beliefs.grid.outcome import GridOutcome as G\nisinstance(f, G | None)",
        "from pgm.beliefs.grid.outcome import GridOutcome\ntype(f) is GridOutcome",
        "from pgm.inference import GridFigures\nisinstance(f, (int, GridFigures))",
        "from pgm.beliefs.grid.online import GridSteps as G\nmatch f:\n    case G():\n        pass",
    ],
)
def test_the_check_finds_who_asks(source):
    assert list(asked_kinds("pgm.inference.engine", source))


@pytest.mark.parametrize(
    "source",
    [
        "from pgm.beliefs.own.family import BeliefFamily\nisinstance(f, BeliefFamily)",
        "from pgm.beliefs.grid.belief import GridBelief",
        "from pgm.posteriors.outcome import TABLES\nposterior.form == TABLES",
        "f'{f.beliefs} have none'",
        "step < len(f.beliefs)",
        "from pgm.inference.families import family_of\nfamily_of(f).infer",
    ],
)
def test_the_check_lets_the_rest_pass(source):
    assert not list(asked_kinds("pgm.inference.engine", source))


@pytest.mark.parametrize(
    "source",
    [
        "from typing import overload",
        "from typing_extensions import overload as o",
        "import typing\n@typing.overload\ndef f(): ...",
        "import typing as t\n@t.overload\ndef f(): ...",
    ],
)
def test_the_check_finds_overloads(source):
    assert list(overloads(source))


# ---- refusals of options


class Bare(pgm.Smoothing):
    """A schedule of a user's own, which takes none of the options that others take."""

    takes = frozenset()


FAMILIES = (MOMENTS, TABLES, pgm.Grid({"x": (0.0, 1.0, 2)}), pgm.Particles(2), EnsembleKalman(2))
SCHEDULES = (pgm.Filtering(), pgm.FixedLag(1), pgm.Smoothing(), pgm.Flooding(), Bare())
PARTIES = {
    **{type(p).__name__: p for p in (options.OVER_TIME, options.BALANCED, options.STATIC)},
    "Paths": options.PATHS,
    **{type(schedule).__name__: options.Scheduled(schedule) for schedule in SCHEDULES},
    **{type(family).__name__: family for family in FAMILIES},
}
# Of calls, their schedules, and online filters.
OPTIONS = {*options.Call._fields, *options.OF_SCHEDULES, *options._ONLINE, "method", "belief"}
OPTIONS -= {"schedule"}  # which each refuses by its name
# What refuses an option says that it is, or is not, for something; the others check its value.
SAYS = "(is|are) (not )?(only )?for|(is|are) not (taken|used)|decides|cannot|has no|have no|may not"
REFUSES = re.compile(
    rf"(?<![\w.])(({'|'.join(OPTIONS)})= ({SAYS})|(start|gate) ((is|are) (not )?for|cannot))\b"
    rf"|\{{\w*\}}= ({SAYS})\b"
)
# Of `pgm.animate`, whose options are its own.
APART = {"pgm.plot.moving.animation"}


def refusals():
    """Each party's refusal of each option that it does not take, and what `compile` refuses."""
    graph = pgm.compile(pair)
    for name, party in PARTIES.items():
        for option in sorted(OPTIONS - party.takes):
            yield name, option, str(party.refusal(option, graph))
    for model, method in ((still, None), (walk, pgm.Balanced())):
        with pytest.raises(pgm.PgmError) as told:
            pgm.compile(model, 2, method=method, compiled=True)
        yield "compile", "compiled", str(told.value)


def wordings(sources):
    """The texts of modules that refuse an option, with a pattern of what they say."""
    for module, source in sources:
        if module not in APART:
            for text in said(source):
                if REFUSES.search(text):
                    parts = re.split(r"\{[^{}]*\}", text)
                    yield module, re.compile(".*".join(map(re.escape, parts)), re.DOTALL)


def unsaid(sources):
    """The texts that refuse an option and that no party says: second refusals, or dead ones."""
    said_so = [text for *_, text in refusals()]
    for module, pattern in wordings(sources):
        if not any(pattern.fullmatch(text) for text in said_so):
            yield module, pattern.pattern


def test_no_option_is_refused_but_by_a_party():
    found = list(unsaid(modules()))
    assert not found, found


def test_one_text_words_a_refusal():
    texts = list(wordings(modules()))
    for party, option, text in refusals():
        sources = [pattern.pattern for _, pattern in texts if pattern.fullmatch(text)]
        assert len(sources) <= 1, (party, option, sources)


def test_families_refuse_in_one_way():
    """By `BeliefFamily.refusal`; tables have words of their own for some options."""
    own = {type(f).__name__ for f in FAMILIES if type(f).refusal is not BeliefFamily.refusal}
    assert own == {"Tables"}


@pytest.mark.parametrize(
    "text",
    [
        "gate= cannot be used with {x}",
        "gate= is not for grids",
        "memory= is for trees",
        "a gate cannot be used on a grid",
        "{option}= is not for {x} at all",
        # Worded as a party words it, and again.
        "gate= is for dynamic networks alone",
    ],
)
def test_the_check_finds_second_refusals(text):
    assert list(unsaid([("pgm.inference.engine", f"raise GraphError(f{text!r})")]))


@pytest.mark.parametrize(
    "text", ["memory= is a number of bytes, not {x}", "gate= maps sensors to probabilities"]
)
def test_the_check_lets_values_be_refused(text):
    assert not list(unsaid([("pgm.inference.engine", f"raise GraphError(f{text!r})")]))


# ---- parties are asked


LOOPS = pgm.compile(pgm.examples.rainy, method=pgm.Bethe())
TREE = pgm.compile(walk, 1, method=pgm.Balanced())
SEEN = {pgm.examples.z: [[4.0]]}
AT = {pgm.examples.x: np.zeros((2, 1))}


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (
            lambda: pgm.infer(LOOPS, {}, schedule=pgm.Flooding(), memory=2**20),
            pgm.GraphError,
            r"memory= .* Flooding lets all runs go round ClusterGraph.* fewer runs to a call",
        ),
        (
            lambda: pgm.infer(LOOPS, {}, schedule=pgm.Residual(), impossible="allow"),
            pgm.GraphError,
            r"impossible= is for two passes over a tree.* Residual sends them on ClusterGraph",
        ),
        (
            lambda: pgm.infer(TREE, SEEN, schedule=pgm.Filtering(gate=0.9)),
            pgm.GraphError,
            r"gate= decides .* BalancedGraph.*: leave it out, or compile without pgm.Balanced",
        ),
        (
            lambda: pgm.infer(TREE, SEEN, schedule=pgm.FixedLag(0)),
            pgm.GraphError,
            r"FixedLag\(lag=0.* goes along a chain .*compile without pgm.Balanced",
        ),
        (
            lambda: pgm.infer(pgm.compile(walk, 1), SEEN, schedule=pgm.Filtering(), start=AT),
            pgm.EvidenceError,
            r"a start is for smoothing all at once, not Filtering\(.*smooth by",
        ),
        (
            lambda: pgm.infer(pgm.compile(walk, 1), SEEN, schedule=Bare(), start=AT),
            pgm.EvidenceError,
            "a start is for smoothing all at once, not Bare",
        ),
        (
            lambda: pgm.most_probable(pgm.compile(still, 1), {}, memory=2**20),
            pgm.GraphError,
            "memory= and executor= are for networks without time; .* fewer runs to a call",
        ),
        (
            lambda: pgm.most_probable(pgm.compile(still, 1, method=pgm.Balanced()), {}),
            pgm.GraphError,
            "tables go along a chain of slices, which BalancedGraph.* is not: leave method= out",
        ),
    ],
)
def test_what_has_no_use_for_an_option_refuses_it(call, error, words):
    with pytest.raises(error, match=words):
        call()
