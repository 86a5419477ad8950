"""Telemetry that does not come by itself is asked for, and only that."""

import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Codec
from wisar_planner.mavlink.exchange import Address
from wisar_planner.mavlink.session import Session

POSITION = mav.MAVLink_global_position_int_message(0, 570000000, -40000000, 0, 0, 0, 0, 0, 0)
CURRENT = mav.MAVLink_mission_current_message(1)
HOME = mav.MAVLink_home_position_message(0, 0, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
BEAT = mav.MAVLink_heartbeat_message(2, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)


def run(seconds, sent_by_vehicle, silent_from=float("inf")):
    """Let a session hear messages every second; return (time, message id) asked for."""
    session, vehicle, ground = Session(Address(245, 190), "test"), Codec(7, 1), Codec(245, 190)
    asked = []
    for now in range(1, seconds + 1):
        heard = (BEAT, *(() if now >= silent_from else sent_by_vehicle))
        for message in ground.decode(b"".join(map(vehicle.encode, heard)))[0]:
            session.receive(message, float(now))
        for message in session.tick(float(now)):
            if message.get_type() == "COMMAND_LONG":
                assert message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL
                assert (message.target_system, message.target_component) == (7, 1)
                asked.append((now, int(message.param1)))
    return asked


def test_a_vehicle_that_sends_only_heartbeats_is_asked_soon_and_then_ever_less():
    asked = run(100, ())
    codes = {POSITION.id, CURRENT.id, HOME.id}
    assert {code for now, code in asked if now <= 5} == codes
    for code in codes:
        times = [now for now, one in asked if one == code]
        assert len(times) == 6
        assert times[-1] - times[-2] == 30


def test_what_comes_by_itself_is_left_alone():
    assert run(60, (POSITION, CURRENT, HOME)) == []


@pytest.mark.parametrize(
    ("missing", "sent"), [(POSITION, (CURRENT, HOME)), (CURRENT, (POSITION, HOME))]
)
def test_only_what_is_missing_is_asked_for(missing, sent):
    assert {code for _, code in run(30, sent)} == {missing.id}


def test_what_ends_is_asked_for_again():
    asked = run(40, (POSITION, CURRENT, HOME), silent_from=20)
    assert min(now for now, _ in asked) in (21, 22)
    assert {code for _, code in asked} == {POSITION.id, CURRENT.id, HOME.id}


def test_a_connection_that_broke_for_a_moment_is_told_as_well_again():
    session, ground, vehicle = Session(Address(245, 190), "test"), Codec(245, 190), Codec(7, 1)

    def beat(now):
        for message in ground.decode(vehicle.encode(BEAT))[0]:
            session.receive(message, now)

    beat(1.0)
    linked = session.status
    assert linked.connected
    session.connection_lost("the other end closed the connection")
    session.tick(2.0)
    assert "closed" in session.status.text
    beat(3.0)
    assert session.status == linked


def test_a_silent_vehicle_is_not_asked():
    session, ground, vehicle = Session(Address(245, 190), "test"), Codec(245, 190), Codec(7, 1)
    for message in ground.decode(vehicle.encode(BEAT))[0]:
        session.receive(message, 0.0)
    asked = [m for now in range(7, 60) for m in session.tick(float(now))]
    assert {m.get_type() for m in asked} == {"HEARTBEAT"}
