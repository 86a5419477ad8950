"""Our MAVLink against independent software: MAVSDK at either end, and a real autopilot if given.

``WISAR_AUTOPILOT=udpin:127.0.0.1:14540`` adds the autopilot at that connection to the flight test.
It is armed and flown: simulators only.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import select
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from wisar_planner.mavlink.client import LinkError, MissionClient
from wisar_planner.mavlink.files import write_plan_file
from wisar_planner.mavlink.mission import Mission, MissionItem, MissionKind, build_mission
from wisar_planner.mavlink.vehicle import VehicleState
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_sim.processes import only_one

mavsdk = pytest.importorskip("mavsdk", reason="needs the PyPI package mavsdk")
action = pytest.importorskip("mavsdk.plugins.action")
mission_raw = pytest.importorskip("mavsdk.plugins.mission_raw")

REAL = os.environ.get("WISAR_AUTOPILOT")
BOOT_S = {"px4": 0.0, "ardupilot": 6.0, "mavsdk": 0.0}
FENCE = [[-150.0, -150.0], [150.0, -150.0], [150.0, 150.0], [-150.0, 150.0]]
KEEP_OUT = [[100.0, 100.0], [120.0, 100.0], [110.0, 120.0]]
SEARCH = [[0.0, 10.0], [40.0, 10.0], [40.0, 30.0], [0.0, 30.0]]


def mission_around(latitude: float, longitude: float) -> Mission:
    frame = LocalFrame(GeoOrigin(latitude, longitude))
    return build_mission(
        frame.to_geodetic(SEARCH),
        altitude_m=20.0,
        speed=5.0,
        launch=(latitude, longitude),
        inclusions=[frame.to_geodetic(FENCE)],
        exclusions=[frame.to_geodetic(KEEP_OUT)],
        rally=[(latitude, longitude)],
    )


MISSION = mission_around(57.0, -4.0)


def wait_for(condition: Callable[[], object], seconds: float, what: str) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"waited {seconds:g} s for {what}"
        time.sleep(0.05)


@pytest.fixture
def simulated() -> Iterator[Callable[..., str]]:
    """Start simulated autopilots; return where a client finds them."""
    running: list[subprocess.Popen[str]] = []

    def start(profile: str, *options: str) -> str:
        command = [sys.executable, "-m", "wisar_sim.autopilot", "--profile", profile]
        command += ["--connection", "udpin:127.0.0.1:0", *options]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        running.append(process)
        assert process.stdout is not None
        assert select.select([process.stdout], [], [], 60.0)[0], "sim_autopilot does not start"
        port = re.search(r":(\d+)\s*$", process.stdout.readline())
        assert port is not None
        return f"udpout:127.0.0.1:{port[1]}"

    yield start
    for process in running:
        process.terminate()
        assert process.wait(10.0) == 0
        assert process.stdout is not None
        process.stdout.close()


# -- MAVSDK as the client -------------------------------------------------------------------------


def raw_items(items: tuple[MissionItem, ...], kind: MissionKind) -> list[object]:
    return [
        mission_raw.MissionItem(
            seq=number,
            frame=item.frame,
            command=item.command,
            current=int(number == 0),
            autocontinue=1,
            **{f"param{n}": value for n, value in enumerate(item.params, start=1)},
            x=item.x,
            y=item.y,
            z=item.z,
            mission_type=int(kind),
        )
        for number, item in enumerate(items)
    ]


def places(items: object) -> list[tuple[int, int, int, float]]:
    return [(i.command, i.x, i.y, i.z) for i in items]  # type: ignore[attr-defined]


@pytest.fixture
def ground_station() -> Iterator[Callable[[str], object]]:
    """A MAVSDK ground station and the vehicle that it finds."""
    kind = mavsdk.ComponentType.GROUND_STATION
    sdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(kind))

    def connect(connection: str) -> object:
        sdk.add_any_connection(connection.replace("udpout:", "udpout://"))
        system = sdk.first_autopilot(20.0)
        assert system is not None, "MAVSDK finds no autopilot"
        return system

    yield connect
    sdk.destroy()


@pytest.mark.parametrize("profile", ["px4", "ardupilot", "mavsdk"])
def test_mavsdks_client_uploads_reads_and_clears(
    simulated: Callable[..., str], ground_station: Callable[[str], object], profile: str
) -> None:
    system = ground_station(simulated(profile))
    time.sleep(BOOT_S[profile])
    raw = mission_raw.MissionRaw(system)
    items = MISSION.items
    if profile == "ardupilot":  # MAVSDK leaves home to its user
        items = (MissionItem(16, 0, x=items[0].x, y=items[0].y), *items)
    for _ in range(3):
        raw.upload_mission(raw_items(items, MissionKind.MISSION))
    found = raw.download_mission()
    assert places(found[-len(MISSION.items) :]) == places(MISSION.items)
    assert len(found) == len(items)

    raw.upload_geofence(raw_items(MISSION.fence, MissionKind.FENCE))
    raw.upload_rally_points(raw_items(MISSION.rally, MissionKind.RALLY))
    assert places(raw.download_geofence()) == places(MISSION.fence)
    assert places(raw.download_rallypoints()) == places(MISSION.rally)
    raw.clear_mission()
    assert len(raw.download_mission()) == (1 if profile == "ardupilot" else 0)


def test_mavsdks_client_flies_the_simulated_px4(
    simulated: Callable[..., str], ground_station: Callable[[str], object]
) -> None:
    system = ground_station(simulated("px4", "--speed-up", "20"))
    raw = mission_raw.MissionRaw(system)
    raw.upload_mission(raw_items(MISSION.items, MissionKind.MISSION))
    done = threading.Event()

    def on_progress(progress: object, _: object = None) -> None:
        # PX4 does not tell that the return, the last item, is reached.
        if progress.current >= len(MISSION.items) - 1:  # type: ignore[attr-defined]
            done.set()

    raw.subscribe_mission_progress(on_progress)
    action.Action(system).arm()
    raw.start_mission()
    assert done.wait(60.0), "MAVSDK does not see the mission end"


def test_mavsdk_reads_our_plan_file(
    simulated: Callable[..., str], ground_station: Callable[[str], object], tmp_path: Path
) -> None:
    path = tmp_path / "search.plan"
    write_plan_file(path, MISSION)
    raw = mission_raw.MissionRaw(ground_station(simulated("px4")))
    data = raw.import_qgroundcontrol_mission(str(path))
    wanted = [i for i in MISSION.items if i.is_waypoint]
    found = [i for i in data.mission_items if i.command == wanted[0].command]
    assert [(i.x, i.y) for i in found] == [(i.x, i.y) for i in wanted]
    assert [i.z for i in found] == [i.z for i in wanted]
    corners = [(i.command, i.x, i.y) for i in data.geofence_items]
    assert corners == [(i.command, i.x, i.y) for i in MISSION.fence]


# -- MAVSDK as the autopilot ----------------------------------------------------------------------


class MavsdkAutopilot:
    """MAVSDK's mission server, which real companion autopilots are built with."""

    def __init__(self) -> None:
        from mavsdk.plugins.action_server import ActionServer
        from mavsdk.plugins.mission_raw_server import MissionRawServer
        from mavsdk.plugins.param_server import ParamServer
        from mavsdk.plugins.telemetry_server import TelemetryServer

        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.connection = f"udpout:127.0.0.1:{port}"
        kind = mavsdk.ComponentType.AUTOPILOT
        self.sdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(kind))
        self.sdk.add_any_connection(f"udpin://127.0.0.1:{port}")
        component = self.sdk.server_component()
        self.parameters = ParamServer(component)
        self.parameters.provide_param_int("WISAR", 1)
        self.servers = [ActionServer(component), TelemetryServer(component)]
        self.missions = MissionRawServer(component)
        self.received: list[object] = []
        self.missions.subscribe_incoming_mission(
            lambda result, plan, _=None: self.received.append(plan)
        )


@pytest.fixture
def mavsdk_autopilot() -> Iterator[MavsdkAutopilot]:
    autopilot = MavsdkAutopilot()
    yield autopilot
    autopilot.sdk.destroy()


def test_our_client_uploads_to_mavsdk(mavsdk_autopilot: MavsdkAutopilot) -> None:
    with MissionClient(mavsdk_autopilot.connection) as client:
        client.wait_heartbeat(20.0)
        result = client.upload(MISSION)
        assert result.verified, result.error
        assert places(client.download(MissionKind.FENCE)) == places(MISSION.fence)
        wait_for(lambda: len(mavsdk_autopilot.received) >= 3, 10.0, "MAVSDK's callback")
    mission = mavsdk_autopilot.received[-1].mission_items  # type: ignore[attr-defined]
    assert places(mission) == places(MISSION.items)
    for theirs, ours in zip(mission, MISSION.items, strict=True):
        params = [getattr(theirs, f"param{n}") for n in range(1, 5)]
        np.testing.assert_array_equal(params, ours.params)


def test_our_client_uploads_5000_items_to_mavsdk(mavsdk_autopilot: MavsdkAutopilot) -> None:
    plan = np.column_stack((57.0 + 1e-5 * np.arange(4_998), np.full(4_998, -4.0)))
    mission = build_mission(plan, altitude_m=40.0)
    assert len(mission.items) == 5_000
    with MissionClient(mavsdk_autopilot.connection) as client:
        client.wait_heartbeat(20.0)
        result = client.upload(mission, kinds=[MissionKind.MISSION])
        assert result.verified, result.error


# -- the same flight on every autopilot that there is ----------------------------------------------


def targets() -> list[object]:
    real = pytest.param("real", marks=pytest.mark.timeout(1800))
    return ["px4", "ardupilot", "mavsdk", *([real] if REAL else [])]


def located(client: MissionClient) -> VehicleState:
    def here() -> bool:
        vehicle = client.vehicle
        return vehicle is not None and vehicle.latitude not in (None, 0.0)

    wait_for(here, 120.0, "a position")
    assert client.vehicle is not None
    return client.vehicle


def arm(client: MissionClient, seconds: float) -> None:
    """Arm as soon as the vehicle is ready: a real one checks its sensors first."""
    deadline = time.monotonic() + seconds
    while True:
        try:
            client.arm()
        except LinkError:
            assert time.monotonic() < deadline, client.vehicle
            time.sleep(2.0)
        else:
            return


@pytest.fixture
def target(request: pytest.FixtureRequest) -> Iterator[str]:
    """What is flown; a real autopilot by one test at a time."""
    with only_one("autopilot") if request.param == "real" else contextlib.nullcontext():
        yield request.param


@pytest.mark.parametrize("target", targets(), indirect=True)
def test_upload_verify_and_fly_to_the_end(simulated: Callable[..., str], target: str) -> None:
    if target == "real":
        assert REAL is not None
        connection, patience = REAL, 600.0
    else:
        connection, patience = simulated(target, "--speed-up", "6"), 90.0
    with MissionClient(connection) as client:
        client.wait_heartbeat(60.0)
        vehicle = located(client)
        assert vehicle.latitude is not None
        assert vehicle.longitude is not None
        mission = mission_around(vehicle.latitude, vehicle.longitude)
        result = client.upload(mission)
        assert result.verified, result.error
        read = client.download()
        assert vehicle.dialect.differences(MissionKind.MISSION, mission.items, read) == ()
        assert not vehicle.armed

        arm(client, patience)
        client.start_mission()
        track: list[tuple[float, float]] = []

        def finished() -> bool:
            now = client.vehicle
            assert now is not None
            if now.latitude is not None and now.longitude is not None:
                track.append((now.latitude, now.longitude))
            return len(track) > 20 and not now.armed

        wait_for(finished, patience, "the landing at the end of the mission")
    frame = LocalFrame(GeoOrigin(vehicle.latitude, vehicle.longitude))
    flown = frame.to_local(*np.array(track).T)
    for corner in SEARCH:
        nearest = np.linalg.norm(flown - corner, axis=1).min()
        assert nearest < 10.0, f"never near {corner}"
    assert math.hypot(*flown[-1]) < 10.0
