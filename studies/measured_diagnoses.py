"""Diagnose the measured recordings and print the tables of docs/closing_the_loop.md.

    python studies/measured_diagnoses.py DATA OUTPUT [RECORDING ..]

DATA: folder of the recordings. OUTPUT: for the params files and results; a recording whose result is there already is
not diagnosed again. RECORDING: only these, by the first letters of `recording, settings`.
"""
from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mems_ins_fusion.cli.diagnose import main as diagnose  # noqa: E402
from mems_ins_fusion.diagnosis.estimate import Estimate  # noqa: E402
from mems_ins_fusion.reports.html import number  # noqa: E402

#: bag, and what a user has to say
RECORDINGS = {
    'longmont_rtk_drive': ('bag', 'imu.mounting_rpy: [0.0, 0.0, 3.141593]'),
    'karlsruhe_hills': ('bag', 'reference_topic: /reference/fix'),
    'incheon_square_ros2': ('bag', 'imu.mounting_rpy: [3.141593, 0.0, 0.0]\n    gnss_topic: /fix'),
    'incheon_park_ros2': ('bag_0.db3', 'gnss_topic: /fix'),
    'kingston_span': ('bag', 'imu.mounting_rpy: [0.0, 0.0, -1.570796]\n    reference_topic: /reference/fix'),
}
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


def main() -> None:
    data, output = Path(sys.argv[1]), Path(sys.argv[2])
    titles = {f'{name}, {settings}': (name, settings) for name in RECORDINGS for settings in SETTINGS}
    chosen = {title: which for title, which in titles.items()
              if not sys.argv[3:] or any(title.startswith(wanted) for wanted in sys.argv[3:])}
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
