"""Compilation of the simulator's inner loop with numba, cached on disk by the content of the whole package.

Numba notices a change in the file of a cached function, not in the files of the functions it calls. The cache folder is
therefore named after a digest of every source that holds compiled functions: no stale machine code after an edit or an
update.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from numba.core import config

F = TypeVar("F", bound=Callable[..., Any])

_COMPILES = (b"import compiled", b"numba.core.extending", b"numba.njit")
"""What a source with compiled functions has in it."""


@cache
def _cache_folder() -> str:
    package = Path(__file__).resolve().parent
    digest = hashlib.sha256()
    for source in sorted([*package.glob("*.py"), *(package / "effects").glob("*.py")]):
        text = source.read_bytes()
        digest.update(text if any(mark in text for mark in _COMPILES) else b"")
    name = f"kernel-{digest.hexdigest()[:16]}"
    if os.access(package, os.W_OK):
        return str(package / "__pycache__" / name)
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return str(Path(home) / "groundstation" / name)


def compiled(function: F) -> F:
    """Compile for numbers and named tuples; division by zero gives inf, as in numpy."""
    before = config.CACHE_DIR  # pyright: ignore[reportAttributeAccessIssue]
    config.CACHE_DIR = _cache_folder()  # pyright: ignore[reportAttributeAccessIssue]
    try:
        return numba.njit(cache=True, error_model="numpy", forceinline=True)(function)  # type: ignore[return-value]
    finally:
        config.CACHE_DIR = before  # pyright: ignore[reportAttributeAccessIssue]
