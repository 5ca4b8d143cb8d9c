"""How long a call takes on one core."""

from __future__ import annotations

import time
from collections.abc import Callable


def seconds(function: Callable[[], object]) -> float:
    """Processor time of a call, of all threads together: what one core would need, whatever else runs beside it."""
    began = time.process_time()
    function()
    return time.process_time() - began
