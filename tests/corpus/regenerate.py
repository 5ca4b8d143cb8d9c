"""Small sound files of every kind that is read from outside: what :mod:`studies.fuzz` mutates.

python -m tests.corpus.regenerate          # writes them again; regressions (crash-*) are left alone
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import tomli_w

from drivers.mocap.session import SYSTEMS
from drivers.samples import Batch, Battery, Event, Imu, Motors, Pose, Raw, Setpoint, State, encode_batch
from groundstation.fleet.catalogue import Catalogue
from groundstation.paths import configs_dir
from groundstation.recording import container, write_bundle, write_mcap
from groundstation.recording.mcapfile import read_mcap, write_recording_as_mcap
from groundstation.vehicle import load_vehicle, vehicle_to_dict
from tests.recording_flight import flight
from tests.test_mocap_wire import said
from tests.test_recording_autopilots import write_dataflash, write_ulog
from tests.test_recording_blackbox import flown
from tests.test_recording_crazyflie import IMU_VARIABLES, usd
from tests.test_recording_mapping import NAMES, TABLE, columns
from tests.test_recording_rosbag import StoragePlugin, bag, standard
from tests.written_logs import truth

HERE = Path(__file__).parent
SHORT_S = 0.08


def servers(folder: Path) -> None:
    """What each motion-capture server says, as ``studies.fuzz_readers`` takes it."""
    for number, system in enumerate(SYSTEMS):
        messages = b"".join(len(data).to_bytes(4, "little") + data for data in said(system))
        (folder / f"{system}.bin").write_bytes(bytes([number]) + messages)


def recordings() -> None:
    """Recordings of our own and foreign ones, a fraction of a second each."""
    made = flight(SHORT_S)
    compressed = write_mcap(made, fresh("mcap") / "zstd.mcap")
    plain = HERE / "mcap" / "plain.mcap"  # without compression and checksum, so that mutations reach the messages
    crc, compressor = container.zlib.crc32, container.zstandard.ZstdCompressor
    container.zlib.crc32 = lambda data: 0
    container.zstandard.ZstdCompressor = lambda level: Plain()
    try:
        write_recording_as_mcap(read_mcap(compressed), plain)
    finally:
        container.zlib.crc32, container.zstandard.ZstdCompressor = crc, compressor
    plain.write_bytes(plain.read_bytes().replace(b"\x04\0\0\0zstd", b"\0\0\0\0"))
    shutil.copytree(HERE / "mcap", fresh("convert"), dirs_exist_ok=True)
    shutil.rmtree(HERE / "bundle", ignore_errors=True)
    write_bundle(made, HERE / "bundle" / "b")
    longer = flight(0.2)
    write_ulog(fresh("ulog") / "a.ulg", longer)
    write_dataflash(fresh("dataflash") / "a.bin", longer)
    rows = [(1000 * k, 0.0, 0.0, 1.0, 0.1, 0.0, 0.0, 1, 2, 3, 4) for k in range(100)]
    (fresh("usd") / "log00").write_bytes(usd(rows, IMU_VARIABLES))
    samples = (
        *(Imu(1.0, (0.1, 0.2, 0.3), (0.0, 0.0, 9.8)), Pose(1.0, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0))),
        *(Motors(1.0, (400.0,) * 4), Battery(1.0, 12.1, 3.0), Setpoint(1.0, (0.0, 0.0, 1.0), 0.0)),
        *(Event(1.0, "phase", "armed"), Raw(1.0, "in", b"\xfd\x09")),
        State(1.0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    )
    servers(fresh("mocap"))
    (fresh("batch") / "batch").write_bytes(encode_batch(Batch(3, (51.0,) * len(samples), samples)))
    others()


def others() -> None:
    """A blackbox log, ROS 2 bags of both stores, and a table with the map that says what its columns are."""
    t, u = truth()
    few = slice(60, 160)  # a second about take-off
    flown(fresh("blackbox"), u[few])
    _, topics = standard()
    short = {name: (kind, rows[: 20 if name == "/motors" else 12]) for name, (kind, rows) in topics.items()}
    for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3):
        shutil.rmtree(HERE / "rosbag" / plugin.name.lower(), ignore_errors=True)
        (HERE / "rosbag").mkdir(exist_ok=True)
        bag(HERE / "rosbag" / plugin.name.lower(), plugin, short)
    folder = fresh("map/table")
    form = '{{ column = "o{i}", offset = -1000.0, factor = 0.001 }}'
    (folder / "map.toml").write_text(TABLE.format(motors=columns(form)))
    lines = [",".join(NAMES)]
    lines += [
        ",".join(map(repr, (1000.0 * at, 90.0, 45.0, -30.0, 0.0, 0.5, -1.0, *(1000.0 + 1000.0 * x for x in row))))
        for at, row in zip(t[few].tolist(), u[few].tolist(), strict=True)
    ]
    (folder / "log.csv").write_text("\n".join(lines) + "\n")


class Plain:
    """A compressor that does not compress."""

    def compress(self, data: bytes) -> bytes:
        """The same."""
        return data


def fresh(name: str) -> Path:
    """The folder of a reader's seeds."""
    folder = HERE / name
    folder.mkdir(parents=True, exist_ok=True)
    for path in folder.iterdir():
        if path.is_file() and not path.name.startswith("crash-"):
            path.unlink()
    return folder


def settings() -> None:
    """Vehicles, plans, stations, scenarios as they ship."""
    for kind, folder in (
        ("vehicle", "vehicles"),
        ("plan", "plans"),
        ("station", "stations"),
        ("scenario", "scenarios"),
    ):
        for path in sorted((configs_dir() / folder).glob("*.toml")):
            (fresh(kind) if path.stem == "clean" or kind != "scenario" else HERE / kind).mkdir(exist_ok=True)
            shutil.copy(path, HERE / kind / path.name)


def estimate(value: float, std: float) -> dict:
    """As documents hold it."""
    return {"value": value, "std": std, "ci95": [value - 2.0 * std, value + 2.0 * std]}


def results() -> None:
    """Documents of an identification and a diagnosis, a catalogue of flights, journals."""
    declared = load_vehicle(configs_dir() / "vehicles" / "qball2.toml")
    parameters = {"mass_kg": estimate(1.62, 0.002), "ixx_kg_m2": estimate(0.03, 1e-4)}
    model = {"rotor_lag_up_s": estimate(0.045, 1e-3), "thrust_coefficient_n_s2": estimate(1.2e-5, 1e-7)}
    method = {"parameters": parameters, "condition_number": 16.2, "rms_output_error": {"force_z_n": 0.1}, "note": ""}
    identification = {
        **{"schema": "groundstation.identification/1", "flight": "f1", "vehicle": "qball2", "anchor": "thrust"},
        **{"methods": {"LS": method, "PE": method}, "model": model, "best": "PE", "best_reason": "smallest error"},
        **{"clock": {"mocap_minus_imu_s": 0.001, "std_s": 1e-4}, "not_identifiable": ["com_offset_z_m"]},
        **{"remedies": {"com_offset_z_m": "tilt"}, "warnings": ["short"], "quality": ["imu: fine"]},
        "validation": [
            {
                "kind": "output",
                "samples": 5,
                "note": "",
                "rms": {"nominal": {"force_z_n": 0.2}, "PE": {"force_z_n": 0.1}},
            }
        ],
    }
    finding = {
        **{"effect": "rotor_drag", "parameters": {"d_x_kg_s": estimate(0.3, 0.01), "d_y_kg_s": estimate(0.3, 0.01)}},
        **{"evidence": "drag in x", "confidence": 0.99, "alternatives": ["body_drag"], "rotor": None},
    }
    weak = {
        "effect": "weak_rotor",
        "parameters": {"loss": estimate(0.1, 0.01)},
        "evidence": "",
        "confidence": 0.9,
        "alternatives": [],
        "rotor": 2,
    }
    lag = {
        "effect": "motor_lag",
        "parameters": {"rotor_lag_up_s": estimate(0.04, 0.001)},
        "evidence": "",
        "confidence": 0.9,
        "alternatives": ["input_delay"],
        "rotor": None,
    }
    diagnosis = {
        **{"schema": "groundstation.diagnosis/1", "flight": "f1", "vehicle": "qball2", "verdict": "explained"},
        **{"findings": [finding, weak, lag], "parameters_before": parameters, "parameters_after": parameters},
        "unexplained": [{"channel": "force_z_n", "share": 0.12, "depends_on": ["position_x_m"], "proposal": "look"}],
        "error": {
            "held_out": {"before": {"force_x_n": 0.41}, "after": {"force_x_n": 0.06}, "nominal": {"force_x_n": 0.5}}
        },
        "candidates": [
            {
                "effect": "body_drag",
                "settings": {},
                "evidence": 3.0,
                "values": {"c_kg_m": 0.1},
                "rival_of": "rotor_drag",
            }
        ],
        **{"next_flight": "fly faster", "reason": "", "warnings": []},
    }
    document = {
        **{"schema": "groundstation.model/1", "flight": "f1", "method": "PE", "vehicle": vehicle_to_dict(declared)},
        **{"parameters": parameters, "model": model, "not_identifiable": ["com_offset_z_m"]},
        "effects": {
            "rotor_drag": finding["parameters"],
            "weak_rotor": {"loss": estimate(0.1, 0.01), "rotor": {"value": 2.0, "std": 0.0}},
        },
    }
    (fresh("model") / "a.toml").write_text(tomli_w.dumps(document))
    (HERE / "model" / "b.json").write_text(json.dumps(identification))
    (fresh("diagnosis") / "a.json").write_text(json.dumps(diagnosis))
    for number in (1, 2):
        folder = fresh(f"catalogue/logs/f{number}")
        (folder / "identification.json").write_text(json.dumps({**identification, "flight": f"f{number}"}))
        (folder / "diagnosis.json").write_text(json.dumps(diagnosis))
        (folder / "refused.json").write_text(json.dumps({"reason": "too short", "remedy": "fly longer"}))
    shutil.rmtree(HERE / "database", ignore_errors=True)
    shutil.copytree(HERE / "catalogue", HERE / "database")
    Catalogue(HERE / "database" / "logs")  # leaves its Parquet file there
    lines = [
        {"monotonic_s": 1.5, "kind": "phase", "text": "armed"},
        {"monotonic_s": 2.5, "kind": "outcome", "text": "done", "exit_status": 0, "reason": ""},
    ]
    journal = fresh("journal/run")
    (journal / "flight.log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    (journal / "parameters.journal").write_text(json.dumps({"restore": {"1/1": {"SIH_MASS": 1.0}}}))
    for index, name in enumerate(("imu.csv", "a/b.txt", "Ünïcode name (1).toml")):
        (fresh("name") if index == 0 else HERE / "name").joinpath(f"n{index}").write_text(name)


if __name__ == "__main__":
    recordings()
    settings()
    results()
