"""ArduPilot waypoint files (https://mavlink.io/en/file_formats/#mission_plain_text_file)."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.mission import Mission, MissionItem, plain_frame

_HEADER = "QGC WPL 110"


def render(mission: Mission, name: str) -> str:
    """Return the text of a .waypoints file: the flight, after a row for home.

    `name`, fence and rally points have no place in this format.
    """
    first = next(i for i in mission.items if i.is_global)
    home = MissionItem(mav.MAV_CMD_NAV_WAYPOINT, mav.MAV_FRAME_GLOBAL, x=first.x, y=first.y)
    rows = [_row(item, number) for number, item in enumerate((home, *mission.items))]
    return "\n".join((_HEADER, *rows)) + "\n"


def _row(item: MissionItem, number: int) -> str:
    params = (0.0 if math.isnan(p) else p for p in item.params)
    if item.is_global:
        place = (f"{item.latitude:.8f}", f"{item.longitude:.8f}")
    else:
        place = (str(item.x), str(item.y))
    columns = (
        number,
        1 if number == 0 else 0,
        plain_frame(item.frame),
        item.command,
        *(f"{p:.8f}" for p in params),
        *place,
        f"{item.z:.6f}",
        int(item.autocontinue),
    )
    return "\t".join(str(c) for c in columns)
