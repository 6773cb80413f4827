"""How well `configuration.speed_offset` finds how late a wheel speed is: realistic simulated drives.

    python studies/speed_offset.py [DRIVES [FIRST_SEED [SECONDS]]]
    python studies/speed_offset.py measured

Roads with grades, suspension, vibration, an IMU two metres in front of the axle and turned by what `configure`
leaves of its mounting (2 deg); wheels with a scale of 1 % and 0.05 m/s of noise, offsets of -0.4 to 0.6 s. What is
printed stands in docs/configure.md, "Wheel speed". SECONDS: the last ones of the drive alone.

measured: the IMUs of measured drives, with a speed made of the track, between one position and the next (RTK fixes at 4
Hz, a reference at 10 Hz), in the middle of the two, and late by some offset more.
"""
from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from mems_ins_fusion.configuration.mounting import estimate_mounting
from mems_ins_fusion.configuration.speed_offset import SHOWN, estimate_speed_offset
from mems_ins_fusion.filter.runs.usable import usable_fixes
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.motion import positions
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.samples import Speeds
from mems_ins_fusion.simulation.scene import SCENES
from mems_ins_fusion.simulation.simulation import SensorErrors, SimulatedAiding, simulate_recording

DATA = Path(__file__).resolve().parents[2] / 'shared' / 'data'
#: measured drives: topic of the reference; None: the fixes
TRACKS = {'longmont_rtk_drive': None, 'karlsruhe_hills': '/reference/fix'}
ADDED = 0.0, 0.4, -0.3  # s
#: s, of a drive
DURATION = 300.0
#: rad: by which the mounting that is given is wrong
MOUNTING = np.radians([2.0, -2.0, 2.0])


def quantized(speeds: Speeds, step: float) -> Speeds:
    """As a bus delivers them: in steps, and nothing below two of them."""
    rounded = np.round(speeds.speed / step) * step
    return replace(speeds, speed=np.where(np.abs(rounded) < 2.0 * step, 0.0, rounded))


def main(drives: int = 40, first_seed: int = 0, length: int = round(DURATION)) -> None:
    scene = replace(SCENES['realistic'], axle_to_imu=(2.0, 0.3, 0.5), mounting_error=0.0,
                    aiding=SimulatedAiding(speed_rate=10.0))
    values = {**table.defaults(), **scene.imu}
    found = []
    for seed in range(first_seed, first_seed + drives):
        offset = np.random.default_rng(seed).uniform(-0.4, 0.6)
        drive = scene.drive(DURATION, seed, 100.0)
        distortions = scene.distortions(seed)
        recording = simulate_recording(drive, SensorErrors.from_parameters(values, 'gauss_markov'), None,
                                       distortions.pop('effects'), seed=seed, **distortions).recording
        late = replace(recording.speed, stamp=recording.speed.stamp + round(offset * 1e9))
        since = recording.imu.stamp[0] + round((DURATION - length) * 1e9)
        imu, late = (samples.select(samples.stamp >= since) for samples in (recording.imu, late))
        seen = estimate_speed_offset(imu, quantized(late, 0.1 if seed % 2 else 0.01), rotation_from_rpy(*MOUNTING))
        if seen is None:
            print(f'drive {seed}: not shown')
            continue
        print(f'drive {seed}: {offset:.3f} s, found {seen.lag:.3f} +- {seen.lag_sigma:.3f} s')
        found.append((seen.lag - offset, seen.lag_sigma, seen.lag_sigma < SHOWN))
    error, sigma, shown = (np.array(column) for column in zip(*found))
    print(f'{len(found)} of {drives} drives, {shown.sum()} with sigma below 0.1 s')
    error, sigma = error[shown], sigma[shown]
    score = np.sqrt(((error / sigma)**2).mean())
    rms = np.sqrt((error**2).mean())
    print(f'error: mean {error.mean():.3f} s, RMS {rms:.3f} s, at most {np.abs(error).max():.3f} s; '
          f'sigma: median {np.median(sigma):.3f} s; RMS of error over sigma {score:.2f}')
    print(f'within 0.05 s: {(np.abs(error) < 0.05).mean():.0%}; '
          f'within 2 sigma: {(np.abs(error) < 2 * sigma).mean():.0%}')


def measured() -> None:
    for name, topic in TRACKS.items():
        folder = DATA / name / 'bag'
        recording = read_recording(folder if folder.is_dir() else DATA / name, '/imu/data', '/gps/fix', topic)
        found = estimate_mounting(recording.imu, usable_fixes(recording.gnss))
        track = recording.gnss if topic is None else recording.reference
        print(f'{name}: gnss.time_offset {found.offset.lag:.3f} +- {found.offset.lag_sigma:.3f} s')
        for added in ADDED:
            speeds = along(track, added)
            seen = estimate_speed_offset(recording.imu, speeds, found.rotation)
            print(f'{name}: {added} s added: {seen.lag:.3f} +- {seen.lag_sigma:.3f} s, low pass '
                  f'{seen.low_pass.tau:.2f} +- {seen.low_pass.sigma:.2f} s')


def along(track, late: float) -> Speeds:
    """Speeds between one position of `track` and the next, m/s, stamped in the middle and `late` s more."""
    step = np.diff(track.stamp)
    ways, near = np.hypot(*np.diff(positions(track), axis=0).T), (step > 0) & (step < 1.5 * np.median(step))
    stamp = (track.stamp[:-1] + step // 2 + round(late * 1e9))[near]
    return Speeds(stamp, stamp, ways[near] / (step[near] * 1e-9), np.full(near.sum(), 0.01))


if __name__ == '__main__':
    if sys.argv[1:] == ['measured']:
        measured()
    else:
        main(*map(int, sys.argv[1:]))
