"""The trajectory on its way to the vehicle: on board where the autopilot can fly it, else as setpoints from the link.

On board means our script and the plan's coefficients in ArduCopter's scripts folder, each confirmed by its checksum.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import cos, sin
from pathlib import Path
from typing import Literal

import numpy as np

from drivers.mavlink.exchange import Steps
from drivers.mavlink.ftp import Ftp
from groundstation.flight.placement import Placement
from groundstation.flight.profiles import Profile
from groundstation.trajectory import FourierSeries

SCRIPT = Path(__file__).with_name("profiles") / "excitation.lua"
FOLDER = "scripts"


@dataclass(frozen=True, slots=True)
class Way:
    """How the trajectory is flown, and why so."""

    kind: Literal["onboard", "setpoints"]
    why: str


def choose_way(profile: Profile, parameters: Mapping[str, float | None], *, onboard: bool) -> Way:
    """On board only where it is asked for and can be; setpoints fly on every autopilot."""
    if not onboard:
        return Way("setpoints", "setpoints from the link process: every autopilot follows them")
    if profile.name != "arducopter":
        return Way("setpoints", f"{profile.name} flies no script of ours; setpoints from the link process")
    if parameters.get("SCR_ENABLE") != 1.0:
        return Way("setpoints", "scripting is off (SCR_ENABLE 1 and a restart switch it on); setpoints instead")
    return Way("onboard", "our script flies it at the autopilot's own rate; no radio in the loop")


def coefficients_text(series: FourierSeries, placement: Placement) -> str:
    """What the script reads: the series in NED, moved and turned to where the vehicle stands.

    The rotation about the vertical and the change to NED are linear, so they act on the coefficients themselves.
    """
    c, s = cos(placement.yaw_rad), sin(placement.yaw_rad)
    to_vehicle = np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    to_ned = np.diag([1.0, -1.0, -1.0, -1.0])
    a, b = to_ned @ to_vehicle @ series.a, to_ned @ to_vehicle @ series.b
    origin = np.array([*placement.origin_m, placement.yaw_rad])
    offset = to_ned @ (to_vehicle @ series.c + origin)
    numbers = [series.a.shape[1], series.base_frequency_rad_s, series.duration_s, *(to_ned @ origin)]
    for row in range(4):
        numbers.append(offset[row])
        numbers += [value for pair in zip(a[row], b[row], strict=True) for value in pair]
    return "\n".join(f"{number:.9g}" for number in numbers) + "\n"


def send_onboard(profile: Profile, series: FourierSeries, placement: Placement) -> Steps[None]:
    """Script and coefficients by MAVLink FTP, each confirmed by its checksum.

    Raises:
        drivers.mavlink.ftp.FtpError: refused, or damaged on the way.
    """
    ftp = Ftp(profile.system, profile.component)
    yield from ftp.make_folder(FOLDER)
    yield from ftp.write(f"{FOLDER}/excitation.lua", SCRIPT.read_bytes())
    yield from ftp.write(f"{FOLDER}/excitation.txt", coefficients_text(series, placement).encode())
