"""From a path over an area to a mission."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.checks import check_mission
from wisar_planner.mavlink.search_mission import MissionSettings, search_mission
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_planner.search import SearchArea, SearchPath

FRAME = LocalFrame(GeoOrigin(56.79, -5.0))
PATH = SearchPath(np.array([[-80.0, -80.0], [80.0, -80.0], [80.0, 80.0]]), 25.0)
SQUARE = SearchArea.rectangle(-100.0, -100.0, 100.0, 100.0)


def fence_polygons(mission, command: int) -> list[shapely.Polygon]:
    """Read the fence as an autopilot does: runs of vertices, each telling its polygon's size."""
    vertices = [item for item in mission.fence if item.command == command]
    polygons = []
    while vertices:
        count = round(vertices[0].params[0])
        corners, vertices = vertices[:count], vertices[count:]
        points = FRAME.to_local([c.latitude for c in corners], [c.longitude for c in corners])
        polygons.append(shapely.Polygon(points))
    return polygons


def test_the_altitude_shows_the_swath() -> None:
    mission = search_mission(PATH, FRAME, MissionSettings(field_of_view=math.radians(45.0)))
    # SAREnv's example turned round: 33.1 m at 80 m with 45 degrees, so 25 m at 60.4 m.
    assert mission.waypoints[:, 2] == pytest.approx(60.36, abs=0.01)
    np.testing.assert_allclose(
        FRAME.to_local(mission.waypoints[:, 0], mission.waypoints[:, 1]), PATH.waypoints, atol=0.02
    )


def test_the_fence_is_the_area_with_its_margin_and_holes() -> None:
    area = SearchArea(
        shapely.Polygon(SQUARE.polygon.exterior, [shapely.box(-40, -40, -20, -20).exterior.coords])
    )
    mission = search_mission(
        PATH, FRAME, MissionSettings(fence=True, fence_margin_m=10.0), area=area
    )
    (inclusion,) = fence_polygons(mission, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION)
    (exclusion,) = fence_polygons(mission, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION)
    assert inclusion.symmetric_difference(shapely.box(-110, -110, 110, 110)).area < 10.0
    assert exclusion.symmetric_difference(shapely.box(-40, -40, -20, -20)).area < 2.0
    assert check_mission(mission) == ()


def test_an_area_in_parts_is_fenced_as_a_whole() -> None:
    area = SearchArea(
        shapely.MultiPolygon([shapely.box(-100, -100, 0, 100), shapely.box(60, -100, 100, 100)])
    )
    mission = search_mission(
        PATH, FRAME, MissionSettings(fence=True, fence_margin_m=0.0), area=area
    )
    (inclusion,) = fence_polygons(mission, mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION)
    assert inclusion.buffer(0.05).covers(SQUARE.polygon)


def test_the_launch_point_becomes_a_rally_point() -> None:
    mission = search_mission(PATH, FRAME, MissionSettings(rally=True), launch=(56.79, -5.0))
    assert [(r.latitude, r.longitude) for r in mission.rally] == [(56.79, -5.0)]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (MissionSettings(fence=True), "area is not known"),
        (MissionSettings(rally=True), "launch point is not known"),
        (MissionSettings(altitude_m=-5.0), "altitude"),
        (MissionSettings(field_of_view=0.0), "field_of_view"),
        (MissionSettings(speed=math.nan), "speed"),
    ],
)
def test_what_cannot_be_right_is_refused(settings: MissionSettings, words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        search_mission(PATH, FRAME, settings)
