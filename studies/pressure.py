"""What a barometer gives: errors of the height on hilly simulated drives, with fixes and in 60 s without.

    python studies/pressure.py

Fixes of 1.5 m, 4 m in height; a barometer of 10 Hz and 5 Pa whose weather is 80 m off and wanders by 0.05 m/sqrt(s).
What is printed stands in docs/filter.md, "Height from pressure".
"""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run_with_outages
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

#: s: of a drive, of an outage, and where these begin
DURATION, OUTAGE, BEGINS = 300.0, 60.0, (60, 120, 180, 230)
DRIVES = 8


def main() -> None:
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    error, largest = {'': [], '/pressure': []}, {'': [], '/pressure': []}
    for seed in range(DRIVES):
        drive = simulate_drive(DURATION, seed, 50.0, standstill=10.0, hills=True)
        recording = simulate_recording(drive, sensors, GnssNoise(1.5, 1.0, vertical_sigma=4.0), seed=seed,
                                       aiding=SimulatedAiding(pressure_rate=10.0)).recording
        begin = recording.imu.stamp[0] + np.array(BEGINS) * 10**9
        for topic in error:
            config = FilterConfig.from_parameters(table.check({'pressure_topic': topic}))
            aiding = Aiding(pressure=recording.others['pressure']) if topic else Aiding()
            whole, outages = run_with_outages(config, recording.imu, recording.gnss, begin, OUTAGE, aiding)
            away, lost = (run.height - np.interp(run.stamp, drive.stamp, drive.height) for run in (whole, outages.run))
            error[topic].append(np.sqrt(np.mean(away[whole.stamp > begin[0]] ** 2)))
            largest[topic] += [np.abs(lost[a:b]).max() for a, b in zip(outages.first[:-1], outages.first[1:])]
    for topic, name in (('', 'fixes alone'), ('/pressure', 'with pressure')):
        print(f'{name}: with fixes {np.median(error[topic]):.1f} m RMS; at most in {OUTAGE:.0f} s without, median and '
              f'95 %: {np.median(largest[topic]):.1f}, {np.percentile(largest[topic], 95):.1f} m')


if __name__ == '__main__':
    main()
