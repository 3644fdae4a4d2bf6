"""Dynamic Bayesian networks: one slice of CPDs, repeated in time."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.arguments import public
from pgm.boundary import as_generator, as_mapping, is_whole
from pgm.cpds import CPD, TableCPD, by_step
from pgm.display import Drawn, Listing, Summary
from pgm.errors import ModelError
from pgm.evidence import Evidence
from pgm.factors.scope import Scope, one_name_each
from pgm.immutable import Immutable
from pgm.networks import checks
from pgm.networks.markov import FEW, product
from pgm.networks.sampling import Sample, draw_steps
from pgm.networks.static import BayesianNetwork
from pgm.resources import require_memory
from pgm.variables import Discrete

if TYPE_CHECKING:
    import networkx as nx

# Numbers of memory that a copy of a CPD at a step takes in a network, at the least.
_COPY = 100
# Letters of the factors of a slice that are shown.
FACTORS = 84


@public
class DynamicBayesianNetwork(Drawn, Immutable):
    """A prior over the states, a transition from each slice to the next, and sensors.

    States are x[0..T]. The prior holds at step 0, transition CPDs at steps 1..T, observation
    CPDs at 0..T. All CPDs are Gaussian; or all are tables, of a hidden Markov model, whose sensors
    may also be `SwitchingCPD` of continuous readings; or it is mixed: tables of discrete variables,
    and Gaussian CPDs, among which `SwitchingCPD` lets the discrete variables choose.

    Numbers of a `LinearGaussianCPD` may change from step to step: T is then as many as they are,
    `steps`, and no other number of steps is taken.

    Parameters
    ----------
    prior : sequence of CPD
        CPDs of the states at step 0; a state may depend on other states there.
    transition : sequence of CPD
        CPDs of each state given states of the step before (``x.previous``), other hidden variables
        of the same step, and inputs. A child without a prior, such as a control with noise, is
        hidden at steps 1..T.
    observation : sequence of CPD, optional
        CPDs of measurements given hidden variables of the same step, and inputs. A measurement may
        be taken any number of times a step, or never.

    Attributes
    ----------
    states : tuple of Variable
        The variables that have a prior, parents before children.
    controls : tuple of Variable
        The other hidden variables, of steps 1..T: controls with noise, and those that no variable
        depends on.
    sensors : tuple of Variable
        The children of the observation CPDs.
    inputs : tuple of Variable
        Parents that no CPD explains: they must have evidence.
    discrete : bool
        Whether all its hidden variables are discrete, and their CPDs tables rather than Gaussian.
    mixed : bool
        Whether discrete variables are hidden beside continuous ones, or choose their CPDs.
    steps : int or None
        T, where numbers of CPDs change from step to step.

    Raises
    ------
    ModelError
        If sensors do not fit the kind of the hidden variables, a state lacks its prior or
        transition, a child has two CPDs, two variables share a name, the CPDs form a cycle, or a
        parent stands where it cannot.

    Examples
    --------
    >>> from pgm import GaussianCPD, LinearGaussianCPD, Variable
    >>> x, z = Variable("x"), Variable("z")
    >>> DynamicBayesianNetwork(
    ...     prior=[GaussianCPD(x, mean=0.0, cov=1.0)],
    ...     transition=[LinearGaussianCPD(x, given={x.previous: 1.0}, cov=0.1)],
    ...     observation=[LinearGaussianCPD(z, given={x: 1.0}, cov=0.5)],
    ... )
    DynamicBayesianNetwork
      states       x
      prior        p(x)
      transition   p(x | x[t-1])
      observation  p(z | x)
    """

    prior: tuple[CPD, ...]
    transition: tuple[CPD, ...]
    observation: tuple[CPD, ...]
    states: Scope
    controls: Scope
    sensors: Scope
    inputs: Scope
    discrete: bool
    mixed: bool

    def __init__(
        self,
        prior: Iterable[CPD],
        transition: Iterable[CPD],
        observation: Iterable[CPD] = (),
    ) -> None:
        prior = checks.as_cpds(prior, "prior")
        transition = checks.as_cpds(transition, "transition")
        observation = checks.as_cpds(observation, "observation")
        everything = (*prior, *transition, *observation)
        discrete, mixed = checks.kinds((*prior, *transition), observation)
        checks.check_templates(everything)
        for cpd in (*transition, *observation):
            cpd.require_proper("only the prior of a dynamic network takes flat priors")
        one_name_each(v for cpd in everything for v in cpd.scope)
        checks.one_cpd_each(prior)
        checks.one_cpd_each((*transition, *observation))
        states = {cpd.child for cpd in prior}
        hidden = {cpd.child for cpd in transition}
        sensors = tuple(cpd.child for cpd in observation)
        checks.check_states(prior, transition, observation, states, hidden)
        checks.check_parents(prior, transition, observation, states, hidden, set(sensors))
        checks.runs(everything)
        checks.no_steps(prior, "the prior is of step 0 alone")
        by_step.among((*transition, *observation))
        transition = checks.in_order(transition, lambda cpd: cpd.given)
        parents = (v for cpd in (*transition, *observation) for v in cpd.parents)
        inputs = tuple(dict.fromkeys(v for v in parents if v.template not in hidden))
        values = {
            "prior": checks.in_order(prior, lambda cpd: cpd.given),
            "transition": transition,
            "observation": observation,
            "states": tuple(cpd.child for cpd in transition if cpd.child in states),
            "controls": tuple(cpd.child for cpd in transition if cpd.child not in states),
            "sensors": sensors,
            "inputs": inputs,
            "discrete": discrete,
            "mixed": mixed,
        }
        self._set(**values)

    @cached_property
    def layouts(self) -> dict[Any, Any]:
        """How its slices are laid out, by the choice of machine code: see `SliceLayout.of`."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__()
        state.pop("layouts", None)  # which any process finds by itself
        return state

    def replace(self, **changes: Iterable[CPD]) -> DynamicBayesianNetwork:
        """A variant with all CPDs of a part, ``prior=``, ``transition=``, ``observation=``, new."""
        parts: dict[str, Any] = {
            "prior": self.prior,
            "transition": self.transition,
            "observation": self.observation,
        }
        unknown = set(changes) - set(parts)
        if unknown:
            raise ModelError(f"replace takes {list(parts)}, not {sorted(unknown)}")
        return DynamicBayesianNetwork(**(parts | changes))

    @property
    def cpds(self) -> tuple[CPD, ...]:
        """All CPDs: prior, transition, observation."""
        return (*self.prior, *self.transition, *self.observation)

    @property
    def variables(self) -> Scope:
        """All variables: states, controls, sensors, inputs."""
        return (*self.states, *self.controls, *self.sensors, *self.inputs)

    @property
    def steps(self) -> int | None:
        """The number of steps T, where CPDs have arrays with an entry for each; else None."""
        changing = self._changing
        return None if changing is None else changing.steps

    @property
    def _changing(self) -> CPD | None:
        """A CPD whose numbers change from step to step, by which T is told."""
        return by_step.among((*self.transition, *self.observation))

    @property
    def lead(self) -> tuple[int, ...]:
        """The axes of runs of the model itself, where a `GaussianCPD` differs by run."""
        return checks.runs(self.cpds)

    @public
    def sample(
        self,
        inputs: Evidence | None = None,
        *,
        steps: int | None = None,
        runs: int | tuple[int, ...] = (),
        rng: np.random.Generator | int,
    ) -> Sample:
        """Draw the states, and the measurements of the sensors, from the model.

        Parameters
        ----------
        inputs : mapping of Variable, optional
            Values of the inputs, as evidence. For a sensor, ``pgm.sightings(step=..., given=...)``
            says when it reads; one without an entry reads once at each of the steps 1..T,
            where all its inputs are known.
        steps : int, optional
            T, where no plain array tells.
        runs : int or tuple of int
            Leading axes of independent runs, which broadcast with the model's.
        rng : numpy.random.Generator or int
            The generator of draws, or its seed.

        Returns
        -------
        Sample
            ``sample[x]`` is (*runs, T+1, d) for a state, (*runs, T, d) for a control;
            ``sample.evidence`` are the inputs and the measurements, ready for `infer`.

        Examples
        --------
        >>> from pgm.examples import walk, x
        >>> walk.sample(steps=5, runs=3, rng=0)[x].shape
        (3, 6, 1)
        """
        generator = as_generator(rng)
        asked = as_mapping(inputs, "inputs")
        return draw_steps(self, asked, steps, runs, lambda variable, rows: generator)

    @public
    def unroll(self, steps: int) -> BayesianNetwork:
        """The static network over the variables of slices 0..steps.

            p(x[0..T], z[0..T] | u) = p(x[0]) Π p(x[t] | x[t−1], u[t]) Π p(z[t] | x[t])

        Each sensor reads once a step, at step 0 too where its parents exist there. The copies of
        one CPD have it as their `origin`. Discrete inputs, which a network without time does not
        have, get equal probabilities of their states: given their evidence, marginals are the same,
        and the log-evidence of each step less by their ln(size).

        For T = `steps`, 0 or more; of a model with arrays by step it is their T.

        Examples
        --------
        >>> from pgm.examples import walk
        >>> walk.unroll(1)
        BayesianNetwork(p(x[0])  p(z[0] | x[0])  p(x[1] | x[0])  p(z[1] | x[1]))
        """
        self._require_steps(steps)
        by_step.require_last(self._changing, int(steps), ModelError)
        slices = range(int(steps) + 1)
        placed = [cpd.at(step) for step in slices for cpd in self.cpds_at(step)]
        if self.discrete or self.mixed:
            parents = dict.fromkeys(parent for cpd in placed for parent in cpd.parents)
            inputs = [p for p in parents if p.template in self.inputs and isinstance(p, Discrete)]
            placed += [TableCPD(p, table=np.full(p.size, 1.0 / p.size)) for p in inputs]
        return BayesianNetwork(placed)

    @public
    def to_networkx(self, steps: int = 1) -> nx.DiGraph:
        """The network unrolled to slices 0..steps, for pictures and questions of structure.

        Nodes are variables at steps, with the attributes ``kind`` (state, control, sensor or input)
        and ``step``; edges go from parents to children.
        """
        import networkx as nx  # here, since it is slow to import

        kinds = {
            **dict.fromkeys(self.states, "state"),
            **dict.fromkeys(self.controls, "control"),
            **dict.fromkeys(self.sensors, "sensor"),
            **dict.fromkeys(self.inputs, "input"),
        }
        self._require_steps(steps)
        graph = nx.DiGraph()
        for step in range(steps + 1):
            for cpd in self.cpds_at(step):
                for variable in cpd.scope:
                    node = variable.at(step)
                    graph.add_node(node, kind=kinds[variable.template], step=node.step)
                graph.add_edges_from((p.at(step), cpd.child.at(step)) for p in cpd.parents)
        return graph

    def _require_steps(self, steps: int) -> None:
        if not is_whole(steps) or steps < 0:
            raise ModelError(
                f"a dynamic network is unrolled to slices 0..T; give T, 0 or more, not {steps!r}"
            )
        require_memory(
            int(steps) * len((*self.transition, *self.observation)) * _COPY,
            f"the CPDs of the slices 0..{steps}",
            "take fewer steps; pgm.filter and pgm.smooth hold one copy of each",
        )

    def cpds_at(self, step: int) -> tuple[CPD, ...]:
        """The CPDs that hold at a step, as templates.

        At step 0 they are the prior and the sensors whose parents exist there, but for those with
        arrays by step, which begin at step 1; later the transition and all sensors.
        """
        if not is_whole(step) or step < 0:
            raise ModelError(f"steps are counted from 0 on; there is no step {step!r}")
        if step == 0:
            possible = set(self.states) | set(self.inputs)
            first = tuple(
                cpd
                for cpd in self.observation
                if cpd.steps is None and set(cpd.parents) <= possible
            )
            return self.prior + first
        return self.transition + self.observation

    @property
    def _title(self) -> str:
        return "DynamicBayesianNetwork"

    def _summary(self) -> Summary:
        rows = [("states", ", ".join(v.name for v in self.states[:FEW]))]
        parents = {p.template for cpd in (*self.transition, *self.observation) for p in cpd.parents}
        ends = [v for v in self.controls if v not in parents]
        drivers = [v for v in self.controls if v in parents]
        for label, found, note in (
            ("controls", drivers, ""),
            # Such as a sensor in the wrong place; but a hidden variable may have no children.
            ("hidden", ends, "; nothing depends on it: a sensor belongs in observation="),
            ("inputs", self.inputs, ""),
        ):
            if found:
                rows.append((label, ", ".join(v.name for v in found[:FEW]) + note))
        for label in ("prior", "transition", "observation"):
            cpds: tuple[CPD, ...] = getattr(self, label)
            if cpds:
                rows.append((label, product(cpds)))
        return Summary(self._title, [Listing(("", ""), rows, names=2, cell=FACTORS)])
