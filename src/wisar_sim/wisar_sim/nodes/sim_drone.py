"""The simulated drone: flies `plan` and publishes `pose` and `search_progress`."""

from __future__ import annotations

import sys

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node

from wisar_msgs.msg import ProbabilityMap, SearchPlan, SearchProgress
from wisar_planner.errors import InvalidInput
from wisar_planner.nodes import conversions, parameters
from wisar_planner.nodes.conversions import Plan
from wisar_planner.nodes.latest_map import LatestMap
from wisar_planner.nodes.qos import ALL_LATCHED, LATCHED, STREAM
from wisar_planner.nodes.runtime import spin
from wisar_planner.search import SearchProblem
from wisar_sim.heading_drone import HeadingDrone, by_boundary, by_cubature

METHODS = {"cubature": by_cubature, "boundary": by_boundary}


class SimDrone(Node):
    """Plays the paper's heading-control drone, one step per tick.

    It takes off in the simulation as soon as it has a plan and the map of that plan; a plan of
    another map is refused until that map arrives, and the flight under way goes on.
    """

    def __init__(self) -> None:
        super().__init__("sim_drone")
        rate = parameters.declare(
            self, "tick_rate", 1.0, "Steps per second of simulated time", minimum=0.001
        )
        speed_up = parameters.declare(
            self, "speed_up", 1.0, "How many times faster than real time", minimum=0.001
        )
        parameters.declare(
            self,
            "method",
            "cubature",
            "How p_t is computed; cubature is the paper's",
            choices=tuple(METHODS),
        )
        self._maps = LatestMap(self)
        self._waiting: Plan | None = None  # until its map is here
        self._flight: tuple[HeadingDrone, Plan] | None = None
        self._pose_publisher = self.create_publisher(PoseStamped, "pose", STREAM)
        self._progress_publisher = self.create_publisher(SearchProgress, "search_progress", LATCHED)
        self.create_subscription(ProbabilityMap, "pdm", self._on_map, ALL_LATCHED)
        self.create_subscription(SearchPlan, "plan", self._on_plan, LATCHED)
        self._timer = self.create_timer(1.0 / (rate * speed_up), self._on_tick)
        self.add_post_set_parameters_callback(lambda _: self._retime())

    def _retime(self) -> None:
        rate = self.get_parameter("tick_rate").value * self.get_parameter("speed_up").value
        self._timer.timer_period_ns = round(1e9 / rate)
        # Without it the period under way, which may be minutes, runs to its end first.
        self._timer.reset()

    def _on_map(self, message: ProbabilityMap) -> None:
        try:
            taken = self._maps.take(message)
        except InvalidInput as error:
            self.get_logger().error(f"map refused, the last good map stays: {error}")
            return
        if taken is not None:
            self._take_off()

    def _on_plan(self, message: SearchPlan) -> None:
        try:
            self._waiting = conversions.plan_from_msg(message)
        except InvalidInput as error:
            self.get_logger().error(f"plan refused, the flight under way goes on: {error}")
            return
        located = self._maps.current
        if located is None or self._waiting.map_id != located.map_id:
            # Either may come first: the middleware keeps no order between topics.
            current = "none has arrived" if located is None else f"the last is {located.map_id!r}"
            self.get_logger().warning(
                f"plan of map {self._waiting.map_id!r} waits for that map, {current}"
            )
        self._take_off()

    def _take_off(self) -> None:
        """Fly the waiting plan if its map is here."""
        plan, located = self._waiting, self._maps.current
        if plan is None or located is None or plan.map_id != located.map_id:
            return
        self._waiting = None
        try:
            # The start of the problem plays no part in what a path sees or earns.
            inside = located.area.polygon.representative_point()
            problem = SearchProblem(
                pdm=located.pdm,
                area=located.area,
                start=np.array([inside.x, inside.y]),
                step_length=plan.step_length,
                swath_radius=plan.path.swath_radius,
                max_distance=plan.budget,
            )
            method = METHODS[self.get_parameter("method").value]
            drone = HeadingDrone(plan.path, problem, method)
        except InvalidInput as error:
            self.get_logger().error(f"plan refused, the flight under way goes on: {error}")
            return
        self._flight = (drone, plan)
        self.get_logger().info(f"flying {drone.steps} steps of plan {plan.path.planner!r}")
        self._publish(drone, plan)

    def _on_tick(self) -> None:
        if self._flight is None:
            return
        drone, plan = self._flight
        if drone.state.finished:
            return
        state = drone.tick()
        self._publish(drone, plan)
        if state.finished:
            self.get_logger().info(
                f"flown: {state.distance:.0f} m, e_p {state.probability_efficiency:.3f}"
            )

    def _publish(self, drone: HeadingDrone, plan: Plan) -> None:
        state = drone.state
        header = conversions.header(self.get_clock().now().nanoseconds, plan.frame_id)
        self._pose_publisher.publish(conversions.pose(state.position, state.heading, header))
        self._progress_publisher.publish(
            SearchProgress(
                header=header,
                map_id=plan.map_id,
                step=state.step,
                steps=drone.steps,
                x=float(state.position[0]),
                y=float(state.position[1]),
                heading=state.heading,
                distance=state.distance,
                probability=state.probability,
                probability_efficiency=state.probability_efficiency,
                reward=state.reward,
                planned_probability=float(plan.probability[state.step]),
                out_of_area=bool(state.out_of_area),
                finished=state.finished,
            )
        )


def main() -> int:
    """Run the node as a process."""
    return spin(SimDrone)


if __name__ == "__main__":
    sys.exit(main())
