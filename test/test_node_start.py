"""Starts that mislead an alignment, sent to the real node over real ROS 2."""
from __future__ import annotations

import math

import numpy as np
import pytest
from ros_support import PLAYABLE, Diagnostics, NodeProcess, Player, stamp_of
from test_alignment import CAR, GO, STAND, Segment, driven, recorded, scattered, template  # noqa: F401

from mems_ins_fusion.navigation.frames import wrap

REVERSE = [Segment(5.0, -5.0), Segment(4.0), Segment(5.0, 5.0), Segment(1.0)]
BEND = Segment(8.0, course_change=1.2)


def played(peer, drive, recording):
    """What the node publishes and says of a recording that is played to it: odometry, diagnostics, lines."""
    with NodeProcess('fusion_node', *PLAYABLE) as node:
        node.wait_until_ready()
        heard, player = Diagnostics(peer), Player(peer, node, recording)
        player.connect()
        player.play()
        heard.wait(lambda d: 'state' in d.values('filter'))
        peer.spin_some()
    node.wait()
    return list(peer.odometry), heard, node.lines


def heading_errors(drive, recording, odometry):
    """Error of each yaw over its sigma; time, s after the first sample."""
    time = np.array([stamp_of(m) - int(recording.imu.stamp[0]) for m in odometry]) * 1e-9
    yaw = np.array([math.pi / 2 - 2.0 * math.atan2(m.pose.pose.orientation.z, m.pose.pose.orientation.w)
                    for m in odometry])
    sigma = np.sqrt([m.pose.covariance[35] for m in odometry])
    return time, wrap(yaw - drive.at(time).yaw) / sigma


@pytest.mark.parametrize('case', ['claims 2 cm', 'begins in reverse'])
def test_the_heading_is_as_good_as_it_says(peer, template, case):  # noqa: F811
    # given a receiver that scatters by 1.5 m and claims 2 cm, or a car that reverses out and then goes on
    reverses = case == 'begins in reverse'
    drive = driven(template, [STAND, *(REVERSE if reverses else []), GO, Segment(20.0), BEND, Segment(20.0)])
    _, recording = recorded(drive, 2, sigma=0.02, **CAR)
    odometry, heard, lines = played(peer, drive, scattered(recording, 1.5, 1.5 if reverses else 0.02, 2))
    # then it has a heading before the bend, whose sigma is true, and nothing is wrong at the end
    time, errors = heading_errors(drive, recording, odometry)
    assert time[0] < 10.0 + 6.0 + 20.0 + 15.0 * reverses, lines
    assert np.abs(errors).max() < 4.0, (time[np.abs(errors).argmax()], errors)
    assert heard.values('filter')['state'] == 'fusing' and heard.level('filter') == 0, heard.statuses['filter']


def test_fixes_that_wander_start_no_drive_of_a_parked_car(peer, template):  # noqa: F811
    # given a car that is parked for two minutes, with fixes whose errors of 15 m last for half a minute
    drive = driven(template, [Segment(120.0), GO, Segment(30.0)])
    _, recording = recorded(drive, 1, **CAR)
    odometry, _, lines = played(peer, drive, scattered(recording, 15.0, 1.5, 1, 30.0))
    # then nothing says that it moves while it is at rest, and it starts when it drives off
    moving = [m for m in odometry if stamp_of(m) < recording.imu.stamp[0] + 119 * 10**9
              and math.hypot(m.twist.twist.linear.x, m.twist.twist.linear.y) > 0.5]
    assert odometry and not moving, lines
