"""How each family of autopilots is told to start, pause and come home."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Message

Commands = tuple[tuple[int, tuple[float, ...]], ...]
"""MAV_CMD codes with their parameters, to be sent one after the other."""


class Intent(Enum):
    """What the operator asked for."""

    ARM = 1
    DISARM = 2
    START = 3
    PAUSE = 4
    RESUME = 5
    RETURN = 6


# PX4 custom mode: main mode 4 is AUTO, its sub-modes as in px4_custom_mode.h.
_PX4_AUTO = 4.0
_PX4_SUB_MODES = {Intent.PAUSE: 3.0, Intent.RESUME: 4.0, Intent.RETURN: 5.0}
_PX4_FLIES = frozenset({2, 4, 5, 8, 10})  # takeoff, mission, return, follow, VTOL takeoff

# ArduPilot mode numbers; copters pause in BRAKE, because LOITER obeys the throttle stick.
_COPTER_MODES = {Intent.START: 3.0, Intent.PAUSE: 17.0, Intent.RESUME: 3.0, Intent.RETURN: 6.0}
# In these a copter refuses to be armed (it is left in AUTO or RTL after a flight); GUIDED waits.
_COPTER_NOT_ARMABLE = frozenset({3, 6, 9, 17, 21, 27})  # AUTO, RTL, LAND, BRAKE, SMART, AUTO RTL
_COPTER_FLIES = frozenset({3, 6, 21, 27})
_COPTER_GUIDED = 4.0
_PLANE_MODES = {Intent.START: 10.0, Intent.PAUSE: 12.0, Intent.RESUME: 10.0, Intent.RETURN: 11.0}

_PLANE_FLIES = frozenset({10, 11, 13, 21})  # AUTO, RTL, TAKEOFF, QRTL

_PLANE_TYPES = frozenset(
    {
        mav.MAV_TYPE_FIXED_WING,
        *(code for code, entry in mav.enums["MAV_TYPE"].items() if "_VTOL_" in entry.name),
    }
)


def commands_for(
    intent: Intent, autopilot: int, vehicle_type: int, custom_mode: int = 0
) -> Commands:
    """Return the commands that express an intent.

    Parameters
    ----------
    intent
        What the operator asked for.
    autopilot, vehicle_type
        MAV_AUTOPILOT and MAV_TYPE codes of the heartbeat.
    custom_mode
        The autopilot's own mode in the heartbeat.
    """
    if intent in (Intent.ARM, Intent.DISARM):
        on = 1.0 if intent is Intent.ARM else 0.0
        arm = (mav.MAV_CMD_COMPONENT_ARM_DISARM, (on,))
        copter = autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA and vehicle_type not in _PLANE_TYPES
        if intent is Intent.ARM and copter and custom_mode in _COPTER_NOT_ARMABLE:
            return (_set_mode(_COPTER_GUIDED), arm)
        # After the landing PX4 is back in the mode of the flight; armed in it, it would fly off.
        px4 = autopilot == mav.MAV_AUTOPILOT_PX4
        if intent is Intent.ARM and px4 and flies_by_itself(autopilot, vehicle_type, custom_mode):
            return (_set_mode(_PX4_AUTO, _PX4_SUB_MODES[Intent.PAUSE]), arm)
        return (arm,)
    start = (mav.MAV_CMD_MISSION_START, (0.0, 0.0))
    if autopilot == mav.MAV_AUTOPILOT_PX4:
        if intent is Intent.START:
            return (start,)
        return (_set_mode(_PX4_AUTO, _PX4_SUB_MODES[intent]),)
    if autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
        modes = _PLANE_MODES if vehicle_type in _PLANE_TYPES else _COPTER_MODES
        mode = _set_mode(modes[intent])
        return (mode, start) if intent is Intent.START else (mode,)
    return {
        Intent.START: (start,),
        Intent.PAUSE: ((mav.MAV_CMD_DO_PAUSE_CONTINUE, (0.0,)),),
        Intent.RESUME: ((mav.MAV_CMD_DO_PAUSE_CONTINUE, (1.0,)),),
        Intent.RETURN: ((mav.MAV_CMD_NAV_RETURN_TO_LAUNCH, ()),),
    }[intent]


def _set_mode(mode: float, sub_mode: float = 0.0) -> tuple[int, tuple[float, ...]]:
    return (
        mav.MAV_CMD_DO_SET_MODE,
        (float(mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED), mode, sub_mode),
    )


def _custom_mode(mode: float, sub_mode: float, autopilot: int) -> int:
    """Return the custom mode that the heartbeat shows after DO_SET_MODE."""
    if autopilot == mav.MAV_AUTOPILOT_PX4:
        return int(mode) << 16 | int(sub_mode) << 24
    return int(mode)


def is_armed(heartbeat: Message) -> bool:
    """Whether a HEARTBEAT says that the motors may turn."""
    return bool(heartbeat.base_mode & mav.MAV_MODE_FLAG_SAFETY_ARMED)


def shown_by(
    command: int, params: tuple[float, ...], autopilot: int, vehicle_type: int
) -> Callable[[Message], bool] | None:
    """Return what says of a HEARTBEAT whether it shows what a command asked for.

    Parameters
    ----------
    command, params
        One of the steps of `commands_for`.
    autopilot, vehicle_type
        As for `commands_for`.

    Returns
    -------
    callable or None
        None where a heartbeat cannot show it.
    """
    if command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
        wanted = params[0] == 1.0
        return lambda heartbeat: is_armed(heartbeat) is wanted
    if command == mav.MAV_CMD_DO_SET_MODE:
        mode = _custom_mode(params[1], params[2], autopilot)
        return lambda heartbeat: heartbeat.custom_mode == mode
    if command == mav.MAV_CMD_MISSION_START and autopilot != mav.MAV_AUTOPILOT_GENERIC:
        return lambda heartbeat: (
            is_armed(heartbeat) and flies_mission(autopilot, vehicle_type, heartbeat.custom_mode)
        )
    return None


def flies_mission(autopilot: int, vehicle_type: int, custom_mode: int) -> bool:
    """Whether a vehicle in this mode flies its mission; False where modes are not known."""
    return _is_mode_of(Intent.RESUME, autopilot, vehicle_type, custom_mode)


def may_fly_mission(autopilot: int, vehicle_type: int, custom_mode: int) -> bool:
    """Whether a vehicle in this mode flies its mission; True where modes are not known."""
    known = autopilot in (mav.MAV_AUTOPILOT_PX4, mav.MAV_AUTOPILOT_ARDUPILOTMEGA)
    return not known or flies_mission(autopilot, vehicle_type, custom_mode)


def returns_home(autopilot: int, vehicle_type: int, custom_mode: int) -> bool:
    """Whether a vehicle in this mode returns to its launch place; False where not known."""
    return _is_mode_of(Intent.RETURN, autopilot, vehicle_type, custom_mode)


def _is_mode_of(intent: Intent, autopilot: int, vehicle_type: int, custom_mode: int) -> bool:
    if autopilot == mav.MAV_AUTOPILOT_PX4:
        wanted = _custom_mode(_PX4_AUTO, _PX4_SUB_MODES[intent], autopilot)
        return custom_mode & 0xFFFF0000 == wanted
    if autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
        modes = _PLANE_MODES if vehicle_type in _PLANE_TYPES else _COPTER_MODES
        return custom_mode == int(modes[intent])
    return False


def flies_by_itself(autopilot: int, vehicle_type: int, custom_mode: int) -> bool:
    """Whether a vehicle in this mode flies off once it is armed; False where not known."""
    if autopilot == mav.MAV_AUTOPILOT_PX4:
        main, sub_mode = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        return main == int(_PX4_AUTO) and sub_mode in _PX4_FLIES
    if autopilot == mav.MAV_AUTOPILOT_ARDUPILOTMEGA:
        return custom_mode in (_PLANE_FLIES if vehicle_type in _PLANE_TYPES else _COPTER_FLIES)
    return False
