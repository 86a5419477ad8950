"""From a planned path over a search area to the mission that flies it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.camera import altitude_for_swath
from wisar_planner.mavlink.mission import AltitudeFrame, End, Mission, build_mission
from wisar_planner.pdm.geodesy import LocalFrame
from wisar_planner.search import SearchArea, SearchPath


@dataclass(frozen=True)
class MissionSettings:
    """How a path is flown.

    Parameters
    ----------
    altitude_m
        Flying height above the launch point (above ground for the terrain frame), m; None takes
        the height at which the camera sees the path's swath.
    field_of_view
        Angle of view across the direction of flight, radians; used where `altitude_m` is None.
    speed
        Ground speed, m/s; None leaves the vehicle's own setting.
    takeoff
        Whether the mission begins with a takeoff.
    end
        ``"return_to_launch"`` or ``"loiter"``.
    altitude_frame
        ``"relative"`` to launch, or above ``"terrain"``.
    camera_trigger_m
        Distance between two pictures, m; None leaves the camera alone.
    fence
        Whether the search area becomes a geofence: an inclusion polygon, and keep-out polygons
        where the area has holes.
    fence_margin_m
        How far outside the search area the fence stands, m.
    rally
        Whether the launch point becomes a rally point.
    """

    altitude_m: float | None = None
    field_of_view: float = math.radians(45.0)
    speed: float | None = None
    takeoff: bool = True
    end: End = "return_to_launch"
    altitude_frame: AltitudeFrame = "relative"
    camera_trigger_m: float | None = None
    fence: bool = False
    fence_margin_m: float = 30.0
    rally: bool = False


def search_mission(
    path: SearchPath,
    frame: LocalFrame,
    settings: MissionSettings | None = None,
    *,
    area: SearchArea | None = None,
    launch: tuple[float, float] | None = None,
    takeoff_place: tuple[float, float] | None = None,
) -> Mission:
    """Build the mission of a path.

    Parameters
    ----------
    path
        In metres of `frame`.
    frame
        Where the metres lie on Earth.
    settings
        How to fly it.
    area
        The search area, needed for a fence.
    launch
        Latitude and longitude of the launch point in degrees, needed for a rally point.
    takeoff_place
        Where the vehicle is, in degrees; the launch point unless given. A vehicle in the air flies
        to the place of the takeoff first: a fixed wing would return to its launch point for it.

    Raises
    ------
    InvalidInput
        If a setting cannot be right, or what it needs is not known.
    """
    settings = settings or MissionSettings()
    altitude = settings.altitude_m
    if altitude is None:
        altitude = altitude_for_swath(path.swath_radius, settings.field_of_view)
    inclusions: list[NDArray[np.float64]] = []
    exclusions: list[NDArray[np.float64]] = []
    if settings.fence:
        if area is None:
            raise InvalidInput("fence: the search area is not known yet; wait for the map")
        inclusions, exclusions = _fence(area, frame, settings.fence_margin_m)
    if settings.rally and launch is None:
        raise InvalidInput("rally: the launch point is not known; wait for the vehicle's position")
    return build_mission(
        frame.to_geodetic(path.waypoints),
        altitude_m=altitude,
        speed=settings.speed,
        takeoff=settings.takeoff,
        end=settings.end,
        launch=launch if takeoff_place is None else takeoff_place,
        altitude_frame=settings.altitude_frame,
        camera_trigger_m=settings.camera_trigger_m,
        inclusions=inclusions,
        exclusions=exclusions,
        rally=[launch] if settings.rally and launch is not None else None,
    )


def _fence(
    area: SearchArea, frame: LocalFrame, margin: float
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Return the rings of inclusion and exclusion polygons in degrees."""
    if not (math.isfinite(margin) and margin >= 0.0):
        raise InvalidInput(f"fence_margin must be a finite number from 0, got {margin}")
    # A vehicle must stay inside every inclusion polygon, so an area in several parts can only
    # be fenced as a whole.
    widened = area.polygon.buffer(margin, join_style="mitre")
    outline = widened if isinstance(widened, Polygon) else widened.convex_hull
    assert isinstance(outline, Polygon)  # an area has an extent, so has its hull
    parts = getattr(area.polygon, "geoms", [area.polygon])
    holes = [ring for part in parts for ring in part.interiors]
    return (
        [_degrees(outline.exterior, frame)],
        [_degrees(ring, frame) for ring in holes],
    )


def _degrees(ring: shapely.LinearRing, frame: LocalFrame) -> NDArray[np.float64]:
    # The last corner of a shapely ring repeats the first, MAVLink's does not.
    return frame.to_geodetic(shapely.get_coordinates(ring)[:-1])
