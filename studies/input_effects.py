"""What effects of inputs cost, and what is left of it: a low pass, an odometry that is turned, dynamic pressure.

    python studies/input_effects.py lag|yaw|pressure [--seeds 49301 49302] [--fixes 0.5] [--minutes 10]
                                    [--sizes 0 0.5 1] [--set NAME=VALUE ...]

REALISTIC drives; a wheel speed at 50 Hz (lag, sizes in s: nothing declared, the offset, and both), an odometry at 20 Hz
with its velocity sideways to 5 cm/s (yaw, degrees to the left), a barometer at 20 Hz (pressure, shares). RMS of the
position, of the height, and the mean of the largest horizontal errors in 30 and 60 s without fixes, begun each 70 s, m.
"""
from __future__ import annotations

import argparse
import warnings

import numpy as np
import yaml
from vehicle import drive_of, sensors
from wrong_speeds import SETTLED, _errors

from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run_with_outages
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SimulatedAiding, simulate_recording

#: input, effect and its parameter, errors of the input, and usual sizes
CASES = {'lag': ('speed', 'speed_lag', 'tau', {'speed_rate': 50.0}, (0.0, 0.2, 0.5, 1.0)),
         'yaw': ('twist', 'twist_yaw', 'yaw', {'twist_rate': 20.0, 'twist_lateral_sigma': 0.05}, (0.0, 2.0, 5.0, 15.0)),
         'pressure': ('pressure', 'pressure_dynamic', 'share', {'pressure_rate': 20.0}, (0.0, -0.5, -0.2, 0.2, 0.5))}
DURATIONS, SPACING = (30.0, 60.0), 70.0


def judged(recording, name: str, values: dict) -> str:
    """A line of what the filter with `values` and the input `name` ('': none) makes of it."""
    given = {'reference_lever_arm': [0.0] * 3, **({f'{name}_topic': f'/{name}', **values} if name else {})}
    config = FilterConfig.from_parameters(table.check(given))
    samples = Aiding({name: recording.streams()[name]} if name else {})
    start, end, largest = recording.imu.stamp[0], recording.imu.stamp[-1], []
    for duration in DURATIONS:
        begins = np.arange(start + SETTLED * 1e9, end - (duration + 1.0) * 1e9, SPACING * 1e9).astype(np.int64)
        whole, outages = run_with_outages(config, recording.imu, recording.gnss, begins, duration, samples)
        off, stamp = _errors(recording.reference, outages.run), outages.run.stamp
        largest.append(np.mean([off[(stamp >= b) & (stamp <= b + duration * 1e9)].max() for b in begins]))
    settled = whole.stamp > start + SETTLED * 1e9
    higher = whole.height - np.interp(whole.stamp, recording.reference.stamp, recording.reference.height)
    rms = [np.sqrt(np.mean(one[settled] ** 2)) for one in (_errors(recording.reference, whole), higher)]
    return f'{rms[0]:.3f}, height {rms[1]:.2f}; 30 s {largest[0]:.2f}, 60 s {largest[1]:.2f}'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('case', choices=CASES)
    parser.add_argument('--seeds', type=int, nargs='+', default=[49301, 49302])
    parser.add_argument('--fixes', type=float, default=0.5, help='sigma, m')
    parser.add_argument('--minutes', type=float, default=10.0)
    parser.add_argument('--sizes', type=float, nargs='+')
    parser.add_argument('--set', nargs='+', default=[], metavar='NAME=VALUE', help='parameters')
    options = parser.parse_args()
    warnings.simplefilter('ignore')
    given = {name: yaml.safe_load(value) for name, _, value in (text.partition('=') for text in options.set)}
    name, effect, parameter, errors, usual = CASES[options.case]
    for seed in options.seeds:
        drive = drive_of(seed, options.minutes)
        for number, size in enumerate(options.sizes or usual):
            distortions = {**REALISTIC.distortions(seed), 'aiding': SimulatedAiding(**errors)}
            distortions['effects'] = [*distortions['effects'], (EFFECTS[effect], {
                parameter: np.radians(size) if options.case == 'yaw' else size})]
            recording = simulate_recording(drive, sensors(), GnssNoise(options.fixes), seed=seed,
                                           **distortions).recording
            if not number:
                print(f'seed {seed}, without {name}: {judged(recording, "", {})}', flush=True)
            declared = {'nothing declared': {}}
            if options.case == 'lag' and size:
                declared |= {'offset': {'speed.time_offset': size}, 'both': {'speed.time_offset': size,
                                                                             'speed.lag': size}}
            for words, values in declared.items():
                print(f'seed {seed}, {size:g}, {words}: {judged(recording, name, {**given, **values})}', flush=True)


if __name__ == '__main__':
    main()
