"""``python -P -m sim.firmware``: physics for a firmware that runs elsewhere."""

from __future__ import annotations

import argparse
import select
import signal
import socket
import sys
import time
from collections.abc import Callable

from drivers.mavlink.transports import SerialTransport
from groundstation.errors import BadInput, GroundStationError
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle
from sim.arguments import Parser
from sim.firmware.arducopter import JsonExchange
from sim.firmware.px4 import HilExchange

ANSWER_S = 2.0
"""A firmware in lock-step that has been silent for so long is stuck or gone."""


def serve_json(exchange: JsonExchange, place: socket.socket, stopped: Callable[[], bool]) -> None:
    """Answer ArduPilot's packets until stopped; the firmware paces."""
    while not stopped():
        if not select.select([place], [], [], 0.2)[0]:
            continue
        packet, peer = place.recvfrom(4096)
        line = exchange.answer(packet)
        if line is not None:
            place.sendto(line, peer)


PX4_CLOSED = "PX4 closed the simulator link; start it again, then this."


def serve_tcp(exchange: HilExchange, connection: socket.socket, stopped: Callable[[], bool], speed: float) -> None:
    """Lock-step with PX4 over TCP, no faster than ``speed`` times real time (0: as fast as it goes).

    Raises:
        BadInput: PX4 stopped answering or closed the connection, which is seen while reading or while writing.
    """
    try:
        _lock_step(exchange, connection, stopped, speed)
    except ConnectionError:
        raise BadInput(PX4_CLOSED) from None


def _lock_step(exchange: HilExchange, connection: socket.socket, stopped: Callable[[], bool], speed: float) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    begun, asked = time.monotonic(), time.monotonic()
    while not stopped():
        if not (exchange.locked and exchange.waiting):
            ahead = exchange.time_us * 1e-6 / speed - (time.monotonic() - begun) if speed > 0.0 else 0.0
            if not exchange.locked:
                ahead = max(ahead, exchange.time_us * 1e-6 - (time.monotonic() - begun))
            time.sleep(max(0.0, ahead))
            connection.sendall(exchange.step())
            asked = time.monotonic()
        if select.select([connection], [], [], 0.05 if exchange.locked else 0.0)[0]:
            data = connection.recv(65536)
            if not data:
                raise BadInput(PX4_CLOSED)
            exchange.receive(data)
        elif exchange.locked and time.monotonic() - asked > ANSWER_S:
            raise BadInput(f"PX4 has not answered for {ANSWER_S:.0f} s; look at its console.")


def serve_serial(exchange: HilExchange, line: SerialTransport, stopped: Callable[[], bool]) -> None:
    """Pace a flight controller in hardware-in-the-loop mode (SYS_HITL 1) in real time."""
    begun = time.monotonic()
    while not stopped():
        for _, data in line.read():
            exchange.receive(data)
        line.write(exchange.step())
        time.sleep(max(0.0, exchange.time_us * 1e-6 - (time.monotonic() - begun)))


def arguments(argv: list[str] | None = None) -> argparse.Namespace:
    """Parse the command line."""
    parser = Parser(
        prog="python -P -m sim.firmware",
        description="The simulated vehicle as physics for ArduCopter's or PX4's own firmware.",
        epilog="example: python -P -m sim.firmware --px4 tcp://127.0.0.1:4560 --vehicle x500 --scenario clean",
    )
    firmware = parser.add_mutually_exclusive_group(required=True)
    firmware.add_argument("--arducopter", metavar="HOST:PORT", help="answer its JSON interface here (127.0.0.1:9002)")
    firmware.add_argument("--px4", metavar="URL", help="tcp://HOST:PORT to listen on (4560), or serial://DEVICE:BAUD")
    parser.add_argument("--vehicle", required=True, metavar="FILE", help="vehicle file, or the name of a shipped one")
    parser.add_argument("--scenario", metavar="FILE", help="scenario file or name; without one an ideal laboratory")
    parser.add_argument("--seed", type=int, default=0, help="of all noise")
    parser.add_argument(
        "--real-time", type=float, default=1.0, metavar="SPEED", help="at most; 0 as fast as it goes (PX4 over TCP)"
    )
    parser.add_argument(
        "--natnet", metavar="HOST:PORT", help="motion capture of it, as an OptiTrack server (127.0.0.1:1510)"
    )
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Serve until interrupted; the exit status."""
    options = arguments(argv)
    stopping: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda n, _: stopping.append(n))
    try:
        _serve(options, lambda: bool(stopping))
    except GroundStationError as error:
        print(f"sim.firmware: {error}", file=sys.stderr)
        return error.exit_status
    return 0


def _serve(options: argparse.Namespace, stopped: Callable[[], bool]) -> None:
    from sim.mavlink.plant import SimulatedAirframe
    from sim.scenario import Scenario, load_scenario

    vehicle = load_vehicle(find_config("vehicles", options.vehicle))
    scenario = load_scenario(find_config("scenarios", options.scenario)) if options.scenario else Scenario()
    count = vehicle.rotors.count
    airframe = SimulatedAirframe(vehicle, scenario, seed=options.seed)
    airframe.step(0.004, (0.0,) * count)  # compiles before the firmware waits
    if options.natnet:
        _place(options.natnet)
        airframe.filmed_from(options.natnet)
    if options.arducopter:
        host, port = _place(options.arducopter)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
            place.bind((host, port))
            print(f"physics for ArduCopter at {host}:{port}", flush=True)
            serve_json(JsonExchange(airframe, count), place, stopped)
        return
    exchange = HilExchange(airframe, count)
    kind, _, rest = options.px4.partition("://")
    if kind == "serial":
        device, _, baud = rest.rpartition(":")
        print(f"physics for PX4 on {device}", flush=True)
        serve_serial(exchange, SerialTransport(device, int(baud)), stopped)
    elif kind == "tcp":
        host, port = _place(rest)
        with socket.create_server((host, port)) as server:
            print(f"physics for PX4 at {host}:{port}", flush=True)
            server.settimeout(0.2)
            while not stopped():
                try:
                    connection, _ = server.accept()
                except TimeoutError:
                    continue
                with connection:
                    serve_tcp(exchange, connection, stopped, options.real_time)
    else:
        raise BadInput(f"--px4 {options.px4}: write tcp://127.0.0.1:4560 or serial:///dev/ttyACM0:921600.")


def _place(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit():
        raise BadInput(f"'{text}' is no address; write HOST:PORT, for example 127.0.0.1:9002.")
    return host, int(port)


if __name__ == "__main__":
    sys.exit(main())
