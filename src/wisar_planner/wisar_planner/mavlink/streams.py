"""Telemetry that has to be asked for: ArduPilot sends nothing but heartbeats of its own accord."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.exchange import Address

_FIRST_PAUSE_S = 3.0
_LONGEST_PAUSE_S = 30.0


@dataclass
class _Stream:
    """A message that the flight cannot be followed without.

    Parameters
    ----------
    code
        Its message id.
    every_s
        Interval to ask for.
    silence_s
        How long it may be missing before it is asked for.
    """

    code: int
    every_s: float
    silence_s: float
    ask_at: float = math.inf
    pause: float = _FIRST_PAUSE_S


class Streams:
    """Asks for position, mission progress and home when they do not come by themselves.

    What arrives, at whatever rate, is left alone; what does not is asked for again and again, at
    growing intervals, as the request may be lost or the vehicle restarted.

    Parameters
    ----------
    vehicle
        Who is asked.
    """

    def __init__(self, vehicle: Address) -> None:
        self._vehicle = vehicle
        self._streams = {
            "GLOBAL_POSITION_INT": _Stream(mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, 0.25, 2.0),
            "MISSION_CURRENT": _Stream(mav.MAVLINK_MSG_ID_MISSION_CURRENT, 1.0, 4.0),
            "HOME_POSITION": _Stream(mav.MAVLINK_MSG_ID_HOME_POSITION, 5.0, 15.0),
        }

    def heard(self, name: str, now: float) -> None:
        """Take in that a message of this name came."""
        stream = self._streams.get(name)
        if stream is not None:
            stream.ask_at = now + stream.silence_s
            stream.pause = _FIRST_PAUSE_S

    def due(self, now: float) -> list[Message]:
        """Return the requests to send now."""
        out = []
        for stream in self._streams.values():
            if math.isinf(stream.ask_at):
                stream.ask_at = now + min(stream.silence_s, _FIRST_PAUSE_S)
            if now < stream.ask_at:
                continue
            stream.ask_at = now + stream.pause
            stream.pause = min(2.0 * stream.pause, _LONGEST_PAUSE_S)
            out.append(
                mav.MAVLink_command_long_message(
                    self._vehicle.system,
                    self._vehicle.component,
                    mav.MAV_CMD_SET_MESSAGE_INTERVAL,
                    0,
                    stream.code,
                    stream.every_s * 1e6,
                    *(0.0,) * 5,
                )
            )
        return out
