"""From a calibration by hand to the station file's section, and its words."""

from __future__ import annotations

import re
from datetime import date
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.mocap.session import SYSTEMS
from groundstation.errors import BadInput
from groundstation.flight.station import MarkerCalibration, Station, station_from_dict
from groundstation.identification.handheld import HandCalibration
from groundstation.outside import parse_toml, read_bytes
from groundstation.paths import configs_dir
from groundstation.writing import write_whole

Array = NDArray[np.float64]
_SECTION = re.compile(r"^\[mocap\.calibration\][^\n]*\n(?:(?!\[)[^\n]*\n?)*", re.M)
_LATENCY = re.compile(r"^([ \t]*latency_s[ \t]*=[ \t]*)[0-9.eE+-]+", re.M)
SURELY = 3.0
"""Standard deviations beyond which a scale is applied: less is the accelerometer's own."""
DOCUMENT_BYTES = 1 << 20


def calibration_of(
    found: HandCalibration, station: Station, clock_error_s: float, today: date | None = None
) -> MarkerCalibration:
    """What is written: a scale only where it is surely none, a delay on top of what the system's stamps have untold.

    Args:
        clock_error_s: of the vehicle's clock, by which the IMU was dated.
    """
    delay_s = SYSTEMS[station.mocap.system].delay.seconds + found.mocap_minus_imu_s
    return MarkerCalibration(
        body=station.mocap.body,
        measured=(today or date.today()).isoformat(),
        position_m=_rounded(found.position_m, 5), position_std_m=_rounded(found.position_std_m, 6),
        rotation_rad=_rounded(found.rotation_rad, 5), rotation_std_rad=_rounded(found.rotation_std_rad, 6),
        tilt_rad=(round(float(found.tilt_rad[0]), 5), round(float(found.tilt_rad[1]), 5)),
        scale=round(found.scale, 4) if abs(found.scale) > SURELY * found.scale_std else 0.0,
        delay_s=round(max(-0.2, min(0.2, delay_s)), 6),
        delay_std_s=round(float(np.hypot(found.clock_std_s, clock_error_s)), 6),
    )  # fmt: skip


def _rounded(values: Array, digits: int) -> tuple[float, float, float]:
    x, y, z = (round(float(v), digits) for v in values)
    return (x, y, z)


def section(calibration: MarkerCalibration) -> str:
    """The section of a station file."""
    lines = ["[mocap.calibration]       # by `groundstation calibrate`"]
    for name, value in calibration.model_dump().items():
        text = f'"{value}"' if isinstance(value, str) else str(list(value)) if isinstance(value, tuple) else repr(value)
        lines.append(f"{name} = {text}")
    return "\n".join(lines) + "\n"


def write_calibration(path: Path, calibration: MarkerCalibration) -> None:
    """Put the section into a station file, in the place of an older one. ``latency_s``, which it replaces, becomes 0;
    all else stays as it is.

    Raises:
        BadInput: it is a shipped file, cannot be written, or would not be valid.
    """
    if path.resolve().is_relative_to(configs_dir().resolve()):
        raise BadInput(f"{path}: is a shipped file; copy it, and give your copy with --station.")
    text = read_bytes(path, "a station file", DOCUMENT_BYTES).decode("utf-8", "replace")
    rest = _LATENCY.sub(r"\g<1>0.0", _SECTION.sub("", text)).rstrip("\n")
    changed = f"{rest}\n\n{section(calibration)}"
    station_from_dict(parse_toml(changed.encode(), str(path)), str(path))
    try:
        write_whole(path, changed)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); give a station file of your own.") from None


def result_text(found: HandCalibration, calibration: MarkerCalibration) -> str:
    """For people: value, 95 % half width, and what to make of it."""
    lines = [
        f"measured over {found.seconds:.0f} s, carried {found.moved_m:.2f} m rms, turned by up to "
        f"{np.degrees(found.turned_rad):.0f} degrees"
    ]
    for name, values, std, factor, unit in (
        ("offset", found.position_m, found.position_std_m, 1e3, "mm"),
        ("rotation", found.rotation_rad, found.rotation_std_rad, 180.0 / np.pi, "degrees"),
        ("tilt", found.tilt_rad, found.tilt_std_rad, 180.0 / np.pi, "degrees"),
    ):
        each = zip("xyz", values, std, strict=False)
        lines.append(
            f"{name:<9} "
            + ", ".join(f"{a} {factor * v:.2f} +- {1.96 * factor * s:.2f}" for a, v, s in each)
            + f" {unit}"
        )
    lines.append(
        f"scale     {1.0 + found.scale:.4f} +- {1.96 * found.scale_std:.4f}"
        + ("" if calibration.scale else ", left at 1")
    )
    lines.append(
        f"delay     {1e3 * calibration.delay_s:.2f} +- {1.96e3 * calibration.delay_std_s:.2f} ms of stamps after the "
        "exposure; taken off them, so latency_s is 0"
    )
    lines.append(f"noise     {1e3 * found.residual_m:.2f} mm, {np.degrees(found.residual_rad):.2f} degrees")
    return "\n".join(lines)
