"""Sending a list, message by message, at a time of the test's choosing."""

from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.dialect import ARDUPILOT, PX4
from wisar_planner.mavlink.exchange import NEVER, Address
from wisar_planner.mavlink.link_estimate import LinkEstimate, RetryPolicy
from wisar_planner.mavlink.mission import MissionItem, MissionKind
from wisar_planner.mavlink.upload import Upload, UploadEnd

TARGET = Address(1, 1)
ITEMS = tuple(MissionItem(16, 6, x=n, y=-n, z=10.0) for n in range(3))
OK = mav.MAV_MISSION_ACCEPTED
STRICT = replace(ARDUPILOT, strict_sequence=True)


def upload(items=ITEMS, dialect=PX4, **policy):
    progress = []
    machine = Upload(
        items,
        MissionKind.MISSION,
        TARGET,
        dialect,
        link=LinkEstimate(RetryPolicy(**policy)),
        on_progress=progress.append,
    )
    return machine, progress


def request(seq, legacy=False, kind=0):
    make = (
        mav.MAVLink_mission_request_message if legacy else mav.MAVLink_mission_request_int_message
    )
    return make(245, 190, seq, kind)


def ack(result=OK, kind=0):
    return mav.MAVLink_mission_ack_message(245, 190, result, kind)


def sent(messages):
    return [(m.get_type(), getattr(m, "seq", getattr(m, "count", None))) for m in messages]


def run_out(machine, now):
    """Let time pass until the machine ends; return everything it sent."""
    out = []
    while not machine.done:
        assert machine.deadline < NEVER
        now = max(now, machine.deadline)
        out += machine.on_time(now)
    return out, now


@pytest.mark.parametrize("legacy", [False, True])
def test_a_clean_upload(legacy):
    machine, progress = upload()
    assert sent(machine.start(0.0)) == [("MISSION_COUNT", 3)]
    for n in range(3):
        (item,) = machine.on_message(request(n, legacy), 0.1 * n)
        # The old request, too, is answered with integers: floats lose a metre.
        assert sent([item]) == [("MISSION_ITEM_INT", n)]
        assert (item.x, item.y) == (n, -n)
    assert machine.on_message(ack(), 0.4) == []
    assert machine.end is UploadEnd.ACCEPTED
    assert machine.deadline == NEVER
    assert progress == [1, 2, 3]


def test_the_count_is_repeated_until_an_answer_comes():
    machine, _ = upload()
    machine.start(0.0)
    assert machine.on_time(0.4) == []
    assert sent(machine.on_time(0.5)) == [("MISSION_COUNT", 3)]
    assert sent(machine.on_time(1.0)) == [("MISSION_COUNT", 3)]
    assert sent(machine.on_message(request(0), 1.1)) == [("MISSION_ITEM_INT", 0)]


def test_silence_ends_in_words_within_bounds():
    machine, _ = upload(max_tries=12, patience_s=5.0)
    machine.start(0.0)
    out, now = run_out(machine, 0.0)
    assert machine.end is UploadEnd.SILENT
    assert len(out) < 12
    assert now < 30.0


def test_an_item_is_sent_again_when_nothing_happens_but_late_to_a_strict_autopilot():
    for dialect, earliest in ((PX4, 0.1), (ARDUPILOT, 0.1), (STRICT, 2.5)):
        machine, _ = upload(dialect=dialect)
        machine.start(0.0)
        machine.on_message(request(0), 0.1)
        out, now = [], 0.1
        while not out:
            now = machine.deadline
            out = machine.on_time(now)
        assert sent(out) == [("MISSION_ITEM_INT", 0)]
        assert earliest < now < 4.0


def test_a_wrong_sequence_number_is_no_refusal():
    machine, _ = upload(dialect=ARDUPILOT)
    machine.start(0.0)
    machine.on_message(request(0), 0.1)
    machine.on_message(ack(mav.MAV_MISSION_INVALID_SEQUENCE), 0.2)
    assert sent(machine.on_time(machine.deadline)) == [("MISSION_ITEM_INT", 0)]
    assert not machine.done
    assert machine.told_wrong_sequence


def test_an_error_after_the_last_item_leaves_the_answer_to_the_reading():
    machine, _ = upload(dialect=ARDUPILOT)
    machine.start(0.0)
    for n in range(3):
        machine.on_message(request(n), 0.1 * n)
    machine.on_message(ack(mav.MAV_MISSION_ERROR), 0.4)
    run_out(machine, 0.4)
    assert machine.end is UploadEnd.UNACKNOWLEDGED


def test_duplicates_of_a_request_are_answered_once():
    machine, _ = upload(dialect=STRICT)
    machine.start(0.0)
    assert len(machine.on_message(request(0), 0.1)) == 1
    assert machine.on_message(request(0), 0.3) == []
    assert len(machine.on_message(request(0), 1.2)) == 1  # now it is asked again for real


def test_a_late_request_does_not_abort_an_upload_to_a_strict_autopilot():
    machine, _ = upload(dialect=STRICT)
    machine.start(0.0)
    machine.on_message(request(0), 0.1)
    machine.on_message(request(1), 0.2)
    assert machine.on_message(request(0), 0.25) == []
    # Asked again after its own waiting time, it did start over.
    assert sent(machine.on_message(request(0), 1.3)) == [("MISSION_ITEM_INT", 0)]


def test_whatever_px4_asks_for_it_gets():
    machine, progress = upload()
    machine.start(0.0)
    for now, seq in enumerate((0, 1, 0, 2, 1)):
        assert sent(machine.on_message(request(seq), float(now))) == [("MISSION_ITEM_INT", seq)]
    assert progress == [1, 2, 3]


@pytest.mark.parametrize("seq", [3, 65535])
def test_requests_beyond_the_list_are_ignored(seq):
    machine, _ = upload()
    machine.start(0.0)
    assert machine.on_message(request(seq), 0.1) == []
    assert not machine.done


def test_messages_of_other_lists_are_ignored():
    machine, _ = upload()
    machine.start(0.0)
    for message in (request(0, kind=1), ack(kind=1), mav.MAVLink_mission_current_message(1)):
        assert machine.on_message(message, 0.1) == []
    assert not machine.done


def test_an_early_acceptance_belongs_to_another_transfer():
    machine, _ = upload()
    machine.start(0.0)
    machine.on_message(request(0), 0.1)
    machine.on_message(ack(), 0.2)
    assert not machine.done


@pytest.mark.parametrize("code", [mav.MAV_MISSION_UNSUPPORTED, mav.MAV_MISSION_NO_SPACE])
def test_a_refusal_counts_after_a_moment_of_silence(code):
    machine, _ = upload()
    machine.start(0.0)
    machine.on_message(request(0), 0.1)
    machine.on_message(ack(code), 0.2)
    assert not machine.done
    out, now = run_out(machine, 0.2)
    assert out == []
    assert now < 2.0
    assert (machine.end, machine.result) == (UploadEnd.REFUSED, code)


def test_a_refusal_followed_by_a_request_was_meant_for_a_duplicate():
    machine, _ = upload()
    machine.start(0.0)
    machine.on_message(request(0), 0.1)
    machine.on_message(ack(mav.MAV_MISSION_ERROR), 0.2)
    for n in (1, 2):
        assert len(machine.on_message(request(n), 0.2 + 0.1 * n)) == 1
    machine.on_message(ack(), 0.5)
    assert machine.end is UploadEnd.ACCEPTED


@pytest.mark.parametrize("dialect", [PX4, ARDUPILOT])
def test_a_lost_acknowledgement_is_told_apart_from_a_stalled_upload(dialect):
    whole, _ = upload(dialect=dialect)
    whole.start(0.0)
    for n in range(3):
        whole.on_message(request(n), 0.1 * n)
    run_out(whole, 0.3)
    assert whole.end is UploadEnd.UNACKNOWLEDGED
    half, _ = upload(dialect=dialect)
    half.start(0.0)
    half.on_message(request(0), 0.1)
    run_out(half, 0.1)
    assert half.end is UploadEnd.STALLED
    assert half.items_sent == 1


def test_cancelling_tells_the_autopilot_and_ends():
    machine, _ = upload()
    machine.start(0.0)
    machine.on_message(request(0), 0.1)
    (message,) = machine.cancel(0.2)
    assert (message.get_type(), message.type) == (
        "MISSION_ACK",
        mav.MAV_MISSION_OPERATION_CANCELLED,
    )
    assert machine.end is UploadEnd.CANCELLED
    assert machine.cancel(0.3) == []
    assert machine.on_message(request(1), 0.3) == []


def test_timeouts_follow_the_link():
    machine, _ = upload(items=ITEMS * 20)
    machine.start(0.0)
    now = 0.0
    for n in range(40):
        now += 0.9  # a slow telemetry radio
        machine.on_message(request(n), now)
    assert machine.deadline - now > 1.5
