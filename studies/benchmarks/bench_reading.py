"""Reading, writing and checking of an hour at 100 Hz: CPU time a message, beside rosbags' ordinary way in the same run.

    python studies/benchmarks/bench_reading.py [--minutes 60]
"""
from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from mems_ins_fusion.recordings.checker import check_recording
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import STORAGES, write_recording
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording

GOAL = 2.5  # microseconds a message


def recording(minutes: float) -> Recording:
    """An IMU at 100 Hz and fixes at 1 Hz."""
    generator = np.random.default_rng(1)
    stamp = 1_700_000_000_000_000_000 + np.arange(round(minutes * 6000)) * 10_000_000
    slow = stamp[::100]
    count = len(slow)
    return Recording(
        'benchmark', ImuSamples(stamp, stamp + 2_000_000, generator.normal(size=(len(stamp), 3)),
                                generator.normal(size=(len(stamp), 3))),
        Fixes(slow, slow + 50_000_000, np.full(count, 0.8), np.full(count, 0.2), np.zeros(count),
              np.tile(np.eye(3), (count, 1, 1)), np.zeros(count, np.int8), np.full(count, 2, np.uint8)))


def cpu(function, repetitions=3) -> float:
    """Median CPU seconds of a call."""
    times = []
    for _ in range(repetitions):
        start = time.process_time()
        function()
        times.append(time.process_time() - start)
    return statistics.median(times)


def ordinary(path: Path) -> None:
    """The same fields through rosbags' own deserialization."""
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--minutes', type=float, default=60.0)
    made = recording(parser.parse_args().minutes)
    count = len(made.imu) + len(made.gnss)
    print(f'{count} messages; CPU microseconds a message (goal for reading: {GOAL})')
    with tempfile.TemporaryDirectory() as folder:
        for storage in STORAGES:
            path = Path(folder) / storage
            write = cpu(lambda path=path, storage=storage: write_recording(made, path, storage), 1)
            read = cpu(lambda path=path: read_recording(path, '/imu/data', '/gps/fix'))
            slow = cpu(lambda path=path: ordinary(path), 1)
            print(f'{storage:8} write {write / count * 1e6:6.2f}   read {read / count * 1e6:6.2f}   '
                  f'rosbags {slow / count * 1e6:6.2f}   ratio {slow / read:5.1f}')
    check_recording(made)  # compiles and imports
    print(f'check of the recording: {cpu(lambda: check_recording(made)):.3f} s')


if __name__ == '__main__':
    main()
