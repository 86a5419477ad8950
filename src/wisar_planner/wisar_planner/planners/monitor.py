"""The clock of a search, what it tells, and whether it was told to stop."""

from __future__ import annotations

import math
import time

from wisar_planner.errors import FloatArray
from wisar_planner.planners.base import OnProgress, PlanProgress, ShouldStop
from wisar_planner.search.problem import SearchProblem
from wisar_planner.search.seen_area import probability_seen

# Least time between two reports, s: what a path sees takes a fraction of a millisecond to compute.
_REPORTS_S = 0.02


class Monitor:
    """The budget of a plan, the best it has to tell, and whether it was told to stop.

    Parameters
    ----------
    problem : SearchProblem
        What is planned.
    seconds : float
        Time budget, s; infinite where moves are counted.
    moves : float
        Budget of moves; infinite where time is.
    on_progress, should_stop : callable, optional
        See `Planner.plan`.
    """

    def __init__(
        self,
        problem: SearchProblem,
        seconds: float,
        moves: float,
        on_progress: OnProgress | None,
        should_stop: ShouldStop | None,
    ) -> None:
        self._began = time.monotonic()
        self.seconds, self.moves = seconds, moves
        self._moved = 0
        self._problem = problem
        self._on_progress = on_progress
        self._should_stop = should_stop
        self._best = 0.0
        self._reported_at = -math.inf
        self._stopped = False

    def count(self, moves: int) -> None:
        """Count some moves as done."""
        self._moved += moves

    def spent(self) -> float:
        """Return the share of the budget that is spent."""
        return (time.monotonic() - self._began) / self.seconds + self._moved / self.moves

    def seconds_until(self, share: float) -> float:
        """Return the time until a share of the budget is spent, s; infinite without a limit."""
        left = share - self.spent()
        return max(0.0, left * self.seconds) if math.isfinite(self.seconds) else math.inf

    def moves_until(self, share: float) -> int | None:
        """Return the moves until a share of the budget is spent, at least 1; None: no limit."""
        left = share - self.spent()
        return max(1, math.ceil(left * self.moves)) if math.isfinite(self.moves) else None

    def ended(self) -> bool:
        """Return whether the budget is spent, or the plan was told to stop."""
        return self._stopped or self.spent() >= 1.0

    def stopped(self) -> bool:
        """Return whether the plan was told to stop when it last reported."""
        return self._stopped

    def asked_to_stop(self) -> bool:
        """Ask whether to stop."""
        self._stopped = self._should_stop is not None and self._should_stop()
        return self._stopped

    def report(self, waypoints: FloatArray, fraction: float = 0.0) -> None:
        """Tell what the best path so far sees, if that was not just done; ask whether to stop.

        Parameters
        ----------
        waypoints : (N + 1, 2) float64
            The newest path, m.
        fraction : float
            Share of the work that is done, where that is more than the share of the budget.
        """
        now = time.monotonic()
        if self._on_progress is not None and now - self._reported_at >= _REPORTS_S:
            self._reported_at = now
            problem = self._problem
            seen = probability_seen(problem.pdm, waypoints, problem.swath_radius)
            self._best = max(self._best, seen)
            fraction = min(1.0, max(fraction, self.spent()))
            efficiency = self._best / problem.probability_in_area
            self._on_progress(PlanProgress(now - self._began, efficiency, fraction))
        self.asked_to_stop()
