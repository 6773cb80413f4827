"""The filter's speed: CPU nanoseconds a sample, beside dense and per-sample filters of the same size in the same run.

    python studies/benchmarks/bench_filter.py [--minutes 60] [--repeats 5]

One hour at 100 Hz with a fix each second, and what a replay keeps of each state written out. The machine is noisy:
CPU time, medians of repeats, and ratios between what ran side by side.
"""
from __future__ import annotations

import argparse
import math
import statistics
import subprocess
import sys
import time

import numpy as np
from numba import njit

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.kernel import run
from mems_ins_fusion.filter.memory import PLANAR, Event, Kind
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.filter.runs.results import columns
from mems_ins_fusion.filter.start.initial import initialize
from mems_ins_fusion.filter.start.start import Start
from mems_ins_fusion.parameters import table

RATE = 100
#: the paper's filter, and what the defaults add to it
PAPER = {'mechanization': 'planar', 'vehicle.zero_velocity': False, 'vehicle.non_holonomic': False,
         'imu.mounting_sigma': 0.0, 'vehicle.rear_axle_sigma': 0.0}
STRAPDOWN = {**PAPER, 'mechanization': 'strapdown'}
CASES = {'planar RW': {**PAPER, 'sensor_error_model': 'random_walk'},
         'planar GM': {**PAPER, 'sensor_error_model': 'gauss_markov'},
         'planar AR(2)': {**PAPER, 'sensor_error_model': 'autoregressive',
                          'accelerometer.autoregressive.interval': 1 / RATE,
                          'gyroscope.autoregressive.interval': 1 / RATE},
         'strapdown GM': STRAPDOWN,
         'constraints': {**STRAPDOWN, 'vehicle.zero_velocity': True, 'vehicle.non_holonomic': True},
         'defaults': {}}
#: ns a sample to reach (issue 10)
GOALS = {'planar RW': 100, 'planar GM': 100, 'planar AR(2)': 130, 'strapdown GM': 500, 'constraints': 650}
LATITUDE, LONGITUDE = 0.84, 0.2
NO_EVENTS = np.zeros((0, Event.SIZE))


def recording(minutes: float):
    """Samples (k, 7): time, specific force and angular rate in sensor axes; fixes of a vehicle in a large slow circle
    to the right, and how many samples came before each."""
    rng = np.random.default_rng(1)
    n = round(minutes * 60 * RATE)
    stamp = np.arange(1, n + 1) / RATE
    force = np.array([0.0, -0.5, 9.81]) + rng.normal(0, 0.1, (n, 3))
    rate = np.array([0.0, 0.0, -0.05]) + rng.normal(0, 3e-3, (n, 3))
    fixes = np.zeros((int(n / RATE) - 1, Event.SIZE))
    fixes[:, Event.TIME] = np.arange(1, len(fixes) + 1) + 0.0037
    angle = 0.05 * fixes[:, Event.TIME]
    fixes[:, Event.LATITUDE] = LATITUDE + 200 * np.sin(angle) / 6.37e6
    fixes[:, Event.LONGITUDE] = LONGITUDE + 200 * (1 - np.cos(angle)) / 6.37e6 / math.cos(LATITUDE)
    fixes[:, [Event.R_NN, Event.R_EE, Event.R_DD]] = 2.25, 2.25, 5.0
    fixes[:, Event.KIND] = Kind.POSITION
    return np.column_stack([stamp, force, rate]), fixes, np.searchsorted(stamp, fixes[:, Event.TIME])


def started(values: dict):
    """Configuration and memory at the start of `recording`."""
    config = FilterConfig.from_parameters(table.check(values))
    memory = config.memory()
    initialize(memory, config, Start(0.0, LATITUDE, LONGITUDE, 0.0, np.array([10.0, 0.0]), 0.0,
                                     np.diag([2.0, 2.0, 0.1, 0.1, 0.01]), None))
    return config, memory


def kernel_seconds(values: dict, data) -> float:
    """CPU seconds of one call for all samples, what a replay keeps of every state written out."""
    samples, fixes, arrival = data
    config, memory = started(values)
    names, kept = columns(config.layout), np.arange(len(samples))
    states = np.empty((len(samples), len(names)))
    states.fill(0.0)  # touch the pages, which is not the filter's time
    fixes, answers = fixes.copy(), np.zeros(len(fixes), np.int64)
    begin = time.thread_time()
    run(memory, samples, fixes, arrival, answers, names, kept, states, NO_EVENTS)
    elapsed = time.thread_time() - begin
    assert np.all(answers == 0) and np.all(np.isfinite(states[-1]))
    return elapsed


@njit(cache=True)
def dense_filter(n, p, force, rate, states):
    """The same predictions and scalar corrections with dense n x n matrices, as a textbook writes them."""
    dt = 1.0 / RATE
    x, phi, q, cov, h = np.zeros(n), np.eye(n), np.eye(n) * 1e-8, np.eye(n), np.zeros(n)
    v_n, v_e, yaw = 10.0, 0.0, 0.0
    for k in range(len(force)):
        yaw += rate[k, 2] * dt
        c, s = np.cos(yaw), np.sin(yaw)
        f_n, f_e = c * force[k, 0] - s * force[k, 1], s * force[k, 0] + c * force[k, 1]
        v_n += f_n * dt
        v_e += f_e * dt
        phi[0, 2] = phi[1, 3] = phi[4, 5 + 2 * p] = dt
        phi[2, 4], phi[3, 4] = -f_e * dt, f_n * dt
        phi[2, 5], phi[2, 5 + p], phi[3, 5], phi[3, 5 + p] = c * dt, -s * dt, s * dt, c * dt
        for channel in range(3):
            start = 5 + channel * p
            phi[start, start] = 0.9997
            if p == 2:
                phi[start, start + 1], phi[start + 1, start], phi[start + 1, start + 1] = -1e-4, 1.0, 0.0
        x = phi @ x
        cov = phi @ cov @ phi.T + q
        if k % RATE == RATE - 1:
            for axis in range(2):
                h[:] = 0.0
                h[axis] = 1.0
                gain = cov @ h / (h @ cov @ h + 2.25)
                x = x - gain * (h @ x)
                joseph = np.eye(n) - np.outer(gain, h)
                cov = joseph @ cov @ joseph.T + 2.25 * np.outer(gain, gain)
        for i in range(n):
            states[k, i] = x[i]


def numpy_filter(n: int, force, rate) -> None:
    """The same, one sample at a time in NumPy."""
    states = np.empty((len(force), n))
    dense_filter.py_func(n, (n - 5) // 3, force, rate, states)


def median_cpu(function, repeats: int) -> float:
    """Median CPU seconds of a call."""
    taken = []
    for _ in range(repeats):
        begin = time.thread_time()
        function()
        taken.append(time.thread_time() - begin)
    return statistics.median(taken)


def single_calls(values: dict, count: int = 20000) -> tuple[np.ndarray, np.ndarray]:
    """Wall nanoseconds of each sample, and of each fix that is a little late, as one call from Python."""
    _, memory = started(values)
    record = np.zeros((1, Event.SIZE))
    record[0, [Event.KIND, Event.LATITUDE, Event.LONGITUDE, Event.R_NN, Event.R_EE, Event.R_DD]] = (
        Kind.POSITION, LATITUDE, LONGITUDE, 2.25, 2.25, 5.0)
    sample, before, answer = np.array([[0.0, 0.0, 0.5, 9.81, 0.0, 0.0, 0.05]]), np.zeros(1, np.int64), np.zeros(
        1, np.int64)
    names, none, states = np.zeros(0, np.uint64), np.zeros(0, np.int64), np.zeros((0, 0))
    clock, steps, fixes = time.perf_counter_ns, np.empty(count), []
    for k in range(count):
        now = (k + 1) / RATE
        begin = clock()
        sample[0, 0] = now
        run(memory, sample, NO_EVENTS, none, none, names, none, states, NO_EVENTS)
        steps[k] = clock() - begin
        if k % RATE == 50:
            record[0, Event.TIME] = now - 0.0013  # a little late: the last interval is done again, split
            begin = clock()
            run(memory, sample[:0], record, before, answer, names, none, states, NO_EVENTS)
            fixes.append(clock() - begin)
    return steps[100:], np.array(fixes[2:])


def live_fixes(minutes: float = 5.0) -> np.ndarray:
    """CPU nanoseconds of each fix in the live filter (`FusionFilter.add_fix`), a message of its own each."""
    samples, fixes, arrival = recording(minutes)
    fusion, taken, k = FusionFilter(FilterConfig.from_parameters(table.defaults())), [], 0
    for fix, before in zip(fixes, arrival):
        for sample in samples[k:before].tolist():
            fusion.add_imu(round(sample[0] * 1e9), *sample[1:])
        k, position = before, fix[[Event.LATITUDE, Event.LONGITUDE, Event.HEIGHT]].tolist()
        stamp, covariance = round(fix[Event.TIME] * 1e9) - 5_000_000, np.diag([2.25, 2.25, 5.0]).ravel()
        begin = time.thread_time_ns()
        fusion.add_fix(stamp, *position, covariance)
        taken.append(time.thread_time_ns() - begin)
    assert fusion.tallies['fix'].used > 0.9 * len(fixes)
    return np.array(taken[len(taken) // 2:])


def clock_overhead(count: int = 20000) -> float:
    """Mean ns that a pair of clock readings takes."""
    clock = time.perf_counter_ns
    return statistics.mean(-(clock() - clock()) for _ in range(count))


def import_seconds(repeats: int) -> tuple[float, float]:
    """CPU seconds of a new process that makes a filter ready for its first message, and of one that imports NumPy."""
    ready = ('from mems_ins_fusion.parameters import table; from mems_ins_fusion.filter.config import FilterConfig; '
             'from mems_ins_fusion.filter.runs.live import FusionFilter; '
             'FusionFilter(FilterConfig.from_parameters(table.check({}))).warm_up()')
    measure = 'import time; {}; print(time.process_time())'
    taken = [[float(subprocess.run([sys.executable, '-c', measure.format(code)], capture_output=True, check=True,
                                   text=True).stdout) for _ in range(repeats)] for code in (ready, 'import numpy')]
    return statistics.median(taken[0]), statistics.median(taken[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--repeats', type=int, default=5)
    options = parser.parse_args()
    data = recording(options.minutes)
    samples, fixes, _ = data
    force, rate = samples[:, 1:4], samples[:, 4:]
    short = slice(0, 20000)
    for values in CASES.values():  # compile
        kernel_seconds(values, (samples[:300], fixes[:1], data[2][:1]))
    dense_filter(8, 1, force[:10], rate[:10], np.empty((10, 8)))
    print(f'{len(samples)} samples at {RATE} Hz, {len(fixes)} fixes; CPU ns a sample, median of {options.repeats}')
    print(f'{"":13} {"kernel":>7} {"goal":>5} {"dense":>7} {"ratio":>6} {"NumPy":>8} {"ratio":>6}')
    for name, values in CASES.items():
        kernel = statistics.median(kernel_seconds(values, data) for _ in range(options.repeats)) / len(samples)
        config, _ = started(values)
        n = config.layout.n
        line = f'{name:13} {kernel * 1e9:7.1f} {GOALS.get(name, math.nan):5.0f}'
        if config.mechanization == PLANAR:
            out = np.empty((len(force[short]), n))
            dense = median_cpu(lambda n=n, p=config.layout.order, out=out: dense_filter(
                n, p, force[short], rate[short], out), options.repeats) / len(out)
            slow = median_cpu(lambda n=n: numpy_filter(n, force[:2000], rate[:2000]), 3) / 2000
            line += f' {dense * 1e9:7.0f} {dense / kernel:6.1f} {slow * 1e9:8.0f} {slow / kernel:6.0f}'
        print(line)
    overhead = clock_overhead()
    print('\none call from Python, wall microseconds (goals: sample 1 mean, 2 at 99 %; fix 2)')
    for name, values in CASES.items():
        steps, fixes = (1e-3 * (part - overhead) for part in single_calls(values))
        print(f'{name:13} sample mean {steps.mean():5.2f}  median {np.median(steps):5.2f}  99 % '
              f'{np.percentile(steps, 99):5.2f}   fix median {np.median(fixes):5.2f}')
    taken = 1e-3 * live_fixes()
    print(f'\na fix in the live filter, CPU microseconds: median {np.median(taken):.0f}, '
          f'10 % {np.percentile(taken, 10):.0f}')
    ready, numpy = import_seconds(min(options.repeats, 3))
    print(f'\nready for the first message, compiled code cached: {ready:.2f} s CPU, of which NumPy {numpy:.2f} s')


if __name__ == '__main__':
    main()
