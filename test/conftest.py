"""Nodes as processes of their own over Fast DDS, each test in a ROS domain of its own."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter

from wisar_msgs.action import UploadMission
from wisar_planner.pdm import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_planner.pdm.gis import save_mixture
from wisar_planner.search import SearchArea
from wisar_sim.nodes.operator import Operator
from wisar_sim.processes import (
    WITHOUT_SHARED_MEMORY,
    ProcessGroup,
    RosDomain,
    executable,
    free_udp_port,
    ros_arguments,
)

os.environ.update(WITHOUT_SHARED_MEMORY)  # for the operator here and all it starts

SCENE = {"swath_radius": 10.0, "step_length": 25.0, "max_distance": 1500.0}
"""A small search that plans in milliseconds."""


class Suite:
    """The suite's processes and an operator in one ROS domain."""

    def __init__(self, folder: Path) -> None:
        self._domain = RosDomain()
        self.domain = self._domain.number
        self.port = free_udp_port()
        self.folder = folder
        self.processes = ProcessGroup(folder / "logs", {"ROS_DOMAIN_ID": str(self.domain)})
        self.operator = Operator(domain=self.domain)

    def start(
        self, package: str, name: str, namespace: str | None = None, **parameters: object
    ) -> subprocess.Popen[bytes]:
        command = [executable(package, name), *ros_arguments(parameters, namespace=namespace)]
        return self.processes.start(f"{namespace or ''}{name}", command)

    def start_map(self, path: Path, namespace: str | None = None) -> subprocess.Popen[bytes]:
        return self.start("wisar_planner", "pdm_server", namespace, map=str(path))

    def start_planner(
        self, planner: str = "greedy", namespace: str | None = None, **parameters: object
    ) -> subprocess.Popen[bytes]:
        settings = SCENE | {"planner": planner} | parameters
        return self.start("wisar_planner", "planner", namespace, **settings)

    def start_drone(self) -> None:
        self.start("wisar_sim", "sim_drone", tick_rate=200.0)

    def start_autopilot(self, *options: str) -> None:
        command = [executable("wisar_sim", "sim_autopilot")]
        # Home is the origin of the test's map; an option given again wins.
        place = ("--home", "56.79,-5.0")
        options = ("--connection", f"udpin:127.0.0.1:{self.port}", *place, *options)
        self.processes.start("sim_autopilot", [*command, *options])

    def start_bridge(self, **parameters: object) -> subprocess.Popen[bytes]:
        connection = f"udpout:127.0.0.1:{self.port}"
        return self.start("wisar_planner", "mavlink_bridge", connection=connection, **parameters)

    def close(self) -> None:
        self._domain.close()

    def log(self, name: str) -> str:
        return self.processes.log(name).read_text(errors="replace")

    def wait(self, condition: Callable[[], object], what: str, timeout: float = 90.0) -> None:
        """Wait until `condition` holds; fail with `what` was waited for."""
        deadline = time.monotonic() + timeout
        while not condition():
            self.processes.check()
            if time.monotonic() > deadline:
                pytest.fail(f"waited {timeout:g} s for {what}")
            time.sleep(0.02)

    def ask(self, kind: type, service: str, request: object) -> Any:
        """Call a service and return its answer."""
        client = self.operator.node.create_client(kind, service)
        self.wait(client.service_is_ready, service)
        lost = self._lost_answers()
        future = client.call_async(request)
        what = f"the answer of {service}"
        self.wait(lambda: future.done() or self._lost_answers() > lost, what)
        if not future.done():
            # The node answered before it had discovered this new client, and said so.
            future = client.call_async(request)
            self.wait(future.done, what)
        return future.result()

    def _lost_answers(self) -> int:
        """How many answers of services nodes say that they could not send."""
        logs = self.processes.log("any").parent.glob("*.log")
        return sum(log.read_bytes().count(b"client will not receive response") for log in logs)

    def set_parameter(self, name: str, value: object, node: str = "planner") -> SetParametersResult:
        """Ask a node to change a parameter and return its answer."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        return self.ask(SetParameters, f"{node}/set_parameters", request).results[0]

    # Topics keep no order among each other: that one message is here says nothing of the others.

    def wait_for_plan(self) -> None:
        """Wait until the operator has the map, the plan and its path."""
        seen = self.operator
        self.wait(lambda: seen.map and seen.plan and seen.path, "map, plan and path")

    def wait_for_flight(self) -> None:
        """Wait until the operator has the map, the plan, its path and the flight's end."""
        self.wait_for_plan()
        seen = self.operator
        self.wait(lambda: seen.progress and seen.progress.finished, "the flight's end")

    def wait_for_bridge(self) -> None:
        """Wait until the operator has the bridge's status and its action takes requests."""
        self.wait(lambda: self.operator.mission, "the bridge's status")
        upload = ActionClient(self.operator.node, UploadMission, "upload_mission")
        self.wait(upload.server_is_ready, "the bridge's action")


@pytest.fixture
def suite(tmp_path: Path) -> Iterator[Suite]:
    made = Suite(tmp_path)
    with contextlib.closing(made), made.processes, made.operator:
        yield made


WriteMixture = Callable[..., Path]


@pytest.fixture
def write_mixture(tmp_path: Path) -> WriteMixture:
    """Write a mixture of two components in 600 m x 500 m of the Scottish Highlands."""

    def write(name: str, shift: float = 0.0) -> Path:
        mixture = GaussianMixture(
            [0.6, 0.4],
            [[-80.0 + shift, 20.0], [120.0, -40.0]],
            [[[2500.0, 600.0], [600.0, 1800.0]], [[1600.0, 0.0], [0.0, 3000.0]]],
        )
        area = SearchArea.rectangle(-300.0, -250.0, 300.0, 250.0)
        save_mixture(tmp_path / name, mixture, area.polygon, GeoOrigin(56.79, -5.0))
        return tmp_path / name

    return write


@pytest.fixture
def mixture_file(write_mixture: WriteMixture) -> Path:
    return write_mixture("mixture.yaml")
