"""The result of inference on any graph, with beliefs of any family."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Never

import numpy as np
import numpy.typing as npt

from pgm.arguments import public
from pgm.boundary import as_generator, as_lengths
from pgm.clustergraph import Cluster
from pgm.display import Judged, NoArray, Shown, Summary
from pgm.errors import EvidenceError, Unanswered
from pgm.factors.listing import moments_frame, run_names
from pgm.factors.scope import Scope, as_scope, listed
from pgm.kernels.arrays import Array, Integers, deviation
from pgm.posteriors.completed import completed
from pgm.posteriors.labelled import Labelled
from pgm.posteriors.outcome import QUESTIONS, B, Outcome
from pgm.variables import Discrete, Variable

if TYPE_CHECKING:
    from pgm.factors import CanonicalForm, GaussianMixture, Table
    from pgm.networks import Sample
    from pgm.posteriors.associations import Found
    from pgm.posteriors.belief_kind import Kind
    from pgm.posteriors.entered import Entered
    from pgm.posteriors.innovations import Innovations
    from pgm.posteriors.lost import Lost
    from pgm.posteriors.on_card import CardBeliefs
    from pgm.posteriors.outcome import OverTime
    from pgm.posteriors.rejections import Rejections
    from pgm.posteriors.status import Status
    from pgm.posteriors.verdict import Verdict


@dataclass(frozen=True, eq=False, repr=False)
class Posterior(Labelled, Judged, Shown, NoArray, Generic[B]):
    """The beliefs of a cluster graph after a schedule of messages; leading axes are runs.

    ``posterior[x]`` is the marginal of a variable without evidence: a `Gaussian`, a `Table` of a
    discrete variable, a `GridBelief` or `ParticleBelief` with ``belief=``, or what a
    `BeliefFamily` of your own shows. Over time the last of the leading axes is of steps: 0..T of a
    state, 1..T of a hidden control (``.steps`` says); ``posterior[x.at(3)]`` is that of one step.
    Messages and beliefs of clusters are a `CanonicalForm` or a `Table`, unnormalised. What a family
    of beliefs does not have it refuses, in words.

    Attributes
    ----------
    graph : ClusterGraph
        Of a dynamic network a `DynamicGraph`, whose clusters are numbered by step: 0 is over the
        states at step 0, t = 1..T over the states at t − 1 and the slice at t.
    status : Status
        Iterations, residuals, whether each run converged, and how far the beliefs can be trusted.
    kind : Kind or None
        Which measurements the beliefs know: filtered, fixed-lag or smoothed; None without time. A
        smoother's particles are trajectories: the i-th of each step are one draw of all steps
        together.
    log_evidence_kind : str
        ``exact``; ``linearised``, of the linearised model; ``laplace``, at the fixed point of
        Taylor relinearisation; ``bethe``, on a graph with loops; ``grid`` or ``particles``;
        ``merged``, ``modes`` or ``draws``, of `Gaussians`; or ``own``, of a family of your own.
        With robust noise a lower ``bound``, a ``linearised bound``, or ``unnormalised``, if a
        density has no finite integral.

    Examples
    --------
    >>> a, b, c = pgm.variables("a b c")
    >>> net = pgm.BayesianNetwork([
    ...     pgm.GaussianCPD(a, 0.0, 1.0),
    ...     pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=1.0),
    ...     pgm.LinearGaussianCPD(c, given={b: 1.0}, cov=2.0),
    ... ])
    >>> graph = pgm.compile(net, method=pgm.JunctionTree())
    >>> posterior = pgm.infer(graph, {c: [4.0]})
    >>> posterior[a].mean, posterior[b].mean
    (array([1.]), array([2.]))
    >>> posterior.joint(a, b).cov
    array([[0.75, 0.5 ],
           [0.5 , 1.  ]])
    >>> posterior.belief(0)
    CanonicalForm(a, b)
      g = -7.10339
         h  K: a     b
      a  0     2  -1.0
      b  2    -1   1.5
    >>> posterior.message(0, 1)
    CanonicalForm(b)
      g = -1.26551
         h  K: b
      b  0   0.5

    Over time:

    >>> from pgm.examples import walk, x, z
    >>> posterior = pgm.smooth(walk, {z: [[4.0]]})
    >>> posterior[x].mean.ravel(), posterior[x].cov.ravel()
    (array([1., 2.]), array([0.75, 1.  ]))
    >>> posterior.filtered[x].mean.ravel()
    array([0., 2.])
    >>> posterior.joint(x.at(0), x.at(1)).cov
    array([[0.75, 0.5 ],
           [0.5 , 1.  ]])
    """

    _outcome: Outcome[B]
    _entered: Entered | None = None
    _verdict: Verdict | None = None

    _arrays: ClassVar[str] = ".mean and .cov by variable, posterior[x].mean"

    # Python would else iterate by asking for the variables 0, 1, ...
    __iter__: ClassVar[None] = None

    @property
    def graph(self) -> Any:  # a ClusterGraph, of which a DynamicGraph has more, such as its steps
        """The cluster graph on which the schedule ran."""
        return self._outcome.graph

    @property
    def on_card(self) -> CardBeliefs:
        """The beliefs that lie on a card, ``posterior.on_card[x].mean``.

        They stay there if evidence of `pgm.filter` or `pgm.smooth` lies there, as arrays of CuPy,
        JAX or PyTorch may, and ``compiled=pgm.Compiled(device="cuda")`` asks for the card. All else
        of the posterior comes home at the first look at it, but for `log_evidence`.

        Raises
        ------
        EvidenceError
            If the beliefs lie in this machine's memory.
        """
        raise _at_home()

    @property
    def status(self) -> Status:
        """How the schedule went: iterations, residuals, digits, and a family's own numbers."""
        return self._outcome.status

    @property
    def kind(self) -> Kind | None:
        """Which measurements the beliefs know, such as filtered; None without time."""
        return self._outcome.kind

    @property
    def log_evidence(self) -> Array:
        """The log-evidence ln p(evidence), (*runs), in nats; see `log_evidence_kind`."""
        return self._outcome.log_evidence

    @property
    def log_evidence_kind(self) -> str:
        """The kind of `log_evidence`, one of those that the class lists, such as ``exact``."""
        return self._outcome.log_evidence_kind

    @property
    def verdict(self) -> Verdict | None:
        """Of `pgm.estimate`, whether the answer can be vouched for; None of other calls."""
        return self._verdict

    def _judged(self, verdict: Verdict) -> Posterior[B]:
        """The posterior with a verdict."""
        return replace(self, _verdict=verdict)

    def __getitem__(self, variable: Variable) -> B:
        """The marginal of a variable without evidence.

        Parameters
        ----------
        variable : Variable
            ``x``, of all steps of a dynamic network, or ``x.at(3)``. A measurement ``z.at(3)`` that
            was not taken has the belief, noise included, that follows from all that the beliefs
            of its parents know; ``z`` stands for all steps, if it was read at none.

        Returns
        -------
        Gaussian, Table, GridBelief, ParticleBelief, or what a family shows
            Leading axes (*runs), followed by the steps of a variable over time.

        Raises
        ------
        EvidenceError
            If the variable has evidence, is not of the network, was not kept, or has no such step;
            of a measurement over time also if evidence does not tell its observed parents.
        ModelError
            If it stands after the last step of a grid or particles.
        """
        return self._about((variable,))[variable]

    def _about(self, variables: Iterable[object]) -> Outcome[B]:
        """The outcome that has beliefs of some variables: of all patterns of gaps where it has to.

        Of a network without time whose evidence has gaps that the schedule's outcome leaves out.
        """
        entered = self._entered
        if entered is not None and any(map(entered.leaves_out, variables)):
            return entered.by_pattern
        return self._outcome

    def means(self, variables: Iterable[Variable], *more: Never) -> Array:
        """The means of several variables, stacked.

        Parameters
        ----------
        variables : iterable of Variable
            k continuous variables without evidence, of d components each.

        Returns
        -------
        ndarray
            (*runs, k, d); (*runs, steps, k, d) of variables at all their steps.

        Raises
        ------
        EvidenceError
            If a variable has evidence, is discrete, or is not of the network, if there is none, or
            if they differ in their numbers of components or steps.

        Examples
        --------
        >>> from pgm.examples import a, b, pair
        >>> posterior = pgm.infer(pgm.compile(pair), {})
        >>> posterior.means([a, b]).shape, posterior.covs([a, b]).shape
        ((2, 1), (2, 1, 1))
        """
        require_one_list("means", variables, more)
        found = alike(variables)
        return self._about(found)._stacked(found)[0]

    def covs(self, variables: Iterable[Variable], *more: Never) -> Array:
        """The covariances of several variables, each by itself: (*runs, k, d, d); see `means`."""
        require_one_list("covs", variables, more)
        found = alike(variables)
        return self._about(found)._stacked(found)[1]

    def stds(self, variables: Iterable[Variable], *more: Never) -> Array:
        """The standard deviations of several variables: (*runs, k, d); see `means`."""
        require_one_list("stds", variables, more)
        return deviation(self.covs(variables))

    def to_frame(self, variables: Iterable[Variable] | None = None, *more: Never) -> Any:
        """The completed table of records, or moments of several variables, as a data frame.

        Without variables, of a network without time, it has a row a run, with the values that were
        observed, and where there are gaps the means of continuous variables and the likeliest
        states of discrete ones. First are the columns of the evidence, in its order, then those of
        other variables that have a belief: by the variable's name, ``x.east`` of a component of a
        vector. They are followed by ``std_<column>``, standard deviations, and
        ``probability_<column>``, of the states: 0 and 1 where it was observed. A gap without a
        belief, of a run whose evidence is impossible or of a reading of robust noise, is NaN, or
        None.

        With variables it has the means and standard deviations of these. A row for each run, step
        and variable, in the index: the level ``run``, or ``run_0``, ``run_1``, ... where runs have
        several axes, the level ``step``, where the variables have any, and the level ``variable``,
        of names. Columns are ``mean_<component>``, then ``std_<component>``, and ``value`` stands
        for the component of several scalars; see `means`.

        ``frame.attrs["units"]`` has the units of columns, where they are known.

        Raises
        ------
        EvidenceError
            As of `means`, or if the variables' components have other names or units. Without
            variables, if there is time, or two columns would have one name.
        ImportError
            Where pandas is missing.

        Examples
        --------
        >>> from pgm.examples import a, b, pair
        >>> records = pgm.records({"a": [None, 1.0], "b": [2.0, None]}, pair)
        >>> frame = pgm.infer(pgm.compile(pair), records).to_frame()
        >>> list(frame.columns), frame.round(3).to_numpy().tolist()
        (['a', 'b', 'std_a', 'std_b'], [[1.0, 2.0, 0.707, 0.0], [1.0, 1.0, 0.0, 1.0]])

        >>> x, y = (pgm.Variable(name, components=("east", "north")) for name in "xy")
        >>> priors = [pgm.GaussianCPD(v, mean=[0.0, k], cov=0.25) for k, v in enumerate((x, y))]
        >>> posterior = pgm.infer(pgm.compile(pgm.BayesianNetwork(priors)), {})
        >>> posterior.to_frame([x, y]).loc["y"].tolist()
        [0.0, 1.0, 0.5, 0.5]
        """
        require_one_list("to_frame", variables, more)
        if variables is None:
            if self._entered is None:
                raise EvidenceError(
                    f"{self._title} is no table of records, which a network without time has: name "
                    "the variables, posterior.to_frame([x])"
                )
            return completed(self, self._entered)
        found = alike(variables)
        labels = found[0].components
        other = next((v for v in found if v.components != labels), None)
        if len(labels) == 1 and other is not None:
            labels, other = ("value",), None
        if other is not None:
            raise EvidenceError(
                f"{other!r} has the components {other.components}, {found[0]!r} has "
                f"{found[0].components}: a frame has columns of one kind of variables",
                variable=other,
            )
        units = found[0].units
        if (odd := next((v for v in found if v.units != units), None)) is not None:
            raise EvidenceError(
                f"{odd!r} is in the units {listed(odd.units)}, {found[0]!r} in {listed(units)}: a "
                "column of a frame has one unit",
                variable=odd,
            )
        mean, cov = self._about(found)._stacked(found)
        steps = getattr(self[found[0]], "steps", None)
        lead = mean.shape[:-2]
        levels: list[Any] = [*map(range, lead), [repr(v) for v in found]]
        titles = run_names(len(lead) - (steps is not None))
        if steps is not None:
            levels[-2], titles = steps, [*titles, "step"]
        titles = [*titles, "variable"]
        what = "Posterior.to_frame()"
        own = [found[0].unit_of(each) for each in found[0].components]
        return moments_frame(mean, deviation(cov), labels, own, levels, titles, what)

    def joint(self, *variables: Variable) -> B:
        """The joint of some variables without evidence, in the order given.

        Of a dynamic network it knows the measurements that the belief at the latest of the steps
        knows: after filtering those up to that step, after smoothing all of them, as `kind` says.

        Parameters
        ----------
        *variables : Variable
            Of a dynamic network at steps, ``x.at(3), x.at(4)``; of a grid and of particles also
            ``x, m``, of all steps.

        Returns
        -------
        Gaussian, Table, GridBelief, ParticleBelief, or what a family shows
            Leading axes (*runs).

        Raises
        ------
        EvidenceError, ModelError
            If a variable has evidence, is not of the network or is named twice, none is given, or
            the family has no joint of several steps.
        GraphError
            If no cluster of a graph with loops holds them all, or the result would take too much
            memory.
        NumericalError
            If windows of an iterated fixed lag were solved in twice the digits.
        """
        found: B = self._ask("joint", self._about(variables))(*variables)
        return found

    @public
    def sample(
        self, size: int | tuple[int, ...] = (), *, rng: np.random.Generator | int
    ) -> dict[Variable, Any]:
        """Draws of all variables without evidence together, from their joint posterior.

        Of a tree they are drawn cluster by cluster, each given those above it, and of a smoothed
        chain step by step, from the last to the first: whole trajectories. On a grid these stand at
        the centres of cells, as its beliefs do; particles are drawn from their own trajectories.

        Of modes and states the modes are drawn first, with the smoothed probabilities of each and
        of each two successive ones, and what sightings are of with them; then the states, as a
        smoother of these modes alone has them. Where Gaussians were merged, the moments at each
        step are those of no joint: draws then differ from the posterior by about as much as this
        does from the exact one, and a larger ``pgm.Gaussians(count)`` brings all of them together.

        Parameters
        ----------
        size : int or tuple of int
            How many draws of each run.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Returns
        -------
        dict
            By variable (*size, *runs, d), and of discrete ones indices of states (*size, *runs).
            Over time there is an axis of steps after those of runs: 0..T of a state, 1..T of a
            hidden control.

        Raises
        ------
        GraphError
            If the graph has loops.
        EvidenceError
            If the posterior is of a filter or a fixed lag, whose beliefs at each step know other
            measurements; or the family draws nothing.
        ModelError
            If `size` is no number of draws or would not fit into memory, or `rng` is neither a
            generator nor a seed.

        Examples
        --------
        >>> from pgm.examples import walk, x, z
        >>> smoothed = pgm.smooth(walk, {z: [[4.0]]})
        >>> drawn = smoothed.sample(10_000, rng=0)[x]
        >>> drawn.shape, drawn.mean(axis=0).ravel().round(1)
        ((10000, 2, 1), array([1., 2.]))

        References
        ----------
        Frühwirth-Schnatter, Data augmentation and dynamic linear models, 1994; Koller & Friedman,
        Probabilistic Graphical Models, 2009, section 12.1.
        """
        shape = as_lengths(size, "of each run")
        left_out = self._entered is not None and self._entered.left_out
        outcome = self._entered.by_pattern if self._entered and left_out else self._outcome
        found = self._ask("sample", outcome)(math.prod(shape), as_generator(rng))
        return {v: values.reshape((*shape, *values.shape[1:])) for v, values in found.items()}

    def message(self, source: int | Cluster, target: int | Cluster) -> CanonicalForm | Table:
        """The message from one cluster to a neighbour, over their sepset, unnormalised.

        Parameters
        ----------
        source, target : int or Cluster

        Returns
        -------
        CanonicalForm or Table
            The g of a form includes the log-density of the measurements that went into it.

        Raises
        ------
        GraphError
            If the clusters are not joined, the family has no messages, or this one was not sent:
            backward messages are those of smoothing alone.
        NumericalError
            If it has no canonical form, since a covariance is singular.
        """
        return self._ask("message")(source, target)  # type: ignore[no-any-return]

    def belief(self, cluster: int | Cluster) -> CanonicalForm | Table | GaussianMixture:
        """The belief of a cluster over its variables without evidence, unnormalised.

        Parameters
        ----------
        cluster : int or Cluster

        Returns
        -------
        CanonicalForm, Table or GaussianMixture
            Its integral is the evidence that its messages know: all of it after smoothing. Of
            several modes it is a mixture, of mass one.

        Raises
        ------
        GraphError
            If the graph has no such cluster, the family no such beliefs, or several modes of a
            cluster whose variables are all observed.
        NumericalError
            If it has no canonical form, since a covariance is singular.
        """
        return self._ask("belief")(cluster)  # type: ignore[no-any-return]

    def potential(self, cluster: int | Cluster) -> CanonicalForm | Table:
        """The potential of a cluster: the product of its CPDs, with their evidence put in.

        It is over the cluster's variables without evidence, nonlinear CPDs as they were linearised
        last. Its product with all messages to the cluster, if the schedule has sent these, is the
        cluster's belief.

        Parameters
        ----------
        cluster : int or Cluster

        Returns
        -------
        CanonicalForm or Table

        Raises
        ------
        GraphError
            If the graph has no such cluster, or the family no potentials.
        NumericalError
            If it has no canonical form, since a noise is singular.
        """
        return self._ask("potential")(cluster)  # type: ignore[no-any-return]

    @property
    def filtered(self) -> OverTime[B]:
        """The beliefs of the forward pass, ``posterior.filtered[x]``; of a filter, the same.

        A fixed-lag smoother that iterates slides a window of lag + 1 steps along the chain: then
        they are the marginals of each window at its newest step.
        """
        return self._over_time("filtered")

    @property
    def predicted(self) -> OverTime[B]:
        r"""Beliefs given the measurements before each step, as CPDs were linearised last.

        ``predicted[x]`` is the marginal of a state or a hidden control at its steps. Under every
        schedule ``predicted[z]`` is the belief of a sensor's measurement before its own value is
        taken, noise included:

        .. math:: z_t \mid z_0, \dots, z_{t-1} \sim N(H \mu_t + b,\; H P_t H^\top + R)

        with the predicted mean μ and covariance P of the states, and the sensor's linearisation
        H, b and noise R. At steps without a reading, such as those after the last one, that is a
        forecast from all readings before.

        The rows of ``predicted[z]``, told by ``.steps`` of a Gaussian, are those of evidence that
        is an array, 1..T (``steps=`` makes T larger than the array); else all steps, 0..T, however
        many sightings each has, or 1..T where an observed parent of the sensor is an array, or a
        hidden one is a control. If the sightings themselves have observed parents, ``given=``, rows
        are the sightings in their order, and a sighting of NaN tells the parents where nothing was
        read. ``predicted[z.at(3)]`` is that of one step.

        A measured angle is within half a turn of its reading or, without one, of the row before.
        Robust noise counts with the `cov` of its CPD. Under a flat prior a component that depends
        on a direction of which nothing is known has an infinite variance, and no covariances.

        Of particles and grids ``predicted[z]`` is a `PointMixture`, the sum of the sensor's density
        over the points, with angles within half a turn of zero. Particles of a proposal have looked
        at their step's readings, and their weights make up for it.

        Raises
        ------
        EvidenceError
            If a variable is neither hidden nor a measurement, has no such step, or depends on
            observed parents that evidence does not tell.

        Examples
        --------
        >>> from pgm.examples import walk, x, z
        >>> filtered = pgm.filter(walk, {z: [[4.0]]}, steps=3)
        >>> filtered.predicted[z].mean.ravel(), filtered.predicted[z].std.ravel().round(3)
        (array([0., 2., 2.]), array([2.   , 2.   , 2.236]))
        """
        return self._over_time("predicted")

    @property
    def left_out(self) -> Mapping[Variable, Any]:
        r"""By sensor, the belief of each reading given all readings but its own, of a smoother.

        .. math:: p(z_k \mid z_j,\, j \neq k)

        It is found from the smoothed beliefs, by removing the reading's own likelihood, without
        running again: leave-one-out cross-validation of a model, and of each of its readings, noise
        included. A reading without noise, or one that tells nearly all that is known of what it
        measures, is left out by a pass of its own. Rows are the readings in the order of the
        evidence, as in `innovations`. Nonlinear sensors stay linearised, and robust noise weighed,
        as they were with the reading.
        Grids multiply all densities but the reading's own. Particles divide their weights by its
        density, which fails where it tells more than all others do: ``.pareto`` is the shape of
        their weights, and a `ParticleWarning` tells where it is above 0.7. Chains that switch are
        smoothed again, without many readings at a time, one in each copy.

        Returns
        -------
        mapping of Variable to Gaussian, GaussianMixture, Table or PointMixture
            (*runs, M, d): the belief of M readings of d components, with their ``.steps``. A
            `Table` has rows (*runs, M) alone.

        Raises
        ------
        EvidenceError
            If the posterior is of a filter or a fixed lag, or the variable was not read.
        NumericalError
            If without a reading even twice the digits of float64 are too few.

        Warns
        -----
        ParticleWarning
            If particles cannot leave out a reading.

        References
        ----------
        de Jong, A cross-validation filter for time series models, 1988. Vehtari, Gelman & Gabry,
        Practical Bayesian model evaluation using leave-one-out cross-validation and WAIC, 2017.

        Examples
        --------
        >>> from pgm.examples import walk, x, z
        >>> found = pgm.smooth(walk, {z: [[4.0], [2.0]]}).left_out[z]
        >>> found.mean.ravel().round(2), found.cov.ravel().round(2)
        (array([0.8, 2. ]), array([3.2, 4. ]))
        """
        return self._ask("left_out")  # type: ignore[no-any-return]

    @property
    def innovations(self) -> Mapping[Variable, Innovations]:
        """By sensor, the `Innovations`: how far measurements were from their prediction.

        Of mixtures of Gaussians, as of chains that switch, they are those of the mixture, by its
        mean and covariance: the NIS has the right mean then, and no χ² distribution.
        """
        return self._ask("innovations")  # type: ignore[no-any-return]

    @property
    def lost(self) -> Lost:
        """Where the filter is probably lost, as its innovations tell."""
        return self._ask("lost")  # type: ignore[no-any-return]

    @property
    def nonlinearity(self) -> Mapping[Variable, Array]:
        r"""How nonlinear CPDs are over the beliefs where they were linearised, by their children.

        .. math:: \operatorname{tr} \Sigma_n (\Sigma_n + R)^{-1}

        R is the covariance of the CPD's own noise, and Σₙ that of what the best line through its
        function leaves over the belief of its hidden parents. The trace lies between 0 and the
        number of components measured: so many of them does the error govern, rather than the noise.
        Above ½ no line at this belief is to be trusted, whichever rule has found it: iterate, so
        that lines are found at narrower beliefs, or take a `Grid` or `Particles`.

        The belief is that before the reading or the motion, where CPDs were linearised once; where
        they were linearised again, the one that the posterior has.

        Returns
        -------
        mapping of Variable to ndarray
            (*runs, M) of a sensor, a figure for each of its M readings, NaN where nothing was read;
            (*runs, T) of a state, for the steps 1..T. Affine CPDs have none.

        References
        ----------
        García-Fernández, Svensson, Morelande & Särkkä, Posterior linearization filter, 2015.

        Examples
        --------
        >>> from pgm.examples import squares, z
        >>> print(pgm.filter(squares, {z: [[9.0]]}).nonlinearity)
        Nonlinearities(z)
          z: 1 to 1, median 1; 1 of 1 above 0.5
        >>> print(pgm.smooth(squares, {z: [[9.0]]}, iterations=20).nonlinearity)
        Nonlinearities(z)
          z: 1.54e-09 to 1.54e-09, median 1.54e-09; 0 of 1 above 0.5
        """
        return self._ask("nonlinearity")  # type: ignore[no-any-return]

    @property
    def rejected(self) -> Mapping[Variable, Rejections]:
        """By sensor with a gate, the `Rejections`: which measurements it left out."""
        return self._ask("rejected")  # type: ignore[no-any-return]

    @property
    def weights(self) -> Mapping[Any, Array]:
        """By sensor, (*runs, M): the weight w of each of its M measurements.

        Of a network without time it is (*runs), by observed variable, which is one measurement; of
        a `MarkovNetwork` by factor, ``posterior.weights[factor]``: each `NonlinearGaussianFactor`,
        and each CPD of robust noise. A measurement counts as a Gaussian of covariance `cov` / w: 1
        of Gaussian noise, less of robust noise. NaN where nothing was measured.
        """
        return self._ask("weights")  # type: ignore[no-any-return]

    @property
    def associations(self) -> Found:
        """By sensor, the `Associations` of measurements of a parent given as `unknown`.

        They tell the candidate, such as a landmark, that each was taken to be of.
        """
        return self._ask("associations")  # type: ignore[no-any-return]

    @public
    def report(
        self,
        path: str | PathLike[str],
        *,
        truth: Mapping[Variable, npt.ArrayLike] | Sample | None = None,
    ) -> Path:
        """Write one page that says how far the beliefs may be trusted, for a browser.

        On top it says in a line each, with a mark, what its sections find:

        - the verdict of `pgm.estimate`, of a posterior that has one;
        - whether the schedule converged, and its residuals;
        - the decimal digits that rounding leaves;
        - stretches at which the belief was probably lost, `lost`;
        - where CPDs were linearised though no line is right, `nonlinearity`;
        - sensors ranked by their innovations, with the NIS at each step in the band of a right
          model;
        - with a truth the RMSE, the NEES and the share of truths inside 95 % regions.

        A chain has its path beside them, as `pgm.view` draws it, with the truth and the stretches
        that were lost. Of what a family cannot tell, as particles their innovations, a line says
        that it is not known, and why. The page asks nothing of a network.

        Parameters
        ----------
        path : str or path-like
            The file's path, like ``"report.html"``; an old one is replaced.
        truth : mapping of Variable to array_like, or Sample, optional
            True values: of a state (*runs, T+1, d), of a hidden control (*runs, T, d), without time
            (*runs, d), or any without the axes of runs, for all of them; of discrete variables
            names or indices of states, without the last axis. NaN, or −1, is not known. Variables
            that were observed are left out, so that `model.sample()` may be given.

        Returns
        -------
        Path
            The file's path.

        Raises
        ------
        GraphError
            If the truth is none, is of no variable of the network, or does not fit its beliefs.
        ModelError
            If a value of the truth is no number or no state.
        OSError
            If the file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> from pgm.examples import walk, z
        >>> drawn = walk.sample(steps=20, rng=1)
        >>> smoothed = pgm.smooth(walk, drawn.evidence)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     smoothed.report(f"{folder}/report.html", truth=drawn).name
        'report.html'
        """
        return self._report(path, truth)

    def __getattr__(self, name: str) -> Any:
        # What a family alone has, such as the grid at the resolution that was used.
        if name.startswith("_"):
            raise AttributeError(name)
        if name in QUESTIONS:  # which Python asks for again, after an AttributeError
            return self._ask(name)
        if name == "on_card":  # so it is here
            raise _at_home()
        try:
            if name in _INSIDE:
                raise AttributeError
            return getattr(self._outcome, name)
        except AttributeError:
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}") from None

    def __dir__(self) -> list[str]:
        more = (n for n in dir(self._outcome) if not n.startswith("_") and n not in _INSIDE)
        return sorted({*super().__dir__(), *more})

    def _ask(self, question: str, outcome: Outcome[B] | None = None) -> Any:
        """The outcome's answer to one of `QUESTIONS`, or its refusal."""
        outcome = self._outcome if outcome is None else outcome
        if not hasattr(type(outcome), question) and question not in vars(outcome):
            raise outcome.refusal(question)
        return getattr(outcome, question)

    def _over_time(self, question: str) -> OverTime[B]:
        """The marginals of a pass that a question is about: a posterior, if they are an outcome."""
        found = self._ask(question)
        if isinstance(found, Outcome):
            found = self if found is self._outcome else Posterior(found)
        return found  # type: ignore[no-any-return]

    def _moments(self, variable: Variable) -> Any:
        return self._about((variable,))._moments(variable)

    def _readings_of(self, variable: Variable) -> tuple[Integers, Array]:
        return self._outcome._readings_of(variable)

    @property
    def _squares(self) -> Mapping[Variable, tuple[Array, Integers]]:
        return self._outcome._squares

    @property
    def _hidden(self) -> Scope:
        return self._outcome._hidden

    def _why_unsettled(self) -> str:
        return self._outcome._why_unsettled()

    def _doubt(self) -> str:
        return self._outcome._doubt()

    def _misfit(self) -> str:
        return self._outcome._misfit()

    @property
    def _title(self) -> str:
        return self._outcome._title

    def _summary(self) -> Summary:
        found = self._outcome._summary()
        if self._verdict is None:
            return found
        return Summary(found.title, [self._verdict.headline, *found.parts])


# What every outcome has for pages and refusals, and is no answer to a user.
_INSIDE = frozenset(n for n in dir(Outcome) if not n.startswith("_"))


def _at_home() -> Unanswered:
    """The error for arrays on a card of beliefs that lie in this machine's memory."""
    return Unanswered(
        "the beliefs lie in this machine's memory; they stay on a card if evidence lies there, "
        'and pgm.filter or pgm.smooth is given compiled=pgm.Compiled(device="cuda")'
    )


def require_one_list(name: str, first: Any, more: Sequence[Any]) -> None:
    """Refuse variables that are given one after the other."""
    if more:
        every = ", ".join(map(repr, (first, *more)))
        raise TypeError(f"{name} takes several variables as one list: {name}([{every}])")


def alike(variables: Iterable[Variable]) -> Scope:
    """The variables; an `EvidenceError` if they have no moments that can be stacked."""
    found = as_scope(variables)
    if not found:
        raise EvidenceError("moments are stacked of one or more variables; there is none")
    if len({len(v.components) for v in found}) == 1 and Discrete not in set(map(type, found)):
        return found
    for variable in found:
        if isinstance(variable, Discrete):
            raise EvidenceError(f"{variable!r} is discrete, and has no mean", variable=variable)
        if variable.dimension != found[0].dimension:
            raise EvidenceError(
                f"{variable!r} has {variable.dimension} components, {found[0]!r} has "
                f"{found[0].dimension}: moments are stacked of variables with equal numbers",
                variable=variable,
            )
    return found


def require_variable(variable: Variable) -> Variable:
    """The same variable; any other key, as a name or several variables, is an `EvidenceError`."""
    if isinstance(variable, Variable):
        return variable
    if isinstance(variable, tuple | list | set):
        raise EvidenceError(
            f"{variable!r} is asked for where one variable was due: of several, ask a posterior "
            "for posterior.joint(a, b), an online belief for each by itself"
        )
    raise EvidenceError(f"results are asked for by variable, not by {variable!r}: posterior[x]")
