"""The planner node: from `pdm` to `plan` and `path`, and the `plan_search` action."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
import traceback
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np
from nav_msgs.msg import Path
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from wisar_msgs.action import PlanSearch
from wisar_msgs.msg import ProbabilityMap, SearchPlan
from wisar_planner.errors import InvalidInput
from wisar_planner.nodes import conversions, parameters
from wisar_planner.nodes.conversions import LocatedMap, Plan
from wisar_planner.nodes.latest_map import LatestMap
from wisar_planner.nodes.qos import ALL_LATCHED, LATCHED
from wisar_planner.nodes.runtime import spin
from wisar_planner.planners.base import PlanProgress
from wisar_planner.planners.polish import preload
from wisar_planner.planners.registry import make_planner, planner_names, planner_options
from wisar_planner.search import SearchProblem

Result = PlanSearch.Result
FEEDBACK_PERIOD = 0.1
"""Seconds between two feedback messages of the action."""


Reason = TypeVar("Reason")


class GoalError(Exception):
    """Why a goal of `plan_search` is not met: a numbered error of the action, with text.

    `plan` is what there was when planning was cancelled.
    """

    def __init__(self, code: int, text: str, plan: Plan | None = None) -> None:
        super().__init__(text)
        self.code = code
        self.plan = plan


class _Latch(Generic[Reason]):
    """Whether planning has to end: the first reason stays, even if it passes.

    A planner that was told to stop returns what it has; to look again afterwards would take that
    for a whole plan.
    """

    def __init__(self, look: Callable[[], Reason | None]) -> None:
        self._look = look
        self.reason: Reason | None = None

    def __call__(self) -> bool:
        if self.reason is None:
            self.reason = self._look()
        return self.reason is not None


class _Until:
    """Something to await in a callback: a condition, looked at whenever the executor wakes."""

    def __init__(self, condition: Callable[[], bool]) -> None:
        self._condition = condition

    def __await__(self) -> Generator[None, None, None]:
        while not self._condition():
            yield


@dataclass(frozen=True, eq=False)
class _Order:
    """What to plan, with which planner and which options."""

    located: LocatedMap
    problem: SearchProblem
    planner: str
    options: dict[str, Any]


@dataclass(frozen=True, eq=False)
class _AutomaticPlan:
    """A plan that a map or a parameter asks for; told apart by identity."""

    located: LocatedMap


class PlannerNode(Node):
    """Plans when a map arrives and when the action asks; publishes the last good plan.

    One plan is computed at a time, on a thread of its own; goals of the action wait for their turn
    in the order in which they came, without holding a thread of the executor. A new map ends
    planning on the old one. A goal that can be planned ends the planning that a map or a parameter
    started, which is taken up again unless a goal has brought a plan. A map or request that cannot
    be used is refused with a log line, and what was published stays.
    """

    def __init__(self) -> None:
        super().__init__("planner")
        self._declare_parameters()
        self._maps = LatestMap(self)
        self._state = threading.Lock()  # guards _automatic and _goals
        self._automatic: _AutomaticPlan | None = None  # until it is published or superseded
        self._goals = 0  # accepted, valid, not yet ended
        self._closing = threading.Event()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="plan")
        self._worker.submit(preload)  # before the first plan, which has a budget to keep
        self._plan_publisher = self.create_publisher(SearchPlan, "plan", LATCHED)
        self._path_publisher = self.create_publisher(Path, "path", LATCHED)
        self.create_subscription(ProbabilityMap, "pdm", self._on_map, ALL_LATCHED)
        group = ReentrantCallbackGroup()
        self._action = ActionServer(
            self,
            PlanSearch,
            "plan_search",
            execute_callback=self._on_goal,
            goal_callback=lambda _: (
                GoalResponse.REJECT if self._closing.is_set() else GoalResponse.ACCEPT
            ),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=group,
        )
        # The executor does not look again at a callback that was at work when it was woken, so a
        # goal's end could go unseen until something else happens.
        self._waker = self.create_timer(
            0.1,
            lambda: None,
            callback_group=group,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
            autostart=False,
        )
        self.add_post_set_parameters_callback(lambda _: self._plan_automatically())

    def close(self) -> None:
        """Stop planning; goals end while the executor still sends their results."""
        self._closing.set()
        self._worker.shutdown(wait=True, cancel_futures=True)

    def destroy_node(self) -> None:
        """Destroy the action as well, which rclpy leaves to the node's owner."""
        self._action.destroy()
        super().destroy_node()

    # Parameters

    def _declare_parameters(self) -> None:
        parameters.declare(self, "planner", "sac_search", "Planner to use", choices=planner_names())
        parameters.declare(
            self, "swath_radius", 2.5, "Half the width of the strip that is seen, m", minimum=0.01
        )
        parameters.declare(
            self, "step_length", 8.0, "Distance between two waypoints, m", minimum=0.01
        )
        parameters.declare(self, "max_distance", 512.0, "Longest path, m", minimum=0.01)
        parameters.declare(
            self, "plan_on_map", True, "Plan whenever a map arrives or a parameter changes"
        )
        parameters.declare_point(
            self,
            "start",
            "Where the search starts, metres east and north of the map's origin; unset: the "
            "centre of the search area",
        )
        for name in planner_names():
            for option in planner_options(name).values():
                parameters.declare(
                    self,
                    f"{name}.{option.name}",
                    option.default,
                    option.help,
                    minimum=option.minimum,
                    maximum=option.maximum,
                )

    def _parameter(self, name: str) -> str:
        return str(self.get_parameter(name).value)

    # Planning when a map arrives

    def _on_map(self, message: ProbabilityMap) -> None:
        try:
            located = self._maps.take(message)
        except InvalidInput as error:
            self.get_logger().error(f"map refused, the last good map and plan stay: {error}")
            return
        if located is None:
            return
        self.get_logger().info(f"map {located.map_id!r} with {len(located.pdm.weights)} components")
        self._plan_automatically()

    def _plan_automatically(self) -> None:
        """Plan on the last map with the parameters, in place of any such plan under way."""
        located = self._maps.current
        wanted = located is not None and self.get_parameter("plan_on_map").value
        request = _AutomaticPlan(located) if located is not None and wanted else None
        with self._state:
            self._automatic = request
        self._submit(request)

    def _submit(self, request: _AutomaticPlan | None) -> None:
        if request is not None:
            # The worker has ended where the node is about to.
            with contextlib.suppress(RuntimeError):
                self._worker.submit(self._plan_on_map, request)

    def _plan_on_map(self, request: _AutomaticPlan) -> None:
        """Plan and publish on the worker, unless a goal or another request comes in between."""

        def displaced() -> bool | None:
            with self._state:
                due = self._automatic is request and self._goals == 0
            return not due or self._is_outdated(request.located) or None

        stop = _Latch(displaced)
        if stop():
            return
        try:
            plan = self._plan(
                self._order(request.located, self._problem(request.located)), stop, None
            )
            if stop():
                return  # whoever displaced it asks again
            self._publish(plan)
        except InvalidInput as error:
            self.get_logger().error(f"no plan, the last good plan stays: {error}")
        except Exception:
            # A worker thread has nobody to raise to, and the node must go on answering.
            self.get_logger().error(
                f"planning failed, the last good plan stays:\n{traceback.format_exc()}"
            )
        with self._state:
            if self._automatic is request:
                self._automatic = None

    # Planning when the action asks

    async def _on_goal(self, goal: ServerGoalHandle) -> PlanSearch.Result:
        try:
            plan = await self._planned(goal, self._read_goal(goal.request))
        except GoalError as error:
            if error.code == Result.CANCELED:
                goal.canceled()
            else:
                self.get_logger().warning(f"plan_search refused: {error}")
                goal.abort()
            result = Result(error_code=error.code, error_text=str(error))
            if error.plan is not None:
                result.plan = conversions.plan_to_msg(error.plan)
            return result
        except Exception as error:
            self.get_logger().error(f"plan_search failed:\n{traceback.format_exc()}")
            goal.abort()
            return Result(error_code=Result.PLANNING_FAILED, error_text=str(error))
        goal.succeed()
        return Result(error_code=Result.NONE, plan=conversions.plan_to_msg(plan))

    async def _planned(self, goal: ServerGoalHandle, order: _Order) -> Plan:
        """Plan when the worker is free, and return the plan once it is published.

        Raises
        ------
        GoalError
            When the goal has been cancelled, the map has changed or the node is to end.
        """
        stop = _Latch(lambda: self._reason_to_end(goal, order))
        with self._state:
            displaced = self._automatic
            self._goals += 1
            self._waker.reset()
        published = False
        try:
            if stop():
                raise self._ended(stop, None)
            job = self._worker.submit(self._plan_for_goal, order, stop, self._feedback(goal))
            job.add_done_callback(lambda _: self._wake())
            # A goal that still waits for its turn ends at once when it is to end.
            await _Until(lambda: job.done() or (stop() and job.cancel()))
            if job.cancelled():
                raise self._ended(stop, None)
            plan = job.result()
            published = True
            return plan
        finally:
            with self._state:
                self._goals -= 1
                if published and self._automatic is displaced:
                    self._automatic = None
                again = self._automatic if self._goals == 0 else None
                if self._goals == 0:
                    self._waker.cancel()
            self._submit(again)

    def _plan_for_goal(
        self, order: _Order, stop: _Latch[GoalError], on_progress: Callable[[PlanProgress], None]
    ) -> Plan:
        """Plan and publish on the worker, or raise the GoalError that has ended it."""
        if stop():
            raise self._ended(stop, None)
        plan = self._plan(order, stop, on_progress)
        if stop():
            raise self._ended(stop, plan)
        self._publish(plan)
        return plan

    def _reason_to_end(self, goal: ServerGoalHandle, order: _Order) -> GoalError | None:
        """Return why a goal is not to be planned any further."""
        if goal.is_cancel_requested:
            return GoalError(Result.CANCELED, "cancelled before planning")
        if self._closing.is_set():
            return GoalError(
                Result.PLANNING_FAILED,
                "the planner node was told to end while planning: start it and ask again",
            )
        if self._is_outdated(order.located):
            return GoalError(Result.MAP_CHANGED, "a new map arrived while planning: ask again")
        return None

    def _ended(self, stop: _Latch[GoalError], plan: Plan | None) -> GoalError:
        """Return the error of a goal that has been ended with what is planned so far."""
        if not stop() or stop.reason is None:
            raise RuntimeError("planning was taken away without a reason")
        if stop.reason.code == Result.CANCELED and plan is not None:
            text = "cancelled; the best plan so far is returned, not published"
            return GoalError(Result.CANCELED, text, plan)
        return stop.reason

    def _wake(self) -> None:
        if self.executor is not None:
            self.executor.wake()

    def _read_goal(self, request: PlanSearch.Goal) -> _Order:
        """Return what a goal asks for, or raise GoalError; nothing is changed by it."""
        located = self._maps.current
        if located is None:
            raise GoalError(
                Result.NO_MAP, "no probability map has arrived: start pdm_server or load a map"
            )
        name = request.planner or self._parameter("planner")
        try:
            known = planner_options(name)
        except InvalidInput as error:
            raise GoalError(Result.UNKNOWN_PLANNER, str(error)) from None
        options: dict[str, float] = {}
        try:
            problem = self._problem(
                located,
                budget=request.budget,
                start=tuple(request.start) if request.use_start else None,
            )
            if request.time_budget != 0.0:
                if "time_budget_s" not in known:
                    raise InvalidInput(f"planner {name} takes no time budget: leave it at 0")
                options["time_budget_s"] = known["time_budget_s"].checked(request.time_budget)
                if "max_iterations" in known:
                    options["max_iterations"] = 0  # a number of them would replace the time
        except InvalidInput as error:
            raise GoalError(Result.INVALID_REQUEST, str(error)) from None
        return self._order(located, problem, name, options)

    def _feedback(self, goal: ServerGoalHandle) -> Callable[[PlanProgress], None]:
        last = -FEEDBACK_PERIOD

        def publish(progress: PlanProgress) -> None:
            nonlocal last
            if progress.elapsed_s - last >= FEEDBACK_PERIOD and goal.is_active:
                last = progress.elapsed_s
                goal.publish_feedback(
                    PlanSearch.Feedback(
                        elapsed=float(progress.elapsed_s),
                        fraction=float(progress.fraction),
                        probability_efficiency=float(progress.efficiency),
                    )
                )

        return publish

    # Both

    def _is_outdated(self, located: LocatedMap) -> bool:
        return self._closing.is_set() or self._maps.current is not located

    def _problem(
        self,
        located: LocatedMap,
        *,
        budget: float = 0.0,
        start: tuple[float, ...] | None = None,
    ) -> SearchProblem:
        """Build the problem of the parameters, with a goal's values where it has them.

        Raises
        ------
        InvalidInput
            When a value cannot be planned with, or the budget is no step or far too many.
        """
        chosen = start or parameters.point(self, "start")
        problem = SearchProblem(
            pdm=located.pdm,
            area=located.area,
            start=located.area.middle if chosen is None else np.array(chosen),
            step_length=self.get_parameter("step_length").value,
            swath_radius=self.get_parameter("swath_radius").value,
            max_distance=budget if budget != 0.0 else self.get_parameter("max_distance").value,
        )
        name = "budget" if budget != 0.0 else "max_distance"
        problem.check_steps(step="step_length", budget=name)
        if problem.steps < 1:
            raise InvalidInput(
                f"step_length: {problem.step_length:g} m is longer than the {name} of "
                f"{problem.max_distance:g} m, so that not one step can be flown; give a shorter "
                f"step_length or a larger {name}"
            )
        return problem

    def _order(
        self,
        located: LocatedMap,
        problem: SearchProblem,
        name: str = "",
        options: dict[str, float] | None = None,
    ) -> _Order:
        """Return what to plan: planner and options are the parameters' where not given."""
        name = name or self._parameter("planner")
        settings = {
            option: self.get_parameter(f"{name}.{option}").value for option in planner_options(name)
        }
        return _Order(located, problem, name, settings | (options or {}))

    def _plan(
        self,
        order: _Order,
        should_stop: Callable[[], bool],
        on_progress: Callable[[PlanProgress], None] | None,
    ) -> Plan:
        began = time.monotonic()
        path = make_planner(order.planner, **order.options).plan(
            order.problem, on_progress=on_progress, should_stop=should_stop
        )
        plan = Plan.of(path, order.problem, order.located, time.monotonic() - began)
        return replace(plan, stamp_ns=self.get_clock().now().nanoseconds)

    def _publish(self, plan: Plan) -> None:
        self._plan_publisher.publish(conversions.plan_to_msg(plan))
        self._path_publisher.publish(conversions.plan_to_nav_path(plan))
        self.get_logger().info(
            f"{plan.path.planner}: e_p {plan.probability_efficiency:.3f} "
            f"({plan.probability_efficiency / plan.upper_bound:.0%} of the bound) "
            f"over {plan.path.length:.0f} m in {plan.planning_time:.2f} s"
        )


def main() -> int:
    """Run the node as a process."""
    return spin(PlannerNode)


if __name__ == "__main__":
    sys.exit(main())
