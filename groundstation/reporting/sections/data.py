"""What the numbers rest on: streams, clocks, repairs, excluded segments, warnings, and how to get the same again."""

from __future__ import annotations

import hashlib
import json
import platform
import shlex
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path

import numpy as np

import groundstation
from groundstation.flightdata import FlightData, Stream
from groundstation.identification.results import Clock, Identification
from groundstation.paths import commit
from groundstation.recording.manifest import provenance
from groundstation.reporting import figures
from groundstation.reporting.markup import Markup, definition_list, element, fragment, sentence_list, table
from groundstation.reporting.page import Page
from groundstation.reporting.units import fixed, percent, readable, significant
from groundstation.trajectory import Plan, plan_to_dict
from groundstation.vehicle import vehicle_to_dict

LINE = 80


def add_data(page: Page, flight: FlightData, identification: Identification | None, live: Sequence[str]) -> None:
    """Streams with rates and gaps, clock offset, repairs."""
    streams = flight.streams()
    rows = [(name, *_stream_row(stream)) for name, stream in streams.items()]
    header = (
        "stream",
        "samples",
        "rate (Hz)",
        "from (s)",
        "to (s)",
        "gaps",
        "longest gap (s)",
        "missing",
        "arrival delay spread (ms)",
    )
    caption = (
        "Each stream on its own device clock. A gap is a step over five median intervals; missing is what it left out."
    )
    coverage = figures.coverage_figure(
        {name: figures.stretches(stream.t_s) for name, stream in streams.items()},
        identification.excluded_s if identification else (),
    )
    sentences = list(dict.fromkeys([*live, *(identification.quality if identification else ()), *flight.notes]))
    page.section(
        "data",
        "Data",
        table(caption, header, rows),
        page.figure(coverage, "When each stream was there; shaded: excluded from the analysis."),
        _clock(identification.clock if identification else None),
        _excluded(identification),
        element("h3", "Quality and repairs"),
        sentence_list(readable(text) for text in dict.fromkeys(sentences))
        if sentences
        else element("p", "Nothing had to be repaired.", class_="note"),
        folded=True,
    )


def _stream_row(stream: Stream) -> list[str]:
    t = stream.t_s
    if len(t) < 2:
        return [str(len(t)), *["–"] * 7]
    step = np.diff(t)
    median = float(np.median(step))
    gaps = step[step > 5.0 * median]
    missing = float(np.sum(gaps / median - 1.0))
    return [
        str(len(t)),
        significant(1.0 / median),
        fixed(float(t[0]), 2),
        fixed(float(t[-1]), 2),
        str(len(gaps)),
        significant(float(gaps.max())) if len(gaps) else "–",
        percent(missing / (missing + len(t))).lstrip("+"),
        _delay_spread(stream),
    ]


def _delay_spread(stream: Stream) -> str:
    """Middle 98 % of arrival minus device time, after a straight line (the clocks' offset and drift) is taken out."""
    if stream.received_s is None or len(stream) < 16:
        return "–"
    delay = stream.received_s - stream.t_s
    line = np.polyfit(stream.t_s - stream.t_s[0], delay, 1)
    rest = delay - np.polyval(line, stream.t_s - stream.t_s[0])
    return significant(1e3 * float(np.subtract(*np.percentile(rest, [99, 1]))))


def _clock(clock: Clock | None) -> Markup:
    if clock is None:
        return element("p", "Motion-capture and IMU clocks were not compared.", class_="note")
    offset = f"{fixed(1e3 * clock.mocap_minus_imu_s, 3)} ± {fixed(1e3 * 1.959964 * clock.std_s, 3)} ms"
    drift = f"{fixed(1e6 * clock.drift, 1)} ± {fixed(1e6 * 1.959964 * clock.drift_std, 1)} ppm"
    rows = [("motion capture − IMU, at the middle of the flight (95 %)", offset), ("drift (95 %)", drift)]
    if clock.online_s is not None and clock.online_error_s is not None:
        told = f"{fixed(1e3 * clock.online_s, 3)} ± {fixed(1e3 * clock.online_error_s, 3)} ms"
        rows.append(("the same as the link knew it in flight", f"{told}: {'agrees' if clock.agrees else 'differs'}"))
    return fragment(element("h3", "Clocks"), definition_list(rows))


def _excluded(identification: Identification | None) -> Markup | None:
    if identification is None:
        return None
    pairs = []
    if identification.window_s[1] > identification.window_s[0]:
        start, end = identification.window_s
        pairs.append(("analysed", f"{fixed(start, 2)} … {fixed(end, 2)} s"))
    excluded = ", ".join(f"{fixed(a, 2)} … {fixed(b, 2)} s" for a, b in identification.excluded_s) or "nothing"
    return definition_list([*pairs, ("excluded", excluded)])


def add_warnings(page: Page, warnings: Sequence[str]) -> None:
    """Every warning, once."""
    unique = [readable(text) for text in dict.fromkeys(warnings)]
    content = sentence_list(unique) if unique else element("p", "None.", class_="note")
    page.section("warnings", f"Warnings ({len(unique)})" if unique else "Warnings", content)


def _metadata(known: Mapping[str, str]) -> Markup:
    """What the recording says of itself; what is longer than a line is folded."""
    short = [(name, text) for name, text in sorted(known.items()) if len(text) <= LINE]
    folded = [
        element("details", element("summary", name), element("pre", text))
        for name, text in sorted(known.items())
        if len(text) > LINE
    ]
    return fragment(definition_list(short), folded)


def add_reproduction(
    page: Page, flight: FlightData, identification: Identification | None, source: str, recording: Path | None = None
) -> None:
    """Versions, hashes of what went in, what is known about the recording, and the commands that give the same numbers
    again.
    """
    versions = [("groundstation", groundstation.__version__), ("Python", platform.python_version())]
    versions += [(name, metadata.version(name)) for name in ("numpy", "scipy")]
    versions += [("commit", made_of)] if (made_of := commit()) else []
    commands = "\n".join(reproduction_commands(flight, identification, source))
    said = provenance(recording) if recording is not None else ""
    page.section(
        "reproduce",
        "Reproduce",
        element("p", said) if said else None,
        element("pre", commands),
        element("h3", "Analysed with"),
        definition_list([*versions, *hashes(flight, recording)]),
        [element("h3", "Recorded with"), _metadata(flight.metadata)] if flight.metadata else None,
        element("details", element("summary", "The plan"), element("pre", _plan_text(flight.plan)))
        if flight.plan
        else None,
        folded=True,
    )


def reproduction_commands(flight: FlightData, identification: Identification | None, source: str) -> list[str]:
    """What flies it again, where it was simulated, and what analyses it again."""
    options = "".join(f" --exclude {a:g}:{b:g}" for a, b in identification.excluded_s) if identification else ""
    known = flight.metadata
    flown = []
    if flight.truth is not None and known.get("scenario") and known.get("seed"):
        words = ("--vehicle", flight.vehicle.name, "--scenario", known["scenario"], "--seed", known["seed"])
        flown = [f"groundstation rehearse {shlex.join(words)} --plan plan.toml"]
    return [*flown, *(f"groundstation {command} {source}{options}" for command in ("identify", "diagnose", "report"))]


def _plan_text(plan: Plan) -> str:
    import tomli_w

    return tomli_w.dumps(plan_to_dict(plan))


def hashes(flight: FlightData, recording: Path | None) -> list[tuple[str, str]]:
    """SHA-256 of the recording, of the plan and of the vehicle as declared; the latter two of their JSON with sorted
    keys.
    """
    found = []
    if recording is not None and recording.is_file():
        with recording.open("rb") as file:
            found.append((f"SHA-256 of {recording.name}", hashlib.file_digest(file, "sha256").hexdigest()))
    documents = {"vehicle": vehicle_to_dict(flight.vehicle)} | (
        {"plan": plan_to_dict(flight.plan)} if flight.plan else {}
    )
    for name, document in documents.items():
        text = json.dumps(document, sort_keys=True)
        found.append((f"SHA-256 of the {name}", hashlib.sha256(text.encode()).hexdigest()))
    return found
