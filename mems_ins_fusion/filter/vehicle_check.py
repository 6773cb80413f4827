"""What the filter has seen of the vehicle that its parameters do not say: how the IMU sits in it, and how it moves."""
from __future__ import annotations

import math

import numpy as np

from .config import FilterConfig
from .layout import NAV, Event, Head, Verdict, state_at
from .white_noise import FAR_MORE

#: faster no car goes backwards, m/s
FASTEST_BACKWARDS = 8.0
#: slower it stands, m/s
AT_REST = 0.3
#: a mounting found further from that of the parameters than so many sigma, and than this, rad, is worth a word
MOUNTING_SIGMAS, SMALL_ANGLE = 3.0, 0.2
#: a vehicle that goes sideways for longer in all is none that rolls, s
LONGEST_SIDEWAYS = 5.0
#: s of a slide that are worth a word
LONGEST_UNSETTLED = 0.5
#: and of far more noise than is assumed
LONGEST_SHAKEN = 60.0
#: refused fixes in a row that go on while the IMU is seen at rest, and how far, m, in that time
ADRIFT, FARTHEST_ADRIFT = 10, 10.0


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
    if memory[Head.SIDEWAYS] > LONGEST_SIDEWAYS:
        texts.append(f'the vehicle went sideways for {memory[Head.SIDEWAYS]:.0f} s, against vehicle.non_holonomic, '
                     'which was not used then: a boat needs config/boat.yaml, a robot that turns on the spot '
                     'config/robot.yaml')
    if memory[Head.SLID] > LONGEST_UNSETTLED:
        texts.append(f'{topic}: for {memory[Head.SLID]:.1f} s it showed a motion sideways that is not usual for this '
                     'vehicle: it slid, or the IMU was not right; the fixes decided then')
    if memory[Head.SHAKEN] > LONGEST_SHAKEN:
        texts.append(f'{topic}: the gyroscopes scatter from one sample to the next for minutes by more than '
                     f'{FAR_MORE:g} times gyroscope.noise_density: the vehicle shakes it faster than it '
                     'samples. That counts as noise (imu.adapt_noise); a soft mount, a faster rate or the low pass of '
                     'the IMU make it less')
    return texts


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
