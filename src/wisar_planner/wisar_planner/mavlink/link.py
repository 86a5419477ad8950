"""A connection that speaks MAVLink and comes back by itself."""

from __future__ import annotations

import select
import time
from collections.abc import Callable

from wisar_planner.mavlink.codec import Codec, Counters, Message, StreamDecoder
from wisar_planner.mavlink.transport import Transport, open_transport, parse_connection

_FIRST_RETRY_S = 0.2
_LONGEST_RETRY_S = 5.0


class Link:
    """MAVLink messages over one connection string.

    A connection that cannot be opened or is lost is tried again, with growing pauses.

    Parameters
    ----------
    connection
        See `transport.parse_connection`.
    codec
        Ids and signing.
    on_state
        Called with True when the connection is opened, False and the reason when it is lost.
    """

    def __init__(
        self,
        connection: str,
        codec: Codec,
        *,
        on_state: Callable[[bool, str], None] = lambda *_: None,
    ) -> None:
        parse_connection(connection)  # a mistake of the user is told at once
        self.connection = connection
        self._codec = codec
        self._on_state = on_state
        self._transport: Transport | None = None
        self._stream = StreamDecoder(codec)
        self._retry_at = 0.0
        self._retry_pause = _FIRST_RETRY_S
        self._said: str | None = None

    @property
    def counters(self) -> Counters:
        """What became of the bytes received."""
        return self._codec.counters

    def open(self) -> bool:
        """Open the connection if it is closed and it is time to try; return whether it is open.

        Nothing is raised: what is wrong is told by `on_state`, and it is tried again later.
        """
        if self._transport is not None:
            return True
        now = time.monotonic()
        if now < self._retry_at:
            return False
        try:
            self._transport = open_transport(self.connection)
        except OSError as error:
            self._lost(f"{self.connection}: {error.strerror or error}")
            return False
        except ValueError as error:  # a host that cannot be a name, a port without its driver
            self._lost(f"{self.connection}: {error}")
            return False
        self._stream = StreamDecoder(self._codec)
        self._retry_pause = _FIRST_RETRY_S
        self._said = None
        self._on_state(True, self.connection)
        return True

    def _lost(self, reason: str) -> None:
        if self._transport is not None:
            self._transport.close()
            self._transport = None
        self._retry_at = time.monotonic() + self._retry_pause
        self._retry_pause = min(2.0 * self._retry_pause, _LONGEST_RETRY_S)
        if reason != self._said:
            self._said = reason
            self._on_state(False, reason)

    def receive(self, timeout: float, wake: int | None = None) -> list[Message]:
        """Wait for messages.

        Parameters
        ----------
        timeout
            Longest wait in seconds.
        wake
            A descriptor that ends the wait when it becomes readable.
        """
        opened = self.open()
        waits = [fd for fd in (wake,) if fd is not None]
        if opened and self._transport is not None:
            waits.append(self._transport.fileno())
        else:
            timeout = min(timeout, max(self._retry_at - time.monotonic(), 0.0))
        try:
            readable, _, _ = select.select(waits, [], [], max(timeout, 0.0))
            if self._transport is None or self._transport.fileno() not in readable:
                return []
            received = self._transport.read()
        except OSError as error:
            self._lost(f"{self.connection}: {error.strerror or error}")
            return []
        messages: list[Message] = []
        for data, peer in received:
            if self._transport.is_stream:
                found = self._stream.decode(data)
            else:
                found, _ = self._codec.decode(data)
            if found:
                self._transport.trust(peer)
            messages.extend(found)
        return messages

    def send(self, message: Message) -> None:
        """Send a message, if the connection is open; a lost one is noticed by `receive`."""
        if self._transport is None:
            return
        try:
            self._transport.write(self._codec.encode(message))
        except OSError as error:
            self._lost(f"{self.connection}: {error.strerror or error}")

    def close(self) -> None:
        """Close the connection for good."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None
        self._retry_at = float("inf")
