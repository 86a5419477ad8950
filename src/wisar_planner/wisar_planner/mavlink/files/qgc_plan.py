"""QGroundControl plan files (https://docs.qgroundcontrol.com/master/en/qgc-dev-guide/file_formats/plan.html)."""

from __future__ import annotations

import json
import math
from typing import Any

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.mission import Mission, MissionItem, plain_frame
from wisar_planner.mavlink.rings import fence_rings

# QGroundControl's own numbers for how an altitude is meant.
_ALTITUDE_MODES = {
    mav.MAV_FRAME_GLOBAL_RELATIVE_ALT: 1,
    mav.MAV_FRAME_GLOBAL: 2,
    mav.MAV_FRAME_GLOBAL_TERRAIN_ALT: 4,
}


def render(mission: Mission, name: str) -> str:
    """Return the text of a .plan file; `name` has no place in this format."""
    rings = fence_rings(mission.fence)
    plan = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {
            "version": 2,
            "circles": [],
            "polygons": [
                {"version": 1, "inclusion": ring.inclusion, "polygon": ring.corners.tolist()}
                for ring in rings
            ],
        },
        "rallyPoints": {
            "version": 2,
            "points": [[p.latitude, p.longitude, p.z] for p in mission.rally],
        },
        "mission": {
            "version": 2,
            "firmwareType": int(mav.MAV_AUTOPILOT_PX4),
            "vehicleType": int(mav.MAV_TYPE_QUADROTOR),
            "cruiseSpeed": _speed(mission),
            "hoverSpeed": _speed(mission),
            "globalPlanAltitudeMode": _altitude_mode(mission),
            "plannedHomePosition": _home(mission),
            "items": [_item(item, number) for number, item in enumerate(mission.items, start=1)],
        },
    }
    return json.dumps(plan, indent=2, allow_nan=False) + "\n"


def _speed(mission: Mission) -> float:
    speeds = (i.params[1] for i in mission.items if i.command == mav.MAV_CMD_DO_CHANGE_SPEED)
    return next(speeds, 5.0)


def _altitude_mode(mission: Mission) -> int:
    waypoint = next(i for i in mission.items if i.is_waypoint)
    return _ALTITUDE_MODES.get(plain_frame(waypoint.frame), 1)


def _home(mission: Mission) -> list[float]:
    first = next(i for i in mission.items if i.is_global)
    # The ground's height is not known here; QGroundControl asks its elevation service.
    return [first.latitude, first.longitude, 0.0]


def _item(item: MissionItem, number: int) -> dict[str, Any]:
    place = [item.latitude, item.longitude] if item.is_global else [float(item.x), float(item.y)]
    row: dict[str, Any] = {
        "type": "SimpleItem",
        "command": item.command,
        "frame": plain_frame(item.frame),
        "params": [None if math.isnan(p) else p for p in (*item.params, *place, item.z)],
        "autoContinue": item.autocontinue,
        "doJumpId": number,
    }
    if item.is_global:
        row["Altitude"] = item.z
        row["AltitudeMode"] = _ALTITUDE_MODES.get(plain_frame(item.frame), 1)
        row["AMSLAltAboveTerrain"] = None
    return row
