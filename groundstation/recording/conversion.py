"""``convert``: between recordings and flight bundles, every sample and time stamp as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from groundstation.errors import BadInput
from groundstation.paths import find_config
from groundstation.recording.bundle import unholdable, write_recording_as_bundle
from groundstation.recording.load import read_recording
from groundstation.recording.mapping import load_map, read_mapped
from groundstation.recording.mcapfile import write_recording_as_mcap
from groundstation.recording.recorded import VEHICLE_FILE, Recording, vehicle_file
from groundstation.vehicle import Vehicle, load_vehicle


def convert(
    source: str | Path, target: str | Path, *, vehicle: str | Path | None = None, mapped: str | Path | None = None
) -> tuple[str, ...]:
    """Convert a recording of any format to MCAP (a target that ends in ``.mcap``) or a flight bundle (a folder).

    Args:
        source: file or folder.
        target: must not exist, or be an empty folder.
        vehicle: vehicle file or shipped name, for a source that carries none.
        mapped: map file that says which columns of the source are which stream.

    Returns:
        What the target does not hold of the source, or the source had lost already, one sentence each.

    Raises:
        BadInput: the source is malformed, the target exists, or the vehicle is missing.
    """
    target = Path(target)
    declared = None if vehicle is None else load_vehicle(find_config("vehicles", vehicle))
    recording = read_recording(source, declared) if mapped is None else _mapped(Path(source), mapped, declared)
    if target.suffix == ".mcap":
        write_recording_as_mcap(recording, target)
        return recording.left_out
    if target.suffix in (".ulg", ".bin", ".csv", ".bag", ".db3"):
        raise BadInput(f"{target}: is neither an MCAP file (.mcap) nor a folder for a flight bundle; name one of them.")
    if VEHICLE_FILE not in recording.files:
        raise BadInput(f"{source}: carries no vehicle, and a flight bundle needs one; give it with --vehicle FILE.")
    write_recording_as_bundle(recording, target)
    return (*recording.left_out, *unholdable(recording))


def _mapped(source: Path, mapped: str | Path, vehicle: Vehicle | None) -> Recording:
    if vehicle is None:
        raise BadInput(f"{source}: a map needs the vehicle too, for its rotors; give it with --vehicle FILE.")
    recording = read_mapped(source, load_map(mapped), vehicle)
    return replace(recording, files={VEHICLE_FILE: vehicle_file(vehicle)})
