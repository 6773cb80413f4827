"""Draw docs/figures/effects.png: what each effect does to the innovations of a filter that does not know it.

    python studies/effects_figure.py

The same simulated drive with and without the effect (same noise): drawn is the difference, which the white innovations,
of unit variance, hide more or less.
"""
from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from mems_ins_fusion.diagnosis.problem import Problem
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

SHOWN = (
    ('gnss_time_offset', {'time_offset': 0.2}),
    ('gnss_lever_arm', {'x': 1.5, 'y': 0.5}),
    ('accelerometer_lever_arm', {'x': 1.5, 'y': 0.5}),
    ('gnss_coloured_noise', {'sigma': 1.5, 'tau': 30.0}),
    ('accelerometer_scale', {'x': 0.05, 'y': -0.05}),
    ('gyroscope_scale', {'z': 0.03}),
    ('mounting_rotation', {'yaw': 0.1}),
    ('tilt', {'pitch_per_acceleration': 0.01, 'roll_per_acceleration': 0.01}),
    ('tilt', None),  # of the road
    ('g_sensitivity', {'x': 2e-3, 'y': 1e-3}),
    ('temperature', {'accelerometer_x': 0.02, 'gyroscope_z': 2e-4}),
    ('sideslip', {'angle_per_acceleration': 0.02}),
)
SEED, DURATION, WINDOW = 1, 600.0, (60.0, 360.0)


def innovations(constrained, effects=(), hills=False):
    """Seconds, and whitened innovations along and across the track."""
    values = table.check({'vehicle.non_holonomic': constrained})
    drive = simulate_drive(DURATION, SEED, rate=50.0, hills=hills)
    errors = SensorErrors.from_parameters(values, 'gauss_markov')
    problem = Problem(simulate_recording(drive, errors, GnssNoise(sigma=0.5), effects, seed=SEED).recording, values)
    seconds = (problem.stamp - problem.recording.imu.stamp[0]) * 1e-9
    return seconds, problem.base.along_across()


def main():
    figure = Figure(figsize=(13, 13), layout='constrained')
    plain = {constrained: innovations(constrained)[1] for constrained in (False, True)}
    for cell, (name, theta) in zip(figure.subfigures(4, 3).flat, SHOWN):
        effect, constrained = EFFECTS[name], name == 'sideslip'
        of = 'a road with grades of up to 6 %' if theta is None else ', '.join(
            f'{p.name} {theta[p.name]:g} {p.unit}'.removesuffix(' -') for p in effect.parameters if p.name in theta)
        cell.suptitle(f'{name}\n{of}', fontsize=8)
        seconds, series = innovations(constrained, [(effect, effect.complete(theta))] if theta else [], not theta)
        shown = (seconds > WINDOW[0]) & (seconds < WINDOW[1])
        for axes, label, column in zip(cell.subplots(2, 1, sharex=True), ('along', 'across'), (0, 1)):
            axes.axhspan(-1, 1, color='0.92')
            axes.plot(seconds[shown], (series - plain[constrained])[shown, column], color='#c1121f', linewidth=0.9)
            axes.set_ylabel(f'{label}, sigma', fontsize=7)
            axes.tick_params(labelsize=7)
            low, high = axes.get_ylim()
            axes.set_ylim(min(low, -1.5), max(high, 1.5))
        axes.set_xlabel('time, s', fontsize=7)
    figure.savefig(Path(__file__).parent / 'figures' / 'effects.png', dpi=75, metadata={'Software': None})


if __name__ == '__main__':
    main()
