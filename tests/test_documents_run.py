"""Every command that README and docs print is there, and the quick ones run and end well (the others are parsed in
test_cli_words).
"""

from __future__ import annotations

import re
import shlex
from dataclasses import replace

import pytest
from test_cli_words import DOCUMENTS, ROOT, printed_commands

from groundstation.cli import main
from groundstation.fleet.rows import set_notes
from groundstation.reporting.exports import model_document, write_model
from tests import reporting_fixture as fixture

QUICK = ("export", "flights", "compare", "completion", "doctor")
NAMES = ("2026-01-31T12-00-00-x500", "2026-02-01T12-00-00-x500")


def quick() -> list[tuple[str, str]]:
    """Printed commands that need no flight, no plan and no link, each once; what a document shows behind them is left
    out.
    """
    found = {}
    for document, line in printed_commands():
        words = re.sub(r"\s{2,}\S.*$", "", line).split("#")[0].strip()
        if words.split()[1] in QUICK and "s3://" not in words:
            found.setdefault(words, document)
    return sorted((document, words) for words, document in found.items())


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """A folder as the documents speak of: two flights in logs, tagged, and the model file of one."""
    (tmp_path / "logs").mkdir()
    (tmp_path / "first").mkdir()
    for name, tag in zip(NAMES, ("empty", "payload"), strict=True):
        set_notes(fixture.written(tmp_path / "logs" / name), add=(tag,))
    found = replace(fixture.diagnosis(), findings=fixture.diagnosis().findings[:1])
    model = model_document(fixture.identification(), fixture.vehicle(), found)
    for place in ("identification.toml", "first/identification.toml"):
        write_model(tmp_path / place, model)
    for place, name in (("flight-a", NAMES[0]), ("flight-b", NAMES[1])):
        (tmp_path / "logs" / place).symlink_to(tmp_path / "logs" / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("document", "line"), quick())
def test_a_quick_command_of_the_documents_runs_as_printed(document, line, workplace, capfd):
    words = shlex.split(line)[1:]
    if words in (["export"], ["compare"]):
        return  # running text that names the command
    status = main(words)
    said = capfd.readouterr()
    accepted = (0, 3) if words[0] == "doctor" else (0,)  # what is wrong with this machine is an answer
    assert status in accepted, (document, line, said.err)
    assert said.out.strip()
    for option in ("--output", "--export", "--report"):
        if option in words:
            assert (workplace / words[words.index(option) + 1]).stat().st_size > 0


def test_every_benchmark_target_and_file_that_the_documents_print_exists():
    missing = []
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for path in DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        for module in re.findall(r"python (?:-P )?-m (benchmarks\.\w+)", text):
            if not (ROOT / f"{module.replace('.', '/')}.py").is_file():
                missing.append((path.name, module))
        for script in re.findall(r"python (benchmarks/\w+\.py|docs/\S+\.py)", text):
            if not (ROOT / script).is_file():
                missing.append((path.name, script))
        for target in re.findall(r"[`\n]make ([a-z][a-z-]+)", text):
            if not re.search(rf"^{target}:", makefile, re.M):
                missing.append((path.name, f"make {target}"))
    assert not missing


def test_the_documents_have_quick_commands_at_all():
    assert len(quick()) > 12
