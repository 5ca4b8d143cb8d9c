"""Texts that others wrote, as they may be shown and as they may name a file. Pure."""

from __future__ import annotations

import re

NAME_CHARS = 100
_ALLOWED = re.compile(r"[\w .+,=@()\[\]~-]+")


def shown(text: object, *, limit: int = 2000, lines: bool = False) -> str:
    r"""A text from outside as it may reach a terminal, a page or a log: what cannot be seen is left out.

    Args:
        text: anything; its ``str``.
        limit: of characters; a longer text ends in "...".
        lines: keep line breaks and tabs, for texts of several lines of our own.
    """
    whole = str(text)
    if len(whole) <= limit and whole.isprintable():
        return whole
    kept = "\n\t" if lines else ""
    clean = "".join(
        char if char.isprintable() or char in kept else " " if char.isspace() else "" for char in whole[: limit + 1]
    )
    return clean if len(whole) <= limit else f"{clean[: limit - 3]}..."


def file_name(text: object, default: str = "unnamed") -> str:
    """A text from outside as the name of one file or folder: letters, digits, ``._-``; never hidden, empty or a
    path.
    """
    name = re.sub(r"[^\w.-]+", "_", shown(text, limit=NAME_CHARS)).strip("._")
    return name or default


def holdable(name: str) -> bool:
    """Whether a name, with ``/`` between folders, can be one of a file below a folder (:func:`outside.inside`)."""
    parts = name.split("/")
    return len(name) <= 2 * NAME_CHARS and all(_ALLOWED.fullmatch(part) and part.strip(" .") == part for part in parts)
