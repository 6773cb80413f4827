"""Messages where the motion of the vehicle contradicts the parameters: mounting, time offsets, kind of vehicle,
vibration."""
from __future__ import annotations

import math

import numpy as np

from ...navigation.frames import ANGLE_DIGITS, FLU_TO_FRD, rotation_from_rpy
from ..config import MOUNTING_STATES, FilterConfig
from ..memory import NAV, Event, Kind, Nav, StateLayout, Verdict, covariance_index, newest_row, variance_factor
from ..trust.usual_speed import usual
from ..trust.white_noise import NOTEWORTHY, White

FASTEST_BACKWARDS = 8.0  # m/s, largest speed of a car in reverse
#: standard deviations by which an estimated mounting has to differ from the parameters to be reported: of the estimate
#: for the advice of `found_mounting`, of imu.mounting_sigma for a warning
MOUNTING_SIGMAS = 3.0
#: rad by which it has to differ for a warning besides: a mounting measured by hand is off by a few degrees
SMALL_ANGLE = 0.2
#: rad by which it has to differ for the advice besides; its standard deviation has to be smaller. Chosen, not measured
WORTH_SETTING = math.radians(0.5)
#: factor by which its standard deviation has to be smaller than imu.mounting_sigma for the advice, unless it is beyond
#: MOUNTING_SIGMAS of that: otherwise the estimate contains little but the prior
BETTER_KNOWN = 5.0
#: s: an estimated time offset is reported only if it differs from the parameter by more than this: less has little
#: effect on the position,
LATE = 0.05
#: and by more than this many standard deviations: the check is repeated all day
LATE_SIGMAS = 4.0
#: m by which an antenna may be off where the params file lacks its arm, or of a further receiver one of the two (zero:
#: an antenna that is at the IMU cannot be stated): at the usual speed of the vehicle, less than this is no time offset
#: but maybe an arm, forward, which looks the same at a constant speed
UNSTATED_ARM = 1.0
#: s of sideways motion in total above which the vehicle has no wheels, or turns on the spot. Chosen, not measured
LONGEST_SIDEWAYS = 5.0
#: s above which a contradiction by the lateral constraint (`Nav.SLID`) is reported. Chosen, not measured
LONGEST_UNSETTLED = 0.5
#: s in total of far more noise than configured (`White.SHAKEN`) above which it is reported. Chosen, not measured
LONGEST_SHAKEN = 60.0
#: number of refused fixes in a row that show a boat if they move on while the IMU shows a standstill. The fixes of a
#: receiver that jumps do not move on
ADRIFT = 10
#: m/s of the filter below which it shows the vehicle at rest while these are refused. Chosen, not measured
LOW_SPEED = 0.3
FARTHEST_ADRIFT = 10.0  # m by which these fixes have to move: fixes of a parked vehicle wander by less


def vehicle_warnings(memory: np.ndarray, config: FilterConfig, fixes: np.ndarray) -> list[str]:
    """Messages on contradictions to the parameters. fixes: the latest events (k, Event.SIZE)."""
    texts, topic, row = [], config.imu.topic, newest_row(memory)
    if config.vehicle.zero_velocity_sigma and _is_adrift(fixes):
        texts.append(f'{config.gnss.topic}: the fixes move on while {topic} shows a standstill '
                     '(vehicle.zero_velocity): a boat needs config/boat.yaml')
    verdicts = fixes[:, Event.VERDICT]
    fixes = fixes[(verdicts == Verdict.USED) | (verdicts == Verdict.WEIGHTED)]
    if config.vehicle.lateral_sigma:
        turn = mounting_angles(row, config.layout)[0]
        prior = config.parameters['imu.mounting_sigma']
        if abs(turn) > max(MOUNTING_SIGMAS * prior, SMALL_ANGLE):
            texts.append(f'{topic}: the vehicle moves {abs(math.degrees(turn)):.0f} deg to the '
                         f'{"right" if turn > 0 else "left"} of the forward axis that imu.mounting_rpy gives it: add '
                         f'{turn:.2f} to its yaw')
        heading = fixes[:, Event.YAW] + turn
        backwards = -(np.cos(heading) * fixes[:, Event.V_N] + np.sin(heading) * fixes[:, Event.V_E])
        fastest = float(backwards.max(initial=0.0))
        if fastest > FASTEST_BACKWARDS:
            texts.append(f'{topic}: the vehicle seems to go backwards at {fastest:.1f} m/s; if it does not, turn '
                         'the yaw of imu.mounting_rpy by pi')
    sideways, slid = float(row[Nav.SIDEWAYS]), float(row[Nav.SLID])
    if sideways > LONGEST_SIDEWAYS:
        texts.append(f'the vehicle went sideways for {sideways:.0f} s, against vehicle.non_holonomic, '
                     'which was not used then: a boat needs config/boat.yaml, a robot that turns on the spot '
                     'config/robot.yaml')
    if slid > LONGEST_UNSETTLED:
        texts.append(f'{topic}: for {slid:.1f} s it showed a sideways motion that is unusual for this vehicle: the '
                     'vehicle slid, or the IMU was wrong. In that time every fix was used')
    if memory[White.SHAKEN] > LONGEST_SHAKEN:
        texts.append(f'{topic}: for minutes the gyroscopes have been noisier than {NOTEWORTHY:g} times '
                     'gyroscope.noise_density: the vehicle vibrates faster than the IMU samples. A soft mount, a '
                     'higher rate or the low pass of the IMU help')
    return texts


def found_mounting(memory: np.ndarray, config: FilterConfig) -> str:
    """The estimated mounting in words, with the parameter to set, where it certainly differs from `imu.mounting_rpy`;
    '' else."""
    layout, row = config.layout, newest_row(memory)
    states = [layout.index(name) for name in MOUNTING_STATES]
    if states[0] < 0:
        return ''
    yaw, pitch = mounting_angles(row, layout)
    sigmas = [math.sqrt(variance_factor(row, 0) * row[covariance_index(state, state, layout)]) if state >= 0 else 0.0
              for state in states]
    prior = config.parameters['imu.mounting_sigma']
    if not any(abs(angle) > max(MOUNTING_SIGMAS * s, WORTH_SETTING) and s < WORTH_SETTING
               and (s < prior / BETTER_KNOWN or abs(angle) > MOUNTING_SIGMAS * prior)
               for angle, s in zip((yaw, pitch), sigmas)):
        return ''
    from scipy.spatial.transform import Rotation  # imported here: it is slow to load, and most runs do not need it

    turned = FLU_TO_FRD @ Rotation.from_euler('ZY', [yaw, pitch]).as_matrix().T @ FLU_TO_FRD
    declared = rotation_from_rpy(*config.imu.mounting_rpy)
    rpy = [round(float(angle), ANGLE_DIGITS) for angle in Rotation.from_matrix(turned @ declared).as_euler('xyz')]
    parts = [f'{abs(math.degrees(angle)):.1f} +- {math.degrees(s):.1f} deg {sides[angle > 0]}'
             for angle, s, sides in zip((yaw, pitch), sigmas, (('to the left', 'to the right'), ('down', 'up'))) if s]
    return (f'the vehicle points {" and ".join(parts)} of the forward axis that imu.mounting_rpy gives it; pose and '
            f'twist refer to that axis: set imu.mounting_rpy: [{", ".join(map(str, rpy))}], or vehicle_axes: true')


def found_time_offsets(memory: np.ndarray, config: FilterConfig) -> dict[int, str]:
    """By the number of the input: its estimated time offset in words, with the parameter to set, where it certainly
    differs from that."""
    layout, row, found = config.layout, newest_row(memory), {}
    for number, measurement in config.inputs.items():
        state = layout.index(measurement.time_offset_state)
        if state < 0:
            continue
        left = float(row[NAV + state])
        sigma = math.sqrt(variance_factor(row, 0) * row[covariance_index(state, state, layout)])
        if abs(left) > max(LATE, LATE_SIGMAS * sigma) and not _may_be_an_arm(row, config, number, left):
            name = 'gnss' if number == Kind.POSITION else measurement.name
            total = config.settings_of(number).time_offset + left
            found[number] = (f'stamped {abs(left):.3f} +- {sigma:.3f} s too {"late" if left > 0 else "early"}, which '
                             f'the filter corrects now: set {name}.time_offset: {total:.2f}')
    return found


def _may_be_an_arm(row: np.ndarray, config: FilterConfig, number: int, late: float) -> bool:
    """Whether a lever arm that is not stated explains what the estimated time offset, s, of the input does."""
    measurement = config.inputs[number]
    if measurement.kind != Kind.POSITION:
        return False
    arms = [config.gnss.lever_arm] if number == Kind.POSITION else [config.gnss.lever_arm, measurement.arm]
    return not all(np.any(arm) for arm in arms) and abs(late) * math.sqrt(2.0 * usual(row, 0)) < UNSTATED_ARM


def _is_adrift(fixes: np.ndarray) -> bool:
    """Whether ADRIFT refused fixes in a row have moved on while the filter was at rest."""
    refused = fixes[:, Event.VERDICT] == Verdict.REFUSED
    if refused.sum() < ADRIFT:  # the usual case, without the rest
        return False
    refused &= np.hypot(fixes[:, Event.V_N], fixes[:, Event.V_E]) < LOW_SPEED
    off = np.hypot(fixes[:, Event.Z_N], fixes[:, Event.Z_E])
    gone = [np.ptp(off[k - ADRIFT:k]) for k in range(ADRIFT, len(fixes) + 1) if refused[k - ADRIFT:k].all()]
    return max(gone, default=0.0) > FARTHEST_ADRIFT


def mounting_angles(row: np.ndarray, layout: StateLayout) -> tuple[float, float]:
    """Estimated yaw and pitch of the vehicle's axes in the body's, rad to the right and up; 0 without these states."""
    yaw, pitch = (float(row[NAV + state]) if state >= 0 else 0.0 for state in map(layout.index, MOUNTING_STATES))
    return yaw, pitch
