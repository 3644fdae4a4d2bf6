"""The status of a schedule: iterations, convergence, and the digits that rounding leaves."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from pgm.display import Shown, Summary, few, number
from pgm.errors import PrecisionWarning, levels_to_user
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array, Mask
from pgm.posteriors.figures import Figures

# Digits of a mean, counted from its standard deviation, below which the user is warned.
ENOUGH_DIGITS = 6.0
# What all figures have for a status, and is no figure.
_INSIDE = frozenset(dir(Figures))
# Residuals that a summary shows at the most.
FEW = 8
# Why digits are few, and what helps.
FAR_APART = (
    "some deviations of the model are too far apart for float64; scale them, give what is not "
    "known at all cov=np.inf in the prior of a chain, or read a repeated or redundant measurement "
    "once"
)
CLOSE_POINTS = (
    "sigma points of a small alpha lie so close together that values of a function far from zero "
    "differ in few digits; use a larger alpha, pgm.Unscented() or pgm.Cubature(), or count "
    "coordinates from a place nearby"
)
LAST_PLACE = (
    "a standard deviation is too small beside its mean, of which the last digit in float64 is too "
    "coarse for it; count coordinates from a place nearby, and give what is known exactly cov=0"
)


def digits(error: Array, lead: tuple[int, ...]) -> Array:
    """The correct decimal digits −log₁₀ e of means with errors e, in standard deviations.

    The errors are (runs,), the digits (*lead): 15.7 at the most, as of float64, and 0 for an error
    that is not finite.
    """
    least = np.finfo(np.float64).eps
    error = np.where(np.isfinite(error), error, 1.0)
    return np.asarray(0.0 - np.log10(np.maximum(error, least)).reshape(lead))


class Status(Shown, Immutable):
    """The status of a schedule: iterations, convergence, digits.

    Attributes
    ----------
    iterations : int
        On a tree or chain, the number of linearisations made. After a schedule for any graph, the
        number of its iterations, which is less than the maximum also where messages diverged;
        `converged` is then False.
    residuals : ndarray
        The convergence record. Of a tree or chain, (iterations − 1, *runs): the largest move of a
        mean at each relinearisation, in standard deviations. (On a balanced tree, with `Taylor`,
        Jacobians that are given and regular noise, these are the deviations of a component given
        all other components.) Of other graphs, (iterations, *runs): the largest change of a message
        in each iteration, or move of a mean where CPDs were linearised anew.
    converged : ndarray of bool
        (*runs): whether the last residual was within the tolerance, or nothing was to iterate. Of
        nonlinear CPDs that were linearised once it is False.
    by_edge : mapping of (int, int) to ndarray
        After a schedule for any graph, (*runs): how much the messages between each two joined
        clusters would still change, for ``pgm.plot.cluster_graph(graph, residuals=...)``; empty
        after others.
    edge_residuals : ndarray or None
        (iterations, edges, *runs), after a schedule for any graph: the change of the messages along
        each edge, in the order of ``graph.sepsets``; zero of runs that had ended before. None after
        others, and where it would take more than 8 MiB.
    digits : ndarray or None
        (*runs): how many decimal digits rounding leaves of the mean that it harms most. Digits are
        counted from the mean's standard deviation, so that 6 are an error of 10⁻⁶ deviations. If
        the deviation is below 10⁻⁹ of the largest one that the component had, they are counted from
        10⁻⁹ of that one. The rounding of the mean to its last place in float64 is included. None if
        digits were not measured and that last rounding is at most 10⁻⁶ deviations for each mean.
        Fewer than six give a `PrecisionWarning`.
    compilation : str
        An account of the sweeps along a chain, or over a tree: ``"compiled"``, where machine code
        made them, with the CPDs whose functions it called back; ``"not compiled: ..."`` or
        ``"compiled, but for: ..."``, where it was due and something of the call left it to NumPy,
        with the reasons; ``"by NumPy: ..."``, where it was not due. Else empty.

    numbers : mapping of str to object
        A belief family's own figures, by name; also as attributes of the status. Those of a grid
        are told at `GridFigures`, of particles at `ParticleFigures`; others have none.

    Examples
    --------
    >>> from pgm.examples import squares, z
    >>> status = pgm.smooth(squares, {z: [[9.0]]}, iterations=20).status
    >>> bool(status.converged), bool(status.residuals[-1] < 1e-9)
    (True, True)
    """

    iterations: int
    residuals: Array
    converged: Mask
    by_edge: Mapping[tuple[int, int], Array]
    edge_residuals: Array | None
    digits: Array | None
    compilation: str
    _cause: str
    _figures: Figures | None

    def __init__(
        self,
        iterations: int,
        residuals: Array,
        converged: Mask,
        by_edge: Mapping[tuple[int, int], Array] = MappingProxyType({}),
        digits: Array | None = None,
        edge_residuals: Array | None = None,
        compilation: str = "",
        *,
        _cause: str = FAR_APART,
        _figures: Figures | None = None,
    ) -> None:
        for record in (residuals, converged, digits, edge_residuals):
            if record is not None:
                record.flags.writeable = False
        self._set(
            iterations=iterations,
            residuals=residuals,
            converged=converged,
            by_edge=MappingProxyType(dict(by_edge)),
            edge_residuals=edge_residuals,
            digits=digits,
            compilation=compilation,
            _cause=_cause,
            _figures=_figures,
        )

    def __getattr__(self, name: str) -> Any:
        # A family's own figures.
        figures = self.__dict__.get("_figures")
        if figures is None or name.startswith("_"):
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        try:
            return getattr(figures, name)
        except AttributeError:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}") from None

    def __dir__(self) -> list[str]:
        found = () if self._figures is None else (*self.numbers, *dir(self._figures))
        more = (name for name in found if not name.startswith("_") and name not in _INSIDE)
        return sorted({*super().__dir__(), *more})

    @property
    def numbers(self) -> Mapping[str, Any]:
        """A belief family's own figures, by name."""
        return MappingProxyType({}) if self._figures is None else self._figures.numbers

    @classmethod
    def of_figures(cls, figures: Figures, lead: tuple[int, ...], converged: bool = True) -> Status:
        """The status of a family with figures of its own, of which nothing was iterated.

        `converged` tells it of all runs together, which have the axes `lead`.
        """
        return cls(1, np.zeros((0, *lead)), np.full(lead, converged), _figures=figures)

    @classmethod
    def of(cls, residuals: list[Array], converged: Mask, lead: tuple[int, ...]) -> Status:
        """The status after a first linearisation of the CPDs and some relinearisations.

        `residuals` has one array (runs,) for each relinearisation: the largest move of a mean, in
        standard deviations. `converged` (runs,) marks the runs that have converged. `lead` is the
        shape of the user's axes of runs, into which the axis of runs is reshaped.
        """
        count = len(residuals)
        record = np.array(residuals, dtype=np.float64).reshape(count, *lead)
        return cls(count + 1, record, converged.reshape(lead))

    def _measured(self, digits: Array, cause: str) -> Status:
        """The same status with digits (*runs), without a warning.

        A later warning says, in the words of `cause`, why digits are few.
        """
        return self._with(digits=digits, _cause=cause)

    def _losing(self, error: Array, cause: str) -> Status:
        """The same status with fewer digits, since means have a further error by rounding.

        The further error (runs,), in standard deviations, is added to the one that the present
        digits stand for. The words `cause` say why it arises. They are recorded for a warning,
        unless the error before is as large or larger: then the words recorded before stay. No
        warning is given here: `_warn` gives it, once a call.
        """
        past = np.zeros(error.shape)
        if self.digits is not None:
            past = 10.0 ** -self.digits.reshape(-1)
            if past.max(initial=0.0) >= np.where(np.isfinite(error), error, 1.0).max(initial=0.0):
                cause = self._cause
        return self._measured(digits(past + error, self.converged.shape), cause)

    def _warn(self) -> None:
        """Give a `PrecisionWarning` if fewer than six digits are left.

        Its text does not say how many, so that Python shows it once a place, and not once a call.
        """
        if self.digits is None or not (self.digits < ENOUGH_DIGITS).any():
            return
        message = (
            f"rounding leaves fewer than {ENOUGH_DIGITS:g} decimal digits of a mean, counted from "
            f"its standard deviation (status.digits says in which runs how many): {self._cause}"
        )
        warnings.warn(message, PrecisionWarning, stacklevel=levels_to_user())

    def with_compilation(self, words: str) -> Status:
        """The same status with `words` as its `compilation`: how sweeps along a chain were made."""
        return self._with(compilation=words)

    def _with(self, **changes: Any) -> Status:
        """The same status with the attributes in `changes` replaced, by name."""
        names = ("iterations", "residuals", "converged", "by_edge", "edge_residuals", "digits")
        more = ("compilation", "_cause", "_figures")
        same = {name: getattr(self, name) for name in (*names, *more)}
        return Status(**same | changes)

    @property
    def _swept(self) -> list[str]:
        """Whether sweeps were compiled, in words; nothing where that was not asked."""
        swept = self.compilation.startswith(("not compiled", "compiled"))
        return [self.compilation] if swept else []

    @property
    def _phrases(self) -> list[str]:
        """The family's own figures in words, and how it swept; nothing where it has no figures."""
        return [] if self._figures is None else [*self._figures.phrases, *self._swept]

    @property
    def _title(self) -> str:
        lost = ""
        if self.digits is not None and (least := self.digits.min(initial=np.inf)) < ENOUGH_DIGITS:
            lost = f", {max(least, 0.0):.1f} digits left"
        if told := self._phrases:
            return f"Status({'; '.join(told)})"
        return f"Status({'; '.join([self._went() + lost, *self._swept])})"

    def _summary(self) -> Summary:
        if self._figures is not None and len(self._phrases) > self._figures.on_a_line:
            first, *rest = self._phrases
            return Summary(f"Status({first})", rest)
        if len(self.residuals) < 2 or not self.residuals[0].size:
            return Summary(self._title)
        worst = self.residuals.reshape(len(self.residuals), -1).max(axis=1)
        shown = ["..." if k is None else number(worst[k], 3) for k in few(len(worst), FEW)]
        of = " of the worst run" if self.converged.size > 1 else ""
        return Summary(self._title, [f"residuals{of}: {', '.join(shown)}"])

    def _went(self) -> str:
        """How the iterations went, as text: their number, runs converged, the last residual.

        Of several runs the largest last residual is told. If there are no residuals, the text
        says whether CPDs were linearised once or there was nothing to iterate.
        """
        converged = int(self.converged.sum())
        if not len(self.residuals):
            every = converged == self.converged.size
            return "nothing to iterate" if every else "linearised once, not iterated"
        return (
            f"{self.iterations} iteration{'s' if self.iterations > 1 else ''}, "
            f"{converged} of {self.converged.size} runs converged, "
            f"last residual {self.residuals[-1].max(initial=0.0):.3g}"
        )
