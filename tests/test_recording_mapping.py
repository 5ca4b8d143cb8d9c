"""A log of any kind by a map: the same flight from a table, a Parquet file, a PX4, an ArduPilot and a bag's log."""

from __future__ import annotations

import numpy as np
import pytest

from groundstation.errors import BadInput
from groundstation.recording import convert, read_recording
from groundstation.recording.mapping import load_map, template
from groundstation.recording.recorded import vehicle_file
from tests.test_recording_settings import QUAD
from tests.written_logs import ArduLog, Px4Log, truth


def mapped(tmp_path, source, text):
    (tmp_path / "map.toml").write_text(text)
    (tmp_path / "quad.toml").write_bytes(vehicle_file(QUAD))
    convert(source, tmp_path / "out", vehicle=tmp_path / "quad.toml", mapped=tmp_path / "map.toml")
    return read_recording(tmp_path / "out").streams


def columns(form):
    return "\n".join(f"m{i}_command = {form.format(i=i, j=i - 1)}" for i in range(1, 5))


TABLE = """
[motors]
time = "time"
time_unit = "ms"
[motors.columns]
{motors}
[imu]
time = "time"
time_unit = "ms"
frame = "FRD"
[imu.columns]
gyro_x_rad_s = {{ column = "p", factor = 0.017453292519943295 }}
gyro_y_rad_s = {{ column = "q", factor = 0.017453292519943295 }}
gyro_z_rad_s = {{ column = "r", factor = 0.017453292519943295 }}
accel_x_m_s2 = {{ column = "ax", factor = 9.80665 }}
accel_y_m_s2 = {{ column = "ay", factor = 9.80665 }}
accel_z_m_s2 = {{ column = "az", factor = 9.80665 }}
"""


def rows():
    t, u = truth()
    imu = np.tile([90.0, 45.0, -30.0, 0.0, 0.5, -1.0], (len(t), 1))
    return t, u, np.column_stack([1000.0 * t, imu, 1000.0 + 1000.0 * u])


NAMES = ("time", "p", "q", "r", "ax", "ay", "az", "o1", "o2", "o3", "o4")


def check(streams, t, u):
    assert np.allclose(streams["motors"].values, u, atol=1e-9)
    assert np.allclose(streams["motors"].t_s, t)
    assert np.allclose(streams["imu"].values[0], [np.pi / 2, -np.pi / 4, np.pi / 6, 0.0, -0.5 * 9.80665, 9.80665])


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_a_table_by_a_map(tmp_path, separator):
    t, u, table = rows()
    lines = [separator.join(NAMES), *(separator.join(map(repr, row)) for row in table.tolist())]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    motors = columns('{{ column = "o{i}", offset = -1000.0, factor = 0.001 }}')
    check(mapped(tmp_path, tmp_path / "log.csv", TABLE.format(motors=motors)), t, u)


def test_a_parquet_file_by_a_map(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    t, u, table = rows()
    parquet.write_table(pyarrow.table(dict(zip(NAMES, table.T, strict=True))), tmp_path / "log.parquet")
    motors = columns('{{ column = "o{i}", offset = -1000.0, factor = 0.001 }}')
    check(mapped(tmp_path, tmp_path / "log.parquet", TABLE.format(motors=motors)), t, u)


def test_a_px4_log_by_a_map(tmp_path):
    t, u = truth()
    limits = dict.fromkeys((5, 6, 7, 8), (1000.0, 2000.0))
    (tmp_path / "a.ulg").write_bytes(Px4Log(channels=(5, 6, 7, 8), limits=limits).write(t, u))
    head = '[motors]\nsource = "actuator_outputs"\ntime = "timestamp"\ntime_unit = "us"\n[motors.columns]\n'
    body = "\n".join(
        f'm{i}_command = {{ column = "output[{i + 3}]", offset = -1000.0, factor = 0.001 }}' for i in range(1, 5)
    )
    imu = '\n[imu]\nsource = "sensor_combined"\ntime = "timestamp"\ntime_unit = "us"\nframe = "FRD"\n[imu.columns]\n'
    for k, axis in enumerate("xyz"):
        imu += f'gyro_{axis}_rad_s = "gyro_rad[{k}]"\naccel_{axis}_m_s2 = "accelerometer_m_s2[{k}]"\n'
    streams = mapped(tmp_path, tmp_path / "a.ulg", head + body + imu)
    assert np.allclose(streams["motors"].values, u, atol=1e-6)
    assert np.allclose(streams["imu"].values[0], [0.1, -0.2, -0.3, 0.0, 0.0, 9.8])


def test_an_ardupilot_log_by_a_map_with_one_instance(tmp_path):
    t, u = truth()
    (tmp_path / "a.bin").write_bytes(ArduLog(esc_instances=(0, 1, 2, 3)).write(t, u))
    head = '[motors]\nsource = "RCOU"\ntime = "TimeUS"\ntime_unit = "us"\nwhere = { C1 = 1000 }\n[motors.columns]\n'
    body = columns('{{ column = "C{i}", offset = -1000.0, factor = 0.001 }}')
    state = (
        '\n[imu]\nsource = "IMU"\ntime = "TimeUS"\ntime_unit = "us"\nframe = "FRD"\nwhere = { I = 0 }\n[imu.columns]\n'
    )
    for axis in "xyz":
        state += f'gyro_{axis}_rad_s = "Gyr{axis.upper()}"\naccel_{axis}_m_s2 = "Acc{axis.upper()}"\n'
    streams = mapped(tmp_path, tmp_path / "a.bin", head + body + state)
    assert len(streams["motors"]) == np.sum(np.round(1000.0 * u[:, 0]) == 0)
    assert len(streams["imu"]) == len(t)


def test_a_camera_whose_y_is_up_is_turned(tmp_path):
    """One metre up and a turn about the vertical: y and qy of such a camera are z and qz here."""
    lines = ["t,x,y,z,w,i,j,k,m", *(f"{0.01 * k},1.0,2.0,3.0,0.8,0.0,0.6,0.0,0.5" for k in range(5))]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    text = '[motors]\ntime = "t"\n[motors.columns]\n' + columns('"m"')
    text += '\n[mocap]\ntime = "t"\nframe = "y-up"\n[mocap.columns]\n'
    text += "".join(
        f'{ours} = "{theirs}"\n'
        for ours, theirs in zip(("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"), "xyzwijk", strict=True)
    )
    streams = mapped(tmp_path, tmp_path / "log.csv", text)
    assert streams["mocap"].values[0].tolist() == [1.0, -3.0, 2.0, 0.8, 0.0, -0.0, 0.6]


def test_faults_of_a_map_are_named(tmp_path):
    _, _, table = rows()
    lines = [",".join(NAMES), *(",".join(map(repr, row)) for row in table.tolist())]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    good = TABLE.format(motors=columns('"o{i}"'))
    for wrong, said in (
        (good.replace('"o3"', '"o9"'), r"no field o9, which the map names for \[motors\]"),
        (good.replace('m3_command = "o3"', ""), r"\[motors.columns\] lacks m3_command"),
        (good.replace('time_unit = "ms"', 'time_unit = "minutes"', 1), "motors.time_unit"),
        (good.replace("[motors]", '[motors]\nsource = "other"'), "has no table 'other'"),
        (good.replace("[imu]", "[imuu]").replace("[imu.columns]", "[imuu.columns]"), "imuu"),
        ("x = [", "not valid TOML"),
        ("x = " + "9" * 4400, "4300 digits"),
        (good[: good.index("[imu]")], "needs the motion too"),
    ):
        with pytest.raises(BadInput, match=said):
            mapped(tmp_path, tmp_path / "log.csv", wrong)
    with pytest.raises(BadInput, match="--map-template"):
        load_map(tmp_path / "none.toml")


def test_the_template_lists_what_there_is_and_is_a_map_once_filled(tmp_path):
    _, u, table = rows()
    lines = [",".join(NAMES), *(",".join(map(repr, row)) for row in table.tolist())]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    text = template(tmp_path / "log.csv", QUAD)
    assert "# log: 400 rows" in text
    assert "o1, o2, o3, o4" in text
    filled = text[: text.index("# [imu]")].replace('time = ""', 'time = "time"').replace('"us"', '"ms"')
    filled += "[imu]" + TABLE.split("[imu]")[1].format()
    for i in range(1, 5):
        filled = filled.replace(
            f'm{i}_command = ""', f'm{i}_command = {{ column = "o{i}", offset = -1000, factor = 0.001 }}'
        )
    assert np.allclose(mapped(tmp_path, tmp_path / "log.csv", filled)["motors"].values, u, atol=1e-9)
