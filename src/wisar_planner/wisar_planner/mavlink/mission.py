"""Mission items, whole missions, and how a search plan becomes one."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput

DEGREES_PER_UNIT = 1e-7
"""Degrees per unit of the integer coordinates in MISSION_ITEM_INT."""

End = Literal["return_to_launch", "loiter"]
AltitudeFrame = Literal["relative", "terrain"]

_FRAMES: dict[str, int] = {
    "relative": mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    "terrain": mav.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT,
}

# MAVLink has two codes each for "global", "relative" and "terrain"; in MISSION_ITEM_INT they mean
# the same, and an autopilot may read a mission back with the other code of a pair.
_SAME_FRAME: dict[int, int] = {
    mav.MAV_FRAME_GLOBAL_INT: mav.MAV_FRAME_GLOBAL,
    mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mav.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT: mav.MAV_FRAME_GLOBAL_TERRAIN_ALT,
}

KEEP_HEADING = (0.0, 0.0, 0.0, math.nan)
"""Parameters of a waypoint or takeoff whose heading is left to the vehicle (along its track)."""

_GLOBAL_FRAMES = frozenset(_SAME_FRAME) | frozenset(_SAME_FRAME.values())


class MissionKind(IntEnum):
    """The three lists that an autopilot keeps (MAV_MISSION_TYPE)."""

    MISSION = mav.MAV_MISSION_TYPE_MISSION
    FENCE = mav.MAV_MISSION_TYPE_FENCE
    RALLY = mav.MAV_MISSION_TYPE_RALLY


def plain_frame(frame: int) -> int:
    """Return the code that stands for `frame` and for its ``_INT`` twin."""
    return _SAME_FRAME.get(frame, frame)


def float32(value: float) -> float:
    """Round a number to what a MAVLink ``float`` field carries.

    Every NaN becomes the one object `math.nan`, so that tuples of parameters compare equal.
    """
    if math.isnan(value):
        return math.nan
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


@dataclass(frozen=True)
class MissionItem:
    """One item of a mission, fence or rally list, as MISSION_ITEM_INT carries it.

    Numbers are rounded to the wire's precision when the item is made, so that an item which
    was sent and read back without a change is equal to the one that was kept.

    Parameters
    ----------
    command
        MAV_CMD code.
    frame
        MAV_FRAME code.
    params
        The command's parameters 1 to 4; NaN means "the autopilot's default".
    x, y
        Latitude and longitude in units of 1e-7 degrees for global frames; the command's
        parameters 5 and 6 otherwise.
    z
        Altitude in metres for global frames; the command's parameter 7 otherwise.
    autocontinue
        Whether the vehicle goes on to the next item by itself.
    """

    command: int
    frame: int = mav.MAV_FRAME_MISSION
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    x: int = 0
    y: int = 0
    z: float = 0.0
    autocontinue: bool = True

    def __post_init__(self) -> None:
        if len(self.params) != 4:
            raise InvalidInput(f"params must be 4 numbers, got {len(self.params)}")
        rounded = tuple(float32(p) for p in self.params)
        object.__setattr__(self, "params", rounded)
        object.__setattr__(self, "z", float32(self.z))

    @classmethod
    def at(
        cls,
        command: int,
        latitude: float,
        longitude: float,
        altitude: float = 0.0,
        *,
        frame: int = mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> MissionItem:
        """Make an item at a place given in degrees and metres.

        Raises
        ------
        InvalidInput
            If the place is not a finite WGS84 latitude and longitude.
        """
        if not (math.isfinite(latitude) and abs(latitude) <= 90.0):
            raise InvalidInput(f"latitude must be within -90 to 90 degrees, got {latitude}")
        if not (math.isfinite(longitude) and abs(longitude) <= 180.0):
            raise InvalidInput(f"longitude must be within -180 to 180 degrees, got {longitude}")
        return cls(
            command=command,
            frame=frame,
            params=params,
            x=round(latitude / DEGREES_PER_UNIT),
            y=round(longitude / DEGREES_PER_UNIT),
            z=altitude,
        )

    @property
    def is_global(self) -> bool:
        """Whether `x` and `y` are a latitude and a longitude."""
        return self.frame in _GLOBAL_FRAMES

    @property
    def latitude(self) -> float:
        """Latitude in degrees (global frames only)."""
        return self.x * DEGREES_PER_UNIT

    @property
    def longitude(self) -> float:
        """Longitude in degrees (global frames only)."""
        return self.y * DEGREES_PER_UNIT

    @property
    def is_waypoint(self) -> bool:
        """Whether this is a plain waypoint (MAV_CMD_NAV_WAYPOINT)."""
        return self.command == mav.MAV_CMD_NAV_WAYPOINT


@dataclass(frozen=True)
class Mission:
    """What is put on an autopilot: the flight, the geofence and the rally points.

    An empty `fence` or `rally` means that the mission brings none; what the autopilot holds then
    stays, unless an upload is told to delete it.
    """

    items: tuple[MissionItem, ...] = ()
    fence: tuple[MissionItem, ...] = ()
    rally: tuple[MissionItem, ...] = ()

    def of_kind(self, kind: MissionKind) -> tuple[MissionItem, ...]:
        """Return one of the three lists."""
        lists = {
            MissionKind.MISSION: self.items,
            MissionKind.FENCE: self.fence,
            MissionKind.RALLY: self.rally,
        }
        return lists[kind]

    @property
    def cautions(self) -> tuple[str, ...]:
        """What to know before the flight, one sentence each."""
        told = []
        relative = mav.MAV_FRAME_GLOBAL_RELATIVE_ALT
        if any(i.is_waypoint and plain_frame(i.frame) == relative for i in self.items):
            told.append("heights are above the launch point; terrain is not checked")
        if self.fence:
            told.append(
                "whether the vehicle obeys the fence is its own setting (ArduPilot: FENCE_ENABLE, "
                "FENCE_TYPE and FENCE_ACTION; PX4: GF_ACTION)"
            )
        return tuple(told)

    @property
    def waypoints(self) -> NDArray[np.float64]:
        """Latitude, longitude (degrees) and altitude (m) of the plain waypoints, (N, 3)."""
        rows = [(i.latitude, i.longitude, i.z) for i in self.items if i.is_waypoint]
        return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _coordinates(name: str, value: ArrayLike, at_least: int) -> NDArray[np.float64]:
    points = np.asarray(value, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < at_least:
        raise InvalidInput(
            f"{name} must have shape (N, 2) with N >= {at_least}, got {points.shape}"
        )
    if not np.isfinite(points).all():
        raise InvalidInput(f"{name} must be finite; remove the NaN or infinite rows")
    return points


def fence_items(
    inclusions: Sequence[ArrayLike], exclusions: Sequence[ArrayLike] = ()
) -> tuple[MissionItem, ...]:
    """Turn rings of latitude and longitude into geofence items.

    Parameters
    ----------
    inclusions
        Rings, each (N, 2) degrees [latitude, longitude], that the vehicle must stay inside. A
        closing point equal to the first is dropped, as the protocol wants rings open.
    exclusions
        Rings that the vehicle must stay outside.

    Raises
    ------
    InvalidInput
        If a ring has fewer than three different corners or a coordinate is not finite.
    """
    items: list[MissionItem] = []
    for name, command, rings in (
        ("inclusions", mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, inclusions),
        ("exclusions", mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION, exclusions),
    ):
        for ring in rings:
            corners = _coordinates(name, ring, 3)
            if np.array_equal(corners[0], corners[-1]):
                corners = corners[:-1]
            if len(np.unique(corners, axis=0)) < 3:
                raise InvalidInput(f"{name}: a ring needs at least three different corners")
            items.extend(
                MissionItem.at(
                    command,
                    latitude,
                    longitude,
                    frame=mav.MAV_FRAME_GLOBAL,
                    params=(float(len(corners)), 0.0, 0.0, 0.0),
                )
                for latitude, longitude in corners
            )
    return tuple(items)


def rally_items(points: ArrayLike, altitude_m: float) -> tuple[MissionItem, ...]:
    """Turn places (N, 2), degrees, into rally points at an altitude above home in metres."""
    return tuple(
        MissionItem.at(
            mav.MAV_CMD_NAV_RALLY_POINT,
            latitude,
            longitude,
            altitude_m,
            frame=mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        )
        for latitude, longitude in _coordinates("points", points, 1)
    )


def build_mission(
    plan_latlon: ArrayLike,
    *,
    altitude_m: float,
    speed: float | None = None,
    takeoff: bool = True,
    end: End = "return_to_launch",
    launch: tuple[float, float] | None = None,
    altitude_frame: AltitudeFrame = "relative",
    camera_trigger_m: float | None = None,
    inclusions: Sequence[ArrayLike] = (),
    exclusions: Sequence[ArrayLike] = (),
    rally: ArrayLike | None = None,
) -> Mission:
    """Turn a search plan into a mission.

    The items are, in this order: takeoff, speed, camera trigger on, one waypoint per row of the
    plan, camera trigger off, and the end of the flight.

    Parameters
    ----------
    plan_latlon
        Waypoints (N, 2) in degrees, [latitude, longitude], N >= 1.
    altitude_m
        Flying height in metres above the launch point, or above ground for the terrain frame.
    speed
        Ground speed in m/s; None leaves the vehicle's own setting.
    takeoff
        Whether the mission starts with a takeoff.
    end
        ``"return_to_launch"`` or ``"loiter"`` (stay at the last waypoint).
    launch
        Latitude and longitude of the takeoff; None takes off above the first waypoint's place in
        the mission, which multicopters do where they stand.
    altitude_frame
        ``"relative"`` to the launch altitude, or following the ``"terrain"``.
    camera_trigger_m
        Distance in metres between two pictures; None leaves the camera alone.
    inclusions, exclusions
        Geofence rings, see `fence_items`.
    rally
        Rally points (M, 2) in degrees, at the mission's altitude.

    Returns
    -------
    Mission
        The same for every autopilot; differences of dialect are applied when it is uploaded.

    Raises
    ------
    InvalidInput
        If an argument cannot be right.
    """
    plan = _coordinates("plan_latlon", plan_latlon, 1)
    _positive("altitude_m", altitude_m)
    if end not in ("return_to_launch", "loiter"):
        raise InvalidInput(f"end must be 'return_to_launch' or 'loiter', got {end!r}")
    if launch is not None and tuple(launch) == (0.0, 0.0):
        raise InvalidInput(
            "launch is 0, 0, which a vehicle tells before it knows its place; wait for its GPS"
        )
    if altitude_frame not in _FRAMES:
        raise InvalidInput(f"altitude_frame must be one of {sorted(_FRAMES)}")
    frame = _FRAMES[altitude_frame]

    items: list[MissionItem] = []
    if takeoff:
        latitude, longitude = launch if launch is not None else plan[0]
        # Takeoff is always above the launch point: terrain data may not be loaded yet.
        items.append(
            MissionItem.at(
                mav.MAV_CMD_NAV_TAKEOFF,
                float(latitude),
                float(longitude),
                altitude_m,
                params=KEEP_HEADING,
            )
        )
    if speed is not None:
        _positive("speed", speed)
        # Type 1 is ground speed; -1 leaves the throttle alone.
        items.append(
            MissionItem(mav.MAV_CMD_DO_CHANGE_SPEED, params=(1.0, float(speed), -1.0, 0.0))
        )
    if camera_trigger_m is not None:
        _positive("camera_trigger_m", camera_trigger_m)
        items.append(_camera_trigger(camera_trigger_m))
    items.extend(
        MissionItem.at(
            mav.MAV_CMD_NAV_WAYPOINT,
            latitude,
            longitude,
            altitude_m,
            frame=frame,
            params=KEEP_HEADING,
        )
        for latitude, longitude in plan
    )
    if camera_trigger_m is not None:
        items.append(_camera_trigger(0.0))
    if end == "return_to_launch":
        items.append(MissionItem(mav.MAV_CMD_NAV_RETURN_TO_LAUNCH))
    else:
        items.append(
            MissionItem.at(
                mav.MAV_CMD_NAV_LOITER_UNLIM,
                float(plan[-1, 0]),
                float(plan[-1, 1]),
                altitude_m,
                frame=frame,
                params=KEEP_HEADING,
            )
        )
    return Mission(
        items=tuple(items),
        fence=fence_items(inclusions, exclusions),
        rally=() if rally is None else rally_items(rally, altitude_m),
    )


def _camera_trigger(distance: float) -> MissionItem:
    return MissionItem(mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST, params=(float(distance), 0.0, 0.0, 0.0))


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InvalidInput(f"{name} must be a positive finite number, got {value}")
