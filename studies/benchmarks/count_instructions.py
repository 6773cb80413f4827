"""The filter's work without a clock: machine instructions a sample, counted by valgrind, the same on any busy machine.

    python studies/benchmarks/count_instructions.py

The cases of bench_filter.py with what a replay keeps of each state; the defaults with the copies without fixes for the
trust horizon (`runs/withheld.py`), and all that is Python of them: in the first minutes, where they follow each other
at once, and later, beside the same playback without copies. Needs valgrind with its headers, and a C compiler: so small
a library as below switches the counting on behind the imports. The code is compiled for a processor that valgrind
knows, in a cache of its own (a few minutes the first time).
"""
from __future__ import annotations

import ctypes
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from bench_filter import CASES, NO_EVENTS, recording, started

from mems_ins_fusion.filter.kernel import run
from mems_ins_fusion.filter.memory import Event
from mems_ins_fusion.filter.runs.replay import Copies, Events, Playback
from mems_ins_fusion.filter.runs.results import columns
from mems_ins_fusion.filter.runs.withheld import COPIES_AT_ONCE, PERIODS_APART

#: samples before the count, and in it
WARM, COUNTED = 1000, 3000
SWITCH = """#include <valgrind/callgrind.h>
void on(void) { CALLGRIND_START_INSTRUMENTATION; CALLGRIND_TOGGLE_COLLECT; }
void off(void) { CALLGRIND_TOGGLE_COLLECT; CALLGRIND_STOP_INSTRUMENTATION; CALLGRIND_DUMP_STATS; }
"""
PROCESSOR = {'NUMBA_CPU_NAME': 'haswell', 'NUMBA_CPU_FEATURES': '+avx,+avx2,+fma,+bmi,+bmi2,+lzcnt,+popcnt,+sse,+sse2,'
             '+sse3,+ssse3,+sse4.1,+sse4.2,+cx16,+64bit,+cmov,+movbe,+fxsr,+xsave'}


def run_case(values: dict, switch) -> None:
    """Counted twice: a call without samples, and one with COUNTED of them."""
    samples, fixes, arrival = recording((WARM + COUNTED) / 6000 + 0.1)
    config, memory = started(values)
    kept, names = np.arange(COUNTED), columns(config.layout)
    states = np.zeros((COUNTED, len(names)))
    for begin, end in ((0, WARM), (WARM, WARM), (WARM, WARM + COUNTED)):
        mine = (arrival >= begin) & (arrival < end)
        arguments = (memory, samples[begin:end], fixes[mine], arrival[mine] - begin, np.zeros(mine.sum(), np.int64),
                     names, kept[:end - begin], states, NO_EVENTS)
        if begin:
            switch.on()
        run(*arguments)
        if begin:
            switch.off()


def run_copies(switch) -> None:
    """Counted three times, over the samples of whole copies: the defaults with the second copy, with those after
    COPIES_AT_ONCE copies, and without."""
    later = COPIES_AT_ONCE + PERIODS_APART
    samples, fixes, arrival = recording((later + PERIODS_APART + 1) * COUNTED / 6000 + 0.1)
    numbers = np.arange(len(fixes))
    fixes[:, Event.ID] = numbers
    config, memory = started({})
    names, kept = columns(config.layout), np.arange(len(samples))
    work = Playback(samples, Events(numbers, numbers, arrival, fixes, 0 * numbers), names, kept,
                    np.zeros((len(samples), len(names))))
    copies = Copies(config, work, 0.0)
    for begin, end in ((2, 3), (later, later + PERIODS_APART)):
        copies.advance(memory, begin * COUNTED)
        switch.on()
        copies.advance(memory, end * COUNTED)
        switch.off()
    switch.on()
    work.advance(memory, (later + PERIODS_APART + 1) * COUNTED)
    switch.off()


def run_all(switch) -> None:
    for values in CASES.values():
        run_case(values, switch)
    run_copies(switch)


def main() -> None:
    if len(sys.argv) > 1:  # the process that is counted, and before it the one that compiles
        run_all(ctypes.CDLL(sys.argv[1]) if sys.argv[1] != 'compile' else SimpleNamespace(on=int, off=int))
        return
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        (here / 'switch.c').write_text(SWITCH, encoding='ascii')
        subprocess.run(['cc', '-shared', '-fPIC', '-o', 'switch.so', 'switch.c'], cwd=here, check=True)
        environment = {**os.environ, **PROCESSOR, 'NUMBA_CACHE_DIR': str(Path.home() / '.cache' / 'counted')}
        subprocess.run([sys.executable, __file__, 'compile'], env=environment, check=True)
        subprocess.run(['valgrind', '-q', '--tool=callgrind', '--trace-children=yes', '--instr-atstart=no',
                        '--collect-atstart=no', f'--callgrind-out-file={here}/count', sys.executable, __file__,
                        str(here / 'switch.so')], env=environment, check=True)
        counts = [int(re.search(r'^totals: (\d+)', (here / f'count.{i + 1}').read_text(), re.M)[1])
                  for i in range(2 * len(CASES) + 3)]
    print('instructions a sample')
    for name, without, whole in zip(CASES, counts[::2], counts[1::2]):
        print(f'{name:13} {(whole - without) / COUNTED:7.0f}')
    first, later, without = counts[-3:]
    later /= PERIODS_APART
    print(f'with copies   {first / COUNTED:7.0f} ({first / without:.3f} times), later {later / COUNTED:.0f} '
          f'({later / without:.3f} times)')


if __name__ == '__main__':
    main()
