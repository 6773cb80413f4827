"""How long N recordings take on k workers: simulated, with the assumptions stated, and measured on this machine.

    python studies/fleet_scheduler.py                        # 10 000 recordings on 1, 10, 100 and 1000 workers
    python studies/fleet_scheduler.py --measure LOGS PARAMS  # the recordings in LOGS on one and on two processes

Assumptions of the simulation. Recordings are independent and handed out one at a time to whoever is free, the largest
first. Their lengths are log-normal (median 20 min, a factor 2 each way in 68 of 100), at most 8 h; a recording takes
SECONDS_PER_HOUR of CPU, by this package's table of numbers, and a worker's core is its own. A worker starts in START s,
once. The scheduler hands out one recording in HANDED s (Dask's documentation: about 1 ms of overhead a task, here with
a result folder on a shared disk) and does nothing else meanwhile. One worker in a hundred dies in the run; its
recording starts again elsewhere.
"""
from __future__ import annotations

import argparse
import heapq
import os
import resource
import subprocess
import sys
import tempfile
import time

import numpy as np

#: CPU seconds of a replay with pages for an hour at 100 Hz with three models; of a worker until it is ready; and of the
#: scheduler for one recording
SECONDS_PER_HOUR, START, HANDED = 60.0, 8.0, 0.003
DEAD = 0.01


def simulate(recordings: int, workers: int, seed: int = 0) -> tuple[float, float, float]:
    """Seconds until all is done, N/k times the mean of one recording, and of the longest one."""
    rng = np.random.default_rng(seed)
    hours = np.minimum(np.exp(np.log(1 / 3) + np.log(2.0) * rng.standard_normal(recordings)), 8.0)
    seconds = SECONDS_PER_HOUR * hours
    free = [(START, i) for i in range(workers)]
    heapq.heapify(free)
    dies = rng.random(workers) < DEAD
    left, scheduler, end = sorted(seconds), 0.0, 0.0  # the largest is handed out first
    while left:
        time_free, worker = heapq.heappop(free)
        scheduler = max(scheduler, time_free) + HANDED
        need = left.pop()
        if dies[worker] and rng.random() < 0.2:  # at some recording, half way through it
            dies[worker] = False
            left.append(need)
            heapq.heappush(free, (scheduler + 0.5 * need + START, worker))
            continue
        done = scheduler + need
        end = max(end, done)
        heapq.heappush(free, (done, worker))
    return end, float(seconds.sum() / workers), float(seconds.max())


def measure(logs: str, params: str, rounds: int) -> None:
    """One process against two, in turns: wall-clock time on an idle machine, and CPU time on one that is not."""
    wall: dict[int, list[float]] = {1: [], 2: []}
    cpu: dict[int, list[float]] = {1: [], 2: []}
    for _ in range(rounds):
        for workers in (1, 2):
            with tempfile.TemporaryDirectory() as folder:
                began, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN)
                subprocess.run([sys.executable, '-m', 'mems_ins_fusion', 'fleet', logs, '--task', 'replay',
                                '--no-pages', '--params-file', params, '--workers', str(workers), '--output',
                                f'{folder}/out'], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                after = resource.getrusage(resource.RUSAGE_CHILDREN)
            wall[workers].append(time.monotonic() - began)
            cpu[workers].append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
            print(f'{workers} processes: {wall[workers][-1]:.1f} s, {cpu[workers][-1]:.1f} s of CPU; load of the '
                  f'machine {os.getloadavg()[0]:.1f}', flush=True)
    ratio = 2 * min(wall[2]) / min(wall[1])
    print(f'two processes take {ratio:.2f} N/k times one (wall-clock, the shortest of each); all their CPU is '
          f'{min(cpu[2]) / min(cpu[1]):.2f} of that of one')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--measure', nargs=2, metavar=('LOGS', 'PARAMS'))
    parser.add_argument('--rounds', type=int, default=3)
    parser.add_argument('--recordings', type=int, default=10_000)
    options = parser.parse_args()
    if options.measure:
        measure(*options.measure, options.rounds)
        return
    print(f"{'workers':>8}{'hours':>9}{'N/k times one, h':>18}{'ratio':>8}{'longest recording, h':>22}")
    for workers in (1, 10, 100, 1000):
        end, ideal, longest = simulate(options.recordings, workers)
        print(f'{workers:>8}{end / 3600:>9.3f}{ideal / 3600:>18.3f}{end / ideal:>8.3f}{longest / 3600:>22.3f}')


if __name__ == '__main__':
    main()
