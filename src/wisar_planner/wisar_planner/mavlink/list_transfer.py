"""Putting one list on the autopilot: send, read back, compare, try again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.command import Clear, RequestEnd
from wisar_planner.mavlink.dialect import Dialect
from wisar_planner.mavlink.download import Download, DownloadEnd
from wisar_planner.mavlink.exchange import NEVER, Address
from wisar_planner.mavlink.link_estimate import LinkEstimates
from wisar_planner.mavlink.mission import MissionItem, MissionKind
from wisar_planner.mavlink.outcome import UploadCode
from wisar_planner.mavlink.upload import Upload, UploadEnd
from wisar_planner.mavlink.wording import is_passing, mission_result

DO_NOT_FLY = ". Do not fly it; upload again"
"""What ends the words about a list that differs from what was sent."""


class _Phase(Enum):
    SENDING = "sending"
    READING = "reading back"
    PAUSING = "waiting to try again"
    DONE = "done"


class ListTransfer:
    """State machine that puts one list on the autopilot and proves it by reading it back.

    An acknowledgement alone proves nothing, and a lost one nothing either: what counts is the
    comparison. A first read-back that differs is repeated before it is believed, as it may have
    caught late messages of an earlier transfer.

    Parameters
    ----------
    items
        The list as people mean it; an empty one clears what is there.
    kind, target, dialect, links
        As for `Upload`.
    on_progress
        Called with (phase, items sent, items read back, attempt).
    objection
        Called before each sending of the list; words say why it must not be sent now.

    Attributes
    ----------
    old
        What the autopilot held before, where it has been read.
    """

    _MOST_ATTEMPTS = 8
    _MOST_REFUSALS = 5
    _MOST_READS = 10
    _MOST_SILENT_READS = 4
    # How long after the first read-back a silent one is still repeated: on a link where each takes
    # many minutes the operator is told instead.
    _READING_PATIENCE_S = 600.0
    _PAUSE_S = 1.0
    _LONGEST_PAUSE_S = 3.0

    def __init__(
        self,
        items: Sequence[MissionItem],
        kind: MissionKind,
        target: Address,
        dialect: Dialect,
        *,
        links: LinkEstimates,
        on_progress: Callable[[str, int, int, int], None] = lambda *_: None,
        objection: Callable[[], str] = lambda: "",
    ) -> None:
        self._objection = objection
        self._in_place = dialect.replaces_in_place and kind is MissionKind.MISSION
        self.old: tuple[MissionItem, ...] | None = None
        self._wanted = tuple(items)
        self._kind = kind
        self._target = target
        self._dialect = dialect
        self._links = links
        self._on_progress = on_progress
        self._phase = _Phase.PAUSING
        self._sender: Upload | Clear | None = None
        self._reader: Download | None = None
        self._pause_until = NEVER
        self._after_pause: Callable[[float], list[Message]] = self.start
        self._wire_count = 0
        self._careful = False
        self._reads = 0
        self._reading_since = NEVER
        self._differed = False
        self._failure: tuple[UploadCode, str] | None = None
        self.attempts = 0
        self.items_sent = 0
        self.code: UploadCode | None = None
        self.error = ""
        self.differences: tuple[str, ...] = ()
        self.old_counts = True
        """Whether the autopilot surely holds the list that it held before."""

    @property
    def done(self) -> bool:
        """Whether the transfer has ended; `code` and `error` then say how."""
        return self._phase is _Phase.DONE

    @property
    def _active(self) -> Upload | Clear | Download | None:
        if self._phase is _Phase.SENDING:
            return self._sender
        return self._reader if self._phase is _Phase.READING else None

    @property
    def deadline(self) -> float:
        """When `on_time` wants to be called next."""
        active = self._active
        return active.deadline if active is not None else self._pause_until

    def start(self, now: float) -> list[Message]:
        """Begin an attempt."""
        why = self._objection()
        if why:
            self._finish(UploadCode.REFUSED_BEFORE, why)
            return []
        self.attempts += 1
        self._reads = 0
        self._differed = False
        self._failure = None
        self._phase = _Phase.SENDING
        self._pause_until = NEVER
        if self._wanted:
            if self._in_place:
                self.old_counts = False  # from the announcement on it is being overwritten
            wire = self._dialect.to_wire(self._kind, self._wanted)
            self._wire_count = len(wire)
            dialect = self._dialect
            self._sender = Upload(
                wire,
                self._kind,
                self._target,
                replace(dialect, strict_sequence=dialect.strict_sequence or self._careful),
                link=self._links.sending,
                on_progress=self._sent,
            )
        else:
            self.old_counts = False
            self._sender = Clear(
                self._kind, self._target, link=self._links.asking, announces_none=self._in_place
            )
        return self._sender.start(now)

    def _sent(self, count: int) -> None:
        if count == self._wire_count:
            self.old_counts = False  # from here on the new list may be in force
        self.items_sent = min(count, len(self._wanted))
        self._report(0)

    def _report(self, read: int) -> None:
        self._on_progress(self._phase.value, self.items_sent, read, self.attempts)

    def _read(self, now: float) -> list[Message]:
        if self._reads == 0:
            self._reading_since = now
        self._reads += 1
        self._phase = _Phase.READING
        self._reader = Download(
            self._kind,
            self._target,
            link=self._links.asking,
            on_progress=lambda count: self._report(min(count, len(self._wanted))),
        )
        return self._reader.start(now)

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Pass a message to the step in progress."""
        active = self._active
        if active is None:
            return []
        return active.on_message(message, now) + self._go_on(now)

    def on_time(self, now: float) -> list[Message]:
        """Let time pass."""
        active = self._active
        if active is not None:
            return active.on_time(now) + self._go_on(now)
        if self._phase is _Phase.PAUSING and now >= self._pause_until:
            return self._after_pause(now)
        return []

    def cancel(self, now: float) -> list[Message]:
        """End early. The old list stays, unless all items had been sent already."""
        if self.done:
            return []
        active = self._active
        out = active.cancel(now) if active is not None else []
        self._finish(
            UploadCode.CANCELLED,
            "cancelled: the old list counts"
            if self.old_counts
            else "cancelled"
            if self._in_place
            else "cancelled after everything was sent: the autopilot may hold the new list, "
            "unverified",
        )
        return out

    def _go_on(self, now: float) -> list[Message]:
        if self._phase is _Phase.SENDING and self._sender is not None and self._sender.done:
            return self._after_sending(now)
        if self._phase is _Phase.READING and self._reader is not None and self._reader.done:
            return self._after_reading(self._reader, now)
        return []

    def _after_sending(self, now: float) -> list[Message]:
        sender = self._sender
        assert sender is not None
        if sender.end in (UploadEnd.ACCEPTED, UploadEnd.UNACKNOWLEDGED, RequestEnd.ACCEPTED):
            return self._read(now)
        if sender.end in (UploadEnd.SILENT, RequestEnd.SILENT):
            self._finish(
                UploadCode.NO_LINK,
                "the autopilot does not answer; check the link, then read the mission back",
            )
            return []
        if sender.end is RequestEnd.REFUSED and sender.result == mav.MAV_MISSION_UNSUPPORTED:
            # An autopilot that does not know such a list holds none, which is what was wanted.
            self._finish(UploadCode.VERIFIED, "")
            return []
        if isinstance(sender, Upload) and sender.told_wrong_sequence:
            # It may have ended the upload because of a repeated item: try the other way next.
            self._careful = not self._careful
        if sender.end in (UploadEnd.REFUSED, RequestEnd.REFUSED):
            result = sender.result if sender.result is not None else -1
            return self._failed(
                UploadCode.REFUSED, mission_result(result), may_pass=is_passing(result), now=now
            )
        return self._failed(
            UploadCode.INCOMPLETE,
            f"the autopilot stopped asking after {self.items_sent} of {len(self._wanted)} items; "
            "move closer or turn the antenna, then try again",
            may_pass=True,
            now=now,
        )

    def _failed(self, code: UploadCode, error: str, *, may_pass: bool, now: float) -> list[Message]:
        """Try again where that can help; otherwise find out what the autopilot holds now."""
        most = self._MOST_REFUSALS if code is UploadCode.REFUSED else self._MOST_ATTEMPTS
        if may_pass and self.attempts < most:
            return self._pause(self.start, now)
        self._failure = (code, error)
        return self._read(now)

    def _pause(self, then: Callable[[float], list[Message]], now: float) -> list[Message]:
        self._phase = _Phase.PAUSING
        self._after_pause = then
        self._pause_until = now + min(self._PAUSE_S * self.attempts, self._LONGEST_PAUSE_S)
        return []

    def _after_reading(self, reader: Download, now: float) -> list[Message]:
        if reader.end is not DownloadEnd.COMPLETE:
            # An autopilot that still waits for the last item reads nothing out until it gives up.
            if reader.end is DownloadEnd.REFUSED and self._reads < self._MOST_READS:
                return self._pause(self._read, now)
            # Where the new list may be in force already, a long silence is not the last word.
            if (
                reader.end is DownloadEnd.SILENT
                and not self.old_counts
                and self._reads < self._MOST_SILENT_READS
                and now - self._reading_since < self._READING_PATIENCE_S
            ):
                return self._read(now)
            why = "" if reader.result is None else ": " + mission_result(reader.result)
            code, error = self._failure or (UploadCode.UNVERIFIED, "all items were sent")
            self._finish(code, f"{error}; what the autopilot holds now could not be read back{why}")
            return []
        found = self._dialect.from_wire(self._kind, reader.items)
        differences = self._dialect.differences(self._kind, self._wanted, found)
        if not differences:
            self._finish(UploadCode.VERIFIED, "")
            return []
        if self._failure is not None:
            code, error = self._failure
            # Refused before its first item came, say: then nothing has been overwritten.
            if self.old is not None and not self._dialect.differences(self._kind, self.old, found):
                self.old_counts = True
            self._finish(
                code,
                f"{error}. The new list is not in force; the autopilot holds {len(found)} items",
            )
            return []
        if not self._differed:
            self._differed = True
            return self._read(now)
        self.differences = differences
        return self._failed_comparison(differences, now)

    def _failed_comparison(self, differences: tuple[str, ...], now: float) -> list[Message]:
        sender = self._sender
        # Without an acknowledgement a difference most likely means that the last item was lost;
        # after one it means that the autopilot changes what it is given, now and next time.
        unheard = sender is not None and sender.end is UploadEnd.UNACKNOWLEDGED
        if self.attempts < (self._MOST_ATTEMPTS if unheard else 2):
            return self.start(now)
        self._finish(
            UploadCode.DIFFERENT,
            "what the autopilot holds differs from what was sent: "
            + "; ".join(differences)
            + DO_NOT_FLY,
        )
        return []

    def _finish(self, code: UploadCode, error: str) -> None:
        self.code = code
        self.error = error
        if code is UploadCode.VERIFIED:
            self.differences = ()
            self.old_counts = False
        self._phase = _Phase.DONE
        self._pause_until = NEVER
