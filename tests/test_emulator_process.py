"""The emulator's process: links opened from URLs, a served TCP port, a serial line, signed frames, bad arguments."""

from __future__ import annotations

import os
import pty
import socket
import tty
from pathlib import Path

import pytest

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import mavlink
from drivers.mavlink.signing import Signing, signing_stamp
from groundstation.errors import BadInput
from sim.mavlink.__main__ import main
from sim.mavlink.arducopter import ArduCopter
from sim.mavlink.process import DATAGRAM, Service, TcpServer, attach, open_link
from sim.mavlink.px4 import Px4
from tests.emulated import RigidAirframe, quadrotor

KEY = b"k" * 32


class Clock:
    """A clock that moves when told."""

    def __init__(self) -> None:
        self.now_s = 50.0

    def __call__(self) -> float:
        return self.now_s


def service(kind, url: str, **options) -> tuple[Service, Clock, object]:
    vehicle, clock = quadrotor(), Clock()
    autopilot = kind(vehicle, RigidAirframe(vehicle), boot_s=60.0)
    transports = attach(autopilot, (url,), **options)
    return Service(autopilot, transports, monotonic=clock), clock, transports[url]


def run(made: Service, clock: Clock, seconds: float) -> None:
    for _ in range(round(seconds / 0.01)):
        clock.now_s += 0.01
        made.turn(clock.now_s)


def test_px4_speaks_first_over_udp_in_datagrams_that_fit():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(2.0)
        made, clock, _ = service(Px4, f"udpout:127.0.0.1:{station.getsockname()[1]}")
        run(made, clock, 0.5)
        data = station.recv(65536)
        assert len(data) <= DATAGRAM
        assert any(r.name == "HEARTBEAT" for r in MavlinkCodec().decode(data, datagram=True))


def test_arducopter_serves_tcp_and_a_new_client_takes_the_place_of_the_old():
    made, clock, server = service(ArduCopter, "tcpin://127.0.0.1:0")
    assert isinstance(server, TcpServer)
    for _ in range(2):
        with socket.create_connection(("127.0.0.1", server.port)) as station:
            station.settimeout(2.0)
            codec = MavlinkCodec()
            station.sendall(codec.encode(mavlink.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)))
            run(made, clock, 0.2)
            names = [r.name for r in codec.decode(station.recv(65536))]
            assert "AUTOPILOT_VERSION" in names
    run(made, clock, 1.5)  # nobody there: it goes on
    server.close()


def test_a_serial_line_carries_no_more_than_its_baud_rate():
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    os.set_blocking(master, False)
    made, clock, line = service(Px4, f"serial://{os.ttyname(slave)}:57600")
    carried = 0
    for _ in range(300):
        clock.now_s += 0.01
        made.turn(clock.now_s)
        try:
            carried += len(os.read(master, 65536))
        except BlockingIOError:
            continue
    line.close()  # type: ignore[attr-defined]
    os.close(master)
    os.close(slave)
    assert 0.8 * 5760 * 3 < carried < 1.15 * 5760 * 3 + 4096


def test_with_a_key_what_is_not_signed_is_not_obeyed():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(2.0)
        made, clock, _ = service(Px4, f"udpout://127.0.0.1:{station.getsockname()[1]}", key=KEY)
        run(made, clock, 0.1)
        _, vehicle = station.recvfrom(65536)
        request = mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0)
        autopilot = made._autopilot
        station.sendto(MavlinkCodec().encode(request), vehicle)
        run(made, clock, 0.1)
        assert autopilot.mode.name == "LOITER"
        signed = MavlinkCodec(signing=Signing(KEY, signing_stamp(1_900_000_000.0)))
        station.sendto(signed.encode(request), vehicle)
        run(made, clock, 0.1)
        assert autopilot.mode.name == "OFFBOARD"


def test_a_machine_that_cannot_keep_up_slows_the_simulation_instead_of_rushing_it():
    vehicle = quadrotor()
    clock = Clock()

    class Slow(RigidAirframe):
        def step(self, dt_s, commands):
            clock.now_s += 0.008  # twice as long as what it simulates
            super().step(dt_s, commands)

    autopilot = Px4(vehicle, Slow(vehicle), boot_s=60.0)
    made = Service(autopilot, {}, monotonic=clock)
    for _ in range(50):
        clock.now_s += 0.05
        made.turn(clock.now_s)
    elapsed = clock.now_s - 50.0
    assert autopilot.time_s - 60.0 < 0.65 * elapsed


@pytest.mark.parametrize(
    ("url", "words"),
    [("carrier-pigeon://x:1", "names no link"), ("tcpin://127.0.0.1:none", "tcpin"), ("serial:///dev/none:9", "none")],
)
def test_a_link_that_cannot_be_is_refused_in_a_sentence(url, words):
    with pytest.raises(BadInput, match=words):
        open_link(url)


def test_bad_arguments_end_with_status_2_and_a_sentence(tmp_path: Path, capsys):
    key = tmp_path / "short.key"
    key.write_bytes(b"short")
    assert main(["--profile", "px4", "--vehicle", "no-such-vehicle"]) == 2
    assert "there is no such file" in capsys.readouterr().err
    assert main(["--profile", "px4", "--fault", "gremlin@1"]) == 2
    assert "there is no fault 'gremlin'" in capsys.readouterr().err
    assert main(["--profile", "px4", "--key-file", str(key)]) == 2
    assert "32 bytes, not 5" in capsys.readouterr().err
