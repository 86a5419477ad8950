"""Sending one list to the autopilot (https://mavlink.io/en/services/mission.html#uploading_mission)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.dialect import Dialect
from wisar_planner.mavlink.exchange import NEVER, Address, ack_message, item_message
from wisar_planner.mavlink.link_estimate import LinkEstimate
from wisar_planner.mavlink.mission import MissionItem, MissionKind
from wisar_planner.mavlink.wording import is_passing


class UploadEnd(Enum):
    """How sending a list ended. None of these proves what the autopilot holds."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    UNACKNOWLEDGED = "all items sent, but no acknowledgement heard"
    STALLED = "the autopilot stopped asking for items"
    SILENT = "the autopilot did not answer"
    CANCELLED = "cancelled"


class _State(Enum):
    COUNTING = 1  # MISSION_COUNT sent, no request heard yet
    SENDING = 2  # answering requests
    DONE = 3


@dataclass
class _Backward:
    """A request for an earlier item than the last one, waiting to be heard again."""

    seq: int
    heard: float


class Upload:
    """State machine that sends one list of items.

    The autopilot asks for the items one by one; whatever it asks for, it gets. An error
    acknowledgement counts only when no further request follows, because on a
    bad link it may be a late one that belongs to an earlier transfer, or answer a duplicate.

    Parameters
    ----------
    items
        The list as it goes over the wire.
    kind
        Which of the autopilot's lists it is.
    target
        The autopilot.
    dialect
        Its family.
    link
        Round-trip time and losses, shared with the other exchanges on the link.
    on_progress
        Called with the number of items that the autopilot has asked for so far.
    """

    # A request repeated sooner than this is a duplicate made by the network: autopilots wait
    # 0.25 s (PX4) to 1 s (ArduPilot) before they ask again.
    _DUPLICATE_WITHIN_S = 0.05
    _DUPLICATE_WITHIN_STRICT_S = 0.8
    # How long to listen for a repeated request before a missing acknowledgement is believed lost.
    _ACK_PATIENCE_S = 3.5
    # Silence that losses no longer explain is believed after this time already.
    _QUICK_STALL_S = 3.0

    def __init__(
        self,
        items: Sequence[MissionItem],
        kind: MissionKind,
        target: Address,
        dialect: Dialect,
        *,
        link: LinkEstimate,
        on_progress: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._items = items
        self._kind = kind
        self._target = target
        self._dialect = dialect
        self._link = link
        self._on_progress = on_progress
        self._state = _State.COUNTING
        self._deadline = NEVER
        self._tries = 0
        self._sent_at = 0.0
        self._asked_at = 0.0
        self._heard_at = 0.0
        self._seq = -1  # the item sent last
        self._highest = -1
        self._backward: _Backward | None = None
        self._error: int | None = None
        self.end: UploadEnd | None = None
        self.result: int | None = None
        """MAV_MISSION_RESULT of a refusal."""
        self.told_wrong_sequence = False
        """Whether the autopilot said that an item was not the one that it had asked for."""

    @property
    def done(self) -> bool:
        """Whether the upload has ended; `end` then says how."""
        return self._state is _State.DONE

    @property
    def deadline(self) -> float:
        """When `on_time` wants to be called next."""
        return self._deadline

    @property
    def items_sent(self) -> int:
        """How many different items were sent."""
        return self._highest + 1

    def start(self, now: float) -> list[Message]:
        """Announce the list."""
        self._heard_at = self._asked_at = now
        return self._announce(now)

    def _announce(self, now: float) -> list[Message]:
        self._tries += 1
        self._sent_at = now
        self._deadline = now + self._link.timeout
        return [
            mav.MAVLink_mission_count_message(
                self._target.system, self._target.component, len(self._items), self._kind
            )
        ]

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Answer a request, or take in an acknowledgement."""
        name = message.get_type()
        if self.done or getattr(message, "mission_type", None) != self._kind:
            return []
        if name in ("MISSION_REQUEST_INT", "MISSION_REQUEST"):
            return self._on_request(message.seq, now)
        if name == "MISSION_ACK":
            self._on_ack(message.type, now)
        return []

    def _on_request(self, seq: int, now: float) -> list[Message]:
        if not 0 <= seq < len(self._items):
            return []
        self._heard_at = now
        self._error = None
        if seq == self._seq and now - self._sent_at < self._duplicate_window:
            return []
        if seq < self._seq and self._dialect.strict_sequence and not self._asked_again(seq, now):
            return []
        if seq == self._seq + 1:
            self._link.answered(self._tries, now - self._asked_at)
        self._backward = None
        self._state = _State.SENDING
        if seq != self._seq:
            self._tries = 0
            self._asked_at = now
        self._seq = seq
        if seq > self._highest:
            self._highest = seq
            self._on_progress(self.items_sent)
        return self._send_item(now)

    def _asked_again(self, seq: int, now: float) -> bool:
        """Whether a request that goes backward is meant, and not a late one."""
        before = self._backward
        if before is None or before.seq != seq:
            self._backward = _Backward(seq, now)
            return False
        return now - before.heard >= self._duplicate_window

    @property
    def _duplicate_window(self) -> float:
        strict = self._dialect.strict_sequence
        return self._DUPLICATE_WITHIN_STRICT_S if strict else self._DUPLICATE_WITHIN_S

    def _send_item(self, now: float) -> list[Message]:
        self._tries += 1
        self._sent_at = now
        self._deadline = now + self._link.timeout
        return [item_message(self._items[self._seq], self._seq, self._kind, self._target)]

    @property
    def _all_sent(self) -> bool:
        return self._highest == len(self._items) - 1

    def _on_ack(self, result: int, now: float) -> None:
        if result == mav.MAV_MISSION_ACCEPTED:
            # Before the last item was sent this can only belong to an earlier transfer.
            if self._all_sent:
                self._finish(UploadEnd.ACCEPTED)
            return
        if result == mav.MAV_MISSION_INVALID_SEQUENCE:
            # Answers an item that came twice. ArduCopter goes on (an old one may not: then the next
            # item is answered with another error, or not at all).
            self.told_wrong_sequence = True
            return
        self._error = result
        grace = self._link.timeout
        if is_passing(result):
            grace = max(grace, self._dialect.asks_again_after_s)
        self._deadline = now + grace

    def on_time(self, now: float) -> list[Message]:
        """Send again what found no answer, or give up."""
        if self.done or now < self._deadline:
            return []
        if self._error == mav.MAV_MISSION_ERROR and self._all_sent:
            # Also what ArduPilot says to the last item when it has it already.
            self._finish(UploadEnd.UNACKNOWLEDGED)
            return []
        if self._error is not None:
            self.result = self._error
            self._finish(UploadEnd.REFUSED)
            return []
        self._link.timed_out()
        if self._state is _State.COUNTING:
            if self._link.policy.exhausted(self._tries, now - self._heard_at):
                self._finish(UploadEnd.SILENT)
                return []
            return self._announce(now)
        silent = now - self._heard_at
        if self._all_sent and silent >= max(self._ACK_PATIENCE_S, 3.0 * self._link.timeout):
            self._finish(UploadEnd.UNACKNOWLEDGED)
            return []
        if silent >= self._dialect.gives_up_after_s + 2.0 * self._link.timeout or (
            self._tries >= self._link.suspicious_tries() and silent >= self._QUICK_STALL_S
        ):
            self._finish(UploadEnd.STALLED)
            return []
        if self._dialect.strict_sequence and silent < self._dialect.asks_again_after_s:
            self._deadline = now + self._link.timeout
            return []
        return self._send_item(now)

    def cancel(self, now: float) -> list[Message]:
        """Tell the autopilot that no more items follow; it keeps its old list."""
        if self.done:
            return []
        self._finish(UploadEnd.CANCELLED)
        return [ack_message(mav.MAV_MISSION_OPERATION_CANCELLED, self._kind, self._target)]

    def _finish(self, end: UploadEnd) -> None:
        self.end = end
        self._state = _State.DONE
        self._deadline = NEVER
