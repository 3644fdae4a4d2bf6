"""A Gaussian of one variable, and the error ellipse of one of two."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc
from scipy.stats import chi2

import pgm
import pgm.plot
from pgm.plot.drawing.colours import INK, MUTED, PALETTE

Array = npt.NDArray[np.float64]

distance = pgm.Variable("x")
position = pgm.Variable("p", components=("x₁", "x₂"))

ONE = pgm.Gaussian(distance, mean=2.0, cov=0.75**2)
TWO = pgm.Gaussian(position, mean=[3.0, 2.0], cov=[[2.2, 0.9], [0.9, 1.3]])
CONFIDENCE = 0.95


def density() -> Figure:
    """The density of a Gaussian, its mean μ and its standard deviation σ."""
    figure, ax = plt.subplots(figsize=(6.0, 3.2), layout="constrained")
    mean, std = ONE.mean.item(), ONE.std.item()

    def height(x: npt.ArrayLike) -> Array:
        return np.exp(ONE.log_density(np.asarray(x)[..., None]))

    x = np.linspace(mean - 4.0 * std, mean + 4.0 * std, 401)
    inner = np.linspace(mean - std, mean + std, 101)
    ax.plot(x, height(x), color=PALETTE[0], lw=1.8)
    ax.fill_between(inner, height(inner), color=PALETTE[0], alpha=0.12, lw=0)
    ax.vlines(mean, 0.0, height(mean), color=INK, lw=1.0, ls=":")
    level = float(height(mean + std))  # where the curve turns from hollow to bulging
    for end, label in ((mean - std, "σ"), (mean + std, "σ")):
        ax.vlines(end, 0.0, level, color=MUTED, lw=0.8, ls=":")
        ax.annotate("", (end, level), (mean, level), arrowprops={"arrowstyle": "<->", "color": INK})
        ax.annotate(
            label, (0.5 * (mean + end), level), (0, 5), textcoords="offset points", ha="center"
        )
    ax.text(mean - 0.5 * std, 0.45 * level, "68 %", ha="center", color=PALETTE[0])
    ax.set_xticks(
        mean + std * np.arange(-3, 4), ["μ − 3σ", "", "μ − σ", "μ", "μ + σ", "", "μ + 3σ"]
    )
    ax.set(xlabel="x", ylabel="p(x)", ylim=(0.0, None))
    ax.spines[["top", "right"]].set_visible(False)
    plt.close(figure)
    return figure


def error_ellipse() -> Figure:
    """The 95 % ellipse of a Gaussian in the plane, its axes dotted, and its orientation α."""
    figure, ax = plt.subplots(figsize=(6.0, 4.4), layout="constrained")
    pgm.plot.ellipses(TWO, confidence=CONFIDENCE, colour=PALETTE[0], linewidth=1.6, ax=ax)
    found = TWO.ellipse(CONFIDENCE)
    angle = orientation()
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    centre = found.centre
    for way, half, sign, text, side in (
        (along, found.half_axes[0], -1.0, "major axis", across),
        (across, found.half_axes[1], 1.0, "minor axis", -along),
    ):
        ends = np.array([centre - half * way, centre + half * way])
        ax.plot(*ends.T, ":", color=INK, lw=1.3)
        _along(ax, centre + sign * 0.55 * half * way, text, way, side)
    ax.plot(*centre, "o", color=INK, markersize=4)
    ax.annotate("μ", tuple(centre), (-3, -17), textcoords="offset points")
    reach = 0.62 * float(found.half_axes[0])
    ax.plot([centre[0], centre[0] + reach], [centre[1]] * 2, color=MUTED, lw=0.9)
    ax.add_patch(Arc(tuple(centre), reach, reach, theta2=np.degrees(angle), color=INK, lw=1.2))
    middle = centre + 0.58 * reach * np.array([np.cos(0.5 * angle), np.sin(0.5 * angle)])
    ax.text(middle[0], middle[1], "α", ha="left", va="center")
    ax.set_aspect("equal", adjustable="datalim")
    plt.close(figure)
    return figure


def orientation() -> float:
    """The angle α of the major axis, in [−π/2, π/2), for an axis has no front."""
    return float(np.mod(TWO.ellipse(CONFIDENCE).orientation + 0.5 * np.pi, np.pi) - 0.5 * np.pi)


def _along(ax: Axes, at: Array, text: str, way: Array, side: Array) -> None:
    """A text beside a line, turned as the line is."""
    turn = np.degrees(np.arctan2(way[1], way[0]))
    turn = turn - 180.0 if turn > 90.0 else turn
    ax.annotate(
        text,
        tuple(at),
        tuple(9.0 * side),
        textcoords="offset points",
        ha="center",
        va="center",
        rotation=turn,
        rotation_mode="anchor",
        fontsize=8.5,
    )


def inside(draws: int, rng: np.random.Generator) -> dict[str, float]:
    """The share of draws within σ of μ, and within the ellipse, beside their probabilities."""
    one, two = ONE.sample(draws, rng=rng), TWO.sample(draws, rng=rng)
    away = two - TWO.mean
    square = (away * np.linalg.solve(TWO.cov, away.T).T).sum(axis=-1)
    return {
        "within_std": float((np.abs(one - ONE.mean) <= ONE.std).mean()),
        "within_ellipse": float((square <= chi2(2).ppf(CONFIDENCE)).mean()),
    }


def axes_of(covariance: npt.ArrayLike) -> tuple[Array, float]:
    """Half axes √(sλ) and orientation α, by eigenvectors (equations 2.13 to 2.16)."""
    variances, vectors = np.linalg.eigh(np.asarray(covariance, dtype=float))
    largest = vectors[:, -1]
    half: Array = np.sqrt(chi2(2).ppf(CONFIDENCE) * variances[::-1])
    return half, float(np.arctan(largest[1] / largest[0]))
