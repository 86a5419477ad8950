"""The chain as separate processes: map file -> plan -> flight -> verified mission."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink import mavutil

from wisar_msgs.msg import MissionStatus
from wisar_planner.nodes import conversions
from wisar_planner.pdm.geodesy import LocalFrame
from wisar_planner.search import SearchPath
from wisar_sim.nodes.operator import Operator


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_map_becomes_a_verified_mission(suite, mixture_file, profile: str) -> None:
    suite.start_autopilot("--profile", profile, "--home", "56.79,-5.0")
    suite.start_map(mixture_file)
    suite.start_planner("lhc_gw_conv")
    suite.start_drone()
    suite.start_bridge()
    operator = suite.operator
    suite.wait_for_flight()
    plan, progress = operator.plan, operator.progress
    assert progress.distance == pytest.approx(plan.length)
    assert progress.map_id == plan.map_id == operator.map.id
    # The drone integrates by cubature, the planner along the boundary: two methods, one value.
    assert progress.probability == pytest.approx(plan.probability[-1], rel=1e-3)
    assert 0.0 < plan.probability_efficiency <= plan.upper_bound

    suite.wait(operator.can_upload, "the bridge's link")
    operator.request_upload(plan.map_id)
    suite.wait(lambda: operator.upload_result, "the upload's end")
    result = operator.upload_result
    assert result.error_code == result.NONE, result.error_text
    assert result.items == len(plan.x) + 3  # takeoff, speed, return to launch
    suite.wait(lambda: operator.mission.state == MissionStatus.VERIFIED, "status verified")
    assert operator.mission.map_id == plan.map_id
    assert not operator.mission.armed

    waypoints = download_waypoints(suite.port)
    frame = LocalFrame(conversions.origin_from_msg(plan.origin))
    planned = frame.to_geodetic(np.column_stack((plan.x, plan.y)))
    assert np.abs(waypoints - planned).max() <= 1e-7


def download_waypoints(port: int) -> np.ndarray:
    """Read the mission back with pymavlink alone, as another ground station would."""
    link = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=250)
    try:
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        assert link.wait_heartbeat(timeout=10) is not None
        target = link.target_system, link.target_component
        link.mav.mission_request_list_send(*target)
        count = link.recv_match(type="MISSION_COUNT", blocking=True, timeout=10).count
        points = []
        for number in range(count):
            link.mav.mission_request_int_send(*target, number)
            item = link.recv_match(
                type="MISSION_ITEM_INT",
                condition=f"MISSION_ITEM_INT.seq=={number}",
                blocking=True,
                timeout=10,
            )
            if item.command == mavutil.mavlink.MAV_CMD_NAV_WAYPOINT and item.frame in (3, 6):
                points.append((item.x * 1e-7, item.y * 1e-7))
        link.mav.mission_ack_send(*target, 0)
        return np.array(points)
    finally:
        link.close()


def test_who_starts_late_still_gets_map_plan_and_path(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait_for_plan()
    with Operator(domain=suite.domain) as late:
        suite.wait(lambda: late.map and late.plan and late.path, "the late subscriber's messages")
        assert late.plan == suite.operator.plan
        assert late.map == suite.operator.map
        assert len(late.path.poses) == len(late.plan.x)


def test_the_planned_path_is_what_the_plan_says(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.wait_for_plan()
    plan = suite.operator.plan
    path = SearchPath(np.column_stack((plan.x, plan.y)), plan.swath_radius)
    mixture = conversions.map_from_msg(suite.operator.map).pdm
    # From scratch and by another method: fine polygon of the buffered path.
    polygon = path.seen_area()
    assert mixture.integrate(polygon) == pytest.approx(plan.probability[-1], rel=2e-3)
    assert path.length == pytest.approx(plan.length)
    assert plan.length <= plan.budget


def test_two_drones_live_in_their_namespaces(suite, mixture_file) -> None:
    for name, budget in (("north", 400.0), ("south", 800.0)):
        suite.start_map(mixture_file, namespace=name)
        suite.start_planner(namespace=name, max_distance=budget)
    with (
        Operator("north", domain=suite.domain) as north,
        Operator("south", domain=suite.domain) as south,
    ):
        suite.wait(lambda: north.plan and south.plan, "both plans")
        assert (north.plan.budget, south.plan.budget) == (400.0, 800.0)
    assert suite.operator.plan is None
