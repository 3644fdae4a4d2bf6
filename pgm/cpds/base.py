"""What all CPDs have in common."""

from __future__ import annotations

from collections.abc import Iterable

import numpy.typing as npt

from pgm.cpds.noise import Noise, as_covariance
from pgm.errors import ModelError
from pgm.factors.scope import Scope, as_scope
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array
from pgm.variables import Variable


class CPD(Immutable):
    """The density of a child given its parents; an immutable value.

    Attributes
    ----------
    child : Variable
    given : tuple of Variable
        The parents, in the order of the function's arguments.
    cov : ndarray or Noise
        Covariance of the noise.
    """

    child: Variable
    given: Scope
    cov: Array | Noise

    def _set_family(
        self,
        child: Variable,
        given: Iterable[Variable],
        cov: npt.ArrayLike | Noise,
        *,
        lead: bool = False,
    ) -> None:
        if not isinstance(child, Variable):
            raise ModelError(f"a CPD's child is a variable, not {child!r}")
        if child.lag:
            raise ModelError(
                f"the child of a CPD cannot be {child!r}: declare it for {child.template!r}",
                variable=child,
            )
        given = as_scope(given)
        if child in given:
            raise ModelError(
                f"{child!r} is given as its own parent; did you mean {child.name}.previous?",
                variable=child,
            )
        self._set(child=child, given=given)
        self._set(cov=cov if isinstance(cov, Noise) else as_covariance(child, cov, lead=lead))

    @property
    def noise_given(self) -> Scope:
        """The parents that the noise covariance depends on."""
        return self.cov.given if isinstance(self.cov, Noise) else ()

    @property
    def parents(self) -> Scope:
        """All parents: those of the mean, then those of the noise alone."""
        return self.given + tuple(v for v in self.noise_given if v not in self.given)

    @property
    def scope(self) -> Scope:
        """The family: the child and its parents."""
        return (self.child, *self.parents)

    def __repr__(self) -> str:
        parents = ", ".join(map(repr, self.parents))
        return f"{type(self).__name__}({self.child!r}{' | ' if parents else ''}{parents})"
