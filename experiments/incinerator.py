"""The waste incinerator of Lauritzen's paper: its published figures, and ours.

In summary.json ``before`` and ``after`` have by variable ``mean`` and ``std``, each a list of the
published figure and ours, and ``states`` those of the probabilities after the evidence.
"""

from __future__ import annotations

from typing import Any

import pgm
from experiments.record import Out, Record
from models import mixed

QUICK: dict[str, Any] = {}
# Lauritzen (1992), section 5: means and deviations before and after the evidence.
BEFORE = {
    mixed.efficiency: (-3.25, 0.709),
    mixed.dust: (3.04, 0.770),
    mixed.dioxide: (-1.85, 0.507),
    mixed.light: (1.48, 0.631),
    mixed.metals_in: (-0.214, 0.459),
    mixed.metals_out: (2.83, 0.860),
}
AFTER = {
    mixed.efficiency: (-3.90, 0.076),
    mixed.dust: (3.61, 0.326),
    mixed.metals_in: (0.50, 0.100),
    mixed.metals_out: (4.11, 0.344),
}
STATES = {mixed.burning: 0.0123, mixed.filter_state: 0.9995}
SEEN = {mixed.waste: "industrial", mixed.light: 1.1, mixed.dioxide: -0.9}


def run(out: Out = None) -> None:
    """A network of discrete and continuous variables finds the figures of its paper."""
    record = Record("incinerator", out)
    graph = pgm.compile(mixed.incinerator())
    before, after = pgm.infer(graph, {}), pgm.infer(graph, SEEN)
    told: dict[str, Any] = {}
    for name, posterior, published in (("before", before, BEFORE), ("after", after, AFTER)):
        told[name] = {
            variable.name: {
                "mean": [mean, float(posterior[variable].mean[0])],
                "std": [std, float(posterior[variable].std[0])],
            }
            for variable, (mean, std) in published.items()
        }
        record.table(
            "Before any evidence" if name == "before" else "Given industrial waste, light, dioxide",
            ("variable", "mean, published", "mean", "std, published", "std"),
            [(key, *each["mean"], *each["std"]) for key, each in told[name].items()],
            about="Means and standard deviations, exact; the published ones have three digits.",
        )
    told["states"] = {
        variable.name: [chance, float(after[variable].probabilities[0])]
        for variable, chance in STATES.items()
    }
    record.table(
        "Probabilities given the same",
        ("state", "published", "found"),
        [
            (f"{variable.name} {variable.states[0]}", *told["states"][variable.name])
            for variable in STATES
        ],
    )
    record.summary(**told)
