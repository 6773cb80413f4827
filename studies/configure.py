"""How well `configure` finds mountings: simulated short drives, and measured recordings turned in every way.

    python studies/configure.py drives RESULTS.csv [--drives 100] [--first 0] [--any-fixes] [--diagnose] [--second]
    python studies/configure.py drives RESULTS.csv --rates 0.2 0.5 1 2 5 10 20 [the same]
    python studies/configure.py slow --drives 12 --first 7701
    python studies/configure.py joint --drives 180 --first 56501
    python studies/configure.py bias --drives 25 --first 58214 [--stays 0.03]
    python studies/configure.py simulated [--drives 100]
    python studies/configure.py measured DATA
    python studies/configure.py evidence DATA

drives: cars on roads, receivers that smooth, rovers at walking speed, phones of 10 Hz whose samples alias; offsets,
arms and mountings drawn at random: what `configure` writes, and with --diagnose what `diagnose` makes of it, and of the
mounting by hand; each against the truth. A line of RESULTS.csv each; those that are there are not run again. With
--any-fixes receivers of 0.2, 1, 5 and 10 Hz in turn, each second one with gaps of some seconds; with --rates of those
rates, Hz, and, where nothing is run with the file, IMUs in g and deg/s, too. With --second the file of `configure`, and
one by hand, on a second drive of the same vehicle, with other biases: errors against the truth.
slow: robots at 0.4 m/s that turn on the spot, with twelve receivers, on level ground and with everything that
`simulate --drive realistic` has: what is said of the mounting after some minutes, as the live node looks at it.
bias: what gyroscope.bias of a drive is worth on two others, whose turn-on biases are others; --stays: rad/s, standard
deviation of a part that is the same in all of them.
joint: the time offset with the antenna's arm unknown, as `configure` tells it, and with the arm that is in its file.
simulated: two minutes with a standstill, one right-angled turn and one stop, on hilly roads, in cars with suspension,
IMUs in arbitrary positions, five receivers; the error of the mounting over its sigma. measured: each recording with its
IMU turned by the 24 right-angled rotations and 20 arbitrary ones, in g and deg/s. evidence: whether a
filter without any constraint points where the vehicle goes.
docs/configure.md holds the results.
"""
from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
from diagnosis_on_roads import SECOND_DRIVE, TRUTH, errors
from diagnosis_on_roads import measured as measured_errors
from scipy.spatial.transform import Rotation

from mems_ins_fusion.configuration.check import compare_mounting
from mems_ins_fusion.configuration.configure import Configuration, configured, evidence_of_recording
from mems_ins_fusion.configuration.mounting import deviation, estimate_mounting, rpy
from mems_ins_fusion.configuration.topics import Candidate, Topics
from mems_ins_fusion.diagnosis.diagnose import diagnose
from mems_ins_fusion.diagnosis.findings import Diagnosis
from mems_ins_fusion.diagnosis.problem import DiagnosisError
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.intervals import interval_of_share
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.navigation.frames import rotation_from_rpy, wrap
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.remarks import ERROR
from mems_ins_fusion.recordings.units import as_delivered, find_units, in_si
from mems_ins_fusion.reports.configuration import doubts
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation import drive
from mems_ins_fusion.simulation.drive import MARGIN, _random_hills, follow, stream
from mems_ins_fusion.simulation.manoeuvres import Segment, _speed_change
from mems_ins_fusion.simulation.scene import FLAT, REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

#: receivers: sigma of a fix, m, and fixes per second
RECEIVERS = ((0.02, 5.0), (0.3, 5.0), (1.0, 1.0), (1.5, 1.0), (1.5, 5.0))


def short_drive(seed: int, rate=100.0):
    """Two minutes: 15 s at rest, off, straight on, a right-angled turn, straight on, a stop, off again."""
    draw = stream(seed, 'configure')
    cruise, corner, last = draw.uniform(8, 15), draw.uniform(4, 8), draw.uniform(8, 15)
    turn = draw.choice([-1.0, 1.0]) * np.pi / 2
    segments = [Segment(15.0), _speed_change(0.0, cruise, draw.uniform(1.0, 2.0)), Segment(15.0),
                _speed_change(cruise, corner, draw.uniform(1.0, 2.0)), Segment(round(6.0 * 6.0 / corner, 1), 0.0, turn),
                _speed_change(corner, cruise, draw.uniform(1.0, 2.0)), Segment(15.0),
                _speed_change(cruise, 0.0, draw.uniform(1.0, 2.0)), Segment(8.0),
                _speed_change(0.0, last, draw.uniform(1.0, 2.0))]
    segments.append(Segment(120.0 + MARGIN - sum(segment.duration for segment in segments)))
    road = drive.Path(tuple(segments), course=draw.uniform(-np.pi, np.pi), hills=_random_hills(draw),
                pitch_per_acceleration=draw.uniform(0.0, 0.01), roll_per_acceleration=draw.uniform(0.0, 0.01))
    return follow(road, 120.0, rate)


def short_recording(seed: int):
    """A recording of `short_drive` and the true rotation to base_link."""
    true = Rotation.random(random_state=seed).as_matrix()
    sigma, rate = RECEIVERS[seed % len(RECEIVERS)]
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    simulation = simulate_recording(short_drive(seed), sensors, GnssNoise(sigma, rate), mounting_rpy=rpy(true),
                                    seed=seed)
    return simulation.recording, true


def one_drive(seed: int):
    """Error and sigma of the mounting, rad, about forward, left and up."""
    recording, true = short_recording(seed)
    found = estimate_mounting(recording.imu, recording.gnss)
    return np.concatenate([deviation(found.rotation, true), found.sigma])


def simulated(drives: int, processes: int):
    with ProcessPoolExecutor(processes) as pool:
        rows = np.array(list(pool.map(one_drive, range(drives))))
    error, sigma = rows[:, :3], rows[:, 3:]
    for number, (noise, rate) in enumerate(RECEIVERS):
        show(f'{noise:g} m, {rate:g} Hz', error[number::len(RECEIVERS)], sigma[number::len(RECEIVERS)])
    show('all', error, sigma)


def show(name, error, sigma):
    """A row of the table: RMS errors, and how they compare with the sigmas."""
    known = sigma[:, 2] < np.radians(20.0)
    score = error / sigma
    level, yaw = error[:, :2], error[known, 2]
    print(f'| {name} | {len(error)} | {rms(level):.2f} | {np.degrees(np.abs(level).max()):.2f} | '
          f'{np.sqrt((score[:, :2]**2).mean()):.2f} | {(np.abs(score[:, :2]) < 2).mean():.0%} | {known.sum()} | '
          f'{rms(yaw):.2f} | {np.degrees(np.abs(yaw).max()):.2f} | {np.sqrt((score[known, 2]**2).mean()):.2f} | '
          f'{(np.abs(score[known, 2]) < 2).mean():.0%} |')


def rms(angles) -> float:
    return float(np.degrees(np.sqrt((angles**2).mean())))


#: recording, topic of the fixes, and the axes that its README tells: rotation to forward-left-up, deg
MEASURED = (('longmont_rtk_drive/bag', '/gps/fix', (0, 0, 180)), ('karlsruhe_hills/bag', '/gps/fix', (0, 0, 0)),
            ('karlsruhe_hills/bag', '/reference/fix', (0, 0, 0)), ('incheon_square_ros2/bag', '/fix', (180, 0, 0)),
            ('incheon_park_ros2/bag_0.db3', '/fix', (0, 0, 0)), ('incheon_static_ros2/bag', '/gps/fix', (0, 0, 0)),
            ('kingston_span/bag', '/gps/fix', (0, 0, -90)), ('kingston_span/bag', '/reference/fix', (0, 0, -90)))


PARTS = 'error', 'sigma'
#: columns of what a diagnosis sets or only tells, of its answer, and of the mean of the largest error in outages, m
SETTINGS = tuple(f'{name}_set' for name in ('gnss.time_offset', 'gnss.lever_arm', 'imu.mounting_rpy'))
DIAGNOSED = ('answer', *SETTINGS, *(f'{when}_{s}' for when in ('before', 'after') for s in (10, 30, 60)))
#: RMS with all fixes, and mean largest error in 10, 30 and 60 s without, m; NaN where the filter never starts
SECOND = tuple(f'second_{what}_{way}' for way in ('configure', 'by_hand') for what in ('fixes', 10, 30, 60))
KINDS = ('car', 'car, RTK', 'car, smoothing', 'rover', 'phone')
#: receivers of the rovers
ROVER_FIXES = GnssNoise(0.02, 5.0), GnssNoise(0.3, 1.0)
ANY_RATE = 0.2, 1.0, 5.0, 10.0  # Hz, of the receivers with --any-fixes
GAPS = 30.0  # an hour, of 3 to 40 s each, with --any-fixes and --rates
UNITS = tuple(product(('m/s^2', 'g'), ('rad/s', 'deg/s')))  # of the IMUs, in turn, with --rates
LARGEST_OFFSET, FELT_OFFSET, FELT_ANGLE = 1.0, 0.1, 3.0  # s, s, deg
UPRIGHT = 6.0  # deg, about each axis: a box that somebody has put in a car
#: of motorways. m, smallest radius of a bend, at its middle
TIGHTEST_BEND = 600.0
#: mean of the turn rate in a segment over that at its middle, where it is largest: the course is a quintic polynomial
MEAN_OF_BEND = 8 / 15
#: rad per m/s^2 by which a car pitches as it speeds up, and rolls in bends: about those of REALISTIC (0.35 and 0.4 deg)
PITCH, ROLL = 0.006, 0.007


@dataclass(frozen=True)
class Case:
    """One drive of the study `drives`, and the truth of it: time offset, s, mounting (3, 3), arm (3,) m."""

    kind: str
    recording: Recording
    offset: float
    rotation: np.ndarray
    arm: np.ndarray


def case(number: int, upright: bool = False, duration: float = 600.0, any_fixes: bool = False,
         second: int = 0, rates: Sequence[float] = (), fast: bool = False,
         bias: Sequence[float] = (0.0, 0.0, 0.0)) -> Case:
    """upright: the IMU sits about as its axes say, off by some degrees; else anyhow. duration: s, at most. any_fixes:
    receivers of ANY_RATE, each second one with gaps, instead of the kind's own rate. rates: the same with these, Hz.
    second: which other drive of this vehicle, with the truth; 0: the first drive. fast: on a motorway.
    bias: rad/s, of the gyroscopes, beside that of each start."""
    seed = number + SECOND_DRIVE * second
    kind, draw = KINDS[number % len(KINDS)], stream(number, 'estimator')
    if fast and kind == 'rover':
        raise ValueError(f'drive {number} is of a rover, which drives on no motorway')
    offset = float(draw.uniform(-LARGEST_OFFSET, LARGEST_OFFSET))
    arm = np.array([draw.uniform(-1.5, 1.5), draw.uniform(-0.5, 0.5), draw.uniform(0.2, 1.5)])
    rotation = (Rotation.from_euler('xyz', stream(number, 'upright').uniform(-UPRIGHT, UPRIGHT, 3), degrees=True)
                if upright else Rotation.random(random_state=number)).as_matrix()
    sensors = replace(SensorErrors.from_parameters(table.check({} if kind == 'phone' else REALISTIC.imu),
                                                   'gauss_markov'), gyroscope_bias=tuple(bias))
    vibration = REALISTIC.distortions(seed)['vibration']
    receiver = {'car': GnssNoise(1.5, 1.0), 'car, RTK': GnssNoise(0.02, 5.0),
                'car, smoothing': GnssNoise(1.5, 1.0, smoothing=float(draw.uniform(0.6, 1.5)), coloured_sigma=1.0,
                                            outliers=0.01),
                'rover': ROVER_FIXES[number // len(KINDS) % 2],
                'phone': GnssNoise(2.0, 1.0, coloured_sigma=2.0)}[kind]
    turn = number // len(KINDS)
    if rates:
        receiver = replace(receiver, rate=rates[turn % len(rates)], dropouts=GAPS * (turn % 2))
    elif any_fixes:
        receiver = replace(receiver, rate=ANY_RATE[turn % len(ANY_RATE)],
                           dropouts=GAPS * (turn // len(ANY_RATE) % 2))
    if kind == 'rover':
        motion, vibration, arm = rover(seed, min(duration, 400.0)), None, 0.3 * arm
    else:
        seconds = min(duration, 400.0 if kind == 'car, RTK' else 600.0)
        motion = motorway(seed, seconds) if fast else replace(REALISTIC, mounting_error=0.0).drive(seconds, seed)
    effects = [(EFFECTS['gnss_time_offset'], {'time_offset': offset}),
               (EFFECTS['gnss_lever_arm'], dict(zip('xyz', arm.tolist())))]
    made = simulate_recording(motion, sensors, receiver, effects, rpy(rotation), seed, vibration=vibration,
                              name=f'drive {number}').recording
    if kind == 'phone':  # each tenth sample as it is: what shakes faster than 5 Hz aliases
        made = replace(made, imu=made.imu.select(slice(0, None, 10)))
    made = replace(made, reference=made.reference if second else None, speed=None, velocity=None, heading=None)
    return Case(kind, made, offset, rotation, arm)


def rover(seed: int, duration: float = 400.0):
    """A drive at walking speed."""
    draw = stream(seed, 'rover')
    segments, speed = [Segment(15.0)], 0.0
    while sum(segment.duration for segment in segments) < duration + MARGIN:
        kind = draw.integers(4)
        if kind == 0:
            new = [_speed_change(speed, draw.uniform(0.4, 1.5), 0.4), Segment(round(draw.uniform(2, 10), 1))]
        elif kind == 1 and speed > 0.2:
            new = [Segment(round(draw.uniform(3, 6), 1), 0.0, draw.uniform(0.3, 2.0) * draw.choice([-1, 1])),
                   Segment(round(draw.uniform(2, 6), 1))]
        elif kind == 2 and speed > 0.2:
            new = [_speed_change(speed, 0.0, 0.4), Segment(round(draw.uniform(3, 10), 1)),
                   _speed_change(0.0, draw.uniform(0.5, 1.3), 0.4)]
        else:
            new = [Segment(round(draw.uniform(2, 8), 1))]
        segments += new
        speed += sum(segment.speed_change for segment in new)
    return follow(drive.Path(tuple(segments), course=draw.uniform(-np.pi, np.pi), axle_to_imu=(0.3, 0.0, -0.2),
                             rotating_earth=True, **_uneven(seed)), duration, 50.0)


def _uneven(seed: int) -> dict:
    return {name: drive._random_waves(share, lengths, False, stream(seed, of)) for name, of, share, lengths in (
        ('hills', 'grade', 0.03, (190.0, 70.0, 26.0)), ('banks', 'bank', 0.02, (110.0, 37.0, 13.0)))}


def motorway(seed: int, duration: float):
    """Off from rest, three crossings, then a motorway at 25 to 38 m/s with bends of 600 m and more."""
    draw = stream(seed, 'motorway')
    segments, speed = [Segment(15.0), _speed_change(0.0, 12.0, 1.5), Segment(8.0)], 12.0
    for _ in range(3):
        segments += [_speed_change(12.0, 6.0, 2.0), Segment(5.0, 0.0, draw.choice([-1.0, 1.0]) * np.pi / 2),
                     _speed_change(6.0, 12.0, 1.5), Segment(round(draw.uniform(4, 8), 1))]
    while sum(segment.duration for segment in segments) < duration + MARGIN:
        new = draw.uniform(25.0, 38.0)
        bend = round(draw.uniform(8, 20), 1)
        angle = draw.uniform(-1.0, 1.0) * new / TIGHTEST_BEND * bend * MEAN_OF_BEND
        segments += [_speed_change(speed, new, draw.uniform(0.6, 1.5)), Segment(round(draw.uniform(3, 20), 1)),
                     Segment(bend, 0.0, angle)]
        speed = new
    return follow(drive.Path(tuple(segments), course=draw.uniform(-np.pi, np.pi), axle_to_imu=(1.2, 0.3, -0.5),
                             pitch_per_acceleration=PITCH, roll_per_acceleration=ROLL, rotating_earth=True,
                             **_uneven(seed)), duration, 100.0)


def what_is_found(of: Case, units: tuple[str, str] = UNITS[0]) -> Configuration:
    """What `configure` finds in the drive, its IMU in these units."""
    imu, fixes = as_delivered(of.recording.imu, *units), of.recording.gnss
    topics = Topics(*((Candidate(topic, len(samples), 1.0, 0.0, 1.0, False, samples),)
                      for topic, samples in (('/imu/data', imu), ('/gps/fix', fixes))), ())
    return configured(topics, [evidence_of_recording(of.recording.name, imu, fixes)], [fixes])


def one_joint(number: int) -> list | None:
    """Kind; errors of the time offset, s, with the arm unknown and with that of the file; its sigma with the arm
    unknown; squared errors of the arm forward and left, m^2, in the file and as estimated. None without an offset."""
    of = case(number, upright=True, duration=300.0, any_fixes=True)
    found = what_is_found(of)
    offset = found.mounting.offset if found.mounting is not None else None
    if offset is None or not offset.shown:
        return None
    covariance = np.linalg.inv(offset.basis.information)
    scale = offset.basis.sigmas / np.sqrt(np.diag(covariance))
    covariance *= np.outer(scale, scale)
    written = np.array(found.values['gnss.lever_arm'])
    given = covariance[0, 1:4] @ np.linalg.solve(covariance[1:4, 1:4], written - offset.arm)
    arms = [np.mean((arm - of.arm)[:2] ** 2) for arm in (written, offset.arm)]
    return [of.kind, offset.lag - of.offset, offset.lag + given - of.offset, offset.lag_sigma, *arms]


def joint(drives: int, first: int, processes: int):
    with ProcessPoolExecutor(processes) as pool:
        rows = [row for row in pool.map(one_joint, range(first, first + drives)) if row is not None]
    for kind in (*KINDS, 'all'):
        unknown, given, sigma, written, estimated = np.array([row[1:] for row in rows if kind in (row[0], 'all')]).T
        print(f'| {kind} | {len(sigma)} | {np.sqrt((unknown**2).mean()):.3f} | {held(unknown, sigma)} | '
              f'{np.sqrt((given**2).mean()):.3f} | {np.sqrt(written.mean()):.2f} | {np.sqrt(estimated.mean()):.2f} |')


def bias(drives: int, first: int, stays: float):
    """The errors on other drives with the bias that the standstills of the first one show, without it, and as
    `configure` decides."""
    print('| vehicle | bias at rest in its first drive, rad/s | on two others, RMS with fixes / mean largest error in '
          '10 / 30 / 60 s without, m: with this bias | without one | as configure decides |\n|---|---|---|---|---|')
    for number in range(first, first + drives):
        same = stays * stream(number, 'stable').standard_normal(3)
        of = case(number, upright=True, duration=300.0, any_fixes=True, bias=same)
        found = what_is_found(of)
        if found.drives[0].noise is None:
            continue
        others = [case(number, upright=True, duration=300.0, any_fixes=True, second=k, bias=same).recording
                  for k in (1, 2)]
        shown, rows = found.drives[0].noise.bias, []
        for written in (shown.tolist(), [0.0], found.values['gyroscope.bias']):
            values = table.check({**found.values, 'gyroscope.bias': written, **TRUTH})
            rows.append(' / '.join(f'{error:.2g}' for error in np.mean(
                [measured_errors(errors(values, other)) for other in others], axis=0)))
        print(f'| {number}, {of.kind} | {", ".join(f"{b:.3f}" for b in shown)} | {" | ".join(rows)} |', flush=True)


def one_case(task) -> list[dict]:
    """What `configure` says of a drive, and `diagnose` after it and by hand; a row each."""
    number, diagnosed, any_fixes, second, rates = task
    of = case(number, any_fixes=any_fixes, rates=rates)
    units = UNITS[number % len(UNITS)] if rates and not (diagnosed or second) else UNITS[0]
    found = what_is_found(of, units)
    offset = found.mounting.offset
    shown = offset is not None and offset.shown
    rows = [row(of, number, 'configure', found.values, offset.lag if shown else 0.0,
                offset.lag_sigma if shown else np.inf, sigmas=np.degrees(found.mounting.sigma),
                ready=not doubts(found),
                arm=offset.arm - of.arm if shown else np.full(3, np.nan),
                arm_sigma=offset.arm_sigma if shown else np.full(3, np.nan),
                units=all({**table.defaults(), **found.values}[f'imu.{name}_unit'] == unit
                          for name, unit in zip(('acceleration', 'rate'), units)))]
    by_hand = table.check({'imu.mounting_rpy': np.radians(np.round(np.degrees(rpy(of.rotation)))).tolist()})
    if second:
        other = case(number, any_fixes=any_fixes, second=True, rates=rates).recording
        rows[0] |= dict(zip(SECOND, (error for values in (found.values, by_hand) for error in measured_errors(
            errors(table.check({**values, **TRUTH}), other)))))
    for way, values in (('configure, diagnose', table.check(found.values)), ('by hand, diagnose', by_hand)):
        if not diagnosed:
            continue
        try:
            result = diagnose(of.recording, values)
        except DiagnosisError as error:
            print(f'drive {number}, {way}: {error}')
            continue
        rows.append(diagnosed_row(of, number, way, values, result))
    return rows


def diagnosed_row(of: Case, number: int, way: str, given: dict, result: Diagnosis) -> dict:
    """What a diagnosis says, set or only told; where it says nothing, the error is that of the file, the sigma NaN."""
    values, sigmas, certain = result.corrected, {}, {}
    for finding in result.findings:
        known = {name: e for name, e in finding.parameters.items() if e.known}
        if finding.name in ('gnss_time_offset', 'gnss_lever_arm', 'mounting_rotation') and known:
            effect = EFFECTS[finding.name]
            said = effect.adjusted(given, {p.name: known[p.name].value if p.name in known else 0.0
                                           for p in effect.parameters})
            name, = (name for name in said if said[name] != given[name])
            values = {**values, name: said[name]}
            certain[f'{name}_set'] = finding.added
            sigmas |= {f'{finding.name}.{parameter}': e.sigma for parameter, e in known.items()}
    sigma = {effect: np.array([sigmas.get(f'{effect}.{axis}', np.nan) for axis in axes]) for effect, axes in (
        ('gnss_lever_arm', 'xyz'), ('mounting_rotation', ('roll', 'pitch', 'yaw')))}
    said = row(of, number, way, values, values['gnss.time_offset'], sigmas.get('gnss_time_offset.time_offset', np.nan),
               np.degrees(sigma['mounting_rotation']), result.better,
               np.array(values['gnss.lever_arm']) - of.arm, sigma['gnss_lever_arm'])
    return {**said, 'set_error': result.corrected['gnss.time_offset'] - of.offset, 'answer': result.verdict.answer,
            **{name: certain.get(name, '') for name in SETTINGS},
            **{f'{when}_{o["duration_s"]:g}': o['max_error_mean_m'] for when, measured in (
                ('before', result.before), ('after', result.after)) for o in measured.summary()['outages']}}


def row(of: Case, number, way, values, lag, lag_sigma, sigmas=(np.nan,) * 3, ready=False, arm=(np.nan,) * 3,
        arm_sigma=(np.nan,) * 3, units=True) -> dict:
    away = np.degrees(deviation(rotation_from_rpy(*values['imu.mounting_rpy']), of.rotation))
    return {'number': number, 'kind': of.kind, 'way': way, 'offset': of.offset, 'error': lag - of.offset,
            'sigma': lag_sigma, 'set_error': values['gnss.time_offset'] - of.offset, 'ready': ready, 'units': units,
            **{f'{name}_error': error for name, error in zip(('roll', 'pitch', 'yaw'), away)},
            **{f'{name}_sigma': sigma for name, sigma in zip(('roll', 'pitch', 'yaw'), sigmas)},
            **{f'arm_{name}_error': error for name, error in zip('xyz', arm)},
            **{f'arm_{name}_sigma': sigma for name, sigma in zip('xyz', arm_sigma)}}


def drives(path: Path, count: int, first: int, diagnosed: bool, any_fixes: bool, second: bool, rates: Sequence[float],
           processes: int):
    there = list(csv.DictReader(path.open())) if path.exists() else []
    known = {int(line['number']) for line in there}
    tasks = [(number, diagnosed, any_fixes, second, rates) for number in range(first, first + count)
             if number not in known]
    with ProcessPoolExecutor(processes) as pool, path.open('a', newline='') as file:
        for rows in pool.map(one_case, tasks):
            writer = csv.DictWriter(file, dict.fromkeys((*rows[0], *DIAGNOSED, *SECOND)), restval='')
            if file.tell() == 0:
                writer.writeheader()
            writer.writerows(rows)
            file.flush()
    rows = list(csv.DictReader(path.open()))
    summary(rows)
    second_drives(rows)


def summary(rows: list[dict]):
    """The table of docs/configure.md: what is within two sigma, and what is ready and off by more than is felt."""
    for way in dict.fromkeys(r['way'] for r in rows):
        for kind in (*KINDS, 'all'):
            chosen = [r for r in rows if r['way'] == way and kind in (r['kind'], 'all')]
            number = {name: np.array([float(r[name]) for r in chosen]) for name in chosen[0]
                      if name.endswith(('error', 'sigma'))} if chosen else {}
            if not chosen:
                continue
            ready = np.array([r['ready'] == 'True' for r in chosen])
            turned = np.stack([number[f'{axis}_error'] for axis in ('roll', 'pitch', 'yaw')])
            off = (np.abs(number['set_error']) > FELT_OFFSET) | (np.abs(turned) > FELT_ANGLE).any(axis=0)
            print(f"| {way} | {kind} | {len(chosen)} | {held(number['error'], number['sigma'])} | "
                  f"{held(turned, np.stack([number[f'{axis}_sigma'] for axis in ('roll', 'pitch', 'yaw')]))} | "
                  f"{held(*(np.stack([number[f'arm_{axis}_{part}'] for axis in 'xyz']) for part in PARTS))} | "
                  f"{np.median(np.abs(number['set_error'])):.3f} | {np.abs(number['set_error']).max():.2f} | "
                  f'{ready.sum()} | {(ready & off).sum()} |')
    print(f"units found: {sum(r['units'] == 'True' for r in rows)} of {len(rows)}")


def second_drives(rows: list[dict]):
    """Files on the second drive of the same vehicle: how many filters started, and their errors."""
    there = [row for row in rows if row.get(SECOND[0])]
    for kind in (*KINDS, 'all') if there else ():
        chosen = np.array([[float(row[name]) for name in SECOND] for row in there if kind in (row['kind'], 'all')])
        if not len(chosen):
            continue
        for way, found in zip(('configure', 'by hand'), np.split(chosen, 2, axis=1)):
            started = np.isfinite(found[:, 0])
            medians = ' | '.join(f'{np.nanmedian(e):.2f}' if np.isfinite(e).any() else '-' for e in found.T)
            print(f'| {way} | {kind} | {len(found)} | {(~started).sum()} | {medians} |')


def held(error, sigma) -> str:
    """How many of the errors lie within two sigma, the 95 % interval of that share, and the root mean square of their
    ratio."""
    known = np.isfinite(sigma)
    if not known.any():
        return '-'
    score = error[known] / sigma[known]
    within = int((np.abs(score) < 2.0).sum())
    low, high = interval_of_share(within, score.size)
    return f'{within} of {score.size} ({low:.0%} to {high:.0%}), {np.sqrt((score**2).mean()):.2f}'


#: receivers of `slow`: sigma of a fix, m, and fixes per second
SLOW_FIXES = tuple(product((0.02, 0.1, 0.5, 1.5), (1.0, 5.0, 10.0)))
LOOKS = 60, 90, 120, 240, 480, 600  # s after the start, at which a live node or a replay looks
KEPT = 240  # s that a live node keeps


def slow_drive(seed: int) -> list[tuple]:
    """Sigma of the receiver, time of the look, error and sigma of the yaw, deg, NaN where it is not shown, and whether
    an ERROR is said: of each receiver and look."""
    rows = []
    for scene in (FLAT, REALISTIC):
        scene = replace(scene, manoeuvres='slow', mounting_error=0.0)
        motion, shaking = scene.drive(606.0, seed, 50.0, standstill=25.0), scene.distortions(seed)['vibration']
        sensors = SensorErrors.from_parameters(table.check(scene.imu), 'gauss_markov')
        for sigma, rate in SLOW_FIXES:
            made = simulate_recording(motion, sensors, GnssNoise(sigma, rate), seed=seed, vibration=shaking).recording
            for look_at in LOOKS:
                begin, end = (made.imu.stamp[0] + int(1e9 * at) for at in (
                    look_at - KEPT if look_at < LOOKS[-1] else 0.0, look_at))
                imu, fixes = (samples.select((samples.stamp > begin) & (samples.stamp < end))
                              for samples in (made.imu, made.gnss))
                findings, found = compare_mounting(imu, fixes, table.defaults(), 0.0)
                known = found is not None and found.yaw_known
                rows.append((sigma, look_at, np.degrees(found.rpy[2]) if known else np.nan,
                             np.degrees(found.sigma[2]) if known else np.nan,
                             any(finding.severity == ERROR for finding in findings)))
    return rows


def slow(drives: int, first: int, processes: int):
    with ProcessPoolExecutor(processes) as pool:
        rows = np.array([row for rows in pool.map(slow_drive, range(first, first + drives)) for row in rows], float)
    groups = [(f'{sigma:g} m', rows[:, 0] == sigma) for sigma in dict.fromkeys(s for s, _ in SLOW_FIXES)]
    groups += [(f'after {at} s', rows[:, 1] == at) for at in LOOKS] + [('all', np.ones(len(rows), bool))]
    for name, chosen in groups:
        _, _, error, sigma, wrong = rows[chosen].T
        score = np.abs(error / sigma)[np.isfinite(sigma)]
        print(f'| {name} | {chosen.sum()} | {len(score)} | {held(error, sigma)} | {(score > 4.0).sum()} | '
              f'{int(wrong.sum())} |', flush=True)


def turns() -> list[np.ndarray]:
    """The 24 right-angled rotations and 20 arbitrary ones."""
    right = [np.array([[sign[i] * (j == order[i]) for j in range(3)] for i in range(3)], float)
             for order in permutations(range(3)) for sign in product((1, -1), repeat=3)]
    return [matrix for matrix in right if np.linalg.det(matrix) > 0] + list(
        Rotation.random(20, random_state=15).as_matrix())


def turned(imu, rotation, acceleration=1.0, rate=1.0):
    """What the same IMU records when it is mounted otherwise, in other units."""
    return replace(imu, specific_force=imu.specific_force @ rotation.T * acceleration,
                   angular_rate=imu.angular_rate @ rotation.T * rate)


def one_turn(task):
    """Error of the mounting of a turned IMU in g and deg/s against what `straight` makes of it; whether units fit.

    The time offset is that of the recording as it is, which a rotation does not change: the search takes longest.
    """
    imu, fixes, straight, rotation = task
    imu = turned(imu, rotation, 1 / STANDARD_GRAVITY, 180 / np.pi)
    units = find_units(imu, fixes, STANDARD_GRAVITY)
    found = estimate_mounting(in_si(imu, units.acceleration, units.rate), fixes, lag=straight.lag)
    return deviation(found.rotation, straight.rotation @ rotation.T), (units.acceleration, units.rate) == ('g', 'deg/s')


def measured(data: Path):
    for name, topic, axes in MEASURED:
        recording = read_recording(data / name, '/imu/data', topic)
        imu, fixes = recording.imu, recording.gnss
        found = estimate_mounting(imu, fixes)
        angles, sigma = np.degrees(found.rpy), np.degrees(found.sigma)
        nominal = Rotation.from_euler('xyz', axes, degrees=True).as_matrix()
        away = np.degrees(deviation(found.rotation, nominal))
        errors, right = zip(*(one_turn((imu, fixes, found, rotation)) for rotation in turns()))
        errors = np.degrees(np.abs(errors))
        yaw = f'{angles[2]:.1f} ± {sigma[2]:.1f}' if found.yaw_known else 'not shown'
        lag = f'{found.lag:.3f} ± {found.lag_sigma:.3f}' if found.lag_sigma < 0.3 else 'not shown'
        worst_yaw = f'{errors[:, 2].max():.2f}' if found.yaw_known else '–'
        print(f'| {name.split("/")[0]}, {topic} | {angles[0]:.1f} ± {sigma[0]:.1f} | '
              f'{angles[1]:.1f} ± {sigma[1]:.1f} | {yaw} | {away[0]:.1f}, {away[1]:.1f}, {away[2]:.1f} | {lag} | '
              f'{errors[:, :2].max():.2f} | {worst_yaw} | {sum(right)} of {len(right)} |', flush=True)


def evidence(data: Path):
    """Attitude of a strapdown filter that is told the mounting but no constraint, against course and grade."""
    from mems_ins_fusion.filter.config import FilterConfig
    from mems_ins_fusion.filter.runs.replay import run

    for name, topic, _ in MEASURED:
        recording = read_recording(data / name, '/imu/data', topic)
        found = estimate_mounting(recording.imu, recording.gnss)
        if not found.yaw_known:
            continue
        values = table.check({'mechanization': 'strapdown', 'imu.mounting_rpy': found.rpy.tolist(),
                              'gnss.time_offset': found.lag, 'gnss.robust_sigma': 3.0,
                              'vehicle.non_holonomic': False, 'vehicle.zero_velocity': False})
        result = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss)
        time = (result.stamp - result.stamp[0]) * 1e-9
        steady = np.abs(np.gradient(np.unwrap(result.yaw), time)) < 0.03
        speed = np.hypot(result.velocity[:, 0], result.velocity[:, 1])
        used = steady & (speed > max(1.0, 0.5 * np.percentile(speed, 90))) & (time > 60.0)
        slip = wrap(np.arctan2(result.velocity[:, 1], result.velocity[:, 0]) - result.yaw)[used]
        stretches = [part.mean() for part in np.array_split(slip, max(len(slip) // 1000, 2))]
        print(f'{name}, {topic}: course minus heading of the filter {np.degrees(np.mean(stretches)):+.2f} +- '
              f'{np.degrees(np.std(stretches) / np.sqrt(len(stretches))):.2f} deg in {used.sum()} samples straight on')


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('what', choices=('drives', 'slow', 'joint', 'bias', 'simulated', 'measured', 'evidence'))
    parser.add_argument('data', nargs='?', type=Path, help='folder of the measured recordings, or RESULTS.csv')
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--diagnose', action='store_true')
    parser.add_argument('--any-fixes', action='store_true')
    parser.add_argument('--second', action='store_true')
    parser.add_argument('--rates', type=float, nargs='+', default=())
    parser.add_argument('--stays', type=float, default=0.0)
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--drives', type=int, default=100)
    options = parser.parse_args()
    if options.what == 'drives':
        drives(options.data, options.drives, options.first, options.diagnose, options.any_fixes, options.second,
               options.rates, options.processes)
    elif options.what == 'slow':
        slow(options.drives, options.first, options.processes)
    elif options.what == 'joint':
        joint(options.drives, options.first, options.processes)
    elif options.what == 'bias':
        bias(options.drives, options.first, options.stays)
    elif options.what == 'simulated':
        simulated(options.drives, options.processes)
    else:
        {'measured': measured, 'evidence': evidence}[options.what](options.data)


if __name__ == '__main__':
    main()
