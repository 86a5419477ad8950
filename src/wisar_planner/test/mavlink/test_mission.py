"""Mission items and the mission made of a plan."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.mission import (
    Mission,
    MissionItem,
    MissionKind,
    build_mission,
    fence_items,
    float32,
    plain_frame,
    rally_items,
)
from wisar_planner.mavlink.rings import fence_rings

PLAN = np.array([[57.0, -4.0], [57.001, -4.0], [57.001, -4.002]])
SQUARE = [(56.9, -4.1), (57.1, -4.1), (57.1, -3.9), (56.9, -3.9)]


def commands(mission: Mission) -> list[int]:
    return [item.command for item in mission.items]


def test_a_plan_becomes_takeoff_waypoints_and_return():
    mission = build_mission(PLAN, altitude_m=40.0)
    assert commands(mission) == [
        mav.MAV_CMD_NAV_TAKEOFF,
        *[mav.MAV_CMD_NAV_WAYPOINT] * 3,
        mav.MAV_CMD_NAV_RETURN_TO_LAUNCH,
    ]
    assert np.abs(mission.waypoints[:, :2] - PLAN).max() <= 0.5e-7
    assert (mission.waypoints[:, 2] == 40.0).all()
    frames = {item.frame for item in mission.items if item.is_waypoint}
    assert frames == {mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT}
    assert math.isnan(mission.items[1].params[3])  # the heading is the vehicle's own business


def test_speed_camera_terrain_and_loiter_are_optional_parts():
    mission = build_mission(
        PLAN,
        altitude_m=40.0,
        speed=7.5,
        takeoff=False,
        end="loiter",
        altitude_frame="terrain",
        camera_trigger_m=12.0,
    )
    assert commands(mission) == [
        mav.MAV_CMD_DO_CHANGE_SPEED,
        mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
        *[mav.MAV_CMD_NAV_WAYPOINT] * 3,
        mav.MAV_CMD_DO_SET_CAM_TRIGG_DIST,
        mav.MAV_CMD_NAV_LOITER_UNLIM,
    ]
    speed, camera_on, *_, camera_off, loiter = mission.items
    assert speed.params[:3] == (1.0, 7.5, -1.0)
    assert camera_on.params[0] == 12.0
    assert camera_off.params[0] == 0.0
    assert loiter.frame == mav.MAV_FRAME_GLOBAL_TERRAIN_ALT_INT
    assert (loiter.latitude, loiter.longitude) == pytest.approx(tuple(PLAN[-1]), abs=1e-7)


def test_the_takeoff_is_at_the_launch_point_and_never_above_terrain():
    mission = build_mission(PLAN, altitude_m=40.0, launch=(56.5, -4.5), altitude_frame="terrain")
    takeoff = mission.items[0]
    assert (takeoff.latitude, takeoff.longitude) == pytest.approx((56.5, -4.5), abs=1e-9)
    assert takeoff.frame == mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT


def test_fence_rings_are_open_and_carry_their_corner_count():
    fence = fence_items([[*SQUARE, SQUARE[0]]], [SQUARE[:3]])
    assert [i.params[0] for i in fence] == [4.0] * 4 + [3.0] * 3
    inclusion, exclusion = fence_rings(fence)
    assert inclusion.inclusion
    assert not exclusion.inclusion
    np.testing.assert_allclose(inclusion.corners, SQUARE, atol=1e-7)
    np.testing.assert_allclose(exclusion.corners, SQUARE[:3], atol=1e-7)


def test_an_incomplete_fence_polygon_is_left_out():
    fence = fence_items([SQUARE], [SQUARE])
    assert len(fence_rings(fence[:3])) == 0
    assert len(fence_rings(fence[:6])) == 1
    assert len(fence_rings((fence[0], *fence[4:]))) == 1


@pytest.mark.parametrize("count", [math.nan, math.inf, -math.inf, 1e38, -4.0])
def test_a_corner_count_that_is_no_number_makes_no_ring(count):
    first, *others = fence_items([SQUARE], [SQUARE])
    (exclusion,) = fence_rings((replace(first, params=(count, 0.0, 0.0, 0.0)), *others))
    assert not exclusion.inclusion


def test_rally_points_have_the_missions_altitude():
    (point,) = rally_items([(57.0, -4.0)], 33.0)
    assert (point.command, point.z) == (mav.MAV_CMD_NAV_RALLY_POINT, 33.0)
    assert build_mission(PLAN, altitude_m=33.0, rally=[(57.0, -4.0)]).rally == (point,)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"altitude_m": math.nan}, "altitude_m"),
        ({"altitude_m": 0.0}, "altitude_m"),
        ({"speed": -1.0}, "speed"),
        ({"camera_trigger_m": math.inf}, "camera_trigger_m"),
        ({"end": "land"}, "end"),
        ({"altitude_frame": "sea"}, "altitude_frame"),
        ({"inclusions": [SQUARE[:2]]}, "inclusions"),
        ({"exclusions": [[SQUARE[0]] * 4]}, "exclusions"),
        ({"rally": [(95.0, 0.0)]}, "latitude"),
        ({"launch": (0.0, 181.0)}, "longitude"),
    ],
)
def test_wrong_arguments_are_named(changes, word):
    with pytest.raises(InvalidInput, match=word):
        build_mission(PLAN, **{"altitude_m": 40.0, **changes})


@pytest.mark.parametrize("plan", [[], [1.0, 2.0], [[1.0, 2.0, 3.0]], [[math.nan, 0.0]]])
def test_wrong_plans_are_refused(plan):
    with pytest.raises(InvalidInput, match="plan_latlon"):
        build_mission(plan, altitude_m=40.0)


@given(
    st.floats(-90.0, 90.0),
    st.floats(-180.0, 180.0),
    st.floats(-500.0, 9000.0, width=32),
)
def test_places_are_kept_to_half_a_unit(latitude, longitude, altitude):
    item = MissionItem.at(mav.MAV_CMD_NAV_WAYPOINT, latitude, longitude, altitude)
    assert abs(item.latitude - latitude) <= 0.5e-7 + 1e-12
    assert abs(item.longitude - longitude) <= 0.5e-7 + 1e-12
    assert item.z == altitude
    assert item == MissionItem.at(mav.MAV_CMD_NAV_WAYPOINT, item.latitude, item.longitude, item.z)


def test_items_with_default_parameters_are_equal():
    nan = float("nan")
    assert MissionItem(16, params=(0.0, 0.0, 0.0, nan)) == MissionItem(
        16, params=(0.0, 0.0, 0.0, -nan)
    )


def test_float32_is_the_wires_precision():
    assert float32(0.1) == float(np.float32(0.1))
    assert float32(1e300) == math.inf
    assert float32(-1e300) == -math.inf


def test_frames_have_twins():
    assert plain_frame(mav.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT) == mav.MAV_FRAME_GLOBAL_RELATIVE_ALT
    assert plain_frame(mav.MAV_FRAME_MISSION) == mav.MAV_FRAME_MISSION


def test_the_three_lists_can_be_taken():
    mission = build_mission(PLAN, altitude_m=40.0, inclusions=[SQUARE], rally=[(57.0, -4.0)])
    lists = [mission.of_kind(kind) for kind in MissionKind]
    assert lists == [mission.items, mission.fence, mission.rally]
    assert all(lists)


def test_a_launch_at_0_0_is_refused():
    with pytest.raises(InvalidInput, match="launch is 0, 0"):
        build_mission([(57.0, -4.0)], altitude_m=40.0, launch=(0.0, 0.0))


def test_whose_heights_are_above_the_launch_point_says_so():
    plan = [(57.0, -4.0), (57.001, -4.0)]
    (caution,) = build_mission(plan, altitude_m=40.0).cautions
    assert caution == "heights are above the launch point; terrain is not checked"
    assert build_mission(plan, altitude_m=40.0, altitude_frame="terrain").cautions == ()
