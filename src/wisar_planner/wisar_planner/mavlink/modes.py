"""How each family of autopilots is told to start, pause and come home."""

from __future__ import annotations

from enum import Enum

from pymavlink.dialects.v20 import common as mav

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

# ArduPilot mode numbers; copters pause in BRAKE, because LOITER obeys the throttle stick.
_COPTER_MODES = {Intent.START: 3.0, Intent.PAUSE: 17.0, Intent.RESUME: 3.0, Intent.RETURN: 6.0}
# In these a copter refuses to be armed (it is left in AUTO or RTL after a flight); GUIDED waits.
_COPTER_NOT_ARMABLE = frozenset({3, 6, 9, 17, 21})  # AUTO, RTL, LAND, BRAKE, SMART_RTL
_COPTER_GUIDED = 4.0
_PLANE_MODES = {Intent.START: 10.0, Intent.PAUSE: 12.0, Intent.RESUME: 10.0, Intent.RETURN: 11.0}

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
