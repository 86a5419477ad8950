"""What is known of the vehicle from its telemetry."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.dialect import GENERIC, Dialect, dialect_of
from wisar_planner.mavlink.modes import is_armed

_NO_HEADING = 65_535
_CHUNK_BYTES = 50  # of a STATUSTEXT
POSITION_KNOWN_FOR_S = 5.0
"""How old a position may be and still tell where the vehicle is, s."""


@dataclass(frozen=True)
class VehicleState:
    """A snapshot of the vehicle.

    Parameters
    ----------
    system, component
        Ids of the autopilot.
    autopilot, vehicle_type
        MAV_AUTOPILOT and MAV_TYPE codes of the heartbeat.
    custom_mode
        The autopilot's own number of its mode.
    armed
        Whether the motors may turn.
    landed
        Whether the vehicle stands on the ground; None where it does not tell.
    heard_at
        Monotonic time in seconds of the last heartbeat.
    latitude, longitude
        Degrees, as last told; None before the first position. See `place_at`.
    position_at
        Monotonic time in seconds at which they were told.
    altitude, relative_altitude
        Metres above mean sea level and above home.
    velocity
        North, east and down in m/s.
    heading
        Radians clockwise from north; None if the vehicle does not know it.
    home
        Latitude, longitude (degrees) and altitude (m) of home, once told.
    current_item, reached_item
        Item being flown to and last item reached, in the mission's own numbering (without
        ArduPilot's home item); None if not told.
    text
        Last status text of the vehicle.
    """

    system: int
    component: int
    autopilot: int = mav.MAV_AUTOPILOT_GENERIC
    vehicle_type: int = mav.MAV_TYPE_GENERIC
    custom_mode: int = 0
    armed: bool = False
    landed: bool | None = None
    heard_at: float = 0.0
    latitude: float | None = None
    longitude: float | None = None
    position_at: float = -math.inf
    altitude: float = 0.0
    relative_altitude: float = 0.0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading: float | None = None
    home: tuple[float, float, float] | None = None
    current_item: int | None = None
    reached_item: int | None = None
    text: str = ""

    @property
    def dialect(self) -> Dialect:
        """How this autopilot speaks the mission protocol."""
        return dialect_of(self.autopilot) if self.heard_at else GENERIC

    def place_at(self, now: float) -> tuple[float, float] | None:
        """Return latitude and longitude, or None where they are not known at a time any more."""
        if self.latitude is None or self.longitude is None:
            return None
        known = now - self.position_at <= POSITION_KNOWN_FOR_S
        return (self.latitude, self.longitude) if known else None


_LANDED = {
    mav.MAV_LANDED_STATE_ON_GROUND: True,
    mav.MAV_LANDED_STATE_IN_AIR: False,
    mav.MAV_LANDED_STATE_TAKEOFF: False,
    mav.MAV_LANDED_STATE_LANDING: False,
}
# ArduPilot tells it by the heartbeat; others are ACTIVE as soon as they are armed.
_ARDUPILOT_LANDED = {mav.MAV_STATE_STANDBY: True, mav.MAV_STATE_ACTIVE: False}


def _is_place(latitude: int, longitude: int) -> bool:
    """Whether 1e-7 degrees lie on Earth; 0, 0 is what a vehicle tells before its GPS's fix."""
    on_earth = abs(latitude) <= 900_000_000 and abs(longitude) <= 1_800_000_000
    return on_earth and not latitude == longitude == 0


def _text_of(message: Message) -> str:
    text = message.text
    return text if isinstance(text, str) else str(text.decode("utf-8", "replace"))


def is_last_chunk(message: Message) -> bool:
    """Whether the text of a STATUSTEXT ends with it; a full chunk of a longer one does not."""
    return not message.id or len(_text_of(message).encode()) < _CHUNK_BYTES


def changes(state: VehicleState, message: Message, now: float) -> dict[str, object]:
    """Return the fields of `state` that a telemetry message replaces; empty if none."""
    name = message.get_type()
    if name == "HEARTBEAT":
        ardupilot = message.autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA
        status = message.system_status
        return {
            # A failsafe, which hides it, does not lift a vehicle off the ground.
            "landed": _ARDUPILOT_LANDED.get(status, state.landed) if ardupilot else state.landed,
            "autopilot": message.autopilot,
            "vehicle_type": message.type,
            "custom_mode": message.custom_mode,
            "armed": is_armed(message),
            "heard_at": now,
        }
    if name == "GLOBAL_POSITION_INT":
        if not _is_place(message.lat, message.lon):
            return {}
        known = message.hdg != _NO_HEADING
        return {
            "latitude": message.lat * 1e-7,
            "longitude": message.lon * 1e-7,
            "position_at": now,
            "altitude": message.alt * 1e-3,
            "relative_altitude": message.relative_alt * 1e-3,
            "velocity": (message.vx * 0.01, message.vy * 0.01, message.vz * 0.01),
            "heading": message.hdg * 0.01 * 0.017453292519943295 if known else None,
        }
    if name == "EXTENDED_SYS_STATE" and state.autopilot != mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return {"landed": _LANDED.get(message.landed_state)}
    if name == "HOME_POSITION":
        if not _is_place(message.latitude, message.longitude):
            return {}
        return {
            "home": (message.latitude * 1e-7, message.longitude * 1e-7, message.altitude * 1e-3)
        }
    if name in ("MISSION_CURRENT", "MISSION_ITEM_REACHED"):
        seq = message.seq - (1 if state.dialect.home_item else 0)
        field = "current_item" if name == "MISSION_CURRENT" else "reached_item"
        return {field: seq if seq >= 0 else None}
    if name == "STATUSTEXT":
        # A text longer than 50 bytes comes in chunks with the same id.
        before = state.text if message.id and message.chunk_seq else ""
        text = before + _text_of(message)
        return {"text": text.rstrip() if is_last_chunk(message) else text}
    return {}
