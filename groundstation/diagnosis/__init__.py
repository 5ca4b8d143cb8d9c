"""From a residual to the effect behind it: evidence, attribution, the error before and after."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from groundstation.diagnosis.pipeline import diagnose

__all__ = ["diagnose"]


def __getattr__(name: str) -> Any:
    """``diagnose``, imported when it is asked for: it takes scipy and numba a second to load."""
    if name != "diagnose":
        raise AttributeError(name)
    from groundstation.diagnosis.pipeline import diagnose as found

    return found
