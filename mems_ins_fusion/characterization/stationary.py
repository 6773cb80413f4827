"""The samples of a recording in which the sensor is at rest: a uniform time grid, and the parts to keep.

Three kinds of disturbance are handled: samples that are missing or stamped irregularly; knocks, after which the sensor
is as before; and movements, after which its tilt, and so the level of its accelerometers, has changed.
Missing samples and knocks leave holes (NaN) in a part; a movement begins a new part, with a level of its own.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..samples import runs

#: s, longest gap in the stamps within a part; a longer one begins a new part
LONGEST_HOLE = 60.0
#: s, shortest part at rest that is used
SHORTEST = 60.0
#: s, shortest window in which rest is tested
_WINDOW = 1.0
#: smallest number of samples in such a window
_WINDOW_SAMPLES = 50
#: largest standard deviation of a window at rest, as a multiple of that of the quiet windows
_SPREAD = 2.0
#: largest deviation from the mean of a window at rest, in standard deviations
_PEAK = 7.0
#: smallest step of the mean from one window to the next that is not a slow error, in standard deviations of such steps
_STEP = 8.0
#: number of windows averaged on each side of a disturbance to find a change of the level
_SIDE = 5
#: s, longest disturbance that the report calls a knock; a longer one is a vibration
_LONG = 10.0
#: number of windows averaged on each side of a shift of the level
_SHIFT_SIDE = 30


class StationaryError(InputError):
    """A recording that cannot be characterized: one line saying why."""


@dataclass(frozen=True)
class Grid:
    """Samples on a uniform time grid. values: (n, k), NaN where missing. breaks: indices at which a new stretch
    begins after a long gap. missing: samples lost in short gaps; rejected: samples whose stamp did not advance;
    jitter: median absolute deviation of the sample intervals, s."""

    rate: float
    values: np.ndarray
    breaks: tuple[int, ...] = ()
    missing: int = 0
    rejected: int = 0
    jitter: float = 0.0


@dataclass(frozen=True)
class Cut:
    """Time cut out, s from the start, and why."""

    start: float
    stop: float
    reason: str


@dataclass(frozen=True)
class RestPeriods:
    """parts: (start, stop) indices into the grid at rest, in order. holes: (n,) bool, samples in them to leave out.
    cuts: what was cut out, for the report. shifts: (s, column, size) of large shifts of the level where the samples
    were kept: either the table tilted a little or the bias of the sensor jumped; the samples do not show which."""

    parts: tuple[tuple[int, int], ...]
    holes: np.ndarray
    cuts: tuple[Cut, ...] = ()
    shifts: tuple[tuple[float, int, float], ...] = ()


def to_grid(stamp: np.ndarray, values: np.ndarray) -> Grid:
    """Lay stamped samples on a uniform grid.

    stamp: (n,) ns. values: (n, k). The sensor's clock is assumed to be steady, and the stamps to contain the delay of
    the driver in addition: samples that come in a burst are late, not missing. Samples are missing where even the
    smallest delays increase for good. Raises StationaryError for fewer than 100 samples.
    """
    if not len(stamp):
        raise StationaryError('there is no sample that could be used to characterize a sensor')
    forward = np.concatenate([[True], stamp[1:] > np.maximum.accumulate(stamp)[:-1]])
    rejected = int(np.count_nonzero(~forward))
    time = (stamp[forward] - stamp[0]) * 1e-9
    if len(time) < 100:
        raise StationaryError(f'{len(time)} samples with advancing stamps are too few to characterize a sensor')
    interval = _sample_interval(time)
    steps = _steps(time, interval)
    long = steps * interval > LONGEST_HOLE
    missing = int(steps[~long].sum())
    index = np.arange(len(time)) + np.concatenate([[0], np.cumsum(np.where(long, 0, steps))])
    breaks = tuple(int(i) for i in index[1:][long])
    if missing:
        filled = np.full((index[-1] + 1, values.shape[1]), np.nan)
        filled[index] = values[forward]
    else:
        filled = np.asarray(values[forward], float)
    filled[~np.isfinite(filled).all(axis=1)] = np.nan
    intervals = np.diff(time)
    present = index[-1] + 1 + int(np.sum(long))
    elapsed = time[-1] - time[0] - np.sum(intervals[long]) + np.sum(long) * interval
    return Grid((present - 1) / elapsed, filled, breaks, missing, rejected,
                float(np.median(np.abs(intervals - np.median(intervals)))))


def _sample_interval(time):
    reach = max(1, min(200, len(time) // 4))
    return float(np.median(time[reach:] - time[:-reach])) / reach


def _steps(time, interval):
    """Number of samples missing before each sample but the first: permanent steps of the smallest delay after it."""
    from scipy.ndimage import minimum_filter1d

    window = max(5, round(1.0 / interval))
    delay = time - interval * np.arange(len(time))
    ahead = minimum_filter1d(delay, window, mode='nearest', origin=-(window // 2))
    return np.maximum(np.round(np.diff(ahead) / interval), 0).astype(np.int64)


def find_rest(grid: Grid) -> RestPeriods:
    """The parts at rest of at least SHORTEST s.

    The test is made in windows of a second or 50 samples, relative to the quiet windows of the same recording: by the
    spread, the peaks, and the steps of the level from one window to the next that are too large for a slow error.
    Raises StationaryError where the sensor is nowhere at rest for that long, or an axis delivers a constant.
    """
    size = max(round(_WINDOW * grid.rate), _WINDOW_SAMPLES)
    count = len(grid.values) // size
    seconds = size / grid.rate
    if count * seconds < SHORTEST or count < 2 * _SIDE + 2:
        raise StationaryError(f'{len(grid.values) / grid.rate:.0f} s are too short to characterize a sensor; '
                              f'{SHORTEST:.0f} s is the least, hours are needed for the slow errors')
    mean, spread, peak = _window_statistics(grid.values, size, count)
    quiet = _quiet_spread(spread)
    present = np.isfinite(mean).all(axis=1)
    disturbed = present & ((spread > _SPREAD * quiet) | (peak > _PEAK * np.maximum(spread, quiet))
                           | (peak > _PEAK * 1.2 * quiet)).any(axis=1)
    bad = ~present | _widened(disturbed)
    smooth = _side_means(mean, bad)
    boundaries, steps = _boundaries(mean, bad, smooth, quiet / np.sqrt(size))
    boundaries |= {int(np.clip(round(b / size), 0, count)) for b in grid.breaks}
    cuts = _describe(bad & present, steps, boundaries, grid.breaks, seconds, size, count)
    parts, short = _parts(bad, boundaries, size, count, len(grid.values), SHORTEST / seconds)
    if not parts:
        raise StationaryError(f'nowhere in {len(grid.values) / grid.rate:.0f} s is the sensor at rest for '
                              f'{SHORTEST:.0f} s without being moved in between')
    cuts += [Cut(float(a * seconds), float(b * seconds), f'at rest for less than {SHORTEST:.0f} s') for a, b in short]
    holes = np.zeros(len(grid.values), bool)
    holes[:count * size] = np.repeat(bad & present, size)
    shifts = _shifts(np.where(bad[:, None], np.nan, mean), parts, size, seconds)
    return RestPeriods(tuple(parts), holes, tuple(sorted(cuts, key=lambda cut: cut.start)), shifts)


def _window_statistics(values, size, count):
    """Mean, standard deviation and largest deviation from the mean in each window: (count, k) each."""
    statistics = np.empty((3, count, values.shape[1]))
    for k in range(values.shape[1]):
        windows = values[:count * size, k].reshape(count, size)
        present = np.isfinite(windows)
        number = present.sum(axis=1)
        total = np.where(present, windows, 0.0).sum(axis=1)
        with np.errstate(invalid='ignore', divide='ignore'):
            mean = np.where(2 * number >= size, total / number, np.nan)
            deviation = np.where(present, windows - mean[:, None], 0.0)
            spread = np.sqrt(np.square(deviation).sum(axis=1) / number)
            statistics[:, :, k] = mean, spread, np.abs(deviation).max(axis=1)
    return statistics


def _quiet_spread(spread):
    quiet = np.nanquantile(spread, 0.1, axis=0)
    for k in np.flatnonzero(quiet <= 0):
        moving = spread[:, k][spread[:, k] > 0]
        if not len(moving):
            raise StationaryError(f'the {axis_name(k)} axis delivers a constant value')
        quiet[k] = np.median(moving)
    return quiet


def axis_name(k: int) -> str:
    """Name of column k of accelerometer x, y, z, gyroscope x, y, z."""
    return f'{("accelerometer", "gyroscope")[k // 3]} {"xyz"[k % 3]}'


def _widened(mask):
    wide = mask.copy()
    wide[1:] |= mask[:-1]
    wide[:-1] |= mask[1:]
    return wide


def _side_means(mean, bad):
    """Mean of the _SIDE good windows that begin at each window; NaN where one of them is bad."""
    good = np.where(bad[:, None], np.nan, mean)
    total = np.cumsum(np.concatenate([np.zeros((1, mean.shape[1])), np.where(np.isnan(good), 0.0, good)]), axis=0)
    whole = np.cumsum(np.concatenate([[0], ~bad]))
    full = whole[_SIDE:] - whole[:-_SIDE] == _SIDE
    return np.where(full[:, None], (total[_SIDE:] - total[:-_SIDE]) / _SIDE, np.nan)


def _boundaries(mean, bad, smooth, floor):
    """Windows at which a new part begins: the level stepped, at once or across a disturbance."""
    boundaries, steps = set(), []
    difference = np.abs(np.diff(mean, axis=0))
    limit = _STEP * np.maximum(_typical(np.diff(np.where(bad[:, None], np.nan, mean), axis=0)), floor)
    for k in np.flatnonzero(~bad[1:] & ~bad[:-1] & (difference > limit).any(axis=1)):
        boundaries.add(int(k) + 1)
        steps.append(int(k) + 1)
    for a, b in runs(bad):
        if a >= _SIDE and b < len(smooth) and _moved(smooth, a, b, floor):
            boundaries.add(int(b))
    return boundaries, steps


def _moved(smooth, a, b, floor):
    lag = b - a + _SIDE
    change = np.abs(smooth[b] - smooth[a - _SIDE])
    if not np.isfinite(change).all():
        return False  # another disturbance is near; the decision is made there
    # change of the sensor's slow error in this time: a random walk from one stretch of windows to the next
    usual = _typical(smooth[_SIDE:] - smooth[:-_SIDE]) * np.sqrt(lag / _SIDE)
    return bool((change > _STEP * np.maximum(usual, floor)).any())


def _typical(differences):
    """Robust standard deviation of zero-mean differences, per column."""
    return 1.4826 * np.nanmedian(np.abs(differences), axis=0)


def _shifts(mean, parts, size, seconds):
    """(s, column, size): steps within a part of means over _SHIFT_SIDE windows, the largest of each neighbourhood."""
    found = []
    for start, stop in parts:
        levels = mean[start // size:stop // size]
        if len(levels) < 10 * _SHIFT_SIDE:
            continue
        present = np.isfinite(levels)
        total = np.cumsum(np.concatenate([np.zeros((1, levels.shape[1])), np.where(present, levels, 0.0)]), axis=0)
        count = np.cumsum(np.concatenate([np.zeros((1, levels.shape[1])), present]), axis=0)
        number = np.maximum(count[_SHIFT_SIDE:] - count[:-_SHIFT_SIDE], 1)
        smooth = (total[_SHIFT_SIDE:] - total[:-_SHIFT_SIDE]) / number
        step = smooth[_SHIFT_SIDE:] - smooth[:-_SHIFT_SIDE]
        relative = np.abs(step) / np.maximum(_typical(step), np.finfo(float).tiny)
        while relative.max() > _STEP:
            i, k = np.unravel_index(np.argmax(relative), relative.shape)
            found.append((float((start // size + i + _SHIFT_SIDE) * seconds), int(k), float(step[i, k])))
            relative[max(0, i - 2 * _SHIFT_SIDE):i + 2 * _SHIFT_SIDE, k] = 0.0
    return tuple(sorted(found))


def _describe(disturbed, steps, boundaries, breaks, seconds, size, count):
    cuts = []
    for a, b in runs(disturbed):
        reason = 'vibration' if (b - a) * seconds > _LONG else 'knock'
        moved = not boundaries.isdisjoint(range(a, b + 1))
        cuts.append(Cut(float(a * seconds), float(b * seconds), 'moved: another level after it' if moved else reason))
    cuts += [Cut(float(k * seconds), float(k * seconds), 'level stepped: a new part begins') for k in steps]
    cuts += [Cut(b / size * seconds, b / size * seconds, 'gap in the stamps: a new part begins') for b in breaks]
    return cuts


def _parts(bad, boundaries, size, count, samples, shortest):
    """(start, stop) of long enough parts in samples; of those too short in windows."""
    edges = sorted({0, count} | boundaries)
    parts, short = [], []
    for a, b in zip(edges[:-1], edges[1:]):
        good = np.flatnonzero(~bad[a:b])
        if len(good) >= shortest:
            stop = samples if b == count and good[-1] == b - a - 1 else (a + good[-1] + 1) * size
            parts.append((int(a + good[0]) * size, int(stop)))
        elif len(good):
            short.append((a, b))
    return parts, short
