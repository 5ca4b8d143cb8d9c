"""The table of thresholds: complete lines, one place for each number, and documents that say what the code does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from groundstation.diagnosis.thresholds import THRESHOLDS, Entry, entries

ROOT = Path(__file__).resolve().parent.parent
DIAGNOSIS = ROOT / "groundstation" / "diagnosis"
PAGE = ROOT / "docs" / "diagnosis.md"
PAGES = {
    PAGE: (
        "specific force below {curve_low_pass_hz} Hz",
        "beats chance ({effect_chance}, shared among its variants",
        "(RMS of {material_percent} % of weight",
        "explains more than a tenth ({form_error_share}) of the amplitude of the other effects",
        "{held_out_guard_s} s of guard on either side",
        "({held_out_guard_s} s of guard)",
        "unlikely by chance ({dependence_chance} over all)",
    ),
    ROOT / "docs" / "decisions" / "0006-evidence-is-a-joint-wald-statistic.md": (
        "what chance passes once in {effect_chance_inverse} per effect",
        "larger than {material_percent} % of weight",
        "to {material_percent} % on 2026-11-22",
    ),
}


def written(value: float | tuple[float, ...]) -> str:
    """A number as people write it."""
    if isinstance(value, tuple):
        return " to ".join(map(written, value))
    return re.sub(r"e([+-])0*(\d)", lambda m: f"e{m[1].strip('+')}{m[2]}", f"{value:.4g}")


def line(entry: Entry) -> str:
    number = f"{written(entry.value)} {entry.unit}".strip()
    return f"| `{entry.name}` | {number} | {entry.reason} | {entry.source} | {entry.chosen_on} |"


def test_the_page_prints_the_table_as_the_code_has_it():
    printed = [each for each in PAGE.read_text(encoding="utf-8").splitlines() if each.startswith("| `")]
    names = {f"| `{entry.name}` |" for entry in entries()}
    table = [each for each in printed if any(each.startswith(name) for name in names)]
    expected = [line(entry) for entry in entries()]
    assert table == expected, "docs/diagnosis.md should have:\n" + "\n".join(expected)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_prose_gives_the_numbers_of_the_table(page: Path):
    text = " ".join(page.read_text(encoding="utf-8").split())
    numbers = {entry.name: written(entry.value) for entry in entries()} | {
        "material_percent": written(100.0 * THRESHOLDS.material_share),
        "effect_chance_inverse": written(1.0 / THRESHOLDS.effect_chance),
    }
    for phrase in PAGES[page]:
        assert phrase.format(**numbers) in text


def test_every_threshold_has_a_sentence_a_source_and_what_it_was_chosen_on():
    for entry in entries():
        assert entry.reason.endswith(".") and len(entry.reason.split()) > 5, entry.name
        assert entry.source and entry.chosen_on, entry.name


def test_every_threshold_is_read_and_none_stands_in_a_module_of_its_own():
    modules = {path: path.read_text(encoding="utf-8") for path in DIAGNOSIS.rglob("*.py") if path.stem != "thresholds"}
    code = "\n".join(modules.values())
    for entry in entries():
        assert f"THRESHOLDS.{entry.name}" in code, f"{entry.name} is read by nobody"
    verdict = re.compile(r"^(CHANCE|CERTAIN|MATERIAL|INSEPARABLE|FORM|LEAST|LARGEST|WORSE|BETTER)\w* = ", re.M)
    for path, text in modules.items():
        found = verdict.search(text)
        assert found is None, f"{path.name}: {found and found.group()} belongs into thresholds.py"
