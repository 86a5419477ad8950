"""Requests such as "clear the fence" or "start the mission", repeated until they are answered."""

from __future__ import annotations

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
    """State machine that empties one list (MISSION_CLEAR_ALL).

    Parameters
    ----------
    kind
        Which of the autopilot's lists to empty.
    target
        The autopilot.
    """

    def __init__(self, kind: MissionKind, target: Address, *, link: LinkEstimate) -> None:
        super().__init__(link)
        self._kind = kind
        self._target = target

    def _message(self) -> Message:
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


class Command(_Request):
    """State machine that sends one COMMAND_LONG.

    Parameters
    ----------
    command
        MAV_CMD code.
    params
        Parameters 1 to 7; those left out are 0.
    target
        The autopilot.
    """

    def __init__(
        self,
        command: int,
        params: tuple[float, ...],
        target: Address,
        *,
        link: LinkEstimate,
    ) -> None:
        super().__init__(link)
        self._command = command
        self._params = (*params, *(0.0,) * (7 - len(params)))
        self._target = target

    def _message(self) -> Message:
        return mav.MAVLink_command_long_message(
            self._target.system,
            self._target.component,
            self._command,
            min(self._tries - 1, 255),  # tells a repeated command from a new one
            *self._params,
        )

    def on_message(self, message: Message, now: float) -> list[Message]:
        """Take in the answer."""
        if self.done or message.get_type() != "COMMAND_ACK" or message.command != self._command:
            return []
        if message.result == mav.MAV_RESULT_IN_PROGRESS:
            self._tries = 1
            self._deadline = now + self._link.policy.max_timeout
        else:
            self._answer(message.result, message.result == mav.MAV_RESULT_ACCEPTED, now)
        return []
