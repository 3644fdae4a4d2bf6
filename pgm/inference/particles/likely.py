"""How many particles there are: as many as explain the measurements together."""

from __future__ import annotations

from pgm.boundary import is_number, is_whole
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.immutable import Immutable


class LikelihoodSampling(InCode, Immutable):
    r"""As many particles as explain a step's measurements together.

    Particles are drawn and moved, in batches that double their number, until

    .. math:: \sum_i \frac{p(z_t \mid x_t^i)}{\max_x p(z_t \mid x)} \ge L

    Few are drawn where all of them are where the measurements say, and many where most are
    elsewhere. The largest density is that of normal noise at no residual, and that of a
    `LikelihoodField` where all beams end at obstacles; sensors of other densities are
    refused. At steps without measurements the number stays.

    Parameters
    ----------
    total : float
        L, the number of particles that would do if each explained everything: some tens of them
        leave means that err by a tenth or two of a standard deviation.
    least, most : int
        Bounds of the number of particles of a run.

    Raises
    ------
    ModelError
        If one of these is no such number.

    References
    ----------
    Koller & Fratkina, Using learning for approximation in stochastic processes, 1998; Fox, Adapting
    the sample size in particle filters through KLD-sampling, 2003, section 3.1.

    Examples
    --------
    >>> LikelihoodSampling(50)
    LikelihoodSampling(50; 100 to 100,000)
    """

    total: float
    least: int
    most: int

    def __init__(self, total: float, *, least: int = 100, most: int = 100_000) -> None:
        if not is_number(total) or not 0.0 < total < float("inf"):
            raise ModelError(f"LikelihoodSampling: total is a positive number, not {total!r}")
        if not is_whole(least) or not is_whole(most) or not 1 <= least <= most < 2**63:
            raise ModelError(
                f"LikelihoodSampling: least and most are whole numbers, 1 <= least <= most, not "
                f"{least!r} and {most!r}"
            )
        self._set(total=float(total), least=int(least), most=int(most))

    def more(self, count: int, found: float) -> int:
        """How many particles to draw next, of so many drawn, whose shares add up to so much."""
        if found >= self.total:
            return 0
        return min(count, self.most - count)

    def __repr__(self) -> str:
        return f"LikelihoodSampling({self.total:g}; {self.least:,} to {self.most:,})"
