"""The parameters of the MAVLink bridge, and the settings that they make."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from wisar_planner.mavlink.checks import Limits
from wisar_planner.mavlink.search_mission import MissionSettings
from wisar_planner.nodes import parameters

_FIXED = frozenset(
    {
        "connection",
        "system_id",
        "component_id",
        "target_system",
        "target_component",
        "key_file",
    }
)
"""What the link is opened with, so that it cannot change afterwards."""


def declare_all(node: Node) -> None:
    """Declare the parameters of the bridge.

    Raises
    ------
    InvalidInput
        When a value given at the start is none of a parameter's choices.
    """

    def declare(name: str, default: bool | int | float | str, text: str, **limits: Any) -> None:
        parameters.declare(node, name, default, text, read_only=name in _FIXED, **limits)

    declare(
        "connection",
        "udpin:127.0.0.1:14550",
        "Where the autopilot is: udpin:, udpout:, tcp: or a serial device, as pymavlink has it",
    )
    declare("system_id", 245, "Own MAVLink system id", minimum=1, maximum=255)
    declare("component_id", 190, "Own MAVLink component id", minimum=1, maximum=255)
    declare("target_system", 0, "Vehicle's system id; 0: the first heard", minimum=0, maximum=255)
    declare("target_component", 0, "Its component id; 0: the first heard", minimum=0, maximum=255)
    declare("key_file", "", "File with the signing key; empty: no signing")
    declare(
        "altitude",
        0.0,
        "Flying height above the launch point, m; 0: where the camera sees the plan's swath",
        minimum=0.0,
    )
    declare(
        "field_of_view",
        45.0,
        "Camera's angle of view across the direction of flight, degrees",
        minimum=1.0,
        maximum=170.0,
    )
    declare("speed", 10.0, "Ground speed, m/s; 0: the vehicle's own setting", minimum=0.0)
    declare("takeoff", True, "Whether the mission begins with a takeoff")
    declare(
        "end",
        "return_to_launch",
        "What follows the search",
        choices=("return_to_launch", "loiter"),
    )
    declare(
        "altitude_frame",
        "relative",
        "What altitudes refer to: relative to launch, or terrain",
        choices=("relative", "terrain"),
    )
    declare("camera_trigger", 0.0, "Distance between two pictures, m; 0: none", minimum=0.0)
    declare("fence", False, "Whether the search area is uploaded as a geofence")
    declare("fence_margin", 30.0, "How far outside the area the fence stands, m", minimum=0.0)
    declare("rally", False, "Whether the launch point is uploaded as a rally point")
    declare(
        "clear_old",
        False,
        "Whether an upload deletes the fence and the rally points on the vehicle that it does "
        "not replace; false leaves them as they are",
    )
    declare("min_altitude", 2.0, "Lowest altitude allowed, m", minimum=0.0)
    declare("max_altitude", 120.0, "Highest altitude allowed, m", minimum=0.0)
    declare(
        "endurance",
        0.0,
        "Distance that the vehicle can fly, the legs there and home included, m; 0: unknown",
        minimum=0.0,
    )
    declare(
        "max_first_waypoint",
        2000.0,
        "Greatest distance between the vehicle and the first waypoint, m",
        minimum=1.0,
    )
    declare(
        "plan_files",
        "",
        "Files to write each plan to, separated by commas: .plan .waypoints .kml .gpx .geojson",
    )


def _values(node: Node) -> Callable[[str], Any]:
    """Return what looks up a parameter by its name."""
    return lambda name: node.get_parameter(name).value


def mission_settings(node: Node) -> MissionSettings:
    """Return how a plan is flown, as the parameters say now."""
    value = _values(node)
    return MissionSettings(
        altitude_m=value("altitude") or None,
        field_of_view=math.radians(value("field_of_view")),
        speed=value("speed") or None,
        takeoff=value("takeoff"),
        end=value("end"),
        altitude_frame=value("altitude_frame"),
        camera_trigger_m=value("camera_trigger") or None,
        fence=value("fence"),
        fence_margin_m=value("fence_margin"),
        rally=value("rally"),
    )


def mission_limits(node: Node) -> Limits:
    """Return what a mission must keep to, as the parameters say now.

    Raises
    ------
    InvalidInput
        If they contradict each other.
    """
    value = _values(node)
    return Limits(
        min_altitude_m=value("min_altitude"),
        max_altitude_m=value("max_altitude"),
        endurance_m=value("endurance") or None,
        first_waypoint_m=value("max_first_waypoint"),
    )
