"""Nothing a station can send brings the emulated autopilots down."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import MESSAGES, mavlink
from sim.mavlink.arducopter import ArduCopter
from sim.mavlink.px4 import Px4
from tests.emulated import RigidAirframe, Station, quadrotor

INBOUND = (
    *(
        "HEARTBEAT",
        "COMMAND_LONG",
        "COMMAND_INT",
        "SET_POSITION_TARGET_LOCAL_NED",
        "VISION_POSITION_ESTIMATE",
        "ODOMETRY",
    ),
    *("TIMESYNC", "PING", "PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET", "MISSION_COUNT", "MISSION_ITEM_INT"),
    *("MISSION_REQUEST_LIST", "MISSION_REQUEST_INT", "MISSION_CLEAR_ALL", "FILE_TRANSFER_PROTOCOL", "LOG_REQUEST_LIST"),
    *("LOG_REQUEST_DATA", "LOG_REQUEST_END", "LOG_ERASE", "SET_GPS_GLOBAL_ORIGIN", "ATT_POS_MOCAP"),
)
BY_NAME = {kind.msgname: kind for kind in MESSAGES.values()}
COMMANDS = (16, 20, 21, 22, 115, 176, 178, 179, 185, 192, 241, 245, 246, 400, 510, 511, 512, 519, 520, 60000)
FLOATS = st.one_of(
    st.floats(width=32), st.sampled_from([0.0, 1.0, math.nan, math.inf, -math.inf, 3.0e38, 21196.0, 31.0, 105.0])
)
RANGES = {"uint8_t": (0, 255), "int8_t": (-128, 127), "uint16_t": (0, 65535), "int16_t": (-32768, 32767),
          "uint32_t": (0, 2**32 - 1), "int32_t": (-(2**31), 2**31 - 1), "uint64_t": (0, 2**64 - 1),
          "int64_t": (-(2**63), 2**63 - 1)}  # fmt: skip


@st.composite
def messages(draw):
    """A message of the protocols with any content at all, addressed to the vehicle more often than not."""
    kind = BY_NAME[draw(st.sampled_from(INBOUND))]
    values = []
    lengths = [kind.array_lengths[kind.ordered_fieldnames.index(name)] for name in kind.fieldnames]
    for name, type_name, length in zip(kind.fieldnames, kind.fieldtypes, lengths, strict=True):
        if type_name == "char":
            values.append(
                draw(
                    st.sampled_from(
                        [b"NAV_DLL_ACT", b"FS_GCS_ENABLE", b"EKF2_HGT_REF", b"\xff\xfe", b"", b"IMU_INTEG_RATE"]
                    )
                )
            )
            continue
        element = FLOATS if type_name in ("float", "double") else st.integers(*RANGES[type_name])
        if name in ("target_system", "target_component"):
            element = st.sampled_from([1, 1, 1, 0, 7])
        elif name == "command":
            element = st.sampled_from(COMMANDS)
        values.append(draw(st.lists(element, min_size=length, max_size=length)) if length else draw(element))
    return kind(*values)


@pytest.mark.parametrize("kind", [Px4, ArduCopter])
@settings(max_examples=25, deadline=None)
@given(sent=st.lists(messages(), min_size=1, max_size=12), noise=st.binary(max_size=300))
def test_any_message_and_any_noise_leave_it_running(kind, sent, noise):
    vehicle = quadrotor()
    s = Station(kind(vehicle, RigidAirframe(vehicle), boot_s=60.0), step_s=0.01)
    s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    codec = MavlinkCodec()
    for message in sent:
        s._outgoing.append(codec.encode(message))
        s.run(0.02)
    s._outgoing.append(noise)
    s.run(0.1)
    before = len(s.named("HEARTBEAT"))
    s.run(1.3)
    assert len(s.named("HEARTBEAT")) > before
    position = s.autopilot.truth.position_m
    assert all(math.isfinite(p) for p in position)


@pytest.mark.parametrize("kind", [Px4, ArduCopter])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 3.0e38])
def test_every_command_survives_numbers_that_are_none(kind, value):
    vehicle = quadrotor()
    s = Station(kind(vehicle, RigidAirframe(vehicle), boot_s=60.0), step_s=0.01)
    for number in COMMANDS:
        s.send(mavlink.MAVLink_command_long_message(1, 1, number, 0, *([value] * 7)))
        s.run(0.02)
    s.run(1.2)
    assert not s.autopilot.armed
    assert s.named("HEARTBEAT", s.now_s - 1.2)
