"""Elimination: factors are multiplied and variables summed out, by a plan made beforehand.

A `Plan` says which factors are multiplied and what is summed out of each product (`plan`); `orders`
makes plans. `eliminate` and `Calibrated` carry one out (`carry_out`) for any kind of factor that an
`Algebra` multiplies and sums; `tables` has the algebra of tables.
"""

from pgm.elimination.carry_out import Algebra, Calibrated, eliminate, results
from pgm.elimination.orders import by_fill, in_order, next_smallest
from pgm.elimination.plan import Label, Plan, Scope, Step
from pgm.elimination.tables import Entries, Move, TableAlgebra

__all__ = [
    "Algebra",
    "Calibrated",
    "Entries",
    "Label",
    "Move",
    "Plan",
    "Scope",
    "Step",
    "TableAlgebra",
    "by_fill",
    "eliminate",
    "in_order",
    "next_smallest",
    "results",
]
