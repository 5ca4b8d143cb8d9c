"""Core, link and emulated autopilot as real processes: whoever is killed or stopped, the vehicle comes down and
disarms.

A second link of the autopilot tells the test what the vehicle really does.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import tomli_w
from mavlink_vehicle import small_plan

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import mavlink
from drivers.mavlink.tlog import entries
from groundstation.flight.client.client import FlightOrder, outcome, start_core
from groundstation.flight.client.rehearse import LinkOrder, linked_vehicle
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.paths import find_config
from groundstation.recording.load import read_recording
from groundstation.recording.manifest import provenance

DEADLINE_S = 60.0


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


class Witness:
    """Hears the vehicle on a link of its own."""

    def __init__(self) -> None:
        self.place = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.place.bind(("127.0.0.1", 0))
        self.place.settimeout(0.5)
        self.codec = MavlinkCodec()
        self.armed = self.mode = None

    def until(self, done: Callable[[], object], what: str) -> None:
        """Hear on until it is so."""
        end = time.monotonic() + DEADLINE_S
        while time.monotonic() < end:
            try:
                data = self.place.recv(65536)
            except TimeoutError:
                data = b""
            for received in self.codec.decode(data, datagram=True):
                if received.name == "HEARTBEAT" and received.message is not None:
                    self.armed = bool(received.message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            if done():
                return
        raise AssertionError(f"waited {DEADLINE_S:g} s for {what}")


class Flight:
    """One flight of the emulated PX4 by a core and a link process."""

    def __init__(self, folder: Path):
        self.folder = folder / "2026-11-29T12-00-00-x500"
        plan, station = self.folder / "plan.toml", folder / "station.toml"
        self.folder.mkdir()
        plan.write_text(
            tomli_w.dumps(small_plan(periods=20.0).model_dump(mode="json", by_alias=True, exclude_none=True))
        )
        station.write_text("[policy]\nclimb_m_s = 1.0\nsettle_s = 1.0\n")
        vehicle = find_config("vehicles", "x500")
        self.witness = Witness()
        port = free_port()
        links = [f"udpout://127.0.0.1:{number}" for number in (port, self.witness.place.getsockname()[1])]
        command = [sys.executable, "-P", "-m", "sim.mavlink", "--profile", "px4", "--vehicle", "x500"]
        for link in links:
            command += ["--link", link]
        self.autopilot = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        self.url = f"udpin://127.0.0.1:{port}"
        link = linked_vehicle(self.folder, vehicle, LinkOrder(self.url, str(station), set_parameters=True))
        self.core, _ = start_core(FlightOrder(self.folder, plan, vehicle, link, analyse=False), start=True)

    def journal(self) -> list[str]:
        log = self.folder / JOURNAL
        return [entry["text"] for entry in read_journal(log)] if log.is_file() else []

    def excite(self) -> None:
        self.witness.until(
            lambda: any(text.endswith("-> exciting") for text in self.journal()) or self.core.poll() is not None,
            "the excitation",
        )
        assert self.core.poll() is None, outcome(self.folder)
        assert self.witness.armed

    def pids(self) -> dict[str, int]:
        """Core and link."""
        children = Path(f"/proc/{self.core.pid}/task/{self.core.pid}/children").read_text().split()
        link = [int(p) for p in children if b"flight.link" in Path(f"/proc/{p}/cmdline").read_bytes()]
        return {"core": self.core.pid, "link": link[0]}

    def end(self) -> None:
        self.core.kill()
        self.autopilot.kill()
        self.autopilot.wait()
        self.witness.place.close()


@pytest.fixture
def flight(tmp_path: Path) -> Iterator[Flight]:
    made = Flight(tmp_path)
    yield made
    made.end()


def listening(pid: int) -> set[str]:
    """Local addresses of a process's sockets that could be spoken to from elsewhere: bound UDP, listening TCP."""
    inodes = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = str(entry.readlink())
        except FileNotFoundError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = set()
    for table, states in (("tcp", {"0A"}), ("tcp6", {"0A"}), ("udp", {"07"}), ("udp6", {"07"})):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes and fields[3] in states:
                found.add(fields[1].rpartition(":")[0])
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize(
    ("who", "number"), [("link", signal.SIGKILL), ("core", signal.SIGSTOP), ("core", signal.SIGKILL)]
)
def test_whoever_dies_the_vehicle_lands_and_the_recording_opens(flight, who, number):
    flight.excite()
    pids = flight.pids()
    for name, pid in pids.items():
        assert listening(pid) <= {"0100007F"}, f"the {name} process listens beyond loopback"
    begun = time.monotonic()
    os.kill(pids[who], number)
    flight.witness.until(lambda: flight.witness.armed is False, "the vehicle to disarm")
    assert time.monotonic() - begun < 20.0
    if who == "link":
        assert flight.core.wait(DEADLINE_S) == 4
        assert "another link landed it" in outcome(flight.folder)[1]
    elif number == signal.SIGSTOP:
        os.kill(pids["core"], signal.SIGCONT)
        assert flight.core.wait(DEADLINE_S) == 4
    assert_recorded(flight)


def assert_recorded(flight: Flight) -> None:
    recording = read_recording(flight.folder / "flight.mcap")
    assert len(recording.streams["imu"]) > 500
    raw = list(entries((flight.folder / "raw.tlog").read_bytes()))
    assert len(raw) > 1000


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_station_restarted_in_the_air_refuses_silently_then_takes_over_and_goes_on_with_the_folder(flight):
    flight.excite()
    for pid in flight.pids().values():
        os.kill(pid, signal.SIGSTOP)  # the link first holds the port: it must be gone
    for pid in flight.pids().values():
        os.kill(pid, signal.SIGKILL)
    flight.core.wait(DEADLINE_S)
    command = [sys.executable, "-P", "-m", "groundstation.cli", "fly", "--link", flight.url, "--vehicle", "x500"]
    command += ["--logs", str(flight.folder.parent), "--yes-simulated", "--take-over", "land"]
    taken = subprocess.run(command, capture_output=True, text=True, timeout=2 * DEADLINE_S, stdin=subprocess.DEVNULL)
    assert taken.returncode == 4, taken.stderr
    assert "going on with" in taken.stderr and "taken over" in taken.stderr
    flight.witness.until(lambda: flight.witness.armed is False, "the vehicle to disarm")
    assert len(read_recording(flight.folder / "flight-2.mcap").streams["imu"]) > 0
    assert_recorded(flight)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_an_abort_while_it_arms_ends_in_seconds_with_the_vehicle_where_it_stood(flight):
    flight.witness.until(lambda: any(text.endswith("-> checked") for text in flight.journal()), "the checks")
    begun = time.monotonic()
    flight.core.interrupt()
    assert flight.core.wait(DEADLINE_S) == 4
    assert time.monotonic() - begun < 20.0, "it waited 113 s for a landing"
    assert "did not take off" in outcome(flight.folder)[1]
    said = provenance(flight.folder / "flight.mcap")
    assert said.startswith("The data are as flown: ") and "raw.tlog" in said and "flight.mcap" in said
    flight.witness.until(lambda: flight.witness.armed is False, "the vehicle to say so")
