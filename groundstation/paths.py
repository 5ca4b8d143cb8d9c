"""Where the files that ship with the program lie: in the installed package, or in the repository it runs from."""

from __future__ import annotations

import os
import subprocess
from functools import cache
from pathlib import Path

from groundstation.errors import BadInput
from groundstation.texts import file_name, shown


def configs_dir() -> Path:
    """The folder with ``vehicles/``, ``scenarios/``, ``plans/`` and ``stations/``."""
    package = Path(__file__).resolve().parent
    for candidate in (package / "configs", package.parent / "configs"):
        if candidate.is_dir():
            return candidate
    raise BadInput("the configs folder is missing from this installation; install groundstation again.")


def settings_dir() -> Path:
    """The folder of this user's own keys and passes, whether it is there or not."""
    home = os.environ.get("XDG_CONFIG_HOME") or Path("~/.config").expanduser()
    return Path(home) / "groundstation"


@cache
def commit() -> str:
    """The commit of the program where it runs from a checkout ("+" where files differ from it); empty where it is
    installed.
    """
    top = Path(__file__).resolve().parent.parent
    if not (top / ".git").exists():
        return ""
    told = ("git", "-C", str(top), "describe", "--always", "--abbrev=12", "--exclude=*", "--dirty=+")
    try:
        return subprocess.run(told, capture_output=True, text=True, timeout=5.0, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def find_config(kind: str, name_or_path: str | Path) -> Path:
    """A shipped file by its short name ("qball2"), or the path itself when it exists.

    Raises:
        BadInput: neither; the sentence lists the shipped names.
    """
    path = Path(name_or_path)
    if "\0" in str(path):
        raise BadInput(f"{shown(path)}: no file has such a name.")
    if path.suffix == ".toml" and path.is_file():
        return path
    shipped = configs_dir() / kind / f"{Path(name_or_path).name.removesuffix('.toml')}.toml"
    if path.parent == Path() and shipped.is_file():
        return shipped
    import difflib

    names = sorted(p.stem for p in (configs_dir() / kind).glob("*.toml"))
    near = difflib.get_close_matches(path.stem, names, n=1)
    meant = f"did you mean {near[0]}?" if near else f"there are {', '.join(names)}."
    raise BadInput(
        f"{shown(name_or_path)}: there is no such file, and none of this name among the shipped {kind}; {meant}"
    )


def shipped_config(kind: str, name: object) -> Path:
    """A shipped file by a short name that came from outside: never a path.

    Raises:
        BadInput: no such file ships.
    """
    if not isinstance(name, str) or file_name(name) != name:
        raise BadInput(f"'{shown(name, limit=60)}' is none of the shipped {kind}.")
    return find_config(kind, name)
