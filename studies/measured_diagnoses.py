"""Diagnose the measured recordings and print the tables of docs/closing_the_loop.md.

    python studies/measured_diagnoses.py DATA OUTPUT

DATA: folder of the recordings. OUTPUT: for the params files and results; a recording whose result is there already is
not diagnosed again.
"""
from __future__ import annotations

import json
import math
import sys
from pathlib import Path

from mems_ins_fusion.cli.diagnose import main as diagnose
from mems_ins_fusion.reports.html import number

RECORDINGS = {
    'longmont_rtk_drive': 'imu.mounting_rpy: [0.0, 0.0, 3.141593]',
    'karlsruhe_hills': 'reference_topic: /reference/fix',
    'incheon_square_ros2': 'imu.mounting_rpy: [3.141593, 0.0, 0.0]\n    gnss_topic: /fix',
}


def result(data: Path, output: Path, name: str, mechanization: str) -> dict:
    """The content of report.json."""
    folder = output / f'{name}_{mechanization}'
    if not folder.exists():
        output.mkdir(parents=True, exist_ok=True)
        given = output / f'{name}_{mechanization}.yaml'
        given.write_text(f'/**:\n  ros__parameters:\n    {RECORDINGS[name]}\n    mechanization: {mechanization}\n')
        if diagnose(['--bag', str(data / name / 'bag'), '--params-file', str(given), '--output', str(folder)]):
            sys.exit(2)
    return json.loads((folder / 'report.json').read_text())


def effects(content: dict) -> str:
    """The effects added with their values, and the names of those that were tried and not added."""
    added = '; '.join(effect(e) for e in content['effects'] if e['added']) or 'none'
    others = ', '.join(f'`{e["name"]}`' for e in content['effects'] if not e['added'])
    return added + (f'; tried and not added: {others}' if others else '')


def effect(e: dict) -> str:
    values = []
    for name, p in e['parameters'].items():
        digits = max(1 - math.floor(math.log10(p['sigma'])), 0)
        unit = '' if p['unit'] == '-' else f' {p["unit"]}'
        values.append(f'`{name}` {p["value"]:.{digits}f} \N{PLUS-MINUS SIGN} {p["sigma"]:.{digits}f}{unit}')
    group = f' (or {", ".join(n for n in e["group"] if n != e["name"])})' if len(e['group']) > 1 else ''
    return (f'`{e["name"]}`{group}: {", ".join(values)}, held-out gain '
            f'{number(e["held_out_log_likelihood_gain"], 3)}')


def rows(title: str, content: dict) -> tuple[str, list[str]]:
    """A row of the table of findings, and those of the table of errors."""
    stages = [content[stage] for stage in ('before', 'noise_fitted', 'after')]
    residual = ' | '.join(f'{number(s["nis_mean"], 3)}, {s["ljung_box_p"]:.1g}' for s in stages)
    finding = f'| {title} | {residual} | {effects(content)} | {"yes" if content["unexplained"] else "no"} |'
    continuous = ' | '.join(number(s['horizontal_rmse_m'], 3) for s in stages)
    errors = [f'| {title} | fixes used, RMS | {continuous} | |']
    for i, comparison in enumerate(content['comparison'][1:]):
        medians = ' | '.join(number(s['outages'][i]['max_error_median_m'], 3) for s in stages)
        interval = '\N{EN DASH}'
        if comparison.get('low') is not None:
            interval = f'{number(comparison["low"], 3)} to {number(comparison["high"], 3)}'
        errors.append(f'| {title} | {stages[0]["outages"][i]["duration_s"]:g} s without fixes, '
                      f'{stages[2]["outages"][i]["count"]} times | {medians} | {interval} |')
    return finding, errors


def main():
    data, output = Path(sys.argv[1]), Path(sys.argv[2])
    found = [rows(f'{name}, {mechanization}', result(data, output, name, mechanization))
             for name in RECORDINGS for mechanization in ('planar', 'strapdown')]
    print('| recording | before | noise fitted | after | effects | unexplained |\n|---|---|---|---|---|---|')
    print('\n'.join(finding for finding, _ in found))
    print('\n| recording | error, m | before | noise fitted | after | change of the mean, 95 % |')
    print('|---|---|---|---|---|---|')
    print('\n'.join(line for _, errors in found for line in errors))


if __name__ == '__main__':
    main()
