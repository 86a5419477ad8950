"""Every parameter file that is for nodes can be given to all of them."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from rcl_interfaces.srv import GetParameters

from wisar_sim.processes import executable, ros_arguments

CONFIG = Path(__file__).resolve().parent.parent / "config"
FILES = sorted(p.name for p in CONFIG.glob("*.yaml") if "ros__parameters" in p.read_text())


@pytest.mark.parametrize("name", FILES)
def test_every_node_starts_with_the_file(suite, mixture_file, name: str) -> None:
    file = CONFIG / name
    for package, node, parameters in (
        ("wisar_planner", "pdm_server", {"map": str(mixture_file)}),
        ("wisar_planner", "planner", {"planner": "greedy"}),
        ("wisar_planner", "mavlink_bridge", {"connection": f"udpout:127.0.0.1:{suite.port}"}),
        ("wisar_sim", "sim_drone", {"speed_up": 100.0}),
    ):
        arguments = ros_arguments(parameters, parameter_file=file)
        suite.processes.start(node, [executable(package, node), *arguments])
    suite.wait_for_plan()
    suite.wait(lambda: suite.operator.progress, "the takeoff")
    suite.wait_for_bridge()
    given = yaml.safe_load(file.read_text())["/**"]["ros__parameters"]
    plan = suite.operator.plan
    for parameter, value in (
        ("swath_radius", plan.swath_radius),
        ("step_length", plan.step_length),
        ("max_distance", plan.budget),
    ):
        assert value == given[parameter], parameter
    # What the file says of random maps is not taken for what to do with a map that is given.
    request = GetParameters.Request(names=["fit_components", "area_file"])
    components, area = suite.ask(GetParameters, "pdm_server/get_parameters", request).values
    assert (components.integer_value, area.string_value) == (0, "")
