"""Conditions of a simulated drive: road, suspension of the body, mounting of the IMU, vibration.

FLAT is a level road and a rigid vehicle. REALISTIC contains effects that no filter models, to evaluate filters.
"""
from __future__ import annotations

import math
from dataclasses import dataclass, field

from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.simulation.drive import Drive, simulate_drive, stream
from mems_ins_fusion.simulation.manoeuvres import CITY, MIXED, SLOW, TRAFFIC
from mems_ins_fusion.simulation.simulation import SimulatedAiding
from mems_ins_fusion.simulation.vibration import Vibration

MANOEUVRES = {'city': CITY, 'mixed': MIXED, 'traffic': TRAFFIC, 'slow': SLOW}
#: Hz, natural frequency of a car's body on its springs
_SUSPENSION = 1.2
#: rad per m/s^2, pitch of the body, nose up, for forward acceleration
_PITCH = math.radians(0.35)
#: rad per m/s^2, roll of the body, outwards, for lateral acceleration
_ROLL = math.radians(0.4)
#: rad per m/s^2, sideslip: angle from the body's forward axis to the velocity for lateral acceleration
SIDESLIP = 0.003


@dataclass(frozen=True)
class Scene:
    """grade, bank: the largest of the road (0.03 is 3 %). parked_on_slope: it begins with them. manoeuvres: a key of
    MANOEUVRES. body: whether it pitches, rolls and slips sideways as a car. unevenness: rad, pitch and roll that the
    road adds at 10 m/s, RMS. vibration: m/s^2 RMS of the road at 10 m/s; the engine shakes with half of that.
    mounting_error: rad, up to which roll, pitch and yaw of the IMU's mounting are off, drawn for each seed.
    axle_to_imu: m, forward-left-up, from the middle of the rear axle to the IMU. rotating_earth: as in `Path`.
    aiding: further sensors. imu: parameters of the IMU.
    """

    grade: float = 0.0
    bank: float = 0.0
    parked_on_slope: bool = False
    manoeuvres: str = 'city'
    body: bool = False
    unevenness: float = 0.0
    vibration: float = 0.0
    mounting_error: float = 0.0
    axle_to_imu: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotating_earth: bool = False
    aiding: SimulatedAiding | None = None
    imu: dict = field(default_factory=dict)

    def drive(self, duration: float, seed: int = 0, rate: float = 100.0, **options) -> Drive:
        """A drive of `duration` s in this scene; the others as in `simulate_drive`."""
        x, y, z = self.axle_to_imu
        body = {'suspension': _SUSPENSION, 'pitch_per_acceleration': _PITCH, 'roll_per_acceleration': _ROLL,
                'sideslip_per_acceleration': SIDESLIP, 'unevenness': self.unevenness} if self.body else {}
        return simulate_drive(duration, seed, rate, grade=self.grade, bank=self.bank,
                              parked_on_slope=self.parked_on_slope, manoeuvres=MANOEUVRES[self.manoeuvres],
                              rotating_earth=self.rotating_earth, axle_to_imu=(x, -y, -z), **body, **options)

    def distortions(self, seed: int) -> dict:
        """Further arguments of `simulate_recording`: effects, vibration and aiding."""
        off = stream(seed, 'mounting').uniform(-self.mounting_error, self.mounting_error, 3)
        return {'effects': [(EFFECTS['mounting_rotation'], dict(zip(('roll', 'pitch', 'yaw'), off.tolist())))]
                if self.mounting_error else [],
                'vibration': Vibration(self.vibration / 2, self.vibration) if self.vibration else None,
                'aiding': self.aiding}


FLAT = Scene()
REALISTIC = Scene(
    grade=0.03, bank=0.02, parked_on_slope=True, manoeuvres='mixed', body=True, unevenness=math.radians(0.15),
    vibration=0.1, mounting_error=math.radians(5.0), axle_to_imu=(1.2, 0.3, 0.5), rotating_earth=True,
    aiding=SimulatedAiding(speed_rate=10.0, velocity_rate=1.0, heading_rate=1.0),
    imu={  # angle random walk 0.2 deg/sqrt(h), 30 deg/h; velocity random walk 0.1 m/s/sqrt(h), 7 mg
        'gyroscope.noise_density': [math.radians(0.2) / 60], 'gyroscope.gauss_markov.sigma': [math.radians(30) / 3600],
        'gyroscope.gauss_markov.tau': [300.0], 'gyroscope.initial_sigma': [math.radians(0.1)],
        'accelerometer.noise_density': [0.1 / 60], 'accelerometer.gauss_markov.sigma': [0.0687],
        'accelerometer.gauss_markov.tau': [300.0], 'accelerometer.initial_sigma': [0.05]})
SCENES = {'flat': FLAT, 'realistic': REALISTIC}
