"""Tables 3 to 12 of the seed paper (Lopez-Sanchez et al., IEEE Access 8, 2020), as printed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from groundstation.identification.results import MASS_AND_TENSOR, OUTPUTS

STANDARD, FILTERED = ("LS", "GD"), ("FMLS", "FMGD")
METHODS = (*STANDARD, *FILTERED)


def _columns(names: tuple[str, ...], rows: Mapping[str, tuple[float, ...]]) -> dict[str, dict[str, float]]:
    """From rows by signal to one mapping per column."""
    return {name: {signal: row[i] for signal, row in rows.items()} for i, name in enumerate(names)}


TABLE_3 = _columns(
    METHODS,
    dict(
        zip(
            MASS_AND_TENSOR,
            (
                (1.82246, 1.82536, 1.82245, 1.82430),
                (0.01200, 0.01014, 0.00749, 0.00737),
                (-0.00079, -0.00069, -0.00051, 0.00053),
                (0.00010, 0.00063, -0.00003, 0.00141),
                (0.01537, 0.01418, 0.00976, 0.00969),
                (-0.00060, 0.00033, -0.00098, 0.00137),
                (0.08295, 0.08530, 0.05130, 0.05887),
            ),
            strict=True,
        )
    ),
)
"""Estimated parameters by method."""

TABLE_4 = _columns(
    ("nominal", *METHODS),
    {
        "x_m": (0.06187, 0.05888, 0.05868, 0.05863, 0.05863),
        "y_m": (0.06977, 0.06601, 0.06577, 0.06642, 0.06613),
        "z_m": (0.01871, 0.01946, 0.01954, 0.01946, 0.01951),
        "roll_deg": (2.63299, 2.42519, 2.41133, 2.40335, 2.40027),
        "pitch_deg": (2.33434, 2.15146, 2.13917, 2.12429, 2.12517),
        "yaw_deg": (0.98831, 1.18669, 1.20820, 1.16907, 1.16413),
        "force_z_n": (0.41837, 0.41334, 0.42496, 0.41407, 0.42103),
        "torque_x_nm": (0.62791, 0.60840, 0.60445, 0.59663, 0.59541),
        "torque_y_nm": (0.61986, 0.60399, 0.60245, 0.59740, 0.59772),
        "torque_z_nm": (0.11823, 0.11641, 0.11658, 0.11495, 0.11484),
    },
)
"""Experiment against closed-loop simulation, RMS, 10 s to 50 s."""


class OutputTable(NamedTuple):
    """A table of RMS output prediction errors (43)."""

    number: int
    flight: str
    methods: tuple[str, str]
    rms: dict[str, dict[str, float]]


def _output(number: int, flight: str, methods: tuple[str, str], *rows: tuple[float, float, float]) -> OutputTable:
    return OutputTable(number, flight, methods, _columns(("nominal", *methods), dict(zip(OUTPUTS, rows, strict=True))))


OUTPUT_TABLES = (
    _output(
        5, "identification", STANDARD,
        (0.6154, 0.5487, 0.5513), (0.0813, 0.0789, 0.0789), (0.0683, 0.0669, 0.0670), (0.0486, 0.0457, 0.0457),
    ),
    _output(
        6, "identification", FILTERED,
        (0.4604, 0.3635, 0.3656), (0.0825, 0.0712, 0.0709), (0.0685, 0.0604, 0.0607), (0.0425, 0.0416, 0.0418),
    ),
    _output(
        7, "circle 1", STANDARD,
        (0.4620, 0.3981, 0.4042), (0.0859, 0.0834, 0.0833), (0.0748, 0.0730, 0.0729), (0.0537, 0.0545, 0.0546),
    ),
    _output(
        8, "circle 1", FILTERED,
        (0.3927, 0.3129, 0.3175), (0.0848, 0.0746, 0.0744), (0.0734, 0.0651, 0.0648), (0.0517, 0.0520, 0.0523),
    ),
    _output(
        9, "circle 2", STANDARD,
        (0.5348, 0.4971, 0.5035), (0.1193, 0.1162, 0.1161), (0.1002, 0.0980, 0.0979), (0.0555, 0.0549, 0.0549),
    ),
    _output(
        10, "circle 2", FILTERED,
        (0.4706, 0.4275, 0.4320), (0.1142, 0.1026, 0.1027), (0.0965, 0.0858, 0.0854), (0.0521, 0.0518, 0.0517),
    ),
    _output(
        11, "circle 3", STANDARD,
        (0.5411, 0.5122, 0.5191), (0.1236, 0.1213, 0.1214), (0.1258, 0.1227, 0.1225), (0.0589, 0.0586, 0.0587),
    ),
    _output(
        12, "circle 3", FILTERED,
        (0.4775, 0.4446, 0.4495), (0.1200, 0.1092, 0.1096), (0.1216, 0.1081, 0.1074), (0.0554, 0.0553, 0.0554),
    ),
)  # fmt: skip
"""RMS output prediction errors of the nominal set and two methods, 0 s to 50 s."""

CIRCLES = {"circle 1": (0.5, 1.0), "circle 2": (0.8, 0.9), "circle 3": (1.0, 1.0)}
"""Radius and altitude constant, m (section IV-C)."""
