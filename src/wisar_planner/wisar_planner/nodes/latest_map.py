"""The probability map that a node works with, and which message may take its place."""

from __future__ import annotations

import threading

from rclpy.clock import JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node

from wisar_msgs.msg import ProbabilityMap
from wisar_planner.errors import InvalidInput
from wisar_planner.nodes import conversions
from wisar_planner.nodes.conversions import LocatedMap


class LatestMap:
    """The last good map of `pdm`; safe to use from several threads.

    A map that is older than the current one does not replace it: a tool that was slow, or one that
    repeats what it once sent, must not undo what a newer one has said. After the clock has jumped
    back (a simulator that was reset, a bag that begins again), or has changed between system and
    simulated time, stamps from before say nothing any more, and the next map is taken whatever
    its stamp.

    Parameters
    ----------
    node : Node
        Whose clock tells of jumps.
    """

    def __init__(self, node: Node) -> None:
        self._lock = threading.Lock()
        self._current: LocatedMap | None = None
        self._oldest_ns: int | None = None
        # The jump is heeded as long as this handle lives.
        self._jump = node.get_clock().create_jump_callback(
            JumpThreshold(
                min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=True
            ),
            post_callback=self._on_jump,
        )

    @property
    def current(self) -> LocatedMap | None:
        """The last good map, None before the first."""
        with self._lock:
            return self._current

    def take(self, message: ProbabilityMap) -> LocatedMap | None:
        """Make a message the current map and return it; None when it is the current map again.

        A map is the same when its id and its stamp are.

        Raises
        ------
        InvalidInput
            When the message is wrong or older than the current map, which then stays.
        """
        located = conversions.map_from_msg(message)
        with self._lock:
            current = self._current
            if current is not None:
                if (located.map_id, located.stamp_ns) == (current.map_id, current.stamp_ns):
                    return None
                if self._oldest_ns is not None and located.stamp_ns < self._oldest_ns:
                    raise InvalidInput(
                        f"map {located.map_id!r} is older than the current map {current.map_id!r}"
                    )
            self._current, self._oldest_ns = located, located.stamp_ns
            return located

    def _on_jump(self, _: TimeJump) -> None:
        with self._lock:
            self._oldest_ns = None
