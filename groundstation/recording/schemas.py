"""Message schemas of a recording, as ROS 2 interface definitions (``ros2msg``), and the topics that carry them.

Standard types where one exists, so that Foxglove, PlotJuggler and ROS tools open a recording as it is. Ours carry the
exact times as ``float64`` beside the header. See ``docs/formats.md``.
"""

from __future__ import annotations

from dataclasses import dataclass

_SEPARATOR = "\n" + "=" * 80 + "\n"
_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec"
_HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
_POINT = "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z"
_VECTOR3 = "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z"
_QUATERNION = "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w"
_POSE = "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation"
_TIMES = """\
std_msgs/Header header          # stamp: device time, rounded to nanoseconds
float64 device_s                # device time, exact
float64 received_s              # arrival on the host's monotonic clock, exact; NaN where it is not known
"""


def _definition(body: str, *parts: str) -> str:
    return _SEPARATOR.join((body.strip(), *parts))


IMU = _definition(
    """\
std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
""",
    *(_HEADER, _TIME, _QUATERNION, _VECTOR3),
)
POSE_STAMPED = _definition(
    "std_msgs/Header header\ngeometry_msgs/Pose pose", _HEADER, _TIME, _POSE, _POINT, _QUATERNION
)
BATTERY_STATE = _definition(
    """\
std_msgs/Header header
float32 voltage
float32 temperature
float32 current
float32 charge
float32 capacity
float32 design_capacity
float32 percentage
uint8 power_supply_status
uint8 power_supply_health
uint8 power_supply_technology
bool present
float32[] cell_voltage
float32[] cell_temperature
string location
string serial_number
""",
    *(_HEADER, _TIME),
)
MOTORS = _definition(
    _TIMES
    + """\
uint8 ROTOR_SPEED=0             # rad/s, one value per rotor
uint8 COMMAND=1                 # normalised 0..1, one value per rotor
uint8 WRENCH=2                  # force_z_n, torque_x_nm, torque_y_nm, torque_z_nm
uint8 kind
float64[] values
""",
    *(_HEADER, _TIME),
)
SETPOINT = _definition(
    _TIMES + "geometry_msgs/Point position            # world, z up\nfloat64 yaw\n", _HEADER, _TIME, _POINT
)
STATE = _definition(
    _TIMES
    + """\
geometry_msgs/Pose pose         # in the world, z up; rotates body (FLU) into world
geometry_msgs/Vector3 velocity  # in the world
geometry_msgs/Vector3 rate      # in the body
""",
    *(_HEADER, _TIME, _POSE, _POINT, _QUATERNION, _VECTOR3),
)
EVENT = _definition(_TIMES + "string kind\nstring text\n", _HEADER, _TIME)
RAW = _definition(
    _TIMES
    + """\
uint8 IN=0                      # from the vehicle
uint8 OUT=1                     # to the vehicle
uint8 direction
uint8[] data                    # one MAVLink frame as it was on the wire
""",
    *(_HEADER, _TIME),
)
STATUS = _definition(_TIMES + "string phase\nbool armed\nstring text\n", _HEADER, _TIME)
ROW = _definition(
    _TIMES
    + """\
float64[] values                # the channel's metadata names them: "numbers", a JSON list
string[] texts                  # the channel's metadata names them: "texts", a JSON list
""",
    *(_HEADER, _TIME),
)
EXACT = """\
# What the standard message that follows it (same sequence number, topic without "/exact") had to round.
float64 device_s
float64 received_s              # NaN where it is not known
float64[] values                # battery: voltage, current
"""


@dataclass(frozen=True, slots=True)
class Topic:
    """Where one kind of sample is recorded, and as what."""

    name: str
    type: str
    definition: str


TOPICS = {
    "imu": Topic("/imu", "sensor_msgs/msg/Imu", IMU),
    "mocap": Topic("/mocap", "geometry_msgs/msg/PoseStamped", POSE_STAMPED),
    "battery": Topic("/battery", "sensor_msgs/msg/BatteryState", BATTERY_STATE),
    "motors": Topic("/motors", "groundstation_msgs/msg/Motors", MOTORS),
    "setpoint": Topic("/setpoint", "groundstation_msgs/msg/Setpoint", SETPOINT),
    "state": Topic("/state", "groundstation_msgs/msg/State", STATE),
    "events": Topic("/events", "groundstation_msgs/msg/Event", EVENT),
    "raw": Topic("/mavlink/raw", "groundstation_msgs/msg/Raw", RAW),
    "status": Topic("/status", "groundstation_msgs/msg/Status", STATUS),
}
"""Canonical topic of each stream; what else a recording holds lies on topics of the same types under other names."""

ROW_TYPE = "groundstation_msgs/msg/Row"
EXACT_TYPE = "groundstation_msgs/msg/Exact"
STREAM_OF_TYPE = {topic.type: stream for stream, topic in TOPICS.items()}
