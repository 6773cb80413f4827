"""How long `fleet` takes to write its tables when it is interrupted, and when it ends by itself, with so many results.

    python studies/fleet_interruption.py --recordings 10000

Results are made up, as large as those of a replay with three models and three lengths of outages: 20 recordings of each
vehicle. Printed is CPU time of the one process, which does not depend on what else the machine does.
"""
from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from mems_ins_fusion.fleet import run, tables, work
from mems_ins_fusion.fleet.sources import content_id, size_and_time

MODELS, DURATIONS = ('gauss_markov', 'random_walk', 'autoregressive'), (10.0, 30.0, 60.0)
EFFECTS = [('gnss_time_offset', 'time_offset'), *(('gnss_lever_arm', axis) for axis in 'xy'),
           *(('mounting_rotation', name) for name in ('roll', 'pitch', 'yaw')), ('receiver', 'scatter')]


def result(rng, number: int) -> dict:
    """That of one recording."""
    common = {'mechanization': 'strapdown', 'stage': '', 'update_interval_s': 1.0}
    numbers = [n for n, kind in tables.TABLES['results'].items() if kind == tables.NUMBER and n not in common]
    rows = {
        'results': [{'model': m, **common, **dict(zip(numbers, rng.random(len(numbers)).tolist()))} for m in MODELS],
        'outages': [{'model': m, **common, 'duration_s': t, 'count': 17, 'max_error_rms_m': t * float(rng.random())}
                    for m in MODELS for t in DURATIONS],
        'effects': [work.effect_row('configure', *name, float(rng.normal(1.0, 0.1)), 0.1, 'm') for name in EFFECTS],
        'findings': [{'source': 'checker', 'severity': 'warning', 'topic': 'imu', 'message': 'a gap of 1.2 s at 13 s'}]}
    about = {'begin_ns': 10**18 + number * 10**12, 'duration_s': 1200.0, 'imu_samples': 120_000, 'fixes': 1200}
    return {'status': 'done', 'error_id': '', 'reason': '', 'rows': rows, 'recording': about, 'page': ''}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--recordings', type=int, default=10_000)
    options = parser.parse_args()
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        os.chdir(name)
        for i in range(options.recordings):
            path = Path(f'logs/car_{i // 20}/drive_{i % 20}.mcap')
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(str(i))
        asked = run.FleetTask('logs', 'replay', Path('out'), pages=False)
        entries, states = run._entries(asked)
        run._claim(asked)
        known = run._Known(asked)
        known._read = {e.recording: content_id(Path(e.recording)) for e in entries}
        known._contents = {e.recording: (known.content(e), *size_and_time(e.recording)) for e in entries}
        for number, job in enumerate(known.alone(entries).values()):
            folder = asked.output / work.RESULTS / job.id
            folder.mkdir()
            work.write(folder, result(rng, number))
        for words, step in (('to look up what is done', lambda: known.load(entries)),
                            ('interrupted: tables', lambda: run._interrupted(asked, known, entries)),
                            ('ended: tables, histories, page', lambda: run._written(asked, known, entries, states))):
            began = time.process_time()
            step()
            print(f'{options.recordings} recordings, {words}: {time.process_time() - began:.1f} s of CPU', flush=True)


if __name__ == '__main__':
    main()
