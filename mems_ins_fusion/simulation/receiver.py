"""The GNSS receiver of a simulation: the times of its fixes, and their errors."""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.errors import InputError
from mems_ins_fusion.sensor_errors.models import gauss_markov_at

_DROPOUT = (3.0, 40.0)  # s, range of the random lengths of drop-outs


@dataclass(frozen=True)
class GnssNoise:
    """A receiver. sigma: m, white, north and east. rate: Hz. outages: (start, stop) s after the start of the drive,
    without fixes. latency: s from a fix's stamp to its arrival. vertical_sigma: m, by default 1.5 sigma. phase: s from
    the start of the drive to the first fix, so that fixes fall between IMU samples.

    coloured_sigma: m, of an error that lasts, first-order Gauss-Markov of coloured_tau s, on each axis; it is part of
    the stated covariance. outliers: share of the fixes that are outlier_sigma m off, and do not say so. smoothing: s,
    time constant of the receiver's own filter, which takes the velocity for constant: noise comes out coloured, and
    positions late whenever the velocity changes. dropouts: an hour, of a few to 40 s.
    """

    sigma: float = 1.5
    rate: float = 1.0
    outages: Sequence[tuple[float, float]] = ()
    latency: float = 0.0
    vertical_sigma: float | None = None
    phase: float = 0.0037
    coloured_sigma: float = 0.0
    coloured_tau: float = 60.0
    outliers: float = 0.0
    outlier_sigma: float = 20.0
    smoothing: float = 0.0
    dropouts: float = 0.0

    def __post_init__(self):
        if self.rate <= 0 or self.sigma < 0:
            raise InputError(f'the receiver needs a positive rate and a sigma of 0 or more, '
                             f'got {self.rate:g} Hz and {self.sigma:g} m')
        for start, stop in self.outages:
            if not start < stop:
                raise InputError(f'an outage must end after it starts, got {start:g} to {stop:g} s')
        for name in ('coloured_sigma', 'outliers', 'smoothing', 'dropouts'):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(f"the receiver's {name} must be 0 or more, got {getattr(self, name):g}")
        if self.outliers > 1 or self.coloured_tau <= 0:
            raise InputError('the receiver needs a share of outliers of at most 1, and a positive coloured_tau, '
                             f'got {self.outliers:g} and {self.coloured_tau:g} s')

    def times(self, duration: float) -> np.ndarray:
        """Stamps of the fixes, (m,) s after the start of a drive of `duration` s."""
        time = self.phase + np.arange(math.floor((duration - self.phase) * self.rate + 1e-9) + 1) / self.rate
        for start, stop in self.outages:
            time = time[(time < start) | (time >= stop)]
        return time

    def received(self, time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """The times among `time` (m,) s that are in no drop-out."""
        end = 0.0
        while self.dropouts and len(time) and end < time[-1]:
            start = end + rng.exponential(3600.0 / self.dropouts)
            end = start + rng.uniform(*_DROPOUT)
            time = time[(time < start) | (time >= end)]
        return time

    def distort(self, time: np.ndarray, position: np.ndarray, error: np.ndarray, stream) -> np.ndarray:
        """The `error` (m, 3) m of true `position` (m, 3) m at `time` (m,) s, with all errors beyond white noise added.

        stream(purpose): random numbers for one purpose.
        """
        if self.coloured_sigma:
            white = stream('coloured').standard_normal((len(time), 3))
            error = error + self.coloured_sigma * gauss_markov_at(time, self.coloured_tau, white)
        if self.outliers:
            rng = stream('outliers')
            wrong = rng.uniform(size=len(time)) < self.outliers
            error = error + wrong[:, None] * self.outlier_sigma * rng.standard_normal(error.shape)
        return _smoothed(time, position + error, self.smoothing) - position if self.smoothing else error


def _smoothed(time, position, tau):
    """`position` behind a critically damped alpha-beta filter of time constant `tau` s, which restarts after a gap."""
    smooth, velocity = position.copy(), np.zeros(3)
    for i, step in enumerate(np.diff(time).tolist()):
        if step > 5 * tau:
            velocity = np.zeros(3)
            continue
        theta = math.exp(-step / tau)
        predicted = smooth[i] + step * velocity
        innovation = position[i + 1] - predicted
        smooth[i + 1] = predicted + (1 - theta**2) * innovation
        velocity = velocity + (1 - theta)**2 / step * innovation
    return smooth
