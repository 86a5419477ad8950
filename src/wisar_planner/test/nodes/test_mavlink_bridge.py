"""The bridge in this process, with a client that does what a test says: the states it tells."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from pymavlink.dialects.v20 import common as mav
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from wisar_msgs.action import UploadMission
from wisar_msgs.msg import MissionStatus
from wisar_planner.mavlink.client import LinkStatus
from wisar_planner.mavlink.codec import Counters
from wisar_planner.mavlink.outcome import UploadCode, UploadProgress, UploadResult
from wisar_planner.mavlink.vehicle import VehicleState
from wisar_planner.nodes import conversions, mavlink_bridge
from wisar_planner.nodes.conversions import LocatedMap, Plan
from wisar_planner.nodes.mavlink_bridge import MavlinkBridge
from wisar_planner.pdm import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_planner.search import SearchArea, SearchPath

ORIGIN = GeoOrigin(56.8, -5.0)
WAYPOINTS = np.array([[0.0, 0.0], [80.0, 0.0], [80.0, 30.0]])
FIRST = 2  # takeoff and speed stand before the waypoints
HOLD, IN_MISSION = (4 << 16 | sub_mode << 24 for sub_mode in (3, 4))

VERIFIED = UploadResult(UploadCode.VERIFIED, old_counts=False)


class FakeClient:
    """A client whose vehicle and whose uploads are what a test says."""

    def __init__(self, _connection: str, *, on_vehicle: Callable[[VehicleState], None], **_: Any):
        self._on_vehicle = on_vehicle
        self.vehicle: VehicleState | None = None
        self.link_status = LinkStatus(True, "linked")
        self.counters = Counters()
        self.outcome = VERIFIED
        self.during: Callable[[], None] = lambda: None  # what happens during an upload
        self.changes: tuple[str, ...] = ()  # of the mission since its upload
        self.while_reading: Callable[[], None] = lambda: None
        self.reads = 0
        self.starts = self.resumes = 0

    def upload(
        self, mission: object, *, on_progress: Callable[[UploadProgress], None], **_: Any
    ) -> UploadResult:
        on_progress(UploadProgress("sending mission", 1, 0, 6, 1))
        self.during()
        return self.outcome

    def tell(self, **changes: Any) -> None:
        """Let the vehicle tell something, and where it is."""
        before = self.vehicle or VehicleState(
            1, 1, mav.MAV_AUTOPILOT_PX4, mav.MAV_TYPE_QUADROTOR, HOLD
        )
        now = time.monotonic()
        here = {"latitude": ORIGIN.latitude, "longitude": ORIGIN.longitude, "position_at": now}
        self.vehicle = replace(before, heard_at=now, **(here | changes))
        self._on_vehicle(self.vehicle)

    def ask(self) -> None:
        """Accept whatever is asked for."""

    arm = pause = return_to_launch = close = ask

    def start_mission(self) -> None:
        """Count the starts."""
        self.starts += 1

    def resume(self) -> None:
        """Count how often the mission was gone on with."""
        self.resumes += 1

    def changes_since(self, _mission: object) -> tuple[str, ...]:
        """Read back what the vehicle holds."""
        self.reads += 1
        self.while_reading()
        return self.changes


@pytest.fixture
def bridge(monkeypatch: pytest.MonkeyPatch) -> Iterator[MavlinkBridge]:
    monkeypatch.setattr(mavlink_bridge, "MissionClient", FakeClient)
    rclpy.init(args=[])
    node = MavlinkBridge()
    node._client.tell()
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


def give_map(
    bridge: MavlinkBridge, map_id: str, seconds: int = 1, origin: GeoOrigin = ORIGIN
) -> None:
    mixture = GaussianMixture([1.0], [[40.0, 20.0]], [[[400.0, 0.0], [0.0, 300.0]]])
    area = SearchArea.rectangle(-50.0, -50.0, 150.0, 150.0)
    located = LocatedMap(map_id, mixture, area, origin, seconds * 1_000_000_000)
    bridge._on_map(conversions.map_to_msg(located))


def give_plan(bridge: MavlinkBridge, map_id: str) -> None:
    plan = Plan(
        path=SearchPath(WAYPOINTS, 5.0),
        map_id=map_id,
        origin=ORIGIN,
        probability=np.array([0.0, 0.3, 0.4]),
        start=WAYPOINTS[0],
        step_length=10.0,
        budget=200.0,
        probability_in_area=0.9,
        probability_efficiency=0.5,
        upper_bound=0.8,
        planning_time=1.0,
    )
    bridge._on_plan(conversions.plan_to_msg(plan))


def asking(bridge: MavlinkBridge, act: Callable[[], None]) -> Callable[[], Trigger.Response]:
    """Return what calls a service that asks the vehicle."""
    return lambda: bridge._explicit_request(act)(None, Trigger.Response())


def upload(
    bridge: MavlinkBridge, outcome: UploadResult = VERIFIED, map_id: str = ""
) -> UploadMission.Result:
    bridge._client.outcome = outcome
    goal = SimpleNamespace(
        request=UploadMission.Goal(map_id=map_id),
        is_cancel_requested=False,
        publish_feedback=lambda _: None,
        succeed=lambda: None,
        abort=lambda: None,
    )
    return bridge._on_goal(goal)


@pytest.fixture
def holding(bridge: MavlinkBridge) -> MavlinkBridge:
    """A bridge whose vehicle holds the mission of a plan."""
    give_map(bridge, "map")
    give_plan(bridge, "map")
    assert upload(bridge).error_code == UploadMission.Result.NONE
    assert bridge._state == MissionStatus.VERIFIED
    return bridge


def fly(bridge: MavlinkBridge, x: float = 0.0, **changes: Any) -> None:
    latitude, longitude = LocalFrame(ORIGIN).to_geodetic([[x, 0.0]])[0]
    flown = {"armed": True, "custom_mode": IN_MISSION, "current_item": FIRST + 1}
    bridge._client.tell(latitude=latitude, longitude=longitude, **(flown | changes))


# -- the upload -----------------------------------------------------------------------------------


def test_an_upload_refused_before_anything_was_sent_changes_nothing(holding) -> None:
    before = holding._state, holding._text, holding._items
    refused = UploadResult(UploadCode.REFUSED_BEFORE, "call pause first")
    assert upload(holding, refused).error_code == UploadMission.Result.UNSAFE
    assert (holding._state, holding._text, holding._items) == before


def test_an_upload_refused_after_a_part_was_overwritten_has_failed(holding) -> None:
    """The objection is asked for before each attempt, on ArduPilot after the first one's part."""
    fly(holding)
    assert holding._state == MissionStatus.FLYING
    refused = UploadResult(
        UploadCode.REFUSED_BEFORE, "the vehicle may hold a mixture", old_counts=False
    )
    assert upload(holding, refused).error_code == UploadMission.Result.UNSAFE
    assert (holding._state, holding._map_id) == (MissionStatus.FAILED, "")
    assert "the vehicle may hold a mixture" in holding._text


def test_a_new_plan_during_an_upload_does_not_end_the_tracking_of_the_one_uploaded(bridge) -> None:
    give_map(bridge, "map")
    give_plan(bridge, "map")

    def plan_anew() -> None:
        give_map(bridge, "other", seconds=2)
        give_plan(bridge, "other")

    bridge._client.during = plan_anew
    assert upload(bridge).error_code == UploadMission.Result.NONE
    assert bridge._map_id == "map"
    fly(bridge)
    assert bridge._state == MissionStatus.FLYING


def test_a_map_that_comes_after_the_upload_begins_the_tracking(bridge) -> None:
    give_plan(bridge, "map")
    assert upload(bridge).error_code == UploadMission.Result.NONE
    fly(bridge)
    assert bridge._state == MissionStatus.VERIFIED
    give_map(bridge, "map")
    fly(bridge)
    assert bridge._state == MissionStatus.FLYING


# -- the flight -----------------------------------------------------------------------------------


def test_a_mission_that_is_not_flown_any_more_is_verified_until_it_goes_on(holding) -> None:
    fly(holding)
    assert holding._state == MissionStatus.FLYING
    fly(holding, custom_mode=HOLD)
    assert holding._state == MissionStatus.VERIFIED
    assert "armed, but the mission is not being flown now" in holding._text
    fly(holding, reached_item=FIRST)
    assert (holding._state, holding._items) == (MissionStatus.FLYING, (1, 3))
    fly(holding, custom_mode=HOLD)
    holding._client.tell(armed=False)
    assert holding._state == MissionStatus.VERIFIED
    assert holding._text == "the flight ended after 1 of 3 waypoints; the mission is still there"


def test_the_way_home_after_the_search_ends_with_completion(holding) -> None:
    fly(holding)
    home = {"current_item": FIRST + 3, "custom_mode": 4 << 16 | 5 << 24}  # as PX4 flies it
    fly(holding, **home)
    assert holding._state == MissionStatus.FLYING
    fly(holding, **home, armed=False)
    assert holding._state == MissionStatus.COMPLETED


@pytest.mark.parametrize("end", ["loiter", "return_to_launch"])
def test_a_mission_that_is_started_again_in_the_air_is_counted_anew(bridge, end) -> None:
    bridge.set_parameters([Parameter("end", value=end)])
    give_map(bridge, "map")
    give_plan(bridge, "map")
    upload(bridge)
    fly(bridge)
    last = {"reached_item": FIRST + 2}
    fly(bridge, current_item=FIRST + 3, **last)
    assert bridge._items == (3, 3) or end == "return_to_launch"
    assert (bridge._state == MissionStatus.COMPLETED) == (end == "loiter")
    fly(bridge, current_item=0, **last)
    for _ in range(3):
        fly(bridge, current_item=FIRST + 1, **last)
        assert (bridge._state, bridge._items) == (MissionStatus.FLYING, (0, 3))
    fly(bridge, current_item=FIRST + 1, reached_item=FIRST)
    assert (bridge._state, bridge._items) == (MissionStatus.FLYING, (1, 3))


def test_a_fence_comes_with_a_word_on_the_vehicles_settings(bridge: MavlinkBridge) -> None:
    bridge.set_parameters([Parameter("fence", value=True)])
    give_map(bridge, "map")
    give_plan(bridge, "map")
    assert "FENCE_ENABLE" in upload(bridge).error_text


def test_a_mission_verified_in_a_pause_is_not_flown_before_it_is_started(holding) -> None:
    fly(holding)
    fly(holding, custom_mode=HOLD)
    upload(holding)
    fly(holding, custom_mode=HOLD)
    assert holding._state == MissionStatus.VERIFIED
    assert "read back and equal" in holding._text


def test_a_failed_upload_is_told_until_the_vehicle_flies_on(holding) -> None:
    fly(holding)
    fly(holding, custom_mode=HOLD)
    upload(holding, UploadResult(UploadCode.CANCELLED, "cancelled: the old list counts"))
    fly(holding, custom_mode=HOLD)
    assert holding._state == MissionStatus.FAILED
    assert "the old list counts" in holding._text
    fly(holding)
    assert holding._state == MissionStatus.FLYING


def test_the_status_survives_the_end_of_the_tracking_meanwhile(holding, monkeypatch) -> None:
    """An upload that fails takes the tracker away in another thread."""
    left = [holding._tracker]
    vanishing = property(lambda _: left.pop() if left else None, lambda *_: None)
    monkeypatch.setattr(MavlinkBridge, "_tracker", vanishing, raising=False)
    holding._publish_status()
    assert left == []


# -- plan files -----------------------------------------------------------------------------------


def test_plan_files_with_a_rally_point_wait_for_the_vehicle(bridge, tmp_path: Path) -> None:
    written, said = tmp_path / "search.plan", []
    bridge.get_logger = lambda: SimpleNamespace(info=said.append, error=said.append)
    bridge.set_parameters(
        [Parameter("rally", value=True), Parameter("plan_files", value=str(written))]
    )
    bridge._client.vehicle = None
    give_map(bridge, "map")
    give_plan(bridge, "map")
    for _ in range(3):
        bridge._on_timer()
    assert not written.exists()
    assert [text for text in said if "plan file" in text] == [
        "plan files wait for the vehicle's position, which tells the launch point"
    ]
    bridge._client.tell()
    bridge._on_timer()
    assert written.exists()
    written.unlink()
    bridge._on_timer()
    assert not written.exists()


def test_a_mission_that_this_bridge_has_not_verified_is_not_started(bridge: MavlinkBridge) -> None:
    """As after a restart: the vehicle may hold a mixture, or another day's mission."""
    start, resume = (asking(bridge, act) for act in (bridge._start_mission, bridge._resume))
    give_map(bridge, "map")
    give_plan(bridge, "map")
    bridge._client.tell(armed=True, custom_mode=HOLD)
    for act in (start, resume):
        assert not act().success
        assert "call upload_mission" in act().message
    upload(bridge)
    assert start().success
    assert resume().success
    upload(bridge, UploadResult(UploadCode.INCOMPLETE, old_counts=False, error="no answer"))
    assert not start().success
    assert not resume().success
    bridge._client.link_status = LinkStatus(False, "no link")
    assert "no vehicle to talk to: no link" in start().message
    assert bridge._client.starts == 1


def test_a_bridge_begun_in_flight_resumes_what_it_has_seen_flown(bridge: MavlinkBridge) -> None:
    resume = asking(bridge, bridge._resume)
    bridge._client.tell(armed=True, custom_mode=IN_MISSION)
    bridge._client.tell(armed=True, custom_mode=HOLD)
    assert resume().success


@pytest.mark.parametrize("request_name", ["_arm", "_start_mission", "_resume"])
def test_another_mission_on_the_vehicle_is_seen_before_it_is_flown(holding, request_name) -> None:
    """Another ground station put it there, or another vehicle was switched on."""
    request = asking(holding, getattr(holding, request_name))
    holding._client.changes = ("item 3: place became another",)
    assert request().success  # it was read back just now
    assert holding._client.reads == 0
    holding._on_link(LinkStatus(False, "lost"))
    holding._on_link(LinkStatus(True, "linked"))
    answer = request()
    assert not answer.success
    assert "does not hold what was verified any more (item 3" in answer.message
    assert holding._state == MissionStatus.FAILED
    assert holding._map_id == ""
    assert not asking(holding, holding._start_mission)().success


def test_a_mission_that_is_still_there_is_started_after_it_was_read_again(holding) -> None:
    holding._proved_at -= 10.0
    assert asking(holding, holding._arm)().success
    assert asking(holding, holding._start_mission)().success
    assert holding._client.reads == 1
    assert holding._state == MissionStatus.VERIFIED


def test_a_connection_that_broke_for_a_moment_lets_the_mission_be_read_again(holding) -> None:
    holding._on_link(LinkStatus(True, "the other end closed the connection"))
    assert asking(holding, holding._arm)().success
    assert holding._client.reads == 1


@pytest.mark.parametrize("urgent_name", ["_pause", "_return_to_launch"])
@pytest.mark.parametrize("start_name", ["_start_mission", "_resume"])
def test_a_start_is_given_up_for_what_was_asked_for_while_it_read(
    holding, start_name, urgent_name
) -> None:
    """Else it would take the vehicle out of the pause or the return."""
    start, urgent = (asking(holding, getattr(holding, n)) for n in (start_name, urgent_name))
    answers = []
    holding._client.while_reading = lambda: answers.append(urgent())
    holding._proved_at -= mavlink_bridge.PROOF_LASTS
    answer = start()
    assert not answer.success
    assert "given up" in answer.message
    assert [a.success for a in answers] == [True]
    assert holding._client.starts == holding._client.resumes == 0
    assert start().success


def test_a_second_request_is_refused_while_the_first_one_reads(holding) -> None:
    """It would begin the mission once more, long after the first."""
    requests = [asking(holding, getattr(holding, n)) for n in ("_arm", "_start_mission", "_resume")]
    answers = []
    holding._client.while_reading = lambda: answers.extend(request() for request in requests)
    holding._proved_at -= mavlink_bridge.PROOF_LASTS
    assert asking(holding, holding._start_mission)().success
    assert holding._client.starts == 1
    assert [a.success for a in answers] == [False] * 3
    assert all("another request to the vehicle is in progress" in a.message for a in answers)


def test_an_upload_that_ends_while_the_old_mission_is_read_stays_verified(holding) -> None:
    holding._client.while_reading = lambda: upload(holding)
    holding._client.changes = ("item 3: place became another",)
    holding._proved_at -= mavlink_bridge.PROOF_LASTS
    answer = asking(holding, holding._start_mission)()
    assert not answer.success
    assert "an upload has ended meanwhile" in answer.message
    assert (holding._state, holding._map_id) == (MissionStatus.VERIFIED, "map")


def test_another_mission_that_came_in_a_pause_is_not_resumed(holding) -> None:
    start, resume = (asking(holding, act) for act in (holding._start_mission, holding._resume))
    fly(holding)
    fly(holding, custom_mode=HOLD)
    assert resume().success
    holding._client.changes = ("60 items were sent, 59 read back",)
    holding._proved_at -= mavlink_bridge.PROOF_LASTS
    assert not start().success
    assert not resume().success
    fly(holding)  # as somebody else wants it
    fly(holding, custom_mode=HOLD)
    assert resume().success


def test_the_plan_of_an_older_map_is_uploaded_by_name_only(bridge: MavlinkBridge) -> None:
    give_map(bridge, "a")
    give_plan(bridge, "a")
    give_map(bridge, "b", 2)
    refused = upload(bridge)
    assert refused.error_code == UploadMission.Result.WRONG_MAP
    assert "'b' is newer" in refused.error_text
    assert upload(bridge, map_id="a").error_code == UploadMission.Result.NONE


def test_a_map_of_the_same_id_elsewhere_is_not_that_of_the_plan(bridge: MavlinkBridge) -> None:
    give_map(bridge, "map")
    give_plan(bridge, "map")
    assert bridge._map_of(bridge._plan) is not None
    give_map(bridge, "map", 2, GeoOrigin(ORIGIN.latitude + 0.01, ORIGIN.longitude))
    bridge.set_parameters([Parameter("fence", value=True)])
    bridge._map = bridge._maps.current
    assert bridge._map_of(bridge._plan) is None
    assert "not known yet" in upload(bridge).error_text


def test_without_a_vehicle_nothing_is_sent_and_the_state_stays(holding) -> None:
    holding._client.link_status = LinkStatus(False, "no heartbeat heard yet")
    holding._client.during = lambda: pytest.fail("an upload was begun")
    before = holding._state, holding._text
    result = upload(holding)
    assert result.error_code == UploadMission.Result.NO_LINK
    assert "no heartbeat heard yet" in result.error_text
    assert (holding._state, holding._text) == before


def test_a_link_lost_before_anything_was_sent_leaves_the_state(holding) -> None:
    before = holding._state, holding._text, holding._items
    unsent = UploadResult(UploadCode.NO_LINK, "no vehicle to talk to")
    assert upload(holding, unsent).error_code == UploadMission.Result.NO_LINK
    assert (holding._state, holding._text, holding._items) == before
    upload(holding, replace(unsent, attempts=1))
    assert holding._state == MissionStatus.FAILED


def test_a_link_that_comes_up_in_an_upload_that_sends_nothing_is_told(bridge) -> None:
    give_map(bridge, "map")
    give_plan(bridge, "map")
    assert bridge._state == MissionStatus.NO_LINK
    bridge._client.during = lambda: bridge._on_link(bridge._client.link_status)
    upload(bridge, UploadResult(UploadCode.NO_LINK, "no vehicle to talk to"))
    assert (bridge._state, bridge._text) == (MissionStatus.IDLE, "linked")


def test_in_flight_the_takeoff_is_where_the_vehicle_is(bridge: MavlinkBridge) -> None:
    """Else a fixed wing would fly home for it first; the rally point stays at home."""
    assert bridge.set_parameters([Parameter("rally", value=True)])[0].successful
    give_map(bridge, "map")
    give_plan(bridge, "map")
    home = (ORIGIN.latitude + 0.01, ORIGIN.longitude, 0.0)
    bridge._client.tell(armed=True, landed=False, home=home)
    mission = bridge._mission(bridge._plan, bridge._map)
    takeoff, *_ = mission.items
    assert takeoff.command == mav.MAV_CMD_NAV_TAKEOFF
    assert takeoff.latitude == pytest.approx(ORIGIN.latitude, abs=1e-6)
    assert mission.rally[0].latitude == pytest.approx(home[0], abs=1e-6)
