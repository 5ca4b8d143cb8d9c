"""The trajectory on its way to the vehicle: on board where the autopilot can fly it, else as setpoints from the link.

On board means our script and the plan's coefficients in the autopilot's scripts folder, each confirmed by its checksum.
The script goes up while the link prepares, the coefficients with each plan; where the plan lies is told at the start
(:mod:`groundstation.flight.link.onboard`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.exchange import Ask, Steps, listen
from drivers.mavlink.ftp import Ftp, FtpError, checksum
from groundstation.flight import timeouts
from groundstation.flight.link.onboard import REPORT, is_report
from groundstation.flight.link.profiles import Profile
from groundstation.flight.messages import WAY
from groundstation.flight.station import Policy
from groundstation.trajectory import FourierSeries

SCRIPT = Path(__file__).with_name("profiles") / "excitation.lua"
COEFFICIENTS = "excitation.txt"
FOLDERS = ("APM/scripts", "scripts")
"""On a flight controller's card, and in the simulation."""


@dataclass(frozen=True, slots=True)
class Way:
    """How the trajectory is flown, and why so; on board also the folder of the script."""

    kind: Literal["onboard", "setpoints"]
    why: str
    folder: str = ""

    def __str__(self) -> str:
        how = "on board" if self.kind == "onboard" else "by setpoints from the link"
        return f"{WAY}{how}: {self.why}"


def choose_way(profile: Profile, policy: Policy, parameters: Mapping[str, float | None]) -> Steps[Way]:
    """On board where the autopilot runs scripts and takes ours; setpoints fly on every autopilot."""
    if policy.trajectory == "setpoints":
        return Way("setpoints", "the station file asks for it")
    if not profile.scripting:
        return Way("setpoints", f"{profile.name} flies no script of ours")
    if parameters.get(profile.scripting) != 1.0:
        return Way("setpoints", f"scripting is off ({profile.scripting} 1 and a restart switch it on)")
    try:
        folder = yield from send_script(profile)
    except FtpError as error:
        return Way("setpoints", f"our script cannot be used: {error}")
    return Way(
        "onboard",
        "our script does it at the autopilot's own rate, without a radio in the loop; confirmed by checksum",
        folder,
    )


def coefficients_text(series: FourierSeries) -> str:
    """What the script reads: the series in the plan's own frame, with y and z turned round (north, east, down,
    heading).
    """
    to_ned = np.array([1.0, -1.0, -1.0, -1.0])
    numbers: list[float] = [series.a.shape[1], series.base_frequency_rad_s, series.duration_s]
    for sign, a, b, c in zip(to_ned, series.a, series.b, series.c, strict=True):
        numbers.append(sign * c)
        numbers += [sign * value for pair in zip(a, b, strict=True) for value in pair]
    return "\n".join(f"{number:.9g}" for number in numbers) + "\n"


def send_script(profile: Profile) -> Steps[str]:
    """Have our script run on the vehicle; the folder it is in.

    Raises:
        drivers.mavlink.ftp.FtpError: refused, damaged on the way, or nothing was heard of the script afterwards.
    """
    ftp, content = Ftp(profile.system, profile.component), SCRIPT.read_bytes()
    folder = yield from _folder(ftp)
    name = f"{folder}/{SCRIPT.name}"
    try:
        same = (yield from ftp.crc(name)) == checksum(content)
    except FtpError:
        same = False
    if not same:
        yield from ftp.write(name, content)
    elif (yield listen(is_report, 1.5)) is not None:
        return folder
    restart = profile.command(mavlink.MAV_CMD_SCRIPTING, float(mavlink.SCRIPTING_CMD_STOP_AND_RESTART))
    ack = yield Ask((restart,), _acknowledges_scripting, 1.0, 3)
    if ack is None or ack.result != mavlink.MAV_RESULT_ACCEPTED:
        raise FtpError("the vehicle does not restart its scripts; restart the vehicle")
    if (yield listen(is_report, timeouts.SCRIPT_HEARD_S)) is None:
        raise FtpError(
            f"the script is on board, but its report {REPORT} was not heard within {timeouts.SCRIPT_HEARD_S:g} s"
        )
    return folder


def send_coefficients(profile: Profile, folder: str, series: FourierSeries) -> Steps[None]:
    """The plan's coefficients beside the script, confirmed by their checksum.

    Raises:
        drivers.mavlink.ftp.FtpError: refused, or damaged on the way.
    """
    ftp = Ftp(profile.system, profile.component)
    yield from ftp.write(f"{folder}/{COEFFICIENTS}", coefficients_text(series).encode())


def _folder(ftp: Ftp) -> Steps[str]:
    for folder in FOLDERS:
        try:
            yield from ftp.list(folder)
        except FtpError:
            continue
        return folder
    yield from ftp.make_folder(FOLDERS[-1])
    return FOLDERS[-1]


def _acknowledges_scripting(m: Message) -> bool:
    return m.get_type() == "COMMAND_ACK" and m.command == mavlink.MAV_CMD_SCRIPTING
