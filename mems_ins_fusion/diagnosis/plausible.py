"""Sizes that no vehicle has: such an estimate is told, with what it usually stands for, and never added."""
from __future__ import annotations

from collections.abc import Mapping

from .estimate import Estimate
from .problem import UPDATE_INTERVAL

_ARM = 'an error that turns with the vehicle: a time offset, an IMU that is turned or tilted, positions that the ' \
       'receiver smooths'
_SCALE = 'a wrong unit or range setting, an IMU that is turned, slopes, or positions that the receiver smooths'
_CLOCK = 'stamps of another clock (UTC and GPS time, a clock that was set), or positions that the receiver smooths'
#: by effect: the largest size of each parameter that somebody has built, in its unit, and what a larger one stands for
_LARGEST: dict[str, tuple[dict[str, float], str]] = {
    'gnss_time_offset': ({'time_offset': 2.0}, _CLOCK),
    'gnss_lever_arm': ({'x': 5.0, 'y': 3.0, 'z': 3.5}, _ARM),
    'accelerometer_lever_arm': ({'x': 3.0, 'y': 2.0, 'z': 2.0}, _ARM),
    'accelerometer_scale': ({'x': 0.15, 'y': 0.15, 'z': 0.15}, _SCALE),
    'gyroscope_scale': ({'x': 0.15, 'y': 0.15, 'z': 0.15}, _SCALE),
    'mounting_rotation': ({'roll': 0.5, 'pitch': 0.5, 'yaw': 0.8}, 'sensor axes that are not as imu.mounting_rpy says: '
                          'let `configure` find them'),
    'sideslip': ({'angle_per_acceleration': 0.03}, 'an IMU that is turned, or one far from the rear axle'),
    'tilt': ({'pitch_per_acceleration': 0.03, 'roll_per_acceleration': 0.03}, 'slopes, or a scale factor'),
    'g_sensitivity': ({'x': 0.01, 'y': 0.01, 'z': 0.01}, 'an IMU that is turned, or gyroscopes that are not at right '
                      'angles to the accelerometers'),
    'gnss_coloured_noise': ({'sigma': 20.0}, 'fixes that are far off, or positions that the receiver smooths'),
}


#: by effect: the smallest size that is what it says, and what a smaller one is
_SMALLEST: dict[str, tuple[dict[str, float], str]] = {
    'gnss_coloured_noise': ({'tau': UPDATE_INTERVAL}, 'white noise, as it does not last from one fix to the next'),
}


def implausible(effect: str, parameters: Mapping[str, Estimate]) -> str:
    """Why these sizes cannot be, and what they usually stand for; empty where they can."""
    largest, stands_for = _LARGEST.get(effect, ({}, ''))
    beyond = [f'{name} of {estimate.text()}' for name, estimate in parameters.items()
              if estimate.value is not None and _within(estimate)[0] > largest.get(name, float('inf'))]
    if beyond:
        return f'{" and ".join(beyond)} is more than any vehicle has; it usually stands for {stands_for}'
    smallest, is_rather = _SMALLEST.get(effect, ({}, ''))
    below = [f'{name} of {estimate.text()}' for name, estimate in parameters.items()
             if estimate.value is not None and _within(estimate)[1] < smallest.get(name, 0.0)]
    return f'{" and ".join(below)} is {is_rather}' if below else ''


def _within(estimate: Estimate) -> tuple[float, float]:
    """Between which sizes it is, by a sigma: what may be possible is not impossible."""
    sigma = estimate.sigma if estimate.known else 0.0
    return abs(estimate.value) - sigma, abs(estimate.value) + sigma
