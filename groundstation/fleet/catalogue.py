"""The catalogue of a logs folder: one row a flight, in a Parquet file beside the flights, asked with SQL (DuckDB).

The recordings' own folders are what is true. The catalogue is made from them, is never the only copy of anything, and
is written whole or not at all: deleted, damaged or out of date, it is made again. A folder is read again when its
modification time moved, which every result that is written moves. Several stations may write: each writes what it read,
the last one stands, and what it does not hold is read again at the next listing.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from groundstation.errors import BadInput
from groundstation.fleet.rows import CANONICAL, SIGNS, Row, row_of

if TYPE_CHECKING:
    import duckdb

FILE = ".catalogue.parquet"
SCHEMA = "groundstation.catalogue/1"
_COLUMNS = {
    **dict.fromkeys(("flight", "folder", "date", "vehicle", "state", "verdict", "reason", "best"), "VARCHAR"),
    **dict.fromkeys(("source", "version"), "VARCHAR"),
    "tags": "VARCHAR[]",
    "note": "VARCHAR",
    "fingerprint": "BIGINT",
    "parameters": "STRUCT(method VARCHAR, name VARCHAR, value DOUBLE, std DOUBLE, low DOUBLE, high DOUBLE)[]",
    "findings": "STRUCT(effect VARCHAR, rotor INTEGER, confidence DOUBLE, evidence VARCHAR, alternatives VARCHAR[])[]",
    "quality": "VARCHAR[]",
    "inputs": "STRUCT(name VARCHAR, sha256 VARCHAR)[]",
}
_VIEWS = """
CREATE VIEW flights AS SELECT * EXCLUDE (parameters, findings, quality, inputs, fingerprint),
  list_filter(parameters, lambda p: p.method = 'canonical' AND p.name = 'mass_kg')[1].value AS mass_kg FROM catalogue;
CREATE VIEW parameters AS
    SELECT flight, folder, date, vehicle, p.* FROM (SELECT *, unnest(parameters) AS p FROM catalogue);
CREATE VIEW findings AS SELECT flight, folder, date, vehicle, f.* FROM (SELECT *, unnest(findings) AS f FROM catalogue);
CREATE VIEW quality AS SELECT flight, folder, date, vehicle, unnest(quality) AS sentence FROM catalogue;
CREATE VIEW inputs AS SELECT flight, folder, i.* FROM (SELECT *, unnest(inputs) AS i FROM catalogue);
"""
TABLES = ("flights", "parameters", "findings", "quality", "inputs")


@dataclass(frozen=True, slots=True)
class Filter:
    """Which flights a listing shows; what is None or empty does not filter."""

    vehicle: str | None = None
    since: str | None = None
    finding: str | None = None
    tag: str | None = None

    def where(self) -> tuple[str, list[str]]:
        """A condition on ``catalogue`` and its parameters."""
        parts = [
            ("vehicle = ?", self.vehicle),
            ("date >= ?", self.since),
            ("list_contains(list_transform(findings, lambda f: f.effect), ?)", self.finding),
            ("list_contains(tags, ?)", self.tag),
        ]
        given = [(condition, value) for condition, value in parts if value]
        return " AND ".join(condition for condition, _ in given) or "true", [value for _, value in given]


class Catalogue:
    """What lies below a logs folder; refreshed when made.

    Args:
        logs: the folder; one that is not there holds no flights.
        rebuild: read every flight again, whatever the file says.

    Attributes:
        note: what was wrong with the file that was there, in a sentence; empty where nothing was.
    """

    def __init__(self, logs: str | Path, *, rebuild: bool = False):
        self.logs = Path(logs)
        self.note = ""
        self._file = self.logs / FILE
        self._connection = self._open(rebuild)
        self._refresh()

    def rows(self, which: Filter = Filter(), *, newest: int | None = None) -> list[Row]:
        """Flights, oldest first, with the canonical ``parameters`` (value, std) and ``moved``: their change since the
        vehicle's flight before, in combined standard deviations.
        """
        condition, values = which.where()
        limit = f"ORDER BY date DESC, flight DESC LIMIT {int(newest)}" if newest is not None else ""
        chosen = self._connection.execute(
            "SELECT flight, folder, date, vehicle, state, verdict, reason, best, tags, note,"
            " [p.name FOR p IN parameters IF p.method = 'canonical'] AS names,"
            " [p.value FOR p IN parameters IF p.method = 'canonical'] AS values,"
            " [p.std FOR p IN parameters IF p.method = 'canonical'] AS stds, moved_names, moves"
            f" FROM catalogue LEFT JOIN moves USING (folder) WHERE {condition} {limit}",
            values,
        )
        columns = [column[0] for column in chosen.description or ()]
        found = [dict(zip(columns, row, strict=True)) for row in chosen.fetchall()]
        for row in found:
            estimates = zip(row.pop("names"), row.pop("values"), row.pop("stds"), strict=True)
            row["parameters"] = {name: {"value": value, "std": std} for name, value, std in estimates}
            row["moved"] = dict(zip(row.pop("moved_names") or (), row.pop("moves") or (), strict=True))
        return sorted(found, key=lambda row: (row["date"], row["flight"]))

    def series(self, vehicle: str) -> Mapping[str, tuple[list[str], list[float], list[float]]]:
        """Canonical parameters of a vehicle over its flights: (flights, values, stds) by name, oldest flight first."""
        rows = self._connection.execute(
            "SELECT name, list(flight ORDER BY date, flight), list(value ORDER BY date, flight), list(std ORDER BY "
            "date, flight) FROM parameters WHERE method = ? AND vehicle = ? AND std > 0 AND isfinite(value) AND "
            "isfinite(std) GROUP BY name ORDER BY name",
            [CANONICAL, vehicle],
        ).fetchall()
        return {name: (flights, values, stds) for name, flights, values, stds in rows}

    def vehicles(self) -> list[str]:
        """Names of the vehicles that were identified."""
        query = "SELECT DISTINCT vehicle FROM catalogue WHERE vehicle IS NOT NULL ORDER BY vehicle"
        return [name for (name,) in self._connection.execute(query).fetchall()]

    def sql(self, query: str) -> tuple[list[str], list[tuple[Any, ...]]]:
        """One SELECT over :data:`TABLES`; it can read nothing else and change nothing.

        Raises:
            BadInput: it is no single SELECT, or DuckDB refuses it; the sentence has DuckDB's reason.
        """
        import duckdb

        try:
            statements = self._connection.extract_statements(query)
            if len(statements) != 1 or statements[0].type != duckdb.StatementType.SELECT:
                raise BadInput(f"--sql takes one SELECT over {', '.join(TABLES)}; nothing was run.")
            result = self._connection.execute(statements[0])
            return [column[0] for column in result.description or ()], result.fetchall()
        except duckdb.Error as error:
            reason = str(error).splitlines()[0]
            raise BadInput(f"the query was refused: {reason}; the tables are {', '.join(TABLES)}.") from None

    def export(self, path: Path) -> Path:
        """All parameters with their flights as Parquet or CSV, by the name's ending, whole or not at all.

        Raises:
            BadInput: another ending, or the file cannot be written.
        """
        query = (
            "SELECT p.*, f.state, f.verdict, array_to_string(f.tags, ' ') AS tags FROM parameters p JOIN flights f "
            "USING (folder)"
        )
        names, rows = self.sql(f"{query} ORDER BY ALL")
        kinds = {n: "DOUBLE" if n in ("value", "std", "low", "high") else "VARCHAR" for n in names}
        return write_rows(path, [dict(zip(names, row, strict=True)) for row in rows], kinds)

    def _open(self, rebuild: bool) -> duckdb.DuckDBPyConnection:
        """A database in memory, filled from the file where that can be read; nothing outside can be reached through
        it.
        """
        import duckdb

        connection = _load_only()
        if not rebuild and self._file.is_file():
            try:
                names = ", ".join(_COLUMNS)
                connection.execute(
                    f"INSERT INTO catalogue SELECT {names} FROM read_parquet('{_quoted(self._file)}') WHERE schema = "
                    f"'{SCHEMA}'"
                )
            except duckdb.Error as error:
                self.note = (
                    f"{self._file} could not be read ({str(error).splitlines()[0]}); it is made again from the flights."
                )
                connection.close()
                connection = _load_only()
        return connection

    def _refresh(self) -> None:
        """Bring the table up to date with the folders, write it when it changed, and close the database to everything
        outside.
        """
        known = dict(self._connection.execute("SELECT folder, fingerprint FROM catalogue").fetchall())
        here = dict(_flight_folders(self.logs, known))
        gone = [folder for folder in known if folder not in here]
        changed = [folder for folder, stamp in here.items() if known.get(folder) != stamp]
        emptied = [f for f in changed if f in known and not any((Path(f) / sign).exists() for sign in SIGNS)]
        gone, changed = [*gone, *emptied], [f for f in changed if f not in emptied]
        if gone or changed:
            self._connection.execute(
                "DELETE FROM catalogue WHERE list_contains(?::VARCHAR[], folder)", [[*gone, *changed]]
            )
            _insert(self._connection, [row_of(Path(folder), here[folder]) for folder in changed])
        if (gone or changed) and self.logs.is_dir():
            self._write()
        self._connection.execute(_MOVES)
        self._connection.execute("SET enable_external_access = false; SET lock_configuration = true")

    def _write(self) -> None:
        """The Parquet file, whole.

        Where the folder cannot be written, the listing is still right: it is only slower next time.
        """
        try:
            with _beside(self._file) as place:
                self._connection.execute(
                    f"COPY (SELECT '{SCHEMA}' AS schema, * FROM catalogue ORDER BY date, folder)"
                    f" TO '{_quoted(place)}' (FORMAT PARQUET, COMPRESSION ZSTD, USE_TMP_FILE false)"
                )
        except OSError as error:
            self.note = f"{self._file} cannot be written ({error.strerror}); flights are read again at each listing."


_MOVES = """
CREATE TABLE moves AS
SELECT folder, list(name ORDER BY name) AS moved_names, list((value - before) / hypot ORDER BY name) AS moves FROM (
  SELECT folder, name, value, before, sqrt(std * std + std_before * std_before) AS hypot FROM (
    SELECT folder, name, value, std, lag(value) OVER w AS before, lag(std) OVER w AS std_before, flight_number,
      lag(flight_number) OVER w AS number_before
    FROM (SELECT *, dense_rank() OVER (PARTITION BY vehicle ORDER BY date, flight) AS flight_number
          FROM parameters WHERE method = 'canonical')
    WINDOW w AS (PARTITION BY vehicle, name ORDER BY date, flight))
  WHERE number_before = flight_number - 1)
WHERE hypot > 0 GROUP BY folder
"""
"""Each parameter against the same vehicle's flight before, when that one has it too."""


def _load_only() -> duckdb.DuckDBPyConnection:
    import duckdb

    connection = duckdb.connect(":memory:")
    columns = ", ".join(f"{name} {kind}" for name, kind in _COLUMNS.items())
    connection.execute(f"SET threads = 2; CREATE TABLE catalogue ({columns}); {_VIEWS}")
    return connection


def _insert(connection: duckdb.DuckDBPyConnection, rows: Sequence[Row]) -> None:
    if rows:
        with _as_lines(rows, _COLUMNS) as source:
            connection.execute(f"INSERT INTO catalogue SELECT * FROM {source}")


@contextmanager
def _as_lines(rows: Sequence[Row], kinds: Mapping[str, str]) -> Iterator[str]:
    """Rows as a source for SQL, through the reader of JSON lines: a row at a time costs a hundred times as much."""
    with tempfile.NamedTemporaryFile("w", suffix=".ndjson", encoding="utf-8") as file:
        for row in rows:
            file.write(json.dumps({name: row.get(name) for name in kinds}, default=str))
            file.write("\n")
        file.flush()
        columns = "{" + ", ".join(f"{name}: '{kind}'" for name, kind in kinds.items()) + "}"
        name = _quoted(Path(file.name))
        yield f"read_json('{name}', columns = {columns}, format = 'newline_delimited', maximum_object_size = 67108864)"


def write_rows(path: Path, rows: Sequence[Row], kinds: Mapping[str, str]) -> Path:
    """Rows as Parquet or CSV, by the name's ending, whole or not at all.

    Args:
        kinds: DuckDB type of each column, in order.

    Raises:
        BadInput: another ending, or the file cannot be written.
    """
    import duckdb

    form = {".parquet": "PARQUET", ".csv": "CSV"}.get(path.suffix)
    if form is None:
        raise BadInput(f"{path}: ends in neither .parquet nor .csv; name one of them.")
    try:
        with duckdb.connect(":memory:") as connection, _as_lines(rows, kinds) as source, _beside(path) as place:
            connection.execute(
                f"COPY (SELECT * FROM {source}) TO '{_quoted(place)}' (FORMAT {form}, USE_TMP_FILE false)"
            )
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); name a file in a folder that exists.") from None
    return path


def _flight_folders(logs: Path, known: Mapping[str, int]) -> Iterator[tuple[str, int]]:
    """Folders that hold a flight, with their modification time in ns. One that is known is not looked into again."""
    waiting = [str(logs)]
    while waiting:
        folder = waiting.pop()
        try:
            with os.scandir(folder) as entries:
                inside = list(entries)
        except OSError:
            continue
        if any(entry.name in SIGNS for entry in inside):
            yield folder, os.stat(folder).st_mtime_ns  # noqa: PTH116
            continue
        for entry in inside:
            try:
                if entry.name.startswith(".") or not entry.is_dir(follow_symlinks=False):
                    continue
                if entry.path in known:
                    yield entry.path, entry.stat().st_mtime_ns
                else:
                    waiting.append(entry.path)
            except OSError:
                continue


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """A place beside ``path`` that becomes it when the block ends well, and is removed when it does not."""
    handle, name = tempfile.mkstemp(prefix=".new-", suffix=path.suffix, dir=path.parent)
    os.close(handle)
    place = Path(name)
    try:
        yield place
        place.replace(path)
    finally:
        place.unlink(missing_ok=True)


def _quoted(path: Path) -> str:
    return str(path).replace("'", "''")
