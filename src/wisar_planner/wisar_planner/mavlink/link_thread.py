"""The thread that talks to one vehicle, and those who wait for what it does."""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from wisar_planner.mavlink.codec import Codec, Counters, Message, read_key_file
from wisar_planner.mavlink.exchange import Address, Exchange
from wisar_planner.mavlink.link import Link
from wisar_planner.mavlink.session import LinkStatus, Session, Slot
from wisar_planner.mavlink.vehicle import VehicleState

_LONGEST_WAIT_S = 0.25
_PUT_BACK_WITHIN_S = 3.0
_log = logging.getLogger(__name__)

_E = TypeVar("_E", bound=Exchange)


def guarded(callback: Callable[..., None]) -> Callable[..., None]:
    """Keep a mistake in somebody's callback from ending the conversation with the vehicle."""

    def call(*args: object) -> None:
        try:
            callback(*args)
        except Exception:
            _log.exception("a callback of the MAVLink client failed")

    return call


@dataclass
class _Job:
    """An exchange in progress, and who waits for it."""

    exchange: Exchange
    finished: Future[None]
    should_cancel: Callable[[], bool]

    def is_cancelled(self) -> bool:
        """Whether who waits wants no more; one who cannot be asked does not."""
        try:
            return self.should_cancel()
        except Exception:
            _log.exception("whether to cancel could not be asked; the exchange is cancelled")
            return True


@dataclass
class _Lane:
    """The exchanges of one slot: the one in progress, and those that follow it."""

    slot: Slot
    waiting: deque[_Job] = field(default_factory=deque)
    job: _Job | None = None


class LinkThread:
    """A session on a connection: one thread does all input and output.

    Exchanges of the same slot follow one another, those of different slots run side by side.

    Parameters
    ----------
    connection
        pymavlink connection string, see `transport.parse_connection`.
    address
        Own ids.
    target_system, target_component
        The vehicle's ids; None takes the first autopilot heard.
    key_file
        File with the signing key, see `codec.read_key_file`; None neither signs nor checks.
    on_link, on_vehicle, on_text
        See `client.MissionClient`.

    Raises
    ------
    InvalidInput
        If the connection string, an id or the key file cannot be right.
    """

    def __init__(
        self,
        connection: str,
        address: Address,
        *,
        target_system: int | None,
        target_component: int | None,
        key_file: Path | None,
        on_link: Callable[[LinkStatus], None],
        on_vehicle: Callable[[VehicleState], None],
        on_text: Callable[[int, str], None],
    ) -> None:
        key = None if key_file is None else read_key_file(key_file)
        self._heard = threading.Condition()
        self._on_link = guarded(on_link)
        self._session = Session(
            address,
            connection,
            target_system=target_system,
            target_component=target_component,
            on_link=self._link_changed,
            on_vehicle=guarded(on_vehicle),
            on_text=guarded(on_text),
        )
        self._connection = Link(
            connection,
            Codec(address.system, address.component, key=key),
            on_state=lambda opened, text: None if opened else self._session.connection_lost(text),
        )
        self._lanes = {slot: _Lane(slot) for slot in Slot}
        self._jobs_lock = threading.Lock()
        self._failure = ""
        self._ended = False
        self._closing = False
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        os.set_blocking(self._wake_write, False)
        self._thread = threading.Thread(target=self._run, name="mavlink", daemon=True)
        self._thread.start()

    @property
    def vehicle(self) -> VehicleState | None:
        """Latest snapshot of the vehicle; None before its first heartbeat."""
        return self._session.vehicle

    @property
    def status(self) -> LinkStatus:
        """Whether the vehicle can be talked to now."""
        return self._session.status

    @property
    def counters(self) -> Counters:
        """What became of the bytes received (dropped, unsigned, badly signed, ...)."""
        return replace(self._connection.counters)

    @property
    def connection(self) -> str:
        """The connection string."""
        return self._connection.connection

    @property
    def ended(self) -> bool:
        """Whether the thread has ended; no exchange can be carried out any more."""
        return self._ended

    @property
    def failure(self) -> str:
        """Why the thread ended by itself, in words; empty if it did not."""
        return self._failure

    def wait_until_heard(self, timeout: float) -> bool:
        """Wait until the vehicle has been heard or the thread has ended; False if neither."""
        session = self._session
        with self._heard:
            return self._heard.wait_for(lambda: session.status.connected or self._ended, timeout)

    def carry_out(
        self,
        exchange: _E,
        should_cancel: Callable[[], bool] = lambda: False,
        slot: Slot = Slot.TRANSFER,
    ) -> _E:
        """Carry out an exchange and wait for its end; once the thread has ended none begins."""
        job = _Job(exchange, Future(), should_cancel)
        with self._jobs_lock:
            if self._ended:
                job.finished.set_result(None)
            else:
                self._lanes[slot].waiting.append(job)
                self._wake()
        job.finished.result()
        return exchange

    def close(self) -> None:
        """End the thread and close the connection; a waiting call returns as cancelled.

        An old mission that has to be put back then has three seconds for it.
        """
        if self._closing:
            return
        self._closing = True
        self._wake()
        self._thread.join()
        with self._jobs_lock:  # nobody may wake a thread that has gone, by a number used anew
            os.close(self._wake_read)
            os.close(self._wake_write)
            self._wake_write = -1

    def _wake(self) -> None:
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self._wake_write, b"\0")

    def _run(self) -> None:
        try:
            self._serve(lambda: self._closing)
            for slot in self._lanes:
                self._send(self._session.cancel(time.monotonic(), slot))
            # An old mission that is being put back is put back before the connection closes.
            ends = time.monotonic() + _PUT_BACK_WITHIN_S
            self._serve(lambda: self._is_idle() or time.monotonic() >= ends)
        except Exception as error:
            _log.exception("the MAVLink connection ended because of an error of this program")
            self._failure = (
                f"the connection {self.connection} ended because of an error of this program "
                f"({type(error).__name__}: {error}); start it again"
            )
        with self._jobs_lock:
            self._ended = True
            lanes = self._lanes.values()
            left = [job for lane in lanes for job in (lane.job, *lane.waiting) if job is not None]
        if self._failure:
            self._session.ended(self._failure)
        for job in left:
            job.finished.set_result(None)
        self._connection.close()
        with self._heard:
            self._heard.notify_all()

    def _is_idle(self) -> bool:
        transfer = self._session.exchange
        return transfer is None or transfer.done

    def _serve(self, is_over: Callable[[], bool]) -> None:
        session, connection = self._session, self._connection
        while not is_over():
            now = time.monotonic()
            connection.open()
            for lane in self._lanes.values():
                self._begin_or_cancel(lane, now)
            self._send(session.tick(now))
            ended = [self._finish(lane) for lane in self._lanes.values()]
            if any(ended):
                continue
            wait = min(max(session.deadline - now, 0.0), _LONGEST_WAIT_S)
            for message in connection.receive(wait, self._wake_read):
                self._send(session.receive(message, time.monotonic()))
            self._drain_wake()

    def _begin_or_cancel(self, lane: _Lane, now: float) -> None:
        if lane.job is not None and lane.job.is_cancelled():
            self._send(self._session.cancel(now, lane.slot))
            self._finish(lane)
        if lane.job is None and lane.waiting and not self._closing:
            lane.job = lane.waiting.popleft()
            self._send(self._session.begin(lane.job.exchange, now, lane.slot))

    def _finish(self, lane: _Lane) -> bool:
        """Tell who waits that the exchange in progress has ended; return whether it has."""
        if lane.job is None or not lane.job.exchange.done:
            return False
        lane.job.finished.set_result(None)
        self._session.finish(lane.slot)
        lane.job = None
        return True

    def _drain_wake(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.read(self._wake_read, 4096)

    def _send(self, messages: list[Message]) -> None:
        for message in messages:
            self._connection.send(message)

    def _link_changed(self, status: LinkStatus) -> None:
        with self._heard:
            self._heard.notify_all()
        self._on_link(status)
