"""Reading a list, message by message."""

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.download import Download, DownloadEnd
from wisar_planner.mavlink.exchange import NEVER, Address, item_message
from wisar_planner.mavlink.link_estimate import LinkEstimate, RetryPolicy
from wisar_planner.mavlink.mission import MissionItem, MissionKind

TARGET, GROUND = Address(1, 1), Address(245, 190)
ITEMS = [MissionItem(16, 6, x=n, y=-n, z=10.0) for n in range(3)]


def download(**policy):
    return Download(MissionKind.MISSION, TARGET, link=LinkEstimate(RetryPolicy(**policy)))


def count(n, kind=0):
    return mav.MAVLink_mission_count_message(245, 190, n, kind)


def item(n):
    return item_message(ITEMS[n], n, 0, GROUND)


def sent(messages):
    return [(m.get_type(), getattr(m, "seq", None)) for m in messages]


def run_out(machine, now):
    out = []
    while not machine.done:
        now = max(now, machine.deadline)
        out += machine.on_time(now)
    return sent(out), now


def test_a_clean_download():
    machine = download()
    assert sent(machine.start(0.0)) == [("MISSION_REQUEST_LIST", None)]
    assert sent(machine.on_message(count(3), 0.1)) == [("MISSION_REQUEST_INT", 0)]
    assert sent(machine.on_message(item(0), 0.2)) == [("MISSION_REQUEST_INT", 1)]
    assert sent(machine.on_message(item(1), 0.3)) == [("MISSION_REQUEST_INT", 2)]
    (end,) = machine.on_message(item(2), 0.4)
    assert (end.get_type(), end.type) == ("MISSION_ACK", mav.MAV_MISSION_ACCEPTED)
    assert machine.end is DownloadEnd.COMPLETE
    assert machine.items == ITEMS
    assert machine.deadline == NEVER


def test_an_empty_list_is_complete_at_once():
    machine = download()
    machine.start(0.0)
    assert sent(machine.on_message(count(0), 0.1)) == [("MISSION_ACK", None)]
    assert machine.items == []


def test_what_is_lost_is_asked_for_again():
    machine = download()
    machine.start(0.0)
    assert sent(machine.on_time(0.5)) == [("MISSION_REQUEST_LIST", None)]
    machine.on_message(count(3), 0.6)
    assert sent(machine.on_time(machine.deadline)) == [("MISSION_REQUEST_INT", 0)]


def test_duplicates_late_and_foreign_messages_are_harmless():
    machine = download()
    machine.start(0.0)
    assert machine.on_message(item(0), 0.0) == []  # before the count
    assert machine.on_message(count(3, kind=1), 0.0) == []
    machine.on_message(count(3), 0.1)
    assert machine.on_message(count(7), 0.1) == []
    machine.on_message(item(0), 0.2)
    for late in (item(0), item(2), count(3)):
        assert machine.on_message(late, 0.2) == []
    machine.on_message(item(1), 0.3)
    machine.on_message(item(2), 0.4)
    assert machine.items == ITEMS


def test_an_aborted_transfer_is_started_over():
    machine = download()
    machine.start(0.0)
    machine.on_message(count(3), 0.1)
    machine.on_message(item(0), 0.2)
    machine.on_message(mav.MAVLink_mission_ack_message(245, 190, mav.MAV_MISSION_ERROR, 0), 0.3)
    assert sent(machine.on_time(machine.deadline)) == [("MISSION_REQUEST_LIST", None)]
    machine.on_message(count(3), 1.0)
    for n in range(3):
        machine.on_message(item(n), 1.1 + 0.1 * n)
    assert machine.items == ITEMS


def test_long_silence_in_the_middle_starts_over_and_then_ends_in_bounds():
    machine = download()
    machine.start(0.0)
    machine.on_message(count(3), 0.1)
    machine.on_message(item(0), 0.2)
    asked, now = run_out(machine, 0.2)
    assert ("MISSION_REQUEST_LIST", None) in asked
    assert machine.end is DownloadEnd.SILENT
    assert now < 120.0


def refuse(machine, code, now):
    machine.on_message(mav.MAVLink_mission_ack_message(245, 190, code, 0), now)


def test_a_refusal_is_kept():
    machine = download()
    machine.start(0.0)
    refuse(machine, mav.MAV_MISSION_UNSUPPORTED, 0.1)
    asked, _ = run_out(machine, 0.1)
    assert asked == []
    assert (machine.end, machine.result) == (DownloadEnd.REFUSED, mav.MAV_MISSION_UNSUPPORTED)


def test_a_refusal_that_may_pass_is_believed_when_it_is_repeated():
    machine = download()
    machine.start(0.0)
    now = 0.1
    while not machine.done:
        refuse(machine, mav.MAV_MISSION_DENIED, now)
        now = machine.deadline
        machine.on_time(now)
    assert (machine.end, machine.result) == (DownloadEnd.REFUSED, mav.MAV_MISSION_DENIED)
    assert now < 5.0


def test_a_late_refusal_does_not_end_a_download():
    machine = download()
    machine.start(0.0)
    refuse(machine, mav.MAV_MISSION_ERROR, 0.1)
    assert sent(machine.on_time(machine.deadline)) == [("MISSION_REQUEST_LIST", None)]
    machine.on_message(count(0), 1.0)
    assert machine.end is DownloadEnd.COMPLETE


def test_cancelling_tells_the_autopilot():
    machine = download()
    machine.start(0.0)
    (message,) = machine.cancel(0.1)
    assert message.type == mav.MAV_MISSION_OPERATION_CANCELLED
    assert machine.end is DownloadEnd.CANCELLED
    assert machine.cancel(0.2) == []
