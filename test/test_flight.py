"""An uploaded mission is flown only when asked, and followed to its end.

``WISAR_AUTOPILOT=udpin:127.0.0.1:14540`` adds the autopilot at that connection. It is armed and
flown: simulators only.
"""

from __future__ import annotations

import contextlib
import copy
import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mav
from std_srvs.srv import Trigger

from wisar_msgs.msg import MissionStatus, ProbabilityMap, SearchPlan
from wisar_planner.mavlink.client import MissionClient
from wisar_planner.mavlink.codec import Codec
from wisar_planner.mavlink.mission import Mission
from wisar_planner.mavlink.modes import flies_mission
from wisar_planner.nodes.mavlink_bridge import PROOF_LASTS
from wisar_planner.nodes.qos import LATCHED
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_sim.nodes.operator import Operator
from wisar_sim.processes import executable, free_udp_port, only_one

RETURN = "return_to_launch"
PX4_HOLD, PX4_RETURN = 3, 5  # sub-modes of AUTO
REAL = os.environ.get("WISAR_AUTOPILOT")


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


def place_of(connection: str) -> GeoOrigin:
    """Wait until an autopilot tells where it stands."""
    deadline = time.monotonic() + 120.0
    with MissionClient(connection) as client:
        client.wait_heartbeat(60.0)
        while True:
            vehicle = client.vehicle
            if vehicle is not None and vehicle.latitude not in (None, 0.0):
                assert vehicle.longitude is not None
                return GeoOrigin(vehicle.latitude, vehicle.longitude)
            assert time.monotonic() < deadline, "the vehicle does not tell its position"
            time.sleep(0.1)


def moved_to(place: GeoOrigin, map_file: Path) -> Path:
    """Move a mixture's map to another place on Earth."""
    content = yaml.safe_load(map_file.read_text())
    content["origin"] = {"latitude": place.latitude, "longitude": place.longitude}
    map_file.write_text(yaml.safe_dump(content))
    return map_file


def targets() -> list[object]:
    real = pytest.param("real", marks=pytest.mark.timeout(1800))
    return ["px4", "ardupilot", *([real] if REAL else [])]


@pytest.fixture
def target(request: pytest.FixtureRequest) -> Iterator[str]:
    """What is flown; a real autopilot by one test at a time."""
    with only_one("autopilot") if request.param == "real" else contextlib.nullcontext():
        yield request.param


@pytest.mark.parametrize("target", targets(), indirect=True)
def test_a_mission_is_flown_when_asked_and_followed(suite, mixture_file, target: str) -> None:
    settings: dict[str, object] = {"speed": 10.0, "fence": True, "rally": True}
    if target == "real":
        assert REAL is not None
        place, patience = place_of(REAL), 600.0
        suite.start_map(moved_to(place, mixture_file))
        suite.start("wisar_planner", "mavlink_bridge", connection=REAL, **settings)
    else:
        patience = 90.0
        suite.start_autopilot("--profile", target, "--speed-up", "10")
        suite.start_map(mixture_file)
        suite.start_bridge(**settings)
    suite.start_planner(max_distance=800.0)
    operator = suite.operator
    result = upload(suite)
    assert result.error_code == result.NONE, result.error_text
    assert "terrain is not checked" in result.error_text
    assert not operator.mission.armed
    deadline = time.monotonic() + patience
    while not (
        (answer := call(suite, "arm")).success and (answer := call(suite, "start_mission")).success
    ):  # a real one checks its sensors first, and waits for its position
        assert time.monotonic() < deadline, answer.message
        time.sleep(2.0)
    suite.wait(lambda: operator.mission.state == MissionStatus.FLYING, "the flight")
    assert operator.mission.armed
    suite.wait(
        lambda: operator.mission.state == MissionStatus.COMPLETED, "the flight's end", patience
    )
    suite.wait(lambda: operator.plan, "the plan")
    status, plan = operator.mission, operator.plan
    # The vehicle cuts corners within its acceptance radius; what it saw is near the promise.
    assert status.distance == pytest.approx(plan.length, rel=0.15)
    assert status.probability == pytest.approx(plan.probability[-1], rel=0.15)
    suite.wait(lambda: not operator.mission.armed, "the landing", patience)


def test_two_vehicles_each_get_the_mission_of_their_namespace(suite, mixture_file) -> None:
    ports = {"north": suite.port, "south": free_udp_port()}
    for number, (name, port) in enumerate(ports.items(), start=1):
        connection = ("--connection", f"udpin:127.0.0.1:{port}", "--system", str(number))
        command = [executable("wisar_sim", "sim_autopilot"), "--home", "56.79,-5.0", *connection]
        suite.processes.start(f"{name}sim_autopilot", command)
        suite.start_map(mixture_file, namespace=name)
        suite.start_planner(namespace=name, max_distance=400.0 * number)
        suite.start("wisar_planner", "mavlink_bridge", name, connection=f"udpout:127.0.0.1:{port}")
    with (
        Operator("north", domain=suite.domain) as north,
        Operator("south", domain=suite.domain) as south,
    ):
        suite.wait(lambda: north.can_upload() and south.can_upload(), "both bridges' links")
        for operator in (north, south):
            operator.request_upload()
        suite.wait(lambda: north.upload_result and south.upload_result, "both uploads")
        for operator, port in ((north, ports["north"]), (south, ports["south"])):
            result, plan = operator.upload_result, operator.plan
            assert result.error_code == result.NONE, result.error_text
            origin = GeoOrigin(plan.origin.latitude, plan.origin.longitude)
            planned = LocalFrame(origin).to_geodetic(np.column_stack((plan.x, plan.y)))
            with MissionClient(f"udpout:127.0.0.1:{port}", system=250) as other:
                other.wait_heartbeat(20.0)
                held = Mission(other.download()).waypoints[:, :2]
            np.testing.assert_allclose(held, planned, rtol=0, atol=1e-7)
        assert len(north.plan.x) != len(south.plan.x)
        suite.wait(
            lambda: {o.mission.state for o in (north, south)} == {MissionStatus.VERIFIED},
            "both missions verified",
        )


def test_a_map_that_comes_after_its_plan_completes_files_and_tracking(
    suite, mixture_file, tmp_path
) -> None:
    """Topics keep no order; and an older map that is sent again takes the place of none."""
    suite.start_autopilot("--speed-up", "10")
    suite.start_map(mixture_file)
    suite.start_planner(max_distance=300.0)
    suite.wait_for_plan()
    written = tmp_path / "late.plan"
    connection = f"udpout:127.0.0.1:{suite.port}"
    suite.start(
        "wisar_planner", "mavlink_bridge", "late", connection=connection, plan_files=str(written)
    )
    with Operator("late", domain=suite.domain) as late:
        node = late.node
        plans = node.create_publisher(SearchPlan, "plan", LATCHED)
        maps = node.create_publisher(ProbabilityMap, "pdm", LATCHED)
        plans.publish(suite.operator.plan)
        suite.wait(late.can_upload, "the bridge's link and the plan")
        late.request_upload()
        suite.wait(lambda: late.upload_result, "the upload's end")
        assert late.upload_result.error_code == 0, late.upload_result.error_text
        written.unlink()
        assert suite.set_parameter("fence", True, node="late/mavlink_bridge").successful
        plans.publish(suite.operator.plan)
        suite.wait(lambda: "plan files wait for the map" in suite.log("latemavlink_bridge"), "word")
        assert not written.exists()
        maps.publish(suite.operator.map)
        suite.wait(written.exists, "the plan file")
        older = copy.deepcopy(suite.operator.map)
        older.header.stamp.sec -= 1000
        older.id = "older"
        maps.publish(older)
        suite.wait(lambda: "is older than" in suite.log("latemavlink_bridge"), "the older map")
        for name in ("late/arm", "late/start_mission"):
            answer = call(suite, name)
            assert answer.success, answer.message
        suite.wait(lambda: late.mission.state == MissionStatus.COMPLETED, "the flight's end")
        plan = suite.operator.plan
        assert late.mission.probability == pytest.approx(plan.probability[-1], rel=0.15)


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
    written = "search.waypoints written; heights are above the launch point"
    suite.wait(lambda: written in suite.log("mavlink_bridge"), "the word about heights")


def test_nothing_is_uploaded_to_a_vehicle_that_does_not_know_where_it_is(
    suite, mixture_file
) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    connection = f"udpin:127.0.0.1:{suite.port}"
    suite.start("wisar_planner", "mavlink_bridge", connection=connection)
    operator = suite.operator
    vehicle = mavutil.mavlink_connection(f"udpout:127.0.0.1:{suite.port}", source_system=1)

    def connected() -> bool:
        vehicle.mav.heartbeat_send(2, 12, 0, 0, 3)
        # What it tells before its GPS has a fix is no position.
        vehicle.mav.global_position_int_send(0, 0, 0, 0, 0, 0, 0, 0, 65535)
        vehicle.mav.home_position_send(0, 0, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
        return operator.mission is not None and operator.mission.connected

    try:
        ready = "call upload_mission"
        suite.wait(
            lambda: connected() and ready in suite.log("mavlink_bridge"), "the plan and a link"
        )
        suite.wait_for_bridge()
        assert operator.mission.planned_map_id == ""
        operator.request_upload()
        suite.wait(lambda: connected() and operator.upload_result, "the bridge's answer")
        assert operator.upload_result.error_code == operator.upload_result.UNSAFE
        assert "position is not known" in operator.upload_result.error_text
        codec = Codec(vehicle.mav.srcSystem, vehicle.mav.srcComponent)
        for number, chunk in enumerate(
            (b"PreArm: 3D fix needed before the motors may turn, ", b"wait")
        ):
            text = mav.MAVLink_statustext_message(mav.MAV_SEVERITY_CRITICAL, chunk, 7, number)
            vehicle.write(codec.encode(text))
        said = "the vehicle says: PreArm: 3D fix needed before the motors may turn, wait"
        suite.wait(lambda: connected() and said in suite.log("mavlink_bridge"), "what it says")
        assert suite.log("mavlink_bridge").count("the vehicle says") == 1
    finally:
        vehicle.close()


def test_a_return_is_sent_at_once_whatever_else_waits_for_an_answer(suite) -> None:
    connection = f"udpin:127.0.0.1:{suite.port}"
    suite.start("wisar_planner", "mavlink_bridge", connection=connection)
    operator, modes = suite.operator, []
    silent = mavutil.mavlink_connection(f"udpout:127.0.0.1:{suite.port}", source_system=1)

    def connected() -> bool:
        silent.mav.heartbeat_send(2, 12, 128, 4 << 16 | 4 << 24, 4)  # armed, flying its mission
        while (heard := silent.recv_match(blocking=False)) is not None:
            if getattr(heard, "command", None) == mavutil.mavlink.MAV_CMD_DO_SET_MODE:
                modes.append(int(heard.param3))
        return operator.mission is not None and operator.mission.connected

    try:
        suite.wait(connected, "a link")
        clients = {n: operator.node.create_client(Trigger, n) for n in ("pause", "resume", RETURN)}
        for name, client in clients.items():
            suite.wait(client.service_is_ready, f"the service {name}")
        waiting = [clients["pause"].call_async(Trigger.Request()) for _ in range(6)]
        waiting += [clients["resume"].call_async(Trigger.Request()) for _ in range(6)]
        suite.wait(lambda: connected() and PX4_HOLD in modes, "the pause")
        # Services keep no order among each other: until they are taken, the return is not the last.
        suite.wait(
            lambda: connected() and sum(each.done() for each in waiting) >= len(waiting) - 1,
            "the answers of all but the last pause",
        )
        waiting.append(clients[RETURN].call_async(Trigger.Request()))
        suite.wait(lambda: connected() and PX4_RETURN in modes, "the return", 6.0)
        last = len(modes)
        suite.wait(lambda: connected() and len(modes) >= last + 3, "repetitions of the return")
        assert set(modes[last:]) == {PX4_RETURN}
    finally:
        silent.close()


def test_a_mission_that_another_ground_station_put_there_is_not_started(
    suite, mixture_file
) -> None:
    suite.start_autopilot()
    suite.start_map(mixture_file)
    suite.start_planner(max_distance=300.0)
    suite.start_bridge()
    operator = suite.operator
    result = upload(suite)
    assert result.error_code == result.NONE, result.error_text
    with MissionClient(f"udpout:127.0.0.1:{suite.port}", system=250) as other:
        other.wait_heartbeat(20.0)
        held = other.download()
        assert other.upload(Mission(held[:-1])).verified
        time.sleep(PROOF_LASTS)
        answer = call(suite, "arm")
        assert not answer.success
        assert "does not hold what was verified any more" in answer.message
        suite.wait(lambda: operator.mission.state == MissionStatus.FAILED, "the status")
        assert operator.mission.map_id == ""
        # Whoever arms it, and however: the mission of another is started by that one alone.
        other.arm()
        for name in ("start_mission", "resume"):
            answer = call(suite, name)
            assert not answer.success
            assert "call upload_mission" in answer.message
        vehicle = other.vehicle
        assert not flies_mission(vehicle.autopilot, vehicle.vehicle_type, vehicle.custom_mode)


def test_an_unknown_vehicle_refuses_requests_in_words(suite) -> None:
    suite.start_bridge()
    answer = call(suite, "start_mission")
    assert not answer.success
    assert "no vehicle" in answer.message
