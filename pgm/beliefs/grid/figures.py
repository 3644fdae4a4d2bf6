"""The status of a posterior on a grid: errors due to its bounds, its cells and its sensors."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from pgm.beliefs.grid.cut_off import Cut
from pgm.beliefs.grid.densities import Uneven
from pgm.beliefs.grid.measured import Sharpness
from pgm.beliefs.grid.slices import Narrowness, Worst
from pgm.display import brief, number
from pgm.errors import GridWarning, levels_to_user
from pgm.kernels.arrays import Array
from pgm.posteriors.figures import Figures
from pgm.variables import Variable

# The probability outside the bounds above which the user is warned.
MUCH = 1e-3
# A share that may have been cut off and is told.
REMARKABLE = 1e-9
# The error of the log-evidence, in nats, above which cells are too wide for the measurements; and
# that which is told.
COARSE, TOLD = 0.25, 0.01
# Standard deviations of the noise, from a cell to the next, above which a sensor is sharper than
# half a cell.
SHARP = 2.0
# The share above which a density has another shape on the cells.
ROUGH = 0.1
# The standard deviation in cells below which a belief is told to be narrow.
NARROW = 0.7


class Refinement(NamedTuple):
    """One resolution of a grid that is refined: its cells along each axis, and the figure there.

    figure: The log-evidence, or the value of the user's function of the posterior.
    change: The figure's largest change from the resolution before; NaN of the first.
    seconds: How long inference took on these cells.
    """

    cells: tuple[int, ...]
    figure: Array
    change: float
    seconds: float

    def __repr__(self) -> str:
        cells = " × ".join(map(str, self.cells))
        return (
            f"Refinement({cells} cells, figure {brief(self.figure)}, change "
            f"{number(self.change)}, {number(self.seconds)} s)"
        )


class GridFigures(Figures):
    """The figures by which to judge a posterior on a grid: losses at bounds, cells too wide.

    Attributes
    ----------
    outside : ndarray
        (*runs): the probability that has left the bounds in all steps together, which the evidence
        lacks; the probability that the window of active cells cuts off, below 10⁻¹⁴ a step, is
        counted too. Above 10⁻³ a `GridWarning` has been given.
    outside_by_step : ndarray
        (*runs, T+1): the share of each step's belief that has left the bounds.
    added : mapping of str to ndarray
        By component, (*runs): the variance that the lattice has added in all steps together, in
        squared units of the component. It adds where a displacement has a variance of less than
        f(1 − f)h², h being the width of a cell and f the displacement's part past whole cells.
    unresolved : ndarray
        (*runs): the expected error of the log-evidence, in nats, for want of narrower cells: sums
        over centres change by so much as the centres shift within a cell. Once it is above ten no
        more is added. Above .25 a `GridWarning` has been given; beliefs are then no more accurate
        than a cell.
    sharpest : Sharpness
        The sensor whose expected measurement moves the furthest from a cell to the next, at the
        likeliest cell, in standard deviations of its noise: the figure, the sensor and the step.
        Above two it is sharper than half a cell, and the density at centres may miss it: narrower
        cells, or more noise, help.
    narrowest : Narrowness
        The belief with the least standard deviation: s, in cells, its component and its step. A sum
        over centres misses the integral of a normal density by a share of about e^(−2π²s²): 3·10⁻⁹
        at one cell, 10⁻⁵ at three quarters, a sixth at .3.
    cut : Cut
        The belief of which the most may have been cut off: the share, and its step. Cells of a
        share below 10⁻¹⁵ along an axis are left out, and motion ends at 8.5 standard deviations of
        its noise; a state further from the belief is not found again, whatever the evidence, nor is
        a state beyond the bounds. Probability beyond the bounds counts at steps whose measurements
        make the last cells more than 30 times likelier. Above 10⁻³ beliefs and log-evidence may be
        those of the wrong places, and a `GridWarning` has been given. The share is an estimate,
        which leaves out separate modes of a belief that were dropped at 10⁻¹⁵ and that further
        measurements would have made likelier little by little.
    split : tuple of str
        The components that were moved cell by cell, since each depends on another of them, as in a
        rotation, so that none could be moved first. Means and variances are exact all the same,
        densities are not: with noise of a standard deviation of two cells the log-evidence may be
        off by 10⁻⁴ a step, of four cells by 10⁻⁵; ``Grid(..., refine="log_evidence")`` shows by how
        much.
    uneven : Uneven
        The density that is not Gaussian whose sum over centres, due to be one, varies the most as
        the centres shift within a cell: the variation (times the density's weight, in a mixture),
        the variable and the step. The density is normalised, but has another shape on the cells:
        above a tenth a `GridWarning` has been given. Of a normal density with a standard deviation
        of s cells the variation is 4e^(−2π²s²), of Laplace's with a scale of b cells 1/(8b²), of a
        uniform one over n cells 1/n.
    refinements : tuple of Refinement
        One entry a resolution, coarsest first; empty if no refinement was asked for.
    converged : ndarray of bool
        (): whether the figure of the refinement has settled; True where none was asked for. The
        cells are those of all runs, each of which has this in the ``converged`` of the status.

    Examples
    --------
    >>> from pgm.examples import walk, x, z
    >>> grid = pgm.Grid({"x": (-8.0, 8.0, 160)})
    >>> status = pgm.filter(walk, {z: [[4.0]]}, belief=grid).status
    >>> bool(status.outside < 1e-6)
    True
    >>> round(status.narrowest.cells, 1), status.narrowest.component
    (10.0, 'x')
    """

    outside: Array
    outside_by_step: Array
    added: Mapping[str, Array]
    unresolved: Array
    sharpest: Sharpness
    narrowest: Narrowness
    cut: Cut
    split: tuple[str, ...]
    uneven: Uneven
    refinements: tuple[Refinement, ...]
    converged: np.bool_

    def __init__(
        self,
        outside_by_step: Array,
        added: Mapping[str, Array],
        unresolved: Array,
        worst: Worst,
        split: Sequence[str] = (),
        refinements: Sequence[Refinement] = (),
        converged: bool = True,
    ) -> None:
        added = {name: np.asarray(value) for name, value in added.items()}
        outside = np.asarray(1.0 - np.prod(1.0 - outside_by_step, axis=-1))
        unresolved = np.asarray(unresolved)
        for array in (outside, outside_by_step, unresolved, *added.values()):
            array.flags.writeable = False
        self._set(
            outside=outside,
            outside_by_step=outside_by_step,
            added=MappingProxyType(added),
            unresolved=unresolved,
            **worst._asdict(),
            split=tuple(split),
            refinements=tuple(refinements),
            converged=np.bool_(converged),
        )

    @property
    def much(self) -> bool:
        """Whether more than 10⁻³ of the probability has left the bounds in a run."""
        return bool((self.outside > MUCH).any())

    @property
    def sharp(self) -> Variable | None:
        """The sensor that is sharper than half a cell; None if there is none."""
        return self.sharpest.variable if self.sharpest.cells > SHARP else None

    @property
    def coarse(self) -> bool:
        """Whether narrower cells may change the log-evidence of a run by more than ¼ nat."""
        return bool((self.unresolved > COARSE).any())

    def refined(self, refinements: Sequence[Refinement], converged: bool) -> GridFigures:
        """The same status with the record of a refinement, and whether its figure has settled."""
        found = self.outside_by_step, self.added, self.unresolved, self._worst, self.split
        return GridFigures(*found, refinements, converged)

    @property
    def _worst(self) -> Worst:
        """The figures `sharpest`, `narrowest`, `cut` and `uneven`, as one record.

        Each is the worst of all runs and steps.
        """
        return Worst(self.sharpest, self.narrowest, self.cut, self.uneven)

    @property
    def lost(self) -> bool:
        """Whether more than 10⁻³ of a belief may have been cut off, so that the answer is wrong."""
        return self.cut.share > MUCH

    @property
    def rough(self) -> bool:
        """Whether the sums of a density over centres vary by more than a tenth."""
        return self.uneven.share > ROUGH

    def warn(self, before: GridFigures | None = None) -> None:
        """Warn of lost probability, cells that are too wide, and a figure that has not settled.

        The texts have no figures of a run or step, so that Python shows each once a place.

        Parameters
        ----------
        before : GridFigures, optional
            The status of the step before, whose warnings the user has had: they are not given
            again. None if there was none.

        Warns
        -----
        GridWarning
            If more than 10⁻³ of the probability has left the bounds in a run, or may have been cut
            off, a density is narrow for the cells, measurements are too sharp for them, or refining
            has not converged.
        """
        told = before or GridFigures(np.zeros((1, 1)), {}, np.zeros(1), Worst())
        if self.rough and not told.rough:
            _warn(
                f"the density of {self.uneven.variable!r} is narrow for the cells: its sum over "
                f"their centres differs by more than {ROUGH:g} with where between centres it "
                "stands (status.uneven says by how much, at which step): take narrower cells, or "
                "a Gaussian CPD, or a mixture of such, which is moved by displacements"
            )
        if self.coarse and not told.coarse and not self.lost:  # which piles a belief up at its edge
            _warn(
                "measurements are too sharp for the cells: the log-evidence of some run may be off "
                f"by more than {COARSE:g} (status.unresolved), since {self._sharpness}; "
                'take narrower cells, which refine="log_evidence" finds, particles, or a Gaussian '
                "belief"
            )
        if self.lost and not told.lost:
            _warn(
                "the evidence at some step is so far from what was believed that more than "
                f"{MUCH:g} of the belief may stand where it had been cut off (status.cut says how "
                "much, at which step): beliefs and log-evidence are wrong from there on; look for "
                "a mistaken measurement, widen the bounds if it is true, or give the prior or the "
                "motion more noise"
            )
        if self.much and not told.much:
            _warn(
                f"more than {MUCH:g} of the probability of some run has left the bounds of the "
                "grid (status.outside; status.outside_by_step says at which steps): widen the "
                "bounds"
            )
        if not self.converged:
            _warn(
                "the figure of refine= had not settled at the most cells (status.refinements says "
                "how much it still changes): allow more doublings, or a larger tolerance"
            )

    @property
    def _sharpness(self) -> str:
        """Words for a warning of wide cells: the sensor that is sharp, or the narrowest belief."""
        if self.sharp is None:
            return f"{self.narrowest.component} is known to few of them (status.narrowest)"
        return (
            f"{self.sharp!r} differs by more than {SHARP:g} deviations from a cell to the next "
            "(status.sharpest)"
        )

    @property
    def phrases(self) -> list[str]:
        """Phrases of the status as it is shown, such as "outside 0.01".

        The first is the probability that has left the bounds, the largest of all runs.
        """
        parts = [f"outside {float(self.outside.max(initial=0.0)):.2g}"]
        parts += [
            f"variance added to {name} {float(value.max()):.2g}"
            for name, value in self.added.items()
            if value.size and value.max() > 0.0
        ]
        if self.split:
            parts.append(f"{' and '.join(self.split)} moved cell by cell")
        if self.sharp is not None:
            parts.append(
                f"{self.sharp!r} at step {self.sharpest.step} is sharper than half a cell: "
                f"{self.sharpest.cells:.2g} deviations from a cell to the next"
            )
        if self.narrowest.cells < NARROW:
            parts.append(
                f"{self.narrowest.component} at step {self.narrowest.step} is known to "
                f"{self.narrowest.cells:.2g} cells"
            )
        if (self.unresolved > TOLD).any():
            parts.append(f"log-evidence known to {float(self.unresolved.max()):.2g}")
        if self.uneven.share > MUCH:
            parts.append(
                f"sums of the density of {self.uneven.variable!r} uneven by {self.uneven.share:.2g}"
            )
        if self.cut.share > REMARKABLE:
            parts.append(f"up to {self.cut.share:.2g} cut off at step {self.cut.step}")
        if self.refinements:
            cells = " × ".join(map(str, self.refinements[-1].cells))
            settled = "settled" if self.converged else "not settled"
            parts.append(f"refined {len(self.refinements) - 1} times to {cells} cells, {settled}")
        return parts


def _warn(message: str) -> None:
    warnings.warn(message, GridWarning, stacklevel=levels_to_user())
