"""Golden recordings: files that every later version must read to the same figures.

    python -m tests.golden.regenerate          # rewrites expected.json from the recordings that lie here
    python -m tests.golden.regenerate 2        # adds recording-2.mcap and bundle-2 after a change of schema

A recording once committed is never rewritten: it stands for those that users keep.
"""

from __future__ import annotations

import hashlib
import json
import sys
from pathlib import Path

import numpy as np

from groundstation.recording import convert, read_recording
from groundstation.recording.mcapfile import write_recording_as_mcap
from groundstation.recording.recorded import Recording, Texts, recording_of
from tests.recording_flight import flight

HERE = Path(__file__).parent


def figures(path: Path) -> dict:
    """What a recording holds: counts, names, and digests of all doubles."""
    recording = read_recording(path)

    def digest(*arrays):
        return hashlib.sha256(b"".join(np.ascontiguousarray(a, dtype="<f8").tobytes() for a in arrays)).hexdigest()[:16]

    def stream(s):
        return {
            "samples": len(s),
            "columns": list(s.columns),
            "times": digest(s.t_s),
            "received": None if s.received_s is None else digest(s.received_s),
            "values": digest(s.values),
        }

    return {
        "name": recording.name,
        "streams": {name: stream(s) for name, s in recording.streams.items()},
        "extras": {name: stream(s) for name, s in recording.extras.items()},
        "texts": {name: [t.columns, t.rows] for name, t in recording.texts.items()},
        "files": {name: hashlib.sha256(data).hexdigest()[:16] for name, data in recording.files.items()},
        "metadata": dict(recording.metadata),
        "window_s": recording.window_s,
        "notes": recording.notes,
    }


def sample_recording() -> Recording:
    """A second of flight with every kind of thing a recording can hold."""
    base = recording_of(flight(0.4, seed=11))
    t = np.array([0.1 + 0.2, 1.0 / 3.0])
    texts = {
        "events": Texts(t, (("phase", "exciting"), ("guard", 'tilt "41°", over 35°')), ("kind", "text"), t + 50.0),
        "raw": Texts(t, (("in", "fd0900"), ("out", "fd")), ("direction", "data_hex"), t + 50.0),
        "status": Texts(t, (("airborne", "1", ""), ("landed", "0", "done")), ("phase", "armed", "text"), t + 50.0),
    }
    extra = base.streams["battery"]
    extras = {"battery": type(extra)(extra.t_s, extra.values[:, :1] / 3.0, ("cell_v",), extra.received_s)}
    files = {**base.files, "notes.md": b"calm, indoors\n"}
    return Recording(base.name, base.streams, extras, texts, files, base.metadata, base.window_s, ("made up.",))


def main(version: str | None) -> None:
    if version is not None:
        path = HERE / f"recording-{version}.mcap"
        write_recording_as_mcap(sample_recording(), path)
        convert(path, HERE / f"bundle-{version}")
    found = sorted(p for p in HERE.iterdir() if p.name.startswith(("recording-", "bundle-")))
    document = {path.name: figures(path) for path in found}
    (HERE / "expected.json").write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
