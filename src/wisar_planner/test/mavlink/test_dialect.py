"""Differences between autopilots, and what they may normalise."""

import math
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.dialect import ARDUPILOT, GENERIC, PX4, dialect_of
from wisar_planner.mavlink.mission import (
    MissionItem,
    MissionKind,
    build_mission,
    fence_items,
)
from wisar_planner.mavlink.modes import Intent, commands_for
from wisar_planner.mavlink.wording import command_result, is_passing, mission_result

MISSION = build_mission([(57.0, -4.0), (57.001, -4.0)], altitude_m=40.0, speed=5.0).items
KIND = MissionKind.MISSION


def changed(number, **fields):
    return tuple(replace(i, **fields) if n == number else i for n, i in enumerate(MISSION))


def test_the_heartbeat_chooses():
    assert dialect_of(mav.MAV_AUTOPILOT_PX4) is PX4
    assert dialect_of(mav.MAV_AUTOPILOT_ARDUPILOTMEGA) is ARDUPILOT
    assert dialect_of(mav.MAV_AUTOPILOT_GENERIC) is GENERIC


def test_ardupilots_home_is_put_in_front_and_taken_off_again():
    wire = ARDUPILOT.to_wire(KIND, MISSION)
    assert len(wire) == len(MISSION) + 1
    assert wire[1].command == mav.MAV_CMD_NAV_TAKEOFF  # would be lost as item 0
    assert not any(math.isnan(p) for item in wire for p in item.params)
    home = MissionItem(16, 0, x=1, y=2, z=300.0)
    assert ARDUPILOT.differences(KIND, MISSION, ARDUPILOT.from_wire(KIND, (home, *wire[1:]))) == ()
    fence = (MissionItem(5001, 0, (3.0, 0.0, 0.0, 0.0)),)
    assert ARDUPILOT.to_wire(MissionKind.FENCE, fence) == fence


def test_px4_gets_what_is_meant():
    assert PX4.to_wire(KIND, MISSION) == MISSION == PX4.from_wire(KIND, MISSION)


@pytest.mark.parametrize(
    "found",
    [
        changed(2, frame=mav.MAV_FRAME_GLOBAL_RELATIVE_ALT),
        changed(2, params=(0.0, 0.0, 0.0, 0.0)),
        changed(2, x=MISSION[2].x + 1),
        changed(4, frame=mav.MAV_FRAME_GLOBAL),  # return to launch has no place
    ],
)
def test_known_normalisations_are_no_differences(found):
    assert PX4.differences(KIND, MISSION, found) == ()


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (MISSION[:-1], "5 items were sent, 4 read back"),
        (changed(2, command=19), "item 2: command 16 became 19"),
        (changed(2, frame=mav.MAV_FRAME_GLOBAL), "item 2: frame"),
        (changed(2, x=MISSION[2].x + 2), "item 2: place"),
        (changed(2, z=41.0), "item 2: altitude 40 became 41"),
        (changed(2, z=math.nan), "altitude"),
        (changed(1, params=(1.0, 6.0, -1.0, 0.0)), "item 1: parameter 2 5 became 6"),
        (changed(3, autocontinue=False), "item 3: autocontinue"),
        ((*MISSION[:2], MISSION[3], MISSION[2], MISSION[4]), "item 2: place"),
    ],
)
@pytest.mark.parametrize("dialect", [PX4, ARDUPILOT, GENERIC])
def test_real_differences_are_told(dialect, found, words):
    assert words in dialect.differences(KIND, MISSION, found)[0]


def test_ardupilot_keeps_centimetres_px4_does_not_round():
    found = changed(2, z=40.01)
    assert ARDUPILOT.differences(KIND, MISSION, found) == ()
    assert PX4.differences(KIND, MISSION, found) != ()


@pytest.mark.parametrize("kind", [MissionKind.FENCE, MissionKind.RALLY])
def test_autocontinue_means_nothing_to_fences_and_rally_points(kind):
    items = fence_items([[(57.0, -4.0), (57.1, -4.0), (57.1, -3.9)]])
    without = tuple(replace(i, autocontinue=False) for i in items)
    assert PX4.differences(kind, items, without) == ()
    assert PX4.differences(MissionKind.MISSION, items, without) != ()


def test_many_differences_are_cut_short():
    items = MISSION * 10
    assert len(PX4.differences(KIND, items, tuple(replace(i, command=1) for i in items))) == 10


def test_px4_takes_no_heights_above_terrain():
    plan = [(57.0, -4.0), (57.001, -4.0)]
    above_terrain = build_mission(plan, altitude_m=40.0, altitude_frame="terrain")
    assert "use altitude_frame 'relative'" in PX4.refusal_of(above_terrain)
    assert ARDUPILOT.refusal_of(above_terrain) == ""
    assert PX4.refusal_of(build_mission(plan, altitude_m=40.0)) == ""


# -- words ---------------------------------------------------------------------------------------


def test_every_code_has_words_of_its_own():
    codes = [c for c in mav.enums["MAV_MISSION_RESULT"] if c != mav.MAV_MISSION_RESULT_ENUM_END]
    texts = {mission_result(code) for code in codes}
    assert len(texts) == len(codes)
    assert not any("not known" in text for text in texts)
    assert all("not known" not in command_result(c) for c in range(6))
    assert "99" in mission_result(99)
    assert "99" in command_result(99)


def test_what_may_pass_later_is_told_apart():
    assert is_passing(mav.MAV_MISSION_INVALID_SEQUENCE)
    assert is_passing(mav.MAV_MISSION_NO_SPACE)
    assert not is_passing(mav.MAV_MISSION_UNSUPPORTED)
    assert not is_passing(mav.MAV_MISSION_INVALID_PARAM5_X)


# -- modes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("intent", Intent)
@pytest.mark.parametrize("autopilot", [mav.MAV_AUTOPILOT_PX4, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, 0])
@pytest.mark.parametrize("vehicle", [mav.MAV_TYPE_QUADROTOR, mav.MAV_TYPE_FIXED_WING])
def test_only_arm_arms(intent, autopilot, vehicle):
    commands = commands_for(intent, autopilot, vehicle)
    assert commands
    arming = [params for code, params in commands if code == mav.MAV_CMD_COMPONENT_ARM_DISARM]
    assert arming == {Intent.ARM: [(1.0,)], Intent.DISARM: [(0.0,)]}.get(intent, [])
    assert not any(code == mav.MAV_CMD_NAV_TAKEOFF for code, _ in commands)


@pytest.mark.parametrize(("mode", "steps"), [(0, 1), (3, 2), (4, 1), (5, 1), (6, 2)])
def test_a_copter_left_in_a_mode_of_flight_is_put_into_guided_to_be_armed(mode, steps):
    copter = (mav.MAV_AUTOPILOT_ARDUPILOTMEGA, mav.MAV_TYPE_QUADROTOR)
    commands = commands_for(Intent.ARM, *copter, mode)
    assert len(commands) == steps
    assert commands[-1][0] == mav.MAV_CMD_COMPONENT_ARM_DISARM
    if steps == 2:
        assert commands[0] == (mav.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 0.0))
    for other in ((mav.MAV_AUTOPILOT_PX4, 2), (copter[0], mav.MAV_TYPE_FIXED_WING)):
        assert len(commands_for(Intent.ARM, *other, mode)) == 1


@pytest.mark.parametrize(("sub_mode", "steps"), [(2, 2), (3, 1), (4, 2), (5, 2), (6, 1)])
def test_px4_left_in_a_mode_of_flight_is_put_into_hold_to_be_armed(sub_mode, steps):
    """After a landing the real one is in AUTO.MISSION again."""
    px4 = (mav.MAV_AUTOPILOT_PX4, mav.MAV_TYPE_QUADROTOR)
    commands = commands_for(Intent.ARM, *px4, 4 << 16 | sub_mode << 24)
    assert len(commands) == steps
    assert commands[-1] == (mav.MAV_CMD_COMPONENT_ARM_DISARM, (1.0,))
    if steps == 2:
        assert commands[0] == (mav.MAV_CMD_DO_SET_MODE, (1.0, 4.0, 3.0))


def test_copters_pause_without_a_throttle_stick():
    ((_, (_, mode, _)),) = commands_for(
        Intent.PAUSE, mav.MAV_AUTOPILOT_ARDUPILOTMEGA, mav.MAV_TYPE_QUADROTOR
    )
    assert mode == 17.0  # BRAKE; in LOITER a stick at zero means "descend"
