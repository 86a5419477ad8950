"""Putting a whole mission on the autopilot: send, read back, compare, and say what came of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, IntEnum

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.command import Clear, RequestEnd
from wisar_planner.mavlink.dialect import Dialect
from wisar_planner.mavlink.download import Download, DownloadEnd, PatientDownload
from wisar_planner.mavlink.exchange import NEVER, Address
from wisar_planner.mavlink.link_estimate import LinkEstimates
from wisar_planner.mavlink.mission import Mission, MissionItem, MissionKind
from wisar_planner.mavlink.upload import Upload, UploadEnd
from wisar_planner.mavlink.wording import is_passing, mission_result

UPLOAD_ORDER = (MissionKind.FENCE, MissionKind.RALLY, MissionKind.MISSION)
"""The fence comes first: PX4 checks a mission against the fence that it holds by then."""

_LIST_NAMES = {
    MissionKind.MISSION: "mission",
    MissionKind.FENCE: "fence",
    MissionKind.RALLY: "rally points",
}


_MIXTURE = (
    "The vehicle may hold a mixture of the old and the new mission: do not fly it; upload again"
)
_DO_NOT_FLY = ". Do not fly it; upload again"


def lists_of(mission: Mission, *, clear_old: bool = False) -> tuple[MissionKind, ...]:
    """Return the lists that an upload touches: the flight, and of the others what there is.

    Parameters
    ----------
    mission
        What is to be uploaded.
    clear_old
        Whether a fence and rally points that the mission does not have are deleted on the vehicle.
    """
    return tuple(
        kind
        for kind in UPLOAD_ORDER
        if clear_old or kind is MissionKind.MISSION or mission.of_kind(kind)
    )


class UploadCode(IntEnum):
    """Numbered outcomes of an upload; the numbers are those of the UploadMission action."""

    VERIFIED = 0
    REFUSED_BEFORE = 1
    NO_LINK = 2
    REFUSED = 3
    INCOMPLETE = 4
    DIFFERENT = 5
    UNVERIFIED = 6
    CANCELLED = 7
    BUSY = 8


@dataclass(frozen=True)
class UploadProgress:
    """How far an upload has come.

    Parameters
    ----------
    phase
        What is happening now, in words.
    items_sent
        Items that the autopilot has asked for in this attempt, over all lists.
    items_verified
        Items read back so far, over all lists.
    items_total
        Items of all lists.
    attempt
        Number of the attempt at the present list, from 1.
    """

    phase: str
    items_sent: int
    items_verified: int
    items_total: int
    attempt: int


@dataclass(frozen=True)
class UploadResult:
    """What came of an upload.

    Parameters
    ----------
    code
        Outcome as a number; only VERIFIED means that the new mission counts.
    error
        Outcome in words with what to do, empty if verified.
    differences
        One sentence per item that read back differently.
    items_sent, items_total
        Items sent (over all lists) and wanted.
    attempts
        Times that sending a list was begun, over all lists.
    elapsed_s
        Duration in seconds.
    notes
        What else to know, in one sentence each, such as which lists were deleted.
    old_counts
        Whether the mission that the autopilot held before still counts. False after success, and
        where the autopilot may hold something that has not been verified.
    """

    code: UploadCode
    error: str = ""
    differences: tuple[str, ...] = ()
    items_sent: int = 0
    items_total: int = 0
    attempts: int = 0
    elapsed_s: float = 0.0
    old_counts: bool = True
    notes: tuple[str, ...] = ()

    @property
    def verified(self) -> bool:
        """Whether the autopilot holds exactly what was sent."""
        return self.code is UploadCode.VERIFIED


_UNREACHABLE = frozenset({UploadCode.NO_LINK, UploadCode.REFUSED_BEFORE})
"""After these nothing is put back: it would not arrive, or would be flown at once."""


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
            + _DO_NOT_FLY,
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


class MissionTransfer:
    """State machine that puts fence, rally points and mission on the autopilot, in this order.

    The mission itself is replaced last, so that the old one counts until fence and rally points
    are verified. An autopilot that replaces it in place is asked for the old one before: when the
    upload ends early, the old one is put back, and proved like any other.

    Parameters
    ----------
    mission
        What to put there.
    kinds
        Lists to touch, of which empty ones are deleted; the others stay as they are. None takes
        those of `lists_of`.
    target, dialect, links
        As for `Upload`.
    on_progress
        Called on every item.
    objection
        Called before each sending of the mission; words say why it must not be sent now.
    """

    def __init__(
        self,
        mission: Mission,
        target: Address,
        dialect: Dialect,
        *,
        kinds: Sequence[MissionKind] | None = None,
        links: LinkEstimates | None = None,
        on_progress: Callable[[UploadProgress], None] = lambda _: None,
        objection: Callable[[], str] = lambda: "",
    ) -> None:
        self._links = links = links or LinkEstimates()
        self._target = target
        self._dialect = dialect
        self._reader: PatientDownload | None = None  # of the old mission
        self._restoring: ListTransfer | None = None
        kinds = lists_of(mission) if kinds is None else kinds
        self._on_progress = on_progress
        self._deleted = frozenset(kind for kind in kinds if not mission.of_kind(kind))
        self._objection = objection
        self._total = sum(len(mission.of_kind(k)) for k in kinds)
        self._lists = [
            (
                kind,
                ListTransfer(
                    mission.of_kind(kind),
                    kind,
                    target,
                    dialect,
                    links=links,
                    on_progress=self._progress,
                    objection=objection if kind is MissionKind.MISSION else lambda: "",
                ),
            )
            for kind in UPLOAD_ORDER
            if kind in kinds
        ]
        self._at = 0
        self._started_at = 0.0
        self.result: UploadResult | None = None

    @property
    def done(self) -> bool:
        """Whether the transfer has ended; `result` then says how."""
        return self.result is not None

    @property
    def _list(self) -> tuple[MissionKind, ListTransfer]:
        return self._lists[self._at]

    @property
    def _active(self) -> ListTransfer | PatientDownload:
        return self._restoring or self._reader or self._list[1]

    @property
    def deadline(self) -> float:
        """When `on_time` wants to be called next."""
        return NEVER if self.done else self._active.deadline

    def _progress(self, phase: str, sent: int, read: int, attempt: int) -> None:
        before = sum(t.items_sent for _, t in self._lists[: self._at])
        name = _LIST_NAMES[self._list[0]]
        self._on_progress(
            UploadProgress(f"{phase} {name}", before + sent, before + read, self._total, attempt)
        )

    def start(self, now: float) -> list[Message]:
        """Begin with the first list."""
        self._started_at = now
        return self._begin_list(now)

    def _begin_list(self, now: float) -> list[Message]:
        kind, transfer = self._list
        if not (self._dialect.replaces_in_place and kind is MissionKind.MISSION):
            return transfer.start(now) + self._go_on(now)
        self._reader = PatientDownload(
            lambda: Download(
                kind,
                self._target,
                link=self._links.asking,
                on_progress=lambda _: self._progress("keeping a copy of the old", 0, 0, 1),
            )
        )
        return self._reader.start(now)

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Pass a message to the list in progress."""
        if self.done:
            return []
        return self._active.on_message(message, now) + self._go_on(now)

    def on_time(self, now: float) -> list[Message]:
        """Let time pass."""
        if self.done:
            return []
        return self._active.on_time(now) + self._go_on(now)

    def cancel(self, now: float) -> list[Message]:
        """End early; what has to be put back is put back first, which no cancelling ends."""
        if self.done or self._restoring is not None:
            return []
        return self._active.cancel(now) + self._go_on(now)

    def abandon(self, now: float) -> None:
        """End at once, as nothing can be sent any more."""
        if self.done:
            return
        self.cancel(now)
        if not self.done:
            self._conclude(UploadCode.CANCELLED, f"cancelled. {_MIXTURE}", now, old_counts=False)

    def _go_on(self, now: float) -> list[Message]:
        if not self._active.done:
            return []
        if self._restoring is not None:
            return self._after_restoring(self._restoring, now)
        kind, transfer = self._list
        if self._reader is not None:
            reader, self._reader = self._reader, None
            return self._after_copying(reader, transfer, now)
        assert transfer.code is not None
        ok = transfer.code is UploadCode.VERIFIED
        if ok and self._at + 1 < len(self._lists):
            self._at += 1
            return self._begin_list(now)
        error = "" if ok else f"{_LIST_NAMES[kind]}: {transfer.error}"
        mixed = transfer.old is not None and not (ok or transfer.old_counts)
        if mixed and transfer.code in _UNREACHABLE:
            error += f". {_MIXTURE}"
        elif mixed:
            return self._restore(transfer, now)
        self._conclude(transfer.code, error, now, old_counts=self._old_counts)
        return []

    @property
    def _old_counts(self) -> bool:
        return all(t.old_counts for k, t in self._lists if k is MissionKind.MISSION)

    def _after_copying(
        self, reader: PatientDownload, transfer: ListTransfer, now: float
    ) -> list[Message]:
        """Begin to send once a copy of the old mission is here."""
        if reader.end is DownloadEnd.COMPLETE:
            transfer.old = self._dialect.from_wire(MissionKind.MISSION, reader.items)
            return transfer.start(now) + self._go_on(now)
        name = _LIST_NAMES[MissionKind.MISSION]
        if reader.end is DownloadEnd.CANCELLED:
            code, error = UploadCode.CANCELLED, "cancelled: the old list counts"
        elif reader.end is DownloadEnd.REFUSED:
            why = "" if reader.result is None else f": {mission_result(reader.result)}"
            code, error = UploadCode.REFUSED, f"the old mission could not be read first{why}"
        else:
            code, error = UploadCode.NO_LINK, "the autopilot does not answer; check the link"
        self._conclude(code, f"{name}: {error}", now, old_counts=True)
        return []

    def _restore(self, transfer: ListTransfer, now: float) -> list[Message]:
        assert transfer.old is not None
        self._restoring = ListTransfer(
            transfer.old,
            MissionKind.MISSION,
            self._target,
            self._dialect,
            links=self._links,
            on_progress=lambda *_: self._progress("putting back the old", 0, 0, 1),
            objection=self._objection,
        )
        return self._restoring.start(now) + self._go_on(now)

    def _after_restoring(self, restoring: ListTransfer, now: float) -> list[Message]:
        kind, transfer = self._list
        assert transfer.code is not None
        put_back = restoring.code is UploadCode.VERIFIED
        end = "The old mission was put back" if put_back else _MIXTURE
        error = f"{_LIST_NAMES[kind]}: {transfer.error.removesuffix(_DO_NOT_FLY)}. {end}"
        self._conclude(transfer.code, error, now, old_counts=put_back)
        return []

    def _conclude(self, code: UploadCode, error: str, now: float, *, old_counts: bool) -> None:
        verified = [k for k, t in self._lists if t.code is UploadCode.VERIFIED]
        new = [_LIST_NAMES[k] for k in verified if k not in self._deleted]
        gone = [_LIST_NAMES[k] for k in verified if k in self._deleted]
        if code is not UploadCode.VERIFIED and new:
            error += f" (new already: {' and '.join(new)})"
        self.result = UploadResult(
            code=code,
            error=error,
            differences=self._list[1].differences,
            items_sent=sum(t.items_sent for _, t in self._lists),
            items_total=self._total,
            attempts=sum(t.attempts for _, t in self._lists),
            elapsed_s=now - self._started_at,
            old_counts=old_counts,
            notes=(f"deleted on the vehicle: {' and '.join(gone)}",) if gone else (),
        )
