"""What reads files from outside, each as one function of a path that uses all it read; for :mod:`studies.fuzz`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import tomli_w

from groundstation.errors import BadInput
from groundstation.outside import inside
from groundstation.paths import find_config
from groundstation.trajectory import flight_path, load_plan, plan_to_dict
from groundstation.vehicle import Vehicle, load_vehicle, vehicle_from_dict, vehicle_to_dict


@dataclass(frozen=True, slots=True)
class Reader:
    """A reader: what it does with a path, how many of a thousand inputs it gets, and whether it reads a folder."""

    read: Callable[[Path], object]
    share: int
    folder: bool = False


@cache
def vehicle(name: str) -> Vehicle:
    """A shipped vehicle."""
    return load_vehicle(find_config("vehicles", name))


@cache
def quad() -> Vehicle:
    """A quadrotor in X whose motors are commanded, as the seeds of autopilots' logs fly it."""
    document = vehicle_to_dict(vehicle("qball2"))
    arms = [[0.1, -0.12, 0.0], [-0.1, 0.12, 0.0], [0.1, 0.12, 0.0], [-0.1, -0.12, 0.0]]
    document["rotors"] |= {"position_m": arms, "spin": [1, 1, -1, -1], "input": "command"}
    return vehicle_from_dict(document)


def sped() -> Vehicle:
    """The same, its rotors' speeds measured, as the seeds of bags fly it."""
    document = vehicle_to_dict(quad())
    document["rotors"]["input"] = "rotor_speed"
    return vehicle_from_dict(document)


def _flight(flown: Callable[[], Vehicle | None] = lambda: None) -> Callable[[Path], object]:
    def read(path: Path) -> object:
        from groundstation.recording import load_flight

        return load_flight(path, vehicle=flown())

    return read


def _converted(path: Path) -> object:
    """To the other format and back; nothing may appear outside the folder."""
    from groundstation.recording import convert

    with tempfile.TemporaryDirectory(dir=path.parent) as name:
        folder = Path(name)
        before = set(path.parent.iterdir())
        target = folder / ("b" if path.is_file() else "a.mcap")
        try:
            told = convert(path, target)
        except BadInput:
            if any(folder.iterdir()):
                raise AssertionError(f"a refused convert left {list(folder.iterdir())}") from None
            raise
        if set(path.parent.iterdir()) != before:
            raise AssertionError("convert wrote outside its target")
        return told


def _mapped(folder: Path) -> object:
    """A table by its map; the vehicle's motors are commanded."""
    from groundstation.recording.mapping import load_map, read_mapped, template

    log = folder / "log.csv"
    wanted = load_map(folder / "map.toml")
    return read_mapped(log, wanted, quad()), template(log, quad())


def _database(folder: Path) -> object:
    """The catalogue of a folder with the file that an earlier one left there, as all commands read it."""
    from groundstation.fleet.catalogue import Catalogue

    found = Catalogue(folder / "logs")
    rows = [found.series(name) for name in found.vehicles()]
    return found.rows(), rows, found.sql("SELECT * FROM parameters"), found.sql("SELECT * FROM findings")


def _vehicle(path: Path) -> object:
    found = load_vehicle(path)
    found.parameters(), found.allocation(), found.rotor_thrust_max_n()
    return tomli_w.dumps(vehicle_to_dict(found))


def _plan(path: Path) -> object:
    found = load_plan(path)
    flight_path(found, (0.0, 0.0, 0.0, 0.0)).duration_s, found.series().duration_s
    return tomli_w.dumps(plan_to_dict(found))


def _station(path: Path) -> object:
    from groundstation.flight.station import load_station

    return load_station(path)


def _scenario(path: Path) -> object:
    from sim.scenario import load_scenario, true_vehicle

    return true_vehicle(vehicle("qball2"), load_scenario(path))


def _model(path: Path) -> object:
    from groundstation.diagnosis.effect import library, wrench_of
    from groundstation.errors import GroundStationError
    from groundstation.model.vehicle_model import model_from_document
    from groundstation.reporting.exports import FORMATS, export, read_model

    document = read_model(path, vehicle("qball2") if path.suffix == ".json" else None)
    for form in FORMATS:
        try:
            _readable(export(document, form), form)
        except GroundStationError:
            continue
    declared = vehicle_from_dict(document["vehicle"], str(path))
    effects = document["effects"]
    wrench = wrench_of(effects, declared) if any(name in library() for name in effects) else None
    return model_from_document(document, declared, wrench)


def _readable(text: str, form: str) -> None:
    """What was exported is read back by a reader of its format."""
    import tomllib
    import xml.etree.ElementTree as ET

    if form in ("sdf", "urdf", "mjcf"):
        ET.fromstring(text)  # noqa: S314 - our own output
    elif form in ("toml", "vehicle", "scenario"):
        tomllib.loads(text)


def _diagnosis(path: Path) -> object:
    from groundstation.diagnosis.next_flight import candidate, contenders
    from groundstation.documents import read_diagnosis
    from groundstation.tui import documents

    document = read_diagnosis(path)
    documents.finding_text(document), documents.error_rows(document), documents.suspect_rows(document)
    rivals, shared = contenders(document)
    return [candidate(each, vehicle("qball2"), shared) for each in rivals]


def _results(folder: Path) -> object:
    """A folder of flights: what the catalogue takes of each, and what the screens show of it."""
    from groundstation.fleet.rows import row_of
    from groundstation.tui import documents
    from groundstation.tui.results import read_results

    rows = []
    for flight in sorted({path.parent for path in folder.rglob("*.json")}):
        rows.append(row_of(flight, 0))
        results = read_results(flight)
        if results.identification:
            documents.method_table(results.identification, results.declared, 4)
            documents.identification_notes(results.identification), documents.validation_rows(results.identification)
        if results.diagnosis:
            (
                documents.finding_text(results.diagnosis),
                documents.error_rows(results.diagnosis),
                documents.suspect_rows(results.diagnosis),
            )
    return rows


def _journal(folder: Path) -> object:
    from groundstation.flight.client.client import outcome
    from groundstation.flight.link.parameter_journal import ParameterJournal

    for path in folder.glob("*.journal"):
        ParameterJournal(path)
    return outcome(folder)


def _batch(path: Path) -> object:
    """A payload of the bus into the recorder: whatever decodes is recorded, and the recording can be read."""
    from drivers.samples import decode_batch
    from groundstation.recording import McapRecorder, read_recording

    try:
        batch = decode_batch(path.read_bytes())
    except ValueError:
        raise BadInput("no batch") from None
    target = path.with_suffix(".recorded")
    try:
        with McapRecorder(target) as recorder:
            for sample, host_s in zip(batch.samples, batch.host_s, strict=False):
                recorder.add(sample, host_s)
        if recorder.failure is not None:
            raise AssertionError(recorder.failure)
        return read_recording(target)
    finally:
        target.unlink(missing_ok=True)


def _mocap(path: Path) -> object:
    """What a motion-capture server sends: a byte that names the system, then messages with their lengths, one datagram
    each.
    """
    import struct

    from drivers.mocap.readings import Frame
    from drivers.mocap.session import SYSTEMS

    data = path.read_bytes()
    reader = list(SYSTEMS.values())[data[0] % len(SYSTEMS) if data else 0].reader()
    frames, at = [], 1
    while at + 4 <= len(data):
        (size,) = struct.unpack_from("<I", data, at)
        frames += [r for r in reader.feed(data[at + 4 : at + 4 + size], 1.0) if isinstance(r, Frame)]
        reader.due(1.0)
        at += 4 + size
    if not frames:
        raise BadInput("no frame")
    return frames


def _name(path: Path) -> object:
    """A name from outside as a path: never outside the folder."""
    folder = path.parent
    made = inside(folder, path.read_bytes().decode("utf-8", "replace"))
    if not made.resolve().is_relative_to(folder.resolve()):
        raise AssertionError(f"{made} lies outside {folder}")
    return made


READERS: Mapping[str, Reader] = {
    "mcap": Reader(_flight(), 50),
    "convert": Reader(_converted, 30),
    "bundle": Reader(_flight(), 30, folder=True),
    "usd": Reader(_flight(lambda: vehicle("crazyflie21")), 40),
    "ulog": Reader(_flight(quad), 30),
    "dataflash": Reader(_flight(quad), 30),
    "blackbox": Reader(_flight(quad), 30),
    "rosbag": Reader(_flight(sped), 10, folder=True),
    "map": Reader(_mapped, 30, folder=True),
    "batch": Reader(_batch, 120),
    "mocap": Reader(_mocap, 40),
    "vehicle": Reader(_vehicle, 70),
    "plan": Reader(_plan, 70),
    "station": Reader(_station, 70),
    "scenario": Reader(_scenario, 60),
    "model": Reader(_model, 30),
    "diagnosis": Reader(_diagnosis, 80),
    "catalogue": Reader(_results, 30, folder=True),
    "database": Reader(_database, 10, folder=True),
    "journal": Reader(_journal, 70, folder=True),
    "name": Reader(_name, 70),
}
"""By name; the shares add up to a thousand, and those of fast readers are larger."""
