"""Motion capture at the link: the process's wire form, frames told apart before take-off, a marker body that moved."""

# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalOperand=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false,
# reportOperatorIssue=false
from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mavlink.dialect import mavlink
from drivers.mocap.source import FrameReader, frame
from drivers.samples import Pose, State
from groundstation.flight.link.preflight import compare_frames
from groundstation.flight.link.profiles import PROFILES

LEVEL = (1.0, 0.0, 0.0, 0.0)


@given(st.integers(1, 90))
@settings(max_examples=20, deadline=None)
def test_poses_cross_the_pipe_in_any_portions(portion):
    poses = [Pose(float(n), (n, 2.0, 3.0), LEVEL) for n in range(5)]
    data = b"".join(frame(pose, pose.device_s + 0.5, n) for n, pose in enumerate(poses))
    reader = FrameReader()
    got = [entry for i in range(0, len(data), portion) for entry in reader.feed(data[i : i + portion])]
    assert got == [(pose, pose.device_s + 0.5) for pose in poses]


def carried(matrix) -> list[tuple[State, Pose]]:
    """A hand-carried loop as the estimator and a motion capture with other axes see it."""
    out = []
    for t in np.linspace(0.0, 6.0, 60):
        p = np.array([0.5 * np.sin(t), 0.4 * np.sin(2 * t), 0.2 + 0.2 * np.cos(t)])
        state = State(float(t), tuple(p + 3.0), (0.0, 0.0, 0.0), LEVEL, (0.0, 0.0, 0.0))
        out.append((state, Pose(float(t), tuple(np.asarray(matrix) @ p), LEVEL)))
    return out


def test_equal_frames_pass_whatever_their_origins():
    assert compare_frames(carried(np.eye(3))).ok


@pytest.mark.parametrize(
    "matrix",
    [[[0, 1, 0], [1, 0, 0], [0, 0, 1]], [[1, 0, 0], [0, -1, 0], [0, 0, 1]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]]],
    ids=["x and y swapped", "y mirrored", "y up"],
)
def test_swapped_mirrored_and_tilted_axes_are_caught_and_the_map_is_shown(matrix):
    check = compare_frames(carried(matrix))
    assert not check.ok
    assert "best map" in check.reason


def test_too_little_motion_says_nothing_about_frames():
    still = [
        (State(float(n), (0, 0, 0), (0, 0, 0), LEVEL, (0, 0, 0)), Pose(float(n), (0, 0, 0), LEVEL)) for n in range(9)
    ]
    assert compare_frames(still) is None


@pytest.mark.parametrize("name", PROFILES)
def test_a_pose_for_the_vehicle_turns_left_and_up_into_right_and_down(name):
    yaw = 0.6
    pose = Pose(12.5, (1.0, 2.0, 3.0), (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))))
    (message,) = PROFILES[name]().external_pose(pose, 12.5, 0.01, 0.02, 3)
    assert (message.x, message.y, message.z) == (1.0, -2.0, -3.0)
    if name == "px4":
        assert message.time_usec == 12_500_000
        assert message.estimator_type == mavlink.MAV_ESTIMATOR_TYPE_VISION, "PX4 does not fuse MOCAP"
        np.testing.assert_allclose(message.q, [np.cos(0.3), 0, 0, -np.sin(0.3)])
    else:
        assert message.usec == 12_500_000
        assert message.yaw == pytest.approx(-yaw)
    covariance = message.pose_covariance if name == "px4" else message.covariance
    assert covariance[0] == pytest.approx(1e-4)
    assert covariance[20] == pytest.approx(4e-4)
