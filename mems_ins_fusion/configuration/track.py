"""The shape of a drive from the IMU alone: attitude from the gyroscopes, place from the accelerometers."""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.configuration.kinematics import FINEST, LONGEST_GAP
from mems_ins_fusion.recordings.motion import advancing, integral
from mems_ins_fusion.samples import ImuSamples


class Track:
    """Running integrals of samples in the axes of the first one, followed by the gyroscopes; times in s after `origin`.

    rotation: (n, 3, 3) from sensor axes. force: (n, 3) specific force, velocity, place: its integrals. by_force:
    (n, 3, 3) derivative of the place by the specific force, turned: integral of the rotation, by_rate: (n, 3, 3)
    derivative of the place by an error of the rate, of which each piece takes its part. stretches: (k, 2) s, begin and
    end of samples without a gap. bias: (3,) rad/s, taken off the rates.
    """

    def __init__(self, imu: ImuSamples, origin: int, still: np.ndarray):
        """still: (n,) bool, samples at rest, whose mean rate is the gyroscopes' bias; with none it is zero."""
        self.bias = imu.angular_rate[still].mean(axis=0) if still.any() else np.zeros(3)
        time, force, rate = advancing(imu, origin)
        step = float(np.median(np.diff(time)))
        gap = np.diff(time) > max(LONGEST_GAP, 3.0 * step)
        self.stretches = np.column_stack([np.append(time[0], time[1:][gap]), np.append(time[:-1][gap], time[-1])])
        some = slice(None, None, max(round(1.0 / (FINEST * step)), 1))
        self.time = time[some]
        turn = np.diff(integral(time, rate - self.bias)[some], axis=0)
        push = np.diff(integral(time, force)[some], axis=0)
        length = np.diff(self.time)
        self.rotation = _rotations(turn)
        middle = self.rotation[:-1] @ (np.eye(3) + 0.5 * cross(turn))
        push = np.einsum('nij,nj->ni', middle, push)
        self.force = np.vstack([push / length[:, None], push[-1:] / length[-1]])
        self.velocity, self.place = self._integrals(push)
        _, self.by_force = self._integrals(middle * length[:, None, None])
        self.turned = integral(self.time, self.rotation)
        _, self.by_rate = self._integrals(-cross(push) @ (0.5 * (self.turned[1:] + self.turned[:-1])))

    def covers(self, begin: float, end: float) -> bool:
        """Whether there are samples without a gap from `begin` to `end`, s."""
        return bool(((self.stretches[:, 0] <= begin) & (end <= self.stretches[:, 1])).any())

    def smoothed(self, tau: float) -> np.ndarray:
        """`force` twice through a low pass with the time constant `tau`, s: (n, 3)."""
        decay = math.exp(-float(np.median(np.diff(self.time))) / tau) if tau > 0.0 else 0.0
        return _low_pass(_low_pass(self.force, decay), decay)

    def through_low_pass(self, values: np.ndarray, tau: float) -> np.ndarray:
        """`through_low_pass` of `values` (n, ...) at the times of the track."""
        return through_low_pass(self.time, values, tau)

    def _integrals(self, increments):
        """Sum of `increments` (n - 1, ...) up to each time, (n, ...), and its integral over time."""
        first = np.concatenate([np.zeros_like(increments[:1]), np.cumsum(increments, axis=0)])
        return first, integral(self.time, first)

    def at(self, values: np.ndarray, times: np.ndarray) -> np.ndarray:
        """`values` (n, ...) at `times`, of any shape, linear in between."""
        flat = times.ravel()
        left = np.clip(np.searchsorted(self.time, flat) - 1, 0, len(self.time) - 2)
        part = (flat - self.time[left]) / (self.time[left + 1] - self.time[left])
        part = part.reshape((-1,) + (1,) * (values.ndim - 1))
        found = values[left] * (1.0 - part) + values[left + 1] * part
        return found.reshape(times.shape + values.shape[1:])


def through_low_pass(time: np.ndarray, values: np.ndarray, tau: float) -> np.ndarray:
    """`values` (n, ...), linear between `time` (n,), s, through a low pass with the time constant `tau`, s; 0: as they
    are."""
    if tau == 0.0:
        return values
    ratio = float(np.median(np.diff(time))) / tau
    decay, change = math.exp(-ratio), np.diff(values, axis=0, prepend=values[:1])
    # what is behind: u[n] = decay u[n - 1] + change[n] (1 - decay) / ratio
    return values - _low_pass(change, decay) / ratio


def cross(vectors: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrices that multiply by (..., 3) `vectors` from the left, as cross product."""
    matrix = np.zeros((*vectors.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., i, j], matrix[..., j, i] = -vectors[..., k], vectors[..., k]
    return matrix


def _rotations(turns: np.ndarray) -> np.ndarray:
    """(n + 1, 3, 3) rotations to the first frame that successive small `turns`, (n, 3) rad, lead to."""
    half = 0.5 * np.vstack([np.zeros((1, 3)), turns])
    size = np.linalg.norm(half, axis=1)
    quaternion = np.column_stack([np.cos(size), half * np.sinc(size / np.pi)[:, None]])
    reach = 1
    while reach < len(quaternion):  # products of 1, 2, 4, ... in a row: Hillis and Steele's scan
        quaternion = np.vstack([quaternion[:reach], _product(quaternion[:-reach], quaternion[reach:])])
        quaternion /= np.linalg.norm(quaternion, axis=1)[:, None]
        reach *= 2
    w, x, y, z = quaternion.T
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z),
                     1 - 2 * (x * x + z * z), 2 * (y * z - w * x), 2 * (x * z - w * y), 2 * (y * z + w * x),
                     1 - 2 * (x * x + y * y)], axis=1).reshape(-1, 3, 3)


def _product(one, other):
    (a, b, c, d), (w, x, y, z) = one.T, other.T
    return np.column_stack([a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
                            a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w])


def _low_pass(values, decay):
    """First-order low pass along the first axis, settled at the first value: y[n] = (1 - decay) x[n] + decay y[n - 1].

    As a sum of ever longer parts: `lfilter` does the same, but each start of a node would import it for half a second.
    """
    found = (1.0 - decay) * values
    found[0] = values[0]
    step, reach = 1, decay
    while step < len(found) and reach > 1e-18:
        found[step:] += reach * found[:-step]
        step, reach = 2 * step, reach * reach
    return found
