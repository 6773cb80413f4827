"""How much memory a worker of `fleet` takes for a recording, by its length.

    python studies/fleet_memory.py --hours 0.25 1 2

Simulated drives, IMU 100 Hz and fixes 1 Hz, replayed one by one with the default parameters and pages; printed is the
most that the largest process had in memory (ru_maxrss), and its CPU time.
"""
from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

TOOL = [sys.executable, '-m', 'mems_ins_fusion']


def run(*words) -> tuple[float, float]:
    """GB at most of the largest process so far, and CPU seconds of this run with all its processes."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([*TOOL, *map(str, words)], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_maxrss * 1024e-9, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--hours', type=float, nargs='+', default=[0.25, 1.0, 2.0], help='ascending')
    parser.add_argument('--params-file', default='')
    options = parser.parse_args()
    more = ['--params-file', options.params_file] if options.params_file else []
    with tempfile.TemporaryDirectory() as name:
        for hours in options.hours:
            drive = Path(name) / f'{hours:g}_h' / 'drive'
            simulated, _ = run('simulate', '--output', drive, '--duration', 3600 * hours)
            most, cpu = run('fleet', drive, '--task', 'replay', '--workers', 1, '--memory', 100, *more, '--output',
                            f'{drive}_out')
            told = f'{most:.2f} GB' if most > simulated else f'less than the {simulated:.2f} GB of simulate'
            print(f'{hours:g} h: {told}, {cpu:.0f} s of CPU', flush=True)


if __name__ == '__main__':
    main()
