"""Wheels that slip: how soon it is found, how much of it is refused, what it costs, and how often it is said wrongly.

    python studies/slips.py [--seeds 4] [--minutes 8] [--output FILE.md]

REALISTIC drives, fixes of 1.5 m each second, a wheel speed of 0.05 m/s at 10 and at 100 Hz. Where the vehicle is faster
than 4 m/s, the wheels slip each 20 s for 3 s. Found: refused within a second. Refused: share of the messages of the
slips. RMSE of the position, and the largest error. False: refused elsewhere, by periods of two seconds, in an hour.
*without*: the same drives without wheels.
"""
from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import over_drives
from vehicle import FIXES, drive_of, sensors

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import position_errors
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Event, Kind, Verdict
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import SimulatedAiding, simulate_recording

RATES = 10.0, 100.0
FIRST, EACH, LASTS, AFTER, FASTER_THAN = 90.0, 20.0, 3.0, 1.0, 4.0
REFUSED = Verdict.REFUSED, Verdict.CONTRADICTED, Verdict.FROZEN

#: speeds of the wheels from the true ones and the time since the slip began, s
SLIPS: dict[str, Callable] = {
    'none': lambda speed, since: speed,
    '0.5 m/s': lambda speed, since: speed + 0.5,
    '1 m/s': lambda speed, since: speed + 1.0,
    '3 m/s': lambda speed, since: speed + 3.0,
    'growing by 1 m/s^2': lambda speed, since: speed + since,
    'locked': lambda speed, since: 0.05 * np.sin(10.0 * since),
    'half as fast': lambda speed, since: 0.5 * speed,
}


def of_drive(seed: int, minutes: float) -> list:
    results = []
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        for rate in RATES:
            recording = simulate_recording(drive_of(seed, minutes), sensors(), FIXES['1.5 m'], seed=seed, **{
                **REALISTIC.distortions(seed), 'aiding': SimulatedAiding(speed_rate=rate)}).recording
            reference = recording.reference.select(slice(None, None, 10))
            recording = replace(recording, reference=reference)
            results += [((rate, name), _judge(recording, slip)) for name, slip in SLIPS.items()]
        results.append(((0.0, 'without'), _judge(recording, None)))
    return results


def _judge(recording, slip) -> list[float]:
    """Slips, found ones, share refused, periods of false ones, hours, RMSE and largest error, m."""
    values = table.check({'reference_lever_arm': [0.0] * 3, **({'speed_topic': '/speed'} if slip else {})})
    start, samples, begins = recording.imu.stamp[0], {}, np.array([])
    if slip:
        speed, slipping = recording.speed, np.zeros(len(recording.speed), bool)
        time = (speed.stamp - start) * 1e-9
        true = np.interp(speed.stamp, recording.reference.stamp,
                         np.hypot(recording.reference.velocity[:, 0], recording.reference.velocity[:, 1]))
        begins = np.arange(FIRST, time[-1] - LASTS, EACH)
        begins = begins[true[np.searchsorted(time, begins)] > FASTER_THAN]
        said = speed.speed.copy()
        for begin in begins if slip is not SLIPS['none'] else ():
            inside = (time >= begin) & (time < begin + LASTS)
            said[inside] = slip(said[inside], time[inside] - begin)
        samples = {'speed': replace(speed, speed=said)}
    result = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss, Aiding(samples))
    truth = truth_of(recording, values)
    errors = position_errors(result, truth, np.zeros(len(truth), bool))
    off = errors.horizontal[(errors.stamp - start) * 1e-9 > FIRST - 30.0]
    of_wheels = result.measured.kind == Kind.SPEED
    refused = np.isin(result.measured.event[of_wheels][:, Event.VERDICT], REFUSED)
    time = (result.measured.stamp[of_wheels] - start) * 1e-9
    found, share, slipping = 0, [], np.zeros(len(time), bool)
    for begin in begins:
        inside = (time >= begin) & (time < begin + LASTS)
        slipping |= (time >= begin) & (time < begin + LASTS + AFTER)
        found += bool(refused[inside & (time < begin + 1.0)].any())
        share.append(refused[inside].mean())
    wrong = time[refused & ~slipping & (time > FIRST - 30.0)]
    periods = 1 + (np.diff(wrong) > 2.0).sum() if len(wrong) else 0
    return [len(begins), found, np.sum(share), periods, (recording.imu.stamp[-1] - start) * 1e-9 / 3600.0,
            np.sqrt((off**2).mean()), off.max()]


def lines(results: dict, seeds: int):
    yield f'| slip, {seeds} drives | found | refused | false in an hour | RMSE, m | largest, m |'
    yield '|---|---|---|---|---|---|'
    for (rate, name), rows in results.items():
        rows = np.array(rows)
        slips, found, share, periods, hours = rows[:, :5].sum(axis=0)
        words = f'{name}, {rate:.0f} Hz' if rate else name
        shown = f'{found:.0f} of {slips:.0f} | {share / slips:.0%}' if slips else ' | '
        yield f'| {words} | {shown} | {periods / hours:.1f} | {rows[:, 5].mean():.2f} | {rows[:, 6].mean():.1f} |'


if __name__ == '__main__':
    over_drives.main(__doc__, of_drive, lines, 4)
