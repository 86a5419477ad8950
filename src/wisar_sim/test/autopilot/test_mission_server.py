"""Each answer of the simulated autopilots, as measured on the real ones."""

import math

import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_sim.autopilot.mission_server import Client, MissionServer, StoredItem
from wisar_sim.autopilot.profile import PROFILES

CLIENT, OTHER = Client(245, 190), Client(255, 190)
HOME = StoredItem(16, 0, (0.0,) * 4, 570_000_000, -40_000_000, 100.0)
MISSION, FENCE, RALLY = 0, 1, 2
ACCEPTED = mav.MAV_MISSION_ACCEPTED
BOOTED = 10.0


def server(profile="px4", booted=True):
    made = MissionServer(PROFILES[profile], lambda: HOME)
    made.tick(0.0 if booted else BOOTED)
    return made


def count(n, kind=MISSION):
    return mav.MAVLink_mission_count_message(1, 1, n, kind)


def item(seq, kind=MISSION, **changes):
    fields = {
        "frame": 6, "command": 16, "param1": 0.0, "param2": 0.0, "param3": 0.0, "param4": 0.0,
        "x": 570_000_000 + seq, "y": -40_000_000, "z": 40.0,
    } | changes  # fmt: skip
    return mav.MAVLink_mission_item_int_message(
        1, 1, seq, fields["frame"], fields["command"], 0, 1,
        *(fields[f"param{n}"] for n in range(1, 5)), fields["x"], fields["y"], fields["z"], kind,
    )  # fmt: skip


def talk(target, *messages, now=BOOTED, client=CLIENT):
    """Answers as (type, number) of the last message."""
    out = []
    for message in messages:
        out = target.handle(message, client, now)
    return [short(m) for m in out]


def short(message):
    name = message.get_type().removeprefix("MISSION_")
    for field in ("seq", "count", "type"):
        if hasattr(message, field):
            return name, getattr(message, field)
    return name, None


def upload(target, n=3, kind=MISSION, now=BOOTED, **changes):
    """Send a whole list; return the last answer."""
    talk(target, count(n, kind), now=now)
    out = []
    for seq in range(n):
        out = talk(target, item(seq, kind, **changes), now=now)
    return out


ALL = pytest.mark.parametrize("profile", sorted(PROFILES))


# -- the measured table ----------------------------------------------------------------------


def test_px4_asks_for_item_0_in_the_old_way_once_after_boot():
    target = server("px4")
    assert talk(target, count(3)) == [("REQUEST", 0)]
    assert talk(target, item(0)) == [("REQUEST_INT", 1)]
    assert talk(target, item(1), item(2)) == [("ACK", ACCEPTED)]
    assert talk(target, count(3)) == [("REQUEST_INT", 0)]


def test_px4_asks_in_the_other_way_when_told_that_one_is_not_supported():
    target = server("px4")
    talk(target, count(3))
    no = mav.MAVLink_mission_ack_message(1, 1, mav.MAV_MISSION_UNSUPPORTED, 0)
    assert talk(target, no) == [("REQUEST_INT", 0)]
    assert talk(target, no) == [("REQUEST", 0)]


def test_ardupilot_always_asks_in_the_old_way():
    target = server("ardupilot")
    for _ in range(2):
        assert talk(target, count(2)) == [("REQUEST", 0)]
        assert talk(target, item(0)) == [("REQUEST", 1)]
        assert talk(target, item(1)) == [("ACK", ACCEPTED)]


def test_mavsdk_asks_for_integers():
    assert talk(server("mavsdk"), count(3)) == [("REQUEST_INT", 0)]


@pytest.mark.parametrize(
    ("changes", "answers"),
    [
        ({"command": 31_999}, ("UNSUPPORTED", "UNSUPPORTED", "ACCEPTED")),
        ({"frame": 99}, ("UNSUPPORTED_FRAME", "UNSUPPORTED_FRAME", "ACCEPTED")),
        ({"frame": 11}, ("UNSUPPORTED_FRAME", "ACCEPTED", "ACCEPTED")),
        ({"x": 950_000_000}, ("ACCEPTED", "INVALID_PARAM5_X", "ACCEPTED")),
        ({"z": math.nan}, ("ACCEPTED", "INVALID_PARAM7", "ACCEPTED")),
    ],
)
def test_wrong_items(changes, answers):
    for profile, answer in zip(("px4", "ardupilot", "mavsdk"), answers, strict=True):
        target = server(profile)
        talk(target, count(1))
        expected = getattr(mav, f"MAV_MISSION_{answer}")
        assert talk(target, item(0, **changes)) == [("ACK", expected)]
        kept = len(target.lists[MISSION])
        assert kept == (1 if answer == "ACCEPTED" and profile != "ardupilot" else 0)


@pytest.mark.parametrize(("profile", "after"), [("px4", 0.26), ("mavsdk", 0.5)])
def test_a_wrong_sequence_number_is_overlooked_and_the_item_asked_for_again(profile, after):
    target = server(profile)
    talk(target, count(3))
    assert talk(target, item(2)) == []
    assert target.tick(BOOTED + after - 0.01) == []
    assert [short(m)[1] for m in target.tick(BOOTED + after)] == [0]


def test_ardupilot_tells_a_wrong_sequence_number_and_goes_on():
    target = server("ardupilot")
    told = ("ACK", mav.MAV_MISSION_INVALID_SEQUENCE)
    talk(target, count(3))
    assert talk(target, item(2)) == [told]
    assert talk(target, item(0)) == [("REQUEST", 1)]
    assert talk(target, item(0)) == [told]
    assert [short(m) for m in target.tick(BOOTED + 1.0)] == [("REQUEST", 1)]
    assert talk(target, item(1), item(2)) == [("ACK", ACCEPTED)]
    # Outside an upload every item is an error, also the last one again.
    assert talk(target, item(2)) == [("ACK", mav.MAV_MISSION_ERROR)]


def test_wrong_sequence_numbers_do_not_keep_an_upload_alive():
    target = server("ardupilot")
    talk(target, count(3))
    for after in range(1, 8):
        assert talk(target, item(2), now=BOOTED + after) == [
            ("ACK", mav.MAV_MISSION_INVALID_SEQUENCE)
        ]
    said = [short(m) for m in target.tick(BOOTED + 8.0)]
    assert said == [("ACK", mav.MAV_MISSION_OPERATION_CANCELLED)]


@pytest.mark.parametrize(("profile", "after"), [("px4", 0.26), ("ardupilot", 1.0), ("mavsdk", 0.5)])
def test_a_lost_answer_is_asked_for_again(profile, after):
    target = server(profile)
    talk(target, count(3))
    (again,) = target.tick(BOOTED + after)
    assert short(again)[1] == 0
    assert target.deadline == pytest.approx(BOOTED + 2 * after)


@pytest.mark.parametrize(
    ("profile", "after", "words"),
    [
        ("px4", 5.0, []),
        ("mavsdk", 2.0, []),
        ("ardupilot", 8.0, [("ACK", mav.MAV_MISSION_OPERATION_CANCELLED)]),
    ],
)
def test_a_silent_client_is_given_up(profile, after, words):
    target = server(profile)
    talk(target, count(3))
    target.tick(BOOTED + after - 0.01)
    assert [short(m) for m in target.tick(BOOTED + after)] == words
    assert target.tick(BOOTED + after + 60.0) == []
    assert target.deadline == math.inf


def test_a_count_of_60000():
    for profile in ("px4", "ardupilot"):
        assert talk(server(profile), count(60_000)) == [("ACK", mav.MAV_MISSION_NO_SPACE)]
    assert talk(server("mavsdk"), count(60_000)) == [("REQUEST_INT", 0)]


@ALL
def test_fence_and_rally_points_are_accepted(profile):
    target = server(profile)
    corner = mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION
    assert upload(target, 3, FENCE, command=corner, frame=0) == [("ACK", ACCEPTED)]
    point = mav.MAV_CMD_NAV_RALLY_POINT
    assert upload(target, 2, RALLY, command=point, frame=3) == [("ACK", ACCEPTED)]
    assert [len(target.lists[k]) for k in (MISSION, FENCE, RALLY)] == [0, 3, 2]


def test_ardupilot_has_no_space_just_after_boot():
    target = server("ardupilot", booted=False)
    assert talk(target, count(3), now=BOOTED + 5.9) == [("ACK", mav.MAV_MISSION_NO_SPACE)]
    assert talk(target, count(3), now=BOOTED + 6.0) == [("REQUEST", 0)]


def test_ardupilot_keeps_item_0_as_home():
    target = server("ardupilot")
    upload(target, 3)
    assert len(target.flight_items) == 2
    assert target.flight_items[0].x == 570_000_001
    assert talk(target, mav.MAVLink_mission_request_list_message(1, 1, 0)) == [("COUNT", 3)]
    (home,) = target.handle(mav.MAVLink_mission_request_int_message(1, 1, 0, 0), CLIENT, BOOTED)
    assert (home.x, home.z) == (HOME.x, HOME.z)


# -- what all have in common -------------------------------------------------------------------


AS_A_WHOLE = pytest.mark.parametrize("profile", ["mavsdk", "px4"])


def test_ardupilot_overwrites_its_mission_in_place():
    target = server("ardupilot")
    upload(target, 6)
    old = target.lists[MISSION]
    assert len(old) == 5  # without home
    talk(target, count(4))
    assert target.lists[MISSION] == old[:3]  # the return at its end is gone
    talk(target, item(0, z=77.0), item(1, z=77.0))
    assert [i.z for i in target.lists[MISSION]] == [77.0, 40.0, 40.0]
    cancel = mav.MAVLink_mission_ack_message(1, 1, mav.MAV_MISSION_OPERATION_CANCELLED, 0)
    talk(target, cancel)
    assert [i.z for i in target.lists[MISSION]] == [77.0, 40.0, 40.0]
    upload(target, 6, FENCE, command=5001, param1=6.0)
    fence = target.lists[FENCE]
    talk(target, count(3, FENCE))
    assert target.lists[FENCE] == fence  # only the mission


@AS_A_WHOLE
def test_the_old_mission_counts_until_the_last_item_is_in(profile):
    target = server(profile)
    upload(target, 2)
    old = target.lists[MISSION]
    talk(target, count(4))
    for seq in range(3):
        talk(target, item(seq, z=77.0))
        assert target.lists[MISSION] == old
    talk(target, item(3, z=77.0))
    assert target.lists[MISSION] != old


@AS_A_WHOLE
def test_a_cancelled_upload_changes_nothing(profile):
    target = server(profile)
    upload(target, 2)
    old = target.lists[MISSION]
    talk(target, count(3), item(0, z=77.0))
    cancel = mav.MAVLink_mission_ack_message(1, 1, mav.MAV_MISSION_OPERATION_CANCELLED, 0)
    assert talk(target, cancel) == []
    talk(target, item(1), item(2))
    assert target.lists[MISSION] == old
    assert target.deadline == math.inf


@ALL
def test_lists_read_back_as_they_were_sent(profile):
    target = server(profile)
    upload(target, 4)
    home = 1 if profile == "ardupilot" else 0
    assert talk(target, mav.MAVLink_mission_request_list_message(1, 1, 0)) == [("COUNT", 4)]
    for seq in range(home, 4):
        if home and seq == 1:
            talk(target, mav.MAVLink_mission_request_int_message(1, 1, 0, 0))
        (m,) = target.handle(mav.MAVLink_mission_request_int_message(1, 1, seq, 0), CLIENT, BOOTED)
        assert (m.seq, m.x, m.y, m.z) == (seq, 570_000_000 + seq, -40_000_000, 40.0)


@pytest.mark.parametrize(("profile", "kept"), [("px4", 0), ("ardupilot", 1), ("mavsdk", 1)])
def test_px4_keeps_no_autocontinue_of_fence_corners(profile, kept):
    target = server(profile)
    upload(target, 3, FENCE, command=5001, param1=3.0)
    talk(target, mav.MAVLink_mission_request_list_message(1, 1, FENCE))
    request = mav.MAVLink_mission_request_int_message(1, 1, 0, FENCE)
    (corner,) = target.handle(request, CLIENT, BOOTED)
    assert (corner.param1, corner.autocontinue) == (3.0, kept)


def test_the_old_request_is_answered_with_floats():
    target = server("px4")
    upload(target, 1)
    talk(target, mav.MAVLink_mission_request_list_message(1, 1, 0))
    (m,) = target.handle(mav.MAVLink_mission_request_message(1, 1, 0, 0), CLIENT, BOOTED)
    assert m.get_type() == "MISSION_ITEM"
    assert m.x == pytest.approx(57.0)


@ALL
def test_clearing_one_list_leaves_the_others(profile):
    target = server(profile)
    upload(target, 2)
    upload(target, 3, FENCE, command=5001, frame=0)
    assert talk(target, mav.MAVLink_mission_clear_all_message(1, 1, FENCE)) == [("ACK", ACCEPTED)]
    assert target.lists[FENCE] == ()
    assert target.lists[MISSION] != ()
    clear_all = mav.MAVLink_mission_clear_all_message(1, 1, mav.MAV_MISSION_TYPE_ALL)
    assert talk(target, clear_all) == [("ACK", ACCEPTED)]
    assert target.lists[MISSION] == ()


@ALL
def test_unknown_lists_are_refused(profile):
    target = server(profile)
    for message in (
        count(1, 77),
        mav.MAVLink_mission_request_list_message(1, 1, 77),
        mav.MAVLink_mission_clear_all_message(1, 1, 77),
    ):
        assert talk(target, message) == [("ACK", mav.MAV_MISSION_UNSUPPORTED)]


@ALL
def test_a_second_client_cannot_interfere(profile):
    target = server(profile)
    talk(target, count(2))
    assert talk(target, count(5), client=OTHER) == [("ACK", mav.MAV_MISSION_DENIED)]
    talk(target, item(0, z=66.0), client=OTHER)
    assert talk(target, item(0), item(1)) == [("ACK", ACCEPTED)]
    assert all(i.z == 40.0 for i in target.lists[MISSION])


def test_px4_acknowledges_a_repeated_last_item_again():
    target = server("px4")
    upload(target, 3)
    assert talk(target, item(2)) == [("ACK", ACCEPTED)]
    assert talk(target, item(1)) == [("ACK", mav.MAV_MISSION_ERROR)]


def test_px4_ends_a_download_in_which_an_old_item_is_asked_for():
    target = server("px4")
    upload(target, 4)
    ask = [mav.MAVLink_mission_request_int_message(1, 1, n, 0) for n in range(4)]
    talk(target, mav.MAVLink_mission_request_list_message(1, 1, 0))
    assert talk(target, ask[0], ask[1], ask[1]) == [("ITEM_INT", 1)]
    assert talk(target, ask[2], ask[0]) == [("ACK", mav.MAV_MISSION_ERROR)]
    assert talk(target, ask[3]) == []  # and is silent from then on


def test_px4_is_busy_while_it_transfers():
    target = server("px4")
    upload(target, 3)
    talk(target, count(2), item(0))
    assert talk(target, count(2)) == [("ACK", mav.MAV_MISSION_ERROR)]
    assert talk(target, mav.MAVLink_mission_request_list_message(1, 1, 0)) == []


def test_a_count_of_0_clears():
    target = server("px4")
    upload(target, 2)
    assert talk(target, count(0)) == [("ACK", ACCEPTED)]
    assert target.lists[MISSION] == ()
