"""A recording through the filter at once, and its track as a picture.

python examples/replay_and_plot.py BAG PICTURE.png
"""
from __future__ import annotations

import sys

from matplotlib.figure import Figure

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording


def main(bag: str, picture: str) -> None:
    values = table.check({})  # a car; {'gnss.lever_arm': [0.5, 0.0, 1.2]} and so on
    recording = read_recording(bag, values['imu_topic'], values['gnss_topic'])
    result = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss)
    for notice in result.notices:
        print(notice.text)

    fixes = recording.gnss
    datum = fixes.latitude[0], fixes.longitude[0], fixes.height[0]
    figure = Figure(figsize=(8, 8), layout='constrained')
    axes = figure.subplots()
    for label, style, track in (('fixes', '.', fixes), ('filter', '-', result)):
        north, east, _ = to_local(track.latitude, track.longitude, track.height, datum)
        axes.plot(east, north, style, label=label)
    axes.set(xlabel='east, m', ylabel='north, m', aspect='equal')
    axes.legend()
    figure.savefig(picture)
    print(f'{len(result.stamp)} states, mean NIS {result.innovations.nis.mean():.2f} (2 is expected): {picture}')


if __name__ == '__main__':
    main(*sys.argv[1:])
