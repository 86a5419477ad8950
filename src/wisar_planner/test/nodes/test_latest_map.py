"""Which map a node takes: no older one, until the clock has jumped back."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from wisar_msgs.msg import ProbabilityMap
from wisar_planner.errors import InvalidInput
from wisar_planner.nodes import conversions
from wisar_planner.nodes.conversions import LocatedMap
from wisar_planner.nodes.latest_map import LatestMap
from wisar_planner.pdm import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_planner.search import SearchArea


@pytest.fixture
def node() -> Iterator[Node]:
    rclpy.init(args=[])
    made = Node("keeper")
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


def message(map_id: str, seconds: int) -> ProbabilityMap:
    mixture = GaussianMixture([1.0], [[0.0, 0.0]], [[[400.0, 0.0], [0.0, 400.0]]])
    area = SearchArea.rectangle(-50.0, -50.0, 50.0, 50.0)
    origin = GeoOrigin(56.8, -5.0)
    located = LocatedMap(map_id, mixture, area, origin, seconds * 1_000_000_000)
    return conversions.map_to_msg(located)


def test_an_older_map_does_not_replace_the_current_one(node: Node) -> None:
    maps = LatestMap(node)
    assert maps.current is None
    first = maps.take(message("first", 10))
    assert first is not None
    assert first is maps.current
    with pytest.raises(InvalidInput, match="'old' is older than the current map 'first'"):
        maps.take(message("old", 9))
    with pytest.raises(InvalidInput, match="id is empty"):
        maps.take(ProbabilityMap())
    assert maps.current is first
    second = maps.take(message("of the same moment", 10))
    assert second is not None
    assert second is maps.current


def test_the_same_map_again_is_no_new_map(node: Node) -> None:
    maps = LatestMap(node)
    first = maps.take(message("map", 10))
    assert maps.take(message("map", 10)) is None
    assert maps.current is first
    assert maps.take(message("map", 11)) is maps.current is not first


def test_after_a_jump_back_of_the_clock_any_map_is_taken(node: Node) -> None:
    node.set_parameters([Parameter("use_sim_time", value=True)])
    maps = LatestMap(node)
    publisher = node.create_publisher(Clock, "/clock", 10)

    def clock_shows(seconds: int) -> None:
        now = Clock(clock=conversions.stamp_from_ns(seconds * 1_000_000_000))
        deadline = time.monotonic() + 20.0
        while node.get_clock().now().nanoseconds != seconds * 1_000_000_000:
            assert time.monotonic() < deadline
            publisher.publish(now)
            rclpy.spin_once(node, timeout_sec=0.05)

    clock_shows(100)
    maps.take(message("late", 100))
    clock_shows(200)
    with pytest.raises(InvalidInput, match="older"):
        maps.take(message("early", 5))
    clock_shows(3)
    early = maps.take(message("early", 5))
    assert early is not None
    assert early is maps.current
    with pytest.raises(InvalidInput, match="older"):
        maps.take(message("earlier", 4))
