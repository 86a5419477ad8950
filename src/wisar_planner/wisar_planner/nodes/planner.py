"""The planner node: from `pdm` to `plan` and `path`, and the `plan_search` action."""

from __future__ import annotations

import sys
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from nav_msgs.msg import Path
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from wisar_msgs.action import PlanSearch
from wisar_msgs.msg import ProbabilityMap, SearchPlan
from wisar_planner.errors import InvalidInput
from wisar_planner.nodes import conversions, parameters
from wisar_planner.nodes.conversions import LocatedMap, Plan
from wisar_planner.nodes.qos import LATCHED
from wisar_planner.nodes.runtime import spin
from wisar_planner.planners.base import PlanProgress
from wisar_planner.planners.registry import make_planner, planner_names, planner_options
from wisar_planner.search import SearchProblem

Result = PlanSearch.Result
FEEDBACK_PERIOD = 0.1
"""Seconds between two feedback messages of the action."""


class GoalError(Exception):
    """Why a goal of `plan_search` cannot be met: a numbered error of the action, with text."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


class PlannerNode(Node):
    """Plans when a map arrives and when the action asks; publishes the last good plan.

    One plan is computed at a time, on a thread of its own. A new map ends planning on the old
    one; a goal of the action ends the planning that a map started. A map or request that cannot
    be used is refused with a log line, and what was published stays.
    """

    def __init__(self) -> None:
        super().__init__("planner")
        self._declare_parameters()
        self._map: LocatedMap | None = None
        self._state = threading.Lock()  # guards _map and _stop_automatic
        self._planning = threading.Lock()  # held by whoever is planning
        self._stop_automatic = threading.Event()
        self._closing = threading.Event()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="plan")
        self._plan_publisher = self.create_publisher(SearchPlan, "plan", LATCHED)
        self._path_publisher = self.create_publisher(Path, "path", LATCHED)
        self.create_subscription(ProbabilityMap, "pdm", self._on_map, LATCHED)
        self._action = ActionServer(
            self,
            PlanSearch,
            "plan_search",
            execute_callback=self._on_goal,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )
        self.add_post_set_parameters_callback(lambda _: self._plan_automatically())

    def close(self) -> None:
        """Stop planning."""
        self._closing.set()
        self._worker.shutdown(wait=True, cancel_futures=True)
        self._action.destroy()

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
            located = conversions.map_from_msg(message)
            with self._state:
                if self._map is not None and located.stamp_ns < self._map.stamp_ns:
                    raise InvalidInput(
                        f"map {located.map_id!r} is older than the current map {self._map.map_id!r}"
                    )
                self._map = located
        except InvalidInput as error:
            self.get_logger().error(f"map refused, the last good map and plan stay: {error}")
            return
        self.get_logger().info(f"map {located.map_id!r} with {len(located.pdm.weights)} components")
        self._plan_automatically()

    def _plan_automatically(self) -> None:
        """Plan on the last map with the parameters, in place of any such plan under way."""
        with self._state:
            located = self._map
            self._stop_automatic.set()
            self._stop_automatic = stop = threading.Event()
        if located is None or self._closing.is_set() or not self.get_parameter("plan_on_map").value:
            return
        self._worker.submit(self._plan_on_map, located, stop)

    def _plan_on_map(self, located: LocatedMap, stop: threading.Event) -> None:
        try:
            with self._planning:
                if stop.is_set() or self._is_outdated(located):
                    return
                plan = self._plan(
                    located,
                    self._problem(located),
                    self._parameter("planner"),
                    {},
                    lambda: stop.is_set() or self._is_outdated(located),
                )
                if not self._is_outdated(located):
                    self._publish(plan)
        except InvalidInput as error:
            self.get_logger().error(f"no plan, the last good plan stays: {error}")
        except Exception:
            # A worker thread has nobody to raise to, and the node must go on answering.
            self.get_logger().error(
                f"planning failed, the last good plan stays:\n{traceback.format_exc()}"
            )

    # Planning when the action asks

    def _on_goal(self, goal: ServerGoalHandle) -> PlanSearch.Result:
        with self._state:
            located = self._map
            self._stop_automatic.set()
        outdated = self._is_outdated

        def should_stop() -> bool:
            return goal.is_cancel_requested or (located is not None and outdated(located))

        try:
            if located is None:
                raise GoalError(
                    Result.NO_MAP, "no probability map has arrived: start pdm_server or load a map"
                )
            name, problem, options = self._read_goal(goal.request, located)
            while not self._planning.acquire(timeout=0.05):
                if should_stop():
                    break
            else:
                try:
                    plan = self._plan(
                        located, problem, name, options, should_stop, self._feedback(goal)
                    )
                finally:
                    self._planning.release()
                if not should_stop():
                    self._publish(plan)
                    goal.succeed()
                    return Result(error_code=Result.NONE, plan=conversions.plan_to_msg(plan))
                if goal.is_cancel_requested:
                    goal.canceled()
                    return Result(
                        error_code=Result.CANCELED,
                        error_text="cancelled; the best plan so far is returned, not published",
                        plan=conversions.plan_to_msg(plan),
                    )
            if goal.is_cancel_requested:
                goal.canceled()
                return Result(error_code=Result.CANCELED, error_text="cancelled before planning")
            raise GoalError(Result.MAP_CHANGED, "a new map arrived while planning: ask again")
        except GoalError as error:
            self.get_logger().warning(f"plan_search refused: {error}")
            goal.abort()
            return Result(error_code=error.code, error_text=str(error))
        except Exception as error:
            self.get_logger().error(f"plan_search failed:\n{traceback.format_exc()}")
            goal.abort()
            return Result(error_code=Result.PLANNING_FAILED, error_text=str(error))

    def _read_goal(
        self, request: PlanSearch.Goal, located: LocatedMap
    ) -> tuple[str, SearchProblem, dict[str, float]]:
        """Return planner, problem and options of a goal, or raise GoalError."""
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
        except InvalidInput as error:
            raise GoalError(Result.INVALID_REQUEST, str(error)) from None
        return name, problem, options

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
        with self._state:
            return self._closing.is_set() or self._map is not located

    def _problem(
        self,
        located: LocatedMap,
        *,
        budget: float = 0.0,
        start: tuple[float, ...] | None = None,
    ) -> SearchProblem:
        """Build the problem of the parameters, with a goal's values where it has them."""
        chosen = start or parameters.point(self, "start")
        if chosen is None:
            # The centre of an area with a hole may lie in the hole.
            polygon = located.area.polygon
            centre = polygon.centroid
            inside = centre if polygon.covers(centre) else polygon.representative_point()
            chosen = (inside.x, inside.y)
        return SearchProblem(
            pdm=located.pdm,
            area=located.area,
            start=np.array(chosen),
            step_length=self.get_parameter("step_length").value,
            swath_radius=self.get_parameter("swath_radius").value,
            max_distance=budget if budget != 0.0 else self.get_parameter("max_distance").value,
        )

    def _plan(
        self,
        located: LocatedMap,
        problem: SearchProblem,
        name: str,
        options: dict[str, float],
        should_stop: Callable[[], bool],
        on_progress: Callable[[PlanProgress], None] | None = None,
    ) -> Plan:
        settings = {
            option: self.get_parameter(f"{name}.{option}").value for option in planner_options(name)
        }
        began = time.monotonic()
        path = make_planner(name, **(settings | options)).plan(
            problem, on_progress=on_progress, should_stop=should_stop
        )
        plan = Plan.of(path, problem, located, time.monotonic() - began)
        return replace(plan, stamp_ns=self.get_clock().now().nanoseconds)

    def _publish(self, plan: Plan) -> None:
        if self._closing.is_set():
            return
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
