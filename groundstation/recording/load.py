"""Any recorded flight, by whatever program, as :class:`FlightData`: repaired, with a note on each repair."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from groundstation.errors import BadInput
from groundstation.flightdata import FlightData, Stream, motor_columns
from groundstation.outside import require_file
from groundstation.recording.autopilot import one_line
from groundstation.recording.bundle import read_bundle
from groundstation.recording.computed_speeds import without_computed_speeds
from groundstation.recording.container import MAGIC as MCAP_MAGIC
from groundstation.recording.crazyflie import is_usd_log, read_usd
from groundstation.recording.kinds import READABLE, described
from groundstation.recording.mcapfile import ForeignMcap, read_mcap
from groundstation.recording.merge import merge_onboard, onboard_log_of
from groundstation.recording.one_clock import on_one_clock
from groundstation.recording.online_clock import online_clock
from groundstation.recording.part import WHOLE, Part
from groundstation.recording.recorded import VEHICLE_FILE, Recording, vehicle_file
from groundstation.recording.repair import repair
from groundstation.recording.tables import MissingField
from groundstation.recording.thinning import Stretch, used_stretch
from groundstation.vehicle import Vehicle

_SQLITE_MAGIC = b"SQLite format 3\0"
_ULOG_MAGIC = b"ULog\x01\x12\x35"
_BLACKBOX_MAGIC = b"H Product:Blackbox"
_DATAFLASH_MAGIC = b"\xa3\x95\x80"


LARGE_BYTES = 1 << 24
"""A log from here on is read in two passes, so that a part of it costs that part.

A smaller one fits in memory anyway.
"""
_SURVEY_STEP_S = 0.02  # 50 samples in each of the seconds that thinning compares
_MARGIN_S = 1.0  # read on both sides of a stretch, for what is interpolated at its ends

FAULTS = (LookupError, ValueError, TypeError, ArithmeticError, MemoryError, struct.error)
"""What readers raise of fields that are missing, empty, torn or absurd."""


def flight_file(path: str | Path) -> Path:
    """The recording in the folder of a flight; any other path as it is."""
    path = Path(path)
    inside = path / "flight.mcap"
    return inside if inside.is_file() else path


def read_recording(path: str | Path, vehicle: Vehicle | None = None, part: Part = WHOLE) -> Recording:
    """Read a recording of any format as it is: every sample, nothing repaired.

    Args:
        path: file or folder.
        vehicle: overrides the one it carries; a log that carries none needs it.
        part: what is wanted of a log, on its own clock. A format that is read whole anyway gives all.

    Raises:
        BadInput: it is missing, of no known format, or malformed.
    """
    path = flight_file(path)
    if path.is_dir() and (bag := _bag_in(path)) is not None:
        recording = _bag(bag, vehicle, part)
    elif path.is_dir():
        recording = read_bundle(path, vehicle, part)
    else:
        require_file(path, READABLE)
        try:
            with path.open("rb") as file:
                head = file.read(512)
        except OSError as error:
            raise BadInput(f"{path}: cannot be read ({error.strerror}); give the path of {READABLE}.") from None
        if head.startswith(MCAP_MAGIC):
            try:
                recording = read_mcap(path, part)
            except ForeignMcap:
                recording = _bag(path, vehicle, part)
        elif head.startswith(_SQLITE_MAGIC):
            recording = _bag(path, vehicle, part)
        else:
            recording = _foreign(path, head, vehicle, part)
    if vehicle is not None:
        recording = replace(recording, files={**recording.files, VEHICLE_FILE: vehicle_file(vehicle)})
    return _with_its_own_input(without_computed_speeds(recording), str(path))


def _with_its_own_input(recording: Recording, source: str) -> Recording:
    """With ``input = "command"`` where the vehicle file says rotor speeds, nobody measured them, and top speed is
    declared.
    """
    motors, vehicle = recording.streams.get("motors"), recording.vehicle(source)
    if motors is None or vehicle is None or vehicle.rotors.input != "rotor_speed":
        return recording
    if vehicle.rotors.speed_max_rad_s is None or motors.columns != motor_columns("command", vehicle.rotors.count):
        return recording
    rotors = vehicle.rotors.model_copy(update={"input": "command", "speed_source": "command"})
    taken = vehicle_file(vehicle.model_copy(update={"rotors": rotors}))
    note = (
        "motors: rotor speeds are not recorded, commands are; a command is taken as a fraction of speed_max_rad_s at "
        "the "
        'full battery\'s voltage (declare input = "command", and a thrust_curve if thrust goes otherwise).'
    )
    return replace(recording, files={**recording.files, VEHICLE_FILE: taken}, notes=(*recording.notes, note))


def _bag_in(folder: Path) -> Path | None:
    """A folder that is a ROS 2 bag, or the one file of a bag whose metadata are missing.

    Raises:
        BadInput: they are missing, and it has several files.
    """
    if (folder / "metadata.yaml").is_file():
        return folder
    files = sorted(file for kind in ("*.mcap", "*.db3") for file in folder.glob(kind))
    if len(files) > 1 and not (folder / "motors.csv").is_file():
        raise BadInput(
            f"{folder}: holds {len(files)} files of a ROS 2 bag, and no metadata.yaml that joins them; write it with "
            "`ros2 bag reindex`, or name one of the files."
        )
    return files[0] if len(files) == 1 and not (folder / "motors.csv").is_file() else None


def _bag(path: Path, vehicle: Vehicle | None, part: Part) -> Recording:
    """A ROS 2 bag."""
    from groundstation.recording.rosbag import read_bag

    if vehicle is None:
        raise BadInput(f"{path}: carries no vehicle; give its file with --vehicle FILE.")
    return read_bag(path, vehicle, part)


def _foreign(path: Path, head: bytes, vehicle: Vehicle | None, part: Part) -> Recording:
    """A log of an autopilot."""
    if is_usd_log(head):
        read = read_usd
    elif head.startswith(_ULOG_MAGIC):
        from groundstation.recording.ulog import read_ulog as read
    elif head.startswith(_DATAFLASH_MAGIC):
        from groundstation.recording.dataflash import read_dataflash as read
    elif head.startswith(_BLACKBOX_MAGIC):
        from groundstation.recording.blackbox import read_blackbox as read
    else:
        raise BadInput(f"{path}: {described(head, path.stat().st_size)}.")
    if vehicle is None:
        raise BadInput(f"{path}: carries no vehicle; give its file with --vehicle FILE.")
    try:
        return read(path, vehicle, part)
    except MissingField as error:
        raise BadInput(f"{path}: {error}; it is of a version that is not known here, or was not logged.") from None
    except FAULTS as error:
        raise BadInput(f"{path}: is damaged ({one_line(error)}); copy the log from the vehicle again.") from None


def load_flight(
    path: str | Path,
    *,
    vehicle: Vehicle | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    everything: bool = False,
) -> FlightData:
    """Read a flight of any format, check it, and repair its blemishes; ``notes`` tells what was repaired or lost.

    A log of the vehicle that was fetched beside a recording (``onboard.ulg`` or ``onboard.bin``) is joined with it.

    Args:
        path: file or folder.
        vehicle: overrides the one the recording carries; a log that carries none needs it.
        start_s: start of the part to use, on the motors' clock.
        end_s: its end.
        everything: use all of a long flight, too, of which else the most informative stretch is used, with a note.

    Raises:
        BadInput: it is missing, of no known format, malformed, or a stream is beyond repair.
    """
    path = flight_file(path)
    given = None if start_s is None and end_s is None else (start_s, end_s)
    stretch = None if everything else _stretch_of_large_log(path, vehicle, given)
    flight = _read_flight(path, vehicle, stretch)
    if given is not None:
        flight = on_one_clock(_cut(flight, start_s, end_s))
    elif flight.window_s is None:
        flight = on_one_clock(flight)
        flight = flight if everything else _thinned(flight, stretch)
    return repair(flight)


def _read_flight(path: Path, vehicle: Vehicle | None, stretch: Stretch | None) -> FlightData:
    """The flight as it was recorded, of a large log around a stretch alone where that can be read."""
    if stretch is not None:
        try:
            return _flight_in(path, vehicle, Part(stretch.start_s - _MARGIN_S, stretch.end_s + _MARGIN_S))
        except BadInput:
            pass  # what is wrong is said of the whole log
    return _flight_in(path, vehicle, WHOLE)


def _flight_in(path: Path, vehicle: Vehicle | None, part: Part) -> FlightData:
    recording = read_recording(path, vehicle, part)
    declared = recording.vehicle(str(path))
    if declared is None:
        raise BadInput(f"{path}: carries no vehicle; give its file with --vehicle FILE.")
    recording = _with_onboard_log(path, recording, declared)
    return checked_flight(recording, declared, str(path))


def _stretch_of_large_log(
    path: Path, vehicle: Vehicle | None, given: tuple[float | None, float | None] | None
) -> Stretch | None:
    """What will be used of a log too large to be read whole for the sake of a part: what was asked for, or tells most.

    None of a log that is read whole. To find what tells most, the log is read once with a sample of each kind every 20
    ms.
    """
    if _size_of(path) < LARGE_BYTES:
        return None
    if given is not None:
        start_s, end_s = given
        return Stretch(-np.inf if start_s is None else start_s, np.inf if end_s is None else end_s)
    try:
        survey = _flight_in(path, vehicle, Part(step_s=_SURVEY_STEP_S))
    except BadInput:
        return None
    if survey.window_s is not None:
        return None
    survey = on_one_clock(survey)
    return used_stretch(survey.imu, survey.motors)


def checked_flight(recording: Recording, declared: Vehicle, path: str) -> FlightData:
    """A recording as a flight of a vehicle.

    Raises:
        BadInput: it holds no motor samples, or others than the vehicle has.
    """
    if "motors" not in recording.streams:
        raise BadInput(f"{path}: holds no motor samples; without them nothing can be identified.")
    wanted = motor_columns(declared.rotors.input, declared.rotors.count)
    if recording.streams["motors"].columns != wanted:
        has = recording.streams["motors"].columns
        raise BadInput(
            f"{path}: the motors are recorded as {has[0]} to {has[-1]}, but the vehicle file asks for {wanted[0]} to "
            f"{wanted[-1]}; give the file of this vehicle, with its own [rotors] input."
        )
    plan, window = recording.plan(path), recording.window_s
    if plan is not None and window is not None:
        plan = plan.as_flown(window[1] - window[0])
    return FlightData(
        name=recording.name,
        vehicle=declared,
        extras=recording.extras,
        plan=plan,
        window_s=window,
        truth=recording.truth(path),
        metadata=recording.metadata,
        notes=recording.notes,
        online=online_clock(recording.texts.get("events")),
        **recording.streams,
    )


def _size_of(path: Path) -> int:
    """Bytes of a file, or of the files of a folder."""
    files = path.iterdir() if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())


def _thinned(flight: FlightData, stretch: Stretch | None) -> FlightData:
    """A log cut to the flight, and the part of it, that tells most of the vehicle, with a note; any other as it is.

    Args:
        flight: whole, or what was read around the stretch.
        stretch: where that is known already.
    """
    stretch = stretch or used_stretch(flight.imu, flight.motors)
    if stretch is None:
        return flight
    cut = _cut(flight, stretch.start_s, stretch.end_s)
    return replace(cut, window_s=None, notes=(*cut.notes, *stretch.notes))


def _with_onboard_log(path: Path, recording: Recording, vehicle: Vehicle) -> Recording:
    """With the streams of the log that was fetched beside a recording, ``onboard.ulg`` or ``onboard.bin``, if there is
    one.
    """
    log = onboard_log_of(path) if path.suffix == ".mcap" else None
    if log is None:
        return recording
    try:
        return merge_onboard(recording, read_recording(log, vehicle), log.name)
    except BadInput as error:
        return replace(recording, notes=(*recording.notes, f"{error} The flight goes by what came over the link."))


def _cut(flight: FlightData, start_s: float | None, end_s: float | None) -> FlightData:
    """The part between two times on the motors' clock, on every stream's own clock as far as arrival times relate
    them.
    """
    motors = flight.motors
    start = float(motors.t_s[0]) if start_s is None else start_s
    end = float(motors.t_s[-1]) if end_s is None else end_s
    if not start < end or not np.any((motors.t_s >= start) & (motors.t_s <= end)):
        raise BadInput(
            f"{flight.name}: no motor samples between {start:g} and {end:g} s; "
            f"the flight lasts from {motors.t_s[0]:.1f} to {motors.t_s[-1]:.1f} s."
        )

    def cut(stream: Stream) -> Stream:
        shift = _clock_shift(stream, motors)
        return stream.select((stream.t_s >= start + shift) & (stream.t_s <= end + shift))

    streams = {name: cut(stream) for name, stream in flight.streams().items()}
    streams = {name: stream for name, stream in streams.items() if len(stream)}
    kept = dict.fromkeys(("imu", "mocap", "battery", "setpoint", "state"))
    extras = {name: cut(stream) for name, stream in flight.extras.items()}
    return replace(flight, **{**kept, **streams}, extras=extras, window_s=(start, end))


def _clock_shift(stream: Stream, motors: Stream) -> float:
    """This stream's clock minus the motors', to the accuracy of the arrival times; 0 where these are not known."""
    if stream.received_s is None or motors.received_s is None:
        return 0.0
    return float(np.nanmedian(stream.t_s - stream.received_s) - np.nanmedian(motors.t_s - motors.received_s))
