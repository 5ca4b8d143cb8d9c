"""Write PX4's ULog format (docs.px4.io, "ULog File Format"): definitions, then time-stamped data messages."""

from __future__ import annotations

import struct

_MAGIC = b"ULog\x01\x12\x35"
_CODES = {
    "int8_t": "b", "uint8_t": "B", "bool": "?", "int16_t": "h", "uint16_t": "H", "int32_t": "i", "uint32_t": "I",
    "int64_t": "q", "uint64_t": "Q", "float": "f", "double": "d",
}  # fmt: skip


def _code(definition: str, formats: dict[str, str]) -> str:
    """Struct code of a format's fields "type name;type[n] name;...", nested formats written out."""
    codes = []
    for item in filter(None, definition.split(";")):
        kind, _, count = item.split(" ")[0].rstrip("]").partition("[")
        if kind in formats:
            codes.append(_code(formats[kind], formats) * int(count or 1))
        else:
            codes.append(f"{count}{_CODES[kind]}")
    return "".join(codes)


class ULogWriter:
    """A log in memory that grows by one message per call.

    Args:
        start_us: the autopilot's time at the start.
        formats: fields of each topic, in the form of the format message, timestamp first; a format that another one
            contains is not a topic of its own.
        info: key-value pairs of text, integers.
        parameters: initial parameters: name, whether it is a float, value.
    """

    def __init__(
        self,
        start_us: int,
        formats: dict[str, str],
        info: dict[str, str | int],
        parameters: list[tuple[str, bool, float]],
        data: bytearray | None = None,
    ):
        self.data = bytearray() if data is None else data
        self.data += _MAGIC + struct.pack("<BQ", 1, start_us)
        self._message("B", bytes(40))
        for key, value in info.items():
            self._info(key, value)
        for name, fields in formats.items():
            self._message("F", f"{name}:{fields}".encode())
        for name, is_float, value in parameters:
            key = f"{'float' if is_float else 'int32_t'} {name}".encode()
            packed = struct.pack("<f", value) if is_float else struct.pack("<i", int(value))
            self._message("P", bytes([len(key)]) + key + packed)
        self._packers: dict[str, struct.Struct] = {}
        self._ids: dict[str, int] = {}
        nested = {name for name in formats if any(f";{name}[" in f";{fields}" for fields in formats.values())}
        for number, (name, fields) in enumerate((n, f) for n, f in formats.items() if n not in nested):
            self._packers[name] = struct.Struct(f"<HBH{_code(fields, formats)}")
            self._ids[name] = number
            self._message("A", struct.pack("<BH", 0, number) + name.encode())

    def add(self, topic: str, *values: float) -> None:
        """One data message; the first value is the timestamp in microseconds."""
        packer = self._packers[topic]
        self.data += packer.pack(packer.size - 3, 0x44, self._ids[topic], *values)

    def text(self, time_us: int, level: int, text: str) -> None:
        """A logged string; levels as of the Linux kernel (0 emergency .. 7 debug)."""
        self._message("L", struct.pack("<BQ", 0x30 + level, time_us) + text.encode())

    def parameter(self, name: str, is_float: bool, value: float) -> None:
        """A parameter changed while logging."""
        key = f"{'float' if is_float else 'int32_t'} {name}".encode()
        packed = struct.pack("<f", value) if is_float else struct.pack("<i", int(value))
        self._message("P", bytes([len(key)]) + key + packed)

    def _info(self, key: str, value: str | int) -> None:
        if isinstance(value, int):
            name, packed = f"uint32_t {key}".encode(), struct.pack("<I", value)
        else:
            packed = value.encode()
            name = f"char[{len(packed)}] {key}".encode()
        self._message("I", bytes([len(name)]) + name + packed)

    def _message(self, kind: str, body: bytes) -> None:
        self.data += struct.pack("<HB", len(body), ord(kind)) + body
