"""Proposals over cells: particles drawn where measurements are likely at the cells' centres.

The cells, all of one size, cover the places where one state of the network may be. A filter that
knows little of this state draws it from them: at step 0, or when measurements are no longer
explained.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pgm.arguments import public
from pgm.beliefs.points.cloud import BLOCK
from pgm.beliefs.points.laws import Some, States
from pgm.beliefs.points.model import ParticleModel, Sensor
from pgm.boundary import as_floats, is_number
from pgm.display import InCode
from pgm.errors import EvidenceError, ModelError
from pgm.factors.scope import listed
from pgm.immutable import Immutable
from pgm.kernels.angles import TURN
from pgm.kernels.arrays import Array
from pgm.kernels.resampling import indices, systematic
from pgm.kernels.semirings import log_sum
from pgm.networks import DynamicBayesianNetwork
from pgm.variables import Variable

# Neighbours that overlap by a rounding error do not overlap.
_TOUCHING = 1.0 - 1e-6


@public
class CellProposal(InCode, Immutable):
    r"""A proposal that draws a state from the likelihood of a step's measurements, over cells.

    .. math:: q(x) = \frac{p(z \mid c_k)^{τ}}{V \sum_j p(z \mid c_j)^{τ}}

    - z: the measurements of the step, from sensors that depend on this state, and on no other
      hidden variable;
    - c_k: the centre of the cell in which x lies, V the volume of a cell;
    - τ: `temper`: 1 for the likelihood, 0 for equally likely cells, and a number between them for
      cells so wide that the likelihood at a centre is sharper than that of its whole cell.

    The sides of cells are along the axes of the state. The cells are to cover all places where the
    state may be: nothing is drawn outside of them, and a filter that starts from them loses the
    probability that its prior has outside. A grid of centres that is turned against the axes of the
    state, such as the poses of a map that is turned in the world, does not fit: its cells would
    overlap, and are refused.

    Parameters
    ----------
    variable : Variable
        The state that is drawn, of d components.
    centres : array_like
        (k, d): the centres of the cells, in units of the state; ``map.poses(...)`` gives those of a
        map.
    widths : array_like
        (d,): the widths of every cell; cells must not overlap.
    temper : float
        τ, from 0 to 1.

    Raises
    ------
    ModelError
        If an argument is of a wrong kind or shape, or cells overlap.

    References
    ----------
    Lenser & Veloso, Sensor resetting localization for poorly modelled mobile robots, 2000; Thrun,
    Fox, Burgard & Dellaert, Robust Monte Carlo localization for mobile robots, 2001.

    Examples
    --------
    >>> pose = Variable("pose", components=("east", "north"))
    >>> CellProposal(pose, [[0.5, 0.5], [1.5, 0.5], [2.5, 0.5]], widths=[1, 1])
    CellProposal(pose, 3 cells of east 1, north 1)
    """

    variable: Variable
    centres: Array
    widths: Array
    temper: float

    def __init__(
        self, variable: Variable, centres: Any, widths: Any, *, temper: float = 1.0
    ) -> None:
        if not isinstance(variable, Variable):
            raise ModelError(f"a CellProposal is of a Variable, not {variable!r}")
        what = f"CellProposal of {variable!r}"
        points = np.array(as_floats(centres, f"{what}: centres", variable=variable))
        sizes = np.array(as_floats(widths, f"{what}: widths", variable=variable))
        if points.ndim != 2 or not len(points) or points.shape[1] != variable.dimension:
            raise ModelError(
                f"{what}: centres are one or more rows of {variable.dimension} components, (k, "
                f"{variable.dimension}), not of shape {points.shape}",
                variable=variable,
            )
        if sizes.shape != (variable.dimension,) or not ((sizes > 0) & np.isfinite(sizes)).all():
            raise ModelError(
                f"{what}: widths are a positive number for each of the {variable.dimension} "
                f"components, not {widths!r}",
                variable=variable,
            )
        if not np.isfinite(points).all():
            raise ModelError(f"{what}: a centre is NaN or infinite", variable=variable)
        if not is_number(temper) or not 0.0 <= temper <= 1.0:
            raise ModelError(f"{what}: temper is a number from 0 to 1, not {temper!r}")
        _require_apart(what, points / sizes, np.where(variable.angle_mask, TURN / sizes, 0.0))
        for array in (points, sizes):
            array.flags.writeable = False
        self._set(variable=variable, centres=points, widths=sizes, temper=float(temper))

    @property
    def _log_volume(self) -> float:
        """The logarithm of a cell's volume, by which ln q is less than a cell's log-probability."""
        return float(np.log(self.widths).sum())

    def sensors(self, model: ParticleModel, step: int) -> list[Sensor]:
        """The sensors that have measurements at a step, and no hidden parent but this state."""
        found = []
        for sensor in model.sensors:
            hidden = [v for v in sensor.law.cpd.parents if v in model.places]
            if hidden == [self.variable] and len(sensor.rows(step)):
                found.append(sensor)
        return found

    def drawn(
        self, model: ParticleModel, step: int, run: int, count: int, rng: np.random.Generator
    ) -> tuple[States, Array]:
        """Draw `count` states of the variable from q, for a run, by a step's measurements.

        Returns the states, (d, count), and ln q at each, (count,). Cells are drawn systematically
        by their probabilities, and the states come in the order of the cells; a state is uniform in
        its cell. With a `temper` above 0 an EvidenceError is raised if no sensor with measurements
        depends on this variable alone, or if the measurements are impossible at all centres.
        """
        levels = np.zeros(len(self.centres))
        if self.temper > 0.0:
            levels = self.temper * self._log_likelihood(model, step, run)
        total = log_sum(levels, 0)
        if not np.isfinite(total):
            raise EvidenceError(
                f"{self!r}: the measurements of step {step}, run {run + model.bound.first_run}, "
                "are impossible at every centre; take more cells, or a sensor that allows for "
                "outliers",
                variable=self.variable,
                step=step,
                run=run + model.bound.first_run,
            )
        chosen = indices(systematic(np.exp(levels - total), count, rng))
        within = rng.random((count, self.variable.dimension)) - 0.5
        points = self.centres[chosen] + within * self.widths
        return points.T.astype(model.dtype), levels[chosen] - total - self._log_volume

    def _log_likelihood(self, model: ParticleModel, step: int, run: int) -> Array:
        """The log-density of a step's measurements at the centre of each cell, (cells,).

        An EvidenceError is raised if no sensor with measurements depends on this state alone.
        """
        sensors = self.sensors(model, step)
        if not sensors:
            raise EvidenceError(
                f"{self!r}: step {step} has no measurements of a sensor that depends on "
                f"{self.variable!r} alone; those read are of {listed(model.read(step)) or 'none'}",
                variable=self.variable,
                step=step,
            )
        found = np.zeros(len(self.centres))
        for first in range(0, len(found), BLOCK):
            points = self.centres[first : first + BLOCK]
            now = np.zeros((model.size, len(points)), dtype=model.dtype)
            now[model.places[self.variable]] = points.T
            owner = np.full(len(points), run) if model.bound.runs > 1 else None
            some = Some(step, now, now, owner)
            for sensor in sensors:
                for row in sensor.rows(step):
                    sensor.add(row, some, found[first : first + BLOCK])
        return found

    def require(self, model: DynamicBayesianNetwork) -> None:
        """Refuse, by a ModelError, a network of which the proposal's variable is no state."""
        if self.variable not in model.states:
            raise ModelError(
                f"{self!r}: {self.variable!r} is no state of the network; those are "
                f"{listed(model.states)}",
                variable=self.variable,
            )

    def __repr__(self) -> str:
        pairs = zip(self.variable.components, self.widths, strict=True)
        each = ", ".join(f"{name} {width:.3g}" for name, width in pairs)
        temper = "" if self.temper == 1.0 else f", temper {self.temper:g}"
        count = f"{len(self.centres):,} cell" + "s" * (len(self.centres) > 1)
        return f"CellProposal({self.variable!r}, {count} of {each}{temper})"


def _require_apart(what: str, places: Array, around: Array) -> None:
    """Refuse cells that overlap, by a ModelError whose text begins with `what`.

    places: The centres, (k, d), in widths of the cells.
    around: A whole turn, in widths of the cells, for each angle, and 0 for other components, (d,).
    """
    from scipy.spatial import KDTree  # here, since it is slow to import

    if len(places) < 2:
        return
    turning = around > 0.0
    if (around[turning] < _TOUCHING).any():
        raise ModelError(f"{what}: the width of an angle is more than a turn")
    places = np.where(turning, np.mod(places, np.where(turning, around, 1.0)), places)
    # Rounding may leave the remainder at the length itself, which a circle has no place for.
    places = np.where(turning & (places >= around), 0.0, places)
    away, which = KDTree(places, boxsize=around).query(places, k=[2], p=np.inf)
    nearest, others = np.ravel(away), np.ravel(which)
    if nearest.min() < _TOUCHING:
        first = int(nearest.argmin())
        raise ModelError(
            f"{what}: cells {first} and {int(others[first])} overlap: their centres are "
            f"{nearest[first]:.3g} widths apart; take narrower cells, or fewer"
        )
