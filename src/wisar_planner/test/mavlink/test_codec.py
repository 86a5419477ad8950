"""Frames to messages and back."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink import codec
from wisar_planner.mavlink.codec import Codec, StreamDecoder, read_key_file
from wisar_planner.mavlink.exchange import Address, item_message, item_of
from wisar_planner.mavlink.mission import MissionItem

KEY = bytes(range(32))
CURRENT = mav.MAVLink_mission_current_message


def seqs(messages):
    return [m.seq for m in messages]


def test_messages_come_out_as_they_went_in():
    sender = Codec(7, 9)
    frames = [sender.encode(CURRENT(n)) for n in range(300)]
    messages, used = Codec(1, 1).decode(b"".join(frames))
    assert seqs(messages) == list(range(300))
    assert used == sum(map(len, frames))
    assert (messages[0].get_srcSystem(), messages[0].get_srcComponent()) == (7, 9)
    assert frames[0][0] == mav.PROTOCOL_MARKER_V2


@given(st.lists(st.binary(max_size=80), max_size=8), st.integers(1, 40))
def test_a_stream_in_pieces_and_with_noise_between_loses_no_frame(noise, piece):
    sender, decoder = Codec(1, 1), StreamDecoder(Codec(2, 2))
    # Markers inside the noise could announce a frame that swallows what follows.
    quiet = [bytes(b for b in n if b not in (0xFD, 0xFE)) for n in noise]
    stream = b"".join(n + sender.encode(CURRENT(k)) for k, n in enumerate(quiet))
    found = []
    for at in range(0, len(stream), piece):
        found += seqs(decoder.decode(stream[at : at + piece]))
    assert found == list(range(len(quiet)))


def test_a_damaged_length_does_not_swallow_the_next_frames():
    sender, receiver = Codec(1, 1), Codec(2, 2)
    first = bytearray(sender.encode(CURRENT(1)))
    first[1] = 0xFF
    rest = b"".join(sender.encode(CURRENT(n)) for n in range(2, 40))
    messages, _ = receiver.decode(bytes(first) + rest)
    assert seqs(messages) == list(range(2, 40))
    assert receiver.counters.corrupt >= 1


@settings(max_examples=300)
@given(st.binary(max_size=400))
def test_no_bytes_raise(data):
    _, used = Codec(1, 1).decode(b"\xfd" + data)
    assert 0 <= used <= len(data) + 1


def test_any_single_damaged_byte_is_noticed():
    frame = Codec(1, 1).encode(mav.MAVLink_mission_count_message(1, 1, 64, 0))
    rng = random.Random(1)
    for at in range(len(frame)):
        damaged = bytearray(frame)
        damaged[at] ^= rng.randint(1, 255)
        messages, _ = Codec(2, 2).decode(bytes(damaged))
        assert messages == []


@given(
    st.integers(0, 65535),
    st.integers(0, 255),
    st.tuples(*[st.floats(width=32, allow_nan=True, allow_infinity=True)] * 4),
    st.integers(-(2**31), 2**31 - 1),
    st.integers(-(2**31), 2**31 - 1),
    st.floats(width=32, allow_nan=False),
    st.booleans(),
)
def test_items_survive_the_wire_exactly(command, frame, params, x, y, z, autocontinue):
    item = MissionItem(command, frame, params, x, y, z, autocontinue)
    frame_bytes = Codec(1, 1).encode(item_message(item, 3, 0, Address(1, 1)))
    ((message,), _) = Codec(2, 2).decode(frame_bytes)
    assert item_of(message) == item


def test_the_older_item_message_is_understood():
    message = mav.MAVLink_mission_item_message(
        1, 1, 0, mav.MAV_FRAME_GLOBAL, 16, 0, 1, 0, 0, 0, 0, 57.5, -4.25, 10.0, 0
    )
    assert item_of(message) == MissionItem(16, 0, x=575_000_000, y=-42_500_000, z=10.0)


# -- signing -----------------------------------------------------------------------------------


def test_signed_messages_are_taken():
    receiver = Codec(2, 2, key=KEY)
    assert seqs(receiver.decode(Codec(1, 1, key=KEY).encode(CURRENT(5)))[0]) == [5]


@pytest.mark.parametrize(
    ("sender", "counter"),
    [(Codec(1, 1), "unsigned"), (Codec(1, 1, key=bytes(32)), "badly_signed")],
)
def test_unsigned_and_badly_signed_messages_are_dropped_and_counted(sender, counter):
    receiver = Codec(2, 2, key=KEY)
    for _ in range(3):
        assert receiver.decode(sender.encode(CURRENT(5)))[0] == []
    assert getattr(receiver.counters, counter) == 3
    assert receiver.counters.received == 0


def test_a_recorded_message_is_not_taken_twice():
    frame = Codec(1, 1, key=KEY).encode(CURRENT(5))
    receiver = Codec(2, 2, key=KEY)
    assert len(receiver.decode(frame)[0]) == 1
    assert receiver.decode(frame)[0] == []
    assert receiver.counters.badly_signed == 1


def test_noise_is_not_taken_for_a_forgery():
    receiver = Codec(2, 2, key=KEY)
    frame = bytearray(Codec(1, 1, key=KEY).encode(CURRENT(5)))
    frame[11] ^= 1
    assert receiver.decode(bytes(frame))[0] == []
    assert receiver.counters.badly_signed == 0
    assert receiver.counters.corrupt >= 1


def test_a_stranger_cannot_shut_out_the_real_sender(monkeypatch):
    receiver, stranger = Codec(2, 2, key=KEY), Codec(1, 1, key=bytes(32))
    monkeypatch.setattr(codec, "_signing_time", lambda: 2**47)  # years ahead
    assert receiver.decode(stranger.encode(CURRENT(4)))[0] == []
    monkeypatch.undo()
    assert seqs(receiver.decode(Codec(1, 1, key=KEY).encode(CURRENT(5)))[0]) == [5]
    assert receiver.counters.badly_signed == 1


def test_version_1_frames_cannot_slip_past_the_signature():
    v1 = mav.MAVLink(None, 1, 1)
    frame = bytes(CURRENT(5).pack(v1, force_mavlink1=True))
    assert len(Codec(2, 2).decode(frame)[0]) == 1
    signed_only = Codec(2, 2, key=KEY)
    assert signed_only.decode(frame)[0] == []
    assert signed_only.counters.unsigned == 1


@pytest.mark.parametrize("content", [KEY, KEY.hex().encode() + b"\n"])
def test_keys_are_read_as_bytes_or_digits(tmp_path, content):
    path = tmp_path / "key"
    path.write_bytes(content)
    path.chmod(0o600)
    assert read_key_file(path) == KEY


def test_a_passphrase_is_hashed(tmp_path):
    path = tmp_path / "key"
    path.write_text("correct horse")
    path.chmod(0o400)
    assert len(read_key_file(path)) == 32


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o666])
def test_a_key_that_others_can_touch_is_refused(tmp_path, mode):
    path = tmp_path / "key"
    path.write_bytes(KEY)
    path.chmod(mode)
    with pytest.raises(InvalidInput, match="chmod 600"):
        read_key_file(path)


def test_a_missing_or_empty_key_is_told(tmp_path):
    with pytest.raises(InvalidInput, match="cannot read"):
        read_key_file(tmp_path / "none")
    path = tmp_path / "empty"
    path.touch(mode=0o600)
    with pytest.raises(InvalidInput, match="empty"):
        read_key_file(path)
    with pytest.raises(InvalidInput, match="32 bytes"):
        Codec(1, 1, key=b"short")
