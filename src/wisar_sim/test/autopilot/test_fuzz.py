"""Hostile input: sound frames with any content, at both ends, and the benchmark's own fuzzing."""

import math
import random
import re
import struct

import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.evaluation import bench_mavlink
from wisar_planner.mavlink.codec import Codec
from wisar_planner.mavlink.dialect import dialect_of
from wisar_planner.mavlink.download import Download
from wisar_planner.mavlink.exchange import Address
from wisar_planner.mavlink.link_estimate import LinkEstimates
from wisar_planner.mavlink.mission import MissionKind, build_mission
from wisar_planner.mavlink.outcome import UploadCode, UploadResult
from wisar_planner.mavlink.session import Session
from wisar_planner.mavlink.transfer import MissionTransfer
from wisar_planner.pdm.geodesy import GeoOrigin
from wisar_sim.autopilot.autopilot import Autopilot
from wisar_sim.autopilot.mission_server import StoredItem
from wisar_sim.autopilot.profile import PROFILES

GROUND, VEHICLE = Address(245, 190), Address(1, 1)
MISSION = build_mission([(57.0, -4.0), (57.001, -4.0)], altitude_m=40.0, speed=5.0)
FLOWN = [StoredItem(i.command, i.frame, i.params, i.x, i.y, i.z) for i in MISSION.items]
_MISSION_TYPES = [m for m in mav.mavlink_map.values() if "MISSION" in m.msgname]
_TYPES = [*mav.mavlink_map.values(), *_MISSION_TYPES * 20]
_CORNERS = (
    mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION,
    mav.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_EXCLUSION,
)
_FENCE_TYPES = ("MISSION_COUNT", "MISSION_ITEM", "MISSION_ITEM_INT")
_NANS = [struct.pack("<f", v) for v in (float("nan"), float("inf"), -float("inf"), 0.0, 1e38)]


def offset(made, field):
    """Where a field lies in the payload."""
    before = made.ordered_fieldnames.index(field)
    fields = re.findall(r"\d*[a-zA-Z]", made.unpacker.format)
    return struct.calcsize("<" + "".join(fields[:before]))


def make_fence_of_one(rng, made, payload):
    """Make a frame one of those that upload a fence of one corner, told to be any number."""
    payload[offset(made, "mission_type")] = mav.MAV_MISSION_TYPE_FENCE
    if made.msgname == "MISSION_COUNT":
        struct.pack_into("<H", payload, offset(made, "count"), 1)
        return
    struct.pack_into("<HH", payload, offset(made, "seq"), 0, rng.choice(_CORNERS))
    payload[offset(made, "frame")] = mav.MAV_FRAME_GLOBAL
    at = offset(made, "param1")
    payload[at : at + 4] = rng.choice(_NANS)


def anything(rng, source, target):
    """A sound frame of any type with any content, from `source` to `target`."""
    made = rng.choice(_TYPES)
    payload = bytearray(rng.randbytes(made.unpacker.size))
    for at in range(0, len(payload) - 3, 4):
        kind = rng.random()
        if kind < 0.4:  # small numbers are those that mean something
            payload[at : at + 4] = struct.pack("<HH", rng.randrange(4), rng.randrange(4))
        elif kind < 0.5:
            payload[at : at + 4] = rng.choice(_NANS)
    for field, value in (("target_system", target.system), ("target_component", target.component)):
        if field in made.fieldnames:
            payload[offset(made, field)] = value
    if "mission_type" in made.fieldnames:
        payload[offset(made, "mission_type")] = rng.choice([0, 0, 0, 1, 2, 77, 255])
    if made.msgname in _FENCE_TYPES and rng.random() < 0.3:
        make_fence_of_one(rng, made, payload)
    ids = bytes([source.system, source.component]) + made.id.to_bytes(3, "little")
    body = bytes([len(payload), 0, 0, 0]) + ids + payload
    checksum = mav.x25crc(bytearray(body + bytes([made.crc_extra]))).crc
    return b"\xfd" + body + checksum.to_bytes(2, "little")


@pytest.mark.parametrize("profile", sorted(PROFILES))
def test_an_autopilot_survives_any_content(profile):
    rng = random.Random(1)
    autopilot = Autopilot(PROFILES[profile], GeoOrigin(57.0, -4.0))
    receiver, down = Codec(1, 1), Codec(1, 1)
    now, understood, judged = 0.0, 0, 0
    for _ in range(20_000):
        now += 0.02
        if not autopilot.vehicle.items:  # the fence is judged with a mission only
            autopilot.vehicle.load(FLOWN)
        frame = anything(rng, GROUND, VEHICLE)
        for heard in receiver.decode(frame)[0]:
            understood += 1
            for answer in autopilot.receive(heard, now):
                down.encode(answer)
        for told in autopilot.tick(now):
            down.encode(told)
        fence = autopilot.missions.lists[mav.MAV_MISSION_TYPE_FENCE]
        judged += any(not math.isfinite(item.params[0]) for item in fence)
    assert understood > 15_000
    assert judged > 0 or PROFILES[profile].checks_values


@pytest.mark.parametrize(
    "make",
    [
        lambda: MissionTransfer(MISSION, Address(1, 1), dialect_of(mav.MAV_AUTOPILOT_PX4)),
        lambda: MissionTransfer(
            MISSION, Address(1, 1), dialect_of(mav.MAV_AUTOPILOT_ARDUPILOTMEGA)
        ),
        lambda: Download(MissionKind.FENCE, Address(1, 1), link=LinkEstimates().asking),
    ],
)
def test_the_bridge_survives_any_content(make):
    rng = random.Random(2)
    session = Session(Address(245, 190), "fuzz")
    receiver, up = Codec(245, 190), Codec(245, 190)
    now, understood, verified = 0.0, 0, 0
    session.begin(make(), now)
    for _ in range(20_000):
        now += 0.02
        frame = anything(rng, VEHICLE, GROUND)
        for heard in receiver.decode(frame)[0]:
            understood += 1
            for answer in session.receive(heard, now):
                up.encode(answer)
        for asked in session.tick(now):
            up.encode(asked)
        exchange = session.exchange
        if exchange.done:
            result = getattr(exchange, "result", None)
            verified += bool(getattr(result, "verified", False))
            session.begin(make(), now)
    assert understood > 15_000
    assert verified == 0  # nobody ever had the mission


def test_hostile_bytes_change_nothing(monkeypatch):
    monkeypatch.setattr(bench_mavlink, "FRAMES", 20_000)
    row = bench_mavlink.ROWS["fuzz_frames"]()
    assert row.ours == 0
    assert row.details["sound_but_foreign"] > 7_000


def test_a_frame_that_changes_something_is_noticed(monkeypatch):
    monkeypatch.setattr(bench_mavlink, "FRAMES", 3_000)
    # To this vehicle instead of to a stranger's.
    clear = Codec(245, 190).encode(mav.MAVLink_mission_clear_all_message(1, 1, 255))
    monkeypatch.setattr(bench_mavlink._Fuzzer, "foreign", lambda _: clear)
    row = bench_mavlink.ROWS["fuzz_frames"]()
    assert row.details["state_changes"] > 0
    assert row.ours > 0


def test_a_crash_is_counted(monkeypatch):
    def fail(*_):
        raise RuntimeError("a fault")

    monkeypatch.setattr(bench_mavlink, "FRAMES", 3_000)
    monkeypatch.setattr(Autopilot, "_is_for_us", fail)
    row = bench_mavlink.ROWS["fuzz_frames"]()
    assert row.details["crashes"] > 0
    assert row.ours > 0


def test_cut_links_mix_no_mission_but_in_place_and_are_told_right(monkeypatch):
    monkeypatch.setattr(bench_mavlink, "CUTS", 30)
    row = bench_mavlink.ROWS["old_mission_intact_after_cut"]()
    assert row.details.get("told_wrong", 0) == 0
    assert row.ours == row.details.get("other_held", 0) == 0
    # Every third autopilot is an ArduPilot, which overwrites its mission in place.
    assert row.details.get("mixed_in_place", 0) <= 10
    assert row.details["old_held"] > 5
    assert row.details["new_held"] > 5


def test_simulated_uploads_are_counted_right():
    good = bench_mavlink._simulated_uploads("px4", 0.1, 3)
    assert (good.uploads, good.verified, good.failed_in_words, good.corrupted) == (3, 3, 0, 0)
    assert (good.left_open, good.changed) == (0, 0)
    bad = bench_mavlink._simulated_uploads("ardupilot", 0.5, 2)
    assert bad.verified + bad.failed_in_words == 2
    assert bad.corrupted == 0


def test_an_upload_that_ends_unverified_or_changed_does_not_count_as_fine():
    held, code = bench_mavlink._Held, UploadCode
    results = [
        (UploadResult(code.VERIFIED, elapsed_s=1.0, old_counts=False), held.NEW),
        (UploadResult(code.VERIFIED, elapsed_s=2.0, old_counts=False), held.OLD),
        (UploadResult(code.INCOMPLETE, "why", elapsed_s=3.0), held.OLD),
        (UploadResult(code.UNVERIFIED, "why", elapsed_s=4.0, old_counts=False), held.NEW),
        (UploadResult(code.DIFFERENT, elapsed_s=9.0, old_counts=False), held.OTHER),
    ]
    counted = bench_mavlink._Outcomes.of(results)
    assert vars(counted) == {
        "uploads": 5,
        "verified": 2,
        "failed_in_words": 2,
        "left_open": 2,
        "changed": 2,
        "corrupted": 2,
        "median_s": 3.0,
        "longest_s": 9.0,
    }
    assert "2 of 5 verified" in counted.words
