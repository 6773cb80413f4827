"""The outage protocol for other filters: recordings for them, and the table of a replay from their output.

A filter of another package cannot be copied at the begin of an outage. So the recordings that `prepare` writes contain
the outages, with time for the filter to recover between two of them. The begins are those of a replay
(docs/metrics.md).
"""
from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .. import __version__
from ..errors import InputError
from ..evaluation import metrics
from ..evaluation.comparison import aiding_of, fixes_apart, samples_to_keep, truth_of
from ..evaluation.metrics import NEES_95, Truth, position_errors
from ..evaluation.outages import SETTLING, Distance, outage_begins
from ..filter.config import FilterConfig
from ..filter.measurements.registry import aiding
from ..filter.runs.replay import run as replay
from ..guard import one_line
from ..navigation.earth import to_local
from ..navigation.frames import FLU_TO_FRD, mounting
from ..parameters import table
from ..recordings.writing import write_recording
from ..reports.html import number
from ..samples import Recording, Reference
from .tracks import FilterTrack, gps_week, read_track
from .variants import VARIANTS, interleaved, withheld

#: file that `prepare` writes beside the recordings
MARKER, TRUTH = 'bench.json', 'truth.csv'
#: the recording with all fixes
FULL = 'full'
#: s with fixes between two outages, for a filter to recover
RECOVERY = 60.0
#: s between two positions that are compared if the recording was changed
_APART = 1.0
#: s, longest interval of a trajectory that is interpolated
_LONGEST_GAP = 10.0


class BenchError(InputError):
    """A bench that cannot be prepared or scored; the text is one line with the reason."""


@dataclass(frozen=True)
class Prepared:
    """Result of `prepare`. recordings: by name, the duration of its outages (s; 0: none) and their begins (ns). datum:
    rad, rad, m. values: the parameters. judged_from: ns."""

    folder: Path
    recordings: dict[str, tuple[float, np.ndarray]]
    truth: Truth
    datum: tuple[float, float, float]
    values: dict
    judged_from: int

    @property
    def variants(self) -> list[str]:
        return [name for name in VARIANTS if (self.folder / name).exists()]


def prepare(recording: Recording, values: dict, folder: Path, kf_gins: bool = False,
            progress: Callable[[float], None] = lambda part: None) -> list[str]:
    """Write the recordings of a bench into `folder`: unchanged, with outages, and changed. Returns their names.

    values: checked parameters; `outage_durations` and `outage_spacing` are used. The outages begin 30 s after this
    package's filter has started, as in a replay.
    """
    truth = truth_of(recording, values)
    config = FilterConfig.from_parameters(values)
    start = replay(config, recording.imu, recording.gnss, aiding_of(recording),
                   keep=samples_to_keep(recording.imu, truth.reference.stamp))
    if not len(start.stamp):
        raise BenchError(f'{recording.name}: the filter does not start on this recording')
    durations = values['outage_durations']
    if not durations:
        raise BenchError("parameter 'outage_durations' is empty")
    good = recording.gnss.select(fixes_apart(recording.gnss, 0.0))
    begins = outage_begins(int(start.stamp[0]), good, values['gnss.time_offset'], values['outage_spacing'],
                           min(durations))
    stamps = np.unique(good.stamp) - round(values['gnss.time_offset'] * 1e9)
    datum = float(good.latitude[0]), float(good.longitude[0]), float(good.height[0])
    made = {FULL: (0.0, np.empty(0, np.int64), recording)}
    for duration in durations if len(begins) else ():
        parts = interleaved(stamps, int(begins[0]), values['outage_spacing'], duration, RECOVERY)
        for i, some in enumerate(parts, 1):
            made[f'outages_{duration:g}s_{i}'] = (
                duration, some, withheld(recording, some, duration, values['gnss.time_offset']))
    for name, variant in VARIANTS.items():
        made[name] = 0.0, np.empty(0, np.int64), variant.make(recording, values, datum)
    for i, (name, (_, _, changed)) in enumerate(made.items()):
        _write(changed, folder / name, values)
        if kf_gins:
            _write_kf_gins(changed, folder / f'{name}_kf_gins', values, start, name in VARIANTS)
        progress((i + 1) / len(made))
    _write_truth(folder / TRUTH, truth)
    content = {'tool': 'bench', 'version': __version__, 'datum': list(datum), 'truth': truth.source,
               'truth_lever_arm_frd': truth.lever_arm.tolist(), 'judged_from_ns': int(
                   start.stamp[0] + round(SETTLING * 1e9)), 'parameters': _not_default(values),
               'recordings': {name: {'duration_s': duration, 'begins_ns': some.tolist()}
                              for name, (duration, some, _) in made.items()}}
    (folder / MARKER).write_text(json.dumps(content, indent=1) + '\n', encoding='utf-8')
    return list(made)


#: parameters that belong to the recording of the bench
_OF_RECORDING = ('bag', 'output_dir', 'reference_topic', 'reference_file', 'start', 'stop')


def _not_default(values: dict) -> dict:
    defaults = table.defaults()
    return {name: value for name, value in values.items() if value != defaults.get(name) and name not in _OF_RECORDING}


def _write(recording: Recording, path: Path, values: dict) -> None:
    topics = {name: values[name] for name in ('temperature_topic', *(one.topic for one in aiding(values)))
              if values[name]}
    # the reference must not be an input of the filter
    write_recording(replace(recording, reference=None), path, imu_topic=values['imu_topic'],
                    gnss_topic=values['gnss_topic'], inputs=aiding(values), **topics)


#: s after the start of this package's filter at which KF-GINS starts from its state
_KF_GINS_LATER = 5.0
#: standard deviations of this state: position north, east, down, m; velocity, m/s; roll, pitch, yaw, deg
_KF_GINS_STD = {'initposstd': [2.0, 2.0, 4.0], 'initvelstd': [0.5, 0.5, 0.5], 'initattstd': [2.0, 2.0, 5.0]}


def _write_kf_gins(recording: Recording, folder: Path, values: dict, start, other_world: bool) -> None:
    """IMU and GNSS data in the format of KF-GINS: seconds of the week; increments of angle (rad) and velocity (m/s),
    forward- right-down; and latitude, longitude (deg), height, standard deviations north, east, down (m). Also its
    configuration: the state of the filter `start` of this package, and the noise of the parameters; not for
    `other_world`, in which the state is another one. Source: src/fileio and config/kf-gins.yaml of KF-GINS."""
    folder.mkdir()
    imu, gnss = recording.imu, recording.gnss.select(fixes_apart(recording.gnss, 0.0))
    rotation = mounting(values['imu.mounting_rpy'])  # to forward-right-down
    step = np.diff(imu.stamp, prepend=imu.stamp[0] - np.median(np.diff(imu.stamp)).astype(np.int64)) * 1e-9
    increments = np.hstack([imu.angular_rate @ rotation.T, imu.specific_force @ rotation.T]) * step[:, None]
    np.savetxt(folder / 'imu.txt', np.column_stack([gps_week(imu.stamp)[1], increments]), '%.9f' + ' %.12e' * 6)
    known = (gnss.covariance_type > 0)[:, None]
    sigma = np.where(known, np.sqrt(np.einsum('nii->ni', gnss.covariance)), values['gnss.default_sigma'])[:, [1, 0, 2]]
    place = np.column_stack([np.degrees(gnss.latitude), np.degrees(gnss.longitude), gnss.height])
    np.savetxt(folder / 'gnss.txt', np.column_stack([gps_week(gnss.stamp)[1], place, sigma]),
               '%.9f %.10f %.10f %.4f %.4f %.4f %.4f')
    if other_world:
        return
    at = min(int(np.searchsorted(start.stamp, start.stamp[0] + round(_KF_GINS_LATER * 1e9))), len(start.stamp) - 1)
    hour, degree = 60.0, 180.0 / np.pi
    noise = {name: [float(v) for v in factor * np.broadcast_to(values[parameter], 3)] for name, parameter, factor in (
        ('arw', 'gyroscope.noise_density', degree * hour), ('vrw', 'accelerometer.noise_density', hour),
        ('gbstd', 'gyroscope.gauss_markov.sigma', degree * 3600.0), ('abstd', 'accelerometer.gauss_markov.sigma', 1e5))}
    arm = FLU_TO_FRD @ np.asarray(values['gnss.lever_arm'])
    settings = {
        'imupath': 'imu.txt', 'gnsspath': 'gnss.txt', 'outputpath': '.', 'imudatalen': 7,
        'imudatarate': round(1e9 / float(np.median(np.diff(imu.stamp)))),
        'starttime': float(gps_week(start.stamp[at:at + 1])[1][0]), 'endtime': -1,
        'initpos': [float(degree * start.latitude[at]), float(degree * start.longitude[at]), float(start.height[at])],
        'initvel': [float(v) for v in np.append(start.velocity[at, :2], 0.0)],
        'initatt': [float(degree * angle[at]) for angle in (start.roll, start.pitch, start.yaw)],
        **dict.fromkeys(('initgyrbias', 'initaccbias', 'initgyrscale', 'initaccscale'), [0.0, 0.0, 0.0]),
        **_KF_GINS_STD, 'imunoise': noise | {
            'gsstd': [1000.0] * 3, 'asstd': [1000.0] * 3,
            'corrtime': float(np.mean(values['gyroscope.gauss_markov.tau'])) / 3600.0},
        'antlever': arm.tolist()}
    (folder / 'kf-gins.yaml').write_text(json.dumps(settings, indent=1) + '\n', encoding='ascii')  # JSON is YAML, too


def _write_truth(path: Path, truth: Truth) -> None:
    r = truth.reference
    with open(path, 'w', encoding='ascii') as file:
        file.write('stamp_ns,latitude_deg,longitude_deg,height_m,variance_m2\n')
        file.writelines(f'{s},{np.degrees(a):.11f},{np.degrees(o):.11f},{h:.4f},{v:.9g}\n' for s, a, o, h, v in zip(
            r.stamp.tolist(), r.latitude, r.longitude, r.height, truth.variance))


def read_prepared(folder) -> Prepared:
    """The result of `prepare` in a folder. BenchError if there is none."""
    folder = Path(folder)
    try:
        content = json.loads((folder / MARKER).read_text(encoding='utf-8'))
        rows = np.loadtxt(folder / TRUTH, delimiter=',', skiprows=1, ndmin=2,
                          dtype=[('s', np.int64), ('a', float), ('o', float), ('h', float), ('v', float)])
        rows = rows.reshape(-1)
        reference = Reference(rows['s'], np.radians(rows['a']), np.radians(rows['o']), rows['h'])
        recordings = {name: (r['duration_s'], np.array(r['begins_ns'], dtype=np.int64))
                      for name, r in content['recordings'].items()}
        return Prepared(folder, recordings, Truth(reference, np.array(content['truth_lever_arm_frd']), rows['v'],
                                                  content['truth']), tuple(content['datum']),
                        table.check(content['parameters']), content['judged_from_ns'])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise BenchError(f'{folder} is not what bench prepare writes: {type(error).__name__}: {one_line(error)}') \
            from None


def tracks_in(folder, prepared: Prepared, datum=None, topic: str = '') -> dict[str, FilterTrack]:
    """The trajectories of a filter in `folder`, by the recording that they belong to: NAME/ (a bag), or NAME with any
    extension.

    datum: rad, rad, m, of local coordinates; None: that of the bench, the first fix. BenchError if there are none.
    """
    folder, found = Path(folder), {}
    week = int(gps_week(prepared.truth.reference.stamp[:1])[0][0])
    if not folder.is_dir():
        raise BenchError(f'{folder} is not a folder with answers of a filter')
    for name in prepared.recordings:
        paths = sorted(p for p in folder.iterdir() if (p.name == name or p.stem == name) and p.suffix != '.std')
        if paths:
            found[name] = read_track(paths[0], datum or prepared.datum, topic, week)
    if not found:
        raise BenchError(f'{folder} holds no answer to {", ".join(prepared.recordings)}: name them NAME.tum, NAME.nav, '
                         'NAME.csv, or NAME/ for a bag')
    return found


def own_tracks(prepared: Prepared, given: dict, progress: Callable[[float], None] = lambda part: None) -> dict:
    """The trajectories of this package's filter. given: parameters by full name, which replace those of the bench."""
    from ..reports.replay import read_part

    found = {}
    checked = table.check(_not_default(prepared.values) | {k: v for k, v in given.items() if k not in _OF_RECORDING})
    for i, name in enumerate(prepared.recordings):
        values = checked
        if name in VARIANTS:
            values = VARIANTS[name].parameters(values)
        recording, _ = read_part(prepared.folder / name, values, lambda part: None)
        keep = samples_to_keep(recording.imu, prepared.truth.reference.stamp)
        use = fixes_apart(recording.gnss, 0.0)
        found[name] = replay(FilterConfig.from_parameters(values), recording.imu, recording.gnss.select(use),
                             aiding_of(recording), keep=keep)
        if not len(found[name].stamp):
            raise BenchError(f'{name}: the filter does not start on this recording')
        progress((i + 1) / len(prepared.recordings))
    return found


@dataclass(frozen=True)
class Score:
    """A filter on a bench. run: the numbers of a run, as in a replay. outages: for each duration. follows: by variant,
    RMS and largest distance, m, of the trajectory from that of the unchanged recording."""

    name: str
    run: dict | None
    outages: list[dict]
    follows: dict[str, tuple[float, float]]


def score(name: str, prepared: Prepared, tracks: dict) -> Score:
    """Measure the trajectories `tracks` of the filter `name`, by recording."""
    full = tracks.get(FULL)
    run = None
    if full is not None:
        judged = prepared.truth.reference.stamp >= prepared.judged_from
        # errors in turns and on straights need the gyroscopes of the recording, which not all filters have
        errors = position_errors(full, prepared.truth.select(judged), np.zeros(judged.sum(), dtype=bool), _LONGEST_GAP)
        run = metrics.summary(errors)
        if not np.isfinite(errors.nees).all():  # the filter gives no covariance
            run |= {'nees_mean': None, 'within_95_percent': None}
    durations = sorted({duration for duration, _ in prepared.recordings.values() if duration})
    outages = [_outages(duration, prepared, tracks) for duration in durations]
    return Score(name, run, [row for row in outages if row['count']], {
        variant: distance_to_unchanged(variant, prepared, full, tracks[variant]) for variant in prepared.variants
        if full is not None and variant in tracks})


def _outages(duration: float, prepared: Prepared, tracks: dict) -> dict:
    """One row of the table of outages, as `evaluation.outages.summary` makes it."""
    largest, distance, within, stamp = [], [], [], prepared.truth.reference.stamp
    for name, (mine, begins) in prepared.recordings.items():
        if mine != duration or name not in tracks:
            continue
        track, driven = tracks[name], Distance(tracks[name])
        for begin in begins.tolist():
            end = begin + round(duration * 1e9)
            rows = slice(np.searchsorted(stamp, begin, side='right'), np.searchsorted(stamp, end, side='right'))
            truth = prepared.truth.select(rows)
            errors = position_errors(track, truth, np.zeros(len(truth), dtype=bool), _LONGEST_GAP)
            if end > stamp[-1] or not len(errors):
                continue
            largest.append(errors.horizontal.max())
            distance.append(driven.at(end) - driven.at(begin))
            within.append(errors.nees[-1] < NEES_95 if np.isfinite(errors.nees[-1]) else np.nan)
    row = {'duration_s': duration, 'count': len(largest)}
    if not largest:
        return row
    known = np.isfinite(within).all()
    return row | {'max_error_rms_m': metrics.rms(largest), 'max_error_median_m': float(np.median(largest)),
                  'max_error_p95_m': float(np.percentile(largest, 95)),
                  'percent_of_distance': float(100 * np.sum(largest) / np.sum(distance)) if np.sum(distance) > 1 else
                  None, 'within_95_percent': float(100 * np.mean(within)) if known else None}


def distance_to_unchanged(variant: str, prepared: Prepared, full, changed) -> tuple[float, float]:
    """Distance between the trajectory of a changed recording, transformed back, and that of the unchanged one: RMS and
    largest horizontal distance, m."""
    change = VARIANTS[variant]
    first, last = prepared.judged_from, min(full.stamp[-1], changed.stamp[-1] - change.shift)
    at = np.arange(first, last, round(_APART * 1e9))
    north, east = _local(full, at, prepared.datum)
    n, e = change.back(*_local(changed, at + change.shift, prepared.datum))
    away = np.hypot(n - north, e - east)
    return metrics.rms(away), float(away.max()) if len(away) else float('nan')


def _local(track, at: np.ndarray, datum) -> tuple[np.ndarray, np.ndarray]:
    """North and east, m, at `at` (ns)."""
    north, east, _ = to_local(track.latitude, track.longitude, track.height, datum)
    origin = track.stamp[0]
    return tuple(np.interp(at - origin, track.stamp - origin, values) for values in (north, east))


def table_text(scores: Sequence[Score]) -> str:
    """The scores as text for a terminal."""
    lines = [f"{'filter':<24}{'outage':>10}{'RMS':>10}{'median':>10}{'95 %':>10}{'count':>7}{'in ellipse':>12}"]
    for s in scores:
        if s.run:
            numbers = [s.run[f'horizontal_{name}_m'] for name in ('rmse', 'median', 'p95')]
            lines.append(_line(s.name, 'none', numbers, s.run['errors_counted'], s.run['within_95_percent']))
        for row in s.outages:
            numbers = [row[f'max_error_{name}_m'] for name in ('rms', 'median', 'p95')]
            lines.append(_line(s.name, f'{row["duration_s"]:g} s', numbers, row['count'], row['within_95_percent']))
    for s in scores:
        lines += [f'{s.name}: {VARIANTS[v].words}: its answer is {number(rms, 2)} m RMS, {number(most, 2)} m at most '
                  'from the one to the recording as it is' for v, (rms, most) in s.follows.items()]
    return '\n'.join(lines)


def _line(name: str, outage: str, numbers, count: int, percent) -> str:
    share = 'not told' if percent is None else f'{percent:.0f} %'
    return f"{name:<24}{outage:>10}{''.join(f'{number(n, 3):>8} m' for n in numbers)}{count:>7}{share:>12}"


def report(scores: Sequence[Score], prepared: Prepared) -> dict:
    """The content of report.json: rows like those of a replay, with `filter`."""
    return {'tool': 'bench', 'version': __version__, 'truth': prepared.truth.source,
            'runs': [{'filter': s.name, **s.run} for s in scores if s.run],
            'outages': [{'filter': s.name, **row} for s in scores for row in s.outages],
            'follows': [{'filter': s.name, 'variant': v, 'rms_m': rms, 'largest_m': most}
                        for s in scores for v, (rms, most) in s.follows.items()]}
