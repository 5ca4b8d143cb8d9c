"""``groundstation doctor --mocap`` and ``calibrate``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from groundstation.commands.common import ProgressLine, Result, example, json_option
from groundstation.errors import BadInput, Refused

if TYPE_CHECKING:
    from groundstation.flight.mocap_survey import SystemSurvey
    from groundstation.flight.station import Station

NOTHING_FOUND = """\
no motion-capture system answers. What each needs:
  OptiTrack  Motive: Data Streaming on, Local Interface not "loopback", rigid bodies on; UDP 1510 and 1511 open
  Qualisys   QTM: Real-Time Output on; TCP 22223 and UDP 22226 open
  Vicon      Tracker, Nexus, Shogun or Evoke running; name its PC with --host; TCP 801 open
  VRPN       name its PC with --host; TCP 3883 open
Nothing has to be installed here. To try without cameras: python -m sim.mocap --system natnet"""


def mocap_report(station: str, hosts: Sequence[str], seconds: float, link: str | None, vehicle: str | None) -> Result:
    """Find, watch and judge; with a link, also against the vehicle's accelerometer."""
    from drivers.mocap.discovery import Found, find
    from groundstation.flight.host_clock import host_time_sync
    from groundstation.flight.mocap_survey import survey, survey_all
    from groundstation.flight.station import load_station

    declared = load_station(station)
    mocap = declared.mocap
    line = ProgressLine()
    line.say("asking the network")
    named = [] if mocap.system == "none" else [mocap.host]
    found = [f for f in find([*hosts, *named]) if (f.system, f.host) != (mocap.system, mocap.host)]
    surveys = [] if not named else [survey(Found(mocap.system, mocap.host), seconds, mocap.body)]
    surveys += survey_all(found, seconds)
    against = [] if link is None else _against_vehicle(declared, link, vehicle, seconds, line)
    line.end()
    clocks = host_time_sync()
    document = {
        "schema": "groundstation.doctor_mocap/1",
        "systems": [each.document() for each in surveys],
        "vehicle": against,
        "host_clock": clocks,
    }
    lines = [text for each in surveys for text in _lines(each)] or [NOTHING_FOUND]
    lines += [f"vehicle: {text}" for text in against]
    lines += [f"this computer: {text}" for text in clocks] or [
        "this computer: neither chrony nor PTP nor timesyncd says that it keeps the clock"
    ]
    return Result(document, "\n".join(lines))


def _against_vehicle(station: Station, link: str, vehicle: str | None, seconds: float, line: ProgressLine) -> list[str]:
    """What gyro and accelerometer say of the poses."""
    from groundstation.flight.link.collect import collect
    from groundstation.flight.mocap_judging import upright
    from groundstation.identification.handheld import marker_axes, up_axis
    from groundstation.paths import find_config
    from groundstation.vehicle import load_vehicle

    if vehicle is None or station.mocap.system == "none":
        raise BadInput("--link needs --vehicle, and a --station with a [mocap] system.")
    declared = load_vehicle(find_config("vehicles", vehicle))
    try:
        both = collect(link, declared, station, max(seconds, 5.0), line.fraction)
        (t_imu, gyro, accel), (t_pose, _, quaternion) = both.imu, both.poses
        marker = marker_axes(t_imu, gyro, t_pose, quaternion)
        said = upright(up_axis(t_imu, accel, t_pose, quaternion, marker))
    except Refused as refusal:
        return [str(refusal)]
    return [said or "z points along gravity, and the poses turn as the gyro does"]


def _lines(each: SystemSurvey) -> list[str]:
    clock = "" if each.clock_error_s is None else f"; stamps known to {1e3 * each.clock_error_s:.2f} ms ({each.clock})"
    lines = [f"{each.found.system} at {each.found.host}: {each.server or 'no answer'}{clock}"]
    for name, s in each.bodies.items():
        if s is not None:
            residual = "" if s.residual_m != s.residual_m else f", residual {1e3 * s.residual_m:.2f} mm"
            lines.append(
                f"  {name}: {s.rate_hz:.0f} Hz, latency {1e3 * s.latency_p50_s:.1f} ms (p99 "
                f"{1e3 * s.latency_p99_s:.1f}), "
                f"jitter {1e6 * s.jitter_s:.0f} us, {s.missing} frames missing, unseen {100 * s.unseen:.1f} %{residual}"
            )
    return lines + [f"  -> {text}" for text in each.faults]


@click.command(
    epilog=example("groundstation calibrate --link udpin://127.0.0.1:14540 --vehicle x500 --station lab.toml")
)
@click.option("--link", required=True, help="serial:///dev/ttyUSB0:921600, udpin://127.0.0.1:14540, tcp://host:port.")
@click.option("--vehicle", required=True, help="Vehicle file, or the name of a shipped one.")
@click.option("--station", required=True, help="Your station file, with its [mocap] section; it is written to.")
@click.option(
    "--seconds", type=click.FloatRange(10.0, 300.0), default=30.0, show_default=True, help="How long to carry it."
)
@click.option("--key-file", type=click.Path(path_type=Path, dir_okay=False), help="32-byte MAVLink signing key.")
@click.option("--yes", is_flag=True, help="Write without asking.")
@json_option
def calibrate(link: str, vehicle: str, station: str, seconds: float, key_file: Path | None, yes: bool) -> Result:
    """Measure how the marker body sits on the IMU: carry the vehicle for half a minute, rotors off, and turn it about
    all axes.

    Offset, rotation, the world's tilt and scale, and the delay of the stamps go into the station file. Every flight
    after uses them, and every preflight checks them again.
    """
    from groundstation.flight.calibration import calibration_of, result_text, section, write_calibration
    from groundstation.flight.link.collect import collect
    from groundstation.flight.station import load_station
    from groundstation.identification.handheld import calibrate_by_hand
    from groundstation.paths import find_config
    from groundstation.vehicle import load_vehicle

    path, declared = find_config("stations", station), load_vehicle(find_config("vehicles", vehicle))
    loaded = load_station(path)
    if loaded.mocap.system == "none":
        raise BadInput(f"{path}: names no motion capture; fill in its [mocap] section first.")
    line = ProgressLine()
    try:
        both = collect(link, declared, loaded, seconds, line.fraction, key_file=key_file)
    except ConnectionError as error:
        raise BadInput(str(error)) from None
    finally:
        line.end()
    found = calibrate_by_hand(both.imu, both.poses, expected_s=0.0, gravity_m_s2=declared.gravity_m_s2)
    calibration = calibration_of(found, loaded, both.clock_error_s)
    text = result_text(found, calibration)
    write = yes or (sys.stdin.isatty() and click.confirm(f"{text}\nWrite this to {path}?", default=False, err=True))
    if write:
        write_calibration(path, calibration)
    state = f"written to {path}" if write else f"not written; the section would be:\n{section(calibration)}"
    document = {"schema": "groundstation.calibration/1", "written": write, **calibration.model_dump()}
    return Result(document, f"{text}\n{state}" if yes or not write else state)
