"""How well a standstill is told from a smooth road, by the filter's detector and by one that learns from the vehicle.

    python studies/standstill.py [--data ../shared/data] [--seeds 20] [--first-seed 3000] [--processes 2]
                                 [--output FILE.md]

Truth of the measured drives: their RTK or reference positions, 3 s of motion around each instant; of the simulated ones
the speed itself. They differ in the IMU's rate, road, engine and vibration (SCENES below). The table counts seconds:
*false* ones, called a standstill while the vehicle moves (faster than 0.3 m/s), those of them above 1.5 m/s, and the
fastest instant; *missed* ones, not called one although it has stood for 3 s, in which a body on springs swings out.

Both detectors see the inertial samples alone: no speed and no fix says that there can be no standstill, as after a long
outage. The one that learns is told when the vehicle certainly moves (true speed above 2 m/s, which a filter knows
whenever it has fixes): it needs that to learn what motion looks like in this vehicle.

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
from mems_ins_fusion.filter.kernel import _is_still as is_still
from mems_ins_fusion.filter.layout import Sample, sample_at
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.navigation.frames import mounting
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.errors import RecordingWarning
from mems_ins_fusion.recordings.motion import valid_fixes
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

#: of the detector that learns. Low pass, running mean, running energy and duration: s
LOW_PASS, MEAN_TIME, ENERGY_TIME, DURATION = 0.2, 0.5, 0.7, 1.0
#: a standstill is quieter than the quietest motion by this factor at least, and may be louder than other standstills by
#: the same
SEPARATION = 2.0
#: the quietest motion is forgotten with this time constant, a standstill's level is a mean over this; s of motion, rest
FORGET, REST = 600.0, 5.0
#: what is expected of a vehicle of which nothing is known yet, m/s^2: it is learned within a minute
EXPECTED_MOTION, EXPECTED_REST = 0.05, 0.01
#: so far above the threshold a single sample ends a standstill
JUMP = 4.0
#: the state: force low-passed once and twice and its mean, energy, logs of the quietest motion and of rest, s of quiet
FIRST, SECOND, MEAN, ENERGY, MOTION, AT_REST, SINCE, SIZE = 0, 3, 6, 9, 10, 11, 12, 13


@numba.njit(cache=True)
def begin(state, f):
    """The state of the detector that learns before its first sample f (3,) m/s^2."""
    for i in range(3):
        state[FIRST + i] = state[SECOND + i] = state[MEAN + i] = f[i]
    state[ENERGY] = EXPECTED_MOTION**2
    state[MOTION], state[AT_REST] = math.log(EXPECTED_MOTION), math.log(EXPECTED_REST)
    state[SINCE] = 0.0


@numba.njit(cache=True)
def step(state, f, dt, moves):
    """Take in a sample f (3,) m/s^2, dt s after the one before; whether the vehicle stands.

    moves: whether the filter is certain that it does not. Causal, 13 numbers of state, about 60 operations a sample.
    """
    low, slow, energy = min(1.0, dt / LOW_PASS), min(1.0, dt / MEAN_TIME), 0.0
    for i in range(3):
        state[FIRST + i] += low * (f[i] - state[FIRST + i])
        state[SECOND + i] += low * (state[FIRST + i] - state[SECOND + i])
        deviation = state[SECOND + i] - state[MEAN + i]
        state[MEAN + i] += slow * deviation
        energy += deviation * deviation
    state[ENERGY] += min(1.0, dt / ENERGY_TIME) * (energy - state[ENERGY])
    level, separation = 0.5 * math.log(max(state[ENERGY], 1e-12)), math.log(SEPARATION)
    if moves:  # the least there is: down at once, though not by one sample alone, and up slowly
        state[MOTION] = min(state[MOTION] + dt / FORGET, max(level, state[MOTION] - 2.0 * dt))
    elif level < state[MOTION] - separation:
        state[AT_REST] += min(1.0, dt / REST) * (level - state[AT_REST])
    between = max(0.5 * (state[MOTION] + state[AT_REST]), state[AT_REST] + separation)
    threshold = min(between, state[MOTION] - separation)
    quiet = level < threshold and energy < JUMP**2 * math.exp(2.0 * threshold) and not moves
    state[SINCE] = state[SINCE] + dt if quiet else 0.0
    return state[SINCE] >= DURATION


@numba.njit(cache=True)
def learned(time, force, moves):
    """Flags (n,) of the detector that learns. time (n,) s, force (n, 3) m/s^2, moves (n,): as in `step`."""
    state, flags = np.zeros(SIZE), np.zeros(len(time), np.bool_)
    begin(state, force[0])
    for k in range(1, len(time)):
        flags[k] = step(state, force[k], max(time[k] - time[k - 1], 0.0), moves[k])
    return flags


@numba.njit
def _thresholds(memory, sample, time, body):
    flags = np.zeros(len(time), np.bool_)
    for k in range(1, len(time)):
        memory[sample + Sample.TIME] = time[k]
        for i in range(6):
            memory[sample + Sample.F_X + i] = body[k, i]
        flags[k] = is_still(memory, sample, time[k] - time[k - 1]) != 0.0
    return flags


def thresholds(time, body):
    """Flags (n,) of the filter's detector. time (n,) s. body (n, 6): samples in body axes, m/s^2 and rad/s."""
    memory = FilterConfig.from_parameters(table.check({'vehicle.zero_velocity': True})).memory()
    return _thresholds(memory, sample_at(memory, 1), time, body)


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
    truth = recording.reference or recording.gnss.select(valid_fixes(recording.gnss))
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


def judge(drive: Drive) -> tuple[str, dict, dict]:
    """Name of the drive, and the counts of the two detectors."""
    moves = drive.speed > SURELY
    return (drive.name, count(drive, thresholds(drive.time, drive.body)),
            count(drive, learned(drive.time, np.ascontiguousarray(drive.body[:, :3]), moves)))


def of_scene(number: int, seed: int):
    return judge(simulated(number, seed))


def of_recording(name: str, data: Path):
    return judge(recorded(name, data))


def row(name: str, *counts: dict) -> str:
    cells = [f'{counts[0]["moving"]:.0f}', f'{counts[0]["settled"]:.0f}']
    for c in counts:
        cells += [f'{c["false"]:.1f}', f'{c["false_fast"]:.1f}', f'{c["fastest"]:.2f}', f'{c["missed"]:.1f}']
    return f'| {name} | {" | ".join(cells)} |'


def total(results) -> str:
    """All drives as one."""
    sums = [{key: (max if key == 'fastest' else sum)(c[key] for c in counts) for key in counts[0]}
            for counts in zip(*(counts for _, *counts in results))]
    return row('all', *sums)


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
    titles = [f'{detector}: {text}' for detector in ('thresholds', 'learned')
              for text in ('false s', f'above {FAST:g} m/s', 'fastest, m/s', 'missed s')]
    lines = [f'| drive | moving, s | at rest, s | {" | ".join(titles)} |', '|' + '---|' * (3 + len(titles)),
             *(row(*result) for result in results), total(results)]
    print('\n'.join(lines))
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
