"""The live filter without ROS: one event at a time, as they arrive.

python examples/live_filter.py BAG [PARAMS.yaml ...]
"""
from __future__ import annotations

import sys

import numpy as np

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.recordings.reading import read_recording


def main(bag: str, *files: str) -> int:
    values = table.check(params_file.load_files(files))
    recording = read_recording(bag, values['imu_topic'], values['gnss_topic'])
    imu, gnss = recording.imu, recording.gnss
    live = FusionFilter(FilterConfig.from_parameters(values))
    live.warm_up()  # compile before the first sample, which would have to wait

    # on a vehicle these come from drivers; here from a recording, in the order in which they arrived
    arrived = np.concatenate([imu.received, gnss.received])
    said = 0
    for k in np.argsort(arrived, kind='stable'):
        if k >= len(imu):
            i = k - len(imu)
            live.add_fix(gnss.stamp[i], gnss.latitude[i], gnss.longitude[i], gnss.height[i], gnss.covariance[i].ravel(),
                         gnss.status[i], gnss.covariance_type[i])
        elif live.add_imu(imu.stamp[k], *imu.specific_force[k], *imu.angular_rate[k]):
            stamp = live.update_odometry()  # fills the arrays below
            if stamp - said >= 10 * 10**9:
                said = stamp
                latitude, longitude, _ = live.geodetic
                sigma = np.sqrt(live.position_covariance_enu[[0, 4]])
                print(f'{(stamp - imu.stamp[0]) * 1e-9:6.1f} s  '
                      f'{np.degrees(latitude):.6f} {np.degrees(longitude):.6f}  '
                      f'sigma {sigma[0]:.2f} m east, {sigma[1]:.2f} m north  {live.state}')
    return 0 if live.aligned else 1


if __name__ == '__main__':
    sys.exit(main(*sys.argv[1:]))
