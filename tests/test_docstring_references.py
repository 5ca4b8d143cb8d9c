"""What docstrings and comments point to is there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NAMED = re.compile(r"(?<![\w/.*{}-])((?:[\w-]+/)*[\w-]+\.md)\b")
"""A Markdown file by name."""
FOREIGN = {"libraries/SITL/examples/JSON/readme.md"}
"""In other projects' sources, named beside them."""


def missing(text: str) -> list[str]:
    """References of a text to Markdown files of the repository that do not exist."""
    return [name for name in NAMED.findall(text) if name not in FOREIGN and not (ROOT / name).exists()]


def test_every_page_that_code_points_to_exists() -> None:
    found = {
        f"{path.relative_to(ROOT)}: {name}"
        for package in ("groundstation", "drivers", "sim", "studies", "benchmarks")
        for path in sorted((ROOT / package).rglob("*.py"))
        for name in missing(path.read_text(encoding="utf-8"))
    }
    assert not found, "\n".join(sorted(found))


def test_a_page_that_is_not_there_is_found() -> None:
    assert missing("see docs/diagnosis.md and effects.md") == ["effects.md"]
