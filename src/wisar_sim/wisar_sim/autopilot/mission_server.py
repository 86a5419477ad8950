"""The autopilot's side of the mission protocol, without socket and clock."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from pymavlink.dialects.v20 import common as mav

from wisar_sim.autopilot.profile import KNOWN_COMMANDS, Profile, Requests

Message = Any
"""A pymavlink message; the library carries no types."""

KINDS = (
    mav.MAV_MISSION_TYPE_MISSION,
    mav.MAV_MISSION_TYPE_FENCE,
    mav.MAV_MISSION_TYPE_RALLY,
)

# Messages that show whether a client speaks the integer variant of the protocol.
_SPEECH = {
    "MISSION_ITEM_INT": True,
    "MISSION_REQUEST_INT": True,
    "MISSION_ITEM": False,
    "MISSION_REQUEST": False,
}

_MOST_INT32 = 2**31
_MOST_UNITS = (900_000_000, 1_800_000_000)


@dataclass(frozen=True)
class StoredItem:
    """One item as the autopilot keeps it; `x` and `y` in 1e-7 degrees for global frames."""

    command: int
    frame: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    autocontinue: int = 1


@dataclass(frozen=True)
class Client:
    """Who is at the other end."""

    system: int
    component: int


@dataclass
class _Receiving:
    """An upload in progress."""

    client: Client
    kind: int
    count: int
    heard: float
    asked: float
    items: list[StoredItem] = field(default_factory=list)


@dataclass
class _Sending:
    """A download in progress."""

    client: Client
    kind: int
    heard: float
    next_seq: int = 0


def _item_of(message: Message) -> StoredItem | None:
    """Take an item out of a message; None if a number in it is not one."""
    x, y = message.x, message.y
    if message.get_type() == "MISSION_ITEM":
        scale = 1.0 if message.frame == mav.MAV_FRAME_MISSION else 1e7
        if not (abs(x) * scale < _MOST_INT32 and abs(y) * scale < _MOST_INT32):
            return None
        x, y = round(x * scale), round(y * scale)
    return StoredItem(
        command=message.command,
        frame=message.frame,
        params=(message.param1, message.param2, message.param3, message.param4),
        x=x,
        y=y,
        z=message.z,
        autocontinue=message.autocontinue,
    )


class MissionServer:
    """Keeps the three lists and lets clients replace and read them.

    A list is replaced as a whole when the last of its new items is in; until then the old one
    stays, whatever happens on the link. Profiles that replace the mission in place overwrite it
    item by item instead.

    Parameters
    ----------
    profile
        Whose behaviour to show.
    home
        Returns the home item (used by profiles that keep home as item 0).
    on_changed
        Called with the kind of a list that was replaced or cleared.
    """

    def __init__(
        self,
        profile: Profile,
        home: Callable[[], StoredItem],
        on_changed: Callable[[int], None] = lambda _: None,
    ) -> None:
        self.profile = profile
        self.lists: dict[int, tuple[StoredItem, ...]] = dict.fromkeys(KINDS, ())
        self._home = home
        self._on_changed = on_changed
        self._receiving: _Receiving | None = None
        self._sending: _Sending | None = None
        self._speaks_int = profile.requests is Requests.INT
        self._last_accepted: tuple[Client, int, int] | None = None
        self._booted_at: float | None = None

    @property
    def flight_items(self) -> tuple[StoredItem, ...]:
        """The mission as it is flown, in its own numbering."""
        return self.lists[mav.MAV_MISSION_TYPE_MISSION]

    @property
    def deadline(self) -> float:
        """When `tick` has something to do next."""
        times = [math.inf]
        if self._sending is not None:
            times.append(self._sending.heard + self.profile.gives_up_after_s)
        if self._receiving is not None:
            times.append(self._receiving.heard + self.profile.gives_up_after_s)
            times.append(self._receiving.asked + self.profile.retry_after_s)
        return min(times)

    def handle(self, message: Message, client: Client, now: float) -> list[Message]:
        """Answer a message of the mission protocol; others are ignored."""
        if self._booted_at is None:
            self._booted_at = now
        name = message.get_type()
        if self.profile.requests is Requests.ADAPTIVE and name in _SPEECH:
            self._speaks_int = _SPEECH[name]
        if name in ("MISSION_ITEM_INT", "MISSION_ITEM"):
            return self._on_item(message, client, now)
        if name == "MISSION_COUNT":
            return self._on_count(message, client, now)
        if name == "MISSION_REQUEST_LIST":
            return self._on_request_list(message.mission_type, client, now)
        if name in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            return self._on_request(message, client, now)
        if name == "MISSION_CLEAR_ALL":
            return self._on_clear(message.mission_type, client)
        if name == "MISSION_ACK":
            return self._on_ack(message, client, now)
        return []

    def tick(self, now: float) -> list[Message]:
        """Ask again, or give a silent client up."""
        if self._booted_at is None:
            self._booted_at = now
        sending, receiving = self._sending, self._receiving
        if sending is not None and now >= sending.heard + self.profile.gives_up_after_s:
            self._sending = None
        if receiving is None:
            return []
        if now >= receiving.heard + self.profile.gives_up_after_s:
            self._receiving = None
            if self.profile.says_giving_up:
                return [_ack(mav.MAV_MISSION_OPERATION_CANCELLED, receiving.kind, receiving.client)]
            return []
        if now >= receiving.asked + self.profile.retry_after_s:
            return [self._request(receiving, now)]
        return []

    # -- receiving -----------------------------------------------------------------------------

    def _on_count(self, message: Message, client: Client, now: float) -> list[Message]:
        kind, count = message.mission_type, message.count
        if kind not in self.lists:
            return [_ack(mav.MAV_MISSION_UNSUPPORTED, kind, client)]
        receiving = self._receiving
        if receiving is not None:
            if receiving.client != client:
                return [_ack(mav.MAV_MISSION_DENIED, kind, client)]
            if self.profile.busy_when_transferring and receiving.items:
                receiving.heard = now
                return [_ack(mav.MAV_MISSION_ERROR, kind, client)]
        if self._sending is not None and self.profile.busy_when_transferring:
            return [_ack(mav.MAV_MISSION_ERROR, kind, client)]
        assert self._booted_at is not None
        if count > self.profile.capacity or now - self._booted_at < self.profile.boot_s:
            return [_ack(mav.MAV_MISSION_NO_SPACE, kind, client)]
        if count == 0:
            self._receiving = None
            return self._replace(kind, (), client)
        self._receiving = _Receiving(client, kind, count, heard=now, asked=now)
        if self._in_place(kind):
            self._store(kind, self.lists[kind][: max(self._numbered(count), 0)])
        return [self._request(self._receiving, now)]

    def _request(self, receiving: _Receiving, now: float) -> Message:
        receiving.asked = now
        seq = len(receiving.items)
        make = (
            mav.MAVLink_mission_request_int_message
            if self._speaks_int
            else mav.MAVLink_mission_request_message
        )
        return make(receiving.client.system, receiving.client.component, seq, receiving.kind)

    def _on_item(self, message: Message, client: Client, now: float) -> list[Message]:
        kind, seq = message.mission_type, message.seq
        receiving = self._receiving
        if receiving is None or receiving.client != client:
            if not self.profile.repeats_acknowledgement:
                said = self.profile.says_wrong_sequence
                return [_ack(mav.MAV_MISSION_ERROR, kind, client)] if said else []
            known = self._last_accepted == (client, kind, seq)
            result = mav.MAV_MISSION_ACCEPTED if known else mav.MAV_MISSION_ERROR
            return [_ack(result, kind, client)]
        if kind != receiving.kind:
            return [_ack(mav.MAV_MISSION_ERROR, kind, client)]
        if seq != len(receiving.items):
            if not self.profile.says_wrong_sequence:
                receiving.heard = now
                return []
            if self.profile.wrong_sequence_aborts:
                self._receiving = None
            return [_ack(mav.MAV_MISSION_INVALID_SEQUENCE, kind, client)]
        receiving.heard = now
        item = _item_of(message)
        result = mav.MAV_MISSION_INVALID if item is None else self._check(kind, item)
        if item is None or result != mav.MAV_MISSION_ACCEPTED:
            self._receiving = None
            return [_ack(result, kind, client)]
        receiving.items.append(self._normalised(kind, item))
        at = self._numbered(seq)
        if self._in_place(kind) and at >= 0:
            old = self.lists[kind]
            self._store(kind, (*old[:at], receiving.items[-1], *old[at + 1 :]))
        if len(receiving.items) < receiving.count:
            return [self._request(receiving, now)]
        self._receiving = None
        self._last_accepted = (client, kind, seq)
        items = tuple(receiving.items)
        if self.profile.home_item and kind == mav.MAV_MISSION_TYPE_MISSION:
            items = items[1:]
        return self._replace(kind, items, client)

    def _check(self, kind: int, item: StoredItem) -> int:
        profile = self.profile
        if profile.checks_commands:
            if item.command not in KNOWN_COMMANDS[kind]:
                return int(mav.MAV_MISSION_UNSUPPORTED)
            if item.frame not in profile.frames:
                return int(mav.MAV_MISSION_UNSUPPORTED_FRAME)
        if profile.checks_values:
            for number, value in enumerate(item.params):
                heading = number == 3
                if math.isinf(value) or (math.isnan(value) and not heading):
                    return int(mav.MAV_MISSION_INVALID_PARAM1) + number
            if item.frame != mav.MAV_FRAME_MISSION:
                if abs(item.x) > _MOST_UNITS[0]:
                    return int(mav.MAV_MISSION_INVALID_PARAM5_X)
                if abs(item.y) > _MOST_UNITS[1]:
                    return int(mav.MAV_MISSION_INVALID_PARAM6_Y)
            if not math.isfinite(item.z):
                return int(mav.MAV_MISSION_INVALID_PARAM7)
        return int(mav.MAV_MISSION_ACCEPTED)

    def _normalised(self, kind: int, item: StoredItem) -> StoredItem:
        if self.profile.plain_places and kind != mav.MAV_MISSION_TYPE_MISSION:
            return replace(item, params=(item.params[0], 0.0, 0.0, 0.0), autocontinue=0)
        if not self.profile.home_item:
            return item
        # ArduPilot keeps altitudes in centimetres and no headings of waypoints.
        first, second, third, fourth = item.params
        heading = 0.0 if math.isnan(fourth) else fourth
        return replace(
            item, params=(first, second, third, heading), z=round(item.z, 2), autocontinue=1
        )

    def _in_place(self, kind: int) -> bool:
        return self.profile.replaces_in_place and kind == mav.MAV_MISSION_TYPE_MISSION

    def _numbered(self, seq: int) -> int:
        """Return a number on the wire in the mission's own numbering, without home."""
        return seq - 1 if self.profile.home_item else seq

    def _store(self, kind: int, items: tuple[StoredItem, ...]) -> None:
        self.lists[kind] = items
        self._on_changed(kind)

    def _replace(self, kind: int, items: tuple[StoredItem, ...], client: Client) -> list[Message]:
        self._store(kind, items)
        return [_ack(mav.MAV_MISSION_ACCEPTED, kind, client)]

    def _on_clear(self, kind: int, client: Client) -> list[Message]:
        if kind != mav.MAV_MISSION_TYPE_ALL and kind not in self.lists:
            return [_ack(mav.MAV_MISSION_UNSUPPORTED, kind, client)]
        if self._receiving is not None:
            return [_ack(mav.MAV_MISSION_DENIED, kind, client)]
        for one in KINDS if kind == mav.MAV_MISSION_TYPE_ALL else (kind,):
            self.lists[one] = ()
            self._on_changed(one)
        return [_ack(mav.MAV_MISSION_ACCEPTED, kind, client)]

    # -- sending -------------------------------------------------------------------------------

    def _wire_list(self, kind: int) -> tuple[StoredItem, ...]:
        items = self.lists[kind]
        if self.profile.home_item and kind == mav.MAV_MISSION_TYPE_MISSION:
            return (self._home(), *items)
        return items

    def _on_request_list(self, kind: int, client: Client, now: float) -> list[Message]:
        if kind not in self.lists:
            return [_ack(mav.MAV_MISSION_UNSUPPORTED, kind, client)]
        if self._receiving is not None:
            if self.profile.busy_when_transferring:
                return []
            return [_ack(mav.MAV_MISSION_DENIED, kind, client)]
        sending = self._sending
        if (
            sending is not None
            and self.profile.busy_when_transferring
            and sending.kind != kind
            and sending.next_seq < len(self._wire_list(sending.kind))
        ):
            return []
        self._sending = _Sending(client, kind, heard=now)
        count = len(self._wire_list(kind))
        if count == 0:
            self._sending = None
        return [mav.MAVLink_mission_count_message(client.system, client.component, count, kind)]

    def _on_request(self, message: Message, client: Client, now: float) -> list[Message]:
        kind, seq = message.mission_type, message.seq
        if kind not in self.lists:
            return [_ack(mav.MAV_MISSION_UNSUPPORTED, kind, client)]
        items = self._wire_list(kind)
        sending = self._sending
        if self.profile.busy_when_transferring:
            # PX4 answers only within a transfer, and only the next item or the one before.
            if sending is None or sending.client != client or sending.kind != kind:
                return []
            sending.heard = now
            if seq not in (sending.next_seq, sending.next_seq - 1) or seq >= len(items):
                self._sending = None
                return [_ack(mav.MAV_MISSION_ERROR, kind, client)]
            sending.next_seq = seq + 1
        elif not 0 <= seq < len(items):
            return [_ack(mav.MAV_MISSION_INVALID_SEQUENCE, kind, client)]
        elif sending is not None:
            sending.heard = now
        as_int = message.get_type() == "MISSION_REQUEST_INT"
        return [_item_message(items[seq], seq, kind, client, as_int)]

    def _on_ack(self, message: Message, client: Client, now: float) -> list[Message]:
        kind = message.mission_type
        if self._sending is not None and (self._sending.client, self._sending.kind) == (
            client,
            kind,
        ):
            self._sending = None
        receiving = self._receiving
        if receiving is None or (receiving.client, receiving.kind) != (client, kind):
            return []
        if message.type == mav.MAV_MISSION_OPERATION_CANCELLED:
            self._receiving = None
        elif (
            message.type == mav.MAV_MISSION_UNSUPPORTED
            and self.profile.requests is Requests.ADAPTIVE
        ):
            # The client does not know this kind of request: ask in the other one.
            self._speaks_int = not self._speaks_int
            return [self._request(receiving, now)]
        return []


def _ack(result: int, kind: int, client: Client) -> Message:
    return mav.MAVLink_mission_ack_message(client.system, client.component, result, kind)


def _item_message(item: StoredItem, seq: int, kind: int, client: Client, as_int: bool) -> Message:
    x: float = item.x
    y: float = item.y
    make = mav.MAVLink_mission_item_int_message
    if not as_int:
        make = mav.MAVLink_mission_item_message
        if item.frame != mav.MAV_FRAME_MISSION:
            x, y = item.x * 1e-7, item.y * 1e-7
    return make(
        client.system,
        client.component,
        seq,
        item.frame,
        item.command,
        0,
        item.autocontinue,
        *item.params,
        x,
        y,
        item.z,
        kind,
    )
