"""Diagnose the measured recordings and print the tables of docs/closing_the_loop.md.

    python studies/measured_diagnoses.py settings DATA OUTPUT [RECORDING ..]
    python studies/measured_diagnoses.py ways DATA OUTPUT [RECORDING ..]

DATA: folder of the recordings. OUTPUT: for the params files and results; a recording whose result is there already is
not diagnosed again. RECORDING: only these, by the first letters of `recording, settings`; in ways `drive NUMBER` is any
simulated drive, from 300 on with receivers of 0.2 to 10 Hz, some with gaps, as in `studies/configure.py --any-fixes`,
`drive NUMBER motorway` the same vehicle, no rover, at 25 to 38 m/s.
settings: with the defaults, and with what was before them. ways: from nothing but the topics, from the file that
`configure` writes, and from one by hand; of the recordings and of simulated drives, whose truth is known. Are the time
offsets, arms, mountings, scales and coloured noise that the three tell alike within their sigmas, and does configure's
file end worse than by hand, by `compare`? Of simulated drives each file is measured against the truth, too, on two
other drives of the same vehicle, as given and as corrected.
"""
from __future__ import annotations

import json
import math
import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import configure  # noqa: E402
import numpy as np

from mems_ins_fusion.cli.compare import main as compare  # noqa: E402
from mems_ins_fusion.cli.diagnose import main as diagnose  # noqa: E402
from mems_ins_fusion.configuration.configure import Configuration  # noqa: E402
from mems_ins_fusion.configuration.configure import configure as look_at  # noqa: E402
from mems_ins_fusion.configuration.mounting import deviation, rpy  # noqa: E402
from mems_ins_fusion.diagnosis.estimate import Estimate  # noqa: E402
from mems_ins_fusion.effects.registry import EFFECTS  # noqa: E402
from mems_ins_fusion.navigation.frames import rotation_from_rpy  # noqa: E402
from mems_ins_fusion.parameters import params_file, table  # noqa: E402
from mems_ins_fusion.recordings.writing import write_recording  # noqa: E402
from mems_ins_fusion.reports.configuration import configuration_yaml, doubts  # noqa: E402
from mems_ins_fusion.reports.html import number  # noqa: E402

#: bag, and what a user has to say
RECORDINGS = {
    'longmont_rtk_drive': ('bag', 'imu.mounting_rpy: [0.0, 0.0, 3.141593]'),
    'karlsruhe_hills': ('bag', 'reference_topic: /reference/fix'),
    'incheon_square_ros2': ('bag', 'imu.mounting_rpy: [3.141593, 0.0, 0.0]\n    gnss_topic: /fix'),
    'incheon_park_ros2': ('bag_0.db3', 'gnss_topic: /fix'),
    'kingston_span': ('bag', 'imu.mounting_rpy: [0.0, 0.0, -1.570796]\n    reference_topic: /reference/fix'),
    'dresden_hobby_imu': ('', 'imu.mounting_rpy: [0.0, 0.1, 0.0]'),
    'husky_wheel_speed': ('', 'speed_topic: /wheel/speed'),
}
#: what is no setting of the vehicle: given in all ways
TRUTH = {name: line.strip() for name, (_, given) in RECORDINGS.items() for line in given.split('\n')
         if 'reference' in line}
#: topics of fixes that are not the default: `configure` finds them itself
FIXES = {name: line.strip() for name, (_, given) in RECORDINGS.items() for line in given.split('\n')
         if 'gnss_topic' in line}
_PLAIN = ('vehicle.zero_velocity: false\n    vehicle.non_holonomic: false\n    gnss.gate_probability: 1.0\n'
          '    gnss.adapt_sigma: false\n    gnss.robust_sigma: 0.0')
#: the defaults; and what was before them, with nothing known of the vehicle and each fix believed
SETTINGS = {'default': '', 'strapdown': _PLAIN,
            'planar': f'mechanization: planar\n    vehicle.tilt_sigma: 0.0\n    {_PLAIN}'}


def result(data: Path, output: Path, name: str, settings: str) -> dict:
    """The content of report.json."""
    folder = output / f'{name}_{settings}'
    if not folder.exists():
        output.mkdir(parents=True, exist_ok=True)
        bag, given = RECORDINGS[name]
        file = output / f'{name}_{settings}.yaml'
        lines = '\n    '.join(filter(None, (given, SETTINGS[settings])))
        file.write_text(f'/**:\n  ros__parameters:\n    {lines}\n')
        if diagnose(['--bag', str(data / name / bag), '--params-file', str(file), '--output', str(folder)]):
            sys.exit(2)
    return json.loads((folder / 'report.json').read_text())


def effects(content: dict) -> str:
    """What was added with its values, the noise levels moved, and what was tried and not added."""
    added = '; '.join(_effect(e) for e in content['effects'] if e['added'])
    noise = ', '.join(f'{name} x {number(factor, 2)}' for name, factor in content['noise_factors'].items())
    others = ', '.join(f'`{e["name"]}`' for e in content['effects'] if not e['added'])
    said = [text for text in (added, noise, f'not added: {others}' if others else '') if text]
    return '; '.join(said) if content['changed_parameters'] else f'kept as given{f" ({others})" if others else ""}'


def _effect(e: dict) -> str:
    values = ', '.join(f'{name} {Estimate(**p).text()}' for name, p in e['parameters'].items())
    group = f' (or {", ".join(n for n in e["group"] if n != e["name"])})' if len(e['group']) > 1 else ''
    return f'`{e["name"]}`{group}: {values}'


def outage(o: dict) -> str:
    """Median and mean square of the largest error, m, and how often the ellipse held the truth."""
    return (f'{number(o["max_error_median_m"], 2)}, {number(o["max_error_rms_m"], 2)}, '
            f'{number(o["within_95_percent"], 2)} %')


# -- three ways --------------------------------------------------------------------------------------------------------

TOPICS, CONFIGURED, BY_HAND = 'topics only', "configure's file", 'by hand'
WAYED = ('husky_wheel_speed', 'dresden_hobby_imu', 'longmont_rtk_drive', 'karlsruhe_hills', 'incheon_square_ros2',
         'kingston_span')
#: simulated drives, by number of `configure.case`, whose kind goes with it; who writes a file by hand sees the mounting
#: to this, deg, and has a tape, m
SIMULATED = (201, 203, 204, 205, 213, 214, 200, 202, 206, 207, 208, 209, 210, 211, 212, 215, 216, 217, 218, 219)
SEEN, TAPE, SECONDS = 5.0, 0.1, 300.0
#: parts of long recordings: lines of params files
PARTS = {'kingston_span': 'stop: 900.0'}
ANY_FIXES = 300  # drives from this number on have receivers of 0.2, 1, 5 and 10 Hz in turn, half of them with gaps
#: of these with gaps: s without samples, s without fixes, each minute
GAPS = {205: (1.5, 20.0), 213: (0.8, 15.0), 214: (0.8, 15.0)}
WAY_DURATIONS = 10.0, 30.0, 60.0
#: s between outages: errors without fixes change within seconds, and half a dozen outages of a short drive are chance
OFTEN = 'outage_spacing: 2.0'
#: a file that says it is ready is off by no more: s, deg
READY_OFFSET, READY_ANGLE = 0.1, 3.0
#: other drives of a vehicle on which its files are measured against the truth
OTHERS = 1, 2


#: what ways are compared in: effect and parameter in which a diagnosis tells it
QUANTITIES = {'offset': ('gnss_time_offset', 'time_offset'),
              'arm forward': ('gnss_lever_arm', 'x'), 'arm left': ('gnss_lever_arm', 'y'),
              'arm up': ('gnss_lever_arm', 'z'),
              'roll': ('mounting_rotation', 'roll'), 'pitch': ('mounting_rotation', 'pitch'),
              'yaw': ('mounting_rotation', 'yaw'),
              'gyroscope scale': ('gyroscope_scale', 'z'), 'accelerometer scale': ('accelerometer_scale', 'x'),
              'coloured noise': ('gnss_coloured_noise', 'sigma')}
ARM, MOUNTING = ('arm forward', 'arm left', 'arm up'), ('roll', 'pitch', 'yaw')


@dataclass(frozen=True)
class Way:
    """Where one way ended. file: what it ends with. verdict: its word. values: the parameters with all of QUANTITIES
    that it tells, set or only told; sigmas: of those that have one, m, s, rad or of one; only_told: those that
    corrected.yaml does not have. arm, mounting: as in corrected.yaml (deg). errors: mean of the largest in outages, m,
    before and after, by duration."""

    file: Path
    verdict: str
    values: dict
    sigmas: dict[str, float]
    only_told: set[str]
    arm: list[float]
    mounting: list[float]
    errors: dict[float, tuple[float, float]]

    @property
    def usable(self) -> bool:
        return self.verdict not in ('not_usable', 'none')


def simulated_drive(name: str, second: int = 0) -> configure.Case:
    """name: `drive NUMBER` or `drive NUMBER motorway`."""
    said = re.fullmatch('drive ([0-9]+)( motorway)?', name)
    if said is None:
        sys.exit(f"'{name}' is neither `drive NUMBER` nor `drive NUMBER motorway`")
    number = int(said[1])
    return configure.case(number, upright=True, duration=SECONDS, any_fixes=number >= ANY_FIXES, second=second,
                          fast=said[2] is not None)


def simulated_bag(name: str, output: Path) -> tuple[Path, configure.Case]:
    """A simulated drive as a bag, and its truth."""
    number, of, bag = int(name.split()[1]), simulated_drive(name), output / name.replace(' ', '_')
    made = of.recording
    if number in GAPS:
        part = [(samples.stamp - made.imu.stamp[0]) % 60_000_000_000 * 1e-9 for samples in (made.imu, made.gnss)]
        made = replace(made, imu=made.imu.select(part[0] > GAPS[number][0]),
                       gnss=made.gnss.select((part[1] < 30.0) | (part[1] > 30.0 + GAPS[number][1])))
    if not bag.exists():
        write_recording(made, bag)
    return bag, of


def three_ways(name: str, bag: Path, always: str, topics: str, by_hand: str, output: Path) -> dict[str, Way]:
    """Lines of params files. always: in each way, also below what `configure` writes."""
    files = {way: output / f'{name}_{i}.yaml' for i, way in enumerate((TOPICS, CONFIGURED, BY_HAND))}
    files[TOPICS].write_text(f'/**:\n  ros__parameters:\n    {_lines("imu_topic: /imu/data", topics, always)}\n')
    files[BY_HAND].write_text(f'/**:\n  ros__parameters:\n    {_lines("imu_topic: /imu/data", by_hand, always)}\n')
    if not files[CONFIGURED].exists():
        found = look_at([bag])
        (output / f'{name}_found.json').write_text(json.dumps(seen_by(found)))
        files[CONFIGURED].write_text(f'{configuration_yaml(found)}    {always}\n')
    found = {}
    for way, file in files.items():
        # who has nothing to write by hand starts from the topics
        folder = output / f'{name}_{[f.read_text() for f in files.values()].index(file.read_text())}'
        if not (folder / 'report.json').exists():
            diagnose(['--bag', str(bag), '--params-file', str(file), '--output', str(folder), '--overwrite'])
        found[way] = ended(folder, file, looked(name, output) if way == CONFIGURED else None)
    return found


def seen_by(found: Configuration) -> dict:
    """What `configure` says: [value, sigma] of the offset, s, arm, m, and mounting (values in the file, deg), sigma
    None where nothing is shown; whether the file is ready."""
    mounting = found.mounting
    offset = mounting.offset if mounting is not None and mounting.offset is not None and mounting.offset.shown else None
    angles = found.values.get('imu.mounting_rpy', [0.0, 0.0, 0.0])
    return {'offset': [offset.lag, offset.lag_sigma] if offset is not None else [0.0, None],
            'arm': [offset.arm.tolist(), offset.arm_sigma.tolist()] if offset is not None else [[0.0] * 3, None],
            'mounting': [angles, mounting.sigma.tolist() if mounting is not None else None],
            'set': found.values['gnss.time_offset'], 'ready': not doubts(found)}


def looked(name: str, output: Path) -> dict:
    return json.loads((output / f'{name}_found.json').read_text())


def _lines(*lines: str) -> str:
    return '\n    '.join(filter(None, lines))


def ended(folder: Path, file: Path, seen: dict | None) -> Way:
    """seen: what `configure` says, where it has written `file`; it sets what is more than two sigma."""
    content = json.loads((folder / 'report.json').read_text()) if (folder / 'report.json').exists() else {}
    end = folder / 'corrected.yaml'
    end = end if end.exists() else file
    corrected = table.check(params_file.load_yaml(end))
    given = table.check(params_file.load_yaml(file))
    values, sigmas, only_told = corrected, {}, set()
    if seen is not None:
        sigmas = {name: sigma for name, sigma in zip(QUANTITIES, (
            seen['offset'][1], *(seen['arm'][1] or [None] * 3), *(seen['mounting'][1] or [None] * 3)))
            if sigma is not None}
        if 'offset' in sigmas and corrected['gnss.time_offset'] == given['gnss.time_offset'] == 0.0:
            values, only_told = {**values, 'gnss.time_offset': seen['offset'][0]}, {'offset'}
        if corrected['gnss.lever_arm'] == given['gnss.lever_arm']:
            values = {**values, 'gnss.lever_arm': seen['arm'][0]}
    for e in content.get('effects', []):
        known = {name: e['parameters'][parameter] for name, (effect, parameter) in QUANTITIES.items()
                 if effect == e['name'] and e['parameters'].get(parameter, {}).get('sigma') is not None}
        sigmas |= {name: estimate['sigma'] for name, estimate in known.items()}
        if e['added']:
            only_told -= set(known)
        elif known:
            only_told |= set(known)
            moved = EFFECTS[e['name']].adjusted(given, {
                **{parameter.name: 0.0 for parameter in EFFECTS[e['name']].parameters},
                **{QUANTITIES[name][1]: estimate['value'] for name, estimate in known.items()}})
            values = {**values, **{name: value for name, value in moved.items() if value != given[name]}}
    # of corrected.yaml: the comparison is with what was tried, which may not be set
    means = [{o['duration_s']: o['max_error_mean_m'] for o in content.get(when, {}).get('outages', []) if o['count']}
             for when in ('before', 'after')]
    errors = {duration: tuple(mean[duration] for mean in means) for duration in WAY_DURATIONS
              if all(duration in mean for mean in means)}
    return Way(end, content.get('verdict', {}).get('answer', 'none'), values, sigmas, only_told,
               corrected['gnss.lever_arm'], [math.degrees(a) for a in corrected['imu.mounting_rpy']], errors)


def beside_by_hand(found: dict[str, Way], bag: Path, folder: Path) -> str:
    """Whether configure's file ends better or worse than the one by hand, and the errors of both with the interval."""
    if not (folder / 'report.json').exists() and compare(
            [str(found[BY_HAND].file), str(found[CONFIGURED].file), '--bag', str(bag), '--output', str(folder),
             '--overwrite']):
        return '- | -'
    verdict = json.loads((folder / 'report.json').read_text())['verdict']
    rows = [f'{_which(change)}: {number(change["before_m"], 2)}, {number(change["after_m"], 2)} m' + (
        '' if change['interval_m'] is None else ' ({} to {})'.format(*(number(m, 2) for m in change['interval_m'])))
        for change in verdict['changes'] if change['duration_s'] or change['every_s']]
    return f'{verdict["answer"]} | {"; ".join(rows)}'


def _which(change: dict) -> str:
    return f'{change["duration_s"]:g} s' if change['duration_s'] else f'fixes each {change["every_s"]:g} s'


def away(values: dict, offset: float, arm, rotation: np.ndarray, scales=(0.0, 0.0), coloured=0.0) -> dict[str, float]:
    """By how much parameters differ from these values, by QUANTITIES."""
    turned = deviation(rotation_from_rpy(*values['imu.mounting_rpy']), rotation)
    return dict(zip(QUANTITIES, (values['gnss.time_offset'] - offset, *np.subtract(values['gnss.lever_arm'], arm),
                                 *turned, *np.subtract(scales_of(values), scales),
                                 values['gnss.coloured_noise.sigma'] - coloured), strict=True))


def scales_of(values: dict) -> tuple[float, float]:
    """Of gyroscopes and accelerometers; a diagnosis adds to one axis."""
    return tuple(max(values[f'{sensor}.scale'], key=abs) for sensor in ('gyroscope', 'accelerometer'))


def agree(found: dict[str, Way]) -> str:
    """By how many sigmas the ways that ended lie apart at most, for each quantity that two of them tell."""
    ends, apart = [way for way in found.values() if way.usable], {}
    for k, a in enumerate(ends):
        for b in ends[:k]:
            if a.file.parent == b.file.parent:  # one diagnosis
                continue
            between = away(a.values, b.values['gnss.time_offset'], b.values['gnss.lever_arm'],
                           rotation_from_rpy(*b.values['imu.mounting_rpy']), scales_of(b.values),
                           b.values['gnss.coloured_noise.sigma'])
            for name in a.sigmas.keys() & b.sigmas.keys():
                sigmas = abs(between[name]) / math.hypot(a.sigmas[name], b.sigmas[name])
                apart[name] = max(sigmas, apart.get(name, 0.0))
    rows = '; '.join(f'{name} {apart[name]:.1f}' for name in QUANTITIES if name in apart)
    return f'{"-" if not apart else "yes" if max(apart.values()) < 2.0 else "no"} | {rows or "-"}'


def on_other_drives(drive: str, found: dict[str, Way], output: Path) -> list[str]:
    """For each way its verdict, and the errors of its file as given and as corrected on OTHERS against the truth:
    RMS with fixes, mean largest error in 10, 30 and 60 s without, m."""
    others = [simulated_drive(drive, k).recording for k in OTHERS]

    def errors(values: dict) -> str:
        each = [configure.measured_errors(configure.errors(table.check({**values, **configure.TRUTH}), other))
                for other in others]
        return ' / '.join(number(m, 2) for m in np.mean(each, axis=0))

    rows = []
    for i, (way, end) in enumerate(found.items()):
        given, corrected = (table.check(params_file.load_yaml(file) | {'fitted_to': []})
                            for file in (output / f'{drive.replace(" ", "_")}_{i}.yaml', end.file))
        rows.append(f'| {drive}, {way} | {end.verdict} | {errors(given)} | '
                    f'{errors(corrected) if corrected != given else "the same file"} |')
    return rows


def way_row(title: str, way: str, end: Way) -> str:
    sigma = end.sigmas.get('offset')
    shown = '-' if sigma is None else f'{end.values["gnss.time_offset"]:.3f} ± {sigma:.3f}' + (
        ' (told)' if 'offset' in end.only_told else '')
    errors = ' / '.join(number(end.errors[d][1], 2) if d in end.errors else '-' for d in WAY_DURATIONS)
    before = ' / '.join(number(end.errors[d][0], 2) if d in end.errors else '-' for d in WAY_DURATIONS)
    return (f'| {title} | {way} | {shown} | {", ".join(f"{a:.2f}" for a in end.arm)} | '
            f'{", ".join(f"{a:.1f}" for a in end.mounting)} | {before} | {errors} | {end.verdict} |')


def ways(data: Path, output: Path, wanted: list[str]) -> None:
    """Each line is printed as it is known: a diagnosis takes minutes."""
    output.mkdir(parents=True, exist_ok=True)
    print('| drive | way | time offset, s | arm, m | mounting, deg | 10 / 30 / 60 s without fixes, before, m | '
          'after, m | verdict |\n|---|---|---|---|---|---|---|---|')
    names = [*WAYED, *dict.fromkeys((*(f'drive {number}' for number in SIMULATED),
                                     *(name for name in wanted if name.startswith('drive '))))]
    unknown = [w for w in wanted if not any(n.startswith(w) for n in names)]
    if unknown:
        sys.exit(f'no drive begins with {unknown[0]!r}')
    agreed, beside, judged, true = {}, {}, [], []
    for name in [n for n in names if not wanted or any(n.startswith(w) for w in wanted)]:
        title = name
        if name in RECORDINGS:
            folder, given = RECORDINGS[name]
            bag, file = data / name / folder, name
            truth = TRUTH.get(name, '')
            by_hand = _lines(*(line.strip() for line in given.split('\n') if line.strip() != truth))
            found = three_ways(name, bag, _lines(truth, PARTS.get(name, ''), OFTEN), FIXES.get(name, ''), by_hand,
                               output)
        else:
            bag, of = simulated_bag(name, output)
            kind = f'{of.kind}, gaps' if int(name.split()[1]) in GAPS else of.kind
            mounting = np.degrees(rpy(of.rotation))
            title = (f'{name} ({kind}; truth {of.offset:.3f} s, {", ".join(f"{a:.2f}" for a in of.arm)} m, '
                     f'{", ".join(f"{a:.1f}" for a in mounting)} deg)')
            seen = np.radians(SEEN * np.round(mounting / SEEN)).round(4).tolist()
            measured = (TAPE * np.round(of.arm / TAPE)).round(2).tolist()
            found = three_ways(file := name.replace(' ', '_'), bag, OFTEN, '', _lines(
                f'imu.mounting_rpy: {seen}', f'gnss.lever_arm: {measured}'), output)
            judged.append(against_truth(of, looked(file, output), found))
            true += on_other_drives(name, found, output)
        for way, end in found.items():
            print(way_row(title, way, end), flush=True)
        agreed[name] = agree(found)
        beside[name] = beside_by_hand(found, bag, output / f'{file}_beside')
    print('\n| drive | do the ways agree | sigmas by which two ways lie apart, at most |\n|---|---|---|')
    for name, said in agreed.items():
        print(f'| {name} | {said} |')
    print('\n| drive | configure\'s file instead of by hand | without fixes, with few: by hand, configure\'s file '
          '(95 % interval of the difference) |\n|---|---|---|')
    for name, said in beside.items():
        print(f'| {name} | {said} |')
    if judged:
        print('\n| drive, way | verdict | by the truth, on other drives of the vehicle, with fixes / 10 / 30 / 60 s '
              'without, m: as given | as corrected |\n|---|---|---|---|')
        print('\n'.join(true))
        summary(judged)


def against_truth(of: configure.Case, seen: dict, found: dict[str, Way]) -> dict:
    """Errors over sigma, (k,) each: of the offset, arm and mounting of configure, and of those that each way tells; and
    whether a file is ready, and off."""
    def scores(errors, sigmas):
        return np.atleast_1d(np.asarray(errors) / np.asarray(sigmas)) if sigmas is not None else np.zeros(0)

    turned = deviation(rotation_from_rpy(*seen['mounting'][0]), of.rotation)
    off = abs(seen['set'] - of.offset) > READY_OFFSET or np.degrees(np.abs(turned)).max() > READY_ANGLE
    ends = {}
    for way, end in found.items():
        wrong = away(end.values, of.offset, of.arm, of.rotation)
        for what, names in (('offset', ('offset',)), ('arm', ARM), ('mounting', MOUNTING)):
            if end.usable:
                ends[f'diagnose, {way}, {what}'] = np.array(
                    [wrong[name] / end.sigmas[name] for name in names if name in end.sigmas])
    return {'configure, offset': scores(seen['offset'][0] - of.offset, seen['offset'][1]),
            'configure, arm': scores(seen['arm'][0] - of.arm, seen['arm'][1]),
            'configure, mounting': scores(turned, seen['mounting'][1]),
            **ends, 'ready': seen['ready'], 'ready and off': seen['ready'] and off}


def summary(judged: list[dict]) -> None:
    print('\n| simulated drives | count | within two sigma | RMS of error over sigma |\n|---|---|---|---|')
    for what in dict.fromkeys(key for row in judged for key in row if 'ready' not in key):
        score = np.concatenate([row[what] for row in judged if what in row])
        if len(score):
            print(f'| {what} | {len(score)} | {(np.abs(score) < 2.0).mean():.0%} | {np.sqrt((score**2).mean()):.2f} |')
    print(f"\n{len(judged)} files, {sum(row['ready'] for row in judged)} ready, of these off by more than "
          f"{READY_OFFSET:g} s or {READY_ANGLE:g} deg: {sum(row['ready and off'] for row in judged)}")


def main() -> None:
    what, data, output, wanted = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4:]
    if what == 'ways':
        return ways(data, output, wanted)
    titles = {f'{name}, {settings}': (name, settings) for name in RECORDINGS for settings in SETTINGS}
    chosen = {title: which for title, which in titles.items()
              if not wanted or any(title.startswith(w) for w in wanted)}
    found = {title: result(data, output, *which) for title, which in chosen.items()}
    print('| recording, settings | found | left unexplained |\n|---|---|---|')
    for title, content in found.items():
        print(f'| {title} | {effects(content)} | {"yes" if content["unexplained"] else "no"} |')
    print('\n| recording, settings | without fixes for | outages | before: median, RMS, in the ellipse | after |')
    print('|---|---|---|---|---|')
    for title, content in found.items():
        for old, new in zip(content['before']['outages'], content['after']['outages']):
            if old['count']:
                print(f'| {title} | {old["duration_s"]:g} s | {old["count"]} | {outage(old)} | {outage(new)} |')
    worse = [title for title, content in found.items()
             for old, new in zip(content['before']['outages'], content['after']['outages'])
             if old['count'] and new['max_error_rms_m'] > 1.1 * old['max_error_rms_m']]
    print(f'\nLarger by a tenth after: {", ".join(dict.fromkeys(worse)) or "none"}; '
          f'{len(found)} diagnoses, {sum(bool(c["changed_parameters"]) for c in found.values())} changed something.')


if __name__ == '__main__':
    main()
