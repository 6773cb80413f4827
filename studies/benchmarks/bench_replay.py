"""CPU time of a replay: three models at three update intervals on one hour at 100 Hz, and its parts.

    python studies/benchmarks/bench_replay.py [REPEATS]

Simulates the hour first, and replays it REPEATS + 1 times; the first, which may compile the filter, does not count.
Target: 2.5 s for reading and the nine runs, 10 s with outages, report, figures and trajectories.
"""
from __future__ import annotations

import statistics
import sys
import tempfile
import time
from pathlib import Path

from mems_ins_fusion.__main__ import main as tool
from mems_ins_fusion.evaluation.comparison import compare
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.reports.replay import replay_recordings


def cpu_seconds(function, *arguments):
    """What `function` returns, and its CPU time, all threads together."""
    began = time.process_time()
    result = function(*arguments)
    return result, time.process_time() - began


def measure(bag: Path, folder: Path) -> dict[str, float]:
    """CPU seconds of reading, the nine runs with their errors, the filter in them, and of a whole replay by parts."""
    values = table.check({'bag': [str(bag)], 'output_dir': str(folder), 'overwrite': True,
                               'reference_topic': '/reference/fix'})
    recording, reading = cpu_seconds(read_recording, bag, '/imu/data', '/gps/fix', '/reference/fix')
    nine, runs = cpu_seconds(compare, recording, {**values, 'outage_durations': []})
    result, whole = cpu_seconds(replay_recordings, values)
    return {'reading': reading, 'nine runs with their errors': runs,
            '  of that the filter': sum(r.run.filter_seconds for r in nine.runs),
            'reading and nine runs': reading + runs,
            'whole replay': whole, **{f'  {name}': s for name, s in result.content['seconds'].items()}}


def main(repeats: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / 'hour'
        tool(['simulate', '--output', str(bag), '--duration', '3600', '--seed', '1'])
        measured = [measure(bag, Path(folder) / 'result') for _ in range(repeats + 1)][1:]
    for name in measured[0]:
        seconds = [m[name] for m in measured]
        print(f'{name:<30}{statistics.median(seconds):7.2f} s   ({min(seconds):.2f} to {max(seconds):.2f})')


if __name__ == '__main__':
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
