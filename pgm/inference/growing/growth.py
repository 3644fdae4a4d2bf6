"""How large a growing map is, and how much of it an addition touched."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pgm.display import Shown, Summary


@dataclass(frozen=True, repr=False)
class Growth(Shown):
    """The size of a growing map, and how much of it the last addition touched.

    Attributes
    ----------
    variables, cpds : int
        Hidden variables, and CPDs, in all.
    cliques : int
        Cliques of the tree.
    touched, relinearised : int
        Hidden variables that the last addition eliminated anew, new ones among them, and those
        whose CPDs it linearised again, since they had moved.
    eliminated : int
        Cliques that it eliminated.

    Examples
    --------
    >>> x = pgm.Variable("x")
    >>> pgm.GrowingMap().add(pgm.GaussianCPD(x, 0.0, 1.0)).status.touched
    1
    """

    variables: int
    cpds: int
    cliques: int
    touched: int
    relinearised: int
    eliminated: int

    def _after(self, before: Growth, touched: int) -> Growth:
        """The growth of an addition in two stages, which have touched so many variables."""
        return replace(
            self,
            touched=touched,
            relinearised=before.relinearised,
            eliminated=before.eliminated + self.eliminated,
        )

    @property
    def _title(self) -> str:
        return (
            f"Growth({_counted(self.variables, 'hidden variable')}, {_counted(self.cpds, 'CPD')}, "
            f"{_counted(self.cliques, 'clique')})"
        )

    def _summary(self) -> Summary:
        return Summary(self._title, [self._last] if self.cpds else [])

    @property
    def _last(self) -> str:
        return (
            f"last added: {_counted(self.touched, 'variable')} touched, {self.relinearised} "
            f"relinearised, {_counted(self.eliminated, 'clique')} eliminated"
        )


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"
