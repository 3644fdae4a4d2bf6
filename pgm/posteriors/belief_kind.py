"""The kind of a chain's beliefs: predicted, filtered, fixed-lag or smoothed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pgm.arguments import public
from pgm.boundary import is_whole
from pgm.display import InCode
from pgm.errors import ModelError, Unanswered


@public
@dataclass(frozen=True)
class Kind(InCode):
    r"""The kind of a chain's beliefs: each knows the measurements up to a lag after its step.

    .. math:: p(x_t \mid z_0, \dots, z_{\min(t + \mathrm{lag},\, T)})

    is the belief over the state x at step t, given the measurements z; T is the last step. The kind
    as text, ``predicted``, ``filtered``, ``fixed-lag (5)`` or ``smoothed``, labels plots:
    ``pgm.plot.trajectory(posterior[x], label=posterior.kind)``. Any other lag than those below is
    refused with a `ModelError`.

    Parameters
    ----------
    lag : int or math.inf
        In steps: −1 of a prediction, which knows the measurements before its step; 0 of a filter;
        more of a fixed-lag smoother; ``math.inf`` of a smoother, which knows all.

    Examples
    --------
    >>> print(Kind(0), Kind(5), Kind(math.inf), sep=", ")
    filtered, fixed-lag (5), smoothed
    """

    lag: float

    def __post_init__(self) -> None:
        endless = isinstance(self.lag, float) and self.lag == math.inf
        if not endless and not (is_whole(self.lag) and self.lag >= -1):
            raise ModelError(
                f"a lag is a whole number of steps from -1 on, or math.inf, not {self.lag!r}"
            )

    @property
    def name(self) -> str:
        """The kind in a word, without the lag: predicted, filtered, fixed-lag or smoothed."""
        names = {-1: "predicted", 0: "filtered", math.inf: "smoothed"}
        return names.get(self.lag, "fixed-lag")

    def last(self, step: int, steps: int) -> int:
        """The last step whose measurements a belief at `step` of a chain of `steps` knows.

        It is min(step + lag, T), with T = `steps`; −1 of a prediction at step 0, which knows none.
        """
        return int(min(step + self.lag, steps))

    def __str__(self) -> str:
        return f"{self.name} ({self.lag})" if self.name == "fixed-lag" else self.name


PREDICTED, FILTERED, SMOOTHED = Kind(-1), Kind(0), Kind(math.inf)


def require_smoothed(kind: Kind) -> None:
    """Refuse draws of whole trajectories of beliefs that do not know all measurements."""
    if kind != SMOOTHED:
        raise Unanswered(
            f"draws of trajectories know all measurements, and this posterior is {kind}: take "
            "pgm.smooth; of one step draw from its belief, posterior[x.at(3)].sample(...)"
        )
