"""Bundles: without loss to MCAP and back, and every malformed one refused in a sentence that names the place."""

from __future__ import annotations

import math
import re
import time
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.errors import BadInput
from groundstation.flightdata import Stream, motor_columns
from groundstation.recording import convert, load_flight, read_recording, write_bundle
from groundstation.vehicle import vehicle_from_dict, vehicle_to_dict
from tests.recording_flight import flight, qball


@pytest.fixture(scope="module")
def pristine(tmp_path_factory):
    return write_bundle(flight(), tmp_path_factory.mktemp("pristine") / "bundle")


@pytest.fixture
def bundle(pristine, tmp_path):
    folder = tmp_path / "bundle"
    folder.mkdir()
    for path in pristine.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


def edit(path, change):
    """Rewrite a CSV file row by row: ``change(row number from 0, dict)`` returns the dict to write, or None to drop
    it.
    """
    head, *lines = path.read_text().splitlines()
    names = head.split(",")
    rows = [change(k, dict(zip(names, line.split(","), strict=True))) for k, line in enumerate(lines)]
    rows = [row for row in rows if row is not None]
    keys = list(rows[0])
    path.write_text("\n".join([",".join(keys), *(",".join(row[key] for key in keys) for row in rows)]) + "\n")


def column(path, name, function):
    edit(path, lambda k, row: {**row, name: repr(float(function(float(row[name]))))})


def tree(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def assert_same(one, other):
    assert set(one.streams) == set(other.streams)
    for part in ("streams", "extras"):
        for name, stream in getattr(one, part).items():
            twin = getattr(other, part)[name]
            assert np.array_equal(stream.t_s, twin.t_s, equal_nan=True), name
            assert np.array_equal(stream.values, twin.values, equal_nan=True), name
            assert stream.columns == twin.columns
            if stream.received_s is None:
                assert twin.received_s is None
            else:
                assert np.array_equal(stream.received_s, twin.received_s, equal_nan=True), name
    assert {k: (v.rows, v.columns) for k, v in one.texts.items()} == {
        k: (v.rows, v.columns) for k, v in other.texts.items()
    }
    assert dict(one.files) == dict(other.files)
    assert (one.name, one.window_s, dict(one.metadata)) == (other.name, other.window_s, dict(other.metadata))


def test_a_bundle_to_mcap_and_back_is_the_same_folder(bundle, tmp_path):
    (bundle / "notes.md").write_text("windy, \r\n second try")
    (bundle / "photos").mkdir()
    (bundle / "photos" / "rig.bin").write_bytes(bytes(range(256)))
    (bundle / "vehicle.toml").write_text("# weighed twice\n" + (bundle / "vehicle.toml").read_text())
    edit(
        bundle / "imu.csv",
        lambda k, row: {**row, "temperature_c": repr(20.0 + k / 7), "mode": "loiter"},
    )
    edit(bundle / "motors.csv", lambda k, row: {**row, "stamp_ns": str(1700000000000000001 + k)})
    assert convert(bundle, tmp_path / "a.mcap") == ()
    assert convert(tmp_path / "a.mcap", tmp_path / "back") == ()
    assert tree(tmp_path / "back") == tree(bundle)


def test_extra_columns_and_text_cells_with_commas_are_carried(bundle, tmp_path):
    path = bundle / "battery.csv"
    head, *lines = path.read_text().splitlines()
    path.write_text("\n".join([head + ",remark", *(f'{line},"sag, {k}"' for k, line in enumerate(lines))]) + "\n")
    recording = read_recording(bundle)
    assert recording.texts["battery"].rows[3] == ("sag, 3",)
    convert(bundle, tmp_path / "a.mcap")
    assert_same(recording, read_recording(tmp_path / "a.mcap"))


numbers = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=40, deadline=None)
@given(
    times=st.lists(st.tuples(numbers, numbers), min_size=1, max_size=6),
    values=st.lists(numbers, min_size=6, max_size=6),
)
def test_any_doubles_survive_both_ways(tmp_path_factory, times, values):
    """Blemished samples too: conversion repairs nothing."""
    folder = tmp_path_factory.mktemp("doubles")
    t_s, received = (np.array(part) for part in zip(*times, strict=True))
    base = flight(0.5)
    imu = Stream(t_s, np.tile(values, (len(t_s), 1)), base.imu.columns, received)
    write_bundle(replace(base, imu=imu), folder / "a")
    convert(folder / "a", folder / "b.mcap")
    convert(folder / "b.mcap", folder / "c")
    back = read_recording(folder / "c").streams["imu"]
    assert np.array_equal(back.t_s, t_s, equal_nan=True)
    assert np.array_equal(back.values, imu.values, equal_nan=True)
    if not np.isnan(received).all():
        assert np.array_equal(back.received_s, received, equal_nan=True)


def test_a_sound_flight_is_read_without_a_word_and_unchanged(pristine):
    loaded, made = load_flight(pristine), flight()
    assert loaded.notes == ()
    assert loaded.vehicle == made.vehicle
    assert loaded.plan == made.plan
    assert loaded.window_s == made.window_s
    for name, stream in made.streams().items():
        twin = getattr(loaded, name)
        assert np.array_equal(stream.t_s, twin.t_s)
        assert np.array_equal(stream.received_s, twin.received_s) or stream.received_s is None
        assert np.allclose(stream.values, twin.values, atol=1e-12, rtol=0.0), name


@pytest.mark.parametrize("scale", [0.3, 1.5, 2.0])
def test_a_legitimate_flight_is_never_refused_slow_or_fast(tmp_path, scale):
    """At twice its speed the trajectory turns at 3.4 rad/s and its rotors nearly stop: a lively flight is no
    blemish.
    """
    made = flight(scale=scale)
    loaded = load_flight(write_bundle(made, tmp_path / "b"))
    assert loaded.notes == ()
    assert all(len(getattr(loaded, name)) == len(stream) for name, stream in made.streams().items())


def test_columns_may_stand_in_any_order_with_spaces_windows_lines_and_a_byte_order_mark(bundle):
    path = bundle / "mocap.csv"
    edit(path, lambda k, row: dict(reversed(row.items())))
    text = path.read_text()
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").replace(",", ", ").encode())
    assert np.array_equal(load_flight(bundle).mocap.values, load_flight_values(flight().mocap))


def load_flight_values(stream):
    q = stream.values[:, 3:] / np.linalg.norm(stream.values[:, 3:], axis=1, keepdims=True)
    return np.hstack([stream.values[:, :3], q])


def test_an_empty_cell_is_a_missing_value_not_an_error(bundle):
    edit(bundle / "imu.csv", lambda k, row: {**row, "gyro_x_rad_s": "" if k == 40 else row["gyro_x_rad_s"]})
    loaded = load_flight(bundle)
    assert len(loaded.imu) == len(flight().imu)
    assert any(re.search(r"imu: 1 of 1500 samples .*not numbers", note) for note in loaded.notes)


def test_a_last_line_cut_off_is_left_out_and_said(bundle):
    path = bundle / "imu.csv"
    text = path.read_text()
    path.write_text(text[: text.rstrip("\n").rfind(",") - 30])
    loaded = load_flight(bundle)
    assert len(loaded.imu) == len(flight().imu) - 1
    assert any("cut off" in note for note in loaded.notes)


def test_sixty_seconds_at_500_hz_load_in_half_a_second(tmp_path):
    rng = np.random.default_rng(0)
    base = flight(2.0)
    t_s = np.arange(30000) / 500.0

    def grown(stream, count):
        rows = np.arange(count) % len(stream)
        t = np.linspace(0.0, 60.0, count)
        return Stream(
            t, stream.values[rows] + rng.normal(size=(count, stream.values.shape[1])) * 1e-4, stream.columns, t
        )

    big = replace(
        base,
        motors=grown(base.motors, len(t_s)),
        imu=grown(base.imu, len(t_s)),
        mocap=grown(base.mocap, 6000),
        state=None,
    )
    write_bundle(big, tmp_path / "b")
    best = math.inf
    for _ in range(3):
        start = time.process_time()
        load_flight(tmp_path / "b")
        best = min(best, time.process_time() - start)
    assert best < 0.5


# Malformed input: one sentence that names file, line or column, what is wrong, and what to do.


def refused(folder, *parts, vehicle=None):
    with pytest.raises(BadInput) as caught:
        load_flight(folder, vehicle=vehicle)
    text = str(caught.value)
    assert "\n" not in text
    assert text.endswith(".")
    for part in parts:
        assert part in text, text


@pytest.mark.parametrize("name", ["motors.csv", "vehicle.toml"])
def test_a_missing_file(bundle, name):
    (bundle / name).unlink()
    refused(bundle, name, "missing")


def test_no_motion_at_all(bundle):
    for name in ("imu.csv", "mocap.csv", "state.csv"):
        (bundle / name).unlink()
    refused(bundle, "imu.csv", "mocap.csv", "state.csv", "missing")


@pytest.mark.parametrize("keep", ["imu.csv", "mocap.csv", "state.csv"])
def test_any_one_source_of_motion_will_do(bundle, keep):
    for name in {"imu.csv", "mocap.csv", "state.csv"} - {keep}:
        (bundle / name).unlink()
    assert keep.removesuffix(".csv") in load_flight(bundle).streams()


def test_a_folder_that_is_not_there(tmp_path):
    refused(tmp_path / "nowhere", "nowhere", "no such file")


def test_a_missing_column(bundle):
    edit(bundle / "mocap.csv", lambda k, row: {key: cell for key, cell in row.items() if key != "qy"})
    refused(bundle, "mocap.csv", "qy", "missing")


def test_text_for_a_number(bundle):
    edit(bundle / "imu.csv", lambda k, row: {**row, "accel_y_m_s2": "n/a" if k == 120 else row["accel_y_m_s2"]})
    refused(bundle, "imu.csv", "line 122", "accel_y_m_s2", "'n/a'")


def test_a_line_with_too_few_cells(bundle):
    path = bundle / "mocap.csv"
    lines = path.read_text().splitlines()
    lines[10] = "1.0,2.0"
    path.write_text("\n".join(lines) + "\n")
    refused(bundle, "mocap.csv", "line 11", "2 cells")


def test_a_file_without_a_header(bundle):
    path = bundle / "imu.csv"
    path.write_text("\n".join(path.read_text().splitlines()[1:]) + "\n")
    refused(bundle, "imu.csv", "line 1", "name the columns")


@pytest.mark.parametrize(("separator", "named"), [("|", "'|'"), (" ", "spaces"), ("  ", "spaces")])
def test_a_separator_that_is_not_read_is_named(bundle, separator, named):
    path = bundle / "motors.csv"
    path.write_text(path.read_text().replace(",", separator))
    refused(bundle, "motors.csv", f"line 1 names its columns with {named} between")


def test_a_column_named_twice(bundle):
    path = bundle / "battery.csv"
    path.write_text(path.read_text().replace("current_a", "voltage_v", 1))
    refused(bundle, "battery.csv", "voltage_v", "twice")


def test_a_file_without_samples(bundle):
    path = bundle / "mocap.csv"
    path.write_text(path.read_text().splitlines()[0] + "\n")
    refused(bundle, "mocap.csv", "no samples")


def test_an_empty_file(bundle):
    (bundle / "mocap.csv").write_text("")
    refused(bundle, "mocap.csv", "empty")


def test_bytes_that_are_no_text(bundle):
    (bundle / "mocap.csv").write_bytes(b"\xff\xfe\x00\x01" * 40)
    refused(bundle, "mocap.csv", "not UTF-8")


def test_quaternions_far_from_unit_throughout(bundle):
    for name in ("qw", "qx", "qy", "qz"):
        column(bundle / "mocap.csv", name, lambda value: 57.3 * value)
    refused(bundle, "mocap", "qw", "unit length")


@pytest.mark.parametrize("scale", [1.2, 2.0])
@pytest.mark.parametrize("kept", [("mocap.csv", "state.csv"), ("state.csv",), ()])
def test_a_gyro_in_degrees(tmp_path, kept, scale):
    """Told from the poses, or from the vehicle's own estimate, or from what the rotors can do."""
    folder = write_bundle(flight(scale=scale), tmp_path / "b")
    for name in {"mocap.csv", "state.csv"} - set(kept):
        (folder / name).unlink()
    for axis in "xyz":
        column(folder / "imu.csv", f"gyro_{axis}_rad_s", math.degrees)
    refused(folder, "imu", "gyro", "degrees")


def test_an_accelerometer_in_g(bundle):
    for axis in "xyz":
        column(bundle / "imu.csv", f"accel_{axis}_m_s2", lambda value: value / 9.80665)
    refused(bundle, "imu", "accel", "in g")


def test_an_accelerometer_without_gravity(bundle):
    column(bundle / "imu.csv", "accel_z_m_s2", lambda value: value - 9.80665)
    refused(bundle, "imu", "accel", "without gravity")


def test_gravity_upside_down(bundle):
    for axis in "yz":
        column(bundle / "imu.csv", f"accel_{axis}_m_s2", lambda value: -value)
    refused(bundle, "imu", "upside down", "accel_z_m_s2")


def test_rotor_speeds_in_rpm(bundle):
    for i in range(1, 5):
        column(bundle / "motors.csv", f"m{i}_rad_s", lambda value: value * 60.0 / (2.0 * math.pi))
    refused(bundle, "motors", "rpm")


def test_commands_in_microseconds(bundle):
    edit(bundle / "motors.csv", lambda k, row: {"t_s": row["t_s"], **{f"m{i}_command": "1480" for i in range(1, 5)}})
    document = vehicle_to_dict(qball())
    document["rotors"]["input"] = "command"
    (bundle / "vehicle.toml").write_text(tomli_w.dumps(document))
    refused(bundle, "motors", "m1_command", "0 to 1")


def test_positions_in_millimetres(tmp_path):
    folder = write_bundle(flight(scale=2.0), tmp_path / "b")
    for axis in "xyz":
        column(folder / "mocap.csv", f"{axis}_m", lambda value: 1000.0 * value)
    refused(folder, "mocap", "metres")


def test_a_battery_in_millivolts(bundle):
    column(bundle / "battery.csv", "voltage_v", lambda value: 1000.0 * value)
    refused(bundle, "battery", "voltage_v", "volts")


@pytest.mark.parametrize(("wrong", "said"), [(3, "m4_rad_s"), (6, "m5_rad_s")])
def test_a_wrong_number_of_rotors(bundle, wrong, said):
    names = motor_columns("rotor_speed", wrong)
    edit(bundle / "motors.csv", lambda k, row: {"t_s": row["t_s"], **dict.fromkeys(names, "600.0")})
    refused(bundle, "motors.csv", said, "4 rotors")


def test_motor_values_of_another_kind_than_declared(bundle):
    edit(bundle / "motors.csv", lambda k, row: {"t_s": row["t_s"], **{f"m{i}_command": "0.5" for i in range(1, 5)}})
    refused(bundle, "motors.csv", "m1_command", 'input = "rotor_speed"')


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("\n[rotor]\nx = 1\n", ("rotor",)),
        ("\n[imu]\npositon_m = [0.0, 0.0, 0.0]\n", ("positon_m",)),
        ("\nthis is no toml\n", ("not valid TOML",)),
    ],
)
def test_an_unknown_or_misspelt_key(bundle, text, parts):
    path = bundle / "vehicle.toml"
    kept = path.read_text().split("[imu]")[0]
    path.write_text(kept + text)
    refused(bundle, "vehicle.toml", *parts)


@pytest.mark.parametrize("name", ["imu", "motors", "mocap"])
def test_time_that_runs_backwards_over_the_whole_file(bundle, name):
    column(bundle / f"{name}.csv", "t_s", lambda value: -value)
    refused(bundle, name, "backwards")


def test_a_vehicle_on_the_command_line_overrides_the_bundles_own(bundle):
    heavier = qball().model_copy(update={"mass_kg": 2.5})
    assert load_flight(bundle, vehicle=heavier).vehicle.mass_kg == 2.5
    (bundle / "vehicle.toml").unlink()
    assert load_flight(bundle, vehicle=heavier).vehicle.mass_kg == 2.5


def test_a_target_that_holds_something_is_left_alone(bundle, tmp_path):
    target = tmp_path / "out"
    target.mkdir()
    (target / "mine.txt").write_text("keep")
    with pytest.raises(BadInput, match="not empty"):
        convert(bundle, target)
    assert tree(target) == {"mine.txt": b"keep"}


def test_an_attachment_cannot_leave_the_folder(bundle, tmp_path):
    from groundstation.recording import McapRecorder
    from groundstation.recording.recorded import vehicle_file

    files = {"vehicle.toml": vehicle_file(qball()), "../evil.txt": b"x", "imu.csv": b"y"}
    path = tmp_path / "a.mcap"
    with McapRecorder(path, {}, files):
        pass
    said = convert(path, tmp_path / "deep" / "out")
    assert any("../evil.txt" in text for text in said)
    assert any("imu.csv" in text for text in said)
    assert not (tmp_path / "deep" / "evil.txt").exists()
    assert not (tmp_path / "deep" / "out" / "imu.csv").exists()


def test_a_part_of_the_flight_is_cut_on_every_streams_own_clock(pristine):
    """Motors' clock runs from 3.25 s, motion capture's from -1.5 s: arrival times relate them."""
    part = load_flight(pristine, start_s=4.25, end_s=6.25)
    assert part.window_s == (4.25, 6.25)
    assert (part.motors.t_s[0], part.motors.t_s[-1]) == (4.25, 6.25)
    assert part.mocap.t_s[0] == pytest.approx(-0.5, abs=0.02)
    assert part.mocap.t_s[-1] == pytest.approx(1.5, abs=0.02)
    with pytest.raises(BadInput, match="no motor samples between"):
        load_flight(pristine, start_s=100.0)


def test_conversion_tells_what_was_lost_before_it_and_nothing_else(bundle, tmp_path):
    recording = tmp_path / "a.mcap"
    assert convert(bundle, recording) == ()
    data = recording.read_bytes()
    recording.write_bytes(data[: len(data) // 2])
    assert [("cut off" in text) for text in convert(recording, tmp_path / "back")] == [True]
    assert any("cut off" in note for note in load_flight(tmp_path / "back").notes)


def test_a_recording_of_another_kind_of_motors_than_the_given_vehicles_is_refused(bundle, tmp_path):
    convert(bundle, tmp_path / "a.mcap")
    document = vehicle_to_dict(qball())
    document["rotors"]["input"] = "command"
    refused(tmp_path / "a.mcap", "m1_rad_s", "m1_command", vehicle=vehicle_from_dict(document))


def test_a_flight_by_the_wrench_alone(tmp_path):
    made = flight(1.0)
    document = vehicle_to_dict(made.vehicle)
    document["rotors"]["input"] = "wrench"
    vehicle = vehicle_from_dict(document)
    wrench = made.vehicle.thrust(made.motors.values) @ made.vehicle.allocation().T
    motors = Stream(made.motors.t_s, wrench, motor_columns("wrench", 4), made.motors.received_s)
    folder = write_bundle(replace(made, vehicle=vehicle, motors=motors), tmp_path / "b")
    convert(folder, tmp_path / "a.mcap")
    for path in (folder, tmp_path / "a.mcap"):
        loaded = load_flight(path)
        assert np.array_equal(loaded.motors.values, wrench)
        assert loaded.motors.columns == ("force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
