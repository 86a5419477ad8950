"""Requests that are repeated until the vehicle shows, not only says, that it has done them."""

import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.command import Command, RequestEnd
from wisar_planner.mavlink.exchange import Address
from wisar_planner.mavlink.link_estimate import LinkEstimates
from wisar_planner.mavlink.modes import (
    Intent,
    commands_for,
    flies_by_itself,
    flies_mission,
    shown_by,
)

PX4, ARDUPILOT = mav.MAV_AUTOPILOT_PX4, mav.MAV_AUTOPILOT_ARDUPILOTMEGA
COPTER = mav.MAV_TYPE_QUADROTOR
HOLD, MISSION, RETURN = (4 << 16 | sub << 24 for sub in (3, 4, 5))
ACCEPTED = mav.MAV_RESULT_ACCEPTED


def command(intent, **options):
    code, params = commands_for(intent, PX4, COPTER)[-1]
    return Command(
        code,
        params,
        Address(1, 1),
        link=LinkEstimates().asking,
        shown_by=shown_by(code, params, PX4, COPTER),
        **options,
    )


def ack(code=mav.MAV_CMD_DO_SET_MODE, result=ACCEPTED):
    return mav.MAVLink_command_ack_message(code, result, 0, 0, 245, 190)


def beat(mode, armed=True):
    base = mav.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mav.MAVLink_heartbeat_message(COPTER, PX4, base, mode, 4, 3)


def run_out(machine, now, mode, armed=True):
    """Let time pass, with heartbeats; return when it was sent again, and the end's time."""
    sent = []
    while not machine.done:
        now += 0.1
        if round(now * 10) % 10 == 0:
            machine.on_message(beat(mode, armed), now)
        sent += [now for _ in machine.on_time(now)]
        assert now < 100.0
    return sent, now


def test_the_late_acknowledgement_of_a_pause_is_not_that_of_a_return():
    pause = command(Intent.PAUSE)
    pause.start(0.0)
    assert len(pause.on_time(0.5)) == 1
    pause.on_message(ack(), 0.9)
    assert not pause.done
    pause.on_message(beat(HOLD), 1.0)
    assert pause.end is RequestEnd.ACCEPTED
    back = command(Intent.RETURN)
    back.start(1.0)  # lost
    back.on_message(ack(), 1.1)  # of the repeated pause
    assert not back.done
    back.on_message(beat(HOLD), 2.0)
    assert len(back.on_time(2.0)) == 1  # asked for again
    back.on_message(ack(), 2.1)
    back.on_message(beat(RETURN), 3.0)
    assert back.end is RequestEnd.ACCEPTED


def test_a_heartbeat_without_an_acknowledgement_may_be_an_old_one():
    machine = command(Intent.RETURN)
    machine.start(0.0)
    machine.on_message(beat(RETURN), 0.1)
    assert not machine.done


def test_what_is_acknowledged_and_never_shown_ends_in_words():
    machine = command(Intent.RETURN)
    machine.start(0.0)
    machine.on_message(ack(), 0.1)
    sent, now = run_out(machine, 0.1, HOLD)
    assert machine.end is RequestEnd.UNCHANGED
    assert len(sent) > 5
    assert 15.0 < now < 25.0


@pytest.mark.parametrize(("intent", "armed"), [(Intent.ARM, True), (Intent.DISARM, False)])
def test_arming_counts_when_the_heartbeat_shows_it(intent, armed):
    machine = command(intent)
    machine.start(0.0)
    machine.on_message(ack(mav.MAV_CMD_COMPONENT_ARM_DISARM), 0.1)
    machine.on_message(beat(HOLD, armed=not armed), 0.2)
    assert not machine.done
    machine.on_message(beat(HOLD, armed=armed), 1.2)
    assert machine.end is RequestEnd.ACCEPTED


def test_a_refusal_counts_at_once():
    machine = command(Intent.RETURN)
    machine.start(0.0)
    machine.on_message(ack(result=mav.MAV_RESULT_DENIED), 0.1)
    assert (machine.end, machine.result) == (RequestEnd.REFUSED, mav.MAV_RESULT_DENIED)


def test_an_acknowledged_start_is_not_sent_again():
    """It would begin the mission anew, or take it out of the pilot's hands."""
    machine = command(Intent.START, insists=False, limit_s=3.0)
    machine.start(0.0)
    machine.on_message(ack(mav.MAV_CMD_MISSION_START), 0.1)
    sent, now = run_out(machine, 0.1, HOLD)
    assert (machine.end, sent) == (RequestEnd.UNCHANGED, [])
    assert now == pytest.approx(3.0, abs=0.15)


def test_a_start_is_not_repeated_for_long():
    machine = command(Intent.START, insists=False, limit_s=3.0)
    assert len(machine.start(0.0)) == 1
    sent, now = run_out(machine, 0.0, HOLD)
    assert machine.end is RequestEnd.SILENT
    assert len(sent) > 2
    assert max(sent) < now == pytest.approx(3.0, abs=0.15)


def test_nothing_is_sent_again_that_has_become_unsafe():
    said = ""
    machine = command(Intent.START, insists=False, limit_s=3.0, objection=lambda _: said)
    assert len(machine.start(0.0)) == 1
    assert len(machine.on_time(machine.deadline)) == 1
    said = "no longer armed"
    assert machine.on_time(machine.deadline) == []
    assert (machine.end, machine.why) == (RequestEnd.WITHDRAWN, said)
    unsafe_from_the_start = command(Intent.START, objection=lambda _: said)
    assert unsafe_from_the_start.start(0.0) == []
    assert unsafe_from_the_start.end is RequestEnd.WITHDRAWN


# -- modes ----------------------------------------------------------------------------------------


def test_modes_that_fly():
    assert flies_mission(PX4, COPTER, MISSION)
    assert not flies_mission(PX4, COPTER, HOLD)
    assert flies_mission(ARDUPILOT, COPTER, 3)
    assert flies_mission(ARDUPILOT, mav.MAV_TYPE_FIXED_WING, 10)
    assert not flies_mission(ARDUPILOT, mav.MAV_TYPE_FIXED_WING, 3)
    assert not flies_mission(mav.MAV_AUTOPILOT_GENERIC, COPTER, MISSION)
    assert [flies_by_itself(PX4, COPTER, m) for m in (HOLD, MISSION, RETURN)] == [False, True, True]
    assert flies_by_itself(PX4, COPTER, 4 << 16 | 2 << 24)
    assert [flies_by_itself(ARDUPILOT, COPTER, m) for m in (0, 3, 4, 6)] == [False, True] * 2
    assert flies_by_itself(ARDUPILOT, mav.MAV_TYPE_FIXED_WING, 13)


@pytest.mark.parametrize("intent", [Intent.PAUSE, Intent.RESUME, Intent.RETURN])
@pytest.mark.parametrize("vehicle", [COPTER, mav.MAV_TYPE_FIXED_WING])
def test_ardupilots_heartbeat_shows_the_mode_by_its_number(intent, vehicle):
    ((code, params),) = commands_for(intent, ARDUPILOT, vehicle)
    shown = shown_by(code, params, ARDUPILOT, vehicle)
    assert shown(beat(int(params[1])))
    assert not shown(beat(int(params[1]) + 1))
