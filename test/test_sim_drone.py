"""The simulated drone: which maps and plans it flies, and how fast."""

from __future__ import annotations

import copy
import time

from wisar_msgs.msg import ProbabilityMap
from wisar_planner.nodes.qos import LATCHED


def test_a_faster_tick_acts_at_once(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.start("wisar_sim", "sim_drone", tick_rate=0.002)  # a step in 500 s
    suite.wait_for_plan()
    suite.wait(lambda: suite.operator.progress, "the takeoff")
    assert suite.set_parameter("tick_rate", 200.0, "sim_drone").successful
    suite.wait(lambda: suite.operator.progress.finished, "the flight's end", 60.0)


def test_an_older_map_is_refused_and_the_same_one_is_no_news(suite, mixture_file) -> None:
    suite.start_map(mixture_file)
    suite.start_planner()
    suite.start_drone()
    suite.wait_for_flight()
    publisher = suite.operator.node.create_publisher(ProbabilityMap, "pdm", LATCHED)
    suite.wait(lambda: publisher.get_subscription_count() >= 3, "planner and drone")
    good = suite.operator.map
    stale = copy.deepcopy(good)
    stale.id, stale.header.stamp.sec = "stale", good.header.stamp.sec - 60
    publisher.publish(good)
    time.sleep(0.5)  # a publisher keeps one message
    publisher.publish(stale)
    suite.wait(lambda: "'stale' is older" in suite.log("sim_drone"), "the drone's refusal")
    suite.wait(lambda: "'stale' is older" in suite.log("planner"), "the planner's refusal")
    # The plan of the good map still has its map.
    suite.operator.progress = None
    assert suite.set_parameter("max_distance", 600.0).successful
    suite.wait(
        lambda: suite.operator.progress and suite.operator.progress.finished, "the second flight"
    )
    assert suite.log("planner").count("components") == 1
