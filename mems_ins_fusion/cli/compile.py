"""`compile`: compiles the filter in advance, so that no tool waits for the compiler."""
from __future__ import annotations

import time

from mems_ins_fusion.cli.command import Parser

DESCRIPTION = """\
Compile the filter and all other compiled code ahead, for this machine, user and version: the first start of the node
then takes a second instead of a minute (minutes on a small computer). What is compiled already is not compiled again.
The code is kept in ~/.cache/mems_ins_fusion, or in the folder that NUMBA_CACHE_DIR or XDG_CACHE_HOME names."""


def main(argv: list[str] | None = None) -> int:
    """Compile; the exit status."""
    _parser().parse_args(argv)
    # imported only now: that takes a second
    from mems_ins_fusion.compiled import FOLDER

    parts = {'live filter': _live, 'replay': _replay, 'several IMUs': _imus, 'characterization': _characterization,
             'diagnosis': _diagnosis}
    for number, (name, part) in enumerate(parts.items(), 1):
        print(f'{number}/{len(parts)} {name} ...', end=' ', flush=True)
        began = time.monotonic()
        part()
        print(f'{time.monotonic() - began:.1f} s', flush=True)
    print(f'compiled code is in {FOLDER}')
    return 0


def _live():
    from mems_ins_fusion.filter.config import FilterConfig
    from mems_ins_fusion.filter.runs.live import FusionFilter
    from mems_ins_fusion.parameters import table

    FusionFilter(FilterConfig.from_parameters(table.defaults())).warm_up()


def _replay():
    from mems_ins_fusion.evaluation.comparison import compare
    from mems_ins_fusion.parameters import table

    recording = _drive()
    for mechanization in ('planar', 'strapdown'):
        compare(recording, table.check({'mechanization': mechanization, 'models': ['gauss_markov'],
                                        'update_intervals': [1.0], 'outage_durations': [10.0]}))


def _imus():
    from mems_ins_fusion.filter.runs.imus import Imus
    from mems_ins_fusion.parameters import table

    Imus(table.check({'inputs': ['second'], 'second.type': 'imu', 'second.topic': '/second'})).warm_up()


def _diagnosis():
    from mems_ins_fusion.diagnosis.online import warm_up

    warm_up(_drive())


def _characterization():
    import numpy as np

    from mems_ins_fusion.characterization.likelihood import average, log_likelihood, state_space
    from mems_ins_fusion.sensor_errors.models import GaussMarkov

    averages = average([np.random.default_rng(0).standard_normal(1000)], 10, 0.1)
    log_likelihood(averages, state_space(GaussMarkov(0.1, 10.0), 0.1, averages.interval))


def _drive():
    from mems_ins_fusion.simulation.simulation import simulate_drive, simulate_recording

    return simulate_recording(simulate_drive(60.0, seed=1, rate=20.0)).recording


def _parser():
    return Parser('compile', DESCRIPTION)
