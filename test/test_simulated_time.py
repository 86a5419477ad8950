"""Nodes that live by /clock."""

from __future__ import annotations

import time

from rosgraph_msgs.msg import Clock

from wisar_msgs.srv import LoadPdm
from wisar_planner.nodes.conversions import stamp_from_ns, stamp_to_ns


class SimulatedClock:
    """Publishes /clock from the operator's node."""

    def __init__(self, suite) -> None:
        self._publisher = suite.operator.node.create_publisher(Clock, "/clock", 10)
        self._timer = suite.operator.node.create_timer(0.05, self._tell)
        self.seconds = 0.0

    def _tell(self) -> None:
        if self.seconds > 0.0:
            self.seconds += 0.05
            self._publisher.publish(Clock(clock=stamp_from_ns(int(self.seconds * 1e9))))


def test_a_map_server_waits_for_the_clock_and_its_next_map_is_newer(suite, mixture_file) -> None:
    clock = SimulatedClock(suite)
    settings = {"use_sim_time": True, "map": str(mixture_file)}
    suite.start("wisar_planner", "pdm_server", **settings)
    suite.start_planner(use_sim_time=True)
    suite.wait(lambda: "waits for /clock" in suite.log("pdm_server"), "the map server")
    answer = suite.ask(LoadPdm, "load_pdm", LoadPdm.Request(path=str(mixture_file)))
    assert not answer.success
    assert "/clock" in answer.message
    time.sleep(0.5)
    assert suite.operator.map is None
    clock.seconds = 100.0
    suite.wait_for_plan()
    first = suite.operator.map
    assert stamp_to_ns(first.header.stamp) >= 100_000_000_000
    suite.processes.kill("pdm_server")
    clock.seconds += 100.0
    suite.start("wisar_planner", "pdm_server", **settings)
    suite.wait(lambda: suite.operator.plan.map_id != first.id, "the plan of the second server")
    assert stamp_to_ns(suite.operator.map.header.stamp) >= 200_000_000_000
    assert "refused" not in suite.log("planner")


def test_after_a_reset_of_the_simulation_its_maps_are_taken(suite, mixture_file) -> None:
    clock = SimulatedClock(suite)
    clock.seconds = 1000.0
    settings = {"use_sim_time": True, "map": str(mixture_file)}
    suite.start("wisar_planner", "pdm_server", **settings)
    suite.start_planner(use_sim_time=True)
    suite.start("wisar_sim", "sim_drone", tick_rate=200.0, use_sim_time=True)
    suite.wait_for_flight()
    first = suite.operator.map
    suite.processes.kill("pdm_server")
    clock.seconds = 5.0
    time.sleep(1.0)
    suite.start("wisar_planner", "pdm_server", **settings)
    suite.wait(
        lambda: suite.operator.progress.map_id != first.id, "the flight of the map after the reset"
    )
    assert stamp_to_ns(suite.operator.map.header.stamp) < 1000_000_000_000
