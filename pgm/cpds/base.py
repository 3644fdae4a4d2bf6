"""What all CPDs have in common."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from pgm.cpds.noise import Noise, as_covariance
from pgm.errors import ModelError
from pgm.factors.scope import Scope, as_scope, listed, one_name_each
from pgm.immutable import Immutable
from pgm.kernels.arrays import Array
from pgm.variables import Discrete, Variable


class CPD(Immutable):
    """The density of a child given its parents; an immutable value.

    Attributes
    ----------
    child : Variable
    given : tuple of Variable
        The parents, in the order of the function's arguments or the table's axes.
    origin : CPD
        The CPD of which this one is a copy at another step (see `at`); itself, if of none.
    """

    child: Variable
    given: Scope
    # What kind of variables a CPD is about: mixed networks are not supported.
    discrete: ClassVar[bool] = False
    _origin: CPD | None = None

    def _set_scope(
        self, child: Variable, given: Variable | Iterable[Variable], noise_given: Scope = ()
    ) -> None:
        if not isinstance(child, Variable):
            raise ModelError(f"a CPD's child is a variable, not {child!r}")
        if child.lag:
            raise ModelError(
                f"the child of a CPD cannot be {child!r}: declare it for {child.template!r}",
                variable=child,
            )
        given = as_scope(given, f"{type(self).__name__} of {child!r}: given")
        if child in given:
            raise ModelError(
                f"{child!r} is given as its own parent; did you mean {child.name}.previous?",
                variable=child,
            )
        if child in noise_given:
            raise ModelError(
                f"the noise of the CPD of {child!r} depends on {child!r} itself; it can depend on "
                "observed parents alone",
                variable=child,
            )
        one_name_each((child, *given, *noise_given))
        for variable in (child, *given, *noise_given):
            if isinstance(variable, Discrete) != self.discrete:
                found = "continuous" if self.discrete else "discrete"
                advice = "a Gaussian CPD" if self.discrete else "a TableCPD"
                raise ModelError(
                    f"{type(self).__name__} of {child!r}: {variable!r} is {found}; {found} "
                    f"variables take {advice}, and no CPD has variables of both kinds: keep the "
                    "discrete and the continuous part in networks of their own",
                    variable=variable,
                )
        self._set(child=child, given=given)

    @property
    def noise_given(self) -> Scope:
        """The parents that the noise covariance depends on."""
        return ()

    @property
    def parents(self) -> Scope:
        """All parents: those of the mean, then those of the noise alone."""
        return self.given + tuple(v for v in self.noise_given if v not in self.given)

    @property
    def scope(self) -> Scope:
        """The family: the child and its parents."""
        return (self.child, *self.parents)

    @property
    def origin(self) -> CPD:
        """The CPD of which this one is a copy; itself, if of none."""
        return self._origin or self

    def at(self, step: int) -> Self:
        """The copy for a concrete step, of a CPD declared for every step."""
        placed = copy.copy(self)
        placed._set(**self._placed(step), _origin=self.origin)
        return placed

    def _placed(self, step: int) -> dict[str, Any]:
        """What a copy at a step has in place of the attributes of this one."""
        return {"child": self.child.at(step), "given": tuple(v.at(step) for v in self.given)}

    def __repr__(self) -> str:
        parents = listed(self.parents)
        return f"{type(self).__name__}({self.child!r}{' | ' if parents else ''}{parents})"


class ConditionalGaussian(CPD):
    """A CPD that is a function of the parents plus Gaussian noise.

    Attributes
    ----------
    cov : ndarray or Noise
        Covariance of the noise.
    """

    cov: Array | Noise

    def _set_family(
        self,
        child: Variable,
        given: Variable | Iterable[Variable],
        cov: npt.ArrayLike | Noise,
        *,
        lead: bool = False,
        flat: bool = False,
    ) -> None:
        self._set_scope(child, given, cov.given if isinstance(cov, Noise) else ())
        if not isinstance(cov, Noise):
            cov = as_covariance(child, cov, lead=lead, flat=flat)
        self._set(cov=cov)

    def require_proper(self, what: str) -> None:
        """Refuse an infinite variance where there is no use for it."""
        if not isinstance(self.cov, Noise) and np.isinf(self.cov).any():
            raise ModelError(
                f"{self!r} has an infinite variance: {what}; give it a finite one",
                variable=self.child,
                cpd=self,
            )

    @property
    def noise_given(self) -> Scope:
        """The parents that the noise covariance depends on."""
        return self.cov.given if isinstance(self.cov, Noise) else ()

    def _placed(self, step: int) -> dict[str, Any]:
        placed = super()._placed(step)
        if isinstance(self.cov, Noise):
            placed["cov"] = Noise(self.cov.function, tuple(v.at(step) for v in self.cov.given))
        return placed
