"""What a mission is refused for before it is sent: things that cannot be right."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput, positive
from wisar_planner.mavlink.mission import Mission, MissionItem, MissionKind
from wisar_planner.mavlink.rings import fence_rings
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame

MOST_ITEMS = 65_535
"""Most items that MISSION_COUNT can announce."""

# Corners and waypoints are rounded to 1e-7 degrees, about a centimetre.
_FENCE_TOLERANCE_M = 0.05


@dataclass(frozen=True)
class Limits:
    """What the operator and the vehicle allow.

    Parameters
    ----------
    min_altitude_m, max_altitude_m
        Allowed heights of waypoints in metres, as the mission gives them.
    endurance_m
        Distance in metres that the vehicle can fly, the ways to the first waypoint and home
        included; None does not check.
    first_waypoint_m
        Greatest distance in metres between vehicle and first waypoint; None does not check.
    most_items
        Most items of one list.

    Raises
    ------
    InvalidInput
        If a limit cannot be right.
    """

    min_altitude_m: float = 2.0
    max_altitude_m: float = 120.0
    endurance_m: float | None = None
    first_waypoint_m: float | None = 2_000.0
    most_items: int = 5_000

    def __post_init__(self) -> None:
        for name in ("endurance_m", "first_waypoint_m"):
            value = getattr(self, name)
            if value is not None:
                positive(value, name)
        if not self.min_altitude_m < self.max_altitude_m:
            raise InvalidInput(
                f"min_altitude_m ({self.min_altitude_m}) must be below max_altitude_m "
                f"({self.max_altitude_m})"
            )
        if not 0 < self.most_items <= MOST_ITEMS:
            raise InvalidInput(f"most_items must be from 1 to {MOST_ITEMS}, got {self.most_items}")


def check_mission(
    mission: Mission,
    limits: Limits | None = None,
    *,
    vehicle: tuple[float, float] | None = None,
    home: tuple[float, float] | None = None,
) -> tuple[str, ...]:
    """Say why a mission must not be uploaded.

    Parameters
    ----------
    mission
        As it would be uploaded.
    limits
        What is allowed.
    vehicle
        Latitude and longitude of the vehicle in degrees, if known.
    home
        Latitude and longitude of home, if known; the vehicle's place otherwise.

    Returns
    -------
    tuple of str
        One sentence per reason; empty if nothing speaks against it.
    """
    limits = limits or Limits()
    reasons = _check_numbers(mission, limits)
    if reasons:
        return tuple(reasons)  # the geometry below needs real places
    waypoints = mission.waypoints
    frame = LocalFrame(GeoOrigin(float(waypoints[0, 0]), float(waypoints[0, 1])))
    track = frame.to_local(waypoints[:, 0], waypoints[:, 1])
    reasons = [
        *_check_altitudes(waypoints[:, 2], limits),
        *_check_fence(mission, frame, track),
        *_check_legs(mission, frame, track, vehicle, home or vehicle),
        *_check_distances(track, frame, limits, vehicle, home or vehicle),
    ]
    return tuple(reasons)


def _check_numbers(mission: Mission, limits: Limits) -> list[str]:
    reasons = []
    if not any(item.is_waypoint for item in mission.items):
        reasons.append("the mission has no waypoint; plan a search first")
    for kind in MissionKind:
        items = mission.of_kind(kind)
        name = kind.name.lower()
        if len(items) > limits.most_items:
            reasons.append(
                f"{len(items)} {name} items are more than the limit of {limits.most_items}; use "
                "longer steps"
            )
        wrong = next((n for n, item in enumerate(items) if not _is_sound(item)), None)
        if wrong is not None:
            reasons.append(
                f"{name} item {wrong} has a number that cannot be (NaN, infinite, or a place "
                "outside the Earth); plan again"
            )
    return reasons


def _is_sound(item: MissionItem) -> bool:
    if not math.isfinite(item.z) or any(math.isinf(p) for p in item.params):
        return False
    return not item.is_global or (abs(item.latitude) <= 90.0 and abs(item.longitude) <= 180.0)


def _check_altitudes(altitudes: NDArray[np.float64], limits: Limits) -> list[str]:
    outside = (altitudes < limits.min_altitude_m) | (altitudes > limits.max_altitude_m)
    if not outside.any():
        return []
    return [
        f"an altitude of {altitudes[outside][0]:g} m is outside the limits "
        f"{limits.min_altitude_m:g} to {limits.max_altitude_m:g} m; change it or the limits"
    ]


def _check_fence(mission: Mission, frame: LocalFrame, track: NDArray[np.float64]) -> list[str]:
    rings = fence_rings(mission.fence)
    corners = sum(len(ring.corners) for ring in rings)
    vertices = {
        mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
        mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
    }
    if corners != sum(item.command in vertices for item in mission.fence):
        return ["the fence has a polygon that is not complete; give each at least three corners"]
    line = shapely.LineString(track) if len(track) > 1 else shapely.Point(track[0])
    reasons = []
    for ring in rings:
        polygon = shapely.Polygon(frame.to_local(ring.corners[:, 0], ring.corners[:, 1]))
        if not polygon.is_valid:
            reasons.append("a fence polygon crosses itself; draw it again")
        # An autopilot keeps the vehicle inside every inclusion polygon, not inside any of them.
        elif ring.inclusion and not polygon.buffer(_FENCE_TOLERANCE_M).covers(line):
            reasons.append("the way leaves the fence; enlarge the fence or plan inside it")
        elif not ring.inclusion and polygon.buffer(-_FENCE_TOLERANCE_M).intersects(line):
            reasons.append("the way crosses a keep-out area; plan around it")
    return reasons


def _check_legs(
    mission: Mission,
    frame: LocalFrame,
    track: NDArray[np.float64],
    vehicle: tuple[float, float] | None,
    home: tuple[float, float] | None,
) -> list[str]:
    """Check the ways to the first waypoint and home, which the fence holds for as well."""
    returns = any(i.command == mav.MAV_CMD_NAV_RETURN_TO_LAUNCH for i in mission.items)
    legs = [("from the vehicle to the first waypoint", vehicle, track[0])]
    if returns:
        legs.append(("home from the last waypoint", home, track[-1]))
    reasons = []
    for words, place, waypoint in legs:
        if place is None:
            continue
        line = shapely.LineString([frame.to_local([place[0]], [place[1]])[0], waypoint])
        for ring in fence_rings(mission.fence):
            polygon = shapely.Polygon(frame.to_local(ring.corners[:, 0], ring.corners[:, 1]))
            if not polygon.is_valid:
                continue  # told already
            if ring.inclusion and not polygon.buffer(_FENCE_TOLERANCE_M).covers(line):
                reasons.append(
                    f"the way {words} leaves the fence; launch inside it or set a larger "
                    "fence_margin"
                )
            elif not ring.inclusion and polygon.buffer(-_FENCE_TOLERANCE_M).intersects(line):
                reasons.append(f"the way {words} crosses a keep-out area; launch elsewhere")
    return reasons


def _check_distances(
    track: NDArray[np.float64],
    frame: LocalFrame,
    limits: Limits,
    vehicle: tuple[float, float] | None,
    home: tuple[float, float] | None,
) -> list[str]:
    reasons = []
    there = _distance(frame, vehicle, track[0])
    if (
        limits.first_waypoint_m is not None
        and there is not None
        and there > limits.first_waypoint_m
    ):
        reasons.append(
            f"the first waypoint is {there:,.0f} m from the vehicle, more than the limit of "
            f"{limits.first_waypoint_m:,.0f} m; check that map and vehicle belong together"
        )
    if limits.endurance_m is not None:
        legs = float(np.linalg.norm(np.diff(track, axis=0), axis=1).sum())
        back = _distance(frame, home, track[-1])
        way = legs + (there or 0.0) + (back or 0.0)
        if way > limits.endurance_m:
            reasons.append(
                f"the way of {way:,.0f} m, there and home included, is longer than the endurance "
                f"of {limits.endurance_m:,.0f} m; plan with a smaller budget"
            )
    return reasons


def _distance(
    frame: LocalFrame, place: tuple[float, float] | None, point: NDArray[np.float64]
) -> float | None:
    if place is None:
        return None
    local = frame.to_local([place[0]], [place[1]])[0]
    return float(math.hypot(*(local - point)))
