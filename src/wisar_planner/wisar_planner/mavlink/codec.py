"""Frames to messages and back: MAVLink 2 with optional signing, robust against any bytes."""

from __future__ import annotations

import hashlib
import hmac
import stat
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput

Message = Any
"""A pymavlink message; the library carries no types."""

_MARKERS = (mav.PROTOCOL_MARKER_V1, mav.PROTOCOL_MARKER_V2)
_CHECKSUM_BYTES = 2
_SIGNATURE_BYTES = 6
# Signing time runs in 10 microseconds since 2015-01-01 (https://mavlink.io/en/guide/message_signing.html).
_SIGNING_EPOCH = 1420070400.0
_SIGNING_TICKS_PER_S = 100_000


@dataclass
class Counters:
    """What became of the bytes received: numbers of frames, or bytes where said so."""

    received: int = 0
    corrupt: int = 0
    unsigned: int = 0
    badly_signed: int = 0
    skipped_bytes: int = 0


def read_key_file(path: Path) -> bytes:
    """Read a signing key that only its owner can read.

    Parameters
    ----------
    path
        A file with 32 bytes, with 64 hexadecimal digits, or with a passphrase, whose SHA-256
        then is the key, as in other ground stations.

    Raises
    ------
    InvalidInput
        If the file is missing or empty, or if others than the owner may read or write it.
    """
    try:
        mode = path.stat().st_mode
        content = path.read_bytes()
    except OSError as error:
        raise InvalidInput(f"key_file: cannot read {path}: {error.strerror}") from None
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise InvalidInput(f"key_file: others may read {path}; run: chmod 600 {path}")
    if len(content) == 32:
        return content
    text = content.strip()
    if not text:
        raise InvalidInput(f"key_file: {path} is empty")
    if len(text) == 64:
        try:
            return bytes.fromhex(text.decode("ascii"))
        except ValueError:
            pass
    return hashlib.sha256(text).digest()


class Codec:
    """One end of a MAVLink connection, without the connection.

    Parameters
    ----------
    system, component
        Ids under which messages are sent.
    key
        Signing key of 32 bytes. With a key, every message sent is signed, and a message that is
        unsigned, badly signed or replayed is dropped and counted.
    link_id
        Number of this link in the signatures, 0 to 255.
    """

    def __init__(
        self, system: int, component: int, *, key: bytes | None = None, link_id: int = 0
    ) -> None:
        self.counters = Counters()
        self._mav = mav.MAVLink(None, srcSystem=system, srcComponent=component)
        self._key = key
        if key is not None:
            if len(key) != 32:
                raise InvalidInput(f"key must be 32 bytes, got {len(key)}")
            signing = self._mav.signing
            signing.secret_key = key
            signing.link_id = link_id
            signing.sign_outgoing = True
            signing.timestamp = _signing_time()

    def encode(self, message: Message) -> bytes:
        """Pack a message into a MAVLink 2 frame, with the next sequence number."""
        if self._key is not None:
            # Signatures carry the time of day, so that a recording is old after a restart too.
            signing = self._mav.signing
            signing.timestamp = max(signing.timestamp, _signing_time())
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def decode(self, data: bytes | bytearray) -> tuple[list[Message], int]:
        """Take the messages out of some bytes.

        Bytes that are no valid frame are skipped one by one, so that a damaged length does not
        swallow the good frames after it.

        Parameters
        ----------
        data
            A datagram, or the bytes of a stream that are not used up yet.

        Returns
        -------
        tuple
            The messages, and how many bytes were used; the rest may be the beginning of a frame.
        """
        messages: list[Message] = []
        data = bytearray(data)
        at, end = 0, len(data)
        while at < end:
            if data[at] not in _MARKERS:
                at += 1
                self.counters.skipped_bytes += 1
                continue
            size = _frame_size(data, at)
            if size is None or at + size > end:
                break
            message = self._decode_frame(data[at : at + size])
            if message is None:
                at += 1
                self.counters.skipped_bytes += 1
                continue
            at += size
            if message.get_type().startswith("UNKNOWN"):
                continue
            self.counters.received += 1
            messages.append(message)
        return messages, at

    def _decode_frame(self, frame: bytearray) -> Message | None:
        try:
            message = self._mav.decode(frame) if self._may_be_authentic(frame) else None
        # Besides MAVError, a frame whose checksum is right by chance can fail in many ways
        # inside the generated code; whatever it is, the frame is not a message.
        except Exception as error:
            message = None
            if str(error) != "Invalid signature":
                self.counters.corrupt += 1
            elif _is_signed(frame):
                self.counters.badly_signed += 1  # a replay: its time is not later than the last
            else:
                self.counters.unsigned += 1
        return message

    def _may_be_authentic(self, frame: bytearray) -> bool:
        """Check a signature before pymavlink does.

        pymavlink notes a frame's time before it looks at the signature, so that a stranger could
        shut out the real sender with one frame from the future.
        """
        if self._key is None or not _is_signed(frame):
            return True
        digest = hashlib.sha256(self._key + frame[:-_SIGNATURE_BYTES]).digest()
        if hmac.compare_digest(digest[:_SIGNATURE_BYTES], frame[-_SIGNATURE_BYTES:]):
            return True
        if _has_right_checksum(frame):
            self.counters.badly_signed += 1
        else:
            self.counters.corrupt += 1
        return False


def _has_right_checksum(frame: bytearray) -> bool:
    """Whether a signed frame arrived as it was sent."""
    kind = mav.mavlink_map.get(int.from_bytes(frame[7:10], "little"))
    end = len(frame) - mav.MAVLINK_SIGNATURE_BLOCK_LEN
    body, checksum = frame[1 : end - _CHECKSUM_BYTES], frame[end - _CHECKSUM_BYTES : end]
    if kind is None:
        return False
    expected = mav.x25crc(body + bytes([kind.crc_extra])).crc
    return bool(expected == int.from_bytes(checksum, "little"))


def _signing_time() -> int:
    return int((time.time() - _SIGNING_EPOCH) * _SIGNING_TICKS_PER_S)


def _is_signed(frame: bytearray) -> bool:
    return frame[0] == mav.PROTOCOL_MARKER_V2 and bool(frame[2] & mav.MAVLINK_IFLAG_SIGNED)


class StreamDecoder:
    """Decoder for a byte stream (TCP, serial), where frames arrive in pieces."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._rest = bytearray()

    def decode(self, data: bytes) -> list[Message]:
        """Take the messages out of the next bytes of the stream."""
        self._rest += data
        messages, used = self._codec.decode(self._rest)
        del self._rest[:used]
        return messages


def _frame_size(data: bytearray, at: int) -> int | None:
    """Length of the frame that begins at `at`, or None if its header is not complete."""
    if len(data) - at < 3:
        return None
    if data[at] == mav.PROTOCOL_MARKER_V1:
        return int(mav.HEADER_LEN_V1) + data[at + 1] + _CHECKSUM_BYTES
    size = int(mav.HEADER_LEN_V2) + data[at + 1] + _CHECKSUM_BYTES
    if data[at + 2] & mav.MAVLINK_IFLAG_SIGNED:
        size += int(mav.MAVLINK_SIGNATURE_BLOCK_LEN)
    return size
