"""What was changed on a vehicle for a flight, kept on disk until it is restored, so that a crash forgets nothing."""

from __future__ import annotations

import json
from pathlib import Path

from groundstation.errors import BadInput
from groundstation.writing import write_whole


class ParameterJournal:
    """Names and values to restore.

    Args:
        path: the file; None keeps nothing (nothing may be changed then, or it is lost with the process).
    """

    def __init__(self, path: Path | None):
        self._path = path
        self._values: dict[str, dict[str, float]] = {}
        if path is not None and path.is_file():
            try:
                document = json.loads(path.read_text(encoding="utf-8"))
                self._values = {
                    str(vehicle): {str(name): float(value) for name, value in values.items()}
                    for vehicle, values in document["restore"].items()
                }
            except (OSError, ValueError, KeyError, AttributeError, TypeError, OverflowError, RecursionError):
                raise BadInput(
                    f"{path}: should list parameters to restore and cannot be read; look at it, restore them by hand, "
                    "and remove it."
                ) from None

    def pending(self) -> dict[str, dict[str, float]]:
        """What earlier flights left changed: vehicle -> name -> value to write back."""
        return {vehicle: dict(values) for vehicle, values in self._values.items()}

    def note(self, vehicle: str, name: str, before: float, after: float) -> None:
        """A parameter is about to change, or (``before == after``) was restored. On disk when this returns."""
        values = self._values.setdefault(vehicle, {})
        if before == after:
            values.pop(name, None)
        else:
            values.setdefault(name, before)
        if not values:
            del self._values[vehicle]
        self._write()

    def _write(self) -> None:
        if self._path is None:
            return
        if not self._values:
            self._path.unlink(missing_ok=True)
            return
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(self._path, json.dumps({"restore": self._values}))


def left_changed(path: Path) -> str:
    """What flights changed and did not restore, as "NAME (1 before), ..."; empty when nothing, or when it cannot be
    read.
    """
    try:
        pending = ParameterJournal(path).pending()
    except BadInput as error:
        return str(error)
    return ", ".join(f"{name} ({value:g} before)" for values in pending.values() for name, value in values.items())
