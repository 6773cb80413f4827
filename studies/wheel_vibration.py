"""Whether the IMU of a car shows the speed of its wheels: spectra of measured drives, and what they tell of the speed.

    python studies/wheel_vibration.py [--data ../shared/data] [--figure FILE.png]

A wheel that is out of balance shakes the car once a revolution, tyre and tread shake it at multiples of that. In a
window of 4 s the samples of an axis are turned back by the phase of the wheel at the filter's speed v(t),

    y(t) = x(t) exp(-2 pi i h s(t) / C),   s = integral of v,   h = 1, 2, 3 the harmonic, C the circumference,

so that a line of the wheels stands at zero frequency however the speed changes, and at h dv / C where the filter's
speed is too small by dv. Its power is divided by the power around it (median over 4 Hz) and by what the axis shows at
that frequency in Hz over the whole drive: suspension, engine at idle and mount stand at a frequency, wheels do not.
Without that division a line in Hz is taken for the wheels' on half of the windows that look certain.

The figure shows the mean logarithm of that power against cycles per metre. The table tells, for K windows of 4 s, 2 s
apart, taken together, how often the best dv within 3 m/s of the speed is the right one (within 0.25 m/s), and the same
where the windows leave no other (97 % of the posterior within 0.25 m/s of the best). What an axis and harmonic tell
(logarithm of the ratio of the densities of the power, on the line over off it) is learned on one half of the drive and
used on the other. Windows with turns faster than 0.1 rad/s or below 4 m/s are left out.
"""
from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording

#: drive, topic of its fixes, parameters: what is known of these recordings (docs/vehicle.md)
DRIVES = {
    'longmont_rtk_drive/bag': ('/gps/fix', {'imu.mounting_rpy': [0.0, 0.0, math.pi], 'gnss.time_offset': -0.26}),
    'karlsruhe_hills/bag': ('/reference/fix', {}),
    'dresden_hobby_imu': ('/gps/fix', {}),
}
WINDOW = 4.0  # s: a line is then 0.5 Hz wide, which is 1 m/s at the first harmonic and 0.3 at the third
HOP = 0.5  # s from one window to the next
SLOWEST = 4.0  # m/s
FASTEST_TURN = 0.1  # rad/s: in a turn the wheels of both sides have two speeds
HARMONICS = (1, 2, 3)
CIRCUMFERENCES = np.arange(1.5, 2.4, 0.005)  # m: of tyres of cars
DV = np.arange(-6.0, 6.01, 0.05)  # m/s
NEIGHBOURHOOD = 4.0  # Hz around a line
ON_LINE = 0.15  # m/s: so near to no error of the speed is the line; the filter's speed has errors, too
RIGHT = 0.25  # m/s
OFF_LINE = 0.5  # m/s: and this far away is none
SEARCHED = 3.0  # m/s to either side
TOGETHER = (1, 2, 4, 8, 16)  # windows of 2 s
TEMPER = 0.5  # of the log-likelihood: axes and windows that overlap are not independent
CERTAIN = 0.97
BINS = np.linspace(-4.0, 6.0, 41)  # of the logarithm of the power


@dataclass(frozen=True)
class Windows:
    """time (w,): middle, s. samples (w, 6, n): of each axis, detrended and tapered. way (w, n): m from the window's
    middle. speed (w,): mean, m/s. rate: Hz."""

    time: np.ndarray
    samples: np.ndarray
    way: np.ndarray
    speed: np.ndarray
    rate: float

    @property
    def size(self) -> int:
        """Of the transforms: four times the window, so that a peak is not missed between two frequencies."""
        return 4 * self.samples.shape[-1]


def windows_of(path: Path, topic: str, values: dict) -> Windows:
    """The windows of one drive, with the speed that the filter has from all fixes."""
    recording = read_recording(path, '/imu/data', topic)
    imu = recording.imu
    result = run(FilterConfig.from_parameters(table.check(values)), imu, recording.gnss)
    time, of_state = (imu.stamp - imu.stamp[0]) * 1e-9, (result.stamp - imu.stamp[0]) * 1e-9
    speed = np.interp(time, of_state, np.hypot(*result.velocity[:, :2].T), left=0.0)
    turn = np.abs(np.interp(time, of_state[1:], np.diff(np.unwrap(result.yaw)) / np.diff(of_state)))
    signals = np.hstack([imu.specific_force, imu.angular_rate])
    rate = 1.0 / np.median(np.diff(time))
    n = round(WINDOW * rate)
    taper, found = np.hanning(n), []
    for first in range(0, len(time) - n, round(HOP * rate)):
        part = slice(first, first + n)
        t, v = time[part] - time[part].mean(), speed[part]
        if v.min() < SLOWEST or np.convolve(turn[part], np.ones(n // 4) / (n // 4), 'valid').max() > FASTEST_TURN or (
                t[-1] - t[0] > 1.1 * WINDOW):
            continue
        trend = np.polynomial.polynomial.polyfit(t, signals[part], 2)
        detrended = signals[part] - np.polynomial.polynomial.polyval(t, trend).T
        way = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
        found.append((time[part].mean(), detrended.T * taper, way - way[n // 2], v.mean()))
    return Windows(*(np.array(column) for column in zip(*found)), rate)


def floors(windows: Windows) -> np.ndarray:
    """Power (w, 6, f) beside which a line is one: of the neighbourhood, times what stands at that frequency always."""
    power = np.abs(np.fft.rfft(windows.samples, windows.size)) ** 2
    width = round(NEIGHBOURHOOD * windows.size / windows.rate)
    local = median_filter(power, (1, 1, width)) / math.log(2.0) + 1e-12 * power.max(axis=-1, keepdims=True)
    standing = np.minimum(power / local, 30.0).mean(axis=0)
    return local * np.maximum(standing, 1.0)


def line_power(windows: Windows, floor: np.ndarray, cycles: float, dv: np.ndarray) -> np.ndarray:
    """Power over floor (w, 6, len(dv)) of a line of `cycles` per metre where the speed is dv (m/s) higher."""
    n, half = windows.samples.shape[-1], windows.rate / 2.0
    time = (np.arange(n) - n // 2) / windows.rate
    turned = windows.samples * np.exp(-2j * np.pi * cycles * windows.way)[:, None]
    power = np.abs(turned @ np.exp(-2j * np.pi * cycles * np.outer(time, dv))) ** 2
    folded = np.abs((cycles * (windows.speed[:, None] + dv) + half) % windows.rate - half)  # aliased lines are lines
    nearest = np.rint(folded * windows.size / windows.rate).astype(int)
    return power / np.take_along_axis(floor, nearest[:, None], axis=-1)


def told(power: np.ndarray) -> np.ndarray:
    """Log-likelihood of the windows (w, len(DV)) from the power (w, c, len(DV)) of each axis and harmonic, each half
    of the windows with what the other half shows."""
    logarithm, half = np.log(np.maximum(power, 1e-3)), len(power) // 2
    result = np.zeros((len(power), len(DV)))
    middle = 0.5 * (BINS[1:] + BINS[:-1])
    for learned, used in ((slice(half), slice(half, None)), (slice(half, None), slice(half))):
        for channel in range(power.shape[1]):
            on, off = (np.histogram(logarithm[learned, channel][:, where], BINS, density=True)[0]
                       for where in (np.abs(DV) < ON_LINE, np.abs(DV) > OFF_LINE))
            kernel = np.array([1, 6, 15, 20, 15, 6, 1]) / 64.0
            on, off = np.convolve(on, kernel, 'same'), np.convolve(off, kernel, 'same')
            result[used] += np.interp(logarithm[used, channel], middle, np.log((on + 0.01) / (off + 0.01)))
    return result


def shares(windows: Windows, likelihood: np.ndarray):
    """(K, number, share of the best that is right, share that is certain, share of these that is right)."""
    near = np.abs(DV) <= SEARCHED
    dv, step = DV[near], round(2.0 / HOP)
    for together in TOGETHER:
        right, certain = [], []
        for first in range(0, len(likelihood) - step * (together - 1), step):
            last = first + step * (together - 1)
            if windows.time[last] - windows.time[first] > 2.0 * (together - 1) + HOP:
                continue
            total = TEMPER * likelihood[first:last + 1:step][:, near].sum(axis=0)
            posterior = np.exp(total - total.max())
            best = dv[posterior.argmax()]
            right.append(abs(best) < RIGHT)
            certain.append(posterior[np.abs(dv - best) < RIGHT].sum() > CERTAIN * posterior.sum())
        right, certain = np.array(right), np.array(certain)
        if len(right):
            yield together, len(right), right.mean(), certain.mean(), right[certain].mean() if certain.any() else np.nan


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--figure', type=Path)
    options = parser.parse_args()
    spectra = {}
    print('| drive | circumference, m | windows together | number | best is right | certain | and right |')
    print(f'|{"---|" * 7}')
    for name, (topic, values) in DRIVES.items():
        windows = windows_of(options.data / name, topic, values)
        floor = floors(windows)
        cycles = np.arange(0.3, 2.2, 0.008)
        found = np.array([line_power(windows, floor, c, np.zeros(1))[..., 0] for c in cycles])
        spectrum = np.log(np.maximum(found, 1e-3)).mean(axis=1)
        spectra[name.split('/')[0]] = spectrum - np.median(spectrum, axis=0)
        comb = [sum(np.interp(h / c, cycles, spectra[name.split('/')[0]].sum(axis=1)) for h in HARMONICS)
                for c in CIRCUMFERENCES]
        circumference = CIRCUMFERENCES[int(np.argmax(comb))]
        power = np.concatenate([line_power(windows, floor, h / circumference, DV) for h in HARMONICS], axis=1)
        for k, number, right, certain, of_these in shares(windows, told(power)):
            print(f'| {name.split("/")[0]} | {circumference:.3f} | {k} | {number} | {right:.0%} | {certain:.0%} | '
                  f'{"-" if math.isnan(of_these) else format(of_these, ".0%")} |')
    if options.figure:
        _draw(cycles, spectra, options.figure)


def _draw(cycles: np.ndarray, spectra: dict, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 2.3 * len(spectra)), layout='constrained')
    for axes, (name, spectrum) in zip(figure.subplots(len(spectra), 1, sharex=True, squeeze=False)[:, 0],
                                      spectra.items()):
        for i, label in enumerate(('forward', 'left', 'up')):
            axes.plot(cycles, spectrum[:, i], linewidth=0.9, label=f'force, {label}')
            axes.plot(cycles, spectrum[:, 3 + i], linewidth=0.9, linestyle='--', label=f'turn rate, {label}')
        axes.set_title(name, fontsize=10)
        axes.set_ylabel('mean log power')
    axes.set_xlabel('cycles per metre')
    figure.axes[0].legend(ncols=2, fontsize=7)
    figure.savefig(path, dpi=100)


if __name__ == '__main__':
    main()
