"""Files for pilots who fly without ROS, chosen by the file name's ending."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.files import geojson, gpx, kml, qgc_plan, waypoints
from wisar_planner.mavlink.mission import Mission

__all__ = ["plan_file_suffixes", "write_plan_file"]

_WRITERS: dict[str, Callable[[Mission, str], str]] = {
    ".plan": qgc_plan.render,
    ".waypoints": waypoints.render,
    ".kml": kml.render,
    ".gpx": gpx.render,
    ".geojson": geojson.render,
}


def plan_file_suffixes() -> tuple[str, ...]:
    """Return the endings that `write_plan_file` knows."""
    return tuple(_WRITERS)


def write_plan_file(path: Path, mission: Mission, *, name: str = "Search") -> None:
    """Write a mission into a file in the format that its ending names.

    Parameters
    ----------
    path
        ``.plan`` (QGroundControl), ``.waypoints`` (ArduPilot's QGC WPL 110, the flight only),
        ``.kml`` (Google Earth), ``.gpx`` (GPS receivers) or ``.geojson`` (GIS programs).
    mission
        What to write. The last three formats are drawings of it and leave out commands.
    name
        Title shown by programs that show one.

    Raises
    ------
    InvalidInput
        If the ending is none of these, or the mission has no waypoint.
    OSError
        If the file cannot be written.
    """
    render = _WRITERS.get(path.suffix.lower())
    if render is None:
        raise InvalidInput(
            f"path: {path.name} must end in one of {', '.join(plan_file_suffixes())}"
        )
    if not len(mission.waypoints):
        raise InvalidInput("mission has no waypoint; plan a search first")
    path.write_text(render(mission, name), encoding="utf-8")
