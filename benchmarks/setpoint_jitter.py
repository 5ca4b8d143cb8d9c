"""How evenly setpoints leave the link process, with the machine idle and with an analysis on every core.

    python -m benchmarks.setpoint_jitter

Core, link and emulated PX4 fly as real processes; between link and autopilot stands a tap whose socket has each
datagram stamped by the kernel on arrival, so that a late tap does not show. Beside the link, in the same seconds, a
plain sender does what a script would: sleep to the next fiftieth of a second, send. Printed is how far the intervals
are from 20 ms.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tomli_w

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from mavlink_vehicle import small_plan

from groundstation.flight.client.client import FlightOrder, outcome, start_core
from groundstation.flight.client.rehearse import LinkOrder, linked_vehicle
from groundstation.paths import find_config

PERIOD_S = 0.02
SETPOINT = 84
"""SET_POSITION_TARGET_LOCAL_NED."""
PAUSE_S = 0.5
"""Setpoints further apart belong to different flights."""
SO_TIMESTAMPNS = 35
TIMESPEC = struct.Struct("@qq")

PLAIN = """
import socket, sys, time
place, target = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), ("127.0.0.1", int(sys.argv[1]))
due = time.monotonic()
while True:
    due += 0.02
    time.sleep(max(0.0, due - time.monotonic()))
    place.sendto(b"setpoint", target)
"""


def bound() -> socket.socket:
    """A loopback socket whose datagrams the kernel stamps."""
    place = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    place.bind(("127.0.0.1", 0))
    place.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    place.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    return place


class Tap(threading.Thread):
    """Relays between autopilot and link, and notes when setpoints came: from the link, and from the plain sender."""

    def __init__(self, link_port: int):
        super().__init__(daemon=True)
        self.vehicle, self.link, self.plain = (bound() for _ in range(3))
        self._link_address = ("127.0.0.1", link_port)
        self._autopilot: tuple[str, int] | None = None
        self.sent_s: dict[str, list[float]] = {"link": [], "plain": []}
        self.start()

    def run(self) -> None:
        """Relay for ever."""
        while True:
            for place in select.select([self.vehicle, self.link, self.plain], [], [])[0]:
                data, ancillary, _, address = place.recvmsg(65536, 64)
                stamp_s = next(1e-9 * (s * 10**9 + ns) for *_, raw in ancillary for s, ns in [TIMESPEC.unpack(raw)])
                if place is self.vehicle:
                    self._autopilot = address
                    self.link.sendto(data, self._link_address)
                elif place is self.plain:
                    self.sent_s["plain"].append(stamp_s)
                elif self._autopilot is not None:
                    self.vehicle.sendto(data, self._autopilot)
                    if data[0] == 0xFD and int.from_bytes(data[7:10], "little") == SETPOINT:
                        self.sent_s["link"].append(stamp_s)


def free_port() -> int:
    """A UDP port nobody listens on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


@contextlib.contextmanager
def running(*commands: list[str]) -> Iterator[None]:
    """Children that are ended at the end, with the sessions they began."""
    children = [
        subprocess.Popen(c, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for c in commands
    ]
    try:
        yield
    finally:
        for child in children:
            child.kill()
            child.wait()


def analysis(flight: Path) -> list[str]:
    """Identify a flight over and over."""
    code = (
        "import sys; from groundstation.cli import main\nwhile True:\n  main(['identify', sys.argv[1]], "
        "standalone_mode=False)"
    )
    return [sys.executable, "-P", "-c", code, str(flight)]


def fly(folder: Path, load: list[list[str]]) -> dict[str, list[float]]:
    """One flight of a minute under a load; when setpoints came."""
    folder.mkdir()
    plan, vehicle, port = folder / "plan.toml", find_config("vehicles", "x500"), free_port()
    document = small_plan(periods=20.0).model_dump(mode="json", by_alias=True, exclude_none=True)
    plan.write_text(tomli_w.dumps(document))
    tap = Tap(port)
    address = f"udpout://127.0.0.1:{tap.vehicle.getsockname()[1]}"
    autopilot = [sys.executable, "-P", "-m", "sim.mavlink", "--profile", "px4", "--vehicle", "x500", "--link", address]
    plain = [sys.executable, "-c", PLAIN, str(tap.plain.getsockname()[1])]
    drone = linked_vehicle(folder, vehicle, LinkOrder(f"udpin://127.0.0.1:{port}", "default", set_parameters=True))
    with running(autopilot, plain, *load):
        core, _ = start_core(FlightOrder(folder, plan, vehicle, drone, analyse=False), start=True)
        core.wait(300.0)
    print(f"({outcome(folder)})", file=sys.stderr)
    return tap.sent_s


def deviations_ms(stamps_s: list[float]) -> np.ndarray:
    """How far intervals are from the period, ms."""
    intervals = np.diff(stamps_s)
    return 1e3 * np.abs(intervals[intervals < PAUSE_S] - PERIOD_S)


def main() -> None:
    """Fly twice, print the table."""
    cores = os.cpu_count() or 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rehearsal = [
            sys.executable,
            "-P",
            "-m",
            "groundstation.cli",
            "rehearse",
            "--scenario",
            "hall",
            "--logs",
            str(folder),
        ]
        subprocess.run(rehearsal, check=True, capture_output=True)
        flight = next(folder.glob("*/flight.mcap"))
        p99 = {}
        print(f"{'load':<28} {'sender':<8} {'intervals':>9} {'p50 ms':>8} {'p99 ms':>8} {'max ms':>8}")
        for load, commands in (("none", []), (f"an analysis on each of {cores} cores", [analysis(flight)] * cores)):
            for sender, stamps in fly(folder / f"under-{len(commands)}", commands).items():
                off = deviations_ms(stamps)
                p50, p99[sender], most = np.percentile(off, (50, 99, 100))
                print(f"{load:<28} {sender:<8} {len(off):>9} {p50:>8.2f} {p99[sender]:>8.2f} {most:>8.2f}", flush=True)
        print(f"p99 under load: the plain sender's is {p99['plain'] / p99['link']:.1f} times the link's")


if __name__ == "__main__":
    main()
