"""The solution of a chain by each kind of schedule, in float64 and in twice the digits."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from pgm.compile import BalancedGraph, DynamicGraph
from pgm.display import titled
from pgm.errors import GraphError
from pgm.inference.chain import careful, fixed_lag, forward, parallel, smoother
from pgm.inference.chain.backward import Beliefs, Reverse
from pgm.inference.chain.balanced import BalancedPosterior
from pgm.inference.chain.careful import Careful
from pgm.inference.chain.fixed_lag import Lagged, Windows
from pgm.inference.chain.forward import Filtered, Forward
from pgm.inference.chain.plan import ChainPlan
from pgm.inference.chain.posterior import ChainPosterior
from pgm.inference.chain.readings import Room
from pgm.inference.schedule import Calibration, FixedLag, Smoothing
from pgm.inference.status import FILTERED, SMOOTHED, Kind, Status, digits
from pgm.kernels.arrays import Array


class Solver(ABC):
    """The solution of a chain by one kind of schedule.

    `starts` says whether it takes means at which everything is linearised first.
    """

    starts: ClassVar[bool] = False

    def __init__(self, graph: DynamicGraph, schedule: Any) -> None:
        self.graph, self.schedule = graph, schedule
        self.balanced = isinstance(graph, BalancedGraph)
        if self.balanced and getattr(schedule, "gate", None) is not None:
            raise GraphError(
                f"{schedule!r}: a gate decides at one predicted belief after another, and "
                f"{titled(graph)} solves for all steps at once: compile without pgm.Balanced()"
            )

    @abstractmethod
    def solve(self, plan: ChainPlan, start: Array | None, room: Room | None) -> ChainPosterior:
        """In float64."""

    @abstractmethod
    def carefully(self, plan: ChainPlan, start: Array | None) -> ChainPosterior:
        """In twice the digits, one step after another."""

    def _posterior(
        self,
        plan: ChainPlan,
        kind: Kind,
        swept: Forward | Filtered,
        status: Status,
        smoothed: Beliefs | None = None,
        reverse: Reverse | None = None,
        careful: Careful | None = None,
        windows: Windows | None = None,
        error: Array | None = None,
    ) -> ChainPosterior:
        if error is not None:
            status = status.with_digits(digits(error, plan.lead))
        parts = kind, plan, swept, smoothed, reverse, careful, windows
        if isinstance(self.graph, BalancedGraph):
            return BalancedPosterior(self.graph, status, *parts)
        return ChainPosterior(self.graph, status, *parts)


class FilterSolver(Solver):
    """Forward messages alone."""

    def solve(self, plan: ChainPlan, start: Array | None, room: Room | None) -> ChainPosterior:
        """Step by step, or in rounds on a balanced tree."""
        ahead: Forward | Filtered
        if self.balanced:
            self._refuse_nonlinear(plan)
            ahead = parallel.whole(parallel.run(plan))
            status = Status.of([], np.ones(plan.runs, dtype=bool), plan.lead)
        elif plan.runs >= forward.MANY and not any(sensor.exact for sensor in plan.sensors):
            # Of many runs only the beliefs, as long as nothing else is asked for.
            ahead, status = forward.filtered(plan, self.schedule, room)
        else:
            ahead, status = forward.run(plan, self.schedule)
        return self._posterior(plan, FILTERED, ahead, status)

    def carefully(self, plan: ChainPlan, start: Array | None) -> ChainPosterior:
        """Step by step, each belief in pairs of float64."""
        if self.balanced:
            self._refuse_nonlinear(plan)
        swept, status = careful.sweep(plan, self.schedule)
        return self._posterior(
            plan, FILTERED, swept.forward, status, careful=swept, error=swept.error
        )

    def _refuse_nonlinear(self, plan: ChainPlan) -> None:
        for family in plan.families:
            if not family.settled:
                kind = "of robust noise" if family.exact else "nonlinear"
                raise GraphError(
                    f"{family.cpd!r} is {kind}, and {titled(self.graph)} solves for all steps "
                    "at once, where a filter linearises at the belief before: compile without "
                    "pgm.Balanced(), or smooth"
                )


class LagSolver(Solver):
    """Backward messages over a lag; windows, where CPDs are linearised again, see to digits."""

    def __init__(self, graph: DynamicGraph, schedule: FixedLag) -> None:
        super().__init__(graph, schedule)
        if self.balanced:
            raise GraphError(
                f"{schedule!r} goes along a chain of slices, step after step, which "
                f"{titled(graph)} is not: compile without pgm.Balanced()"
            )

    def solve(self, plan: ChainPlan, start: Array | None, room: Room | None) -> ChainPosterior:
        """Once and back over the lag, or window after window."""
        return self._lagged(plan, fixed_lag.smooth)

    def carefully(self, plan: ChainPlan, start: Array | None) -> ChainPosterior:
        """The same in pairs of float64, which windows decide upon for themselves."""
        return self._lagged(plan, fixed_lag.carefully)

    def _lagged(
        self, plan: ChainPlan, once: Callable[[ChainPlan, FixedLag], tuple[Lagged, Status]]
    ) -> ChainPosterior:
        slides = fixed_lag.slides(plan, self.schedule)
        found, status = (fixed_lag.slide if slides else once)(plan, self.schedule)
        return self._posterior(
            plan,
            Kind(self.schedule.lag),
            found.forward,
            status,
            found.beliefs,
            found.reverse,
            found.careful,
            found.windows,
            found.error,
        )


class SmootherSolver(Solver):
    """Messages forward and back."""

    starts = True

    def __init__(self, graph: DynamicGraph, schedule: Calibration) -> None:
        if not isinstance(schedule, Smoothing):
            schedule = Smoothing(schedule.iterations, schedule.tolerance)
        super().__init__(graph, schedule)

    def solve(self, plan: ChainPlan, start: Array | None, room: Room | None) -> ChainPosterior:
        """A sweep there and back, or rounds, iterated."""
        smooth = smoother.scan if self.balanced else smoother.smooth
        found, status = smooth(plan, self.schedule, start)
        ahead = parallel.whole(found.forward)
        return self._posterior(plan, SMOOTHED, ahead, status, found.beliefs, found.reverse)

    def carefully(self, plan: ChainPlan, start: Array | None) -> ChainPosterior:
        """Sweeps in pairs of float64, iterated."""
        found, status = smoother.carefully(plan, self.schedule, start, reckoned=self.balanced)
        swept = found.careful
        return self._posterior(
            plan,
            SMOOTHED,
            swept.forward,
            status,
            found.beliefs,
            careful=swept,
            error=found.error,
        )
