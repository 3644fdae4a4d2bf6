"""Networks of discrete and continuous variables without time.

Sources: Lauritzen, Propagation of probabilities, means and variances in mixed graphical association
models (1992), section 5. The numbers of groups and heights are of this project.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pgm

group = pgm.Discrete("group", states=("f", "m"))
height, weight = pgm.variables("height weight")

filter_state = pgm.Discrete("filter", states=("intact", "defect"))
waste = pgm.Discrete("waste", states=("industrial", "household"))
burning = pgm.Discrete("burning", states=("stable", "unstable"))
efficiency, dioxide, dust, light, metals_in, metals_out = pgm.variables(
    "efficiency dioxide dust light metals_in metals_out"
)


def height_and_group() -> pgm.BayesianNetwork:
    """A person's group, height [cm], and weight [kg], which depends on both."""
    return pgm.BayesianNetwork(
        [
            pgm.TableCPD(group, table=[0.5, 0.5]),
            _priors(height, group, {"f": (162.0, 40.0), "m": (176.0, 50.0)}),
            pgm.SwitchingCPD(
                weight,
                given=group,
                cases={
                    "f": pgm.LinearGaussianCPD(weight, {height: 0.8}, offset=-68.0, cov=60.0),
                    "m": pgm.LinearGaussianCPD(weight, {height: 0.9}, offset=-78.0, cov=80.0),
                },
            ),
        ]
    )


def incinerator() -> pgm.BayesianNetwork:
    """The emission of heavy metals from a waste incinerator; continuous numbers are logarithms.

    The filter's state, the waste burnt and how it burns are discrete. What the filter lets through
    (`efficiency`), carbon `dioxide`, `dust`, how `light` penetrates the smoke, and the heavy metals
    in the waste (`metals_in`) and in the emission (`metals_out`) are continuous.
    """
    passed = {
        ("intact", "industrial"): (-3.9, 2e-5),
        ("defect", "industrial"): (-0.4, 1e-4),
        ("intact", "household"): (-3.2, 2e-5),
        ("defect", "household"): (-0.5, 1e-4),
    }
    emitted = {
        ("stable", "industrial"): (6.5, 0.03),
        ("unstable", "industrial"): (7.5, 0.1),
        ("stable", "household"): (6.0, 0.04),
        ("unstable", "household"): (7.0, 0.1),
    }
    return pgm.BayesianNetwork(
        [
            pgm.TableCPD(filter_state, table=[0.95, 0.05]),
            pgm.TableCPD(waste, table=[2 / 7, 5 / 7]),
            pgm.TableCPD(burning, table=[0.85, 0.15]),
            _priors(efficiency, (filter_state, waste), passed),
            _priors(dioxide, burning, {"stable": (-2.0, 0.1), "unstable": (-1.0, 0.3)}),
            pgm.SwitchingCPD(
                dust,
                (burning, waste),
                {
                    k: pgm.LinearGaussianCPD(dust, {efficiency: 1.0}, cov, offset=offset)
                    for k, (offset, cov) in emitted.items()
                },
            ),
            pgm.LinearGaussianCPD(light, {dust: -0.5}, 0.25, offset=3.0),
            _priors(metals_in, waste, {"industrial": (0.5, 0.01), "household": (-0.5, 0.005)}),
            pgm.LinearGaussianCPD(metals_out, {dust: 1.0, metals_in: 1.0}, 0.002),
        ]
    )


def _priors(child: pgm.Variable, given: Any, numbers: Mapping[Any, Any]) -> pgm.SwitchingCPD:
    cases = {states: pgm.GaussianCPD(child, *moments) for states, moments in numbers.items()}
    return pgm.SwitchingCPD(child, given, cases)
