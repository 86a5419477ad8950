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


def update(tracker, snapshot, now):
    """Let a tracker take in a snapshot with a position of this moment."""
    return tracker.update(replace(snapshot, position_at=now), now)


def fly(tracker, spacing=1.0):
    now = 0.0
    for leg in range(3):
        a, b = PATH.waypoints[leg], PATH.waypoints[leg + 1]
        for share in np.arange(0.0, 1.0, spacing / np.linalg.norm(b - a)):
            now += 0.2
            update(tracker, state(a + share * (b - a), FIRST + leg + 1, FIRST + leg), now)
    return update(tracker, state(PATH.waypoints[-1], FIRST + 3, FIRST + 2), now + 0.2)


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
        progress = update(tracker, state(over_the_peak, current), 1.0)
        assert (progress.probability, progress.flying) == (0.0, False)
    assert update(tracker, state(over_the_peak, FIRST + 1, armed=False), 2.0).probability == 0.0
    assert update(tracker, state(over_the_peak, FIRST + 1), 3.0).probability > 0.0


def test_what_happened_in_a_long_silence_is_not_invented():
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION, max_gap_s=3.0)
    update(tracker, state((0.0, 0.0), FIRST + 1), 0.0)
    joined = update(tracker, state((8.0, 0.0), FIRST + 1), 2.0)
    assert joined.distance == pytest.approx(8.0, rel=1e-6)
    gap = update(tracker, state((70.0, 0.0), FIRST + 1), 30.0)
    assert gap.distance == pytest.approx(8.0, rel=1e-6)
    # Two separate stretches: a capsule of 8 m and a disc.
    expected = SearchPath(np.array([[0.0, 0.0], [8.0, 0.0]]), 5.0).seen_probability(PDM)
    expected += SearchPath(np.array([[70.0, 0.0]]), 5.0).seen_probability(PDM)
    assert gap.probability == pytest.approx(expected, abs=1e-9)


def test_a_position_that_other_messages_repeat_is_as_old_as_it_is():
    """MISSION_CURRENT goes on coming where GLOBAL_POSITION_INT has fallen silent."""
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION, max_gap_s=3.0)
    update(tracker, state((0.0, 0.0), FIRST + 1), 0.0)
    old = replace(state((8.0, 0.0), FIRST + 1), position_at=2.0)
    for now in range(2, 32):
        repeated = tracker.update(old, float(now))
    assert repeated.distance == pytest.approx(8.0, rel=1e-6)
    after = update(tracker, state((70.0, 0.0), FIRST + 1), 32.0)
    assert after.distance == pytest.approx(8.0, rel=1e-6)
    expected = SearchPath(np.array([[0.0, 0.0], [8.0, 0.0]]), 5.0).seen_probability(PDM)
    expected += SearchPath(np.array([[70.0, 0.0]]), 5.0).seen_probability(PDM)
    assert after.probability == pytest.approx(expected, abs=1e-9)


def test_a_search_does_not_begin_at_a_position_from_long_ago():
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION, max_gap_s=3.0)
    old = replace(state(PDM.means[0], FIRST + 1), position_at=0.0)
    assert tracker.update(old, 30.0).probability == 0.0
    assert tracker.update(old, 2.0).probability > 0.0


PX4_HOLD, PX4_MISSION, PX4_RETURN, PX4_BY_HAND = (
    *(4 << 16 | sub_mode << 24 for sub_mode in (3, 4, 5)),
    3 << 16,
)
PX4 = {"autopilot": mav.MAV_AUTOPILOT_PX4, "vehicle_type": mav.MAV_TYPE_QUADROTOR}
COPTER = {**PX4, "autopilot": mav.MAV_AUTOPILOT_ARDUPILOTMEGA}
PLANE = {**COPTER, "vehicle_type": mav.MAV_TYPE_FIXED_WING}


@pytest.mark.parametrize(
    ("vehicle", "in_mission", "others"),
    [
        (PX4, PX4_MISSION, (PX4_HOLD, PX4_RETURN, PX4_BY_HAND)),
        (COPTER, 3, (17, 6, 5)),
        (PLANE, 10, (12, 11, 0)),
    ],
)
def test_what_is_flown_in_another_mode_is_not_the_mission(vehicle, in_mission, others):
    """The current item stays in a pause, on the way home and in a flight by hand."""
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)

    def fly_to(x, mode, now):
        snapshot = replace(state((x, 0.0), FIRST + 1), custom_mode=mode, **vehicle)
        return update(tracker, snapshot, now)

    fly_to(0.0, in_mission, 0.0)
    flown = fly_to(8.0, in_mission, 1.0)
    assert (flown.flying, flown.left) == (True, False)
    for number, mode in enumerate(others):
        now = 2.0 + number
        away = fly_to(8.0 + 10.0 * now, mode, now)
        assert (away.flying, away.left) == (False, True)
        assert (away.distance, away.probability) == (flown.distance, flown.probability)
    back = fly_to(8.0, in_mission, 6.0)
    assert (back.flying, back.left, back.distance) == (True, False, flown.distance)
    assert fly_to(16.0, in_mission, 7.0).distance == pytest.approx(16.0, rel=1e-6)


def test_where_modes_are_not_known_the_current_item_tells_it():
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    progress = update(tracker, replace(state((0.0, 0.0), FIRST + 1), custom_mode=17), 0.0)
    assert (progress.flying, progress.left) == (True, False)


def test_the_return_after_the_whole_search_belongs_to_the_mission():
    """PX4 flies the mission's last item in the mode of a return to launch."""
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    last = len(MISSION.items) - 1
    way = [(FIRST + 1, PX4_MISSION), (last, PX4_MISSION), (last, PX4_RETURN), (last, PX4_HOLD)]
    left = []
    for now, (current, mode) in enumerate(way):
        snapshot = replace(state((0.0, 30.0), current), custom_mode=mode, **PX4)
        left.append(update(tracker, snapshot, float(now)).left)
    assert left == [False, False, False, True]


def test_reaching_the_last_item_completes():
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    last = len(MISSION.items) - 1
    assert not update(tracker, state((0.0, 0.0), 0), 0.0).completed
    progress = update(tracker, state((0.0, 0.0), last, reached=last, armed=False), 1.0)
    assert progress.completed
    assert progress.waypoints_reached == 4


@pytest.mark.parametrize("told", [True, False])
def test_a_return_completes_with_the_landing(told):
    """PX4 never tells that a return to launch is reached."""
    last = len(MISSION.items) - 1
    reached = last - 1 if told else None  # the message may be lost
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    fly(tracker)
    progress = update(tracker, state((40.0, 30.0), last, reached=reached), 100.0)
    assert (progress.completed, progress.waypoints_reached) == (False, 4)
    landed = state((0.0, 0.0), last, reached=reached, armed=False)
    assert update(tracker, landed, 200.0).completed


def test_a_loiter_completes_with_the_last_waypoint():
    mission = build_mission(
        FRAME.to_geodetic(PATH.waypoints), altitude_m=40.0, speed=5.0, end="loiter"
    )
    tracker = FlightTracker(PDM, PATH, FRAME, mission)
    assert not fly(tracker).completed
    last = len(mission.items) - 1
    assert update(tracker, state((0.0, 30.0), last, reached=last - 1), 100.0).completed


def test_a_flight_that_ends_early_is_not_completed():
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    fly(tracker)
    landed = state((0.0, 0.0), FIRST + 3, reached=FIRST + 2, armed=False)
    progress = update(tracker, landed, 100.0)
    assert (progress.completed, progress.waypoints_reached) == (False, 3)


def test_an_earlier_flight_does_not_complete_this_one():
    last = len(MISSION.items) - 1
    on_ground = state((0.0, 0.0), 0, reached=last, armed=False)
    armed = state((0.0, 0.0), 0, reached=last)
    tracker = FlightTracker(PDM, PATH, FRAME, MISSION)
    for snapshot in (on_ground, armed, armed):
        progress = update(tracker, snapshot, 1.0)
        assert (progress.completed, progress.waypoints_reached) == (False, 0)
    assert fly(tracker).waypoints_reached == 3
    landed = state((0.0, 0.0), last, reached=last, armed=False)
    assert update(tracker, landed, 100.0).completed
    # The same mission, flown again: seen is seen, but its items have to be reached anew.
    seen = tracker.progress.probability
    again = update(tracker, armed, 200.0)
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
