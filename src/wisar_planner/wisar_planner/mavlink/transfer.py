"""Putting a whole mission on the autopilot, list by list, and saying what came of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.dialect import Dialect
from wisar_planner.mavlink.download import Download, DownloadEnd, PatientDownload
from wisar_planner.mavlink.exchange import NEVER, Address
from wisar_planner.mavlink.link_estimate import LinkEstimates
from wisar_planner.mavlink.list_transfer import DO_NOT_FLY, ListTransfer
from wisar_planner.mavlink.mission import Mission, MissionKind
from wisar_planner.mavlink.outcome import UploadCode, UploadProgress, UploadResult
from wisar_planner.mavlink.wording import mission_result

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
_UNREACHABLE = frozenset({UploadCode.NO_LINK, UploadCode.REFUSED_BEFORE})
"""After these nothing is put back: it would not arrive, or would be flown at once."""


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
    old_is_mixture
        Whether an earlier upload may have left a mixture, which is what is put back then.
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
        old_is_mixture: bool = False,
    ) -> None:
        self._old_is_mixture = old_is_mixture
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
        is_sound = put_back and not self._old_is_mixture
        end = "The old mission was put back" if is_sound else _MIXTURE
        error = f"{_LIST_NAMES[kind]}: {transfer.error.removesuffix(DO_NOT_FLY)}. {end}"
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
            fence_touched=any(
                k is MissionKind.FENCE and not (t.old_counts and t.code is not UploadCode.VERIFIED)
                for k, t in self._lists
            ),
            notes=(f"deleted on the vehicle: {' and '.join(gone)}",) if gone else (),
        )
