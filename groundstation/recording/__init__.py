"""Recordings: MCAP files, flight bundles, and logs of other programs."""

from __future__ import annotations

from groundstation.recording.bundle import write_bundle
from groundstation.recording.conversion import convert
from groundstation.recording.load import flight_file, load_flight, read_recording
from groundstation.recording.mcapfile import write_mcap
from groundstation.recording.recorder import McapRecorder

__all__ = [
    "McapRecorder",
    "convert",
    "flight_file",
    "load_flight",
    "read_recording",
    "write_bundle",
    "write_mcap",
]
