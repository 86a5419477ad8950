"""MAVLink's result codes in words, each with what to do about it."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mav

_MISSION_RESULTS: dict[int, str] = {
    mav.MAV_MISSION_ACCEPTED: "accepted",
    mav.MAV_MISSION_ERROR: (
        "the autopilot refused without a reason; wait until it is idle, then try again"
    ),
    mav.MAV_MISSION_UNSUPPORTED_FRAME: (
        "the autopilot does not know the altitude frame; use altitude_frame 'relative'"
    ),
    mav.MAV_MISSION_UNSUPPORTED: (
        "the autopilot does not know a command of the mission; leave out the camera trigger or "
        "what else is special"
    ),
    mav.MAV_MISSION_NO_SPACE: (
        "the mission does not fit into the autopilot's memory; use fewer waypoints, or wait if "
        "the autopilot has just started"
    ),
    mav.MAV_MISSION_INVALID: "an item is invalid; check altitudes, speed and fence corners",
    mav.MAV_MISSION_INVALID_PARAM1: "parameter 1 of an item is invalid; check speed and times",
    mav.MAV_MISSION_INVALID_PARAM2: "parameter 2 of an item is invalid; check the speed",
    mav.MAV_MISSION_INVALID_PARAM3: "parameter 3 of an item is invalid",
    mav.MAV_MISSION_INVALID_PARAM4: "parameter 4 of an item is invalid; check the heading",
    mav.MAV_MISSION_INVALID_PARAM5_X: "the latitude of an item is invalid; check the plan",
    mav.MAV_MISSION_INVALID_PARAM6_Y: "the longitude of an item is invalid; check the plan",
    mav.MAV_MISSION_INVALID_PARAM7: "the altitude of an item is invalid; check the altitude",
    mav.MAV_MISSION_INVALID_SEQUENCE: (
        "an item arrived out of order, which happens on a bad link; try again"
    ),
    mav.MAV_MISSION_DENIED: (
        "the autopilot takes no mission from this sender now; end other uploads, check the ids"
    ),
    mav.MAV_MISSION_OPERATION_CANCELLED: (
        "the autopilot cancelled the transfer, mostly because the link was silent; try again"
    ),
}

# These say something about the moment, not about the mission: the same mission may pass next time.
_PASSING = frozenset(
    {
        mav.MAV_MISSION_ERROR,
        mav.MAV_MISSION_NO_SPACE,
        mav.MAV_MISSION_INVALID_SEQUENCE,
        mav.MAV_MISSION_DENIED,
        mav.MAV_MISSION_OPERATION_CANCELLED,
    }
)

_COMMAND_RESULTS: dict[int, str] = {
    mav.MAV_RESULT_ACCEPTED: "accepted",
    mav.MAV_RESULT_TEMPORARILY_REJECTED: "not possible now; try again when the vehicle is ready",
    mav.MAV_RESULT_DENIED: "denied; check arming, mode and the vehicle's own messages",
    mav.MAV_RESULT_UNSUPPORTED: "not supported by this autopilot",
    mav.MAV_RESULT_FAILED: "failed; read the vehicle's own messages",
    mav.MAV_RESULT_IN_PROGRESS: "in progress",
    mav.MAV_RESULT_COMMAND_LONG_ONLY: "only accepted as COMMAND_LONG",
    mav.MAV_RESULT_COMMAND_INT_ONLY: "only accepted as COMMAND_INT",
}


def _code_name(enum: str, code: int) -> str:
    entry = mav.enums[enum].get(code)
    return entry.name if entry is not None else f"{enum} {code}"


def mission_result(code: int) -> str:
    """Say what a MAV_MISSION_RESULT means and what to do."""
    words = _MISSION_RESULTS.get(code, "the autopilot refused with a code that is not known")
    return f"{words} ({_code_name('MAV_MISSION_RESULT', code)})"


def is_passing(code: int) -> bool:
    """Whether the same mission may be accepted at another moment."""
    return code in _PASSING


def command_result(code: int) -> str:
    """Say what a MAV_RESULT means and what to do."""
    words = _COMMAND_RESULTS.get(code, "answered with a code that is not known")
    return f"{words} ({_code_name('MAV_RESULT', code)})"
