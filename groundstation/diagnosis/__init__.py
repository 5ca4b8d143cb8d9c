"""From a residual to the effect behind it: evidence, attribution, the error before and after."""

from __future__ import annotations

from groundstation.diagnosis.diagnose import diagnose

__all__ = ["diagnose"]
