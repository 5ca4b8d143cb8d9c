"""JSON documents of results: finite numbers, files that are whole or not there, refusals."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from groundstation.errors import Refused
from groundstation.json_types import Document, JsonObject
from groundstation.writing import write_whole


def write_json(path: Path, document: Document) -> Path:
    """A JSON file a person can read. Numbers that are not finite become null, as JSON has none."""
    return write_whole(path, json.dumps(finite(document), indent=1, ensure_ascii=False) + "\n")


def finite(value: Any) -> Any:
    """The same document with numpy numbers as plain ones and NaN or infinity as None."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(item) for item in value]
    if hasattr(value, "tolist"):
        return finite(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def refusal(error: Refused) -> JsonObject:
    """The JSON document of a refusal."""
    return {
        "schema": "groundstation.refusal/1",
        "refused": True,
        "reason": error.reason,
        "remedy": error.remedy,
        "not_identifiable": list(error.not_identifiable),
    }
