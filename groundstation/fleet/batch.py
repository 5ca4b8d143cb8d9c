"""Work through many recordings: identify, diagnose, report. Can be stopped and run again at any time: what is done
stays done.

A recording's results stand in its own folder (beside an MCAP file, else ``<logs>/<name>``), and ``batch.json`` is
written last. Its key is made of the recording's and the vehicle's content and of the program's version: a result counts
only while all of them are what they were, and a run that was cut off leaves nothing that counts.
"""

from __future__ import annotations

import glob
import hashlib
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from groundstation import __version__
from groundstation.errors import BadInput, GroundStationError, Refused
from groundstation.fleet.rows import BATCH_FILE, Row, row_of
from groundstation.writing import write_whole

STEPS = ("identify", "diagnose", "report")
RECORDINGS = (".mcap", ".ulg", ".bin", ".log", ".bbl", ".bfl", ".bag", ".db3")
"""Endings of recordings; a flight bundle is a folder with a ``vehicle.toml``, and a Crazyflie's log has no ending."""


@dataclass(frozen=True, slots=True)
class Task:
    """One recording.

    Attributes:
        source: path or URL of the recording.
        results: folder, or URL of one, for what comes out.
        vehicle: contents of a vehicle file that overrides the recorded one; None for the recorded one.
        do: steps of :data:`STEPS`.
        key: of the contents that the results depend on; empty for a URL (its worker reads it).
    """

    source: str
    results: str
    vehicle: str | None
    do: tuple[str, ...]
    key: str


@dataclass(frozen=True, slots=True)
class Result:
    """What a task came to: ``state`` is "done", "refused", "bad" (input) or "failed", ``sentence`` says why not.

    ``fresh`` is False where the results stood there already; ``row`` is the catalogue's.
    """

    source: str
    state: str
    sentence: str
    row: Row
    fresh: bool = True


def is_url(text: str) -> bool:
    """``s3://...`` and the like; a path is none."""
    return "://" in text


def find(patterns: Sequence[str]) -> list[str]:
    """Recordings that the patterns name, each once, in order. A flight's folder and what lies in it count once.

    Raises:
        BadInput: a pattern names nothing.
    """
    out: dict[str, None] = {}
    for pattern in patterns:
        if is_url(pattern):
            found = _find_urls(pattern)
        else:
            matches = [Path(p) for p in sorted(glob.glob(pattern, recursive=True))]  # noqa: PTH207
            found = [
                str(p) for p in matches if (p.suffix in RECORDINGS and p.is_file()) or (p / "vehicle.toml").is_file()
            ]
            if len(matches) == 1 and not found:
                found = [str(matches[0])]  # named one by one: a log without an ending, which its reader judges
        if not found:
            raise BadInput(
                f"{pattern}: names no recording; quote a pattern so that it reaches the program, e.g. 'logs/**'."
            )
        out |= dict.fromkeys(found)
    return [p for p in out if not any(str(parent) in out for parent in PurePosixPath(p).parents)]


def _find_urls(pattern: str) -> list[str]:
    fs, path = _filesystem(pattern)
    scheme = pattern.split("://", 1)[0]
    return sorted(
        f"{scheme}://{p.lstrip('/') if scheme != 'file' else p}"
        for p in fs.glob(path)
        if PurePosixPath(p).suffix in RECORDINGS
    )


def _filesystem(url: str) -> tuple[Any, str]:
    try:
        from fsspec.core import url_to_fs
    except ModuleNotFoundError:
        raise BadInput("URLs need fsspec; install it: pip install 'groundstation[cluster]'.") from None
    try:
        return url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise BadInput(f"{url}: cannot be opened ({error}).") from None


def tasks(sources: Sequence[str], logs: str, vehicle: Path | None, do: Sequence[str]) -> list[Task]:
    """A task for each recording, its results' folder named so that no two share one."""
    declared = None if vehicle is None else vehicle.read_text(encoding="utf-8")
    names = [PurePosixPath(s).stem for s in sources]
    out = []
    for source, name in zip(sources, names, strict=True):
        key = "" if is_url(source) else key_of(digest(Path(source)), declared, do)
        if not is_url(source) and Path(source).suffix == ".mcap" and not is_url(logs):
            results = str(Path(source).parent)
            if sum(str(Path(s).parent) == results for s in sources) > 1:
                results = str(Path(source).with_suffix(""))
        else:
            unique = name if names.count(name) == 1 else f"{name}-{hashlib.sha256(source.encode()).hexdigest()[:8]}"
            results = f"{logs.rstrip('/')}/{unique}"
        out.append(Task(source, results, declared, tuple(do), key))
    return out


def digest(path: Path) -> str:
    """SHA-256 of a file, or of a folder's files with their names, in order."""
    if path.is_file():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    whole = hashlib.sha256()
    for each in sorted(p for p in path.rglob("*") if p.is_file() and not p.is_symlink()):
        whole.update(f"{each.relative_to(path)}\0{digest(each)}\n".encode())
    return whole.hexdigest()


def key_of(recording: str, vehicle: str | None, do: Sequence[str]) -> str:
    """Of everything that results depend on."""
    parts = json.dumps([recording, vehicle, sorted(do), __version__])
    return hashlib.sha256(parts.encode()).hexdigest()


def is_done(task: Task) -> bool:
    """Whether the results that stand there are this task's; what is at a URL is asked by its worker."""
    if not task.key or is_url(task.results):
        return False
    try:
        return json.loads((Path(task.results) / BATCH_FILE).read_text(encoding="utf-8")).get("key") == task.key
    except (OSError, ValueError, AttributeError):
        return False


def done_before(task: Task) -> Result:
    """The result of a task that is done."""
    folder = Path(task.results)
    document = json.loads((folder / BATCH_FILE).read_text(encoding="utf-8"))
    state, sentence = str(document.get("state", "done")), str(document.get("sentence", ""))
    return Result(task.source, state, sentence, row_of(folder, 0), fresh=False)


def work(task: Task) -> Result:
    """Do a task: what a worker runs. Bad input and refusals are results; a defect is raised."""
    if not is_url(task.source) and not is_url(task.results):
        return _work_here(Path(task.source), Path(task.results), task)
    with tempfile.TemporaryDirectory() as folder:
        return _work_at_url(Path(folder), task)


def _work_at_url(scratch: Path, task: Task) -> Result:
    """Fetch the recording, work here, put the results there; ``batch.json`` last."""
    there, results = _filesystem(task.results)
    marker = f"{results.rstrip('/')}/{BATCH_FILE}"
    source = Path(task.source)
    if is_url(task.source):
        fs, path = _filesystem(task.source)
        source = scratch / PurePosixPath(path).name
        try:
            fs.get(path, str(source), recursive=fs.isdir(path))
        except OSError as error:
            raise BadInput(f"{task.source}: cannot be read ({error}).") from None
    key = key_of(digest(source), task.vehicle, task.do)
    local = scratch / "results"
    if there.exists(marker) and json.loads(there.cat_file(marker)).get("key") == key:
        there.get(results, str(local), recursive=True)
        return done_before(Task(task.source, str(local), task.vehicle, task.do, key))
    result = _work_here(source, local, Task(task.source, task.results, task.vehicle, task.do, key))
    there.makedirs(results, exist_ok=True)
    files = sorted((p for p in local.iterdir() if p.is_file()), key=lambda p: p.name == BATCH_FILE)
    for file in files:
        there.put_file(str(file), f"{results.rstrip('/')}/{file.name}")
    return result


def _work_here(source: Path, folder: Path, task: Task) -> Result:
    import tomllib

    from groundstation.recording import load_flight
    from groundstation.vehicle import vehicle_from_dict

    folder.mkdir(parents=True, exist_ok=True)
    state, sentence, name = "done", "", None
    try:
        declared = None if task.vehicle is None else vehicle_from_dict(tomllib.loads(task.vehicle), "--vehicle")
        flight = load_flight(source, vehicle=declared)
        name = flight.vehicle.name
        _analyse(flight, folder, task.do)
    except Refused as error:
        from groundstation.analysis.documents import refusal, write_json

        state, sentence = "refused", str(error)
        write_json(folder / "refused.json", refusal(error))
    except GroundStationError as error:
        state, sentence = "bad", str(error)
    document = {
        "schema": "groundstation.batch/1",
        "key": task.key,
        "version": __version__,
        "source": task.source,
        "vehicle": name,
        "did": list(task.do),
        "state": state,
        "sentence": sentence,
        "inputs": {PurePosixPath(task.source).name: digest(source)},
    }
    write_whole(folder / BATCH_FILE, json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return Result(task.source, state, sentence, row_of(folder, 0))


def _analyse(flight: Any, folder: Path, do: Sequence[str]) -> None:
    from groundstation.analysis.analyse import analyse, write_identification
    from groundstation.analysis.documents import write_json
    from groundstation.diagnosis import diagnose
    from groundstation.diagnosis.doubted import identify
    from groundstation.identification.work import Work

    if "report" in do:
        analyse([flight], folder)
        return
    work = Work()
    found = identify([flight], work=work)
    diagnosis = diagnose([flight], work=work) if "diagnose" in do else None
    write_identification(folder, found, flight.vehicle, diagnosis)
    if diagnosis is not None:
        write_json(folder / "diagnosis.json", diagnosis.to_dict())


def results(
    wanted: Sequence[Task], *, workers: int = 1, scheduler: str | None = None, memory_bytes: int | None = None
) -> Iterator[Result]:
    """Results as they come in: those that stand first, then the others. A defect becomes a result of state "failed"."""
    from groundstation.fleet.runner import run

    left = []
    for task in wanted:
        if is_done(task):
            yield done_before(task)
        else:
            left.append(task)
    for outcome in run(work, left, workers=workers, scheduler=scheduler, memory_bytes=memory_bytes):
        if outcome.value is not None:
            yield outcome.value
        else:
            yield Result(outcome.item.source, "failed", outcome.failure, {})


def table(found: Sequence[Result]) -> list[Row]:
    """One row a recording and parameter, ordered by source, without what differs from run to run: equal, whoever
    computed it.
    """
    rows = []
    for result in sorted(found, key=lambda r: r.source):
        head = {"source": result.source, "state": result.state, "sentence": result.sentence}
        rows += [{**head, **p} for p in result.row.get("parameters") or [{}]]
    return rows


def document(found: Sequence[Result]) -> Row:
    """The JSON document of a batch."""
    by_source = sorted(found, key=lambda r: r.source)
    return {
        "schema": "groundstation.batch/1",
        "recordings": [{k: v for k, v in asdict(r).items() if k != "row"} for r in by_source],
    }


def write_table(path: Path, found: Sequence[Result]) -> Path:
    """:func:`table` as Parquet or CSV, by the name's ending, whole or not at all.

    Raises:
        BadInput: another ending, or the file cannot be written.
    """
    from groundstation.fleet.catalogue import write_rows

    kinds: dict[str, str] = dict.fromkeys(("source", "state", "sentence", "method", "name"), "VARCHAR")
    return write_rows(path, table(found), kinds | dict.fromkeys(("value", "std", "low", "high"), "DOUBLE"))
