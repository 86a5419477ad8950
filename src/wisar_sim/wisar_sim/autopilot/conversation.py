"""A ground station and an autopilot that talk over a bad link, at simulated time."""

from __future__ import annotations

import math

from wisar_planner.mavlink.codec import Codec, Message
from wisar_planner.mavlink.exchange import Address, Exchange
from wisar_sim.autopilot.bad_link import BadLink, LinkFaults
from wisar_sim.autopilot.mission_server import Client, MissionServer


class Conversation:
    """Real frames, real state machines on both sides; only time and the wire are simulated.

    Parameters
    ----------
    server
        The autopilot's side.
    up, down
        The link to the autopilot, and back.
    ground, vehicle
        Ids of the two ends.

    Attributes
    ----------
    now
        Simulated time in seconds.
    """

    def __init__(
        self,
        server: MissionServer,
        up: BadLink,
        down: BadLink,
        *,
        ground: Address = Address(245, 190),  # noqa: B008 - immutable
        vehicle: Address = Address(1, 1),  # noqa: B008 - immutable
    ) -> None:
        self.server = server
        self.now = 0.0
        self._up = up
        self._down = down
        self._ground = Codec(ground.system, ground.component)
        self._vehicle = Codec(vehicle.system, vehicle.component)
        self.server.tick(self.now)

    def run(self, exchange: Exchange, *, until: float = math.inf) -> bool:
        """Start an exchange and let time pass.

        Parameters
        ----------
        exchange
            The ground station's side.
        until
            Simulated time at which to stop (as if the link were cut there).

        Returns
        -------
        bool
            Whether the exchange has ended.
        """
        self._send_up(exchange.start(self.now))
        return self.go_on(exchange, until=until)

    def cut(self) -> None:
        """Lose everything from now on, both ways, and what is under way as well."""
        self._up, self._down = (BadLink(LinkFaults(loss=1.0)) for _ in range(2))

    def go_on(self, exchange: Exchange, *, until: float = math.inf) -> bool:
        """Let time pass for an exchange that was started; see `run`."""
        while not exchange.done:
            after = min(
                exchange.deadline,
                self.server.deadline,
                self._up.next_arrival,
                self._down.next_arrival,
            )
            if after > until:
                self.now = until
                return False
            self.now = max(self.now, after)
            self._carry(exchange)
        return True

    def settle(self, seconds: float) -> None:
        """Let the autopilot alone: what is under way arrives, nothing more is sent."""
        end = self.now + seconds
        while True:
            after = min(self.server.deadline, self._up.next_arrival, self._down.next_arrival)
            if after > end:
                break
            self.now = max(self.now, after)
            self._carry(None)
        self.now = end

    def _carry(self, exchange: Exchange | None) -> None:
        for data in self._up.take(self.now):
            for message in self._vehicle.decode(data)[0]:
                client = Client(message.get_srcSystem(), message.get_srcComponent())
                self._send_down(self.server.handle(message, client, self.now))
        self._send_down(self.server.tick(self.now))
        for data in self._down.take(self.now):
            for message in self._ground.decode(data)[0]:
                if exchange is not None:
                    self._send_up(exchange.on_message(message, self.now))
        if exchange is not None:
            self._send_up(exchange.on_time(self.now))

    def _send_up(self, messages: list[Message]) -> None:
        for message in messages:
            self._up.put(self._ground.encode(message), self.now)

    def _send_down(self, messages: list[Message]) -> None:
        for message in messages:
            self._down.put(self._vehicle.encode(message), self.now)
