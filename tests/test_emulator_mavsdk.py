"""MAVSDK, a client nobody here wrote, against the emulator's process on real loopback."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.polling import eventually

mavsdk = pytest.importorskip("mavsdk")

SPEED = 2.0


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def emulator(profile: str, port: int) -> Iterator[None]:
    """The process, ready."""
    command = [sys.executable, "-P", "-m", "sim.mavlink", "--profile", profile, "--vehicle", "x500"]
    command += ["--link", f"udpout://127.0.0.1:{port}", "--real-time", str(SPEED), "--seed", "1"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(profile)  # the first line comes once it is compiled
        yield
    finally:
        process.terminate()
        assert process.wait(10) == 0


@pytest.mark.timeout(180)
def test_mavsdk_connects_arms_takes_off_flies_offboard_lands_and_transfers_a_file(tmp_path: Path):
    from mavsdk.plugins.action import Action, ActionResult
    from mavsdk.plugins.ftp import Ftp
    from mavsdk.plugins.offboard import Offboard, OffboardResult, PositionNedYaw
    from mavsdk.plugins.param import Param
    from mavsdk.plugins.telemetry import FlightMode, LandedState, Telemetry

    port = free_port()
    kind = mavsdk.ComponentType.GROUND_STATION
    sdk = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(kind))
    try:
        assert sdk.add_any_connection(f"udpin://127.0.0.1:{port}").name == "SUCCESS"
        with emulator("px4", port):
            system = sdk.first_autopilot(10.0)
            assert system is not None
            action, telemetry, offboard = Action(system), Telemetry(system), Offboard(system)
            assert Param(system).get_param_float("MPC_XY_VEL_MAX") == pytest.approx(12.0)

            def position():
                return telemetry.position_velocity_ned().position

            assert action.arm() == ActionResult.SUCCESS
            assert action.takeoff() == ActionResult.SUCCESS
            assert eventually(lambda: position().down_m < -2.2, 20.0)
            offboard.set_position_ned(PositionNedYaw(1.0, -0.5, -1.5, 20.0))
            assert offboard.start() == OffboardResult.SUCCESS
            assert eventually(lambda: telemetry.flight_mode() == FlightMode.OFFBOARD, 3.0)

            def there() -> bool:
                p = position()
                return abs(p.north_m - 1.0) < 0.2 and abs(p.east_m + 0.5) < 0.2 and abs(p.down_m + 1.5) < 0.2

            assert eventually(there, 15.0)
            assert action.land() == ActionResult.SUCCESS
            assert eventually(lambda: not telemetry.armed(), 20.0)
            assert telemetry.landed_state() == LandedState.ON_GROUND

            content = bytes(range(256)) * 40
            (tmp_path / "plan.bin").write_bytes(content)
            transfer(Ftp(system), tmp_path, content)
    finally:
        sdk.destroy()


def transfer(files, folder: Path, content: bytes) -> None:
    """Up, compared by checksum, and down again in bursts."""
    from mavsdk.plugins.ftp import FtpResult

    results: list = []

    def finished(result, _progress, _user=None) -> None:
        if result != FtpResult.NEXT:
            results.append(result)

    back = folder / "back"
    back.mkdir()
    files.upload_async(str(folder / "plan.bin"), "/fs/microsd/etc", finished)
    assert eventually(lambda: results == [FtpResult.SUCCESS], 15.0), results
    assert files.are_files_identical(str(folder / "plan.bin"), "/fs/microsd/etc/plan.bin")
    files.download_async("/fs/microsd/etc/plan.bin", str(back), True, finished)
    assert eventually(lambda: results == [FtpResult.SUCCESS] * 2, 15.0), results
    assert (back / "plan.bin").read_bytes() == content
