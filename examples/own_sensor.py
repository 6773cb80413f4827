"""A sensor of one's own, with its units and axes, and the speed of the wheels. python examples/own_sensor.py

Here the 'sensor' is a simulated drive, in g and deg/s with x to the right and y forward, as some boards have it.
"""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.odometry import LINEAR
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_recording

G = 9.80665
#: where the board's axes x, y, z point in base_link (forward, left, up): right, forward, up is a yaw of -90 deg
MOUNTING = [0.0, 0.0, -np.pi / 2]


def board(drive, recording):
    """What the board's driver delivers: stamp (ns), g (3,), deg/s (3,), a fix or None, the wheels' speed or None."""
    imu, gnss = recording.imu, recording.gnss
    after = np.searchsorted(imu.stamp, gnss.stamp).tolist()  # the sample at which each fix is there
    for i, stamp in enumerate(imu.stamp):
        fix = gnss.select(slice(after.index(i), after.index(i) + 1)) if i in after else None
        speed = float(np.linalg.norm(drive.velocity[i, :2])) if i % 5 == 0 else None
        yield int(stamp), imu.specific_force[i] / G, np.degrees(imu.angular_rate[i]), fix, speed


def main(seconds: float = 120.0) -> float:
    """Feed the filter; its error at the end, m."""
    drive = simulate_drive(seconds, seed=3, rate=50.0, standstill=15.0)
    recording = simulate_recording(drive, gnss=GnssNoise(sigma=1.5), mounting_rpy=MOUNTING, seed=3).recording
    # inputs without a topic are not used; here the name says only that there is one
    values = table.check({'imu.mounting_rpy': MOUNTING, 'speed_topic': 'wheels'})
    live = FusionFilter(FilterConfig.from_parameters(values))
    for stamp, force, rate, fix, speed in board(drive, recording):
        live.add_imu(stamp, *(force * G), *np.radians(rate))
        if speed is not None:
            live.add('speed', stamp, speed, 0.1**2)
        if fix is not None:
            live.add_fix(int(fix.stamp[0]), fix.latitude[0], fix.longitude[0], fix.height[0], fix.covariance[0].ravel())
        for notice in live.notices():
            print(notice.text)
    live.update_odometry()
    truth = recording.reference
    north, east, _ = to_local(truth.latitude[-1], truth.longitude[-1], truth.height[-1], tuple(live.geodetic))
    print(f'{live.state}: {np.hypot(north, east):.2f} m from the truth, with fixes of 1.5 m; '
          f'{live.odometry[LINEAR]:.1f} m/s forward')
    return float(np.hypot(north, east))


if __name__ == '__main__':
    main()
