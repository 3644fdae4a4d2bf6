"""Factors, potentials and messages as formulas, and how they are written into a diagram."""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

import pgm
from pgm.cpds import CPD
from pgm.plot.diagrams.canvas import FONT, Canvas, Point, Size
from pgm.plot.drawing.colours import INK

_LINE = 1.45 * FONT
_NOTHING = 1e-12  # a precision below is rounding


def factor(cpd: CPD) -> str:
    """A CPD as a factor of its child and its parents: φ_e(e, b, d)."""
    return rf"$\phi_{{{cpd.child.name}}}({_names((cpd.child, *cpd.parents))})$"


def potential(cluster: pgm.results.Cluster, evidence: Mapping[pgm.Variable, float]) -> list[str]:
    """The initial belief of a cluster, the product of its factors, on two lines."""
    factors = " ".join(factor(cpd) for cpd in cluster.cpds)
    scope = ", ".join(
        f"{v.name} = {_number(evidence[v])}" if v in evidence else v.name for v in cluster.scope
    )
    return [rf"$\psi_{cluster.index + 1}({scope})$ =", factors]


def message(source: int, target: int, sent: pgm.CanonicalForm) -> list[str]:
    """A message and its value: a weight times a Gaussian, or 1 where it says nothing."""
    name = rf"$\delta_{{{source + 1},{target + 1}}}({_names(sent.scope)})$ ="
    if sent.K.item() < _NOTHING:
        return [f"{name} {_weight(float(sent.g)) or 1}"]
    belief = sent.gaussian()
    mean, variance = _number(belief.mean.item()), _number(belief.cov.item())
    density = rf"$\mathcal{{N}}({_names(sent.scope)};\ {mean},\ {variance})$"
    return [name, f"{_weight(float(sent.log_integral))} {density}".strip()]


def size(lines: list[str]) -> Size:
    """The width and height of lines of formulas."""
    font = FontProperties(size=FONT)
    widths = [text_to_path.get_text_width_height_descent(x, font, ismath=True)[0] for x in lines]
    return Size(max(widths), _LINE * len(lines))


def write(canvas: Canvas, at: Point, lines: list[str], *, colour: str = INK) -> None:
    """Write lines of formulas about a point."""
    for k, line in enumerate(lines):
        down = (k - 0.5 * (len(lines) - 1)) * _LINE
        canvas.ax.text(
            at[0],
            at[1] - down,
            line,
            color=colour,
            fontsize=FONT * canvas.letters,
            ha="center",
            va="center",
            zorder=4.0,
        )


def _names(scope: tuple[pgm.Variable, ...]) -> str:
    return ", ".join(variable.name for variable in scope)


def _number(value: float) -> str:
    """Three digits, in braces, so that a sign is none of a difference."""
    return f"{{{value:.3g}}}"


def _weight(logarithm: float) -> str:
    """A power of e, where it is not 1."""
    return "" if abs(logarithm) < _NOTHING else f"$e^{{{logarithm:.3g}}}$"
