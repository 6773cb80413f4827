"""How long a diagnosis of one hour at 100 Hz takes after reading, all effects as candidates; by hand.

    python studies/benchmarks/bench_diagnose.py
"""
from __future__ import annotations

import time

from mems_ins_fusion.diagnosis.diagnose import diagnose
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

VALUES = table.check({'reference_lever_arm': [0.0, 0.0, 0.0]})
OFFSET = {'gnss_time_offset': {'time_offset': 0.2}}
#: what is in the recording, and whether the road has hills, which `tilt` takes out by the strapdown mechanization
CASES = {'no effect': ({}, False), 'one effect': (OFFSET, False),
         'two effects': ({**OFFSET, 'gyroscope_scale': {'z': 0.03}}, False),
         'three effects and hills': ({**OFFSET, 'gyroscope_scale': {'z': 0.03}, 'temperature': {}}, True)}


def recording(duration: float, effects: dict, hills: bool):
    sensors = SensorErrors.from_parameters(VALUES, VALUES['sensor_error_model'])
    drive = simulate_drive(duration, 2, hills=hills)
    return simulate_recording(drive, sensors, GnssNoise(sigma=1.5),
                              effects=[(EFFECTS[name], theta) for name, theta in effects.items()], seed=2).recording


def main():
    diagnose(recording(300.0, {}, False), VALUES)  # compiled code and imports
    for name, (effects, hills) in CASES.items():
        given = recording(3600.0, effects, hills)
        wall, cpu = time.perf_counter(), time.process_time()
        result = diagnose(given, VALUES)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        found = ', '.join(f.name for f in result.findings if f.added) or 'nothing'
        print(f'{name:25s} {wall:6.1f} s, CPU {cpu:6.1f} s; added: {found}', flush=True)


if __name__ == '__main__':
    main()
