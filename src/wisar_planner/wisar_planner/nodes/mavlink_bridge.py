"""The MAVLink bridge: puts `plan` on an autopilot and tells what the vehicle holds and does."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mav
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import Trigger

from wisar_msgs.action import UploadMission
from wisar_msgs.msg import MissionStatus, ProbabilityMap, SearchPlan
from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.checks import check_mission
from wisar_planner.mavlink.client import LinkError, LinkStatus, MissionClient
from wisar_planner.mavlink.files import write_plan_file
from wisar_planner.mavlink.flight import FlightTracker
from wisar_planner.mavlink.mission import Mission
from wisar_planner.mavlink.modes import flies_mission
from wisar_planner.mavlink.outcome import UploadProgress
from wisar_planner.mavlink.search_mission import search_mission
from wisar_planner.mavlink.vehicle import VehicleState
from wisar_planner.nodes import bridge_parameters, conversions
from wisar_planner.nodes.conversions import LocatedMap, Plan
from wisar_planner.nodes.latest_map import LatestMap
from wisar_planner.nodes.qos import ALL_LATCHED, LATCHED
from wisar_planner.nodes.requests import Requests
from wisar_planner.nodes.runtime import spin
from wisar_planner.pdm.geodesy import LocalFrame

Result = UploadMission.Result
STATUS_PERIOD = 1.0
"""Seconds between two `mission_status` messages when nothing changes."""
PROOF_LASTS = 10.0
"""Seconds after which a mission that was read back is read again before it is flown.

Armed on the ground, vehicles disarm by themselves after about as long: a start that comes before
does not wait for another reading on a slow link.
"""


@dataclass(frozen=True)
class _LocatedMission:
    """A mission with what it was made from, so that a later plan and its map do not matter.

    The map is None where it had not arrived by then.
    """

    plan: Plan
    mission: Mission
    located: LocatedMap | None


def _made_of(plan: Plan, located: LocatedMap) -> bool:
    """Return whether a plan is of a map: an id may come again for a map of another place."""
    return plan.map_id == located.map_id and plan.origin == located.origin


class MavlinkBridge(Node):
    """Uploads the last plan when asked, and reports the vehicle's state.

    Nothing is armed or started by itself: `upload_mission` only uploads; `arm`, `start_mission`,
    `pause`, `resume` and `return_to_launch` are services that somebody has to call.
    """

    def __init__(self) -> None:
        super().__init__("mavlink_bridge")
        bridge_parameters.declare_all(self)
        self._plan: Plan | None = None
        self._maps = LatestMap(self)
        self._map: LocatedMap | None = None  # of the last plan; the last one until that is here
        self._verified: _LocatedMission | None = None  # what the vehicle holds
        self._tracker: FlightTracker | None = None  # of that
        self._proved_at = -math.inf  # when that was read back
        self._seen_flying = False  # whether the vehicle has flown its mission since this began
        self._under_way = False  # whether a flight of that has begun and not ended
        self._requests = Requests()
        self._files_wait = ""  # why the plan's files are not written yet; empty if they are
        self._state = MissionStatus.NO_LINK
        self._text = "no heartbeat heard yet"
        self._map_id = ""
        self._items = (0, 0)
        self._status_publisher = self.create_publisher(MissionStatus, "mission_status", LATCHED)
        value = self._value
        self._client = MissionClient(
            value("connection"),
            system=value("system_id"),
            component=value("component_id"),
            target_system=value("target_system") or None,
            target_component=value("target_component") or None,
            key_file=Path(value("key_file")) if value("key_file") else None,
            on_link=self._on_link,
            on_vehicle=self._on_vehicle,
            on_text=self._on_text,
        )
        self.create_subscription(ProbabilityMap, "pdm", self._on_map, ALL_LATCHED)
        self.create_subscription(SearchPlan, "plan", self._on_plan, LATCHED)
        group = ReentrantCallbackGroup()
        self._action = ActionServer(
            self,
            UploadMission,
            "upload_mission",
            execute_callback=self._on_goal,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=group,
        )
        requests = {
            "arm": self._arm,
            "start_mission": self._start_mission,
            "pause": self._pause,
            "resume": self._resume,
            "return_to_launch": self._return_to_launch,
        }
        for name, act in requests.items():
            request = self._explicit_request(act)
            self.create_service(Trigger, name, request, callback_group=group)
        # By the steady clock: a vehicle's link is lost in real time, whatever time is simulated.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(STATUS_PERIOD, self._on_timer, clock=steady)

    def close(self) -> None:
        """End the connection; an upload under way is cancelled, see `MissionClient.close`."""
        self._client.close()

    def destroy_node(self) -> None:
        """Destroy the action as well, which rclpy leaves to the node's owner."""
        self._action.destroy()
        super().destroy_node()

    def _value(self, name: str) -> Any:
        return self.get_parameter(name).value

    # The plan

    def _on_map(self, message: ProbabilityMap) -> None:
        try:
            located = self._maps.take(message)
        except InvalidInput as error:
            self.get_logger().error(f"map refused, the last good map stays: {error}")
            return
        if located is None:
            return
        if self._plan is None or self._map_of(self._plan) is None or self._is_of_plan(located):
            self._map = located
        # Topics keep no order: what needs the map may have come before it.
        if self._files_wait:
            self._write_plan_files()
        verified = self._verified
        if self._tracker is None and verified is not None:
            self._track(verified)
        self._publish_status()

    def _is_of_plan(self, located: LocatedMap) -> bool:
        return self._plan is not None and _made_of(self._plan, located)

    def _on_plan(self, message: SearchPlan) -> None:
        try:
            plan = conversions.plan_from_msg(message)
        except InvalidInput as error:
            self.get_logger().error(f"plan refused, the last good plan stays: {error}")
            return
        self._plan = plan
        newest = self._maps.current
        if newest is not None and self._is_of_plan(newest):
            self._map = newest
        self._publish_status()
        self.get_logger().info(
            f"plan of map {plan.map_id!r} with {len(plan.path.waypoints)} waypoints: "
            "call upload_mission to put it on the vehicle"
        )
        self._write_plan_files()

    def _write_plan_files(self) -> None:
        """Write the files of the last plan, once what its mission needs is here."""
        plan = self._plan
        names = [name.strip() for name in self._value("plan_files").split(",") if name.strip()]
        if plan is None or not names:
            return
        before, self._files_wait = self._files_wait, self._lacking(plan)
        if self._files_wait:
            if self._files_wait != before:  # it is tried again each second
                self.get_logger().info(f"plan files wait for {self._files_wait}")
            return
        for name in names:
            try:
                mission = self._mission(plan, self._map_of(plan))
                write_plan_file(Path(name), mission)
            except (InvalidInput, OSError) as error:
                self.get_logger().error(f"plan file not written: {error}")
            else:
                text = "; ".join((f"plan file {name} written", *mission.cautions))
                self.get_logger().info(text)

    def _lacking(self, plan: Plan) -> str:
        """Return what the mission of a plan needs and is not known yet; empty if nothing."""
        if self._value("fence") and self._map_of(plan) is None:
            return f"the map {plan.map_id!r} and its area"
        if self._value("rally") and self._launch_place() is None:
            return "the vehicle's position, which tells the launch point"
        return ""

    def _mission(self, plan: Plan, located: LocatedMap | None) -> Mission:
        """Build the mission of a plan and its map with the parameters, or raise InvalidInput."""
        return search_mission(
            plan.path,
            LocalFrame(plan.origin),
            bridge_parameters.mission_settings(self),
            area=None if located is None else located.area,
            launch=self._launch_place(),
            takeoff_place=self._vehicle_place(),
        )

    def _map_of(self, plan: Plan) -> LocatedMap | None:
        located = self._map
        return located if located is not None and _made_of(plan, located) else None

    def _vehicle_place(self) -> tuple[float, float] | None:
        vehicle = self._client.vehicle
        return None if vehicle is None else vehicle.place_at(time.monotonic())

    def _launch_place(self) -> tuple[float, float] | None:
        """Where the vehicle starts and returns to: where it stands, or its home once it flies."""
        vehicle = self._client.vehicle
        if vehicle is not None and vehicle.armed and vehicle.home is not None:
            return vehicle.home[:2]
        return self._vehicle_place()

    def _reasons_against(self, mission: Mission) -> tuple[str, ...]:
        """Return why a mission must not be uploaded."""
        place = self._vehicle_place()
        if place is None:
            return (
                "the vehicle's position is not known now, so that the distances cannot be "
                "checked; wait for its GPS, then upload again",
            )
        limits = bridge_parameters.mission_limits(self)
        return check_mission(mission, limits, vehicle=place, home=self._launch_place())

    # The upload

    def _on_goal(self, goal: ServerGoalHandle) -> UploadMission.Result:
        plan = self._plan
        if plan is None:
            return self._refuse(goal, Result.NO_PLAN, "no plan has arrived: start the planner")
        if goal.request.map_id not in ("", plan.map_id):
            return self._refuse(
                goal,
                Result.WRONG_MAP,
                f"the last plan is of map {plan.map_id!r}, not of {goal.request.map_id!r}",
            )
        newest = self._maps.current
        if not goal.request.map_id and newest is not None and newest.map_id != plan.map_id:
            return self._refuse(
                goal,
                Result.WRONG_MAP,
                f"the last plan is of map {plan.map_id!r}, but {newest.map_id!r} is newer; wait "
                f"for its plan, or ask for {plan.map_id!r} by name",
            )
        # Without a vehicle there is no place to measure from; one heard meanwhile is next time's.
        if not (link := self._client.link_status).connected:
            return self._refuse(goal, Result.NO_LINK, f"no vehicle to talk to: {link.text}")
        # A new plan's map may take its place during the upload.
        located = self._map_of(plan)
        try:
            mission = self._mission(plan, located)
            reasons = self._reasons_against(mission)
        except InvalidInput as error:
            reasons = (str(error),)
        if reasons:
            return self._refuse(goal, Result.UNSAFE, "; ".join(reasons))
        return self._upload(goal, _LocatedMission(plan, mission, located))

    def _upload(self, goal: ServerGoalHandle, wanted: _LocatedMission) -> UploadMission.Result:
        mission = wanted.mission

        def on_progress(progress: UploadProgress) -> None:
            items = (progress.items_sent, progress.items_total)
            if items != self._items:
                self._set_state(
                    MissionStatus.UPLOADING, f"{progress.phase}; not to be flown yet", items
                )
                goal.publish_feedback(
                    UploadMission.Feedback(items_sent=items[0], items_total=items[1])
                )

        before = self._state, self._text, self._items
        outcome = self._client.upload(
            mission,
            on_progress=on_progress,
            should_cancel=lambda: goal.is_cancel_requested,
            clear_old=self._value("clear_old"),
        )
        if outcome.verified:
            self._map_id, self._verified = wanted.plan.map_id, wanted
            self._proved_at = time.monotonic()
            self._under_way = False
            self._track(wanted)
            count = len(mission.items)
            notes = (*outcome.notes, *mission.cautions)
            text = "; ".join((f"{count} items uploaded, read back and equal", *notes))
            self._set_state(MissionStatus.VERIFIED, text, (count, count))
            self.get_logger().info(text)
            goal.succeed()
            return Result(error_code=Result.NONE, error_text="; ".join(notes), items=count)
        if not outcome.old_counts:  # nobody knows what the vehicle would fly now
            self._forget()
        text = "; ".join((outcome.error, *outcome.differences[:5], *outcome.notes))
        self.get_logger().error(f"upload failed: {text}")
        # An objection may also come to a later attempt, after a part has been overwritten.
        objected = int(outcome.code) == Result.UNSAFE and outcome.old_counts
        unsent = int(outcome.code) == Result.NO_LINK and outcome.old_counts and not outcome.attempts
        if objected or unsent:
            self._set_state(*before)
            self._show_link(self._client.link_status)  # it may have changed since
        elif int(outcome.code) != Result.BUSY:  # the state is that of the other upload
            self._set_state(MissionStatus.FAILED, text, (0, len(mission.items)))
        if int(outcome.code) == Result.CANCELED and goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return Result(error_code=int(outcome.code), error_text=text)

    def _refuse(self, goal: ServerGoalHandle, code: int, text: str) -> UploadMission.Result:
        self.get_logger().warning(f"upload refused: {text}")
        goal.abort()
        return Result(error_code=code, error_text=text)

    # The flight

    def _track(self, verified: _LocatedMission) -> None:
        """Follow the flight of a verified mission, if the map of its plan is here."""
        plan = verified.plan
        located = verified.located or self._map_of(plan)
        self._tracker = (
            None
            if located is None
            else FlightTracker(located.pdm, plan.path, LocalFrame(plan.origin), verified.mission)
        )

    def _forget(self) -> None:
        """Take the vehicle's mission for an unknown one, whatever it has flown before."""
        self._map_id, self._verified, self._tracker = "", None, None
        self._seen_flying = False

    def _on_vehicle(self, vehicle: VehicleState) -> None:
        if vehicle.armed and flies_mission(
            vehicle.autopilot, vehicle.vehicle_type, vehicle.custom_mode
        ):
            self._seen_flying = True
        tracker = self._tracker
        if tracker is None:
            return
        progress = tracker.update(vehicle, time.monotonic())
        items = (progress.waypoints_reached, progress.waypoints_total)
        if self._state == MissionStatus.UPLOADING:
            return
        flown = self._state in (MissionStatus.VERIFIED, MissionStatus.FLYING)
        if progress.completed and flown:
            self._under_way = False
            self._set_state(MissionStatus.COMPLETED, "the mission has been flown", items)
        elif self._under_way and not vehicle.armed:
            self._under_way = False
            text = f"the flight ended after {items[0]} of {items[1]} waypoints"
            self.get_logger().warning(text)
            if flown:
                text += "; the mission is still there"
                self._set_state(MissionStatus.VERIFIED, text, items)
        elif self._state == MissionStatus.FLYING and progress.left:
            text = (
                f"armed, but the mission is not being flown now, after {items[0]} of {items[1]} "
                "waypoints; resume goes on with it"
            )
            self._set_state(MissionStatus.VERIFIED, text, items)
        elif progress.flying and (self._state != MissionStatus.FLYING or items != self._items):
            self._under_way = True
            self._set_state(MissionStatus.FLYING, "the verified mission is being flown", items)

    def _on_text(self, severity: int, text: str) -> None:
        """Log what the vehicle says, as it often gives a reason once only."""
        said = f"the vehicle says: {text}"
        if severity <= mav.MAV_SEVERITY_ERROR:
            self.get_logger().error(said)
        elif severity == mav.MAV_SEVERITY_WARNING:
            self.get_logger().warning(said)
        else:
            self.get_logger().info(said)

    # Requests to the vehicle

    def _arm(self) -> None:
        """Arm; look first whether the mission is still the one, as vehicles disarm soon again."""
        with self._requests.one("arming") as check:
            self._prove("arming")
            check()
            self._client.arm()

    def _start_mission(self) -> None:
        """Start what this bridge has verified.

        A vehicle may hold anything else: the mission of another day, another vehicle's, what
        another ground station has put there since, or the mixture that an upload left when the
        bridge was ended in the middle of it.
        """
        words = "start of the mission"
        with self._requests.one(words) as check:
            if not (link := self._client.link_status).connected:
                raise LinkError(f"{words}: no vehicle to talk to: {link.text}")
            if self._verified is None:
                raise LinkError(
                    f"{words}: this bridge has verified none since it began, or not what the "
                    "vehicle holds now; call upload_mission first"
                )
            self._prove(words)
            check()
            self._client.start_mission()

    def _resume(self) -> None:
        """Go on with what this bridge has verified, or has itself seen the vehicle fly.

        What was verified is read back first, as for a start.
        """
        with self._requests.one("resume") as check:
            if self._verified is None and not self._seen_flying:
                raise LinkError(
                    "resume: this bridge has neither verified a mission nor seen the vehicle fly "
                    "one since it began; call upload_mission, then start_mission"
                )
            self._prove("resume")
            check()
            self._client.resume()

    def _pause(self) -> None:
        self._requests.give_up()
        self._client.pause()

    def _return_to_launch(self) -> None:
        self._requests.give_up()
        self._client.return_to_launch()

    def _prove(self, words: str) -> None:
        """Read the verified mission back again, unless that was done just now.

        Raises
        ------
        LinkError
            If the vehicle holds another one, which counts as unknown from then on, or does not
            answer.
        """
        verified = self._verified
        fresh = time.monotonic() - self._proved_at < PROOF_LASTS
        # During an upload there is nothing to read; the client refuses to start then.
        if verified is None or fresh or self._state == MissionStatus.UPLOADING:
            return
        differences = self._client.changes_since(verified.mission)
        if self._verified is not verified:
            raise LinkError(f"{words}: an upload has ended meanwhile; look at it, then ask again")
        if not differences:
            self._proved_at = time.monotonic()
            return
        self._forget()
        text = (
            "the vehicle does not hold what was verified any more "
            f"({'; '.join(differences[:2])}); call upload_mission again"
        )
        self._set_state(MissionStatus.FAILED, text, (0, len(verified.mission.items)))
        raise LinkError(f"{words}: {text}")

    def _explicit_request(
        self, act: Callable[[], None]
    ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                act()
            except LinkError as error:
                self.get_logger().error(str(error))
                response.success, response.message = False, str(error)
            else:
                response.success, response.message = True, "accepted by the vehicle"
            return response

        return answer

    # The status

    def _on_link(self, status: LinkStatus) -> None:
        self.get_logger().info(status.text)
        self._proved_at = -math.inf  # what is heard next may be another vehicle
        self._show_link(status)

    def _show_link(self, status: LinkStatus) -> None:
        """Tell of the link where there is nothing else to tell."""
        if self._state in (MissionStatus.NO_LINK, MissionStatus.IDLE):
            state = MissionStatus.IDLE if status.connected else MissionStatus.NO_LINK
            self._set_state(state, status.text, self._items)

    def _uploadable_map_id(self) -> str:
        """Return the map of the last plan once everything that its mission needs is here."""
        plan = self._plan
        if plan is None or (self._value("fence") and self._map_of(plan) is None):
            return ""
        if self._client.link_status.connected and self._vehicle_place() is None:
            return ""
        return plan.map_id

    def _set_state(self, state: int, text: str, items: tuple[int, int]) -> None:
        self._state, self._text, self._items = state, text, items
        self._publish_status()

    def _on_timer(self) -> None:
        if self._files_wait:
            self._write_plan_files()
        self._publish_status()

    def _publish_status(self) -> None:
        vehicle = self._client.vehicle
        link = self._client.link_status
        position = (math.nan, math.nan, math.nan)
        if vehicle is not None and vehicle.latitude is not None and vehicle.longitude is not None:
            position = (vehicle.latitude, vehicle.longitude, vehicle.relative_altitude)
        counters = self._client.counters
        tracker = self._tracker  # read once, as an upload may take it away meanwhile
        flight = None if tracker is None else tracker.progress
        self._status_publisher.publish(
            MissionStatus(
                header=conversions.header(self.get_clock().now().nanoseconds, "wgs84"),
                state=self._state,
                text=self._text if link.connected else link.text,
                planned_map_id=self._uploadable_map_id(),
                map_id=self._map_id,
                autopilot=vehicle.dialect.name if vehicle is not None else "",
                connected=link.connected,
                armed=vehicle is not None and vehicle.armed,
                items_transferred=self._items[0],
                items_total=self._items[1],
                latitude=position[0],
                longitude=position[1],
                altitude=position[2],
                distance=0.0 if flight is None else flight.distance,
                probability=0.0 if flight is None else flight.probability,
                planned_probability=0.0 if flight is None else flight.planned_probability,
                rejected_messages=counters.unsigned + counters.badly_signed,
            )
        )


def main() -> int:
    """Run the node as a process."""
    return spin(MavlinkBridge)


if __name__ == "__main__":
    sys.exit(main())
