"""Several recordings of one vehicle: put on one time axis, and checked to be of the same vehicle."""
from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import fields, replace

import numpy as np

from ..filter.runs.usable import usable_samples
from ..samples import Recording
from .errors import RecordingError

#: s, gap between two drives on the common time axis: longer than any block of time in the statistics
BETWEEN = 120.0
#: largest ratio of the rates of the IMUs in recordings of the same vehicle
SAME_RATE = 1.25
#: rad, largest angle between the directions of gravity in IMU axes in recordings with the same mounting
SAME_UP = np.radians(30.0)


def one_after_another(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with different names and on one time axis, BETWEEN apart; the first one is not changed."""
    placed: list[Recording] = []
    for recording in recordings:
        recording = replace(recording, name=free_name(recording.name, {other.name for other in placed}))
        if placed:
            end = max(int(samples.stamp.max()) for samples in _samples(placed[-1]))
            begin = min(int(samples.stamp.min()) for samples in _samples(recording))
            recording = shifted_recording(recording, end - begin + round(BETWEEN * 1e9))
        placed.append(recording)
    return placed


def free_name(name: str, taken: Collection[str]) -> str:
    """`name`, with a number where it is `taken`."""
    names = [name, *(f'{name}_{i}' for i in range(2, len(taken) + 2))]
    return next(n for n in names if n not in taken)


def _samples(recording: Recording) -> list:
    # a reference may hold more than the drive
    return [samples for name, samples in recording.streams().items() if name != 'reference' and len(samples)]


def shifted_recording(recording: Recording, shift: int) -> Recording:
    """The recording with all stamps later by `shift` ns."""
    moved = {}
    for name, samples in recording.streams().items():
        stamps = {f.name: getattr(samples, f.name) + shift for f in fields(samples)
                  if f.name in ('stamp', 'received', 'later')}
        moved[name] = replace(samples, **stamps)
    return recording.having(moved)


def refuse_other_vehicles(recordings: Sequence[Recording]) -> None:
    """Raise RecordingError if a recording cannot be of the same vehicle and IMU as the first one, or is a duplicate.

    The criteria are the rate of the IMU and its mounting.
    """
    for i, recording in enumerate(recordings):
        for other in recordings[:i]:
            refuse_twice(recording, other)
        if i:
            _refuse_another(recording, recordings[0])


def refuse_twice(recording, other) -> None:
    """Raise RecordingError if `recording` has samples of `other`: the same data twice are no more evidence than once.

    Both have the attributes `name` and `imu`.
    """
    _, a, b = np.intersect1d(recording.imu.stamp, other.imu.stamp, return_indices=True)
    same = (recording.imu.specific_force[a] == other.imu.specific_force[b]).all(axis=1).sum()
    if same > 0.5 * min(len(recording.imu), len(other.imu)):
        raise RecordingError(f'{recording.name} holds the samples of {other.name}; give each recording once')


def _refuse_another(recording: Recording, first: Recording) -> None:
    rate, usual = _rate(recording), _rate(first)
    advice = 'give recordings of one vehicle with one IMU, or diagnose them apart'
    if not 1 / SAME_RATE < rate / usual < SAME_RATE:
        raise RecordingError(f'{recording.name} has an IMU of {rate:.3g} Hz and {first.name} one of {usual:.3g} Hz; '
                             f'{advice}')
    up, usual_up = _up(recording), _up(first)
    if up @ usual_up < np.cos(SAME_UP):
        words = ['({:.2g}, {:.2g}, {:.2g})'.format(*(v + 0.0)) for v in np.round([up, usual_up], 2)]
        raise RecordingError(f'up is {words[0]} in the axes of the IMU in {recording.name} and {words[1]} in '
                             f'{first.name}, so it is mounted differently; {advice}')


def _rate(recording: Recording) -> float:
    step = np.diff(usable_samples(recording.imu).stamp)
    return float(1e9 / np.median(step)) if len(step) else float('nan')


def _up(recording: Recording) -> np.ndarray:
    """The mean direction of specific force in sensor axes, (3,)."""
    mean = usable_samples(recording.imu).specific_force.sum(axis=0)
    return mean / max(np.linalg.norm(mean), 1e-12)
