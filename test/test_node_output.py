"""What the node makes of an estimate: a frame that never jumps, a prediction to now, messages."""
from __future__ import annotations

import sys
import types

import numpy as np
import pytest
import ros_support  # noqa: F401  a ROS domain for the tests
from scipy.spatial.transform import Rotation

from mems_ins_fusion.nodes.output import MapOutput, Output, Prediction, SmoothFrame, VehicleAxes, flatten

DT = 10_000_000  # ns


class Estimate:
    """A filter's newest estimate, set by the test."""

    def __init__(self):
        self.odometry, self.geodetic, self.position_covariance_enu = np.zeros(85), np.zeros(3), np.zeros(9)
        self.odometry[7:43] = np.diag([1.0, 1.0, 4.0, 0.01, 0.01, 0.04]).ravel()
        self.odometry[49:85] = np.diag([0.04, 0.04, 0.25, 1e-4, 1e-4, 1e-4]).ravel()

    def set(self, position, attitude: Rotation, velocity, rate):
        self.odometry[:3], self.odometry[3:7] = position, attitude.as_quat()
        self.odometry[43:46], self.odometry[46:49] = velocity, rate


def driven(estimate, smooth, jump=(0.0, 0.0, 0.0), turn=0.0, at=500, steps=1000):
    """A bend driven at 10 m/s whose estimate jumps by `jump` (m) and `turn` (rad) at one step: smooth poses (k, 7)."""
    poses, position, yaw = [], np.zeros(3), 0.4
    for k in range(steps):
        rate = 0.2 if k > 100 else 0.0
        middle, yaw = Rotation.from_euler('ZYX', [yaw + 0.005 * rate, 0.03, -0.02]), yaw + 0.01 * rate
        position = position + 0.01 * middle.apply([10.0, 0.0, 0.0])
        if k == at:
            position, yaw = position + jump, yaw + turn
        attitude = Rotation.from_euler('ZYX', [yaw, 0.03, -0.02])
        estimate.set(position, attitude, (10.0, 0.0, 0.0), attitude.inv().apply([0.0, 0.0, rate]))
        smooth.advance(k * DT)
        poses.append(smooth.odometry[:7].copy())
    return np.array(poses)


def transform(pose):
    """(7,) position and quaternion as a 4 x 4 matrix."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(pose[3:7]).as_matrix(), pose[:3]
    return matrix


def test_the_smooth_frame_follows_but_never_jumps_where_the_estimate_does():
    # given an estimate that a fix moves by metres and degrees
    estimate = Estimate()
    smooth = SmoothFrame(estimate)
    jumping = driven(estimate, smooth, jump=(5.0, -3.0, 1.0), turn=0.2)
    # then no step is longer than 10 m/s allow, and no turn faster than the vehicle's
    step = np.linalg.norm(np.diff(jumping[:, :3], axis=0), axis=1)
    assert step.max() < 0.1 * 1.001
    turned = (Rotation.from_quat(jumping[1:, 3:]) * Rotation.from_quat(jumping[:-1, 3:]).inv()).magnitude()
    assert turned.max() < 0.01 * 0.2 * 1.2
    # and the frame's own pose takes up the rest: together they are the estimate
    together = transform(np.array(smooth.frame)) @ transform(jumping[-1])
    assert together == pytest.approx(transform(estimate.odometry), abs=1e-9)
    moved = np.array(smooth.frame)
    assert abs(moved[:3]).max() > 1.0


def test_without_corrections_both_frames_stay_the_same():
    estimate = Estimate()
    smooth = SmoothFrame(estimate)
    poses = driven(estimate, smooth)
    assert poses[-1, :3] == pytest.approx(estimate.odometry[:3], abs=0.02)
    assert np.array(smooth.frame) == pytest.approx([0, 0, 0, 0, 0, 0, 1], abs=2e-3)


def test_the_smooth_frame_stays_level_and_its_covariance_knows_its_drift():
    # given an estimate whose roll is corrected by 0.1 rad, and which is moved by 5 m
    estimate = Estimate()
    smooth = SmoothFrame(estimate)
    estimate.set((0, 0, 0), Rotation.identity(), (0, 0, 0), (0, 0, 0))
    smooth.advance(0)
    estimate.set((5, 0, 0), Rotation.from_euler('x', 0.1), (0, 0, 0), (0, 0, 0))
    rolls = []
    for k in range(1, 1001):
        smooth.advance(k * DT)
        rolls.append(Rotation.from_quat(smooth.odometry[3:7]).as_euler('ZYX')[2])
    assert rolls[0] < 0.001 and np.all(np.diff(rolls) >= 0) and rolls[-1] == pytest.approx(0.1, abs=0.001)
    p = smooth.odometry[7:43].reshape(6, 6)
    assert p == pytest.approx(p.T) and np.linalg.eigvalsh(p).min() > 0
    assert p[0, 0] == pytest.approx(1.0 + 25.0) and p[1, 1] == pytest.approx(1.0)


def test_a_restart_of_the_filter_leaves_the_smooth_frame_where_it_is():
    estimate = Estimate()
    smooth = SmoothFrame(estimate)
    driven(estimate, smooth)
    before = smooth.odometry[:7].copy()
    estimate.set((900, 0, 0), Rotation.identity(), (10, 0, 0), (0, 0, 0))
    smooth.advance(1000 * DT + 60 * 10**9)  # a minute without an estimate
    assert smooth.odometry[:3] == pytest.approx(before[:3])


def test_a_heading_that_is_found_turns_the_smooth_frame_and_not_the_vehicle_in_it():
    # given a parked vehicle whose heading nobody knows, and fixes that move it
    estimate = Estimate()
    smooth = SmoothFrame(estimate)
    poses = []
    for k, north in enumerate((0.0, 2.0, -1.0)):
        estimate.set((0, north, 0), Rotation.identity(), (0, 0, 0), (0, 0, 0))
        smooth.advance(k * DT)
        smooth.settle()
        poses.append(smooth.odometry[:7].copy())
    # when it is found
    estimate.set((0, -1.0, 0), Rotation.from_euler('z', 2.0), (0, 0, 0), (0, 0, 0))
    smooth.advance(3 * DT)
    smooth.settle()
    estimate.set((0.5, -1.0, 0), Rotation.from_euler('z', 2.1), (0, 0, 0), (0, 0, 0))
    smooth.advance(4 * DT)
    # then it has not moved in the smooth frame, the two together are the estimate, and the drift is that since then
    assert np.ptp([*poses, smooth.odometry[:7]], axis=0) == pytest.approx(np.zeros(7))
    assert transform(np.array(smooth.frame)) @ transform(smooth.odometry) == pytest.approx(transform(estimate.odometry))
    p = smooth.odometry[7:43].reshape(6, 6)
    assert np.trace(p[:2, :2]) == pytest.approx(np.trace(estimate.odometry[7:43].reshape(6, 6)[:2, :2]) + 0.25)
    assert p[5, 5] == pytest.approx(estimate.odometry[42] + 0.01)


def test_the_prediction_moves_the_pose_along_its_own_velocity():
    # given 10 m/s and a turn, 50 ms old
    estimate = Estimate()
    attitude = Rotation.from_euler('ZYX', [1.1, 0.1, -0.05])
    estimate.set((3.0, 4.0, 5.0), attitude, (10.0, 0.5, -0.2), (0.01, -0.02, 0.3))
    estimate.geodetic[:] = 0.8, 0.2, 100.0
    prediction = Prediction(estimate)
    prediction.advance(0.05)
    moved = 0.05 * attitude.apply([10.0, 0.5, -0.2])
    assert prediction.odometry[:3] == pytest.approx(np.array([3.0, 4.0, 5.0]) + moved)
    turned = attitude * Rotation.from_rotvec(0.05 * np.array([0.01, -0.02, 0.3]))
    assert (turned.inv() * Rotation.from_quat(prediction.odometry[3:7])).magnitude() < 1e-9
    assert prediction.geodetic[:2] == pytest.approx([0.8 + moved[1] / 6.37e6, 0.2 + moved[0] / 6.37e6 / np.cos(0.8)],
                                                    abs=1e-10)
    # and the source stays, and its variance grows by that of the velocity
    assert estimate.odometry[:3].tolist() == [3.0, 4.0, 5.0]
    p = prediction.odometry[7:43].reshape(6, 6)
    velocity = attitude.as_matrix() @ np.diag([0.04, 0.04, 0.25]) @ attitude.as_matrix().T
    assert p[:3, :3] == pytest.approx(np.diag([1.0, 1.0, 4.0]) + 0.05**2 * velocity)


def test_the_transforms_make_a_chain(monkeypatch):
    message = types.ModuleType('tf2_msgs.msg')
    message.TFMessage = lambda transforms: transforms
    monkeypatch.setitem(sys.modules, 'tf2_msgs', types.ModuleType('tf2_msgs'))
    monkeypatch.setitem(sys.modules, 'tf2_msgs.msg', message)
    estimate = Estimate()
    smooth = SmoothFrame(estimate)
    output, in_map = Output(smooth, 'odom', 'base_link'), MapOutput(estimate, smooth, 'map', 'odom')
    (vehicle,), (frame,) = output.add_transform(), in_map.transform()
    driven(estimate, smooth, jump=(5.0, -3.0, 1.0), turn=0.2)
    for part in (output, in_map):
        part.fill(7 * 10**9)
    assert [(t.header.frame_id, t.child_frame_id, t.header.stamp.sec) for t in (frame, vehicle)] == [
        ('map', 'odom', 7), ('odom', 'base_link', 7)]

    def matrix(t):
        p, q = t.transform.translation, t.transform.rotation
        return transform(np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w]))
    assert matrix(frame) @ matrix(vehicle) == pytest.approx(transform(estimate.odometry), abs=1e-9)
    best = in_map.pose.pose
    assert in_map.pose.header.frame_id == 'map'
    assert [best.pose.position.x, best.pose.position.y, best.pose.position.z] == estimate.odometry[:3].tolist()
    assert np.array_equal(best.covariance, estimate.odometry[7:43])


def test_in_the_axes_of_the_vehicle_it_points_where_it_goes():
    # given a vehicle whose forward axis lies 4 deg to the right of the one declared, and 2 deg up, driving straight
    yaw, pitch = np.radians([4.0, 2.0])
    fusion = Estimate()
    fusion.vehicle_axes = lambda: (yaw, pitch, 0.01)
    vehicle = Rotation.from_euler('ZYX', [1.0, -0.1, 0.05])  # forward-left-up in east-north-up
    # to the right and up are both negative about the axes left and up
    declared = vehicle * Rotation.from_euler('ZY', [-yaw, -pitch]).inv()
    speed, turn = np.array([10.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.3])
    fusion.set(np.zeros(3), declared, declared.inv().apply(vehicle.apply(speed)),
               declared.inv().apply(vehicle.apply(turn)))
    VehicleAxes(fusion).turn()
    # then attitude, velocity and rate are the vehicle's, and the variance of the yaw is
    out = fusion.odometry
    assert (Rotation.from_quat(out[3:7]) * vehicle.inv()).magnitude() < 1e-12
    assert np.allclose(out[43:46], speed) and np.allclose(out[46:49], turn)
    p = out[7:43].reshape(6, 6)
    assert p[5, 5] == pytest.approx(1e-4) and np.linalg.eigvalsh(p).min() > 0.0
    # and the uncertainty of the velocity is the same, turned
    assert np.trace(out[49:85].reshape(6, 6)) == pytest.approx(0.04 + 0.04 + 0.25 + 3e-4)


def test_in_two_dimensions_the_way_over_ground_stays():
    estimate = Estimate()
    attitude = Rotation.from_euler('ZYX', [2.0, -0.2, 0.1])
    over_ground = np.array([8.0, -3.0, 0.0])
    velocity = attitude.inv().apply(over_ground + [0.0, 0.0, 1.5])
    estimate.set((5.0, 6.0, 7.0), attitude, velocity, attitude.inv().apply([0.0, 0.0, 0.4]))
    flatten(estimate.odometry)
    out = estimate.odometry
    flat = Rotation.from_quat(out[3:7])
    assert np.allclose(flat.apply(out[43:46]), over_ground) and np.allclose(out[:3], (5.0, 6.0, 0.0))
    assert np.allclose(out[46:49], (0.0, 0.0, 0.4)) and flat.as_rotvec() == pytest.approx([0.0, 0.0, 2.0])
    for first, last in ((7, 43), (49, 85)):
        p = out[first:last].reshape(6, 6)
        assert np.allclose(p, p.T) and np.linalg.eigvalsh(p).min() > 0.0 and p[2, 2] == p[3, 3] == p[4, 4] == 1e-6
