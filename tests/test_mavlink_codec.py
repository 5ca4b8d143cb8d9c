"""Frames, signing, recorded traffic, samples and frames of reference."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mavlink import tlog
from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import EscStatus, mavlink
from drivers.mavlink.framing import Framer
from drivers.mavlink.geometry import flip, flip_quaternion, quaternion_of, rotate, turned, yaw_of
from drivers.mavlink.signing import Signing, signing_stamp
from drivers.mavlink.telemetry import Telemetry
from drivers.samples import Battery, Event, Imu, Motors, State
from groundstation.errors import BadInput
from groundstation.flight.link.signing_memory import SigningMemory
from groundstation.frames import quat_from_euler, quat_rotate

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
RECORDED = {"px4-sih/offboard.tlog": 43687, "arducopter/guided.tlog": 17218}
KEY = bytes(range(32))
NOW = signing_stamp(1.8e9)


def recorded(name: str) -> list[tuple[float, bytes]]:
    path = DATA / name
    if not path.is_file():
        pytest.skip(f"recorded traffic {path} is not here")
    return list(tlog.entries(path.read_bytes()))


def heartbeat(n: int = 0):
    return mavlink.MAVLink_heartbeat_message(2, 12, 0, n, 0, 3)


@pytest.mark.parametrize(("name", "frames"), RECORDED.items())
def test_recorded_traffic_decodes_whole_and_loses_nothing(name, frames):
    codec = MavlinkCodec()
    got = [r for _, data in recorded(name) for r in codec.decode(data, datagram=True)]
    assert len(got) == frames
    assert sum(c.lost for c in codec.counters.values()) == 0
    assert codec.framer.corrupt == 0


@pytest.mark.parametrize("name", RECORDED)
def test_recorded_traffic_as_a_byte_stream_gives_the_same_messages(name):
    first, codec = MavlinkCodec(), MavlinkCodec()
    whole = [r.frame.raw for _, data in recorded(name)[:4000] for r in first.decode(data, datagram=True)]
    stream = b"".join(whole)
    chunks = [stream[i : i + 61] for i in range(0, len(stream), 61)]
    assert [r.frame.raw for chunk in chunks for r in codec.decode(chunk)] == whole


def test_unknown_messages_pass_with_their_bytes():
    codec = MavlinkCodec()
    names = {r.name for _, data in recorded("px4-sih/offboard.tlog") for r in codec.decode(data, datagram=True)}
    assert {"UNKNOWN_8", "UNKNOWN_380", "UNKNOWN_410", "UNKNOWN_411"} <= names


def test_a_telemetry_log_reads_back_and_its_cut_end_is_left_out():
    frames = [MavlinkCodec().encode(heartbeat(n)) for n in range(3)]
    data = b"".join(tlog.record(1.5e9 + n, frame) for n, frame in enumerate(frames))
    assert [f for _, f in tlog.entries(data)] == frames
    assert [f for _, f in tlog.entries(data[:-4])] == frames[:-1]


@given(garbage=st.binary(max_size=40), cut=st.integers(1, 60))
@settings(max_examples=60, deadline=None)
def test_no_valid_frame_is_lost_behind_garbage_however_it_is_cut(garbage, cut):
    sender = MavlinkCodec(1, 1)
    frames = [sender.encode(heartbeat(n)) for n in range(12)]
    # The first frames may complete what the garbage seemed to start; a length byte reaches at most 280 bytes far.
    stream = garbage + b"".join(frames) + bytes(300)
    framer = Framer()
    got = [f.raw for i in range(0, len(stream), cut) for f in framer.feed(stream[i : i + cut]) if f.known]
    assert got == frames


def test_a_stray_start_marker_does_not_swallow_the_frame_behind_it():
    frame = MavlinkCodec(1, 1).encode(heartbeat())
    got = Framer().feed(b"\xfd\x20\x00\x00" + frame + bytes(64))
    assert [f.raw for f in got] == [frame]


def test_a_corrupted_frame_is_counted_and_its_neighbours_survive():
    sender, codec = MavlinkCodec(1, 1), MavlinkCodec()
    frames = [sender.encode(heartbeat(n)) for n in range(3)]
    broken = frames[1][:-1] + bytes([frames[1][-1] ^ 0x40])
    got = codec.decode(frames[0] + broken + frames[2])
    assert [r.message.custom_mode for r in got] == [0, 2]
    assert codec.framer.corrupt == 1
    assert codec.counters[1, 1].lost == 1


def test_lost_late_and_duplicate_frames_are_counted():
    sender, codec = MavlinkCodec(1, 1), MavlinkCodec()
    a, b, c, d = (sender.encode(heartbeat(n)) for n in range(4))
    for frame in (a, c, b, d):
        codec.decode(frame, datagram=True)
    counters = codec.counters[1, 1]
    assert (counters.received, counters.lost, counters.late) == (4, 0, 1)


def signed_pair(stamp: int = 10**9):
    return MavlinkCodec(1, 1, Signing(KEY, stamp)), MavlinkCodec(signing=Signing(KEY, stamp))


def test_signed_frames_are_accepted_once():
    sender, receiver = signed_pair()
    frame = sender.encode(heartbeat())
    assert len(receiver.decode(frame)) == 1
    assert receiver.decode(frame) == []
    assert receiver.signing.rejected["replayed"] == 1 and sum(receiver.signing.rejected.values()) == 1


def test_unsigned_and_wrongly_signed_frames_are_refused_and_radio_status_is_not():
    _, receiver = signed_pair()
    plain = MavlinkCodec(1, 1)
    assert receiver.decode(plain.encode(heartbeat())) == []
    assert receiver.decode(MavlinkCodec(1, 1, Signing(bytes(32), 10**9)).encode(heartbeat())) == []
    assert len(receiver.decode(plain.encode(mavlink.MAVLink_radio_status_message(1, 1, 1, 1, 1, 0, 0)))) == 1


def test_a_forged_stamp_from_the_future_does_not_lock_the_true_sender_out():
    sender, receiver = signed_pair()
    assert len(receiver.decode(sender.encode(heartbeat()))) == 1
    forged = MavlinkCodec(1, 1, Signing(b"x" * 32, 2**47)).encode(heartbeat())
    assert receiver.decode(forged) == []
    assert len(receiver.decode(sender.encode(heartbeat()))) == 1


def test_a_tampered_signed_frame_is_refused():
    sender, receiver = signed_pair()
    frame = bytearray(sender.encode(heartbeat()))
    frame[-14] ^= 1  # the link id is covered by the signature but not by the checksum
    assert receiver.decode(bytes(frame)) == [] or receiver.signing.rejected["forged"] == 1
    assert receiver.signing.rejected["forged"] <= 1


def test_a_new_stream_a_minute_behind_is_refused_as_replayed():
    _, receiver = signed_pair(signing_stamp(1.7e9))
    old = MavlinkCodec(1, 1, Signing(KEY, signing_stamp(1.7e9 - 61.0))).encode(heartbeat())
    assert receiver.decode(old) == []
    assert receiver.signing.rejected["replayed"] == 1


def test_pymavlink_accepts_what_we_sign():
    sender, _ = signed_pair()
    other = mavlink.MAVLink(None)
    other.signing.secret_key, other.signing.timestamp = KEY, 10**9
    assert other.decode(bytearray(sender.encode(heartbeat()))).get_signed() is not None
    assert other.signing.goodsig_count <= 1


def test_esc_status_has_the_published_checksum_seed_and_goes_round():
    assert EscStatus.crc_extra == 10
    sent = EscStatus(0, 123, [1000, -1100, 1200, 1300], [16.0] * 4, [2.0] * 4)
    (got,) = MavlinkCodec().decode(MavlinkCodec(1, 1).encode(sent))
    assert (got.message.time_usec, got.message.rpm, got.message.index) == (123, [1000, -1100, 1200, 1300], 0)


@given(st.tuples(*(st.floats(-3, 3) for _ in range(3))), st.tuples(*(st.floats(-1.4, 1.4) for _ in range(3))))
@settings(max_examples=50, deadline=None)
def test_the_flip_turns_vectors_and_attitudes_alike(vector, angles):
    """R_FLU->world (flip v) = flip (R_FRD->NED v): changing frames before or after rotating is the same."""
    q_ned = quaternion_of(*angles)
    before = rotate(flip_quaternion(q_ned), flip(vector))
    after = flip(rotate(q_ned, vector))
    np.testing.assert_allclose(before, after, atol=1e-12)
    np.testing.assert_allclose(q_ned, quat_from_euler(*angles), atol=1e-12)
    np.testing.assert_allclose(rotate(q_ned, vector), quat_rotate(q_ned, vector), atol=1e-12)
    assert math.isclose(yaw_of(flip_quaternion(quaternion_of(0.0, 0.0, angles[2]))), -angles[2], abs_tol=1e-12)


def test_turning_by_a_small_rate_is_the_exact_rotation_to_second_order():
    q = turned((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.01)
    assert math.isclose(yaw_of(q), 0.01, abs_tol=1e-6)


def take(telemetry: Telemetry, *messages) -> list:
    codec, sender = MavlinkCodec(), MavlinkCodec(1, 1)
    return [s for m in messages for r in codec.decode(sender.encode(m), datagram=True) for s in telemetry.samples(r)]


def test_a_vehicle_at_rest_shows_gravity_upwards_and_a_climb_is_positive():
    imu = mavlink.MAVLink_highres_imu_message(4_000_000, 0.1, 0.2, -9.81, 0.01, 0.02, 0.03, *(0,) * 7, 63)
    attitude = mavlink.MAVLink_attitude_quaternion_message(4000, 1, 0, 0, 0, 0, 0, 0)
    position = mavlink.MAVLink_local_position_ned_message(4000, 1.0, 2.0, -3.0, 0.1, 0.2, -0.3)
    first, state = take(Telemetry(4), imu, attitude, position)
    assert isinstance(first, Imu) and isinstance(state, State)
    np.testing.assert_allclose(first.accel_m_s2, (0.1, -0.2, 9.81), rtol=1e-6)
    np.testing.assert_allclose(first.gyro_rad_s, (0.01, -0.02, -0.03), rtol=1e-6)
    np.testing.assert_allclose(state.position_m, (1.0, -2.0, 3.0))
    np.testing.assert_allclose(state.velocity_m_s, (0.1, -0.2, 0.3), rtol=1e-6)


def test_odometry_velocity_is_turned_from_the_body_into_the_world():
    half = math.sqrt(0.5)
    east = mavlink.MAVLink_odometry_message(
        5_000_000, 1, 12, 0, 0, 0, [half, 0, 0, half], 1.0, 0, 0, 0, 0, 0, [0] * 21, [0] * 21
    )
    (state,) = take(Telemetry(4), east)
    np.testing.assert_allclose(state.velocity_m_s, (0.0, -1.0, 0.0), atol=1e-6)  # heading east is minus y with z up


def test_the_sources_of_one_state_never_mix():
    attitude = mavlink.MAVLink_attitude_quaternion_message(5000, 1, 0, 0, 0, 0, 0, 0)
    odometry = mavlink.MAVLink_odometry_message(
        5_000_000, 1, 12, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, [0] * 21, [0] * 21
    )
    position = mavlink.MAVLink_local_position_ned_message(5004, 9.0, 9.0, 9.0, 0, 0, 0)
    assert len(take(Telemetry(4), attitude, odometry, position)) == 1


@pytest.mark.parametrize(("odometry_s", "expected"), [(0.01, "odometry"), (1.8, "position")])
def test_the_better_source_of_a_state_counts_only_while_it_comes_as_often(odometry_s, expected):
    """A slow line carried ODOMETRY every 1.8 s, and each of them silenced the positions for a second."""
    stream = []
    for ms in range(1000, 9000, 50):
        stream.append(mavlink.MAVLink_attitude_quaternion_message(ms, 1, 0, 0, 0, 0, 0, 0))
        stream.append(mavlink.MAVLink_local_position_ned_message(ms, 1.0, 0, 0, 0, 0, 0))
        stream += [
            mavlink.MAVLink_odometry_message(us, 1, 12, 2.0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, [0] * 21, [0] * 21)
            for us in range(1000 * ms, 1000 * ms + 50000, 1000)
            if us % round(1e6 * odometry_s) == 0
        ]
    states = [s for s in take(Telemetry(4), *stream) if isinstance(s, State) and s.device_s > 4.0]
    wanted = {"position": 1.0, "odometry": 2.0}[expected]
    assert sum(s.position_m[0] == wanted for s in states) > 0.95 * len(states)
    gaps = np.diff([s.device_s for s in states])
    assert gaps.max() < 0.11


def test_duplicates_give_no_second_sample():
    imu = mavlink.MAVLink_highres_imu_message(4_000_000, 0, 0, -9.8, *(0,) * 10, 63)
    assert len(take(Telemetry(4), imu, imu)) == 1


def test_servo_outputs_keep_counting_when_their_32_bit_clock_wraps():
    late = 2**32 + 5_000_000
    imu = mavlink.MAVLink_highres_imu_message(late, 0, 0, -9.8, *(0,) * 10, 63)
    servo = mavlink.MAVLink_servo_output_raw_message(late + 4000 & 0xFFFFFFFF, 0, 1000, 1250, 1500, 2000, *(0,) * 4)
    motors = take(Telemetry(4), imu, servo)[1]
    assert isinstance(motors, Motors)
    assert math.isclose(motors.device_s, (late + 4000) * 1e-6)
    np.testing.assert_allclose(motors.values, (0.0, 0.25, 0.5, 1.0))


def test_rotor_speeds_come_in_radians_once_every_rotor_was_heard():
    esc = EscStatus(0, 1_000_000, [6000, -6000, 3000, 0], [0.0] * 4, [0.0] * 4)
    (speeds,) = take(Telemetry(4), esc)
    np.testing.assert_allclose(speeds.values, (628.3185, 628.3185, 314.1593, 0.0), rtol=1e-6)
    assert take(Telemetry(6), esc) == []
    more = EscStatus(4, 1_000_000, [6000, 6000, 0, 0], [0.0] * 4, [0.0] * 4)
    assert len(take(Telemetry(6), esc, more)[0].values) == 6


def test_battery_sums_its_cells_and_long_texts_are_joined():
    cells = mavlink.MAVLink_battery_status_message(0, 0, 0, 0, [4100, 4000, 3900, *(65535,) * 7], 1234, 0, 0, 80)
    first = mavlink.MAVLink_statustext_message(4, b"x" * 50, 7, 0)
    rest = mavlink.MAVLink_statustext_message(4, b"end", 7, 1)
    battery, text = take(Telemetry(4), cells, first, rest)
    assert isinstance(battery, Battery) and isinstance(text, Event)
    assert battery.voltage_v == pytest.approx(12.0) and battery.current_a == pytest.approx(12.34)
    assert text.text == "warning: " + "x" * 50 + "end"


def test_a_long_text_without_a_number_is_told_once():
    """PX4's firmware gives its first long text the number 0, which means a whole one, and appends a tab."""
    first = mavlink.MAVLink_statustext_message(2, b"Arming denied: Resolve system health failures firs", 0, 0)
    rest = mavlink.MAVLink_statustext_message(2, b"t\t", 0, 1)
    short = mavlink.MAVLink_statustext_message(6, b"Ready for takeoff!\t", 0, 0)
    texts = [e.text for e in take(Telemetry(4), first, rest, short)]
    assert texts == ["critical: Arming denied: Resolve system health failures firs", "info: Ready for takeoff!"]


def test_recorded_flights_are_seen_whole_by_the_telemetry():
    for name, imu, climb_m in (
        ("px4-sih/offboard.tlog", "HIGHRES_IMU", 1.5),
        ("arducopter/guided.tlog", "RAW_IMU", 1.4),
    ):
        codec, telemetry = MavlinkCodec(), Telemetry(4, imu=imu)
        samples = [s for _, d in recorded(name) for r in codec.decode(d, datagram=True) for s in telemetry.samples(r)]
        states = [s for s in samples if isinstance(s, State)]
        imus = [s for s in samples if isinstance(s, Imu)]
        height = np.array([s.position_m[2] for s in states])
        assert height.max() - height[0] > climb_m, name
        position, velocity = (np.array([getattr(s, f) for s in states]) for f in ("position_m", "velocity_m_s"))
        time = np.array([s.device_s for s in states])
        # The estimator corrects its position now and then, so the typical half second counts, in every axis.
        grid = np.arange(time[0], time[-1], 0.5)
        moved = np.diff([np.interp(grid, time, c) for c in position.T], axis=1)
        steps = np.concatenate([np.zeros((1, 3)), np.cumsum(np.diff(time)[:, None] * velocity[1:], axis=0)])
        flown = np.diff([np.interp(grid, time, c) for c in steps.T], axis=1)
        fast = np.abs(flown) > 0.1
        assert fast.any(axis=1).all()
        assert np.median(moved[fast] / flown[fast]) == pytest.approx(1.0, abs=0.2), name
        assert abs(np.mean([s.accel_m_s2[2] for s in imus]) - 9.8) < 0.1, name


def signed_by(key: bytes, stamp: int, system: int = 1) -> bytes:
    return MavlinkCodec(system, 1, signing=Signing(key, stamp)).encode(heartbeat())


def test_a_stamp_at_the_end_of_its_48_bits_is_refused_and_ends_nothing():
    receiver = MavlinkCodec(signing=Signing(KEY, NOW))
    last = MavlinkCodec(1, 1, signing=Signing(KEY, NOW))
    last.signing.stamp = (1 << 48) - 1
    assert receiver.decode(last.encode(heartbeat())) == []
    assert receiver.signing.rejected["ahead"] == 1
    receiver.encode(heartbeat())
    receiver.signing.advance(1 << 60)
    assert receiver.encode(heartbeat()) and receiver.encode(heartbeat())


def test_a_vehicle_a_year_ahead_is_followed_and_locks_no_other_out():
    receiver, year = MavlinkCodec(signing=Signing(KEY, NOW)), 3_155_760_000_000
    assert len(receiver.decode(signed_by(KEY, NOW + year))) == 1
    assert receiver.signing.stamp > NOW + year, "it takes nothing older"
    assert len(receiver.decode(signed_by(KEY, NOW, system=2))) == 1


def test_a_restarted_station_takes_no_frame_that_was_recorded_before(tmp_path):
    memory = SigningMemory(tmp_path / "signing.json", KEY, 1.8e9)
    first = MavlinkCodec(signing=memory.signing)
    recorded = signed_by(KEY, memory.signing.stamp - 1000)
    assert len(first.decode(recorded)) == 1
    sent = memory.signing.stamp
    memory.write()
    again = SigningMemory(tmp_path / "signing.json", KEY, 1.8e9 + 5.0)
    assert MavlinkCodec(signing=again.signing).decode(recorded) == []
    assert again.signing.rejected["replayed"] == 1
    assert again.signing.stamp > sent, "no stamp is used twice"
    (tmp_path / "signing.json").write_text("[1")
    with pytest.raises(BadInput, match="cannot be read"):
        SigningMemory(tmp_path / "signing.json", KEY, 1.8e9)
