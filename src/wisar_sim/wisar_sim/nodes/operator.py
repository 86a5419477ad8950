"""An operator's view of a search: the last message of every topic, and the upload request."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from types import TracebackType
from typing import Any

import rclpy
from nav_msgs.msg import Path
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from wisar_msgs.action import UploadMission
from wisar_msgs.msg import MissionStatus, ProbabilityMap, SearchPlan, SearchProgress
from wisar_planner.nodes.qos import LATCHED


class Operator:
    """Follows a search from its own ROS context and thread; use it as a context manager.

    Parameters
    ----------
    namespace : str
        Namespace of the drone to follow.
    domain : int, optional
        ROS domain; the environment's ROS_DOMAIN_ID unless given.

    Attributes
    ----------
    node : rclpy.node.Node
        For requests beyond those offered here.
    map, plan, path, progress, mission
        The last message of each topic, None before the first.
    upload_feedback : UploadMission.Feedback or None
        The last feedback of the upload under way.
    upload_result : UploadMission.Result or None
        Set when the upload has ended.
    """

    def __init__(self, namespace: str = "", domain: int | None = None) -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = Node("operator", namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="operator", daemon=True)
        self._upload = ActionClient(self.node, UploadMission, "upload_mission")
        self.map: Any = None
        self.plan: Any = None
        self.path: Any = None
        self.progress: Any = None
        self.mission: Any = None
        self.upload_feedback: Any = None
        self.upload_result: Any = None
        self._follow(ProbabilityMap, "pdm", "map")
        self._follow(SearchPlan, "plan", "plan")
        self._follow(Path, "path", "path")
        self._follow(SearchProgress, "search_progress", "progress")
        self._follow(MissionStatus, "mission_status", "mission")

    def __enter__(self) -> Operator:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        # Ended from without, rclpy may trip over what is taken from under it.
        self.run(self._ending.set)
        self._thread.join(timeout=5.0)
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def can_upload(self) -> bool:
        """Whether a mavlink_bridge answers, hears its autopilot and has the last plan."""
        return (
            self.mission is not None
            and self.plan is not None
            and self.mission.connected
            and self.mission.planned_map_id == self.plan.map_id
            and bool(self._upload.server_is_ready())
        )

    def request_upload(self, map_id: str = "") -> None:
        """Ask the bridge to upload the last plan; `upload_result` is set when it has ended."""
        self.upload_feedback = self.upload_result = None

        def send() -> None:
            future = self._upload.send_goal_async(
                UploadMission.Goal(map_id=map_id),
                feedback_callback=lambda m: setattr(self, "upload_feedback", m.feedback),
            )
            future.add_done_callback(self._on_goal_answer)

        self.run(send)

    def run(self, function: Callable[[], Any]) -> Future:
        """Run a function on the operator's own thread; return the future of its result.

        Action clients must be used there: they note a request after they have sent it, and drop
        an answer that another thread reads in between.
        """
        return self._executor.create_task(function)

    def _on_goal_answer(self, future: Future) -> None:
        handle = future.result()
        if not handle.accepted:
            self.upload_result = UploadMission.Result(
                error_code=UploadMission.Result.BUSY, error_text="the bridge refused the goal"
            )
            return
        handle.get_result_async().add_done_callback(
            lambda done: setattr(self, "upload_result", done.result().result)
        )

    def _follow(self, kind: type, topic: str, attribute: str) -> None:
        self.node.create_subscription(
            kind, topic, lambda message: setattr(self, attribute, message), LATCHED
        )

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            while not self._ending.is_set():
                self._executor.spin_once()
