"""Rules of the house that a linter does not know: import directions, what the wheel holds, what must not be in
files.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()


def test_imports_point_the_right_way():
    done = subprocess.run(
        [sys.executable, "-c", "import sys; from importlinter.cli import lint_imports_command as c; sys.exit(c())"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout


def imported(path: Path) -> set[str]:
    """Top-level packages that a file imports, wherever in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.split(".")[0])
    return found


@pytest.mark.parametrize(
    ("folder", "never"),
    [("tests", {"benchmarks"}), ("studies", {"benchmarks", "tests"}), ("groundstation", {"studies", "benchmarks"}),
     ("sim", {"studies", "benchmarks"}), ("drivers", {"studies", "benchmarks"})],
)  # fmt: skip
def test_command_lines_are_imported_by_nobody(folder, never):
    wrong = {path.name: found for path in (ROOT / folder).rglob("*.py") if (found := imported(path) & never)}
    assert not wrong


def test_functions_stay_short():
    lengths = {
        f"{path.relative_to(ROOT)}: {node.name}": (node.end_lineno or node.lineno) - node.lineno + 1
        for package in ("groundstation", "drivers", "sim")
        for path in sorted((ROOT / package).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    }
    long = sorted((length, name) for name, length in lengths.items() if length > 40)
    assert len(long) <= 0.01 * len(lengths), long
    assert max(lengths.values()) <= 80, long[-1]


def test_the_wheel_holds_three_packages_and_the_configs(tmp_path):
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), "."]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    names = zipfile.ZipFile(next(tmp_path.glob("*.whl"))).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == {"groundstation", "drivers", "sim"}
    for config in (ROOT / "configs").glob("*/*.toml"):
        assert f"groundstation/{config.relative_to(ROOT).as_posix()}" in names
    assert any(name.endswith("entry_points.txt") for name in names)


@pytest.mark.skipif(not tracked, reason="not a git work tree")
def test_constraints_name_versions_and_no_addresses():
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")]
    assert lines and all(re.fullmatch(r"[A-Za-z0-9_.-]+==[0-9][A-Za-z0-9.+!]*", line) for line in lines)


def test_the_lock_agrees_with_the_constraints_and_hashes_every_package():
    def plain(name: str) -> str:
        return re.sub(r"[-_.]+", "-", name).lower()

    pinned = dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(), re.M))
    pinned = {plain(name): version for name, version in pinned.items()}
    text = (ROOT / "requirements.lock").read_text().replace("\\\n", " ")
    locked = [
        re.fullmatch(r"([\w.-]+)==(\S+)( ; [^#@:]+?)?((?: +--hash=sha256:[0-9a-f]{64})+)", line)
        for line in text.splitlines()
    ]
    assert len(locked) > 100
    for line, entry in zip(text.splitlines(), locked, strict=True):
        assert entry is not None, f"not a name, a version and hashes alone: {line[:80]}"
        name, version, marker, _ = entry.groups()
        assert pinned.get(plain(name), version if marker else "nothing") == version, f"{name}: run `make lock`"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = {plain(re.split(r"[<>=\[; ]", each)[0]) for each in [*project["dependencies"], *extras["dev"]]}
    assert wanted <= {plain(entry[1]) for entry in locked if entry}


def test_everything_imported_is_constrained():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = [*project["dependencies"], *(r for extra in project["optional-dependencies"].values() for r in extra)]

    def plain(name: str) -> str:
        return re.sub(r"[-_.]+", "-", re.split(r"[<>=!\[; ]", name)[0]).lower()

    pinned = {plain(line) for line in (ROOT / "constraints.txt").read_text().splitlines() if "==" in line}
    assert {plain(name) for name in wanted} <= pinned


@pytest.mark.skipif(not tracked, reason="not a git work tree")
def test_no_file_names_a_place_on_somebodys_machine():
    homes = re.compile(r"(?<![\w.])/(?:home|Users|root|work)/\w")
    texts = [ROOT / name for name in tracked if Path(name).suffix in {".py", ".toml", ".md", ".txt", ".tcss", ""}]
    for path in texts:
        if path.is_file() and path != Path(__file__).resolve():
            match = homes.search(path.read_text(encoding="utf-8", errors="ignore"))
            assert match is None, f"{path.relative_to(ROOT)}: {match and match.group()}"


def test_every_test_that_the_documents_name_exists():
    text = (ROOT / "docs" / "requirements.md").read_text(encoding="utf-8")
    tests = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").glob("test_*.py"))
    for name in set(re.findall(r"`(test_\w+)`", text)):
        assert f"def {name}(" in tests, name
    for path in set(re.findall(r"`((?:tests|docs|\.ci|configs)/[\w./-]+)`", text)):
        assert (ROOT / path).exists(), path
