"""What the filter has seen of the vehicle that its parameters do not say: how the IMU sits in it, and how it moves."""
from __future__ import annotations

import math

import numpy as np

from ...navigation.frames import FLU_TO_FRD, rotation_from_rpy
from ..config import FilterConfig
from ..memory import NAV, Event, Head, Nav, Verdict, covariance_index, state_at, variance_factor
from ..trust.white_noise import FAR_MORE, White

#: faster no car goes backwards, m/s
FASTEST_BACKWARDS = 8.0
#: slower it stands, m/s
AT_REST = 0.3
#: sigmas by which a mounting that is found is off that of the parameters where it is worth a word
MOUNTING_SIGMAS = 3.0
#: rad, by which it is off at least: a mounting measured by hand is off by a few degrees
SMALL_ANGLE = 0.2
#: a mounting known better than this, and found further off, is worth setting, rad
WORTH_SETTING = math.radians(0.5)
#: and so many times better known than the parameters say they know it (imu.mounting_sigma): else it is no news
BETTER_KNOWN = 5.0
#: a vehicle that goes sideways for longer in all is none that rolls, s
LONGEST_SIDEWAYS = 5.0
#: s of a slide that are worth a word
LONGEST_UNSETTLED = 0.5
#: and of far more noise than is assumed
LONGEST_SHAKEN = 60.0
#: refused fixes in a row that go on while the IMU is seen at rest: as a boat's do, and no receiver's that jumps
ADRIFT = 10
#: m, by which they go on in that time at least: fixes of a parked vehicle wander by less
FARTHEST_ADRIFT = 10.0


def vehicle_says(memory: np.ndarray, config: FilterConfig, fixes: np.ndarray) -> list[str]:
    """Lines on what does not fit the parameters, from the filter's memory and records of fixes (k, Event.SIZE)."""
    texts, topic = [], config.imu.topic
    if config.vehicle.zero_velocity_sigma and _is_adrift(fixes):
        texts.append(f'{config.gnss.topic}: the fixes go on while {topic} shows a standstill (vehicle.zero_velocity): '
                     'a boat needs config/boat.yaml')
    fixes = fixes[np.isin(fixes[:, Event.VERDICT], (Verdict.USED, Verdict.WEIGHTED))]
    if config.vehicle.lateral_sigma:
        turn = _mounting_yaw(memory, config)
        prior = config.parameters['imu.mounting_sigma']
        if abs(turn) > max(MOUNTING_SIGMAS * prior, SMALL_ANGLE):
            texts.append(f'{topic}: the vehicle moves {abs(math.degrees(turn)):.0f} deg to the '
                         f'{"right" if turn > 0 else "left"} of the forward axis that imu.mounting_rpy gives it: add '
                         f'{turn:.2f} to its yaw')
        heading = fixes[:, Event.YAW] + turn
        backwards = -(np.cos(heading) * fixes[:, Event.V_N] + np.sin(heading) * fixes[:, Event.V_E])
        fastest = float(backwards.max(initial=0.0))
        if fastest > FASTEST_BACKWARDS:
            texts.append(f'{topic}: the vehicle seems to go backwards at {fastest:.1f} m/s: if it does not, the IMU is '
                         'mounted the other way round: turn the yaw of imu.mounting_rpy by pi')
    row = state_at(memory, int(memory[Head.SAMPLES]))
    sideways, slid = float(memory[row + Nav.SIDEWAYS]), float(memory[row + Nav.SLID])
    if sideways > LONGEST_SIDEWAYS:
        texts.append(f'the vehicle went sideways for {sideways:.0f} s, against vehicle.non_holonomic, '
                     'which was not used then: a boat needs config/boat.yaml, a robot that turns on the spot '
                     'config/robot.yaml')
    if slid > LONGEST_UNSETTLED:
        texts.append(f'{topic}: for {slid:.1f} s it showed a motion sideways that is not usual for this '
                     'vehicle: it slid, or the IMU was not right; the fixes decided then')
    if memory[White.SHAKEN] > LONGEST_SHAKEN:
        texts.append(f'{topic}: the gyroscopes scatter from one sample to the next for minutes by more than '
                     f'{FAR_MORE:g} times gyroscope.noise_density: the vehicle shakes it faster than it '
                     'samples. That counts as noise (imu.adapt_noise); a soft mount, a faster rate or the low pass of '
                     'the IMU make it less')
    return texts


def found_mounting(memory: np.ndarray, config: FilterConfig) -> str:
    """Where the filter has found the IMU to sit other than `imu.mounting_rpy` says, and the line to set; '' where it
    has not, or is not sure."""
    layout, at = config.layout, state_at(memory, int(memory[Head.SAMPLES]))
    row = memory[at:at + int(memory[Head.WIDTH])]
    states = [layout.index(name) for name in ('mounting_yaw', 'mounting_pitch')]
    if states[0] < 0:
        return ''
    yaw, pitch = (float(row[NAV + state]) if state >= 0 else 0.0 for state in states)
    sigmas = [math.sqrt(variance_factor(row, 0) * row[covariance_index(state, state, layout)]) if state >= 0 else 0.0
              for state in states]
    prior = config.parameters['imu.mounting_sigma']
    if not any(abs(angle) > max(MOUNTING_SIGMAS * s, WORTH_SETTING) and s < WORTH_SETTING
               and (s < prior / BETTER_KNOWN or abs(angle) > MOUNTING_SIGMAS * prior)
               for angle, s in zip((yaw, pitch), sigmas)):
        return ''
    from scipy.spatial.transform import Rotation  # takes a while to load, and most never need it

    turned = FLU_TO_FRD @ Rotation.from_euler('ZY', [yaw, pitch]).as_matrix().T @ FLU_TO_FRD
    declared = rotation_from_rpy(*config.imu.mounting_rpy)
    rpy = [round(float(angle), 4) for angle in Rotation.from_matrix(turned @ declared).as_euler('xyz')]
    parts = [f'{abs(math.degrees(angle)):.1f} +- {math.degrees(s):.1f} deg {sides[angle > 0]}'
             for angle, s, sides in zip((yaw, pitch), sigmas, (('to the left', 'to the right'), ('down', 'up'))) if s]
    return (f'the vehicle points {" and ".join(parts)} of the forward axis that imu.mounting_rpy gives it; pose and '
            f'twist are those of that axis: set imu.mounting_rpy: [{", ".join(map(str, rpy))}], or vehicle_axes: true')


def _is_adrift(fixes: np.ndarray) -> bool:
    refused = fixes[:, Event.VERDICT] == Verdict.REFUSED
    refused &= np.hypot(fixes[:, Event.V_N], fixes[:, Event.V_E]) < AT_REST
    off = np.hypot(fixes[:, Event.Z_N], fixes[:, Event.Z_E])
    gone = [np.ptp(off[k - ADRIFT:k]) for k in range(ADRIFT, len(fixes) + 1) if refused[k - ADRIFT:k].all()]
    return max(gone, default=0.0) > FARTHEST_ADRIFT


def _mounting_yaw(memory: np.ndarray, config: FilterConfig) -> float:
    """Of the vehicle in the body's axes, rad clockwise."""
    state = config.layout.index('mounting_yaw')
    return 0.0 if state < 0 else float(memory[state_at(memory, int(memory[Head.SAMPLES])) + NAV + state])
