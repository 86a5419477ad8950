"""The simulated autopilot on a real connection, over a link as bad as wanted."""

from __future__ import annotations

import json
import select
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from wisar_planner.mavlink.codec import Codec, Message, StreamDecoder
from wisar_planner.mavlink.transport import Peer, Transport
from wisar_sim.autopilot.autopilot import Autopilot
from wisar_sim.autopilot.bad_link import BadLink
from wisar_sim.autopilot.mission_server import StoredItem

_TICK_S = 0.02


def save_lists(path: Path, autopilot: Autopilot) -> None:
    """Write mission, fence and rally points to a file."""
    lists = {
        str(kind): [asdict(item) for item in items]
        for kind, items in autopilot.missions.lists.items()
    }
    path.write_text(json.dumps(lists), encoding="utf-8")


def load_lists(path: Path, autopilot: Autopilot) -> None:
    """Read what `save_lists` wrote; a missing file leaves the lists empty."""
    if not path.exists():
        return
    for kind, rows in json.loads(path.read_text(encoding="utf-8")).items():
        items = tuple(StoredItem(**{**row, "params": tuple(row["params"])}) for row in rows)
        autopilot.missions.lists[int(kind)] = items
    autopilot.vehicle.load(autopilot.missions.flight_items)


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
        """Serve until `should_stop` says so. Raises OSError when the connection is lost."""
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
            for frame in self._down.take(now):
                self._transport.write(frame)
            self._save()

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
