"""Names for what JSON and TOML documents are in Python."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

JsonObject = dict[str, Any]
"""A document, or a table of one, as it is written."""
Document = Mapping[str, Any]
"""The same, to be read alone."""
