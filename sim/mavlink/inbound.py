"""What a station may send: each message of the protocols to the part of the autopilot that answers it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from drivers.mavlink.geometry import flip, rotate
from sim.mavlink.airframe import Vector, euler
from sim.mavlink.control import NAN3, Setpoint
from sim.mavlink.outbox import Link, parameter_value
from sim.mavlink.parameters import Parameter
from sim.mavlink.wire import Message, mavlink, whole

if TYPE_CHECKING:
    from sim.mavlink.autopilot import Autopilot

_MISSION = frozenset(
    {"MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_REQUEST_LIST", "MISSION_REQUEST_INT", "MISSION_REQUEST",
     "MISSION_CLEAR_ALL", "MISSION_ACK"}
)  # fmt: skip
_VISION = frozenset({"VISION_POSITION_ESTIMATE", "ODOMETRY", "ATT_POS_MOCAP"})
_POSITION, _VELOCITY, _ACCELERATION, _YAW, _YAW_RATE = (1, 2, 4), (8, 16, 32), (64, 128, 256), 1024, 2048


def handle(a: Autopilot, link: Link, message: Message) -> None:
    """Answer one message."""
    if getattr(message, "target_system", 0) not in (0, a.SYSTEM) or message.get_srcSystem() == a.SYSTEM:
        return
    if getattr(message, "target_component", 0) not in (0, 1):
        return
    sender = (message.get_srcSystem(), message.get_srcComponent())
    name = message.get_type()
    if name == "HEARTBEAT":
        if message.type == mavlink.MAV_TYPE_GCS:
            link.heard_s = a.time_s
    elif name in ("COMMAND_LONG", "COMMAND_INT"):
        _command(a, link, message, sender)
    elif name == "SET_POSITION_TARGET_LOCAL_NED":
        _setpoint(a, message)
    elif name in _VISION:
        _vision(a, name, message)
    elif name == "TIMESYNC":
        _timesync(a, link, message)
    elif name == "PING" and message.target_system == 0:
        link.send(mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender))
    elif name.startswith("PARAM_"):
        _parameter(a, link, name, message, sender)
    elif name in _MISSION:
        replies, stored = a.mission.handle(message, sender)
        link.send(*replies)
        if stored:
            a.mission_stored(link)
    elif name == "FILE_TRANSFER_PROTOCOL":
        for payload in a.ftp.handle(bytes(message.payload)):
            link.send(mavlink.MAVLink_file_transfer_protocol_message(0, *sender, list(payload)))
    elif name == "SET_GPS_GLOBAL_ORIGIN":
        a.set_origin(message.altitude * 1e-3)
    elif name.startswith("LOG_"):
        _logs(a, name, message)


def _command(a: Autopilot, link: Link, message: Message, sender: tuple[int, int]) -> None:
    if message.get_type() == "COMMAND_LONG":
        p = [message.param1, message.param2, message.param3, message.param4, message.param5, message.param6]
    else:
        p = [message.param1, message.param2, message.param3, message.param4, message.x * 1e-7, message.y * 1e-7]
    p.append(message.param7 if message.get_type() == "COMMAND_LONG" else message.z)
    number = message.command
    if number == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
        result = _set_interval(a, link, whole(p[0]), whole(p[1]))
    elif number == mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
        asked = whole(p[0])
        interval = link.streams.interval_us(asked) or 0
        result = mavlink.MAV_RESULT_ACCEPTED if 0 <= asked < 1 << 16 else mavlink.MAV_RESULT_DENIED
        if result == mavlink.MAV_RESULT_ACCEPTED:
            link.send(mavlink.MAVLink_message_interval_message(asked, interval))
    elif number in (mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES):
        wanted = whole(p[0]) if number == mavlink.MAV_CMD_REQUEST_MESSAGE else mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
        return _request_message(a, link, number, wanted, sender)
    else:
        result = a.command(number, p, link, sender)
    if result is not None:
        link.send(mavlink.MAVLink_command_ack_message(number, result, 0, 0, *sender))


def _set_interval(a: Autopilot, link: Link, message_id: int, interval_us: int) -> int:
    refused = a.refuse_interval(message_id, interval_us)
    if refused is not None:
        return refused
    link.streams.set(message_id, interval_us)
    return mavlink.MAV_RESULT_ACCEPTED


def _request_message(a: Autopilot, link: Link, command: int, wanted: int, sender: tuple[int, int]) -> None:
    version = wanted == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    known = version or wanted in a.BUILDERS or wanted in (0, 1)
    result = mavlink.MAV_RESULT_ACCEPTED if known else mavlink.MAV_RESULT_DENIED
    link.send(mavlink.MAVLink_command_ack_message(command, result, 0, 0, *sender))
    if known:
        link.send(*([a.autopilot_version()] if version else a.build(wanted)))


def _masked(values: Vector, bits: tuple[int, int, int], mask: int) -> Vector:
    x, y, z = (math.nan if mask & bit or not math.isfinite(v) else v for v, bit in zip(values, bits, strict=True))
    return flip((x, y, z))


def setpoint_of(
    message: Message, estimate_position: Vector, quaternion: tuple[float, float, float, float]
) -> Setpoint | None:
    """The set-point of SET_POSITION_TARGET_LOCAL_NED in the house's frames; None for a frame nobody flies.

    MAV_FRAME_LOCAL_OFFSET_NED counts from the present position, MAV_FRAME_BODY_NED turns by the heading too.
    """
    m, mask = message, message.type_mask
    position = _masked((m.x, m.y, m.z), _POSITION, mask)
    velocity = _masked((m.vx, m.vy, m.vz), _VELOCITY, mask)
    acceleration = _masked((m.afx, m.afy, m.afz), _ACCELERATION, mask)
    yaw = math.nan if mask & _YAW or not math.isfinite(m.yaw) else -m.yaw
    yaw_rate = math.nan if mask & _YAW_RATE or not math.isfinite(m.yaw_rate) else -m.yaw_rate
    frame = m.coordinate_frame
    if frame == mavlink.MAV_FRAME_LOCAL_NED:
        return Setpoint(position, velocity, acceleration, yaw, yaw_rate)
    heading = euler(quaternion)[2]
    turn = (math.cos(heading / 2), 0.0, 0.0, math.sin(heading / 2))
    if frame in (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED):
        position, velocity, acceleration = (rotate(turn, v) for v in (position, velocity, acceleration))
        yaw += heading
    if frame in (mavlink.MAV_FRAME_LOCAL_OFFSET_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED):
        x, y, z = (p + e for p, e in zip(position, estimate_position, strict=True))
        return Setpoint((x, y, z), velocity, acceleration, yaw, yaw_rate)
    return Setpoint(NAN3, velocity, acceleration, yaw, yaw_rate) if frame == mavlink.MAV_FRAME_BODY_NED else None


def _setpoint(a: Autopilot, message: Message) -> None:
    setpoint = setpoint_of(message, a.estimate.position_m, a.estimate.quaternion)
    if setpoint is not None:
        a.follow(setpoint)


def _vision(a: Autopilot, name: str, m: Message) -> None:
    if not a.vision_accepted(name, m):
        return
    if name == "VISION_POSITION_ESTIMATE":
        stamp, yaw = m.usec, m.yaw
    else:
        w, x, y, z = m.q
        stamp, yaw = m.time_usec, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    if all(map(math.isfinite, (m.x, m.y, m.z, yaw))):
        x, y, z = flip((m.x, m.y, m.z))
        a.estimator.vision((x, y, z + a.vision_height_m), -yaw, a.own_time_s(stamp) - a.vision_delay_s)


def _timesync(a: Autopilot, link: Link, m: Message) -> None:
    if m.tc1 == 0:
        reply = (a.boot_us * 1000, m.ts1)
        link.send(mavlink.MAVLink_timesync_message(*reply))
    elif m.ts1 <= a.boot_us * 1000 < m.ts1 + 10**10:
        a.clock_offset_s = (m.tc1 - (m.ts1 + a.boot_us * 1000) / 2) * 1e-9


def _parameter(a: Autopilot, link: Link, name: str, m: Message, sender: tuple[int, int]) -> None:
    if name == "PARAM_REQUEST_LIST":
        a.parameters_requested(link)
    elif name == "PARAM_REQUEST_READ":
        by_name = m.param_index < 0
        index = a.parameters.index(m.param_id) if by_name else m.param_index
        if index is None or not 0 <= index < len(a.parameters):
            a.unknown_parameter(link, sender, m.param_id)
        else:
            link.send(parameter_value(a, index, shown=a.READ_BY_NAME_INDEX if by_name else None))
    elif name == "PARAM_SET":
        index = a.parameters.index(m.param_id)
        if index is None:
            a.unknown_parameter(link, sender, m.param_id)
            return
        parameter: Parameter = a.parameters.all[index]
        if a.accepts_parameter(link, sender, parameter, m.param_type) and a.parameters.holds(parameter, m):
            a.parameters[parameter.name] = a.parameters.from_wire(m.param_value, m.param_type)
            a.parameter_changed(parameter)
            link.send(parameter_value(a, index, shown=a.READ_BY_NAME_INDEX))


def _logs(a: Autopilot, name: str, m: Message) -> None:
    if name == "LOG_REQUEST_LIST":
        a.logs.request_list(m.start, m.end)
    elif name == "LOG_REQUEST_DATA":
        a.logs.request_data(m.id, m.ofs, m.count)
    elif name == "LOG_REQUEST_END":
        a.logs.stop()
    elif name == "LOG_ERASE":
        a.logs.erase()
