"""Connections by name, and bytes across them."""

import os
import select
import socket
import time

import pytest
from pymavlink.dialects.v20 import common as mav

from wisar_planner.errors import InvalidInput
from wisar_planner.mavlink.codec import Codec
from wisar_planner.mavlink.link import Link
from wisar_planner.mavlink.transport import (
    TcpTransport,
    UdpTransport,
    open_transport,
    parse_connection,
)


def wait_read(transport, timeout=5.0):
    readable, _, _ = select.select([transport.fileno()], [], [], timeout)
    assert readable, "nothing arrived"
    return transport.read()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("udpin:127.0.0.1:14550", ("udpin", "127.0.0.1", 14550)),
        ("udp:0.0.0.0:1", ("udp", "0.0.0.0", 1)),
        ("udpout://host:65535", ("udpout", "host", 65535)),
        ("tcp:[::1]:5760", ("tcp", "::1", 5760)),
        ("tcpin:127.0.0.1:0", ("tcpin", "127.0.0.1", 0)),
        ("/dev/ttyUSB0", ("serial", "/dev/ttyUSB0", 57600)),
        ("/dev/ttyACM0,115200", ("serial", "/dev/ttyACM0", 115200)),
        ("serial:/dev/ttyUSB0:921600", ("serial", "/dev/ttyUSB0", 921600)),
    ],
)
def test_connection_strings(text, parts):
    assert parse_connection(text) == parts


@pytest.mark.parametrize(
    "text", ["", "udp", "udp:host", "udp::1", "udpin:host:99999", "udpin:host:x", "serial:/d:-1"]
)
def test_wrong_connection_strings_are_refused(text):
    with pytest.raises(InvalidInput, match="connection"):
        parse_connection(text)


def test_udp_answers_those_it_trusts():
    server = UdpTransport("127.0.0.1", 0, listen=True)
    client = UdpTransport("127.0.0.1", server.port, listen=False)
    client.write(b"hello")
    ((data, peer),) = wait_read(server)
    assert data == b"hello"
    server.write(b"lost")  # nobody is trusted yet
    server.trust(peer)
    server.write(b"answer")
    assert wait_read(client) == [(b"answer", ("127.0.0.1", server.port))]
    client.close()
    server.close()


def test_udp_to_nobody_is_a_bad_link_not_an_error():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    client = UdpTransport("127.0.0.1", port, listen=False)
    for _ in range(5):
        client.write(b"anybody?")
        time.sleep(0.01)
        assert client.read() == []
    client.close()


def test_tcp_serves_one_client_after_the_other():
    server = TcpTransport("127.0.0.1", 0, listen=True)
    for n in range(2):
        client = TcpTransport("127.0.0.1", server.port, listen=False)
        client.write(b"hello")
        deadline = time.monotonic() + 5.0
        got = []
        while not got and time.monotonic() < deadline:
            got = wait_read(server)
        assert got == [(b"hello", None)]
        server.write(b"answer %d" % n)
        assert wait_read(client) == [(b"answer %d" % n, None)]
        client.close()
        while server.read() or time.monotonic() > deadline:
            pass
    server.close()


def test_serial_carries_bytes_both_ways():
    pytest.importorskip("serial")
    ours, theirs = os.openpty()
    port = open_transport(f"serial:{os.ttyname(theirs)}:57600")
    port.write(b"out")
    assert os.read(ours, 10) == b"out"
    os.write(ours, b"in")
    assert wait_read(port) == [(b"in", None)]
    port.close()
    os.close(ours)
    os.close(theirs)


# -- the link on top -----------------------------------------------------------------------------


def pump(link, seconds, enough):
    deadline = time.monotonic() + seconds
    messages = []
    while time.monotonic() < deadline and not enough(messages):
        messages += link.receive(0.05)
    return messages


def test_a_lost_tcp_connection_comes_back_and_both_are_told():
    states = []
    server = TcpTransport("127.0.0.1", 0, listen=True)
    port = server.port
    link = Link(f"tcp:127.0.0.1:{port}", Codec(1, 1), on_state=lambda up, text: states.append(up))
    pump(link, 5.0, lambda _: states == [True])
    server.close()
    pump(link, 5.0, lambda _: False in states)
    assert states == [True, False]
    server = TcpTransport("127.0.0.1", port, listen=True)
    pump(link, 5.0, lambda _: states[-1] is True)
    assert states == [True, False, True]
    frame = Codec(7, 7).encode(mav.MAVLink_mission_current_message(3))
    deadline = time.monotonic() + 5.0
    found = []
    while not found and time.monotonic() < deadline:
        server.read()
        server.write(frame)
        found = link.receive(0.05)
    assert found[0].seq == 3
    link.close()
    server.close()


def test_a_connection_that_cannot_be_opened_is_said_once():
    states = []
    link = Link("tcp:127.0.0.1:1", Codec(1, 1), on_state=lambda up, text: states.append((up, text)))
    pump(link, 0.8, lambda _: False)
    assert [up for up, _ in states] == [False]
    assert "127.0.0.1:1" in states[0][1]
    link.close()
