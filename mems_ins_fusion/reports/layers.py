"""Layers of the interactive tracks: runs and outages of a replay, a diagnosis before and after."""
from __future__ import annotations

import numpy as np

from ..diagnosis.findings import Diagnosis
from ..diagnosis.measured import MeasuredErrors
from ..evaluation.comparison import Comparison, truth_of
from ..evaluation.metrics import Errors, Truth, lever_arm_north_east
from ..filter.measurements.position import is_fix
from ..filter.runs.results import Run
from ..navigation.earth import to_local
from ..navigation.frames import near
from ..samples import Fixes, Reference
from . import colours
from .track import Layer

#: s, largest time between a point of the track and the truth for its error
NEAR = 2.0


class Ground:
    """Positions as north and east of the middle of the recording, m."""

    def __init__(self, reference: Reference):
        self.datum = centre_of(reference)
        self.stamp = reference.stamp
        self.north, self.east = self(reference)

    def __call__(self, track: Reference | Run | Fixes):
        north, east, _ = to_local(track.latitude, track.longitude, track.height, self.datum)
        return north, east

    def of(self, errors: Errors):
        """North and east of a run, computed from its errors."""
        at = _nearest(self.stamp, errors.stamp)
        return self.north[at] + errors.north, self.east[at] + errors.east

    def antenna(self, run: Run, lever_arm: np.ndarray):
        """North and east of the point at `lever_arm` (3,) m, forward-right-down, from the IMU."""
        north, east = self(run)
        arm_north, arm_east = lever_arm_north_east(lever_arm, run.roll, run.pitch, run.yaw)
        return north + arm_north, east + arm_east


def centre_of(reference: Reference) -> np.ndarray:
    """Latitude, longitude (rad) and height (m) in the middle of the recording."""
    longitude = near(reference.longitude, reference.longitude[0])
    return np.array([np.median(reference.latitude), np.median(longitude), np.median(reference.height)])


def diagnosed_truth(diagnosis: Diagnosis) -> Truth:
    """The truth of one drive at the stamps of its errors."""
    return truth_of(diagnosis.recording, diagnosis.values | {'gnss.time_offset': 0.0})


def _nearest(stamp: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Index of the stamp next to each of `wanted`; both ns, `stamp` ascending."""
    right = np.clip(np.searchsorted(stamp, wanted), 1, max(len(stamp) - 1, 1))
    left = right - 1
    return np.where(wanted - stamp[left] <= stamp[np.minimum(right, len(stamp) - 1)] - wanted, left,
                    np.minimum(right, len(stamp) - 1))


def replay_layers(comparison: Comparison, best: str, names: dict[str, str]) -> list[Layer]:
    """Truth, fixes used and withheld, each model at the shortest interval, its longest outages.

    best: model whose outages are shown at first. names: displayed names of the models.
    """
    ground, origin = Ground(comparison.truth.reference), int(comparison.recording.imu.stamp[0])
    interval = comparison.intervals[0]
    runs = {model: comparison.run_of(model, interval) for model in comparison.models}
    layers = [_truth(ground, origin, comparison.truth.source)]
    layers += _fixes(ground, comparison, runs[best].run, origin)
    for model, result in runs.items():
        north, east = ground.antenna(result.run, comparison.truth.lever_arm)
        layers.append(Layer(f'{names[model]}, fixes each {interval:g} s', colours.MODELS[model],
                            seconds(result.run.stamp, origin), east, north, _read(result.run, result.errors),
                            colours.WIDTHS[model] + 0.5, dash=() if model != 'autoregressive' else (6, 4)))
    for result in comparison.smoothed:
        north, east = ground.antenna(result.run, comparison.truth.lever_arm)
        layers.append(Layer(f'{names[result.model]}, smoothed', colours.SMOOTHED,
                            seconds(result.run.stamp, origin), east, north, _read(result.run, result.errors), 1.5,
                            shown=result.model == best))
    longest = max((r.outages.duration for r in comparison.outages if len(r.outages.begin)), default=None)
    for result in comparison.outages:
        if result.outages.duration == longest:
            layers.append(_outages(ground, result.outages.errors, origin, colours.OUTAGE if result.model == best
                                   else colours.MODELS[result.model], shown=result.model == best,
                                   name=f'{longest:g} s without fixes, {names[result.model]}'))
    return layers


def diagnosis_layers(diagnosis: Diagnosis) -> list[Layer]:
    """Truth, fixes, and the position of one drive before and (if something is corrected) after, with all fixes and in
    the longest outages."""
    d = diagnosis
    truth = diagnosed_truth(d)
    ground, origin = Ground(truth.reference), int(d.recording.imu.stamp[0])
    layers = [_truth(ground, origin, truth.source)]
    [problem] = d.problem.each
    fixes = problem.full.gnss
    if d.recording.reference is not None:
        north, east = ground(fixes)
        layers.append(Layer('fixes', colours.FIX, seconds(fixes.stamp, origin), east, north, {}, points=2.0,
                            shown=False))
    stages = [('before', 'as configured', d.before, colours.BEFORE)]
    if d.changed:
        stages.append(('after', 'with corrected.yaml', d.after, colours.AFTER))
    for stage, name, measured, colour in stages:
        errors = measured.continuous
        north, east = ground.of(errors)
        values = {'error': errors.horizontal, 'sigma': errors.sigma, 'speed': _speed(ground, errors.stamp)}
        layers.append(Layer(f'{name}, all fixes', colour, seconds(errors.stamp, origin), east, north, values,
                            3.0 if stage == 'before' else 1.8))
    for _, name, measured, colour in stages:
        longest = _longest(measured)
        if longest is not None:
            layers.append(_outages(ground, longest.errors, origin, colour,
                                   f'{longest.duration:g} s without fixes, {name}', (5, 3)))
    return layers


def _longest(measured: MeasuredErrors):
    return next((o for o in reversed(measured.outages) if len(o.begin)), None)


def _truth(ground: Ground, origin: int, source: str) -> Layer:
    return Layer(f'truth ({source})', colours.TRUTH, seconds(ground.stamp, origin), ground.east, ground.north, {}, 6.0)


def _fixes(ground: Ground, comparison: Comparison, run: Run, origin: int) -> list[Layer]:
    """Fixes that `run` used, fixes that it was given and did not use, and fixes that it was not given."""
    fixes = comparison.recording.gnss
    fixes = fixes.select(is_fix(fixes))
    stamp = fixes.stamp - round(run.config.gnss.time_offset * 1e9)
    used = np.isin(stamp, run.innovations.stamp)
    given = np.isin(stamp, comparison.fixes_given[comparison.intervals[0]]) & (stamp >= run.stamp[0])
    north, east = ground(fixes)
    kinds = (('fixes used', used, colours.FIX, True, False), ('fixes refused', given & ~used, colours.REFUSED, True,
                                                              True),
             ('fixes withheld', ~given & ~used, colours.WITHHELD, False, True))
    return [Layer(f'{name} ({int(which.sum())})', colour, seconds(stamp[which], origin), east[which], north[which],
                  {}, points=2.5, shown=shown, hollow=hollow) for name, which, colour, shown, hollow in kinds
            if which.any()]


def _outages(ground: Ground, errors: list[Errors], origin: int, colour: str, name: str, dash=(),
             shown: bool = True) -> Layer:
    """One piece for each outage, and the true position at its end."""
    errors = [e for e in errors if len(e)]
    north, east = (np.concatenate(parts) for parts in zip(*(ground.of(e) for e in errors)))
    count = np.array([len(e) for e in errors])
    last = np.cumsum(count) - 1
    joined = {name: np.concatenate([getattr(e, name) for e in errors]) for name in ('stamp', 'north', 'east', 'sigma')}
    stamp = joined['stamp']
    values = {'error': np.hypot(joined['north'], joined['east']), 'sigma': joined['sigma'],
              'speed': _speed(ground, stamp)}
    ends = np.column_stack([east[last], north[last], east[last] - joined['east'][last],
                            north[last] - joined['north'][last]])
    return Layer(name, colour, seconds(stamp, origin), east, north, values, 2.0, shown, last - count + 1, ends,
                 dash=dash)


def _read(run: Run, errors: Errors) -> dict[str, np.ndarray]:
    """Values under the cursor along a run."""
    near = np.abs(errors.stamp[_nearest(errors.stamp, run.stamp)] - run.stamp) < NEAR * 1e9
    error = np.interp(run.stamp - run.stamp[0], errors.stamp - run.stamp[0], errors.horizontal)
    return {'speed': np.hypot(*run.velocity[:, :2].T), 'error': np.where(near, error, np.nan),
            'sigma': np.hypot(run.sigma[:, 0], run.sigma[:, 1])}


def _speed(ground: Ground, wanted: np.ndarray) -> np.ndarray:
    """True speed, mean over a second, at the stamps `wanted` (ns), m/s."""
    seconds, at = (ground.stamp - ground.stamp[0]) * 1e-9, (wanted - ground.stamp[0]) * 1e-9
    ahead, behind = at + 0.5, at - 0.5
    moved = [np.interp(ahead, seconds, values) - np.interp(behind, seconds, values)
             for values in (ground.north, ground.east)]
    return np.hypot(*moved)


def seconds(stamp: np.ndarray, origin: int) -> np.ndarray:
    """s since `origin` of stamps (n,), both ns."""
    return (stamp - origin) * 1e-9
