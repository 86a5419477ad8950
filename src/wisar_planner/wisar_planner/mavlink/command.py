"""Requests such as "clear the fence" or "start the mission", repeated until they are answered."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Message
from wisar_planner.mavlink.exchange import NEVER, Address
from wisar_planner.mavlink.link_estimate import LinkEstimate
from wisar_planner.mavlink.mission import MissionKind


class RequestEnd(Enum):
    """How a request ended."""

    ACCEPTED = "accepted"
    REFUSED = "refused"
    SILENT = "the autopilot did not answer"
    CANCELLED = "cancelled"
    UNCHANGED = "the vehicle acknowledged, but did not change"
    WITHDRAWN = "no longer safe to ask for"


class _Request:
    """A message that is sent until an answer comes."""

    def __init__(self, link: LinkEstimate) -> None:
        self._link = link
        self._began_at = 0.0
        self._tries = 0
        self._deadline = NEVER
        self.end: RequestEnd | None = None
        self.result: int | None = None

    @property
    def done(self) -> bool:
        """Whether the request has ended; `end` then says how."""
        return self.end is not None

    @property
    def deadline(self) -> float:
        """When `on_time` wants to be called next."""
        return self._deadline

    def start(self, now: float) -> list[Message]:
        """Send the request."""
        self._began_at = now
        return self._ask(now)

    def _ask(self, now: float) -> list[Message]:
        self._tries += 1
        self._deadline = now + self._link.timeout
        return [self._message()]

    def on_time(self, now: float) -> list[Message]:
        """Send the request again, or give up."""
        if self.done or now < self._deadline:
            return []
        if self._link.policy.exhausted(self._tries, now - self._began_at):
            self._finish(RequestEnd.SILENT)
            return []
        self._link.timed_out()
        return self._ask(now)

    def cancel(self, now: float) -> list[Message]:
        """Stop asking."""
        if not self.done:
            self._finish(RequestEnd.CANCELLED)
        return []

    def _message(self) -> Message:
        raise NotImplementedError

    def _answer(self, result: int, accepted: bool, now: float) -> None:
        self._link.answered(self._tries, now - self._began_at)
        self.result = result
        self._finish(RequestEnd.ACCEPTED if accepted else RequestEnd.REFUSED)

    def _finish(self, end: RequestEnd) -> None:
        self.end = end
        self._deadline = NEVER


class Clear(_Request):
    """State machine that empties one list.

    By MISSION_CLEAR_ALL, or by announcing none: a MISSION_COUNT ends a transfer that was cut short,
    during which ArduPilot 4.6 refuses to clear for another 8 s.

    Parameters
    ----------
    kind
        Which of the autopilot's lists to empty.
    target
        The autopilot.
    announces_none
        Whether to announce none instead of clearing.
    """

    def __init__(
        self,
        kind: MissionKind,
        target: Address,
        *,
        link: LinkEstimate,
        announces_none: bool = False,
    ) -> None:
        super().__init__(link)
        self._kind = kind
        self._target = target
        self._announces_none = announces_none

    def _message(self) -> Message:
        if self._announces_none:
            return mav.MAVLink_mission_count_message(
                self._target.system, self._target.component, 0, self._kind
            )
        return mav.MAVLink_mission_clear_all_message(
            self._target.system, self._target.component, self._kind
        )

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Take in the acknowledgement."""
        if (
            not self.done
            and message.get_type() == "MISSION_ACK"
            and message.mission_type == self._kind
        ):
            self._answer(message.type, message.type == mav.MAV_MISSION_ACCEPTED, now)
        return []


class SetCurrent(_Request):
    """State machine that chooses the mission's next item (MISSION_SET_CURRENT).

    For autopilots that do not know the command of that name.

    Parameters
    ----------
    number
        The item, in the autopilot's own numbering.
    target
        The autopilot.
    limit_s
        After so many seconds it is given up.
    """

    def __init__(self, number: int, target: Address, *, link: LinkEstimate, limit_s: float) -> None:
        super().__init__(link)
        self._number = number
        self._target = target
        self._limit_s = limit_s

    def _message(self) -> Message:
        return mav.MAVLink_mission_set_current_message(
            self._target.system, self._target.component, self._number
        )

    def on_time(self, now: float) -> list[Message]:
        """Send it again, or give up."""
        if not self.done and now >= self._began_at + self._limit_s:
            self._finish(RequestEnd.SILENT)
        return super().on_time(now)

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Take in the number that the autopilot tells."""
        if (
            not self.done
            and message.get_type() == "MISSION_CURRENT"
            and message.seq == self._number
        ):
            self._answer(mav.MAV_RESULT_ACCEPTED, True, now)
        return []


class Command(_Request):
    """State machine that sends one COMMAND_LONG.

    A COMMAND_ACK tells which command it answers, but not which of two with other parameters: the
    late one of a repeated pause looks like that of a return. Where the heartbeat shows what was
    asked for, only that counts.

    Parameters
    ----------
    command
        MAV_CMD code.
    params
        Parameters 1 to 7; those left out are 0.
    target
        The autopilot.
    shown_by
        Says of a HEARTBEAT whether it shows what was asked for; None believes the acknowledgement.
    insists
        Whether it is sent again when it was acknowledged and the heartbeat does not show it.
    limit_s
        After so many seconds it is given up; None takes the patience of the link's policy.
    objection
        Called with the time before each sending; words say why it must not be sent (again).
    """

    # Heartbeats come once per second; one that left the vehicle before the change is no answer.
    _SHOWS_WITHIN_S = 2.5
    _SHOWS_AFTER_S = 0.5

    def __init__(
        self,
        command: int,
        params: tuple[float, ...],
        target: Address,
        *,
        link: LinkEstimate,
        shown_by: Callable[[Message], bool] | None = None,
        insists: bool = True,
        limit_s: float | None = None,
        objection: Callable[[float], str] = lambda _: "",
    ) -> None:
        super().__init__(link)
        self._command = command
        self._params = (*params, *(0.0,) * (7 - len(params)))
        self._target = target
        self._shown_by = shown_by
        self._insists = insists
        self._limit_s = limit_s
        self._objection = objection
        self._acknowledged_at = math.inf
        self.why = ""
        """Why it was withdrawn."""

    def _message(self) -> Message:
        return mav.MAVLink_command_long_message(
            self._target.system,
            self._target.component,
            self._command,
            min(self._tries - 1, 255),  # tells a repeated command from a new one
            *self._params,
        )

    @property
    def _acknowledged(self) -> bool:
        return math.isfinite(self._acknowledged_at)

    def _ask(self, now: float) -> list[Message]:
        self.why = self._objection(now)
        if self.why:
            self._finish(RequestEnd.WITHDRAWN)
            return []
        out = super()._ask(now)
        if self._acknowledged:
            self._deadline = now + self._SHOWS_WITHIN_S
        self._deadline = min(self._deadline, self._ends_at)
        return out

    @property
    def _ends_at(self) -> float:
        """When it is given up at the latest."""
        if self._limit_s is not None:
            return self._began_at + self._limit_s
        return self._began_at + self._link.policy.patience_s if self._acknowledged else NEVER

    def on_time(self, now: float) -> list[Message]:
        """Send the command again, or give up."""
        if self.done or now < self._deadline:
            return []
        if now >= self._ends_at:
            self._finish(RequestEnd.UNCHANGED if self._acknowledged else RequestEnd.SILENT)
            return []
        if self._acknowledged:
            if self._insists:
                return self._ask(now)
            self._deadline = self._ends_at
            return []
        return super().on_time(now)

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Take in the answer, or a heartbeat that shows what came of it."""
        if self.done:
            return []
        if message.get_type() == "HEARTBEAT":
            self._on_heartbeat(message, now)
        elif message.get_type() == "COMMAND_ACK" and message.command == self._command:
            self._on_ack(message.result, now)
        return []

    def _on_ack(self, result: int, now: float) -> None:
        if result == mav.MAV_RESULT_IN_PROGRESS:
            self._tries = 1
            self._deadline = min(now + self._link.policy.max_timeout, self._ends_at)
            return
        if result != mav.MAV_RESULT_ACCEPTED or self._shown_by is None:
            self._answer(result, result == mav.MAV_RESULT_ACCEPTED, now)
            return
        if not self._acknowledged:
            self._link.answered(self._tries, now - self._began_at)
            self.result = result
        self._acknowledged_at = now
        self._deadline = min(now + self._SHOWS_WITHIN_S, self._ends_at)

    def _on_heartbeat(self, message: Message, now: float) -> None:
        if self._shown_by is None or not self._acknowledged:
            return
        if self._shown_by(message):
            self._finish(RequestEnd.ACCEPTED)
        elif now >= self._acknowledged_at + self._SHOWS_AFTER_S and self._insists:
            self._deadline = now  # it did not happen: ask again at once
