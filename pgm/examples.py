"""The networks of docstrings' examples, each with its variables.

``walk`` is a random walk of x, from N(0, 1) by steps of variance 1, seen as z with variance 2, and
``drive`` one of p in the plane, seen as q likewise; ``squares`` is one from N(1, 1), of which x² is
seen with variance 10⁻⁶. In ``pair`` a is N(0, 1) and b is a with noise of variance 1; in ``square``
x is N(3, 1) and y is x² with noise of variance 1. ``rainy`` has tables of rain and wet, ``still``
those over time, with rain that never changes, ``coin`` that of side, and ``chain`` one hundred
variables of two states in a row.
"""

from itertools import pairwise

from pgm.cpds import GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD, TableCPD
from pgm.networks import BayesianNetwork, DynamicBayesianNetwork
from pgm.variables import Discrete, Variable, variables

a, b, x, y, z = variables("a b x y z")
p, q = (Variable(name, components=("east", "north")) for name in "pq")
rain, wet = (Discrete(name, states=("no", "yes")) for name in ("rain", "wet"))
side = Discrete("side", states=("heads", "tails"))


def _walk(state: Variable, seen: Variable) -> DynamicBayesianNetwork:
    return DynamicBayesianNetwork(
        prior=[GaussianCPD(state, mean=[0.0] * state.dimension, cov=1.0)],
        transition=[LinearGaussianCPD(state, given={state.previous: 1.0}, cov=1.0)],
        observation=[LinearGaussianCPD(seen, given={state: 1.0}, cov=2.0)],
    )


walk, drive = _walk(x, z), _walk(p, q)
pair = BayesianNetwork([GaussianCPD(a, 0.0, 1.0), LinearGaussianCPD(b, given={a: 1.0}, cov=1.0)])
square = BayesianNetwork(
    [GaussianCPD(x, 3.0, 1.0), NonlinearGaussianCPD(y, given=x, function=lambda x: x**2, cov=1.0)]
)
squares = DynamicBayesianNetwork(
    prior=[GaussianCPD(x, 1.0, 1.0)],
    transition=walk.transition,
    observation=[NonlinearGaussianCPD(z, given=x, function=lambda x: x**2, cov=1e-6)],
)
_rain, _wet = (
    TableCPD(rain, table=[0.5, 0.5]),
    TableCPD(wet, given=rain, table=[[0.75, 0.25], [0.25, 0.75]]),
)
rainy = BayesianNetwork([_rain, _wet])
still = DynamicBayesianNetwork(
    [_rain], [TableCPD(rain, given=rain.previous, table=[[1.0, 0.0], [0.0, 1.0]])], [_wet]
)
coin = BayesianNetwork([TableCPD(side, table=[0.25, 0.75])])
_row = [Discrete(f"x{i}", 2) for i in range(100)]
chain = BayesianNetwork(
    [
        TableCPD(_row[0], table=[0.5, 0.5]),
        *(TableCPD(w, given=v, table=[[0.9, 0.1], [0.1, 0.9]]) for v, w in pairwise(_row)),
    ]
)
