"""Beliefs of measurements that a robot's loop has yet to take."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pgm.display import NoArray, Shown, Summary
from pgm.errors import EvidenceError, Unanswered
from pgm.factors.scope import listed, namesake
from pgm.networks import DynamicBayesianNetwork
from pgm.posteriors.belief_kind import PREDICTED
from pgm.posteriors.posterior import require_variable
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.posteriors.online_belief import OnlineBelief


class Predictions(Shown, NoArray):
    """The beliefs of measurements of a step, before they are taken; `OnlineBelief.predicted`.

    ``predicted[z]`` is that of a sensor, noise included, and ``predicted.of(z, given={m: ...})``
    that of a sensor with observed parents. ``predicted[x]`` of a hidden variable is ``belief[x]``.

    Examples
    --------
    >>> import pgm
    >>> from pgm.examples import walk, z
    >>> robot = pgm.OnlineFilter(walk)
    >>> belief = robot.predict(robot.initial())
    >>> belief.predicted[z].mean, belief.predicted[z].std
    (array([0.]), array([2.]))
    """

    def __init__(self, belief: OnlineBelief) -> None:
        self._belief = belief

    def __getitem__(self, variable: Variable) -> Any:
        """The belief of a measurement of a sensor without observed parents; see `of`."""
        return self.of(variable)

    def of(self, variable: Variable, given: Mapping[Variable, Any] | None = None) -> Any:
        r"""The belief of a measurement of a sensor, noise included, before it is taken.

        Of a Gaussian belief it is

        .. math:: z \sim N(H \mu + b,\; H P H^\top + R)

        with the predicted mean μ and covariance P of the hidden variables, and the sensor
        linearised there. Robust noise counts with the `cov` of its CPD. Under a flat prior a
        component that depends on a direction of which nothing is known has an infinite variance.

        Parameters
        ----------
        variable : Variable
            A sensor's, or a hidden one.
        given : mapping of Variable, optional
            The sensor's observed parents, as `pgm.sightings` takes them: (..., M, d), a row for
            each of M measurements; or `pgm.constant`.

        Returns
        -------
        Gaussian, GaussianMixture, Table or PointMixture
            Leading axes are runs, followed by the rows M where `given` has any. Of a hidden Markov
            model a table or a mixture, of particles and grids a `PointMixture`.

        Raises
        ------
        EvidenceError
            If the belief knows measurements of its step, the variable is unknown, or observed
            parents are missing or do not fit; or if beliefs of the family have none online.
        """
        belief = self._belief
        require_variable(variable)
        if belief.kind != PREDICTED:
            raise Unanswered(
                f"{belief._title} knows measurements of its step: ask the belief that predict "
                "returned, before they were taken",
                variable=variable,
                step=belief.step,
            )
        if variable.step not in (None, belief.step):
            raise EvidenceError(
                f"{belief._title} has beliefs of measurements at step {belief.step}, not of "
                f"{variable!r}",
                variable=variable,
                step=belief.step,
            )
        if given is not None and not isinstance(given, Mapping):
            raise EvidenceError(
                f"predicted.of({variable.template.name}, given=) takes a mapping of observed "
                f"parents to rows, not {type(given).__name__}",
                variable=variable,
            )
        return belief._measurement(variable.template, {} if given is None else given)

    @property
    def _title(self) -> str:
        return f"Predictions(of {self._belief._title})"

    def _summary(self) -> Summary:
        return Summary(
            self._title, ["ask for a sensor's: predicted[z], predicted.of(z, given=...)"]
        )


def require_parents(
    model: DynamicBayesianNetwork, variable: Variable, given: Mapping[Variable, Any], step: int
) -> None:
    """Refuse a variable that is no sensor, or whose observed parents are not all given."""
    if variable not in model.sensors:
        raise EvidenceError(
            f"{variable!r} is no sensor, whose measurements could be predicted; there are "
            f"{list(model.sensors)}{namesake(variable, model.sensors)}",
            variable=variable,
            step=step,
        )
    cpd = next(cpd for cpd in model.observation if cpd.child == variable)
    hidden = {each.child for each in model.transition}
    missing = [p for p in cpd.parents if p.template not in hidden and p not in given]
    if missing:
        rows = ", ".join(f"{each.name}: ..." for each in missing)
        raise EvidenceError(
            f"a measurement of {variable!r} depends on [{listed(missing)}], which nothing tells: "
            f"belief.predicted.of({variable.name}, given={{{rows}}})",
            variable=variable,
            cpd=cpd,
            step=step,
        )
