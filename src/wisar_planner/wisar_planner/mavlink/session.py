"""One end of the conversation with one vehicle, without sockets, threads and clocks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.exchange import Address, Exchange
from wisar_planner.mavlink.streams import Streams
from wisar_planner.mavlink.vehicle import VehicleState, changes, is_last_chunk

HEARTBEAT_EVERY_S = 1.0
LINK_LOST_AFTER_S = 5.0


@dataclass(frozen=True)
class LinkStatus:
    """Whether the vehicle can be talked to.

    Parameters
    ----------
    connected
        Whether a heartbeat was heard within the last five seconds.
    text
        The same in words, with the reason if it is not.
    """

    connected: bool
    text: str


class Slot(Enum):
    """Which exchanges follow one another; those of different slots go on side by side.

    The messages of a transfer (MISSION_*) and of a command (COMMAND_*) are never taken for one
    another, and a return to launch must not wait for a transfer's end.
    """

    TRANSFER = "transfer"
    COMMAND = "command"


class Session:
    """Listens to one vehicle, keeps its state, and leads one exchange per slot at a time.

    Telemetry that the vehicle does not send by itself is asked for.

    Messages from others, or addressed to others, change nothing.

    Parameters
    ----------
    address
        Own ids.
    name
        Name of the connection, for messages to people.
    target_system, target_component
        The vehicle's ids; None takes the first autopilot heard.
    on_link, on_vehicle, on_text
        See `client.MissionClient`.
    """

    def __init__(
        self,
        address: Address,
        name: str,
        *,
        target_system: int | None = None,
        target_component: int | None = None,
        on_link: Callable[[LinkStatus], None] = lambda _: None,
        on_vehicle: Callable[[VehicleState], None] = lambda _: None,
        on_text: Callable[[int, str], None] = lambda *_: None,
    ) -> None:
        self.vehicle: VehicleState | None = None
        self.status = LinkStatus(False, "no heartbeat heard yet")
        self._broken = False  # whether the connection was, and the status tells of it
        self._exchanges: dict[Slot, Exchange] = {}
        self._address = address
        self._name = name
        self._wanted = (target_system, target_component)
        self._on_link = on_link
        self._on_vehicle = on_vehicle
        self._on_text = on_text
        self._streams: Streams | None = None
        self._next_heartbeat = -math.inf

    @property
    def exchange(self) -> Exchange | None:
        """The transfer in progress, or the last one."""
        return self._exchanges.get(Slot.TRANSFER)

    @property
    def deadline(self) -> float:
        """When `tick` wants to be called next."""
        return min(self._next_heartbeat, *(e.deadline for e in self._exchanges.values()), math.inf)

    def begin(self, exchange: Exchange, now: float, slot: Slot = Slot.TRANSFER) -> list[Message]:
        """Start an exchange; the one before in this slot must have ended."""
        self._exchanges[slot] = exchange
        return exchange.start(now)

    def finish(self, slot: Slot) -> None:
        """Forget the exchange of a slot."""
        self._exchanges.pop(slot, None)

    def cancel(self, now: float, slot: Slot) -> list[Message]:
        """End the exchange in progress in a slot, if there is one."""
        exchange = self._exchanges.get(slot)
        return [] if exchange is None else exchange.cancel(now)

    def receive(self, message: Message, now: float) -> list[Message]:
        """Take in a message and return the answers."""
        if not (self._is_vehicle(message) and self._is_for_us(message)):
            return []
        self._track(message, now)
        return [m for e in self._exchanges.values() for m in e.on_message(message, now)]

    def tick(self, now: float) -> list[Message]:
        """Let time pass: heartbeats, repetitions, noticing a lost link."""
        out = []
        if now >= self._next_heartbeat:
            self._next_heartbeat = now + HEARTBEAT_EVERY_S
            out.append(_heartbeat())
            self._watch(now)
            if self._streams is not None and self.status.connected:
                out += self._streams.due(now)
        for exchange in self._exchanges.values():
            out += exchange.on_time(now)
        return out

    def connection_lost(self, text: str) -> None:
        """Take in that the connection itself is gone; the vehicle may still be flying."""
        self._broken = True
        self._set_status(LinkStatus(self.status.connected, text))

    def ended(self, text: str) -> None:
        """Take in that nothing will be heard any more, and why."""
        self._set_status(LinkStatus(False, text))

    def _is_vehicle(self, message: Message) -> bool:
        source, sender = message.get_srcSystem(), message.get_srcComponent()
        vehicle = self.vehicle
        if vehicle is not None:
            return bool(source == vehicle.system and sender == vehicle.component)
        if message.get_type() != "HEARTBEAT" or message.autopilot == mav.MAV_AUTOPILOT_INVALID:
            return False
        system, component = self._wanted
        return system in (None, source) and component in (None, sender)

    def _is_for_us(self, message: Message) -> bool:
        """Whether a message is addressed to us or to everybody."""
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self._address.system) and component in (0, self._address.component)

    def _track(self, message: Message, now: float) -> None:
        before = self.vehicle or VehicleState(message.get_srcSystem(), message.get_srcComponent())
        changed: dict[str, Any] = changes(before, message, now)
        if self._streams is not None:  # also what tells nothing yet comes by itself
            self._streams.heard(message.get_type(), now)
        if not changed:
            return
        self.vehicle = replace(before, **changed)
        name = message.get_type()
        if self._streams is None:
            self._streams = Streams(Address(before.system, before.component))
        if name == "HEARTBEAT":
            self._watch(now, heard=True)
        elif name != "STATUSTEXT":
            self._on_vehicle(self.vehicle)
        elif is_last_chunk(message):
            self._on_text(message.severity, self.vehicle.text)

    def _watch(self, now: float, *, heard: bool = False) -> None:
        """Notice that the vehicle has appeared, or has been silent for too long.

        One that is heard again after the connection broke for a moment is told as if it appeared.
        """
        vehicle = self.vehicle
        connected = vehicle is not None and now - vehicle.heard_at <= LINK_LOST_AFTER_S
        if connected == self.status.connected and not (heard and self._broken):
            return
        self._broken = False
        if connected and vehicle is not None:
            text = f"{vehicle.dialect.name} vehicle {vehicle.system} on {self._name}"
        else:
            text = f"no heartbeat for {LINK_LOST_AFTER_S:g} s on {self._name}"
        self._set_status(LinkStatus(connected, text))

    def _set_status(self, status: LinkStatus) -> None:
        self.status = status
        self._on_link(status)


def _heartbeat() -> Message:
    return mav.MAVLink_heartbeat_message(
        mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, mav.MAV_STATE_ACTIVE, 3
    )
