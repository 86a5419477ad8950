"""How real autopilots answer, as measured on PX4, ArduCopter and MAVSDK's mission server."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from pymavlink.dialects.v20 import common as mav


class Requests(Enum):
    """How items are asked for."""

    INT = "MISSION_REQUEST_INT"
    LEGACY = "MISSION_REQUEST"
    ADAPTIVE = "either"


_FRAMES = frozenset(
    {
        mav.MAV_FRAME_GLOBAL,
        mav.MAV_FRAME_MISSION,
        mav.MAV_FRAME_GLOBAL_RELATIVE_ALT,
        mav.MAV_FRAME_GLOBAL_INT,
        mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
    }
)
_TERRAIN_FRAMES = frozenset(
    {mav.MAV_FRAME_GLOBAL_TERRAIN_ALT, mav.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT}
)


@dataclass(frozen=True)
class Profile:
    """The behaviour of one family of autopilots.

    Parameters
    ----------
    name
        Name on the command line.
    autopilot
        MAV_AUTOPILOT code in the heartbeat.
    requests
        How items are asked for: with MISSION_REQUEST_INT (INT), always with the older
        MISSION_REQUEST (LEGACY), or with the older one until the client speaks the newer
        (ADAPTIVE).
    checks_commands
        Whether unknown commands and frames are refused.
    frames
        Altitude frames that are known, where unknown ones are refused.
    checks_values
        Whether places and altitudes that cannot be, and NaN parameters, are refused.
    says_wrong_sequence
        Whether an item that was not asked for is answered: with INVALID_SEQUENCE in an upload,
        with ERROR outside one. It does not count as a sign of life.
    wrong_sequence_aborts
        Whether it ends the upload as well. No profile does that; clients should survive it.
    retry_after_s
        When an item that did not come is asked for again.
    gives_up_after_s
        When a silent client is given up.
    says_giving_up
        Whether giving up is told with OPERATION_CANCELLED.
    capacity
        Most items of one list.
    boot_s
        Seconds after start in which uploads are answered with NO_SPACE.
    home_item
        Whether item 0 of the mission is home.
    busy_when_transferring
        Whether a second transfer is ignored while one is in progress.
    repeats_acknowledgement
        Whether the last item, sent again, is acknowledged again.
    plain_places
        Whether fence corners and rally points keep nothing but their place and first parameter:
        the others read back as 0, autocontinue too.
    start_arms
        Whether MISSION_START arms a vehicle that is not.
    checks_for_s
        Seconds after an upload in which the mission cannot be started yet.
    tells_return
        Whether a return to launch is told as reached.
    stays_in_mission
        Whether the mode remains that of the mission at its end, in which, as in a return, the
        vehicle cannot be armed.
    replaces_in_place
        Whether a mission is cut to the new length when an upload begins, and its items are
        replaced one by one as they come; the others replace it as a whole.
    goes_on
        Whether a mission that is replaced, or started anew, in flight goes on with the item that
        is current then; the others begin with the first.
    streams_when_asked
        Whether nothing but the heartbeat is sent regularly until it is asked for.
    """

    name: str
    autopilot: int
    requests: Requests = Requests.INT
    checks_commands: bool = True
    frames: frozenset[int] = _FRAMES | _TERRAIN_FRAMES
    checks_values: bool = False
    says_wrong_sequence: bool = False
    wrong_sequence_aborts: bool = False
    retry_after_s: float = 0.26
    gives_up_after_s: float = 5.0
    says_giving_up: bool = False
    capacity: int = 10_000
    boot_s: float = 0.0
    home_item: bool = False
    busy_when_transferring: bool = False
    repeats_acknowledgement: bool = False
    plain_places: bool = False
    start_arms: bool = False
    checks_for_s: float = 0.0
    tells_return: bool = True
    stays_in_mission: bool = False
    streams_when_asked: bool = False
    replaces_in_place: bool = False
    goes_on: bool = False


PROFILES: dict[str, Profile] = {
    "px4": Profile(
        "px4",
        mav.MAV_AUTOPILOT_PX4,
        requests=Requests.ADAPTIVE,
        frames=_FRAMES,
        busy_when_transferring=True,
        repeats_acknowledgement=True,
        plain_places=True,
        start_arms=True,
        checks_for_s=1.0,
        tells_return=False,
    ),
    "ardupilot": Profile(
        "ardupilot",
        mav.MAV_AUTOPILOT_ARDUPILOTMEGA,
        requests=Requests.LEGACY,
        checks_values=True,
        says_wrong_sequence=True,
        retry_after_s=1.0,
        gives_up_after_s=8.0,
        says_giving_up=True,
        boot_s=6.0,
        home_item=True,
        stays_in_mission=True,
        streams_when_asked=True,
        replaces_in_place=True,
        goes_on=True,
    ),
    "mavsdk": Profile(
        "mavsdk",
        mav.MAV_AUTOPILOT_GENERIC,
        checks_commands=False,
        retry_after_s=0.5,
        gives_up_after_s=2.0,
        capacity=65_535,
    ),
}

KNOWN_COMMANDS: dict[int, frozenset[int]] = {
    mav.MAV_MISSION_TYPE_MISSION: frozenset(
        {
            mav.MAV_CMD_NAV_WAYPOINT,
            mav.MAV_CMD_NAV_LOITER_UNLIM,
            mav.MAV_CMD_NAV_LOITER_TIME,
            mav.MAV_CMD_NAV_RETURN_TO_LAUNCH,
            mav.MAV_CMD_NAV_LAND,
            mav.MAV_CMD_NAV_TAKEOFF,
            mav.MAV_CMD_NAV_DELAY,
            mav.MAV_CMD_CONDITION_YAW,
            mav.MAV_CMD_DO_JUMP,
            mav.MAV_CMD_DO_CHANGE_SPEED,
            mav.MAV_CMD_DO_SET_ROI_LOCATION,
            mav.MAV_CMD_DO_SET_ROI_NONE,
            mav.MAV_CMD_DO_MOUNT_CONTROL,
            mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
            mav.MAV_CMD_IMAGE_START_CAPTURE,
            mav.MAV_CMD_IMAGE_STOP_CAPTURE,
        }
    ),
    mav.MAV_MISSION_TYPE_FENCE: frozenset(
        {
            mav.MAV_CMD_NAV_FENCE_RETURN_POINT,
            mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
            mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
            mav.MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION,
            mav.MAV_CMD_NAV_FENCE_CIRCLE_EXCLUSION,
        }
    ),
    mav.MAV_MISSION_TYPE_RALLY: frozenset({mav.MAV_CMD_NAV_RALLY_POINT}),
}
"""Commands that the simulated vehicle can execute, by list."""
