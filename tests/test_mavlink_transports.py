"""Transports on loopback and pseudo-terminals: one set of promises for all; rates for slow lines."""

from __future__ import annotations

import os
import pty
import socket
import time
import tty

import pytest

from drivers.mavlink.transports import SerialTransport, TcpTransport, UdpTransport, open_transport, serial_ports
from groundstation.flight.link.profiles import PROFILES
from groundstation.flight.link.rates import SHARE, cost_of_line, fit_rates, frame_bytes


class UdpEnd:
    """A vehicle that speaks first, to where the station listens."""

    def __init__(self):
        self.transport = UdpTransport("127.0.0.1", 0, listen=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(2.0)

    def send(self, data: bytes) -> None:
        self.socket.sendto(data, ("127.0.0.1", self.transport.port))

    def receive(self, count: int) -> bytes:
        return self.socket.recv(count)


class TcpEnd:
    """A vehicle that serves."""

    def __init__(self):
        self.server = socket.create_server(("127.0.0.1", 0))
        self.transport = TcpTransport("127.0.0.1", self.server.getsockname()[1])
        self.socket, _ = self.server.accept()
        self.socket.settimeout(2.0)

    def send(self, data: bytes) -> None:
        self.socket.sendall(data)

    def receive(self, count: int) -> bytes:
        return self.socket.recv(count)


class SerialEnd:
    """A vehicle at the other end of a pseudo-terminal."""

    def __init__(self):
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        self.transport = SerialTransport(os.ttyname(slave), 57600)
        os.close(slave)

    def send(self, data: bytes) -> None:
        os.write(self.master, data)

    def receive(self, count: int) -> bytes:
        return os.read(self.master, count)


def read(transport, seconds: float = 2.0) -> bytes:
    end = time.monotonic() + seconds
    got = b""
    while not got and time.monotonic() < end:
        transport.wait(0.1)
        got = b"".join(data for _, data in transport.read())
    return got


@pytest.mark.parametrize("kind", [UdpEnd, TcpEnd, SerialEnd])
def test_bytes_go_both_ways_and_reading_never_waits(kind):
    end = kind()
    try:
        assert end.transport.read() == []
        end.send(b"\xfd\x00hello\xff\x13\x11")
        assert read(end.transport) == b"\xfd\x00hello\xff\x13\x11"
        end.transport.write(b"\xfdback\x0d\x0a")
        assert end.receive(100) == b"\xfdback\x0d\x0a"
    finally:
        end.transport.close()


def test_a_second_sender_on_the_port_does_not_get_the_first_ones_setpoints():
    end, stranger = UdpEnd(), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.send(b"first")
    assert read(end.transport) == b"first"
    stranger.sendto(b"second", ("127.0.0.1", end.transport.port))
    assert read(end.transport) == b"second"
    end.transport.write(b"setpoint")
    assert end.receive(100) == b"setpoint"
    stranger.settimeout(0.05)
    with pytest.raises(TimeoutError):
        stranger.recv(100)
    end.transport.close()


def test_a_broken_connection_opens_itself_again():
    end = TcpEnd()
    end.socket.close()
    deadline = time.monotonic() + 3.0
    while not end.transport.trouble and time.monotonic() < deadline:
        end.transport.read()
    assert "broke" in end.transport.trouble
    end.server.settimeout(3.0)
    while time.monotonic() < deadline and end.transport.trouble:
        end.transport.wait(0.05)
        end.transport.read()
    again, _ = end.server.accept()
    again.sendall(b"back")
    assert read(end.transport) == b"back"


def test_writing_to_nobody_is_silent():
    transport = UdpTransport("127.0.0.1", 0, listen=True)
    transport.write(b"nobody there yet")
    assert transport.read() == []


def test_nothing_is_bound_beyond_the_address_that_was_named():
    transport = open_transport("udpin://127.0.0.1:0")
    assert transport._socket.getsockname()[0] == "127.0.0.1"
    transport.close()


@pytest.mark.parametrize("url", ["nonsense", "udpin://127.0.0.1", "http://127.0.0.1:80", "tcp://127.0.0.1:x"])
def test_a_url_that_names_no_link_is_refused_with_examples(url):
    with pytest.raises(ValueError, match="serial:///dev"):
        open_transport(url)


def test_a_port_that_does_not_open_says_so():
    with pytest.raises(ConnectionError, match="cannot be opened"):
        open_transport("serial:///dev/no-such-port:57600")


def test_listing_ports_puts_likely_autopilots_first():
    likely = [port.likely for port in serial_ports()]
    assert likely == sorted(likely, reverse=True)


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("baud", [57600, 115200, 921600])
def test_rates_fit_the_line_and_needs_come_first(name, baud):
    wishes = PROFILES[name].streams
    rates = fit_rates(wishes, baud / 10)
    assert sum(rates[w.name] * frame_bytes(w.name) for w in wishes) <= SHARE * baud / 10 * 1.001
    for wish in wishes:
        assert rates[wish.name] <= wish.rate_hz + 1e-9
        assert rates[wish.name] >= 0.99 * wish.needed_hz, f"{wish.name} at {baud} baud"


def test_a_fast_line_grants_every_wish():
    wishes = PROFILES["px4"].streams
    assert fit_rates(wishes, None) == {w.name: w.rate_hz for w in wishes}
    assert fit_rates(wishes, 1e9) == pytest.approx({w.name: w.rate_hz for w in wishes})


def test_what_a_slow_line_costs_is_said_with_the_rates_and_the_width_of_the_intervals():
    wishes = PROFILES["px4"].streams
    slow, bare = cost_of_line(wishes, fit_rates(wishes, 5760.0), 5760.0)
    assert "57600 baud brought HIGHRES_IMU at 24 of 250 Hz" in slow
    assert "above 12 Hz is not in the record" in slow and "3.2 times as wide" in slow  # sqrt(250 / 24)
    assert "ESC_STATUS" in bare
    (full,) = cost_of_line(wishes, fit_rates(wishes, 92160.0), 92160.0)
    assert "no room for" in full and "ESC_STATUS" in full
    assert cost_of_line(wishes, fit_rates(wishes, 1e9), 1e9) == ()
