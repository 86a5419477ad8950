"""What the vehicle has really seen, from the positions that it reports."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import positive
from wisar_planner.mavlink.mission import Mission
from wisar_planner.mavlink.modes import may_fly_mission, returns_home
from wisar_planner.mavlink.vehicle import VehicleState
from wisar_planner.pdm import ProbabilityMap
from wisar_planner.pdm.geodesy import LocalFrame
from wisar_planner.search import SearchPath, SeenArea


@dataclass(frozen=True)
class FlightProgress:
    """How far a flight has come.

    Parameters
    ----------
    flying
        Whether the search part of the mission is being flown: where modes are known, in the mode
        that flies it.
    left
        Whether the vehicle is armed in a mode that does not fly the mission: paused, returning or
        flown by hand. A return after the whole search does not count: PX4 flies the mission's own
        in the same mode.
    completed
        Whether the mission has been flown to its end: the last item is told to be reached, or the
        whole search has been flown and the vehicle has landed after a return (PX4 does not tell
        that one as reached) or loiters.
    waypoints_reached, waypoints_total
        Waypoints of the search.
    distance
        Metres flown since the first waypoint.
    probability
        Probability that the real track has seen so far.
    planned_probability
        What the plan promised at this distance.
    """

    flying: bool
    left: bool
    completed: bool
    waypoints_reached: int
    waypoints_total: int
    distance: float
    probability: float
    planned_probability: float


class FlightTracker:
    """Adds up what the vehicle sees between the first and the last waypoint.

    The probability comes from the same exact union of swaths as the plan's. Two positions are
    joined by a straight line if they were reported within `max_gap_s` of each other; where the
    vehicle was during a longer silence is not known, and nothing is counted.

    Items reached count from the moment the motors are armed, or the mission is begun anew in the
    air, so that an earlier flight does not complete this one; what was seen adds up over all
    flights of the mission.

    Parameters
    ----------
    pdm
        Where the person may be.
    plan
        What was to be flown, in metres of `frame`.
    frame
        Local frame of map and plan.
    mission
        The mission made of the plan; tells which items are its waypoints.
    max_gap_s
        Longest silence in seconds across which the track is joined.
    """

    # Shorter steps than this share of the swath radius add work but nothing to see.
    _STEP_IN_SWATH_RADII = 0.2
    _PLANNED_SAMPLES = 400

    def __init__(
        self,
        pdm: ProbabilityMap,
        plan: SearchPath,
        frame: LocalFrame,
        mission: Mission,
        *,
        max_gap_s: float = 3.0,
    ) -> None:
        self._seen = SeenArea(pdm, plan.swath_radius)
        self._frame = frame
        self._max_gap_s = positive(max_gap_s, "max_gap_s")
        numbers = [n for n, item in enumerate(mission.items) if item.is_waypoint]
        self._waypoints = numbers
        self._last_waypoint = numbers[-1] if numbers else len(mission.items)
        self._last_item = len(mission.items) - 1
        self._returns = mission.items[-1].command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH
        self._planned_at = np.linspace(0.0, plan.length, self._PLANNED_SAMPLES)
        self._planned = plan.probability_over_distance(pdm, self._planned_at)
        self._last: NDArray[np.float64] | None = None
        self._last_at = -math.inf
        self._distance = 0.0
        self._reached = -1
        self._told_before: int | None = None  # item reached in an earlier flight
        self._armed: bool | None = None
        self._flying = False
        self._left = False
        self._was_flying = False
        self._searched = False  # past the last waypoint of the search

    def update(self, state: VehicleState, now: float) -> FlightProgress:
        """Take in a snapshot of the vehicle.

        Parameters
        ----------
        state
            From `MissionClient`.
        now
            Monotonic time in seconds at which it was heard.
        """
        mode = (state.autopilot, state.vehicle_type, state.custom_mode)
        on_mission = state.armed and may_fly_mission(*mode)
        self._flying = on_mission and self._on_search(state.current_item)
        if on_mission and self._searched and self._at_its_begin(state.current_item):
            self._begin_anew(state.reached_item)
        self._take_reached(state)
        returning = self._searched and self._returns and returns_home(*mode)
        self._left = state.armed and not (on_mission or returning)
        if not self._flying:
            self._last = None
        elif state.latitude is not None and state.longitude is not None:
            self._take_position(state.latitude, state.longitude, state.position_at, now)
        return self.progress

    def _take_reached(self, state: VehicleState) -> None:
        reached = state.reached_item
        if self._armed is None or (state.armed and not self._armed):
            self._begin_anew(reached)
        self._armed = state.armed
        if reached is not None and reached != self._told_before:
            self._told_before = None
            self._reached = max(self._reached, reached)
        self._was_flying |= self._flying
        # The message that the last waypoint is reached may be lost; the next item tells it too.
        past = self._was_flying and (state.current_item or 0) > self._last_waypoint
        self._searched |= past or self._reached >= self._last_waypoint

    def _begin_anew(self, reached: int | None) -> None:
        """Forget what an earlier flight reached, and the item that the vehicle still tells of it.

        PX4 repeats the last item of a flight for some seconds after its end.
        """
        self._told_before, self._reached = reached, -1
        self._was_flying = self._searched = False

    def _at_its_begin(self, current: int | None) -> bool:
        """Whether the vehicle has not passed the first waypoint; after the last: once more."""
        return current is not None and bool(self._waypoints) and current <= self._waypoints[0]

    def _on_search(self, current: int | None) -> bool:
        """Whether the vehicle is between the first and the last waypoint."""
        if current is None or not self._waypoints:
            return False
        return self._waypoints[0] < current <= self._waypoints[-1]

    def _take_position(self, latitude: float, longitude: float, at: float, now: float) -> None:
        """Go on to a position; snapshots repeat it until the vehicle tells another one."""
        is_taken = self._last is not None and at == self._last_at
        if not is_taken and now - at <= self._max_gap_s:
            self._advance(self._frame.to_local([latitude], [longitude])[0], at)

    def _advance(self, point: NDArray[np.float64], at: float) -> None:
        if self._last is None or at - self._last_at > self._max_gap_s:
            self._seen.add(point, point)
            self._last, self._last_at = point, at
            return
        self._last_at = at
        step = float(math.hypot(*(point - self._last)))
        if step < self._STEP_IN_SWATH_RADII * self._seen.swath_radius:
            return
        self._seen.add(self._last, point)
        self._distance += step
        self._last = point

    @property
    def progress(self) -> FlightProgress:
        """How far the flight has come."""
        last = self._last_waypoint if self._searched else self._reached
        reached = sum(number <= last for number in self._waypoints)
        return FlightProgress(
            flying=self._flying,
            left=self._left,
            completed=self._reached >= self._last_item
            or (self._searched and not (self._returns and self._armed)),
            waypoints_reached=reached,
            waypoints_total=len(self._waypoints),
            distance=self._distance,
            probability=self._seen.probability,
            planned_probability=float(np.interp(self._distance, self._planned_at, self._planned)),
        )
