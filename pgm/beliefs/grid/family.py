"""Beliefs on a grid, as a family of beliefs."""

from __future__ import annotations

from typing import Any, ClassVar

from pgm.arguments import public
from pgm.beliefs.grid.belief import GridBelief
from pgm.beliefs.grid.online import GridSteps
from pgm.beliefs.grid.outcome import GridOutcome
from pgm.beliefs.grid.run import run
from pgm.beliefs.grid.settings import GridSettings
from pgm.beliefs.own.family import BeliefFamily
from pgm.compile import DynamicGraph
from pgm.evidence import BoundEvidence
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.associations import by_density
from pgm.schedules.options import Call


@public
class Grid(GridSettings, BeliefFamily[GridBelief]):
    r"""Beliefs as probabilities of grid cells, for posteriors of any shape.

    .. math:: p(x_t \mid z) \approx \sum_k p_k \, δ(x_t - c_k)

    - c_k: the centres of cells: point masses stand there, and sensors are asked for the density
      of their measurements there;
    - p_k: their probabilities. Gaussian CPDs move them by kernels on the lattice, which have the
      mean and variance of the transition exactly where the variance is f(1 − f)h² or more: h is the
      width of a cell, f the part by which a displacement goes past a whole number of cells. Where
      the variance is less, ``status.added`` has the variance that the lattice adds. The density of
      other CPDs is evaluated from each centre to each, and normalised; a mixture is moved part by
      part.

    Costs grow with the number of cells: three components, such as a pose in the plane, are
    practical.

    Parameters
    ----------
    cells : mapping
        By component of the states: ``(lo, hi, cells)`` of an interval, in the units of the
        component, or the number of cells of the full circle of an angle. A component is called by
        its name; where states share it, as ``"x.east"``; a scalar may be named by its variable.
    dtype : numpy type
        Type of the beliefs that are kept, ``np.float64`` or ``np.float32``, which takes half the
        memory; the arithmetic is in double precision either way.
    refine : str or callable, optional
        The figure that is to settle: ``"log_evidence"``, or a function of the `Posterior`. The
        cells along all n axes are doubled until it changes by no more than the tolerance; each
        doubling takes about 2^n times the time and memory of the one before. Without it the cells
        stay as they are given.
    tolerance : float
        The largest change of a figure that has settled, in its own units.
    doublings : int
        The most doublings; if the figure has not settled by then, ``status.converged`` is False,
        and a `GridWarning` says so.

    Raises
    ------
    ModelError
        If an extent is no such interval or number, or another argument has no allowed value.

    References
    ----------
    Burgard, Fox, Hennig & Schmidt, Estimating the absolute position of a mobile robot using
    position probability grids, 1996; Bucy & Senne, Digital synthesis of nonlinear filters, 1971.

    Examples
    --------
    >>> pgm.Grid({"east": (0.0, 10.0, 100), "north": (0.0, 6.7, 67), "heading": 72})
    Grid(east: 100 of 0.1, north: 67 of 0.1, heading: 72 of 5 degrees)
    """

    beliefs: ClassVar[str] = "beliefs on a grid"
    spare: ClassVar[str] = (
        "is for beliefs that are Gaussian; a grid linearises nothing, has no lag online, and works "
        "one run after another"
    )

    def infer(self, graph: DynamicGraph, bound: BoundEvidence, call: Call) -> GridOutcome:
        """The posterior's beliefs on the grid; measurements of unknown things are mixtures."""
        return run(graph, by_density(bound), call.schedule, self)

    def online(self, model: DynamicBayesianNetwork, options: dict[str, Any]) -> GridSteps:
        """The filter of one step at a time."""
        return GridSteps(model, self)
