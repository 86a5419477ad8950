"""Reading one list from the autopilot (https://mavlink.io/en/services/mission.html#download_mission)."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.exchange import NEVER, Address, ack_message, item_of
from wisar_planner.mavlink.link_estimate import LinkEstimate
from wisar_planner.mavlink.mission import MissionItem, MissionKind
from wisar_planner.mavlink.wording import is_passing


class DownloadEnd(Enum):
    """How reading a list ended."""

    COMPLETE = "complete"
    REFUSED = "refused"
    SILENT = "the autopilot did not answer"
    CANCELLED = "cancelled"


class _State(Enum):
    LISTING = 1  # MISSION_REQUEST_LIST sent
    FETCHING = 2  # asking for one item after the other
    DONE = 3


class Download:
    """State machine that reads one list of items.

    Parameters
    ----------
    kind
        Which of the autopilot's lists to read.
    target
        The autopilot.
    link
        Round-trip time and losses, shared with the other exchanges on the link.
    on_progress
        Called with the number of items read so far.
    """

    _MOST_RESTARTS = 10
    _MOST_REFUSALS = 5

    def __init__(
        self,
        kind: MissionKind,
        target: Address,
        *,
        link: LinkEstimate,
        on_progress: Callable[[int], None] = lambda _: None,
    ) -> None:
        self._kind = kind
        self._target = target
        self._link = link
        self._on_progress = on_progress
        self._state = _State.LISTING
        self._deadline = NEVER
        self._tries = 0
        self._asked_at = 0.0
        self._count = 0
        self._restarts = 0
        self._error: int | None = None
        self._refusals = 0
        self.items: list[MissionItem] = []
        self.end: DownloadEnd | None = None
        self.result: int | None = None
        """MAV_MISSION_RESULT of a refusal."""

    @property
    def done(self) -> bool:
        """Whether the download has ended; `end` then says how."""
        return self._state is _State.DONE

    @property
    def deadline(self) -> float:
        """When `on_time` wants to be called next."""
        return self._deadline

    def start(self, now: float) -> list[Message]:
        """Ask for the length of the list."""
        self._asked_at = now
        return self._ask(now)

    def _ask(self, now: float) -> list[Message]:
        self._tries += 1
        self._deadline = now + self._link.timeout
        to = (self._target.system, self._target.component)
        if self._state is _State.LISTING:
            return [mav.MAVLink_mission_request_list_message(*to, self._kind)]
        return [mav.MAVLink_mission_request_int_message(*to, len(self.items), self._kind)]

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Take in the count, an item or a refusal."""
        name = message.get_type()
        if self.done or getattr(message, "mission_type", None) != self._kind:
            return []
        if name == "MISSION_COUNT" and self._state is _State.LISTING:
            self._answered(now)
            self._count = message.count
            self._state = _State.FETCHING
            return self._next(now)
        if name in ("MISSION_ITEM_INT", "MISSION_ITEM"):
            if self._state is not _State.FETCHING or message.seq != len(self.items):
                return []  # a duplicate, or one that comes late
            self._answered(now)
            self.items.append(item_of(message))
            self._on_progress(len(self.items))
            return self._next(now)
        if name == "MISSION_ACK" and message.type != mav.MAV_MISSION_ACCEPTED:
            self._error = message.type
            self._refusals += 1
            self._deadline = min(self._deadline, now + self._link.timeout)
        return []

    def _answered(self, now: float) -> None:
        self._link.answered(self._tries, now - self._asked_at)
        self._tries = 0
        self._asked_at = now
        self._error = None

    def _next(self, now: float) -> list[Message]:
        if len(self.items) < self._count:
            return self._ask(now)
        self._finish(DownloadEnd.COMPLETE)
        return [ack_message(mav.MAV_MISSION_ACCEPTED, self._kind, self._target)]

    def on_time(self, now: float) -> list[Message]:
        """Ask again for what did not come, start over, or give up."""
        if self.done or now < self._deadline:
            return []
        exhausted = self._link.policy.exhausted(self._tries, now - self._asked_at)
        if (exhausted or self._is_refused) and not self._may_start_over:
            self.result = self._error
            self._finish(DownloadEnd.SILENT if self._error is None else DownloadEnd.REFUSED)
            return []
        self._link.timed_out()
        # An autopilot that was asked for an item it did not expect (a late duplicate made by the
        # network is enough) ends the transfer, says so once, and is silent from then on.
        gone = exhausted or self._error is not None or self._tries >= self._link.suspicious_tries()
        if gone and self._may_start_over:
            self._restarts += 1
            self._state = _State.LISTING
            self._error = None
            self._tries = 0
            self._asked_at = now
            self.items.clear()
        return self._ask(now)

    @property
    def _is_refused(self) -> bool:
        """Whether a refusal is meant, and not a late one that belongs to an earlier transfer."""
        if self._error is None:
            return False
        return not is_passing(self._error) or self._refusals >= self._MOST_REFUSALS

    @property
    def _may_start_over(self) -> bool:
        return self._state is _State.FETCHING and self._restarts < self._MOST_RESTARTS

    def cancel(self, now: float) -> list[Message]:
        """Tell the autopilot that the rest of the list is not wanted."""
        if self.done:
            return []
        self._finish(DownloadEnd.CANCELLED)
        return [ack_message(mav.MAV_MISSION_OPERATION_CANCELLED, self._kind, self._target)]

    def _finish(self, end: DownloadEnd) -> None:
        self.end = end
        self._state = _State.DONE
        self._deadline = NEVER


class PatientDownload:
    """Reads one list, again after a refusal that may pass.

    An autopilot whose last transfer was cut reads nothing out until it gives that one up.

    Parameters
    ----------
    make
        Makes the next attempt.
    """

    _MOST_ATTEMPTS = 12
    _PAUSE_S = 1.0

    def __init__(self, make: Callable[[], Download]) -> None:
        self._make = make
        self._download = make()
        self._attempts = 1
        self._pause_until = NEVER

    @property
    def _pausing(self) -> bool:
        return self._pause_until < NEVER

    @property
    def done(self) -> bool:
        """Whether the last attempt has ended; `end` then says how."""
        return self._download.done and not self._pausing

    @property
    def end(self) -> DownloadEnd | None:
        """How it ended."""
        return self._download.end

    @property
    def result(self) -> int | None:
        """MAV_MISSION_RESULT of a refusal."""
        return self._download.result

    @property
    def items(self) -> list[MissionItem]:
        """What was read."""
        return self._download.items

    @property
    def deadline(self) -> float:
        """When `on_time` wants to be called next."""
        return min(self._download.deadline, self._pause_until)

    def start(self, now: float) -> list[Message]:
        """Begin the first attempt."""
        return self._download.start(now)

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Pass a message to the attempt in progress."""
        return self._download.on_message(message, now)

    def on_time(self, now: float) -> list[Message]:
        """Let time pass; begin again after a pause."""
        if self._pausing:
            if now < self._pause_until:
                return []
            self._pause_until = NEVER
            self._attempts += 1
            self._download = self._make()
            return self._download.start(now)
        out = self._download.on_time(now)
        refused = self.end is DownloadEnd.REFUSED and is_passing(self.result or 0)
        if refused and self._attempts < self._MOST_ATTEMPTS:
            self._pause_until = now + self._PAUSE_S
        return out

    def cancel(self, now: float) -> list[Message]:
        """Tell the autopilot that the rest of the list is not wanted."""
        if self._pausing:
            self._pause_until = NEVER
            self._download = self._make()
        return self._download.cancel(now)
