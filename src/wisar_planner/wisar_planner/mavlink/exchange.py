"""The shape that all protocol state machines share: messages and time in, messages out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.mission import MissionItem

NEVER = math.inf


@dataclass(frozen=True)
class Address:
    """System and component id of one end of a conversation."""

    system: int
    component: int

    def __post_init__(self) -> None:
        for name in ("system", "component"):
            value = getattr(self, name)
            if not 0 <= value <= 255:
                raise InvalidInput(f"{name} must be from 0 to 255, got {value}")


class Exchange(Protocol):
    """A conversation with the autopilot, without socket and clock.

    All times are seconds of one monotonic clock. Every method returns the messages to send.
    """

    @property
    def done(self) -> bool:
        """Whether the conversation has ended."""

    @property
    def deadline(self) -> float:
        """When `on_time` wants to be called next."""

    def start(self, now: float) -> list[Message]:
        """Begin."""

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Take in a message from the autopilot; one that does not belong is ignored."""

    def on_time(self, now: float) -> list[Message]:
        """Let time pass; does nothing before `deadline`."""

    def cancel(self, now: float) -> list[Message]:
        """End early, politely."""


def item_message(item: MissionItem, seq: int, kind: int, target: Address) -> Message:
    """Put an item on the wire as MISSION_ITEM_INT."""
    return mav.MAVLink_mission_item_int_message(
        target.system,
        target.component,
        seq,
        item.frame,
        item.command,
        1 if seq == 0 and kind == mav.MAV_MISSION_TYPE_MISSION else 0,
        int(item.autocontinue),
        *item.params,
        item.x,
        item.y,
        item.z,
        kind,
    )


def item_of(message: Message) -> MissionItem:
    """Take an item out of MISSION_ITEM_INT or the older MISSION_ITEM."""
    item = MissionItem(
        command=message.command,
        frame=message.frame,
        params=(message.param1, message.param2, message.param3, message.param4),
        z=message.z,
        autocontinue=bool(message.autocontinue),
    )
    if message.get_type() == "MISSION_ITEM_INT":
        return replace(item, x=message.x, y=message.y)
    scale = 1e7 if item.is_global else 1.0
    return replace(item, x=_int32(message.x * scale), y=_int32(message.y * scale))


def _int32(value: float) -> int:
    """Round to the nearest number that MISSION_ITEM_INT can carry; NaN becomes 0."""
    return 0 if math.isnan(value) else round(min(max(value, -(2.0**31)), 2.0**31 - 1.0))


def ack_message(result: int, kind: int, target: Address) -> Message:
    """Make a MISSION_ACK."""
    return mav.MAVLink_mission_ack_message(target.system, target.component, result, kind)
