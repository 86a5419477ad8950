"""Ways to carry bytes: UDP, TCP and serial, named by pymavlink's connection strings."""

from __future__ import annotations

import contextlib
import importlib
import socket
import time
from collections.abc import Callable
from typing import Any, Protocol

from wisar_planner.errors import InvalidInput

_LARGEST_DATAGRAM = 65_535
_READ_BYTES = 4_096
_READS_PER_CALL = 256
_PEER_FORGOTTEN_AFTER_S = 30.0
_MOST_PEERS = 32
_CONNECT_TIMEOUT_S = 2.0
DEFAULT_BAUD = 57_600

Peer = Any
"""Where bytes came from: an address, or None where there is only one other end."""


class Transport(Protocol):
    """One open connection; reading and writing never block."""

    is_stream: bool

    def fileno(self) -> int:
        """Return the descriptor to wait on."""

    def read(self) -> list[tuple[bytes, Peer]]:
        """Return what has arrived, at once. Raises OSError when the connection is lost."""

    def write(self, data: bytes) -> None:
        """Send to every known peer. Raises OSError when the connection is lost."""

    def trust(self, peer: Peer) -> None:
        """Note that a valid message came from this peer, so that answers go there."""

    def close(self) -> None:
        """Close the connection."""


class UdpTransport:
    """UDP, listening (answers go to those who were heard) or talking to a fixed address.

    Parameters
    ----------
    host, port
        Own address when listening, the other end's otherwise. Port 0 listens on any free one.
    listen
        Which of the two.
    """

    is_stream = False

    def __init__(self, host: str, port: int, *, listen: bool) -> None:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_DGRAM, flags=socket.AI_PASSIVE if listen else 0
        )[0]
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)
        self._listen = listen
        self._peers: dict[Peer, float] = {}
        try:
            if listen:
                self._socket.bind(address)
            else:
                self._socket.connect(address)
        except OSError:
            self._socket.close()
            raise

    @property
    def port(self) -> int:
        """The own port."""
        return int(self._socket.getsockname()[1])

    def fileno(self) -> int:
        """Return the descriptor to wait on."""
        return self._socket.fileno()

    def read(self) -> list[tuple[bytes, Peer]]:
        """Return the datagrams that have arrived, with their senders."""
        datagrams: list[tuple[bytes, Peer]] = []
        for _ in range(_READS_PER_CALL):
            try:
                datagrams.append(self._socket.recvfrom(_LARGEST_DATAGRAM))
            except BlockingIOError:
                break
            except ConnectionRefusedError:
                continue  # nobody listens there yet; UDP tells it on the next call
        return datagrams

    def write(self, data: bytes) -> None:
        """Send to the fixed address, or to every peer heard lately."""
        if not self._listen:
            self._send(lambda: self._socket.send(data))
            return
        now = time.monotonic()
        for peer, heard in list(self._peers.items()):
            if now - heard > _PEER_FORGOTTEN_AFTER_S:
                del self._peers[peer]
            else:
                self._send(lambda to=peer: self._socket.sendto(data, to))  # type: ignore[misc]

    @staticmethod
    def _send(send: Callable[[], object]) -> None:
        # What cannot be sent now is lost, as on any bad link; the protocol sends again.
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            send()

    def trust(self, peer: Peer) -> None:
        """Note that a valid message came from this peer, so that answers go there."""
        if self._listen and (peer in self._peers or len(self._peers) < _MOST_PEERS):
            self._peers[peer] = time.monotonic()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpTransport:
    """TCP, as the client of a listening autopilot or as a server for one other end."""

    is_stream = True

    def __init__(self, host: str, port: int, *, listen: bool) -> None:
        self._listener: socket.socket | None = None
        self._stream: socket.socket | None = None
        if listen:
            self._listener = socket.create_server((host, port))
            self._listener.setblocking(False)
        else:
            self._stream = socket.create_connection((host, port), timeout=_CONNECT_TIMEOUT_S)
            self._prepare(self._stream)
        self._unsent = bytearray()

    @staticmethod
    def _prepare(stream: socket.socket) -> None:
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    @property
    def port(self) -> int:
        """The own port."""
        own = self._listener or self._stream
        return int(own.getsockname()[1]) if own is not None else 0

    def fileno(self) -> int:
        """Return the descriptor to wait on."""
        own = self._stream or self._listener
        if own is None:
            raise ConnectionError("the connection is closed")
        return own.fileno()

    def read(self) -> list[tuple[bytes, Peer]]:
        """Return the bytes that have arrived; a server takes the next caller when one leaves."""
        if self._stream is None:
            if self._listener is None:
                raise ConnectionError("the connection is closed")
            try:
                self._stream, _ = self._listener.accept()
            except BlockingIOError:
                return []
            self._prepare(self._stream)
        try:
            data = self._stream.recv(_READ_BYTES * 16)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop()
            return []
        return [(data, None)]

    def _drop(self) -> None:
        if self._stream is not None:
            self._stream.close()
        self._stream = None
        self._unsent.clear()
        if self._listener is None:
            raise ConnectionError("the other end closed the connection")

    def write(self, data: bytes) -> None:
        """Send, keeping whole what the socket does not take at once."""
        if self._stream is None:
            return
        if len(self._unsent) > _LARGEST_DATAGRAM:
            self._unsent.clear()  # the other end does not read; behave like a bad link
            self._drop()
            return
        self._unsent += data
        try:
            sent = self._stream.send(self._unsent)
        except BlockingIOError:
            return
        except OSError:
            self._drop()
            return
        del self._unsent[:sent]

    def trust(self, peer: Peer) -> None:
        """There is only one other end."""

    def close(self) -> None:
        """Close the sockets."""
        for own in (self._stream, self._listener):
            if own is not None:
                own.close()
        self._stream = self._listener = None


class SerialTransport:
    """A serial port, by way of pyserial."""

    is_stream = True

    def __init__(self, device: str, baud: int) -> None:
        try:
            serial: Any = importlib.import_module("serial")
        except ImportError:
            raise InvalidInput(
                "connection: a serial port needs the package pyserial; install it or use UDP or TCP"
            ) from None
        try:
            self._port = serial.Serial(device, baud, timeout=0, write_timeout=0)
        except ValueError as error:
            raise InvalidInput(f"connection: {error}") from None

    def fileno(self) -> int:
        """Return the descriptor to wait on."""
        return int(self._port.fileno())

    def read(self) -> list[tuple[bytes, Peer]]:
        """Return the bytes that have arrived. Raises OSError when the port has gone."""
        data = self._port.read(_READ_BYTES)
        return [(bytes(data), None)] if data else []

    def write(self, data: bytes) -> None:
        """Send what the port takes; a full buffer loses the rest, as on any bad link."""
        self._port.write(data)

    def trust(self, peer: Peer) -> None:
        """There is only one other end."""

    def close(self) -> None:
        """Close the port."""
        self._port.close()


def parse_connection(text: str) -> tuple[str, str, int]:
    """Split a connection string into kind, host or device, and port or baud rate.

    Parameters
    ----------
    text
        ``udpin:HOST:PORT`` or ``udp:HOST:PORT`` (listen), ``udpout:HOST:PORT``,
        ``tcp:HOST:PORT``, ``tcpin:HOST:PORT`` (listen), ``serial:DEVICE[:BAUD]`` or
        ``/dev/DEVICE[,BAUD]``. ``//`` after the first colon is allowed.

    Raises
    ------
    InvalidInput
        If the text is none of these.
    """
    kind, _, rest = text.partition(":")
    rest = rest.removeprefix("//")
    if text.startswith("/dev/"):
        device, _, baud = text.partition(",")
        return "serial", device, _number(text, baud or str(DEFAULT_BAUD), 1, 10_000_000)
    if kind == "serial" and rest:
        device, _, baud = rest.partition(":")
        return "serial", device, _number(text, baud or str(DEFAULT_BAUD), 1, 10_000_000)
    if kind in ("udp", "udpin", "udpout", "tcp", "tcpin"):
        host, _, port = rest.rpartition(":")
        if host:
            return kind, host.strip("[]"), _number(text, port, 0, 65_535)
    raise InvalidInput(
        f"connection: cannot understand {text!r}; use for example udpin:127.0.0.1:14550, "
        "udpout:HOST:PORT, tcp:HOST:PORT or serial:/dev/ttyUSB0:57600"
    )


def _number(text: str, digits: str, low: int, high: int) -> int:
    if digits.isdecimal() and low <= int(digits) <= high:
        return int(digits)
    raise InvalidInput(
        f"connection: {digits!r} in {text!r} must be a whole number from {low} to {high}"
    )


def open_transport(connection: str) -> Transport:
    """Open a connection.

    Raises
    ------
    InvalidInput
        If the connection string cannot be understood.
    OSError
        If the connection cannot be opened now.
    """
    kind, where, number = parse_connection(connection)
    if kind == "serial":
        return SerialTransport(where, number)
    if kind in ("tcp", "tcpin"):
        return TcpTransport(where, number, listen=kind == "tcpin")
    return UdpTransport(where, number, listen=kind != "udpout")
