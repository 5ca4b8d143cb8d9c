"""Calibration by hand: planted mountings come back within their intervals, go into the station file, and are used and
checked.
"""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false
from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from datetime import date

import numpy as np
import pytest

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import mavlink
from drivers.samples import Imu, Pose
from groundstation.errors import BadInput, NotIdentifiable, Refused
from groundstation.flight.calibration import calibration_of, write_calibration
from groundstation.flight.link.marker import MarkerWatch, compared, since
from groundstation.flight.link.mounting import Mounting as Correction
from groundstation.flight.station import MarkerCalibration, load_station, station_from_dict
from groundstation.frames import quat_conjugate, quat_exp, quat_log, quat_multiply
from groundstation.identification.handheld import calibrate_by_hand
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle
from sim.mocap.hand import Mounting, Sensors, carry
from sim.mocap.scene import Replay
from sim.mocap.server import Server, Setup

VEHICLE = load_vehicle(find_config("vehicles", "qball2"))
TUESDAY, SUNDAY = date(2026, 11, 24), date(2026, 11, 29)


def drawn(seed: int) -> Mounting:
    """A mounting at random, turned by any angle."""
    rng = np.random.default_rng(1000 + seed)
    return Mounting(
        tuple(0.05 * rng.standard_normal(3)), tuple(0.8 * rng.standard_normal(3)), tuple(0.01 * rng.standard_normal(2)),
        0.01 * rng.standard_normal(), 10.0 * rng.standard_normal(),
    )  # fmt: skip


def errors(seed: int) -> np.ndarray:
    """Errors over standard deviations of one carrying: offset, rotation, tilt, scale, clock, (10,)."""
    truth = drawn(seed)
    carried = carry(seed, truth, seconds=20.0)
    found = calibrate_by_hand(carried.imu, carried.poses)
    turn = quat_log(quat_multiply(quat_conjugate(quat_exp(np.array(truth.rotation_rad))), quat_exp(found.rotation_rad)))
    return np.concatenate([
        (found.position_m - truth.position_m) / found.position_std_m, turn / found.rotation_std_rad,
        (found.tilt_rad - truth.tilt_rad) / found.tilt_std_rad, [(found.scale - truth.scale) / found.scale_std],
        [(found.mocap_minus_imu_s - truth.clock_s - 10.5 * truth.drift) / found.clock_std_s],
    ])  # fmt: skip


def test_planted_mountings_lie_within_their_intervals():
    seeds = range(4)
    z = np.array([errors(seed) for seed in seeds])
    print(f"seeds {seeds}: rms of error over std {np.sqrt(np.mean(z**2, axis=0)).round(2)}")
    assert np.mean(np.abs(z) < 1.96) > 0.85, "the whole study is benchmarks.mocap --part hand"
    assert np.abs(z).max() < 5.0


def test_a_turn_about_one_axis_does_not_tell_the_mounting():
    carried = carry(1, turning_rad=(0.0, 0.0, 0.8))
    with pytest.raises(NotIdentifiable, match="about one axis"):
        calibrate_by_hand(carried.imu, carried.poses)


def test_mirrored_poses_are_named():
    carried = carry(2)
    (t, place), (w, x, y, z) = carried.poses[:2], carried.poses[2].T
    mirrored = np.stack([w, -x, y, -z], axis=-1)
    for attitude in (mirrored, carried.poses[2]):
        with pytest.raises(Refused, match="mirrored"):
            calibrate_by_hand(carried.imu, (t, place * [1, -1, 1], attitude))


def test_a_world_with_y_up_is_named_with_the_line_to_write():
    carried = carry(3, Mounting(tilt_rad=(0.0, 0.0)))
    t, place, attitude = carried.poses
    lying = quat_exp(np.array([-np.pi / 2, 0.0, 0.0]))
    with pytest.raises(Refused, match='up = "y"'):
        calibrate_by_hand(carried.imu, (t, place[:, [0, 2, 1]] * [1, 1, -1], quat_multiply(lying, attitude)))


def test_corrected_poses_are_those_of_the_declared_tracked_point():
    truth = Mounting((0.03, -0.02, 0.05), (0.3, -0.2, 1.4), (0.02, -0.01), 0.03, 0.0, 0.0)
    quiet = Sensors(pose_m=0.0, pose_rad=0.0)
    declared = VEHICLE.model_copy(update={"mocap": VEHICLE.mocap.model_copy(update={"position_m": (0.0, 0.01, 0.04)})})
    known = MarkerCalibration(
        body="1", measured="2026-11-29", position_m=truth.position_m, rotation_rad=truth.rotation_rad,
        tilt_rad=truth.tilt_rad, scale=truth.scale,
    )  # fmt: skip
    offset = tuple(np.array(declared.mocap.position_m) - declared.imu.position_m)
    plain = carry(4, Mounting(offset, (0.0, 0.0, 0.0), (0.0, 0.0), 0.0, 0.0, 0.0), quiet)
    seen = carry(4, truth, quiet)
    correction = Correction(known, declared)
    for index in (0, 777, 2500):
        pose = correction.corrected(Pose(0.0, tuple(seen.poses[1][index]), tuple(seen.poses[2][index])))
        np.testing.assert_allclose(pose.position_m, plain.poses[1][index], atol=1e-9)
        assert abs(np.dot(pose.quaternion, plain.poses[2][index])) == pytest.approx(1.0, abs=1e-12)


STATION = """# our hall
schema = "groundstation.station/1"
[mocap]
system = "vicon"
body = "drone"   # its name
"""


def test_the_station_file_keeps_all_else_and_has_one_section(tmp_path):
    path = tmp_path / "hall.toml"
    path.write_text(f"{STATION}latency_s = 0.015  # of last week\n")
    carried = carry(5, Mounting(clock_s=0.004, drift=0.0))
    found = calibrate_by_hand(carried.imu, carried.poses, expected_s=0.0)
    for _ in range(2):
        write_calibration(path, calibration_of(found, load_station(path), 1e-4, SUNDAY))
    text = path.read_text()
    assert text.startswith(f"{STATION}latency_s = 0.0  # of last week\n"), "the calibration's delay takes its place"
    assert text.count("[mocap.calibration]") == 1
    written = load_station(path).mocap.calibration
    np.testing.assert_allclose(written.position_m, Mounting().position_m, atol=1e-3)
    assert written.delay_s == pytest.approx(0.004, abs=5e-4)
    assert written.scale == 0.0, "no scale beyond what the accelerometer leaves open"
    assert written.measured == "2026-11-29"


def test_a_shipped_file_and_another_body_are_refused(tmp_path):
    known = MarkerCalibration(body="1", measured="2026-11-29", position_m=(0, 0, 0), rotation_rad=(0, 0, 0))
    with pytest.raises(BadInput, match="copy it"):
        write_calibration(find_config("stations", "default"), known)
    with pytest.raises(BadInput, match="calibration is of body '1'"):
        station_from_dict({"mocap": {"system": "vicon", "body": "drone", "calibration": known.model_dump()}})


def calibration(**changes) -> MarkerCalibration:
    return MarkerCalibration(
        body="1", measured=TUESDAY.isoformat(), position_m=(0, 0, 0), rotation_rad=(0, 0, 0), **changes
    )


def test_a_marker_body_that_moved_is_told_with_how_far_and_since_when():
    small = np.full(3, 2e-4)
    known = calibration(position_std_m=(2e-4, 2e-4, 2e-4))
    moved = compared(known, np.array([0.004, 0.0, 0.0]), small, np.zeros(3), SUNDAY)
    assert not moved.ok
    assert moved.seen == "the marker body moved by 4 mm (+- 1) since Tuesday"
    assert compared(known, np.array([0.001, 0.0, 0.0]), small, np.zeros(3), SUNDAY).ok
    turned = compared(known, np.zeros(3), small, np.array([0.0, 0.0, 0.03]), SUNDAY)
    assert turned.seen == "the marker body turned by 1.7 degrees since Tuesday"
    assert since(known, date(2027, 1, 1)) == "since 2026-11-24"


@pytest.mark.parametrize("shift_m", [0.0, 0.006], ids=["as it was", "6 mm away"])
def test_carrying_the_vehicle_to_its_place_measures_the_marker_body_again(shift_m):
    carried = carry(6, Mounting((shift_m, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0), 0.0, 0.0, 0.0), seconds=20.0)
    watch = MarkerWatch(calibration(position_std_m=(2e-4, 2e-4, 2e-4)), VEHICLE, SUNDAY)
    samples = [Imu(t, tuple(w), tuple(a)) for t, w, a in zip(*carried.imu, strict=True)]
    samples += [Pose(t, tuple(p), tuple(q)) for t, p, q in zip(*carried.poses, strict=True)]
    end = max(s.device_s for s in samples)
    samples += [Imu(end + 0.005 * n, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81)) for n in range(1, 300)]
    last = Pose(end, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    samples += [Pose(end + 0.01 * n, last.position_m, last.quaternion) for n in range(1, 150)]
    for sample in sorted(samples, key=lambda s: s.device_s):
        watch.take(sample, sample.device_s)
    watch.wait()
    verdict = watch.verdict()
    assert verdict.ok == (shift_m == 0.0), verdict
    assert "since Tuesday" in verdict.seen


class CarriedVehicle(threading.Thread):
    """An autopilot in somebody's hands: heartbeats, HIGHRES_IMU as it was carried, TIMESYNC answered on its own
    clock.
    """

    def __init__(self, port: int, imu, began_s: float, ahead_s: float = 500.0):
        super().__init__(daemon=True)
        self._to, self._imu, self._began_s, self._ahead_s = ("127.0.0.1", port), imu, began_s, ahead_s
        self.stop = threading.Event()

    def run(self) -> None:
        codec = MavlinkCodec(system=1, component=1, gated=False)
        line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        line.settimeout(0.002)
        index, beat_s = 0, 0.0
        while not self.stop.is_set():
            now_s = time.monotonic()
            if now_s - beat_s > 0.5:
                beat_s = now_s
                line.sendto(codec.encode(mavlink.MAVLink_heartbeat_message(2, 12, 81, 0, 3, 3)), self._to)
            while index < len(self._imu[0]) and self._began_s + self._imu[0][index] <= now_s:
                t, w, a = (part[index] for part in self._imu)
                index += 1
                stamp = int(1e6 * (self._began_s + t + self._ahead_s))
                (ax, ay, az), (wx, wy, wz) = a, w
                values = (ax, -ay, -az, wx, -wy, -wz, 0.2, 0, 0.4, 1013.0, 0, 0, 20.0)
                line.sendto(codec.encode(mavlink.MAVLink_highres_imu_message(stamp, *values, 63)), self._to)
            try:
                for received in codec.decode(line.recv(4096)):
                    if received.name == "TIMESYNC" and received.message.tc1 == 0:
                        ours = int(1e9 * (time.monotonic() + self._ahead_s))
                        line.sendto(
                            codec.encode(mavlink.MAVLink_timesync_message(ours, received.message.ts1)), self._to
                        )
            except OSError:
                continue
        line.close()


def test_the_command_measures_a_carried_vehicle_over_mavlink_and_natnet(tmp_path):
    truth = Mounting((0.03, -0.02, 0.05), (0.05, -0.1, 0.6), (0.01, -0.005), 0.0, 0.0, 0.0)
    carried = carry(7, truth, Sensors(imu_hz=100.0, pose_hz=100.0), seconds=40.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    began_s = time.monotonic() + 1.0
    replay = Replay(
        carried.poses[0], list(zip(map(tuple, carried.poses[1]), map(tuple, carried.poses[2]), strict=True))
    )
    station = tmp_path / "hall.toml"
    with Server(Setup("natnet", rate_hz=100.0), replay, began_s) as server:
        station.write_text(f'[mocap]\nsystem = "natnet"\nhost = "{server.host}"\nbody = "drone"\n')
        vehicle = CarriedVehicle(port, carried.imu, began_s)
        vehicle.start()
        run = [sys.executable, "-P", "-m", "groundstation.cli", "calibrate", "--link", f"udpin://127.0.0.1:{port}",
               "--vehicle", "qball2", "--station", str(station), "--seconds", "10", "--yes"]  # fmt: skip
        done = subprocess.run(run, capture_output=True, text=True, timeout=120)
        vehicle.stop.set()
        vehicle.join()
    assert done.returncode == 0, done.stderr
    written = load_station(station).mocap.calibration
    np.testing.assert_allclose(written.position_m, truth.position_m, atol=2e-3)
    np.testing.assert_allclose(written.rotation_rad, truth.rotation_rad, atol=5e-3)
    assert abs(written.delay_s) < 0.01, "half a frame of the replay, and what a busy machine adds"
