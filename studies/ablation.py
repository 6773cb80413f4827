"""What each mechanism and each constant of the filter is good for: without it, and with a quarter and four times of it.

    python studies/ablation.py --list
    python studies/ablation.py [--only NAME ...] [--rows faults|vehicle|all] [--faults TEXT ...]
                               [--rates 0.2 1 10] [--seeds 2] [--processes 2] [--output FILE.csv]

Mechanisms are switched off by their parameters, or by a constant with which they never act. A constant is changed by
its name, `file.NAME`, or `file.NAME[1]` for one of a tuple: all of `filter/trust`, `filter/update.py`,
`filter/kernel.py` and `filter/prediction.py`. No file is changed: a process of its own lays the value over the modules
before anything is compiled, and keeps what it compiles in a folder of its own. That costs half a minute of CPU for each
change; what is written already in FILE.csv is not done again, so the study can be stopped and gone on with.

Each line of the table: the change, the row (a fault of faults.py, or a setting of vehicle.py), the rate of the fixes,
the error and how often the 95 % ellipse held the truth. The error is the largest of a fault and the minute after it,
the RMSE of a setting, the 95th percentile of the largest in its outages. At the end: the changes that move nothing by
more than LEAST_M or LEAST_PERCENT anywhere, and for the others where they help and cost most.
"""
from __future__ import annotations

import argparse
import ast
import csv
import importlib
import json
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'mems_ins_fusion.filter'
#: files whose constants are tried
FILES = ('trust/*.py', 'update.py', 'kernel.py', 'prediction.py')
FACTORS = (0.25, 4.0)
#: parameters that switch a mechanism off
MECHANISMS = {
    'gate': {'gnss.gate_probability': 1.0}, 'weights': {'gnss.robust_sigma': 0.0},
    'adapt_sigma': {'gnss.adapt_sigma': False}, 'adapt_covariance': {'gnss.adapt_covariance': False},
    'adapt_noise': {'imu.adapt_noise': False}, 'learn_drift': {'vehicle.learn_drift': False},
    'standstill': {'vehicle.zero_velocity': False}, 'non_holonomic': {'vehicle.non_holonomic': False},
    'mounting': {'imu.mounting_sigma': 0.0}, 'rear_axle': {'vehicle.rear_axle_sigma': 0.0}}
#: others have no parameter: a value of a constant with which they never act
NEVER = {
    'end of weighting': {'trust.receiver.LONGEST_WEIGHTED': 1e9},
    'start anew where the filter strayed': {'trust.receiver.STRAYED_SLOPE': 1e9},
    'floor of the gate': {'trust.receiver.GATE_FLOOR': 0.0},
    'growth from fix to fix': {'trust.receiver.LONGEST_GROWTH': 0.0},
    'inputs that repeat themselves': {'trust.repeats.SLOWEST': 1e9, 'trust.repeats.ROUNDED_SPEED': 1e9,
                                      'trust.repeats.ROUNDED_HEADING': 1e9, 'trust.repeats.AGEING': 0.0},
    'claims that change': {'trust.receiver.CLAIM_CHANGE': 1e9},
    'errors that last, always': {'trust.receiver.LASTING_SHARE': 0.0},
    'claims that nothing shows': {'trust.receiver.NEVER_SHOWN': 0.0},
    'acceleration unseen between fixes': {'trust.receiver.UNSEEN_ACCELERATION': 0.0},
    'slides': {'trust.contradiction.SLIDE': 1e9},
    'state loosened after a slide': {'trust.contradiction.LOOSENED': 1e9},
    'wrong standstills': {'trust.contradiction.LATELY': 0.0},
    'what contested fixes have moved': {'trust.contradiction.NO_CHANCE': 1e9},
    'receivers that go straight on': {'trust.straight_on.KNOWN': 1e9},
    'IMU doubted after straying': {'trust.imu_faults.DOUBT_TIME': 0.0},
    'turns too fast for the speed': {'trust.imu_faults.FASTEST_WHIRL': 1e9},
    'spikes': {'trust.imu_faults.LONGEST_SPIKE': 0.0},
    'frozen samples': {'trust.imu_faults.FROZEN_TIME': 1e9},
    'sensors freed after a restart': {'kernel.SHORTEST_RESTART': 1e9},
    'samples held before coasting': {'kernel.HELD': 0.0},
    'constraint left out where it is not kept': {'update.CONSTRAINT_OFF': 1e9},
    'standstill denied by speed': {'update.STILL_SPEED': 1e3},
    'standstill denied by turning': {'update.STILL_RATE': 1e3},
    'engine at a standstill': {'trust.standstill.JUMP': 1e9}}
#: settings of vehicle.py that are tried beside the faults
SETTINGS = ('car', 'car + speed')
#: what moves no row by more than this, m and percent, moves nothing
LEAST_M, LEAST_PERCENT = 0.05, 0.5
COLUMNS = ('change', 'row', 'rate_hz', 'error_m', 'within_95_percent')


def constants() -> dict[str, float]:
    """All numbers that stand at the top of the files in capitals, by `file.NAME` or `file.NAME[i]`."""
    found = {}
    folder = ROOT / 'mems_ins_fusion' / 'filter'
    for path in sorted(path for pattern in FILES for path in folder.glob(pattern)):
        module = '.'.join(path.relative_to(folder).with_suffix('').parts)
        for node in ast.parse(path.read_text(encoding='utf-8')).body:
            if isinstance(node, ast.Assign):
                for target in node.targets:
                    for name in (target.elts if isinstance(target, ast.Tuple) else [target]):
                        if isinstance(name, ast.Name) and name.id.isupper() and not name.id.startswith('_'):
                            found |= _numbers(f'{module}.{name.id}')
    return found


def _numbers(name: str) -> dict[str, float]:
    module, attribute = name.rsplit('.', 1)
    value = getattr(importlib.import_module(f'{PACKAGE}.{module}'), attribute)
    if isinstance(value, float):
        return {name: value}
    if isinstance(value, tuple) and all(isinstance(v, float) for v in value) and not hasattr(value, '_fields'):
        return {f'{name}[{i}]': v for i, v in enumerate(value)}
    return {}


def lay_over(changes: dict[str, float]) -> None:
    """Give constants other values, in each module that has them, before anything is compiled with them."""
    for name, value in changes.items():
        module, attribute = name.split('[')[0].rsplit('.', 1)
        old = getattr(importlib.import_module(f'{PACKAGE}.{module}'), attribute)
        new = value
        if '[' in name:
            i = int(name[name.index('[') + 1:-1])
            new = (*old[:i], value, *old[i + 1:])
        for known in [m for n, m in list(sys.modules.items()) if n.startswith(PACKAGE) and m is not None]:
            if known.__dict__.get(attribute) is old:
                setattr(known, attribute, new)


def work(job: dict) -> list[tuple[str, float, float, float]]:
    """Rows of one change: name, rate, error (m), share within the 95 % ellipse (%)."""
    sys.path.insert(0, str(ROOT / 'studies'))
    import mems_ins_fusion.filter.runs.live  # noqa: F401  all modules are there before a value is laid over them
    lay_over(job['constants'])
    import faults
    import vehicle

    rows = []
    for rate in job['rates']:
        if job['rows'] != 'vehicle':
            for fault in [f for f in faults.FAULTS if any(part in f.name for part in job['faults'])]:
                found = [faults.judged(fault, 2000 + seed, rate, job['values'])[0] for seed in range(job['seeds'])]
                until = fault.duration + 60.0
                errors = np.concatenate([o.error[(o.time >= 0) & (o.time <= until)] for o in found])
                held = np.concatenate([o.inside[(o.time >= 0) & (o.time <= until)] for o in found])
                rows.append((fault.name, rate, float(errors.max(initial=0.0)), 100.0 * float(held.mean())))
        if job['rows'] != 'faults':
            given = {'reference_lever_arm': [0.0, 0.0, 0.0], 'update_intervals': [1.0 / rate], **job['values']}
            receiver = vehicle.GnssNoise(1.5, rate=rate)
            for setting in SETTINGS:
                found = vehicle.pooled([vehicle.judge(vehicle.simulated(seed, 10.0, receiver),
                                                      {**vehicle.SETTINGS[setting], **given})
                                        for seed in range(job['seeds'])])
                rows.append((setting, rate, faults.rms(found.error), 100.0 * float(found.inside.mean())))
                rows.append((f'{setting}, 30 s without fixes', rate, float(np.percentile(found.largest[30.0], 95)),
                             100.0 * float(found.within[30.0].mean())))
    return rows


def _in_own_process(job: dict) -> list:
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
        if job['constants']:  # what is compiled is of no use to anybody else
            environment['NUMBA_CACHE_DIR'] = folder
        done = subprocess.run([sys.executable, __file__, '--work', json.dumps(job)], env=environment, text=True,
                              capture_output=True)
    if done.returncode:
        raise SystemExit(f"{job['change']}: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout.splitlines()[-1])


def jobs(arguments) -> list[dict]:
    """The filter as it is, then each mechanism off, then each constant with each factor."""
    base = {'constants': {}, 'values': {}, 'rows': arguments.rows, 'faults': arguments.faults, 'rates': arguments.rates,
            'seeds': arguments.seeds}
    made = [{**base, 'change': 'as it is'}]
    made += [{**base, 'change': f'without {name}', 'values': values} for name, values in MECHANISMS.items()]
    made += [{**base, 'change': f'without {name}', 'constants': values} for name, values in NEVER.items()]
    made += [{**base, 'change': f'{name} x {factor:g}', 'constants': {name: factor * value}}
             for name, value in constants().items() for factor in FACTORS]
    if arguments.only:
        made = [job for job in made if job['change'] == 'as it is' or any(o in job['change'] for o in arguments.only)]
    return made


def summary(rows: list[dict]) -> list[str]:
    """What moves nothing, and where the others help and cost most, against the filter as it is."""
    by_change = defaultdict(dict)
    for row in rows:
        by_change[row['change']][row['row'], row['rate_hz']] = (float(row['error_m']),
                                                                float(row['within_95_percent']))
    plain, lines, idle = by_change.pop('as it is'), [], []
    for change, found in by_change.items():
        moved = {key: (value[0] - plain[key][0], value[1] - plain[key][1]) for key, value in found.items()
                 if key in plain}
        if all(abs(m) < LEAST_M and abs(p) < LEAST_PERCENT for m, p in moved.values()):
            idle.append(change)
            continue
        best, worst = min(moved, key=lambda key: moved[key][0]), max(moved, key=lambda key: moved[key][0])
        lines.append(f'{change:45s} {moved[best][0]:+8.2f} m {best[0]} ({best[1]} Hz)   {moved[worst][0]:+8.2f} m '
                     f'{worst[0]} ({worst[1]} Hz)')
    return [*lines, f'move nothing: {", ".join(idle) or "none"}']


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--list', action='store_true', help='the constants and their values')
    parser.add_argument('--only', nargs='+', help='changes with one of these in their name')
    parser.add_argument('--rows', choices=('faults', 'vehicle', 'all'), default='all')
    parser.add_argument('--faults', nargs='+', default=[''], metavar='TEXT',
                        help='those with one of these in their name')
    parser.add_argument('--rates', nargs='+', type=float, default=[0.2, 1.0, 10.0], help='of the fixes, Hz')
    parser.add_argument('--seeds', type=int, default=2)
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--output', type=Path, default=Path('ablation.csv'))
    parser.add_argument('--work', help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.work:
        print(json.dumps(work(json.loads(arguments.work))))
        return
    if arguments.list:
        print('\n'.join(f'{name:45s} {value:g}' for name, value in constants().items()))
        return
    done = []
    if arguments.output.exists():
        with open(arguments.output, newline='') as file:
            done = list(csv.DictReader(file))
    finished = {row['change'] for row in done}
    with open(arguments.output, 'a', newline='') as file, ThreadPoolExecutor(arguments.processes) as pool:
        writer = csv.writer(file, lineterminator='\n')
        if not done:
            writer.writerow(COLUMNS)
        todo = [job for job in jobs(arguments) if job['change'] not in finished]
        for job, rows in zip(todo, pool.map(_in_own_process, todo)):
            writer.writerows((job['change'], *row) for row in rows)
            file.flush()
            print(job['change'], flush=True)
    with open(arguments.output, newline='') as file:
        print('\n'.join(summary(list(csv.DictReader(file)))))


if __name__ == '__main__':
    main()
