"""A link that loses, delays, repeats, reorders and damages what it carries."""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass, fields

import numpy as np

from wisar_planner.errors import InvalidInput


@dataclass(frozen=True)
class LinkFaults:
    """How bad a link is, in one direction.

    Parameters
    ----------
    loss, duplication, reordering, corruption
        Probability of each fault per frame, 0 to 1.
    delay_s, jitter_s
        Every frame is late by `delay_s` plus up to `jitter_s` seconds, uniformly.
    reorder_delay_s
        A reordered frame is late by up to this much more.
    """

    loss: float = 0.0
    duplication: float = 0.0
    reordering: float = 0.0
    corruption: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    reorder_delay_s: float = 0.1

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            most = float("inf") if one.name.endswith("_s") else 1.0
            if not 0.0 <= value <= most:
                raise InvalidInput(f"{one.name} must be from 0 to {most:g}, got {value}")


class BadLink:
    """One direction of a bad link, at any clock.

    Parameters
    ----------
    faults
        How bad it is.
    seed
        Same seed, same faults.
    """

    def __init__(self, faults: LinkFaults, seed: int = 0) -> None:
        self.faults = faults
        self._rng = np.random.default_rng(seed)
        self._flying: list[tuple[float, int, bytes]] = []
        self._order = itertools.count()

    def put(self, frame: bytes, now: float) -> None:
        """Send a frame into the link."""
        faults = self.faults
        lost, repeated, damaged, late, *jitter = self._rng.random(6)
        if lost < faults.loss:
            return
        copies = 2 if repeated < faults.duplication else 1
        for copy in range(copies):
            arrives = now + faults.delay_s + faults.jitter_s * jitter[copy]
            if late < faults.reordering and copy == 0:
                arrives += faults.reorder_delay_s * self._rng.random()
            carried = frame
            if damaged < faults.corruption and copy == 0:
                carried = self._damaged(frame)
            heapq.heappush(self._flying, (arrives, next(self._order), carried))

    def _damaged(self, frame: bytes) -> bytes:
        damaged = bytearray(frame)
        for _ in range(int(self._rng.integers(1, 4))):
            at = int(self._rng.integers(len(damaged)))
            damaged[at] ^= int(self._rng.integers(1, 256))
        if self._rng.random() < 0.2:
            del damaged[int(self._rng.integers(len(damaged))) :]
        return bytes(damaged)

    @property
    def next_arrival(self) -> float:
        """When the next frame comes out; infinity if none is under way."""
        return self._flying[0][0] if self._flying else float("inf")

    def take(self, now: float) -> list[bytes]:
        """Take out the frames that have arrived by now."""
        arrived = []
        while self._flying and self._flying[0][0] <= now:
            arrived.append(heapq.heappop(self._flying)[2])
        return arrived
