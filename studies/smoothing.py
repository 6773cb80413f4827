"""What smoothing makes of a recording, with all fixes and through outages, beside the filter.

    python studies/smoothing.py [--data ../shared/data] [--minutes 10] [--output FILE.md]

Fixes each second, defaults. RMSE and how often the 95 % ellipse held the truth; then the largest error in outages of
10, 30 and 60 s every 60 s, median / 95 %, and how often the ellipse held the end of it (smoothed: its middle).
"""
from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from vehicle import DURATIONS, FIXES, MEASURED, measured, simulated

from mems_ins_fusion.evaluation.comparison import fixes_apart, samples_to_keep, truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors, rms
from mems_ins_fusion.evaluation.outages import outage_begins, run_outages, smooth_outages
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.runs.smoothing import smoothed
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding

SPACING = 60.0


def rows_of(name: str, recording, values: dict):
    """Two lines of the table: filter and smoother."""
    values = table.check(values)
    config, truth = FilterConfig.from_parameters(values), truth_of(recording, values)
    keep = samples_to_keep(recording.imu, truth.reference.stamp)
    given = config, recording.imu, recording.gnss.select(fixes_apart(recording.gnss, 1.0))
    filtered, after = run(*given, keep=keep), smoothed(*given, keep=keep)
    begin = outage_begins(int(filtered.stamp[0]), given[2], config.gnss.time_offset, SPACING, min(DURATIONS))
    both = (('filter', filtered, run_outages(*given, truth, DURATIONS, begin, keep=keep)),
            ('smoothed', after, smooth_outages(*given, truth, DURATIONS, begin, Aiding(), keep, filtered)))
    for kind, track, outages in both:
        errors = position_errors(track, truth, np.zeros(len(truth), dtype=bool))
        cells = [f'{rms(errors.horizontal):.3g}', f'{100 * np.mean(errors.nees < NEES_95):.0f} %']
        for o in outages:
            cells += [' / '.join(f'{float(f"{np.percentile(o.max_error, q):.2g}"):g}' for q in (50, 95)),
                      f'{100 * o.within.mean():.0f} %']
        yield f'| {name} | {kind} | {" | ".join(cells)} |'


def drives(data: Path, minutes: float):
    for fixes in ('1.5 m', 'RTK'):
        yield f'simulated 1000, {fixes}', simulated(1000, minutes, FIXES[fixes]), {}
    for name in ('karlsruhe_hills', 'kingston_span', 'longmont_rtk_drive'):
        if (data / name).exists():
            yield name, measured(name, data), MEASURED[name].values
    if (data / 'longmont_rtk_drive').exists():
        yield ('longmont_rtk_drive, its time offset given', measured('longmont_rtk_drive', data),
               {**MEASURED['longmont_rtk_drive'].values, 'gnss.time_offset': -0.264})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--minutes', type=float, default=10.0)
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    titles = ['drive', '', 'RMSE, m', 'in 95 %', *(t for d in DURATIONS for t in (f'{d:g} s, m', 'in 95 %'))]
    lines = [f'| {" | ".join(titles)} |', f'|{"---|" * len(titles)}']
    print(*lines, sep='\n')
    for drive in drives(options.data, options.minutes):
        for line in rows_of(*drive):
            print(line, flush=True)
            lines.append(line)
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
