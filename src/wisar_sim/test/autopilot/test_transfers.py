"""Uploads over bad links at simulated time: whole or not at all, and the operator knows which."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.dialect import dialect_of
from wisar_planner.mavlink.exchange import Address
from wisar_planner.mavlink.mission import Mission, MissionKind, build_mission
from wisar_planner.mavlink.outcome import UploadCode
from wisar_planner.mavlink.transfer import MissionTransfer, lists_of
from wisar_sim.autopilot.bad_link import BadLink, LinkFaults
from wisar_sim.autopilot.conversation import Conversation
from wisar_sim.autopilot.mission_server import MissionServer, StoredItem
from wisar_sim.autopilot.profile import PROFILES

HOME = StoredItem(16, 0, (0.0,) * 4, 570_000_000, -40_000_000, 100.0)
SQUARE = [(56.9, -4.1), (57.1, -4.1), (57.1, -3.9), (56.9, -3.9)]
ALL = pytest.mark.parametrize("profile", sorted(PROFILES))
CLEAN = LinkFaults(delay_s=0.03)


def plan(count, north=57.0):
    return np.column_stack((north + 1e-4 * np.arange(count), np.full(count, -4.0)))


def mission(count=20, **changes):
    return build_mission(plan(count), **{"altitude_m": 40.0, "speed": 5.0, **changes})


class Setup:
    def __init__(self, profile, faults=CLEAN, seed=0, booted=True, answers=None):
        self.profile = PROFILES[profile]
        self.server = MissionServer(self.profile, lambda: HOME)
        self.talk = Conversation(
            self.server, BadLink(faults, 2 * seed), BadLink(answers or faults, 2 * seed + 1)
        )
        self.talk.now = 20.0 if booted else 0.0
        self.progress = []

    def transfer(self, wanted, **options):
        return MissionTransfer(
            wanted,
            Address(1, 1),
            dialect_of(self.profile.autopilot),
            on_progress=self.progress.append,
            **options,
        )

    def upload(self, wanted, **options):
        transfer = self.transfer(wanted, **options)
        self.talk.run(transfer)
        return transfer.result

    def holds(self, wanted):
        """Whether the autopilot holds exactly this, place by place, in all lists."""
        for kind in MissionKind:
            mine, stored = wanted.of_kind(kind), self.server.lists[int(kind)]
            if [(i.command, i.x, i.y, i.z) for i in mine] != [
                (i.command, i.x, i.y, i.z) for i in stored
            ]:
                return False
        return True


@ALL
def test_fence_rally_points_and_mission_arrive(profile):
    setup = Setup(profile)
    wanted = mission(inclusions=[SQUARE], exclusions=[SQUARE[:3]], rally=[(57.0, -4.0)])
    result = setup.upload(wanted)
    assert result.verified
    assert result.error == ""
    assert setup.holds(wanted)
    assert result.items_sent == result.items_total == len(wanted.items) + 7 + 1
    sent = [p.items_sent for p in setup.progress]
    assert sent == sorted(sent)
    assert setup.progress[-1].items_verified == result.items_total


@ALL
def test_old_fences_and_rally_points_stay_unless_their_deletion_is_asked_for(profile):
    setup = Setup(profile)
    assert setup.upload(mission(inclusions=[SQUARE], rally=[(57.0, -4.0)])).verified
    result = setup.upload(mission(5))
    assert result.verified
    assert result.notes == ()
    assert [len(setup.server.lists[k]) for k in MissionKind] == [5 + 3, 4, 1]
    wanted = mission(rally=[(57.0, -4.0), (57.0, -4.1)])
    result = setup.upload(wanted, kinds=lists_of(wanted, clear_old=True))
    assert result.verified
    assert result.notes == ("deleted on the vehicle: fence",)
    assert setup.holds(wanted)
    gone = setup.upload(mission(), kinds=lists_of(mission(), clear_old=True))
    assert gone.notes == ("deleted on the vehicle: fence and rally points",)
    assert setup.holds(mission())


@ALL
def test_lists_that_are_not_named_stay(profile):
    setup = Setup(profile)
    setup.upload(mission(inclusions=[SQUARE]))
    result = setup.upload(mission(5), kinds=[MissionKind.MISSION])
    assert result.verified
    assert len(setup.server.lists[1]) == 4


def test_ardupilot_just_started_is_waited_for():
    setup = Setup("ardupilot", booted=False)
    result = setup.upload(mission())
    assert result.verified
    assert 6.0 < result.elapsed_s < 20.0


@ALL
def test_5000_items(profile):
    setup = Setup(profile, LinkFaults(delay_s=0.005, loss=0.001))
    wanted = mission(4_997)
    assert len(wanted.items) == 5_000
    assert setup.upload(wanted, kinds=[MissionKind.MISSION]).verified
    assert setup.holds(wanted)


def with_item(**changes):
    from dataclasses import replace

    whole = mission()
    return replace(
        whole, items=(*whole.items[:5], replace(whole.items[5], **changes), *whole.items[6:])
    )


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
@pytest.mark.parametrize(
    ("changes", "words"), [({"command": 31_999}, "UNSUPPORTED"), ({"frame": 99}, "altitude frame")]
)
def test_refusals_are_told_in_words_and_change_nothing(profile, changes, words):
    setup = Setup(profile)
    old = mission(3)
    setup.upload(old)
    result = setup.upload(with_item(**changes))
    assert result.code is UploadCode.REFUSED
    assert words in result.error
    assert setup.holds(old)
    assert result.elapsed_s < 10.0


def test_too_many_items_are_refused_in_words_after_some_patience():
    setup = Setup("px4")
    result = setup.upload(mission(10_500), kinds=[MissionKind.MISSION])
    assert result.code is UploadCode.REFUSED
    assert "does not fit" in result.error


@ALL
def test_a_dead_link_ends_in_words_within_a_minute(profile):
    result = Setup(profile, LinkFaults(loss=1.0)).upload(mission())
    assert result.code is UploadCode.NO_LINK
    assert "does not answer" in result.error
    assert result.elapsed_s < 60.0


@ALL
def test_a_link_that_only_carries_one_way_ends_in_words(profile):
    setup = Setup(profile, faults=CLEAN, answers=LinkFaults(loss=1.0))
    result = setup.upload(mission())
    assert result.code is UploadCode.NO_LINK
    assert result.elapsed_s < 60.0


AS_A_WHOLE = pytest.mark.parametrize("profile", ["mavsdk", "px4"])


@AS_A_WHOLE
def test_the_old_mission_counts_when_the_link_is_cut(profile):
    old, new = mission(7), mission(20, altitude_m=77.0)
    for cut in np.linspace(0.05, 2.5, 25):
        setup = Setup(profile, LinkFaults(delay_s=0.02, jitter_s=0.01), seed=int(cut * 1e3))
        setup.upload(old)
        transfer = setup.transfer(new)
        finished = setup.talk.run(transfer, until=setup.talk.now + cut)
        setup.talk.settle(60.0)
        assert setup.holds(old) or setup.holds(new)
        if finished:
            assert setup.holds(new)


def test_a_mixture_after_a_cut_link_is_told():
    """ArduPilot overwrites its mission in place, mostly without a return to launch at its end."""
    old, new = mission(7), mission(20, altitude_m=77.0)
    mixed = 0
    for cut in np.linspace(0.05, 3.5, 25):
        setup = Setup("ardupilot", LinkFaults(delay_s=0.02, jitter_s=0.01), seed=int(cut * 1e3))
        setup.upload(old)
        transfer = setup.transfer(new)
        if setup.talk.run(transfer, until=setup.talk.now + cut):
            continue
        setup.talk.cut()
        setup.talk.go_on(transfer)
        setup.talk.settle(60.0)
        assert not transfer.result.verified
        assert setup.holds(old) or not transfer.result.old_counts
        told = "mixture of the old and the new mission: do not fly it; upload again"
        assert (told in transfer.result.error) is not transfer.result.old_counts
        mixed += not (setup.holds(old) or setup.holds(new))
    assert mixed > 5


@pytest.mark.parametrize("loss", [0.0, 0.2])
@pytest.mark.parametrize("old_length", [0, 40])
def test_an_ardupilot_gets_its_old_mission_back(old_length, loss):
    old = mission(old_length, altitude_m=60.0) if old_length else Mission()
    for seed, after in enumerate((0.2, 0.9, 2.0, 3.5, 6.0)):
        setup = Setup("ardupilot", LinkFaults(loss=loss, delay_s=0.03), seed)
        assert setup.upload(old, kinds=[MissionKind.MISSION]).verified
        transfer = setup.transfer(mission(60))
        if setup.talk.run(transfer, until=setup.talk.now + after):
            continue
        setup.talk._send_up(transfer.cancel(setup.talk.now))
        while not setup.talk.go_on(transfer, until=setup.talk.now + 0.1):
            setup.talk._send_up(transfer.cancel(setup.talk.now))  # as the client does
        assert transfer.result.code is UploadCode.CANCELLED
        assert transfer.result.old_counts
        setup.talk.settle(30.0)
        assert setup.holds(old)
        begun = transfer._restoring is not None
        assert ("The old mission was put back" in transfer.result.error) is begun


def test_a_mixture_that_is_put_back_is_called_one():
    """After an upload that was cut another one is cancelled in the middle."""
    put_back = 0
    for after in (2.0, 4.0, 8.0):
        setup = Setup("ardupilot", LinkFaults(delay_s=0.05))
        setup.upload(mission(40, altitude_m=60.0))
        setup.talk.run(setup.transfer(mission(20)), until=setup.talk.now + 3.0)
        setup.talk.settle(30.0)
        transfer = setup.transfer(mission(60), old_is_mixture=True)
        setup.talk.run(transfer, until=setup.talk.now + after)
        setup.talk._send_up(transfer.cancel(setup.talk.now))
        setup.talk.go_on(transfer)
        if transfer._restoring is not None:
            put_back += 1
            assert transfer.result.old_counts
            assert "may hold a mixture" in transfer.result.error
    assert put_back


@pytest.mark.parametrize("cancelled", [False, True])
def test_an_ardupilot_that_still_waits_for_an_earlier_upload_is_waited_for(cancelled):
    setup = Setup("ardupilot")
    old = mission(7)
    setup.upload(old)
    abandoned = setup.transfer(mission(20))
    setup.talk.run(abandoned, until=setup.talk.now + 1.5)
    mixture = setup.server.lists[0]
    transfer = setup.transfer(mission(5))
    if cancelled:
        assert not setup.talk.run(transfer, until=setup.talk.now + 3.0)
        setup.talk._send_up(transfer.cancel(setup.talk.now))
        assert transfer.result.code is UploadCode.CANCELLED
        assert setup.server.lists[0] == mixture
    else:
        setup.talk.run(transfer)
        assert transfer.result.verified


def test_nothing_is_sent_to_an_ardupilot_whose_mission_cannot_be_read():
    setup = Setup("ardupilot")
    old = mission(7)
    setup.upload(old)
    original = setup.server.handle

    def unreadable(message, client, now):
        if message.get_type().startswith("MISSION_REQUEST"):
            kind = mav.MAV_MISSION_UNSUPPORTED
            return [mav.MAVLink_mission_ack_message(245, 190, kind, 0)]
        return original(message, client, now)

    setup.server.handle = unreadable
    result = setup.upload(mission())
    assert result.code is UploadCode.REFUSED
    assert result.old_counts
    assert setup.holds(old)


@ALL
@pytest.mark.parametrize("after", [0.0, 0.3, 0.7, 1.1])
def test_cancelling_keeps_the_old_mission(profile, after):
    setup = Setup(profile)
    old = mission(7)
    setup.upload(old)
    transfer = setup.transfer(mission(60))
    assert not setup.talk.run(transfer, until=setup.talk.now + after)
    setup.talk._send_up(transfer.cancel(setup.talk.now))
    assert transfer.done or profile == "ardupilot"  # whose mission has to be put back
    setup.talk.go_on(transfer)
    assert transfer.result.code is UploadCode.CANCELLED
    setup.talk.settle(30.0)
    assert setup.holds(old)
    assert setup.upload(mission(8)).verified  # and nothing is left behind


@ALL
def test_an_upload_tells_whether_the_fence_may_be_another_now(profile):
    """Cut at any time: where it says no, the fence is the old one."""
    fenced = mission(30, inclusions=[SQUARE])
    told = set()
    for after in np.linspace(0.0, 3.0, 13):
        setup = Setup(profile)
        old = mission(7, inclusions=[SQUARE[:3]])
        assert setup.upload(old).fence_touched
        transfer = setup.transfer(fenced)
        if not setup.talk.run(transfer, until=setup.talk.now + after):
            transfer.abandon(setup.talk.now)
        before = [(i.x, i.y) for i in old.fence]
        is_old = [(i.x, i.y) for i in setup.server.lists[int(MissionKind.FENCE)]] == before
        assert is_old or transfer.result.fence_touched
        told.add(transfer.result.fence_touched)
    assert told == {False, True}
    assert not setup.upload(mission(5)).fence_touched


@ALL
def test_who_cancels_is_told_whether_the_old_mission_still_counts(profile):
    faults = LinkFaults(loss=0.2, delay_s=0.03, jitter_s=0.03)
    old, new = mission(7), mission(20, altitude_m=77.0)
    told = set()
    for seed, after in enumerate(np.linspace(0.0, 25.0, 60)):
        setup = Setup(profile, faults, seed)
        setup.upload(old)
        transfer = setup.transfer(new, kinds=[MissionKind.MISSION])
        if setup.talk.run(transfer, until=setup.talk.now + after):
            continue
        setup.talk._send_up(transfer.cancel(setup.talk.now))
        setup.talk.go_on(transfer)
        setup.talk.settle(30.0)
        told.add(transfer.result.old_counts)
        assert setup.holds(old) or not transfer.result.old_counts
        words = ("old list counts", "old mission was put back")
        assert any(w in transfer.result.error for w in words) is transfer.result.old_counts
    # What is put back is proved as well, on this link.
    assert told == ({True} if profile == "ardupilot" else {True, False})


@ALL
def test_a_lost_last_acknowledgement_is_resolved_by_reading_back(profile):
    setup = Setup(profile)
    original = setup.server.handle

    def without_acceptance(message, client, now):
        answers = original(message, client, now)
        return [m for m in answers if m.get_type() != "MISSION_ACK"]

    setup.server.handle = without_acceptance
    wanted = mission()
    assert setup.upload(wanted, kinds=[MissionKind.MISSION]).verified
    assert setup.holds(wanted)


@ALL
def test_a_long_silence_at_the_read_back_is_not_the_last_word(profile):
    setup = Setup(profile)
    original = setup.server.handle
    sent, silent_until = False, None

    def silent_for_a_while(message, client, now):
        nonlocal sent, silent_until
        sent |= message.get_type() == "MISSION_COUNT"  # before, ArduPilot's old one is read
        if sent and silent_until is None and message.get_type() == "MISSION_REQUEST_LIST":
            silent_until = now + 60.0
        if silent_until is not None and now < silent_until:
            return []
        return original(message, client, now)

    setup.server.handle = silent_for_a_while
    assert setup.upload(mission(), kinds=[MissionKind.MISSION]).verified


@ALL
def test_an_acknowledgement_proves_nothing(profile):
    setup = Setup(profile)
    original = setup.server._replace

    def forgetful(kind, items, client):
        return original(kind, items[:-1], client)

    setup.server._replace = forgetful
    result = setup.upload(mission(20), kinds=[MissionKind.MISSION])
    assert result.code is UploadCode.DIFFERENT
    assert "23 items were sent, 22 read back" in result.error
    # Where it was overwritten, the old one is put back: here, none.
    end = "The old mission was put back" if profile == "ardupilot" else "Do not fly"
    assert end in result.error


def test_an_autopilot_without_fences_can_still_take_missions():
    setup = Setup("px4")
    original = setup.server.handle

    def no_fence(message, client, now):
        if getattr(message, "mission_type", 0) == 1:
            kind = mav.MAV_MISSION_UNSUPPORTED
            return [mav.MAVLink_mission_ack_message(245, 190, kind, 1)]
        return original(message, client, now)

    setup.server.handle = no_fence
    assert setup.upload(mission()).verified
    refused = setup.upload(mission(inclusions=[SQUARE]))
    assert refused.code is UploadCode.REFUSED
    assert refused.error.startswith("fence")


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    profile=st.sampled_from(sorted(PROFILES)),
    seed=st.integers(0, 10_000),
    count=st.integers(1, 30),
    up=st.tuples(*[st.floats(0.0, 0.6)] + [st.floats(0.0, 0.3)] * 3, st.floats(0.0, 0.8)),
    down=st.tuples(*[st.floats(0.0, 0.6)] + [st.floats(0.0, 0.3)] * 3, st.floats(0.0, 0.8)),
)
def test_on_any_link_an_upload_ends_verified_or_with_words(profile, seed, count, up, down):
    def faults(loss, duplication, reordering, corruption, delay):
        return LinkFaults(loss, duplication, reordering, corruption, delay, jitter_s=0.3 * delay)

    setup = Setup(profile, faults(*up), seed, answers=faults(*down))
    old = mission(2)
    setup.server.lists[0] = tuple(
        StoredItem(i.command, i.frame, i.params, i.x, i.y, i.z) for i in old.items
    )
    new = mission(count, altitude_m=55.0)
    result = setup.upload(new, kinds=[MissionKind.MISSION])
    setup.talk.settle(30.0)
    if result.verified:
        assert setup.holds(new)
    else:
        assert len(result.error) > 20
        mixed = profile == "ardupilot" and "do not fly it" in result.error
        assert setup.holds(old) or ((mixed or setup.holds(new)) and not result.old_counts)
    assert result.elapsed_s < 1_800.0


@pytest.mark.parametrize("loss", [0.1, 0.3, 0.5])
def test_px4_gets_its_mission_over_very_bad_links(loss):
    faults = LinkFaults(
        loss=loss, duplication=0.1, reordering=0.1, corruption=0.01, delay_s=0.02, jitter_s=0.02
    )
    for seed in range(8):
        setup = Setup("px4", faults, seed)
        assert setup.upload(mission(61), kinds=[MissionKind.MISSION]).verified


@pytest.mark.parametrize("loss", [0.1, 0.3, 0.5])
def test_ardupilot_gets_its_mission_over_very_bad_links_that_repeat(loss):
    faults = LinkFaults(
        loss=loss, duplication=0.1, reordering=0.1, corruption=0.01, delay_s=0.02, jitter_s=0.02
    )
    for seed in range(4):
        setup = Setup("ardupilot", faults, seed)
        assert setup.upload(mission(61), kinds=[MissionKind.MISSION]).verified


@pytest.mark.parametrize("loss", [0.0, 0.1, 0.2])
def test_an_autopilot_that_ends_the_upload_at_a_repeated_item_is_served_too(loss):
    for seed in range(4):
        setup = Setup("ardupilot", LinkFaults(loss=loss, delay_s=0.03, jitter_s=0.03), seed)
        setup.server.profile = replace(setup.profile, wrong_sequence_aborts=True)
        assert setup.upload(mission(61), kinds=[MissionKind.MISSION]).verified


def test_an_empty_mission_clears():
    setup = Setup("px4")
    setup.upload(mission())
    assert setup.upload(Mission()).verified
    assert setup.holds(Mission())


def test_an_empty_list_that_is_overwritten_in_place_is_emptied_again_at_once():
    """While it receives, ArduPilot refuses to clear; it takes the announcement of none."""
    setup = Setup("ardupilot")
    transfer = setup.transfer(mission(40))
    setup.talk.run(transfer, until=setup.talk.now + 1.0)
    assert len(setup.server.lists[0]) > 0
    began = setup.talk.now
    setup.talk._send_up(transfer.cancel(setup.talk.now))
    setup.talk.go_on(transfer)
    assert setup.server.lists[0] == ()
    assert setup.talk.now - began < 3.0
