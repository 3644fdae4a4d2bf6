"""Schedules for any graph: in which order messages are sent until none changes."""

from __future__ import annotations

from dataclasses import dataclass

from pgm.boundary import is_number
from pgm.display import InCode
from pgm.errors import ModelError
from pgm.inference.checks import require_count, require_tolerance


@dataclass(frozen=True)
class Loopy(InCode):
    """Schedules for any graph, a tree or not.

    Messages are sent until none changes: the beliefs of neighbours then agree. On a tree they are
    exact. On a graph with loops they need not converge; where they do, Gaussian means are exact,
    variances and log-evidence approximate, and so are all beliefs of discrete variables.

    Parameters
    ----------
    tolerance : float
        A run has converged when no message changes by more than this: in standard deviations of
        the belief it makes, or in probability.
    damping : float
        The share of the old message that is kept, in [0, 1): a new one is the geometric mean.
    max_iterations : int
        Iterations at the most; one sends as many messages as the graph has.

    Raises
    ------
    ModelError
        If one of them is no such number.
    """

    tolerance: float = 1e-10
    damping: float = 0.0
    max_iterations: int = 1000

    def __post_init__(self) -> None:
        require_count(self, "max_iterations", self.max_iterations)
        require_tolerance(self, self.tolerance)
        if not is_number(self.damping) or not 0.0 <= self.damping < 1.0:
            raise ModelError(
                f"{self!r}: damping is the share of the old message, in [0, 1), not "
                f"{self.damping!r}"
            )


@dataclass(frozen=True)
class Flooding(Loopy):
    """All messages at once, each from the messages of the iteration before.

    Parameters
    ----------
    tolerance : float
        A run has converged when no message changes by more than this: in standard deviations of
        the belief it makes, or in probability.
    damping : float
        The share of the old message that is kept, in [0, 1).
    max_iterations : int
        Iterations at the most; one sends as many messages as the graph has.

    Raises
    ------
    ModelError
        If one of them is no such number.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.Bethe())
    >>> posterior = pgm.infer(graph, {b: [2.0]}, schedule=pgm.Flooding(tolerance=1e-6))
    >>> posterior[a]
    Gaussian(a)
         mean ± deviation
      a     1.000 ± 0.707
    >>> bool(posterior.status.converged)
    True
    """


@dataclass(frozen=True)
class Sequential(Loopy):
    """Cluster after cluster, forth and back, each message from the latest ones.

    Its parameters and errors are those of `Flooding`.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.Bethe())
    >>> pgm.infer(graph, {b: [2.0]}, schedule=pgm.Sequential())[a].mean
    array([1.])
    """


@dataclass(frozen=True)
class Residual(Loopy):
    """Always the message that would change most.

    Each message sent makes all messages it has a part in be computed anew. So an iteration takes
    about n² of them around a hub of n neighbours, where `Flooding` and `Sequential` take n.

    Its parameters and errors are those of `Flooding`.

    References
    ----------
    Elidan, McGraw & Koller, Residual belief propagation, 2006.

    Examples
    --------
    >>> from pgm.examples import a, b, pair
    >>> graph = pgm.compile(pair, method=pgm.Bethe())
    >>> pgm.infer(graph, {b: [2.0]}, schedule=pgm.Residual())[a].mean
    array([1.])
    """
