"""A reader gets the last map of each publisher."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

from wisar_planner.nodes.qos import ALL_LATCHED, LATCHED


@pytest.fixture
def node() -> Iterator[Node]:
    rclpy.init(args=[])
    made = Node("reader")
    yield made
    made.destroy_node()
    rclpy.try_shutdown()


def test_the_last_map_of_each_publisher_is_read(node: Node) -> None:
    publishers = [node.create_publisher(String, "pdm", LATCHED) for _ in range(2)]
    for publisher, text in zip(publishers, ("newer", "older"), strict=True):
        publisher.publish(String(data="what it said before"))
        publisher.publish(String(data=text))
    read: list[str] = []
    node.create_subscription(String, "pdm", lambda message: read.append(message.data), ALL_LATCHED)
    time.sleep(1.0)  # both arrive before the node looks, as when a node starts
    deadline = time.monotonic() + 20.0
    while len(read) < 2 and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.1)
    assert set(read) == {"newer", "older"}
