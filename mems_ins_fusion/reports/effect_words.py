"""What an effect is called by the people who build vehicles, and what they can check: for the pages only.

An effect without an entry goes by its name.
"""
from __future__ import annotations

#: by name: what is wrong, and what to check on the vehicle
_WORDS = {
    'gnss_time_offset': ('the clocks of receiver and IMU disagree',
                         'whether the receiver\'s driver stamps a fix with the time of its measurement (GPS time, PPS) '
                         'or of its arrival'),
    'gnss_lag': ('the receiver smooths its positions', 'the navigation filter setting of the receiver (dynamic model, '
                 'position averaging, static hold)'),
    'gnss_outliers': ('some fixes are far off (multipath)', 'the view of the sky and the ground plane of the antenna'),
    'gnss_lever_arm': ('the antenna is not where the parameters say',
                       'the place of the antenna seen from the IMU, with a tape measure: forward, left, up'),
    'gnss_coloured_noise': ('the receiver\'s errors last for seconds to minutes',
                            'whether the receiver could have corrections (RTK, SBAS)'),
    'accelerometer_scale': ('the accelerometers measure too much or too little',
                            'the range setting and unit conversion of the accelerometers'),
    'gyroscope_scale': ('the gyroscopes measure too much or too little',
                        'the range setting and unit conversion of the gyroscopes'),
    'mounting_rotation': ('the IMU is turned against the vehicle',
                          'how the IMU is mounted: imu.mounting_rpy, and whether its bracket is loose'),
    'tilt': ('gravity leaks into the accelerometers on slopes or when the body leans', ''),
    'g_sensitivity': ('the gyroscopes react to acceleration',
                      'the data sheet of the gyroscopes; vibration at the mount'),
    'temperature': ('the bias follows the temperature', 'the place of the IMU (sun, engine), and its warm-up time'),
    'accelerometer_lever_arm': ('the IMU is far from the axle about which the vehicle turns',
                                'the place of the IMU seen from the middle of the rear axle'),
    'gnss_latency': ('how late the fixes are changes during the drive',
                     'whether the receiver\'s driver stamps a fix when it arrives, and what else uses its serial line'),
    'rear_axle': ('the rear axle is not where the parameters say',
                  'the place of the rear axle seen from the IMU, with a tape measure (vehicle.rear_axle)'),
    'speed_scale': ('the wheels measure too much or too little', 'the size and pressure of the tyres'),
    'gyroscope_warm_up': ('the gyroscope warms up', 'whether it can be switched on some minutes before the drive'),
    'imu_repeats': ('IMU samples come twice', 'the rate of the IMU\'s driver and that at which the sensor measures'),
    'imu_jitter': ('IMU samples are stamped unevenly', 'whether the driver can stamp with the sensor\'s own clock'),
    'sideslip': ('the vehicle moves sideways in bends', 'tyres and load; whether the IMU points straight ahead'),
}


def what(name: str) -> str:
    """The effect `name` in words."""
    return _WORDS.get(name, (name.replace('_', ' '), ''))[0]


def check(name: str) -> str:
    """What to check on the vehicle for the effect `name`; empty where nothing is known."""
    return _WORDS.get(name, ('', ''))[1]
