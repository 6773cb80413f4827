"""What else could show the speed on a straight road without a stop (docs/wheel_vibration.md): tried, and not used.

    python studies/straight_roads.py [--data ../shared/data] [--only axles speeds constraint slope constants]

Measured drives, fixes withheld on their straight stretches (`straight`) by the filter's own machinery; the truth is the
run with all of the best fixes. Errors along the track, m, are median / 95 %; differences are the mean of the errors'
sizes, with less without, with its 95 % interval (outages overlap: for as many as do not).

axles: rear wheels meet what the front wheels met a wheelbase later. The real cepstrum of windows of 4 s at equal steps
of the way (of the logarithm of the power, less what stands at each frequency in Hz always), vertical force and pitch
rate: its largest deviation from zero between 2.4 and 3.1 m and, to compare, between 4.1 and 4.8 m, in standard errors
of its mean over the drive; how often the best speed within 3 m/s is within 0.25 m/s (chance: 8 %) by the axles, by the
wheels (`wheel_vibration.py`) and by both, with what the other half of the drive shows.
speeds: a car keeps its speed. While no fixes come the mean speed of the rest of the drive, or the speed before the
outage, is told as a speed is, with the scatter that it had in the rest of the drive.
constraint: `vehicle.non_holonomic_sigma` at half and twice its value, alone and with an angle, which makes it grow with
the speed.
slope: a slope that is known shows how much of the forward force is gravity. The best case: the slope under the vehicle
is that of the truth, bias and scale (suspension) of the force are those of the two minutes before, the speed at the
begin is the true one; integrated, without a filter.
constants: gyroscope biases that a filter would have after a day. The best case: the mean over all standstills of the
drive, later ones, too, with a drift of a third of the default's.
"""
from __future__ import annotations

import argparse
import copy
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from wheel_vibration import DRIVES as VIBRATING
from wheel_vibration import (
    DV,
    HARMONICS,
    OFF_LINE,
    ON_LINE,
    RIGHT,
    SEARCHED,
    floors,
    line_power,
    told,
    windows_of,
)

from mems_ins_fusion.evaluation.intervals import paired
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.events import empty
from mems_ins_fusion.filter.memory import Event, Head, Kind, Nav, state_at
from mems_ins_fusion.filter.runs.replay import Events, Replay, run
from mems_ins_fusion.filter.runs.results import Run
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.samples import Aiding

#: drive: topic of its fixes, of the best ones, and what is known of it (docs/vehicle.md)
DRIVES = {
    'longmont_rtk_drive/bag': ('/gps/fix', '/gps/fix', {'imu.mounting_rpy': [0.0, 0.0, math.pi],
                                                        'gnss.time_offset': -0.26}),
    'karlsruhe_hills/bag': ('/gps/fix', '/reference/fix', {}),
    'kingston_span/bag': ('/gps/fix', '/reference/fix', {'imu.mounting_rpy': [0.0, 0.0, -math.pi / 2]}),
}
DURATIONS = (30.0, 60.0)
#: s from the begin of one outage to that of the next
EVERY = 5.0
#: m/s: slower is a stop
SLOWEST = 4.0
#: s from one told speed to the next
TOLD_EVERY = 2.0
#: s at which the autocorrelation of the speed is taken, for its correlation time
LAG = 10.0
#: m: lags of the cepstrum that are looked at, where a wheelbase may be, and as many where none is
LAGS = np.arange(1.0, 5.6, 0.02)
WHEELBASE, NO_WHEELBASE = (2.4, 3.1), (4.1, 4.8)
#: cycles per metre from which on the spectrum is looked at; below it is body motion
LOWEST = 0.15
#: of the logarithm of the power: no single bin decides
LARGEST = 3.0
#: windows of 4 s, 2 s apart, that are taken together
TOGETHER = (1, 3, 7)
#: m: circumferences of the wheels, as `wheel_vibration.py` finds them
CIRCUMFERENCES = {'longmont_rtk_drive/bag': 1.880, 'karlsruhe_hills/bag': 1.940, 'dresden_hobby_imu': 1.950}
#: forward specific force and gravity's share of it are compared after this smoothing, s
SMOOTHED = 1.0
#: s before an outage from which bias and scale of the forward force are learned
LEARNED = 120.0
GRAVITY = 9.81  # m/s^2


@dataclass(frozen=True)
class Drive:
    """A recording, parameters and the run with all of its best fixes."""

    name: str
    recording: object
    values: dict
    truth: Run

    def config(self, **more) -> FilterConfig:
        return FilterConfig.from_parameters(table.check({**self.values, **more}))

    @cached_property
    def time(self) -> np.ndarray:
        """Of the states of the truth, s."""
        return (self.truth.stamp - self.truth.stamp[0]) * 1e-9

    @cached_property
    def speed(self) -> np.ndarray:
        return np.linalg.norm(self.truth.velocity[:, :2], axis=1)

    def apart(self, duration: float) -> int:
        """How many of the outages of this duration share no time."""
        count, free = 0, -1
        for begin in self.begins[duration].tolist():
            if begin >= free:
                count, free = count + 1, begin + round(duration * 1e9)
        return count

    @cached_property
    def begins(self) -> dict[float, np.ndarray]:
        """Begins of the outages, ns, for each duration."""
        return {duration: straight(self.truth, duration) for duration in DURATIONS}


def read(data: Path, name: str) -> Drive:
    topic, best, values = DRIVES[name]
    recording = read_recording(data / name, '/imu/data', topic)
    reference = recording if best == topic else read_recording(data / name, '/imu/data', best)
    config = FilterConfig.from_parameters(table.check(values))
    return Drive(name.split('/')[0], recording, values, run(config, reference.imu, reference.gnss))


def straight(truth: Run, duration: float) -> np.ndarray:
    """Begins (o,), ns, of outages without a stop, and with turns above 0.1 rad/s for a fifth of the time at most."""
    time = (truth.stamp - truth.stamp[0]) * 1e-9
    speed = np.linalg.norm(truth.velocity[:, :2], axis=1)
    turn = np.abs(np.gradient(np.unwrap(truth.yaw), time))
    width = max(round(1.0 / np.median(np.diff(time))), 1)
    turn = np.convolve(turn, np.ones(width) / width, 'same')
    found = []
    for begin in np.arange(120.0, time[-1] - duration, EVERY):
        part = slice(*np.searchsorted(time, [begin, begin + duration]))
        if speed[part].min() > SLOWEST and np.mean(turn[part] > 0.1) < 0.2:
            found.append(truth.stamp[0] + round(begin * 1e9))
    return np.array(found, dtype=np.int64)


class _Telling(Replay):
    """A replay in whose outages speeds are told: `tell(begin, speed)` gives times since the filter's epoch, speeds and
    variances."""

    def __init__(self, *given, tell=None):
        super().__init__(*given)
        self.tell = tell

    def _branch(self, memory, work, begin, withheld):
        if self.tell is None:
            return super()._branch(memory, work, begin, withheld)
        newest = state_at(memory, int(memory[Head.SAMPLES]))
        time, speed, variance = self.tell(begin, math.hypot(*memory[newest + Nav.V_N:newest + Nav.V_E + 1]))
        record = empty(Kind.SPEED, len(time))
        record[:, Event.INPUT:Event.INPUT_END] = self.config.of_input(Kind.SPEED)
        record[:, Event.TIME], record[:, Event.R_NN] = time, variance
        record[:, Event.VALUE] = speed + 1e-4 * np.arange(len(time))  # the same number over and over is a dead sensor
        record[:, Event.ID] = -1.0 - np.arange(len(time))
        events, none = work.events, np.zeros(len(time), dtype=np.int64)
        arrival = np.concatenate([events.arrival, np.searchsorted(work.samples[:, 0], time, side='right')])
        order = np.argsort(arrival, kind='stable')
        with_speeds = copy.copy(work)
        with_speeds.events = Events(
            np.concatenate([events.kind, none + Kind.SPEED]), np.concatenate([events.index, none]), arrival,
            np.vstack([events.event, record]), np.concatenate([events.answer, none])).select(order)
        return super()._branch(memory, with_speeds, begin, np.concatenate([withheld, none.astype(bool)])[order])


def outages(drive: Drive, config: FilterConfig, tell=None) -> dict[float, np.ndarray]:
    """Errors along the track at the end of each outage, m, and of the speed, m/s (k, 2), for each duration."""
    begins = np.unique(np.concatenate(list(drive.begins.values())))
    work = _Telling(config, drive.recording.imu, drive.recording.gnss, Aiding(), None, None, begins, max(DURATIONS),
                    tell=tell)
    work.run()
    found = {duration: [] for duration in DURATIONS}
    for branch in work.branches:
        states = work.result([branch])
        for duration in DURATIONS:
            if branch.begin in drive.begins[duration]:
                found[duration].append(_error(states, drive.truth, branch.begin + round(duration * 1e9)))
    return {duration: np.array(errors) for duration, errors in found.items()}


def _error(found: Run, truth: Run, stamp: int) -> tuple[float, float]:
    i = min(int(np.searchsorted(found.stamp, stamp)), len(found.stamp) - 1)
    j = min(int(np.searchsorted(truth.stamp, found.stamp[i])), len(truth.stamp) - 1)
    north, east, _ = to_local(found.latitude[i], found.longitude[i], found.height[i],
                              (truth.latitude[j], truth.longitude[j], truth.height[j]))
    ahead = truth.velocity[j, :2] / np.linalg.norm(truth.velocity[j, :2])
    off = np.linalg.norm(found.velocity[i, :2]) - np.linalg.norm(truth.velocity[j, :2])
    return ahead @ [north, east], off


def size(errors: np.ndarray) -> str:
    return f'{np.median(np.abs(errors)):.1f} / {np.percentile(np.abs(errors), 95):.1f}'


def less(without: np.ndarray, errors: np.ndarray, apart: int) -> str:
    """Mean of the sizes' difference with its interval; apart: how many of the outages share no time."""
    found = paired(np.abs(errors), np.abs(without), apart)
    return 'too few' if found is None else f'{found.mean:+.1f} ({found.low:+.1f} to {found.high:+.1f})'


def rms(values) -> float:
    return math.sqrt(np.mean(np.square(values)))


def cepstra(windows, axis: int) -> np.ndarray:
    """(w, len(LAGS)) of the windows on one axis."""
    spectra = []
    frequency = np.linspace(0.0, 0.4 * windows.rate, 200)  # Hz
    for samples, way, speed in zip(windows.samples[:, axis], windows.way, windows.speed):
        steps = np.linspace(way[0], way[-1], len(way))
        power = np.abs(np.fft.rfft(np.interp(steps, way, samples), 4 * len(way))) ** 2
        cycles = np.fft.rfftfreq(4 * len(way), steps[1] - steps[0])
        spectra.append(np.interp(frequency / speed, cycles, np.log(power + 1e-12)))
    spectra = np.array(spectra)
    spectra -= spectra.mean(axis=1, keepdims=True)
    spectra -= spectra.mean(axis=0)  # what stands in Hz always
    result = np.zeros((len(spectra), len(LAGS)))
    for row, spectrum, speed in zip(result, spectra, windows.speed):
        cycles = frequency / speed
        used = cycles > LOWEST
        trend = np.polynomial.polynomial.polyfit(cycles[used], spectrum[used], 3)
        above = np.clip(spectrum[used] - np.polynomial.polynomial.polyval(cycles[used], trend), -LARGEST, LARGEST)
        row[:] = above @ np.cos(2.0 * np.pi * np.outer(cycles[used], LAGS)) / used.sum()
    return result


def of_axles(data: Path):
    yield '| drive | windows | signal | 2.4 to 3.1 m: standard errors | at, m | 4.1 to 4.8 m | at, m |'
    yield f'|{"---|" * 7}'
    shares = []
    for name, (topic, values) in VIBRATING.items():
        windows, circumference = windows_of(data / name, topic, values), CIRCUMFERENCES[name]
        apart = np.flatnonzero(np.diff(windows.time // 2.0, prepend=-1.0))  # 2 s apart
        windows = type(windows)(windows.time[apart], windows.samples[apart], windows.way[apart], windows.speed[apart],
                                windows.rate)
        found = {'vertical force': cepstra(windows, 2), 'pitch rate': cepstra(windows, 4)}
        for signal, cepstrum in found.items():
            independent = len(cepstrum) / 1.5  # windows that overlap by half
            errors = cepstrum.mean(axis=0) / cepstrum.std(axis=0) * math.sqrt(independent)
            peaks = []
            for low, high in (WHEELBASE, NO_WHEELBASE):
                part = np.flatnonzero((LAGS >= low) & (LAGS <= high))
                best = part[np.abs(errors[part]).argmax()]
                peaks += [f'{errors[best]:+.1f}', f'{LAGS[best]:.2f}']
            yield f'| {name.split("/")[0]} | {len(windows.time)} | {signal} | {" | ".join(peaks)} |'
        floor = floors(windows)
        power = np.concatenate([line_power(windows, floor, h / circumference, DV) for h in HARMONICS], axis=1)
        wheels, near = told(power), np.abs(DV) <= SEARCHED
        axles = of_delay(windows, list(found.values()))
        for k in TOGETHER:
            words = [f'{right:.0%}' for right in (_right(windows, score[:, near], k)
                                                  for score in (axles, wheels, axles + wheels))]
            shares.append(f'| {name.split("/")[0]} | {2 * k + 2} | {" | ".join(words)} |')
    yield '\n| drive | s together | right by axles | by wheels | by both |'
    yield f'|{"---|" * 5}'
    yield from shares


def of_delay(windows, cepstra: list) -> np.ndarray:
    """Log-likelihood of the windows (w, len(DV)), each half with what the other half shows: the discriminant of two
    normal distributions of how alike the cepstrum is to the mean one."""
    near = (LAGS >= WHEELBASE[0]) & (LAGS <= WHEELBASE[1])
    half, result = len(windows.time) // 2, np.zeros((len(windows.time), len(DV)))
    for learned, used in ((slice(half), slice(half, None)), (slice(half, None), slice(half))):
        for cepstrum in cepstra:
            shape = cepstrum[learned].mean(axis=0)[near]
            shape = shape - shape.mean()
            lags = LAGS[near] * (windows.speed[:, None, None] / np.maximum(windows.speed[:, None] + DV, 1.0)[..., None])
            alike = np.array([np.interp(at, LAGS, row) @ shape for at, row in zip(lags, cepstrum)])
            on, off = alike[learned][:, np.abs(DV) < ON_LINE], alike[learned][:, np.abs(DV) > OFF_LINE]
            middle = 0.5 * (on.mean() + off.mean())
            result[used] += (on.mean() - off.mean()) / off.var() * (alike[used] - middle)
    return result


def _right(windows, score: np.ndarray, together: int) -> float:
    """How often the best speed of so many windows in a row, 2 s apart, is the right one."""
    dv = DV[np.abs(DV) <= SEARCHED]
    return np.mean([abs(dv[score[i:i + together].sum(axis=0).argmax()]) < RIGHT
                    for i in range(len(score) - together + 1)
                    if windows.time[i + together - 1] - windows.time[i] < 2.0 * together])


def of_speeds(drives):
    yield ('| drive | s | outages | speed changes by, m/s RMS | error of the filter\'s speed, m/s RMS | without, m | '
           'mean speed told | less | speed before told | less |')
    yield f'|{"---|" * 10}'
    for drive in drives:
        time = np.arange(0.0, drive.time[-1], 1.0)
        speed = np.interp(time, drive.time, drive.speed)
        epoch = (drive.truth.stamp[0] - drive.recording.imu.stamp[0]) * 1e-9

        def rest(begin, time=time, speed=speed, epoch=epoch):
            """Speeds while driving, outside of the minute after `begin`, and which follow LAG s later."""
            since = time + epoch - begin
            use = (speed > SLOWEST) & ((since < 0.0) | (since > max(DURATIONS)))
            lag = round(LAG)
            return use, use[lag:] & use[:-lag], lag

        def mean(begin, now, speed=speed, rest=rest):
            use, both, lag = rest(begin)
            middle, variance = speed[use].mean(), speed[use].var()
            follows = np.mean((speed[lag:][both] - middle) * (speed[:-lag][both] - middle)) / variance
            lasts = -LAG / math.log(min(max(follows, 0.05), 0.99))
            then = begin + np.arange(TOLD_EVERY, max(DURATIONS), TOLD_EVERY)
            return then, np.full(len(then), middle), np.full(len(then), variance * 2.0 * lasts / TOLD_EVERY)

        def before(begin, now, speed=speed, rest=rest):
            use, both, lag = rest(begin)
            walk = np.mean((speed[lag:][both] - speed[:-lag][both]) ** 2) / LAG  # m^2/s^2 for each s
            then = begin + np.arange(TOLD_EVERY, max(DURATIONS), TOLD_EVERY)
            since = then - begin  # errors of a random walk last as long as it has gone on
            return then, np.full(len(then), now), walk * since * 2.0 * since / TOLD_EVERY

        found = [outages(drive, drive.config(), tell) for tell in (None, mean, before)]
        for duration in DURATIONS:
            without, *others = (errors[duration] for errors in found)
            starts = (drive.begins[duration] - drive.truth.stamp[0]) * 1e-9
            change = np.interp(starts + duration, drive.time, drive.speed) - np.interp(starts, drive.time, drive.speed)
            words = ' | '.join(f'{size(errors[:, 0])} | {less(without[:, 0], errors[:, 0], drive.apart(duration))}'
                               for errors in others)
            yield (f'| {drive.name} | {duration:.0f} | {len(without)} | {rms(change):.1f} | {rms(without[:, 1]):.2f} | '
                   f'{size(without[:, 0])} | {words} |')


def of_constraint(drives):
    cases = {'x 0.5': (0.5, 0.0), 'x 2': (2.0, 0.0), 'x 0.5, grows with 0.02 rad': (0.5, 0.02),
             'grows with 0.02 rad': (1.0, 0.02)}
    yield f'| drive | s | without, m | {" | less | ".join(cases)} | less |'
    yield f'|{"---|" * (3 + 2 * len(cases))}'
    for drive in drives:
        default = drive.config()
        sigma = default.parameters['vehicle.non_holonomic_sigma']
        found = [outages(drive, default)] + [
            outages(drive, drive.config(**{'vehicle.non_holonomic_sigma': factor * sigma,
                                           'vehicle.non_holonomic_angle_sigma': angle}))
            for factor, angle in cases.values()]
        yield from _rows(drive, found)


def _rows(drive: Drive, found: list):
    """A line for each duration: without, then size and difference of each case."""
    for duration in DURATIONS:
        without, *others = (errors[duration][:, 0] for errors in found)
        words = ' | '.join(f'{size(errors)} | {less(without, errors, drive.apart(duration))}' for errors in others)
        yield f'| {drive.name} | {duration:.0f} | {size(without)} | {words} |'


def again(drive: Drive) -> float:
    """Share of the way on which the drive has been before: within 5 m and 20 degrees, or 160 and more, a minute ago."""
    time = np.arange(0.0, drive.time[-1], 0.5)
    north, east, _ = to_local(*(np.interp(time, drive.time, getattr(drive.truth, name))
                                for name in ('latitude', 'longitude', 'height')),
                              tuple(getattr(drive.truth, name)[0] for name in ('latitude', 'longitude', 'height')))
    yaw, speed = (np.interp(time, drive.time, values) for values in (np.unwrap(drive.truth.yaw), drive.speed))
    seen = np.zeros(len(time), dtype=bool)
    for i in range(120, len(time)):
        earlier = slice(i - 120)
        near = (north[earlier] - north[i]) ** 2 + (east[earlier] - east[i]) ** 2 < 25.0
        seen[i] = np.any(near & (np.abs(np.sin(yaw[earlier] - yaw[i])) < math.sin(math.radians(20.0))))
    return speed[seen].sum() / speed.sum()


def of_slope(drives):
    yield ('| drive | way driven twice | s | without, m | with the slope | less | force over acceleration | '
           'what remains, m/s^2 RMS |')
    yield f'|{"---|" * 8}'
    for drive in drives:
        imu, step = drive.recording.imu, 0.1
        time = np.arange(0.0, drive.time[-1], step)
        force = imu.specific_force @ rotation_from_rpy(*drive.values.get('imu.mounting_rpy', [0.0] * 3)).T
        width = round(SMOOTHED / step)

        def smooth(values, width=width):
            return np.convolve(values, np.ones(width) / width, 'same')

        fine = np.convolve(force[:, 0], np.ones(5) / 5.0, 'same') if len(imu) > 8 * len(time) else force[:, 0]
        f_x = smooth(np.interp(time, (imu.stamp - drive.truth.stamp[0]) * 1e-9, fine))
        speed = np.interp(time, drive.time, np.linalg.norm(drive.truth.velocity, axis=1))
        acceleration = smooth(np.gradient(speed, step))
        slope = smooth(np.interp(time, drive.time, -drive.truth.velocity[:, 2]) / np.maximum(speed, 1.0))
        without = outages(drive, drive.config())
        for duration in DURATIONS:
            errors, scales, left = [], [], []
            for begin in (drive.begins[duration] - drive.truth.stamp[0]) * 1e-9:
                before = (time > begin - LEARNED) & (time < begin) & (speed > SLOWEST)
                scale, bias = np.polyfit(acceleration[before], f_x[before] - GRAVITY * slope[before], 1)
                part = (time >= begin) & (time < begin + duration)
                off = (f_x[part] - GRAVITY * slope[part] - bias) / scale - acceleration[part]
                errors.append(np.sum(np.cumsum(off)) * step**2)
                scales.append(scale)
                left.append(rms(off))
            errors, plain = np.array(errors), without[duration][:, 0]
            yield (f'| {drive.name} | {again(drive):.0%} | {duration:.0f} | {size(plain)} | {size(errors)} | '
                   f'{less(plain, errors, drive.apart(duration))} | {np.median(scales):.2f} | {rms(left):.2f} |')


def stops(drive: Drive) -> np.ndarray:
    """Mean rate of the gyroscopes over each standstill (s, 3), rad/s, sensor axes."""
    imu, means = drive.recording.imu, []
    speed = np.interp((imu.stamp - drive.truth.stamp[0]) * 1e-9, drive.time, drive.speed, left=1.0)
    still = np.concatenate([[False], speed < 0.05, [False]])
    for first, last in np.flatnonzero(np.diff(still)).reshape(-1, 2):
        if (imu.stamp[last - 1] - imu.stamp[first]) * 1e-9 > 3.0:
            means.append(imu.angular_rate[first:last].mean(axis=0))
    return np.array(means).reshape(-1, 3)


def of_constants(data: Path, drives):
    yield '| drive | minutes | standstills | apart, deg/h RMS | s | without, m | with constants | less |'
    yield f'|{"---|" * 8}'
    for drive in drives:
        means = stops(drive)
        first = f'{drive.name} | {drive.time[-1] / 60.0:.0f} | {len(means)}'
        if len(means) < 2:
            yield f'| {first} | - | - | - | - | - |'
            continue
        mean = means.mean(axis=0)
        first += f' | {rms(means - mean) * math.degrees(3600.0):.0f}'
        default = drive.config()
        sigma = np.array(default.parameters['gyroscope.gauss_markov.sigma'])
        known = drive.config(**{'gyroscope.bias': mean.tolist(), 'gyroscope.initial_sigma': (sigma / 3.0).tolist(),
                                'gyroscope.gauss_markov.sigma': (sigma / 3.0).tolist()})
        for line in _rows(drive, [outages(drive, default), outages(drive, known)]):
            yield f'| {first} | {line.split(" | ", 1)[1]}'
    yield '\n| IMU at rest | mean of 60 s, deg/h RMS apart after 1 min | 10 min | 1 h | 2 h |'
    yield f'|{"---|" * 5}'
    for path in sorted((data / 'adis16405_static').glob('*.npz')):
        recorded = np.load(path)
        n = round(60.0 * float(recorded['rate_hz']))
        rate = recorded['gyro_radps']
        means = rate[:len(rate) // n * n].reshape(-1, n, 3).mean(axis=1) * math.degrees(3600.0)
        words = ' | '.join(f'{rms(means[m:] - means[:-m]):.0f}' for m in (1, 10, 60, 120))
        yield f'| {path.stem} | {words} |'


STUDIES = ('axles', 'speeds', 'constraint', 'slope', 'constants')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--only', nargs='+', choices=STUDIES, default=STUDIES)
    options = parser.parse_args()
    drives = [read(options.data, name) for name in DRIVES] if set(options.only) - {'axles'} else []
    lines = {'axles': lambda: of_axles(options.data), 'speeds': lambda: of_speeds(drives),
             'constraint': lambda: of_constraint(drives), 'slope': lambda: of_slope(drives),
             'constants': lambda: of_constants(options.data, drives)}
    for name in options.only:
        print(f'\n{name}\n', flush=True)
        for line in lines[name]():
            print(line, flush=True)


if __name__ == '__main__':
    main()
