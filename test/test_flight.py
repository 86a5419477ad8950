"""An uploaded mission is flown only when asked, and followed to its end."""

from __future__ import annotations

from pathlib import Path

import pytest
from std_srvs.srv import Trigger

from wisar_msgs.msg import MissionStatus


def call(suite, name: str) -> Trigger.Response:
    client = suite.operator.node.create_client(Trigger, name)
    suite.wait(client.service_is_ready, f"the service {name}")
    future = client.call_async(Trigger.Request())
    suite.wait(future.done, f"the answer of {name}")
    return future.result()


def upload(suite):
    suite.wait(suite.operator.can_upload, "the bridge's link")
    suite.operator.request_upload()
    suite.wait(lambda: suite.operator.upload_result, "the upload's end")
    return suite.operator.upload_result


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_mission_is_flown_when_asked_and_followed(suite, mixture_file, profile: str) -> None:
    suite.start_autopilot("--profile", profile, "--home", "56.79,-5.0", "--speed-up", "10")
    suite.start_map(mixture_file)
    suite.start_planner(max_distance=800.0)
    suite.start_bridge(speed=10.0, fence=True, rally=True)
    operator = suite.operator
    suite.wait_for_plan()
    # Without an explicit position there is no rally point: wait for the vehicle.
    suite.wait(
        lambda: operator.mission and operator.mission.latitude == pytest.approx(56.79),
        "the vehicle's position",
    )
    result = upload(suite)
    assert result.error_code == result.NONE, result.error_text
    assert not operator.mission.armed
    assert call(suite, "arm").success
    answer = call(suite, "start_mission")
    assert answer.success, answer.message
    suite.wait(lambda: operator.mission.state == MissionStatus.FLYING, "the flight")
    assert operator.mission.armed
    suite.wait(lambda: operator.mission.state == MissionStatus.COMPLETED, "the flight's end", 90.0)
    status, plan = operator.mission, operator.plan
    # The vehicle cuts corners within its acceptance radius; what it saw is near the promise.
    assert status.distance == pytest.approx(plan.length, rel=0.15)
    assert status.probability == pytest.approx(plan.probability[-1], rel=0.15)


def test_unsafe_missions_are_refused_before_the_upload(suite, mixture_file, tmp_path) -> None:
    suite.start_autopilot("--home", "56.79,-5.0")
    suite.start_map(mixture_file)
    suite.start_planner()
    files = [tmp_path / "search.plan", tmp_path / "search.waypoints"]
    suite.start_bridge(endurance=1000.0, max_altitude=10.0, plan_files=",".join(map(str, files)))
    operator = suite.operator
    suite.wait(
        lambda: operator.mission and operator.mission.latitude == pytest.approx(56.79),
        "the vehicle's position",
    )
    result = upload(suite)
    assert result.error_code == result.UNSAFE
    assert "endurance" in result.error_text
    assert "altitude" in result.error_text
    assert operator.mission.state != MissionStatus.VERIFIED
    # The bridge tells of the plan before it has written the files.
    suite.wait(lambda: all(map(Path.exists, files)), "the plan files")


def test_an_unknown_vehicle_refuses_requests_in_words(suite) -> None:
    suite.start_bridge()
    answer = call(suite, "start_mission")
    assert not answer.success
    assert "no vehicle" in answer.message
