"""What a flight has seen, against the path's own figures."""

from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.flight import FlightTracker
from wisar_planner.mavlink.mission import build_mission
from wisar_planner.mavlink.vehicle import VehicleState, changes
from wisar_planner.pdm import GaussianMixture
from wisar_planner.pdm.geodesy import GeoOrigin, LocalFrame
from wisar_planner.search import SearchPath

FRAME = LocalFrame(GeoOrigin(57.0, -4.0))
PDM = GaussianMixture([1.0], [[40.0, 20.0]], [[[400.0, 0.0], [0.0, 300.0]]])
PATH = SearchPath(np.array([[0.0, 0.0], [80.0, 0.0], [80.0, 30.0], [0.0, 30.0]]), 5.0)
MISSION = build_mission(FRAME.to_geodetic(PATH.waypoints), altitude_m=40.0, speed=5.0)
FIRST = 2  # takeoff and speed stand before the waypoints


def state(point, current, reached=None, armed=True):
    latitude, longitude = FRAME.to_geodetic([point])[0]
    return VehicleState(
        1,
        1,
        armed=armed,
        latitude=latitude,
        longitude=longitude,
        current_item=current,
        reached_item=reached,
    )


def fly(tracker, spacing=1.0):
    now = 0.0
    for leg in range(3):
        a, b = PATH.waypoints[leg], PATH.waypoints[leg + 1]
        for share in np.arange(0.0, 1.0, spacing / np.linalg.norm(b - a)):
            now += 0.2
            tracker.update(state(a + share * (b - a), FIRST + leg + 1, FIRST + leg), now)
    return tracker.update(state(PATH.waypoints[-1], FIRST + 3, FIRST + 2), now + 0.2)


def test_a_flight_along_the_plan_sees_what_the_plan_promised():
    progress = fly(FlightTracker(PDM, PATH, FRAME, MISSION))
    # Corners are cut by less than the spacing of the positions that count.
    assert progress.distance == pytest.approx(PATH.length, rel=0.01)
    assert progress.probability == pytest.approx(PATH.seen_probability(PDM), rel=0.005)
    assert progress.planned_probability == pytest.approx(progress.probability, rel=0.01)
    assert (progress.waypoints_reached, progress.waypoints_total) == (3, 4)
    assert progress.flying
    assert not progress.completed


def test_the_ways_there_and_back_do_not_count():
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    over_the_peak = PDM.means[0]
    for current in (0, FIRST, FIRST + 4):
        progress = tracker.update(state(over_the_peak, current), 1.0)
        assert (progress.probability, progress.flying) == (0.0, False)
    assert tracker.update(state(over_the_peak, FIRST + 1, armed=False), 2.0).probability == 0.0
    assert tracker.update(state(over_the_peak, FIRST + 1), 3.0).probability > 0.0


def test_what_happened_in_a_long_silence_is_not_invented():
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION, max_gap_s=3.0)
    tracker.update(state((0.0, 0.0), FIRST + 1), 0.0)
    joined = tracker.update(state((8.0, 0.0), FIRST + 1), 2.0)
    assert joined.distance == pytest.approx(8.0, rel=1e-6)
    gap = tracker.update(state((70.0, 0.0), FIRST + 1), 30.0)
    assert gap.distance == pytest.approx(8.0, rel=1e-6)
    # Two separate stretches: a capsule of 8 m and a disc.
    expected = SearchPath(np.array([[0.0, 0.0], [8.0, 0.0]]), 5.0).seen_probability(PDM)
    expected += SearchPath(np.array([[70.0, 0.0]]), 5.0).seen_probability(PDM)
    assert gap.probability == pytest.approx(expected, abs=1e-9)


def test_reaching_the_last_item_completes():
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    last = len(MISSION.items) - 1
    assert not tracker.update(state((0.0, 0.0), 0), 0.0).completed
    progress = tracker.update(state((0.0, 0.0), last, reached=last, armed=False), 1.0)
    assert progress.completed
    assert progress.waypoints_reached == 4


@pytest.mark.parametrize("told", [True, False])
def test_a_return_completes_with_the_landing(told):
    """PX4 never tells that a return to launch is reached."""
    last = len(MISSION.items) - 1
    reached = last - 1 if told else None  # the message may be lost
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    fly(tracker)
    progress = tracker.update(state((40.0, 30.0), last, reached=reached), 100.0)
    assert (progress.completed, progress.waypoints_reached) == (False, 4)
    landed = state((0.0, 0.0), last, reached=reached, armed=False)
    assert tracker.update(landed, 200.0).completed


def test_a_loiter_completes_with_the_last_waypoint():
    mission = build_mission(
        FRAME.to_geodetic(PATH.waypoints), altitude_m=40.0, speed=5.0, end="loiter"
    )
    tracker = FlightTracker(PDM, PATH, FRAME, mission)
    assert not fly(tracker).completed
    last = len(mission.items) - 1
    assert tracker.update(state((0.0, 30.0), last, reached=last - 1), 100.0).completed


def test_a_flight_that_ends_early_is_not_completed():
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    fly(tracker)
    landed = state((0.0, 0.0), FIRST + 3, reached=FIRST + 2, armed=False)
    progress = tracker.update(landed, 100.0)
    assert (progress.completed, progress.waypoints_reached) == (False, 3)


def test_an_earlier_flight_does_not_complete_this_one():
    last = len(MISSION.items) - 1
    on_ground = state((0.0, 0.0), 0, reached=last, armed=False)
    armed = state((0.0, 0.0), 0, reached=last)
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    for snapshot in (on_ground, armed, armed):
        progress = tracker.update(snapshot, 1.0)
        assert (progress.completed, progress.waypoints_reached) == (False, 0)
    assert fly(tracker).waypoints_reached == 3
    landed = state((0.0, 0.0), last, reached=last, armed=False)
    assert tracker.update(landed, 100.0).completed
    # The same mission, flown again: seen is seen, but its items have to be reached anew.
    seen = tracker.progress.probability
    again = tracker.update(armed, 200.0)
    assert (again.completed, again.waypoints_reached) == (False, 0)
    assert again.probability == seen


# -- telemetry -----------------------------------------------------------------------------------


def heartbeat(autopilot):
    return mav.MAVLink_heartbeat_message(2, autopilot, mav.MAV_MODE_FLAG_SAFETY_ARMED, 0, 4, 3)


def track(*messages):
    snapshot = VehicleState(1, 1)
    for message in messages:
        snapshot = replace(snapshot, **changes(snapshot, message, 1.0))
    return snapshot


def test_telemetry_becomes_a_snapshot():
    snapshot = track(
        heartbeat(mav.MAV_AUTOPILOT_PX4),
        mav.MAVLink_global_position_int_message(
            0, 570000000, -40000000, 123000, 45000, 100, -200, 50, 9000
        ),
        mav.MAVLink_mission_current_message(3),
        mav.MAVLink_mission_item_reached_message(2),
        mav.MAVLink_statustext_message(6, b"hello"),
    )
    assert snapshot.armed
    assert snapshot.dialect.name == "PX4"
    assert (snapshot.latitude, snapshot.longitude) == pytest.approx((57.0, -4.0))
    assert (snapshot.altitude, snapshot.relative_altitude) == (123.0, 45.0)
    assert snapshot.velocity == (1.0, -2.0, 0.5)
    assert snapshot.heading == pytest.approx(np.pi / 2.0)
    assert (snapshot.current_item, snapshot.reached_item) == (3, 2)
    assert snapshot.text == "hello"


def test_a_long_text_comes_in_chunks():
    chunks = [(b"RTL: start return at 520 m (31 m above destination", 0), (b")\t", 1)]
    messages = [mav.MAVLink_statustext_message(6, text, 9, n) for text, n in chunks]
    assert track(*messages).text == "RTL: start return at 520 m (31 m above destination)"
    assert track(*messages, mav.MAVLink_statustext_message(6, b"next")).text == "next"


def test_ardupilots_numbers_leave_out_home():
    snapshot = track(
        heartbeat(mav.MAV_AUTOPILOT_ARDUPILOTMEGA),
        mav.MAVLink_mission_current_message(3),
        mav.MAVLink_mission_item_reached_message(0),
    )
    assert (snapshot.current_item, snapshot.reached_item) == (2, None)


def test_a_place_outside_the_earth_is_ignored():
    message = mav.MAVLink_global_position_int_message(0, 2_000_000_000, 0, 0, 0, 0, 0, 0, 65535)
    assert changes(VehicleState(1, 1), message, 0.0) == {}


def test_zero_zero_is_no_place():
    """Vehicles tell it before their GPS has a fix."""
    before = VehicleState(1, 1, latitude=57.0, longitude=-4.0, home=(57.0, -4.0, 9.0))
    position = mav.MAVLink_global_position_int_message(0, 0, 0, 0, 0, 0, 0, 0, 65535)
    home = mav.MAVLink_home_position_message(0, 0, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
    assert changes(before, position, 1.0) == changes(before, home, 1.0) == {}
    on_the_equator = mav.MAVLink_global_position_int_message(0, 0, 10, 0, 0, 0, 0, 0, 65535)
    assert changes(before, on_the_equator, 1.0)["latitude"] == 0.0


def test_a_place_is_known_for_some_seconds():
    message = mav.MAVLink_global_position_int_message(
        0, 570_000_000, -40_000_000, 0, 0, 0, 0, 0, 65535
    )
    known = track(message)  # at 1 s
    assert known.place_at(5.0) == pytest.approx((57.0, -4.0))
    assert known.place_at(7.0) is None
    assert VehicleState(1, 1).place_at(0.0) is None
