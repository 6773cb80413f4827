"""What an effect is called by the people who build vehicles, and what they can check: for the pages only.

An effect without an entry goes by its name.
"""
from __future__ import annotations

import math

from ..diagnosis.estimate import Estimate, rounded

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
    'gyroscope_warm_up': ('the vertical gyroscope drifts in the first minutes, as one that warms up',
                          'whether a recording that begins some minutes after the IMU was switched on has it, too'),
    'imu_repeats': ('IMU samples come twice', 'the rate of the IMU\'s driver and that at which the sensor measures'),
    'imu_jitter': ('IMU samples are stamped unevenly', 'whether the driver can stamp with the sensor\'s own clock'),
    'sideslip': ('the vehicle moves sideways in bends', 'tyres and load; whether the IMU points straight ahead'),
}


#: by name: what looks the same, and a single drive may not tell from it
_OR = {
    'gyroscope_warm_up': 'a heading or biases that the filter had to find first look the same',
    'gnss_coloured_noise': 'several bad fixes in a row look the same',
    'gnss_lag': 'a receiver whose stamps are late looks nearly the same',
    'accelerometer_scale': 'a body that leans on its springs, or an IMU that is not level, looks nearly the same',
    'accelerometer_lever_arm': 'tyres that slip in bends look nearly the same',
    'sideslip': 'an IMU far from the rear axle looks nearly the same',
}
#: by name and parameter: the size in words, where it is above zero, and where below
_SIZES = {
    ('gnss_time_offset', 'time_offset'): ('fixes are stamped {} too late', 'fixes are stamped {} too early'),
    ('gnss_lever_arm', 'x'): ('the antenna is {} further forward', 'the antenna is {} further back'),
    ('gnss_lever_arm', 'y'): ('{} further left', '{} further right'),
    ('gnss_lever_arm', 'z'): ('{} higher', '{} lower'),
    ('accelerometer_lever_arm', 'x'): ('the IMU is {} further forward', 'the IMU is {} further back'),
    ('accelerometer_lever_arm', 'y'): ('{} further left', '{} further right'),
    ('accelerometer_lever_arm', 'z'): ('{} higher', '{} lower'),
    ('mounting_rotation', 'roll'): ('it is tilted {} more to the right', 'it is tilted {} more to the left'),
    ('mounting_rotation', 'pitch'): ('it is tilted {} more forward', 'it is tilted {} more backward'),
    ('mounting_rotation', 'yaw'): ('it is turned {} more to the left', 'it is turned {} more to the right'),
    ('accelerometer_scale', 'x'): ('forward {} too much', 'forward {} too little'),
    ('accelerometer_scale', 'y'): ('sideways {} too much', 'sideways {} too little'),
    ('gyroscope_scale', 'z'): ('in bends {} too much', 'in bends {} too little'),
    ('rear_axle', 'x'): ('it is {} further forward', 'it is {} further back'),
    ('speed_scale', 'scale'): ('{} too much', '{} too little'),
}


def what(name: str) -> str:
    """The effect `name` in words."""
    return _WORDS.get(name, (name.replace('_', ' '), ''))[0]


def check(name: str) -> str:
    """What to check on the vehicle for the effect `name`; empty where nothing is known."""
    return _WORDS.get(name, ('', ''))[1]


def looks_the_same(name: str) -> str:
    """What else may look as the effect `name` does; empty where nothing is known."""
    return _OR.get(name, '')


def size(name: str, parameter: str, estimate: Estimate) -> str:
    """The size of a parameter of the effect `name` in words, angles in degrees and ratios in percent."""
    words = _SIZES.get((name, parameter))
    if words is None or estimate.value is None:
        return f'{parameter} {estimate.text()}'
    shown = {'rad': (math.degrees(1.0), ' deg'), '-': (100.0, ' %')}
    factor, unit = shown.get(estimate.unit, (1.0, f' {estimate.unit}'))
    value, sigma = abs(estimate.value) * factor, estimate.sigma * factor if estimate.known else None
    said = rounded(value, sigma) + (f' \N{PLUS-MINUS SIGN} {sigma:.2g}' if sigma is not None else '') + unit
    return words[estimate.value < 0].format(said)
