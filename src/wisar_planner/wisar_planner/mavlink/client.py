"""The one object that a node or a script needs: a vehicle at the other end of a connection."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from pymavlink.dialects.v20 import common as mav

from wisar_planner.mavlink.codec import Counters
from wisar_planner.mavlink.command import Command, RequestEnd, SetCurrent
from wisar_planner.mavlink.download import Download, DownloadEnd
from wisar_planner.mavlink.exchange import Address
from wisar_planner.mavlink.link_estimate import LinkEstimates, RetryPolicy
from wisar_planner.mavlink.link_thread import LinkThread, guarded
from wisar_planner.mavlink.mission import Mission, MissionItem, MissionKind
from wisar_planner.mavlink.modes import (
    Intent,
    commands_for,
    flies_by_itself,
    flies_mission,
    shown_by,
)
from wisar_planner.mavlink.outcome import UploadCode, UploadProgress, UploadResult
from wisar_planner.mavlink.session import LinkStatus, Slot
from wisar_planner.mavlink.transfer import MissionTransfer, lists_of
from wisar_planner.mavlink.vehicle import VehicleState
from wisar_planner.mavlink.wording import command_result, mission_result

# A late arming or start takes off when nobody expects it any more.
_ARMED_WITHIN_S = 3.0
_FRESH_S = 3.0  # a heartbeat older than this proves nothing
# PX4 checks a new mission for about a second, and denies its start until then.
_MISSION_CHECKED_WITHIN_S = 5.0
_START_AGAIN_AFTER_S = 1.0  # each refusal tells the pilot something

__all__ = ["LinkError", "LinkStatus", "MissionClient", "RefusedError"]


class LinkError(ConnectionError):
    """The vehicle did not answer, or refused; the message says what to do."""


class RefusedError(LinkError):
    """The vehicle answered, and refused."""


def _flies_its_mission(vehicle: VehicleState) -> bool:
    return vehicle.armed and flies_mission(
        vehicle.autopilot, vehicle.vehicle_type, vehicle.custom_mode
    )


class MissionClient:
    """A ground station's end of the conversation with one vehicle.

    One thread does all input and output; the methods may be called from any thread, and wait for
    their result. Transfers follow one another; requests to the vehicle go out beside them. `pause`
    and `return_to_launch` wait for nothing: a request still in progress is given up for them. Of
    the others only one is in progress at a time, further ones are refused. Nothing is ever armed,
    started or flown unless `arm`, `start_mission`, `resume`, `pause` or `return_to_launch` is
    called.

    Parameters
    ----------
    connection
        pymavlink connection string, see `transport.parse_connection`.
    system, component
        Own ids.
    target_system, target_component
        The vehicle's ids; None takes the first autopilot heard.
    key_file
        File with the signing key, see `codec.read_key_file`; None neither signs nor checks.
    policy
        Timeouts and retries.
    on_link
        Called with a `LinkStatus` when the vehicle appears or is lost.
    on_vehicle
        Called with a `VehicleState` on every position and mission progress message.
    on_text
        Called with MAV_SEVERITY and text for every status text of the vehicle, once it is complete.

    Callbacks run in the input-output thread and must return quickly.

    Raises
    ------
    InvalidInput
        If the connection string, an id or the key file cannot be right.

    Examples
    --------
    >>> with MissionClient("udpin:127.0.0.1:14550") as client:  # doctest: +SKIP
    ...     client.wait_heartbeat(10.0)
    ...     result = client.upload(mission)
    ...     print(result.verified, result.error)
    """

    def __init__(
        self,
        connection: str,
        *,
        system: int = 245,
        component: int = mav.MAV_COMP_ID_MISSIONPLANNER,
        target_system: int | None = None,
        target_component: int | None = None,
        key_file: Path | None = None,
        policy: RetryPolicy | None = None,
        on_link: Callable[[LinkStatus], None] = lambda _: None,
        on_vehicle: Callable[[VehicleState], None] = lambda _: None,
        on_text: Callable[[int, str], None] = lambda *_: None,
    ) -> None:
        self._links = LinkEstimates(policy)
        self._requesting = threading.Lock()
        self._urgent_lock = threading.Lock()
        self._urgent = 0, ""
        """How many requests waited for nothing so far, and the last one in words."""
        self._urgent_in_progress = 0
        self._uploading = threading.Lock()
        self._starting = False
        self._doubtful = False  # whether the last upload left a mission that nobody has verified
        self._unstarted = False  # whether a mission has been sent that was never flown since
        self._fence_ahead = False  # whether the fence may be newer than the mission
        self._uploaded_at = -math.inf

        def heard(vehicle: VehicleState) -> None:
            # Another ground station may have started it, or the answer to a start was lost.
            if _flies_its_mission(vehicle) and not self._uploading.locked():
                self._unstarted = False
            on_vehicle(vehicle)

        self._link = LinkThread(
            connection,
            Address(system, component),
            target_system=target_system,
            target_component=target_component,
            key_file=key_file,
            on_link=on_link,
            on_vehicle=heard,
            on_text=on_text,
        )

    # -- what is known -----------------------------------------------------------------------

    @property
    def vehicle(self) -> VehicleState | None:
        """Latest snapshot of the vehicle; None before its first heartbeat."""
        return self._link.vehicle

    @property
    def link_status(self) -> LinkStatus:
        """Whether the vehicle can be talked to now."""
        return self._link.status

    @property
    def counters(self) -> Counters:
        """What became of the bytes received (dropped, unsigned, badly signed, ...)."""
        return self._link.counters

    def wait_heartbeat(self, timeout: float = 10.0) -> VehicleState:
        """Wait until the vehicle has been heard.

        Raises
        ------
        LinkError
            If no heartbeat comes within `timeout` seconds.
        """
        if not self._link.wait_until_heard(timeout):
            raise LinkError(
                f"no heartbeat on {self._link.connection} within {timeout:g} s; check the "
                "connection string, the vehicle's power and, if a key file is used, its key"
            )
        if self.vehicle is None or self._link.ended:
            raise LinkError(self._gone)
        return self.vehicle

    # -- missions ------------------------------------------------------------------------------

    def upload(
        self,
        mission: Mission,
        *,
        on_progress: Callable[[UploadProgress], None] = lambda _: None,
        should_cancel: Callable[[], bool] = lambda: False,
        kinds: Sequence[MissionKind] | None = None,
        clear_old: bool = False,
    ) -> UploadResult:
        """Put a mission on the vehicle, read it back and compare. Never raises for the link.

        A vehicle that is flying its mission would fly the new one at once: that is refused, as is
        what its family of autopilots is known not to take.

        Parameters
        ----------
        mission
            What to put there.
        on_progress
            Called on every item.
        should_cancel
            Asked a few times per second; True ends the upload politely.
        kinds
            Lists to touch, of which empty ones are deleted on the vehicle; the others stay as they
            are. None takes the mission's flight, and its fence and rally points if it has any.
        clear_old
            Where `kinds` is None: whether a fence and rally points that the mission does not have
            are deleted on the vehicle.

        Returns
        -------
        UploadResult
            Only `verified` means that the new mission counts.
        """
        kinds = lists_of(mission, clear_old=clear_old) if kinds is None else kinds
        total = sum(len(mission.of_kind(k)) for k in kinds)
        if not self._uploading.acquire(blocking=False):
            return UploadResult(
                UploadCode.BUSY,
                "another upload is in progress; wait for it or cancel it",
                items_total=total,
            )
        try:
            state, status = self.vehicle, self.link_status
            if state is None or not status.connected:
                return UploadResult(
                    UploadCode.NO_LINK,
                    f"no vehicle to talk to: {status.text}",
                    items_total=total,
                )
            why = ""
            if MissionKind.MISSION in kinds:
                why = state.dialect.refusal_of(mission) or self._against_uploading()
            if why:
                return UploadResult(UploadCode.REFUSED_BEFORE, why, items_total=total)
            transfer = MissionTransfer(
                mission,
                self._target(state),
                state.dialect,
                kinds=kinds,
                links=self._links,
                on_progress=guarded(on_progress),
                objection=self._against_uploading,
                old_is_mixture=self._doubtful,
            )
            self._link.carry_out(transfer, should_cancel)
            transfer.abandon(time.monotonic())
            result = transfer.result
            assert result is not None
            if failure := self._link.failure:
                result = replace(
                    result, code=UploadCode.NO_LINK, error=f"{failure}; {result.error}"
                )
            if MissionKind.MISSION in kinds and not result.old_counts:
                self._doubtful = not result.verified
                self._unstarted = True
            self._fence_ahead = not result.verified and (self._fence_ahead or result.fence_touched)
            self._uploaded_at = time.monotonic()
            return result
        finally:
            self._uploading.release()

    def download(
        self,
        kind: MissionKind = MissionKind.MISSION,
        *,
        on_progress: Callable[[int], None] = lambda _: None,
        should_cancel: Callable[[], bool] = lambda: False,
    ) -> tuple[MissionItem, ...]:
        """Read one of the vehicle's lists (on ArduPilot without the home item).

        Raises
        ------
        LinkError
            If the vehicle does not answer or refuses, or if the download is cancelled.
        """
        state = self._require_vehicle()
        download = self._link.carry_out(
            Download(
                kind,
                self._target(state),
                link=self._links.asking,
                on_progress=guarded(on_progress),
            ),
            should_cancel,
        )
        if download.end is not DownloadEnd.COMPLETE:
            words = self._gone
            if download.end is not None:
                words = download.end.value
            if download.result is not None:
                words = mission_result(download.result)
            raise LinkError(f"reading the {kind.name.lower()} list failed: {words}")
        return state.dialect.from_wire(kind, download.items)

    def changes_since(self, mission: Mission) -> tuple[str, ...]:
        """Read the vehicle's flight back and say how it differs from a mission uploaded before.

        Another ground station may have put something else there, or it is another vehicle.

        Returns
        -------
        tuple of str
            See `Dialect.differences`; empty if the vehicle holds that mission.

        Raises
        ------
        LinkError
            See `download`.
        """
        found = self.download(MissionKind.MISSION)
        dialect = self._require_vehicle().dialect
        return dialect.differences(MissionKind.MISSION, mission.of_kind(MissionKind.MISSION), found)

    # -- explicit requests to the vehicle ------------------------------------------------------

    def arm(self) -> None:
        """Arm the motors.

        A vehicle may still be in the mode of an earlier flight: a copter of ArduPilot, which cannot
        be armed in it, is put into GUIDED first, PX4, which would fly off at once, into hold.
        Others are not armed in a mode in which they would fly off.

        Raises
        ------
        LinkError
            If the mode is such a one, or the vehicle refuses or is not armed within three seconds.
        """
        if self._require_vehicle().armed:
            return  # above all, no change of mode in flight
        with self._asking("ARM") as check:
            self._request("ARM", Intent.ARM, check, self._against_arming)

    def disarm(self) -> None:
        """Stop the motors; vehicles refuse it in the air."""
        with self._asking("DISARM") as check:
            self._request("DISARM", Intent.DISARM, check)

    def start_mission(self) -> None:
        """Fly the mission from its first item.

        The vehicle must be armed; one that is not is not even asked, as PX4 would arm by itself.
        Just after an upload a refusal is not believed at once: PX4 checks the mission first.

        Raises
        ------
        LinkError
            If the vehicle is not armed, refuses or does not answer within three seconds (in the
            air: to each of the steps that it takes there), or an upload is in progress, or the
            last one left a mission that was not verified.
        """
        words = "start of the mission"
        state = self._require_vehicle()
        if not state.armed:
            raise LinkError(f"{words}: the vehicle is not armed; arm it first")
        with self._asking(words) as check, self._as_starting():
            if state.dialect.start_goes_on and not state.landed:
                self._go_to_first_item(words, state, check)
            deadline = self._uploaded_at + _MISSION_CHECKED_WITHIN_S
            while True:
                try:
                    self._request(words, Intent.START, check, self._against_starting)
                except RefusedError:
                    if time.monotonic() >= deadline:
                        raise
                    time.sleep(_START_AGAIN_AFTER_S)
                else:
                    self._unstarted = False
                    return

    def pause(self) -> None:
        """Stop and hold the position; a request still in progress is given up for it."""
        with self._asking("pause", urgent=True) as check:
            self._request("pause", Intent.PAUSE, check)

    def resume(self) -> None:
        """Go on with the mission from where it was paused.

        On the ground this would make the next arming a takeoff, so that it is refused there. So it
        is where another mission was uploaded during the pause: ArduPilot would go on with the item
        of the same number, and leave out those before.

        Raises
        ------
        LinkError
            If the vehicle is not armed or not in the air, refuses or does not answer, an upload is
            in progress, or the mission was uploaded since and has to be started.
        """
        with self._asking("resume") as check, self._as_starting():
            self._request("resume", Intent.RESUME, check, self._against_resuming)

    def return_to_launch(self) -> None:
        """Fly home and land; a request still in progress is given up for it."""
        with self._asking("return to launch", urgent=True) as check:
            self._request("return to launch", Intent.RETURN, check)

    @contextlib.contextmanager
    def _asking(self, words: str, *, urgent: bool = False) -> Iterator[Callable[[], None]]:
        """Make a request to the vehicle.

        Parameters
        ----------
        words
            What is asked for.
        urgent
            Whether it waits for no other request: the others are given up for it.

        Yields
        ------
        callable
            To be called before each step; raises LinkError when the request is to be given up.
        """
        with self._urgent_lock:
            if urgent:
                self._urgent = self._urgent[0] + 1, words
                self._urgent_in_progress += 1
            mine = self._urgent[0]
            # Topics and services keep no order: a late `resume` must not undo a return under way.
            refused = not urgent and self._urgent_in_progress > 0
        if refused or (not urgent and not self._requesting.acquire(blocking=False)):
            raise LinkError(
                f"{words}: another request to the vehicle is in progress; wait for its answer"
            )

        def check() -> None:
            number, latest = self._urgent
            if number != mine:
                raise LinkError(f"{words}: given up, as {latest} was asked for")

        try:
            yield check
        finally:
            if urgent:
                with self._urgent_lock:
                    self._urgent_in_progress -= 1
            else:
                self._requesting.release()

    @contextlib.contextmanager
    def _as_starting(self) -> Iterator[None]:
        self._starting = True
        try:
            yield
        finally:
            self._starting = False

    # What speaks against sending something now, in words; asked before each (re)sending.

    def _against_uploading(self) -> str:
        vehicle = self.vehicle
        if self._starting:
            return "a start of the mission is in progress; wait for its answer, then call pause"
        if vehicle is not None and _flies_its_mission(vehicle):
            return (
                "the vehicle is flying its mission and would fly the new one at once; call pause "
                "first, then upload"
            )
        return ""

    def _against_starting(self, now: float) -> str:
        vehicle = self.vehicle
        if self._uploading.locked():
            return "an upload is in progress; wait for its end"
        if self._doubtful:
            return (
                "the last upload did not end verified, and the vehicle may hold anything; upload "
                "again first"
            )
        if self._fence_ahead:
            return (
                "the last upload ended between fence and mission: the fence is new and the mission "
                "old; upload again first"
            )
        if vehicle is None or now - vehicle.heard_at > _FRESH_S:
            return f"no heartbeat for {_FRESH_S:g} s; check the link, then start again"
        return "" if vehicle.armed else "the vehicle is no longer armed; start again"

    def _against_resuming(self, now: float) -> str:
        vehicle = self.vehicle
        if vehicle is not None and not vehicle.armed:
            return "the vehicle is not armed; arm it, then call start_mission"
        if vehicle is not None and vehicle.landed:
            return "the vehicle is on the ground; call start_mission"
        why = self._against_starting(now)
        if not why and self._unstarted:
            return "a new mission was uploaded since; call start_mission"
        return why

    def _against_arming(self, now: float) -> str:
        vehicle = self.vehicle
        if vehicle is None or now - vehicle.heard_at > _FRESH_S:
            return f"no heartbeat for {_FRESH_S:g} s; check the link, then arm again"
        if flies_by_itself(vehicle.autopilot, vehicle.vehicle_type, vehicle.custom_mode):
            return (
                "the vehicle is in a mode (mission, takeoff or return) in which it would fly off "
                "at once; call pause first"
            )
        return ""

    def _request(
        self,
        words: str,
        intent: Intent,
        check: Callable[[], None],
        objection: Callable[[float], str] = lambda _: "",
    ) -> None:
        """Ask for one intent, step by step, for as long as `check` raises nothing.

        `objection` says in words what speaks against sending at a time, see `Command`.
        """
        state = self._require_vehicle()
        steps = commands_for(intent, state.autopilot, state.vehicle_type, state.custom_mode)
        # For all steps together, as the first may take its time on a slow link.
        until = time.monotonic() + _ARMED_WITHIN_S
        is_limited = intent in (Intent.ARM, Intent.START)
        for code, params in steps:
            makes_armable = intent is Intent.ARM and code == mav.MAV_CMD_DO_SET_MODE
            command = Command(
                code,
                params,
                self._target(state),
                link=self._links.asking,
                shown_by=shown_by(code, params, state.autopilot, state.vehicle_type),
                # A start that was heard begins the mission anew each time it is sent.
                insists=code != mav.MAV_CMD_MISSION_START,
                limit_s=max(0.0, until - time.monotonic()) if is_limited else None,
                objection=(lambda _: "") if makes_armable else objection,
            )
            self._ask(words, command, check)

    def _go_to_first_item(self, words: str, state: VehicleState, check: Callable[[], None]) -> None:
        """Make the first item of the mission the current one."""
        number = 1 if state.dialect.home_item else 0
        command = Command(
            mav.MAV_CMD_DO_SET_MISSION_CURRENT,
            (float(number),),
            self._target(state),
            link=self._links.asking,
            limit_s=_ARMED_WITHIN_S,
            objection=self._against_starting,
        )
        try:
            self._ask(words, command, check)
        except RefusedError:
            if command.result != mav.MAV_RESULT_UNSUPPORTED:
                raise
            older = SetCurrent(
                number, self._target(state), link=self._links.asking, limit_s=_ARMED_WITHIN_S
            )
            self._ask(words, older, check)

    def _ask(self, words: str, request: Command | SetCurrent, check: Callable[[], None]) -> None:
        """Send one request of `words`; raise LinkError unless it is done."""

        def is_given_up() -> bool:
            try:
                check()
            except LinkError:
                return True
            return False

        check()
        self._link.carry_out(request, is_given_up, Slot.COMMAND)
        check()
        if request.end is RequestEnd.ACCEPTED:
            return
        if request.end is RequestEnd.REFUSED and request.result is not None:
            text = "" if self.vehicle is None else self.vehicle.text
            said = f" (the vehicle says: {text})" if text else ""
            raise RefusedError(f"{words}: {command_result(request.result)}{said}")
        if request.end is None or request.end is RequestEnd.CANCELLED:
            raise LinkError(f"{words}: {self._gone}")
        if request.end is RequestEnd.WITHDRAWN and isinstance(request, Command):
            raise LinkError(f"{words}: {request.why}")
        if request.end is RequestEnd.UNCHANGED:
            raise LinkError(
                f"{words}: the vehicle acknowledged, but its heartbeat does not show it; look "
                "at the vehicle, then ask again"
            )
        raise LinkError(f"{words}: the vehicle does not answer; check the link")

    # -- life ----------------------------------------------------------------------------------

    def close(self) -> None:
        """End the thread and close the connection; a waiting call returns as cancelled.

        An old mission that has to be put back then has three seconds for it.
        """
        self._link.close()

    def __enter__(self) -> MissionClient:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    # -- inside --------------------------------------------------------------------------------

    @property
    def _gone(self) -> str:
        """Why nothing can be asked any more."""
        return self._link.failure or "the client was closed"

    def _require_vehicle(self) -> VehicleState:
        vehicle, status = self.vehicle, self.link_status
        if vehicle is None or not status.connected:
            raise LinkError(f"no vehicle to talk to: {status.text}")
        return vehicle

    @staticmethod
    def _target(state: VehicleState) -> Address:
        return Address(state.system, state.component)
