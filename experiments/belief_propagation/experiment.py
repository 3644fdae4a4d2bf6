"""Exact inference against loopy: Sprinkler, a four-cycle, and a robot among unknown landmarks.

Where messages converge, Gaussian means are exact and deviations are not, too small or too large;
marginals of discrete variables are approximate. Where coupling is strong they need not converge;
damping helps, up to a point. Join graphs go from loopy to exact as their clusters may grow.

summary.json:

- ``sprinkler``, ``four_cycle.discrete``, ``four_cycle.gaussian``, ``localisation``: each has
  ``junction_tree`` and, by graph and schedule, ``<graph>.<schedule>``. Graphs are ``bethe``,
  ``ltrip`` and, by hand, ``carrying_1`` and ``carrying_2``, after the number of landmarks that the
  chain of poses carries along. Schedules are ``flooding``, ``sequential`` and ``residual``.
- Each entry has ``log_evidence``, ``log_evidence_kind``, ``iterations`` and ``converged``; of a
  discrete network ``error``, the largest of a probability, and ``marginals``; of a Gaussian one
  ``mean_error``, the largest in exact standard deviations, and ``std_ratio_min`` and
  ``std_ratio_max``, of deviations to the exact ones.
- ``junction_tree.check``: how far it is from an independent answer: enumeration, the dense joint,
  or (of means, in deviations) SciPy's least squares.
- ``coupling``: ``discrete`` and ``gaussian`` have ``at``, the strengths, and by network and
  schedule a list of entries, one a strength.
- ``methods``: ``discrete`` and ``gaussian``, networks drawn at random, and ``repository``, known
  ones, have by network and method of compiling: ``clusters``, ``sepsets``, ``largest`` (entries or
  components), ``log_evidence_error``, ``iterations``, ``converged``, ``seconds``, and
  ``error_mean`` and ``error_max`` of marginals, or ``mean_error_max`` (in deviations),
  ``variance_error_mean`` and ``variance_error_max`` (relative); all but maxima are means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

import pgm
from experiments.belief_propagation import cases, figures
from experiments.belief_propagation.checks import difference
from experiments.belief_propagation.comparison import compare_methods
from experiments.belief_propagation.loops import Case, Numbers, titled
from experiments.belief_propagation.repository import NAMES, require_stored
from experiments.record import Out, Record, Seed

By = dict[str, dict[str, pgm.results.Posterior]]  # graph and schedule

# Precision of sums of three, of which undamped messages diverge.
_DIVERGING = 2.0
# On either side of the strength from which messages do not converge; of spins 0 and the greatest.
QUICK: dict[str, Any] = {
    "steps": 3,
    "spins": [-0.75, -0.5, 0.0, 1.5],
    "precisions": [0.5, 1.0],
    "side": 4,
    "count": 8,
    "draws": 1,
    "known": ["asia"],
}


def run(
    out: Out = None,
    seed: Seed = 0,
    coupling: Annotated[float, typer.Option(min=0.01, help="Strength of the four-cycle.")] = 1.0,
    steps: Annotated[int, typer.Option(min=3, help="Steps of the robot.")] = 5,
    spins: Annotated[
        list[float] | None,
        typer.Option("--spin", help="A coupling of spins to try; 13 from -1.5 to 1.5 without."),
    ] = None,
    precisions: Annotated[
        list[float] | None,
        typer.Option(
            "--precision",
            min=0.01,
            help="A precision of readings of places to try; 6 from 1/8 to 4 without.",
        ),
    ] = None,
    side: Annotated[int, typer.Option(min=3, help="Rows and columns of grids.")] = 8,
    count: Annotated[int, typer.Option(min=6, help="Variables of random networks.")] = 40,
    draws: Annotated[int, typer.Option(min=1, help="Grids and random networks of a kind.")] = 3,
    known: Annotated[
        list[str] | None,
        typer.Option(help="A known network, of pgmpy's files; fourteen without."),
    ] = None,
) -> None:
    """Exact against loopy: marginals, means, deviations, and where messages converge."""
    at = {
        "discrete": sorted(spins or cases.SPINS),
        "gaussian": sorted(precisions or cases.PRECISIONS),
    }
    drawn = {"seed": seed, "side": side, "count": count, "draws": draws}
    require_stored(known or ())
    names = known or NAMES
    record = Record(
        "belief_propagation",
        out,
        coupling=coupling,
        steps=steps,
        strengths=at,
        known=names,
        **drawn,
    )
    robot, truth = cases.robot(seed, steps)
    compared = {
        "sprinkler": cases.wet_grass(),
        "spins": cases.spins(coupling),
        "places": cases.places(coupling),
        "localisation": robot,
    }
    titles = {
        "sprinkler": "Sprinkler, wet = yes",
        "spins": f"four spins in a ring, coupling {coupling:g}",
        "places": f"four places in a ring, readings of precision {coupling:g}",
        "localisation": f"{steps + 1} poses, {len(cases.GUESSES)} unknown landmarks, Taylor",
    }
    posteriors = {name: case.posteriors() for name, case in compared.items()}
    found = {name: summarise(case, posteriors[name]) for name, case in compared.items()}
    for name, title in titles.items():
        _table(record, title, found[name])
    swept = {
        "discrete": cases.discrete_sweep(at["discrete"]),
        "gaussian": cases.gaussian_sweep(at["gaussian"]),
    }
    for kind, networks in swept.items():
        _note_convergence(record, kind, networks, at[kind])
    shown = {"sprinkler": "sprinkler", "four_cycle": "places", "localisation": "localisation"}
    for name, case in shown.items():
        caption = (
            f"{titles[case]}: the graphs on which messages go round. Ellipses are clusters with "
            "their variables, and below these what is observed; rectangles are sepsets."
        )
        record.figure(figures.graphs(compared[case]), f"{name}_graphs", caption)
    record.figure(
        figures.coupling(swept, at),
        "coupling",
        "Errors of loopy beliefs against the strength of the coupling. Left, the largest error of "
        "a probability of four spins; middle, standard deviations over the exact ones, and right, "
        "the largest error of a mean in exact deviations, of Gaussian places against the precision "
        "of their readings. Crosses: messages that did not converge. Means that converge are "
        "exact to rounding, deviations are not.",
    )
    record.figure(
        figures.convergence(_records(compared, posteriors)),
        "convergence",
        "How much messages still change (the residual, without unit), iteration by iteration, on "
        "the Bethe graphs of three networks. A line that rises diverges; damping by a half lets "
        "flooding converge where it does not by itself.",
    )
    beliefs = {"exact": robot.exact, "Bethe": posteriors["localisation"]["bethe"]["sequential"]}
    record.figure(
        figures.scene(robot, truth, beliefs),
        "localisation",
        "A robot's poses and unknown landmarks, in metres: their true places, and the 95 % "
        "ellipses of the exact beliefs and of those on the Bethe graph, whose loops make them "
        "slightly too small or too large.",
    )
    methods = compare_methods(record, names, **drawn)
    record.summary(
        sprinkler=found["sprinkler"],
        four_cycle={"discrete": found["spins"], "gaussian": found["places"]},
        localisation=found["localisation"],
        coupling={kind: {"at": at[kind], **swept[kind]} for kind in swept},
        methods=methods,
    )


def summarise(case: Case, posteriors: By) -> dict[str, Any]:
    """Numbers of the junction tree, and by graph and schedule."""
    tree = case.errors(case.exact) | {"check": difference(case)}
    loopy = {
        graph: {schedule: case.errors(posterior) for schedule, posterior in found.items()}
        for graph, found in posteriors.items()
    }
    return {"junction_tree": tree, **loopy}


def _table(record: Record, title: str, found: Mapping[str, Any]) -> None:
    tree = found["junction_tree"]
    rows: list[tuple[str, str, Numbers]] = [("junction tree", "–", tree)]
    for graph, schedules in found.items():
        if schedules is not tree:
            rows += [(titled(graph), name, each) for name, each in schedules.items()]
    columns = ("error",) if "error" in tree else ("means", "std ratio")
    record.table(
        title,
        ("graph", "schedule", *columns, "ln p(e)", "iter.", "conv."),
        [
            (
                graph,
                schedule,
                *_errors(numbers),
                f"{numbers['log_evidence']:.3f}",
                numbers["iterations"],
                "yes" if numbers["converged"] else "no",
            )
            for graph, schedule, numbers in rows
        ],
        about=_ABOUT["error" if "error" in tree else "means"],
        folded=True,
    )
    others = sorted({numbers["log_evidence_kind"] for _, _, numbers in rows[1:]})
    record.note(
        f"ln p(e) of the tree is {tree['log_evidence_kind']}, of the others {' or '.join(others)}; "
        f"the tree differs from an independent answer by {tree['check']:.1g}"
    )


_RUN = "iter.: iterations until messages rest; conv.: whether they do."
_ABOUT = {
    "error": "error: the largest of a probability in a marginal; ln p(e): the log-evidence, a "
    f"Bethe value where the graph has loops; {_RUN}",
    "means": "means: the largest error of a mean, in exact standard deviations; std ratio: a "
    "standard deviation over the exact one, least and greatest; ln p(e): the log-evidence, a Bethe "
    f"value where the graph has loops; {_RUN}",
}


def _errors(numbers: Numbers) -> tuple[str, ...]:
    """The largest error of a marginal; or of a mean, in deviations, and the deviations' ratios."""
    if "error" in numbers:
        return (f"{numbers['error']:.4f}",)
    ratios = f"{numbers['std_ratio_min']:.2f}–{numbers['std_ratio_max']:.2f}"
    return f"{numbers['mean_error']:.1e}", ratios


def _note_convergence(
    record: Record,
    kind: str,
    networks: Mapping[str, Mapping[str, list[Numbers]]],
    at: Sequence[float],
) -> None:
    """Say where messages did not converge."""
    limit = cases.LIMITS[kind]
    record.note(
        f"{kind}, Bethe, coupling {at[0]:g} to {at[-1]:g}; within {limit} iterations converges"
    )
    for network, schedules in networks.items():
        for schedule, found in schedules.items():
            lost = [f"{c:.3g}" for c, each in zip(at, found, strict=True) if not each["converged"]]
            says = f"except at {', '.join(lost)}" if lost else "throughout"
            record.note(f"  {network}, {schedule}: {says}")


def _records(
    compared: Mapping[str, Case], posteriors: Mapping[str, By]
) -> dict[str, dict[str, pgm.results.Status]]:
    """How schedules converge on the Bethe graphs of three networks."""
    hard = cases.sums_of_three(_DIVERGING)
    half = pgm.Flooding(damping=0.5)
    limited = {
        "flooding": pgm.Flooding(iterations=60),
        "sequential": pgm.Sequential(iterations=60),
        "residual": pgm.Residual(iterations=60),
    }
    found = {
        "four spins in a ring": posteriors["spins"]["bethe"],
        "sums of three places": {name: hard.send("bethe", s) for name, s in limited.items()},
        "robot; jumps are relinearisations": posteriors["localisation"]["bethe"],
    }
    damped = (compared["spins"], hard, compared["localisation"])
    return {
        title: {name: posterior.status for name, posterior in by.items()}
        | {"flooding, damped by ½": case.send("bethe", half).status}
        for (title, by), case in zip(found.items(), damped, strict=True)
    }
