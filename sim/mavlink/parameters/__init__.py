"""The parameter tables of the two autopilots and a store that answers for them.

``px4.csv`` and ``arducopter.csv`` list what the firmwares reported in the recorded flights (names, types, values), in
the order of their own indices. Values travel in the float field of PARAM_VALUE: PX4 copies an integer's bytes into it,
ArduPilot converts.
"""

from __future__ import annotations

import csv
import math
import struct
from dataclasses import dataclass, replace
from importlib import resources

from sim.mavlink.wire import Message, mavlink

_TYPES = {
    "int": mavlink.MAV_PARAM_TYPE_INT32,
    "int8": mavlink.MAV_PARAM_TYPE_INT8,
    "int16": mavlink.MAV_PARAM_TYPE_INT16,
    "int32": mavlink.MAV_PARAM_TYPE_INT32,
    "float": mavlink.MAV_PARAM_TYPE_REAL32,
}


_BITS = {mavlink.MAV_PARAM_TYPE_INT8: 8, mavlink.MAV_PARAM_TYPE_INT16: 16, mavlink.MAV_PARAM_TYPE_INT32: 32}


@dataclass(slots=True)
class Parameter:
    """One setting; ``kind`` is its MAV_PARAM_TYPE."""

    name: str
    kind: int
    value: float

    @property
    def is_float(self) -> bool:
        """Whether the value is a float32."""
        return self.kind == mavlink.MAV_PARAM_TYPE_REAL32


def single(value: float) -> float:
    """The float32 nearest to a value."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


class ParameterStore:
    """Parameters by name and index.

    Args:
        table: "px4" or "arducopter".
        bytewise: integers travel as their bytes (PX4) rather than converted to float.
    """

    def __init__(self, table: str, *, bytewise: bool):
        text = (resources.files("sim.mavlink.parameters") / f"{table}.csv").read_text(encoding="ascii")
        rows = csv.DictReader(text.splitlines())
        self.all = [Parameter(r["name"], _TYPES[r["type"]], single(float(r["value"]))) for r in rows]
        for parameter in self.all:
            if not parameter.is_float:
                parameter.value = round(parameter.value)
        self._index = {parameter.name: i for i, parameter in enumerate(self.all)}
        self._bytewise = bytewise

    def add(self, *more: Parameter) -> None:
        """Append settings the recorded table does not have."""
        for parameter in more:
            self._index[parameter.name] = len(self.all)
            self.all.append(replace(parameter))

    def __len__(self) -> int:
        return len(self.all)

    def __contains__(self, name: str) -> bool:
        return name in self._index

    def __getitem__(self, name: str) -> float:
        return self.all[self._index[name]].value

    def __setitem__(self, name: str, value: float) -> None:
        parameter = self.all[self._index[name]]
        parameter.value = single(value) if parameter.is_float else int(value)

    def index(self, name: str) -> int | None:
        """Position of a name, None for an unknown one."""
        return self._index.get(name)

    def to_wire(self, parameter: Parameter) -> float:
        """The float field of PARAM_VALUE."""
        if parameter.is_float or not self._bytewise:
            return parameter.value
        return struct.unpack("<f", struct.pack("<i", int(parameter.value)))[0]

    def holds(self, parameter: Parameter, message: Message) -> bool:
        """Whether the parameter can take the value of a PARAM_SET: a number, within its integer type."""
        bytewise_integer = self._bytewise and message.param_type != mavlink.MAV_PARAM_TYPE_REAL32
        if not bytewise_integer and not math.isfinite(message.param_value):
            return False
        bits = _BITS.get(parameter.kind)
        return bits is None or abs(self.from_wire(message.param_value, message.param_type)) < 2.0 ** (bits - 1)

    def from_wire(self, field: float, kind: int) -> float:
        """The value in the float field of PARAM_SET, for the type it claims to have."""
        if kind == mavlink.MAV_PARAM_TYPE_REAL32:
            return field
        return struct.unpack("<i", struct.pack("<f", field))[0] if self._bytewise else round(field)
