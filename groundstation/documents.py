"""The documents of results as they come back from files: every field that is read has its type, or the file is refused.

What is written without a number (JSON has no NaN: null) is absent here. Fields that nobody reads are carried along.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from groundstation.errors import BadInput
from groundstation.json_types import Document, JsonObject
from groundstation.outside import read_json
from groundstation.texts import shown

MODEL_SCHEMA = "groundstation.model/1"
IDENTIFICATION_SCHEMA = "groundstation.identification/1"
DIAGNOSIS_SCHEMA = "groundstation.diagnosis/1"

_LARGEST = 1e15
"""No mass, moment, time or share has such a size in SI units; squares and cubes of it are still numbers."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="allow", frozen=True)


def _spread(value: Any) -> Any:
    return math.nan if value is None else value


def _pair(value: Any) -> Any:
    return [_spread(item) for item in value] if isinstance(value, list) and len(value) == 2 else (math.nan, math.nan)


Size = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]


class Value(_Part):
    """An estimate: its value, standard deviation, and interval where it was written."""

    value: Size
    std: Annotated[float, BeforeValidator(_spread)] = math.nan
    ci95: Annotated[tuple[float, float] | None, BeforeValidator(_pair)] = None


def _known(table: Any) -> Any:
    """Without entries that have no value."""
    if not isinstance(table, dict):
        return table
    return {key: entry for key, entry in table.items() if not (isinstance(entry, dict) and entry.get("value") is None)}


def _numbers(table: Any) -> Any:
    return {key: value for key, value in table.items() if value is not None} if isinstance(table, dict) else table


def _present(value: Any, default: Any) -> Any:
    return default if value is None else value


def _list(value: Any) -> Any:
    return _present(value, [])


def _text(value: Any) -> Any:
    return _present(value, "")


Estimates = Annotated[dict[str, Value], BeforeValidator(_known)]
Numbers = Annotated[dict[str, Size], BeforeValidator(_numbers)]
Texts = Annotated[list[str], BeforeValidator(_list)]
Text = Annotated[str, BeforeValidator(_text)]


class ModelDocument(_Part):
    """``identification.toml``; written by :mod:`groundstation.reporting.exports`."""

    flight: str = ""
    method: str = ""
    anchor: str = "thrust"
    vehicle: dict[str, Any]
    parameters: Estimates
    model: Estimates = {}
    effects: dict[str, Estimates] = {}
    not_identifiable: list[str] = []


class Method(_Part):
    """One method of an identification."""

    parameters: Estimates = {}
    condition_number: float | None = None
    rms_output_error: Numbers = {}


class Check(_Part):
    """One validation of an identification."""

    kind: str
    note: Text = ""
    rms: dict[str, Numbers] = {}


class ClockEntry(_Part):
    """The clocks' offset."""

    mocap_minus_imu_s: Size
    std_s: Annotated[float, BeforeValidator(_spread)] = math.nan


class IdentificationDocument(_Part):
    """``identification.json``, what ``identify --json`` prints."""

    flight: Text = ""
    vehicle: Text = ""
    anchor: Text = "thrust"
    methods: dict[str, Method] = {}
    model: Estimates = {}
    best: Text = ""
    best_reason: Text = ""
    clock: ClockEntry | None = None
    not_identifiable: Texts = []
    remedies: dict[str, str] = {}
    warnings: Texts = []
    quality: Texts = []
    validation: list[Check] = []


class FindingEntry(_Part):
    """One finding of a diagnosis."""

    effect: str
    parameters: Estimates = {}
    evidence: Text = ""
    confidence: Size = 0.0
    alternatives: Texts = []
    rotor: int | None = None


class UnexplainedEntry(_Part):
    """One residual that is left."""

    channel: str
    share: Size = 0.0
    depends_on: Texts = []
    proposal: Text = ""


class CandidateEntry(_Part):
    """One effect that was tried."""

    effect: str = "?"
    settings: dict[str, Any] | None = None
    values: dict[str, Size] | None = None
    rival_of: str | None = None


class DiagnosisDocument(_Part):
    """``diagnosis.json``, what ``diagnose --json`` prints."""

    flight: Text = ""
    vehicle: Text = ""
    verdict: str = ""
    findings: list[FindingEntry] = []
    unexplained: list[UnexplainedEntry] = []
    error: dict[str, dict[str, Numbers]] = {}
    parameters_before: Estimates = {}
    parameters_after: Estimates = {}
    next_flight: Text = ""
    reason: Text = ""
    warnings: Texts = []
    candidates: list[CandidateEntry] = []


def checked(document: Any, kind: type[_Part], source: str) -> JsonObject:
    """A document whose fields have their types, defaults put in.

    Raises:
        BadInput: one sentence that names the first faults.
    """
    try:
        found = kind.model_validate(document)
    except (ValidationError, RecursionError) as error:
        raise BadInput(f"{source}: {_faults(error)}; write it again with `groundstation report`.") from None
    return found.model_dump(exclude_none=True)


def _faults(error: ValidationError | RecursionError) -> str:
    if isinstance(error, RecursionError):
        return "nests too deep"
    told = [f"{shown('.'.join(map(str, e['loc'])), limit=80) or 'document'}: {e['msg']}" for e in error.errors()[:3]]
    return "; ".join(told) + ("; and more" if error.error_count() > len(told) else "")


def read_diagnosis(path: Path) -> JsonObject:
    """The document in a ``diagnosis.json``.

    Raises:
        BadInput: missing, malformed, or of another schema.
    """
    try:
        document = read_json(path, "the diagnosis.json of a flight")
    except BadInput as error:
        raise BadInput(f"{str(error).removesuffix('.')}; write it with `diagnose`.") from None
    if not isinstance(document, dict) or document.get("schema", DIAGNOSIS_SCHEMA) != DIAGNOSIS_SCHEMA:
        raise BadInput(f"{path}: is no {DIAGNOSIS_SCHEMA} document; write one with `diagnose`.")
    return checked(document, DiagnosisDocument, str(path))


def read_identification(path: Path) -> JsonObject:
    """The document in an ``identification.json``.

    Raises:
        BadInput: missing, malformed, of another schema, or its best method is none of its methods.
    """
    document = read_json(path, "the identification.json of a flight")
    if not isinstance(document, dict) or document.get("schema", IDENTIFICATION_SCHEMA) != IDENTIFICATION_SCHEMA:
        raise BadInput(f"{path}: is no {IDENTIFICATION_SCHEMA} document; write one with `identify`.")
    found = checked(document, IdentificationDocument, str(path))
    require_best(found, str(path))
    return found


def require_best(document: Document, source: str) -> None:
    """Raise BadInput where the best method of an identification is none of its methods."""
    if document["best"] not in document["methods"]:
        names = shown(", ".join(document["methods"])) or "no methods"
        raise BadInput(f"{source}: its best method '{shown(document['best'], limit=60)}' is not among {names}.")
