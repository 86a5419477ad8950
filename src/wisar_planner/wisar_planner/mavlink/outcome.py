"""What an upload tells while it goes on, and what came of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


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
    fence_touched
        Whether the autopilot may hold another fence than before.
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
    fence_touched: bool = False
    notes: tuple[str, ...] = ()

    @property
    def verified(self) -> bool:
        """Whether the autopilot holds exactly what was sent."""
        return self.code is UploadCode.VERIFIED
