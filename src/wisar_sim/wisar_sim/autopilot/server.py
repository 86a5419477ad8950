"""The simulated autopilot on a real connection, over a link as bad as wanted."""

from __future__ import annotations

import select
import time
from collections.abc import Callable
from pathlib import Path

from wisar_planner.mavlink.codec import Codec, Message, StreamDecoder
from wisar_planner.mavlink.transport import Peer, Transport
from wisar_sim.autopilot.autopilot import Autopilot
from wisar_sim.autopilot.bad_link import BadLink
from wisar_sim.autopilot.storage import save_lists

_TICK_S = 0.02


class Server:
    """Moves frames between a connection and an autopilot.

    Parameters
    ----------
    autopilot
        The logic.
    transport
        The open connection; all clients share it.
    codec
        Ids and signing.
    up, down
        The link from the clients to the autopilot, and back.
    storage
        File in which the lists survive a restart.
    """

    def __init__(
        self,
        autopilot: Autopilot,
        transport: Transport,
        codec: Codec,
        *,
        up: BadLink,
        down: BadLink,
        storage: Path | None = None,
    ) -> None:
        self._autopilot = autopilot
        self._transport = transport
        self._codec = codec
        self._stream = StreamDecoder(codec)
        self._up = up
        self._down = down
        self._storage = storage
        self._lists_saved = dict(autopilot.missions.lists)
        self._last_peer: Peer = None

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Serve until `should_stop` says so.

        Raises
        ------
        InvalidInput
            When the lists cannot be stored.
        OSError
            When the connection is lost.
        """
        next_tick = 0.0
        while not should_stop():
            now = time.monotonic()
            if now >= next_tick:
                next_tick = now + _TICK_S
                self._send(self._autopilot.tick(now), now)
            arrival = min(self._up.next_arrival, self._down.next_arrival, next_tick)
            wait = min(max(arrival - now, 0.0), _TICK_S)
            readable, _, _ = select.select([self._transport.fileno()], [], [], wait)
            now = time.monotonic()
            if readable:
                for data, peer in self._transport.read():
                    self._last_peer = peer
                    self._up.put(data, now)
            for data in self._up.take(now):
                self._receive(data, now)
            self._save()  # before a client hears that its mission was accepted
            for frame in self._down.take(now):
                self._transport.write(frame)

    def _receive(self, data: bytes, now: float) -> None:
        if self._transport.is_stream:
            messages = self._stream.decode(data)
        else:
            messages, _ = self._codec.decode(data)
        if messages:
            self._transport.trust(self._last_peer)
        for message in messages:
            self._send(self._autopilot.receive(message, now), now)

    def _send(self, messages: list[Message], now: float) -> None:
        for message in messages:
            self._down.put(self._codec.encode(message), now)

    def _save(self) -> None:
        if self._storage is not None and self._lists_saved != self._autopilot.missions.lists:
            self._lists_saved = dict(self._autopilot.missions.lists)
            save_lists(self._storage, self._autopilot)
