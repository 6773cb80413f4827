"""How well the filter's detector of standstills tells them from a smooth road.

    python studies/standstill.py [--data ../shared/data] [--seeds 20] [--first-seed 3000] [--processes 2]
                                 [--output FILE.md]

Truth of the measured drives: their RTK or reference positions, 3 s of motion around each instant; of the simulated ones
the speed itself. They differ in the IMU's rate, road, engine and vibration (SCENES below). The table counts seconds:
*false* ones, called a standstill while the vehicle moves (faster than 0.3 m/s), those of them above 1.5 m/s, and the
fastest instant; *missed* ones, not called one although it has stood for 3 s, in which a body on springs swings out.

The detector sees the inertial samples alone: no speed and no fix says that there can be no standstill, as after a long
outage. It is told when the vehicle certainly moves (true speed above 2 m/s, which a filter knows whenever it has
fixes): it needs that to learn what motion looks like in this vehicle. Fixed thresholds on the scatter of samples, which
it replaced, took 410 of 13 300 s of motion for a standstill, 333 of them above 1.5 m/s; it takes 52 and none. They
missed 69 of 2700 s at rest, it misses 24: a body that swings out.

What was found: the scatter of samples, whatever the threshold, does not separate an idling engine from a smooth road
(simulated medians 0.06 m/s^2 and lowest values in motion 0.05; measured on longmont_rtk_drive 0.15 and 0.10). What
does is what is left of the specific force *below 1 Hz or so*: no road is so even, no driver so steady that pitch,
grade, bank and speed keep still, and an engine shakes faster. In all measured drives and all simulated ones but those
where a 10 Hz IMU folds the engine down there, the quietest second of motion has at least twice the low-frequency
scatter of a median second at rest, mostly five to ten times. The gyroscopes, treated alike, separate less (a consumer
gyroscope's noise is as large as a smooth road), and adding them makes it worse on the measured drives.
"""
from __future__ import annotations

import argparse
import math
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numba
import numpy as np
from vehicle import MEASURED, Measured, sensors

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.position import is_fix
from mems_ins_fusion.filter.memory import Sample, sample_at
from mems_ins_fusion.filter.trust.standstill import is_still
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.navigation.frames import mounting
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.errors import RecordingWarning
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_recording
from mems_ins_fusion.simulation.vibration import Vibration

RECORDED = {**MEASURED, 'incheon_static_ros2': Measured('bag', '/gps/fix', {})}
MOVING, FAST, SURELY = 0.3, 1.5, 2.0  # m/s
SWING = 3.0  # s
#: of the simulated drives, one after the other: rate of the IMU in Hz, vibration by road and by engine in m/s^2, pitch
#: and roll by the road in deg, share of the stops with the engine off, largest grade
SCENES = (
    (100.0, 0.03, 0.04, 0.15, 0.5, 0.03), (100.0, 0.10, 0.05, 0.15, 0.0, 0.03), (100.0, 0.20, 0.04, 0.15, 1.0, 0.03),
    (50.0, 0.10, 0.05, 0.15, 0.5, 0.03), (200.0, 0.10, 0.04, 0.15, 0.0, 0.03), (25.0, 0.10, 0.04, 0.15, 0.5, 0.03),
    (10.0, 0.20, 0.04, 0.15, 0.5, 0.03), (20.0, 0.10, 0.05, 0.15, 0.5, 0.03), (100.0, 0.02, 0.04, 0.03, 0.5, 0.015),
    (100.0, 0.10, 0.04, 0.06, 0.5, 0.015))


@numba.njit
def _flags(memory, sample, time, body, moves):
    flags = np.zeros(len(time), np.bool_)
    for k in range(1, len(time)):
        memory[sample + Sample.TIME] = time[k]
        for i in range(6):
            memory[sample + Sample.F_X + i] = body[k, i]
        flags[k] = is_still(memory, sample, time[k] - time[k - 1], 2.0 * moves[k], 0.0, False) != 0.0
    return flags


def flags_of(drive: Drive) -> np.ndarray:
    """Flags (n,) of the filter's detector."""
    memory = FilterConfig.from_parameters(table.check({'vehicle.zero_velocity': True})).memory()
    return _flags(memory, sample_at(memory, 1), drive.time, drive.body, drive.speed > SURELY)


@dataclass(frozen=True)
class Drive:
    """time (n,) s, body (n, 6) samples in body axes, speed (n,) m/s, NaN where it is not known, still (n,): at rest."""

    name: str
    time: np.ndarray
    body: np.ndarray
    speed: np.ndarray
    still: np.ndarray


def simulated(number: int, seed: int, minutes: float = 10.0) -> Drive:
    """A simulated drive in scene `number`, modulo their count."""
    rate, vibration, idle, unevenness, engine_off, grade = SCENES[number % len(SCENES)]
    scene = replace(REALISTIC, grade=grade, bank=grade / 2, unevenness=math.radians(unevenness))
    drive = scene.drive(60.0 * minutes, seed, rate)
    distortions = {**scene.distortions(seed), 'vibration': Vibration(idle, vibration, engine_off), 'aiding': None}
    imu = simulate_recording(drive, sensors(), GnssNoise(1.5), seed=seed, **distortions).recording.imu
    speed = np.abs(drive.path.wheel_speed(drive.time))
    text = f'simulated {seed}: {rate:g} Hz, road {vibration:g} m/s^2 and {unevenness:g} deg, engine {idle:g} m/s^2'
    return Drive(text, drive.time, np.hstack([imu.specific_force, imu.angular_rate]) @ _body((0.0, 0.0, 0.0)).T, speed,
                 speed == 0)


def recorded(name: str, data: Path) -> Drive:
    """A measured drive, with the speed of its reference over 3 s."""
    given = RECORDED[name]
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RecordingWarning)
        recording = read_recording(data / name / given.path, '/imu/data', given.gnss_topic, given.reference_topic)
    truth = recording.reference or recording.gnss.select(is_fix(recording.gnss))
    truth = truth.select(np.argsort(truth.stamp, kind='stable'))
    imu = recording.imu
    stamp, origin = (samples.stamp * 1.0 for samples in (imu, truth)), imu.stamp[0]
    time, when = ((s - origin) * 1e-9 for s in stamp)
    place = to_local(truth.latitude, truth.longitude, truth.height,
                     (float(truth.latitude[0]), float(truth.longitude[0]), float(truth.height[0])))
    steps = [np.interp(time + SWING / 2, when, axis) - np.interp(time - SWING / 2, when, axis) for axis in place[:2]]
    speed = np.hypot(*steps) / SWING
    nearest = np.abs(when[np.clip(np.searchsorted(when, time), 0, len(when) - 1)] - time)
    speed[nearest > 2.5] = np.nan
    noise = 0.03 if np.median(np.diff(when)) < 0.5 else 0.05  # m/s that the positions themselves show at rest
    body = np.hstack([imu.specific_force, imu.angular_rate]) @ _body(given.values.get('imu.mounting_rpy', (0, 0, 0))).T
    keep = np.isfinite(body).all(axis=1) & (np.diff(time, prepend=-1.0) > 0)
    return Drive(name, time[keep], body[keep], speed[keep], (speed < noise)[keep])


def _body(rpy):
    """From sensor axes to body axes, specific force and angular rate together."""
    return np.kron(np.eye(2), mounting(rpy))


def count(drive: Drive, flags: np.ndarray) -> dict[str, float]:
    """Seconds by name: moving, false, false_fast, settled, missed; and fastest, m/s."""
    step_s = np.clip(np.diff(drive.time, prepend=drive.time[0]), 0.0, 0.5)
    moving = drive.speed > MOVING
    restless = np.maximum.accumulate(np.where(drive.still, -np.inf, drive.time))
    settled = drive.still & (drive.time - np.maximum(restless, drive.time[0]) > SWING)
    return {'moving': step_s[moving].sum(), 'false': step_s[moving & flags].sum(),
            'false_fast': step_s[(drive.speed > FAST) & flags].sum(), 'settled': step_s[settled].sum(),
            'missed': step_s[settled & ~flags].sum(), 'fastest': np.nanmax(drive.speed[flags], initial=0.0)}


def judge(drive: Drive) -> tuple[str, dict]:
    """Name of the drive, and the detector's counts."""
    return drive.name, count(drive, flags_of(drive))


def of_scene(number: int, seed: int):
    return judge(simulated(number, seed))


def of_recording(name: str, data: Path):
    return judge(recorded(name, data))


def row(name: str, counts: dict) -> str:
    cells = [f'{counts[key]:.{digits}f}' for key, digits in (
        ('moving', 0), ('settled', 0), ('false', 1), ('false_fast', 1), ('fastest', 2), ('missed', 1))]
    return f'| {name} | {" | ".join(cells)} |'


def total(results) -> str:
    """All drives as one."""
    counts = [c for _, c in results]
    return row('all', {key: (max if key == 'fastest' else sum)(c[key] for c in counts) for key in counts[0]})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add('--data', type=Path, default=Path('../shared/data'))
    add('--seeds', type=int, default=20)
    add('--first-seed', type=int, default=3000)
    add('--processes', type=int, default=2)
    add('--output', type=Path)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.processes) as pool:
        made = [pool.submit(of_scene, i, options.first_seed + i) for i in range(options.seeds)]
        known = [pool.submit(of_recording, name, options.data) for name in RECORDED if (options.data / name).exists()]
        results = [job.result() for job in (*known, *made)]
    titles = ('drive', 'moving, s', 'at rest, s', 'false s', f'above {FAST:g} m/s', 'fastest, m/s', 'missed s')
    lines = [f'| {" | ".join(titles)} |', '|' + '---|' * len(titles), *(row(*result) for result in results),
             total(results)]
    print('\n'.join(lines))
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
