"""Write ArduPilot's DataFlash format: self-describing records behind the marker A3 95."""

from __future__ import annotations

import struct

_CODES = {
    "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "q": "q", "Q": "Q", "f": "f", "d": "d", "n": "4s",
    "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B",
}  # fmt: skip
_SCALED = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
_FMT, _FMT_LENGTH = 128, 89
FORMAT = ("BBnNZ", "Type,Length,Name,Format,Columns")


class DataFlashWriter:
    """A log in memory that grows by one record per call.

    Args:
        formats: per record name its number, format letters and comma-separated columns.
    """

    def __init__(self, formats: dict[str, tuple[int, str, str]], data: bytearray | None = None):
        self.data = bytearray() if data is None else data
        self._records: dict[str, tuple[struct.Struct, int, tuple[tuple[int, float], ...]]] = {}
        self._describe("FMT", _FMT, *FORMAT)
        for name, (number, letters, columns) in formats.items():
            self._describe(name, number, letters, columns)

    def _describe(self, name: str, number: int, letters: str, columns: str) -> None:
        packer = struct.Struct("<BBB" + "".join(_CODES[letter] for letter in letters))
        scale = tuple((i, _SCALED[letter]) for i, letter in enumerate(letters) if letter in _SCALED)
        self._records[name] = (packer, number, scale)
        fields = (number, packer.size, name.encode(), letters.encode(), columns.encode())
        self.data += struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, _FMT, *fields)

    def add(self, name: str, *values: float | bytes) -> None:
        """One record; scaled letters (c, C, e, E, L) take the physical value."""
        packer, number, scale = self._records[name]
        if scale:
            fields = list(values)
            for index, factor in scale:
                fields[index] = round(float(fields[index]) * factor)
            values = tuple(fields)
        self.data += packer.pack(0xA3, 0x95, number, *values)
