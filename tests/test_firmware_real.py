"""Real ArduCopter and PX4 on the simulated physics.

Their binaries are given in ARDUCOPTER and PX4; nothing of them is kept here.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import mavlink
from drivers.mavlink.transports import Transport, open_transport
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle
from sim.build import true_vehicle
from sim.scenario import load_scenario
from studies.firmware import PX4_ENVIRONMENT, arducopter_command, process, px4_command

ARDUCOPTER, PX4 = os.environ.get("ARDUCOPTER", ""), os.environ.get("PX4", "")
NOT_READY = 3
"""Exit status of a flight that preflight refused."""
SET_MODE, ARM = mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_CMD_COMPONENT_ARM_DISARM


class Ground:
    """A few words of a station on real time."""

    def __init__(self, transport: Transport):
        self.transport, self.codec = transport, MavlinkCodec()
        self.seen: dict[str, object] = {}
        self._beat_s = 0.0

    def until(self, condition: Callable[[], bool], within_s: float, each: Callable[[], None] = lambda: None) -> bool:
        end = time.monotonic() + within_s
        while time.monotonic() < end:
            if time.monotonic() - self._beat_s > 1.0:
                self._beat_s = time.monotonic()
                self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            for _, data in self.transport.read():
                for received in self.codec.decode(data):
                    if received.frame.system == 1 and received.message is not None:
                        self.seen[received.name] = received.message
            each()
            if condition():
                return True
            self.transport.wait(0.02)
        return False

    def send(self, message) -> None:
        self.transport.write(self.codec.encode(message))

    def command(self, number: int, *p: float) -> None:
        self.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *(list(p) + [0.0] * 7)[:7]))

    def repeatedly(self, *commands: tuple[float, ...]) -> Callable[[], None]:
        """Send the commands once a second."""
        last = [0.0]

        def each() -> None:
            if time.monotonic() - last[0] > 1.0:
                last[0] = time.monotonic()
                for number, *p in commands:
                    self.command(int(number), *p)

        return each

    @property
    def armed(self) -> bool:
        beat = self.seen.get("HEARTBEAT")
        return beat is not None and bool(beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)  # type: ignore[attr-defined]

    @property
    def height_m(self) -> float:
        position = self.seen.get("LOCAL_POSITION_NED")
        return 0.0 if position is None else -position.z  # type: ignore[attr-defined]


def physics(*arguments: str, scenario: str = "clean") -> list[str]:
    return [sys.executable, "-P", "-m", "sim.firmware", *arguments, "--vehicle", "x500", "--scenario", scenario]


def flown(link: str, folder: Path) -> dict:
    """What ``groundstation fly`` says of a whole flight, once the firmware is ready to fly it."""
    command = [sys.executable, "-P", "-m", "groundstation.cli", "fly", "--link", link, "--vehicle", "x500", "--json"]
    command += ["--yes-simulated", "--set-parameters", "--logs", str(folder / "flights")]
    end = time.monotonic() + 300.0
    while True:
        ended = subprocess.run(command, capture_output=True, text=True, check=False)
        if ended.returncode != NOT_READY or time.monotonic() > end:
            break
    assert ended.returncode == 0, f"{ended.stdout}\n{ended.stderr[-2000:]}"
    newest = max((folder / "flights").glob("*/identification.json"), key=lambda path: path.stat().st_mtime)
    assert (newest.parent / "report.html").is_file()
    assert list(newest.parent.glob("onboard*")), "whole, or on a busy machine what came of it in two minutes"
    return json.loads(newest.read_text())


def assert_within_bounds(found: dict) -> None:
    """Mass to 1 %, moments to the larger of 2 % and three standard deviations."""
    scenario = load_scenario(find_config("scenarios", "hall"))
    true = true_vehicle(load_vehicle(find_config("vehicles", "x500")), scenario).parameters()
    estimates = found["methods"][found["best"]]["parameters"]
    for name in ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2"):
        allowed = 0.01 * true[name] if name == "mass_kg" else max(0.02 * true[name], 3.0 * estimates[name]["std"])
        print(f"{name}: true {true[name]:.5f}, estimated {estimates[name]['value']:.5f}, allowed {allowed:.5f} off")
        assert abs(estimates[name]["value"] - true[name]) <= allowed


@pytest.mark.timeout(900)
@pytest.mark.skipif(not ARDUCOPTER, reason="ARDUCOPTER names no arducopter binary (make firmware-test ARDUCOPTER=path)")
@pytest.mark.parametrize("scripting", [0, 1], ids=["by setpoints", "on board"])
def test_real_arducopter_is_flown_from_preflight_to_report(tmp_path: Path, scripting: int):
    ours = physics("--arducopter", "127.0.0.1:9002", scenario="hall")
    firmware = arducopter_command(Path(ARDUCOPTER), tmp_path, f"SCR_ENABLE {scripting}\n")
    with process(ours, tmp_path), process(firmware, tmp_path):
        assert_within_bounds(flown("tcp://127.0.0.1:5760", tmp_path))


@pytest.mark.timeout(900)
@pytest.mark.skipif(not PX4, reason="PX4 names no px4 binary (make firmware-test PX4=path)")
def test_real_px4_is_flown_from_preflight_to_report(tmp_path: Path):
    ours = physics("--px4", "tcp://127.0.0.1:4560", scenario="hall")
    with process(ours, tmp_path), process(px4_command(Path(PX4), tmp_path), tmp_path, **PX4_ENVIRONMENT):
        assert_within_bounds(flown("udpin://127.0.0.1:14540", tmp_path))


@pytest.mark.timeout(300)
@pytest.mark.skipif(not ARDUCOPTER, reason="ARDUCOPTER names no arducopter binary (make firmware-test ARDUCOPTER=path)")
def test_real_arducopter_arms_takes_off_and_lands_on_our_physics(tmp_path: Path):
    firmware = arducopter_command(Path(ARDUCOPTER), tmp_path, "ARMING_SKIPCHK 0\nFS_THR_ENABLE 0\n")
    with process(physics("--arducopter", "127.0.0.1:9002"), tmp_path), process(firmware, tmp_path):
        ground = Ground(connected("tcp://127.0.0.1:5760"))
        ready = ground.repeatedly((mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 32, 50000), (SET_MODE, 1, 4), (ARM, 1))
        assert ground.until(lambda: ground.armed, 120.0, ready)
        ground.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0)
        assert ground.until(lambda: ground.height_m > 1.7, 30.0)
        ground.command(mavlink.MAV_CMD_NAV_LAND)
        assert ground.until(lambda: not ground.armed, 60.0)


@pytest.mark.timeout(300)
@pytest.mark.skipif(not PX4, reason="PX4 names no px4 binary (make firmware-test PX4=path)")
def test_real_px4_arms_takes_off_and_lands_on_our_physics(tmp_path: Path):
    with (
        process(physics("--px4", "tcp://127.0.0.1:4560"), tmp_path),
        process(px4_command(Path(PX4), tmp_path), tmp_path, **PX4_ENVIRONMENT),
    ):
        ground = Ground(open_transport("udpin://127.0.0.1:14540"))
        assert ground.until(lambda: ground.armed, 120.0, ground.repeatedly((ARM, 1)))
        nan = float("nan")
        ground.command(mavlink.MAV_CMD_NAV_TAKEOFF, nan, nan, nan, nan, nan, nan, nan)
        assert ground.until(lambda: ground.height_m > 1.7, 40.0)
        # PX4 goes from LAND to LOITER when the end of its take-off falls behind the order: it is given until it is down
        assert ground.until(lambda: not ground.armed, 60.0, ground.repeatedly((mavlink.MAV_CMD_NAV_LAND,)))


def connected(url: str, within_s: float = 60.0) -> Transport:
    """The firmware's port, once it is there."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            return open_transport(url)
        except (TimeoutError, ConnectionError):
            time.sleep(0.5)
    raise AssertionError(f"{url} did not open")
