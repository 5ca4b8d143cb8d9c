"""One row of the catalogue: what the files in a flight's folder say of it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from groundstation.errors import BadInput
from groundstation.outside import read_json
from groundstation.writing import write_whole

Row = dict[str, Any]

SIGNS = ("flight.mcap", "identification.json", "refused.json")
"""A folder that holds one of these is a flight's."""
NOTES_FILE = "notes.json"
"""What a person adds to a flight: ``{"tags": [...], "note": "..."}``."""
BATCH_FILE = "batch.json"
"""What a batch wrote of the run that made the results (``groundstation.fleet.batch``)."""
CANONICAL = "canonical"
"""The method of the one estimate that stands for the flight."""

_STAMP = re.compile(r"^(\d{4}-\d\d-\d\d)T(\d\d)-(\d\d)-(\d\d)")


def row_of(folder: Path, fingerprint: int) -> Row:
    """Read a flight's folder; a document that is damaged or half written counts as absent."""
    names = ("identification.json", "refused.json", "diagnosis.json", NOTES_FILE, BATCH_FILE)
    identification, refusal, diagnosis, notes, batch = (_document(folder / name) for name in names)
    return {
        "flight": _text(identification.get("flight")) or folder.name,
        "folder": str(folder),
        "date": flown_at(folder),
        "vehicle": _text(identification.get("vehicle")) or _text(batch.get("vehicle")),
        "state": "identified" if identification else "refused" if refusal else "recorded",
        "verdict": _text(diagnosis.get("verdict")),
        "reason": _text(refusal.get("reason")) or _text(diagnosis.get("reason")) or "",
        "best": _text(identification.get("best")),
        "source": _text(batch.get("source")) or _text(identification.get("source")),
        "version": _text(batch.get("version")) or _text(identification.get("version")),
        "tags": [str(tag) for tag in _list(notes, "tags") if isinstance(tag, str)],
        "note": _text(notes.get("note")) or "",
        "fingerprint": fingerprint,
        "parameters": list(_parameters(identification, diagnosis)),
        "findings": [_finding(f) for f in _list(diagnosis, "findings")],
        "quality": [str(text) for key in ("quality", "warnings") for text in _list(identification, key)],
        "inputs": [{"name": str(k), "sha256": str(v)} for k, v in _mapping(batch, "inputs").items()],
    }


def flown_at(folder: Path) -> str:
    """When a flight was flown, ISO 8601 in UTC: its folder's name where that begins with a stamp, else its recording's
    file time.
    """
    if found := _STAMP.match(folder.name):
        return f"{found[1]}T{found[2]}:{found[3]}:{found[4]}+00:00"
    oldest = next((path for name in SIGNS if (path := folder / name).exists()), folder)
    return datetime.fromtimestamp(oldest.stat().st_mtime, UTC).isoformat(timespec="seconds")


def set_notes(
    folder: Path, *, add: tuple[str, ...] = (), remove: tuple[str, ...] = (), note: str | None = None
) -> Path:
    """Tag a flight, or note a sentence beside it.

    Raises:
        BadInput: the folder holds no flight, or a tag is empty.
    """
    if not any((folder / name).exists() for name in SIGNS):
        raise BadInput(f"{folder}: holds no flight; name a flight's folder, as `groundstation flights` lists it.")
    if any(not tag.strip() for tag in (*add, *remove)):
        raise BadInput("a tag is empty; write a word, e.g. --add-tag payload.")
    known = _document(folder / NOTES_FILE)
    tags = [t for t in dict.fromkeys((*(known.get("tags") or ()), *add)) if t not in remove]
    document = {**known, "tags": tags, "note": known.get("note", "") if note is None else note}
    return write_whole(folder / NOTES_FILE, json.dumps(document, indent=1, ensure_ascii=False) + "\n")


def _parameters(identification: Row, diagnosis: Row) -> Any:
    """Every estimate with its method; the canonical one (findings put in, where there is a diagnosis) once more under
    its own name.
    """
    methods = _mapping(identification, "methods")
    best = _mapping(_mapping(methods, str(identification.get("best"))), "parameters")
    model = _mapping(identification, "model")
    for method, result in methods.items():
        for name, estimate in _mapping(result, "parameters").items():
            yield from _estimate(method, name, estimate)
    for name, estimate in model.items():
        yield from _estimate(str(identification.get("best")), name, estimate)
    after = _mapping(diagnosis, "parameters_after") if diagnosis.get("findings") else {}
    canonical = _mapping(_mapping(identification, "estimate"), "parameters") or {**model, **best, **after}
    for name, estimate in canonical.items():
        yield from _estimate(CANONICAL, name, estimate)
    for finding in _list(diagnosis, "findings"):
        if not isinstance(finding, Mapping):
            continue
        rotor = f"_{finding['rotor']}" if isinstance(finding.get("rotor"), int) else ""
        for name, estimate in _mapping(finding, "parameters").items():
            yield from _estimate(CANONICAL, f"{finding.get('effect')}{rotor}.{name}", estimate)


def _estimate(method: str, name: str, estimate: Any) -> Any:
    if not isinstance(estimate, Mapping):
        return
    value, std = estimate.get("value"), estimate.get("std")
    if not (isinstance(value, (int, float)) and isinstance(std, (int, float))):
        return
    ci = estimate.get("ci95")
    low, high = ci if isinstance(ci, list) and len(ci) == 2 else (None, None)
    yield {"method": method, "name": name, "value": value, "std": std, "low": low, "high": high}


def _finding(finding: Any) -> Row:
    finding = finding if isinstance(finding, Mapping) else {}
    return {
        "effect": _text(finding.get("effect")),
        "rotor": finding.get("rotor") if isinstance(finding.get("rotor"), int) else None,
        "confidence": finding.get("confidence") if isinstance(finding.get("confidence"), (int, float)) else None,
        "evidence": _text(finding.get("evidence")),
        "alternatives": [str(each) for each in _list(dict(finding), "alternatives")],
    }


def _document(path: Path) -> Row:
    try:
        document = read_json(path, "a result")
    except BadInput:
        return {}
    return document if isinstance(document, dict) else {}


def _mapping(document: Any, key: str) -> Row:
    value = document.get(key) if isinstance(document, Mapping) else None
    return dict(value) if isinstance(value, Mapping) else {}


def _list(document: Row, key: str) -> list[Any]:
    value = document.get(key)
    return value if isinstance(value, list) else []


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None
