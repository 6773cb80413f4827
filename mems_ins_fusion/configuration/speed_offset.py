"""The time offset between the speed of wheels and the IMU: no fix, no filter.

Along the nose the accelerometers, less what gravity has there as the vehicle pitches by the gyroscopes, integrate to
the change of the speed. In each piece of the drive the first speed, the direction of gravity and the biases are unknown
anew; all pieces share the offset, the scale of the speed and the place of the axle whose wheels are counted, where the
speed in bends is another than the IMU's. So the offset is estimated with all of these unknown, and its sigma is the
model's, corrected by the jackknife over the pieces as far as that tells (`regression.moderated`). A piece in which
wheels slip fits worse than the others and counts less. A low pass that the speed comes through is a part of the offset;
the rest of what it does shows where the acceleration changes. Equations: docs/configure.md, "Wheel speed".
"""
from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from mems_ins_fusion.configuration.kinematics import InertialIntegrals
from mems_ins_fusion.configuration.offset import FEWEST_PIECES, FLOOR, LARGEST, attempted
from mems_ins_fusion.configuration.regression import moderated
from mems_ins_fusion.configuration.track import Track
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.recordings.motion import find_standstill, integral
from mems_ins_fusion.recordings.remarks import SURE
from mems_ins_fusion.samples import ImuSamples, Speeds, in_time_order, possible

#: s: an offset with a larger standard deviation is not known
SHOWN = 0.1
#: s, step of the search
_STEP = 0.1
#: steps of Gauss-Newton from the best offset of the search, and again as many with weights
_STEPS = 4
#: s, length of a piece: longer ones hardly tell more, as errors of the accelerometers grow on a rough road
_PIECE = 15.0
#: largest number of pieces: limits the computing time
_MOST_PIECES = 80
#: Hz, largest rate of the speeds: of faster ones some are left out
_DENSEST = 8.0
#: smallest number of speeds of a piece
_FEWEST = 30
#: m/s, smallest change of the speed within a piece: a constant speed does not show an offset
_MOVED = 0.5
#: s, step of the numerical derivative by the offset: with a shorter one it would be mostly vibration
_APART = 0.1
#: ratio of the mean square residual of a piece to that of the others, above which the piece has less weight, as wheels
#: slip
_SLIPPING = 3.0
#: prior standard deviations of the unknowns that all pieces have in common: offset (s), scale of the speed, position of
#: the axle across and along (m), error of the yaw of the mounting (rad)
_SHARED = np.array([3.0, 0.3, 2.0, 3.0, 0.1])
#: and their prior means
_EXPECTED = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
#: prior standard deviations of the unknowns of each piece: initial speed (m/s), bias of the forward accelerometer
#: (m/s^2), gravity in sensor axes (m/s^2, three), bias of the pitch gyroscope (rad/s)
_OWN = np.array([1e3, 0.2, 0.5, 0.5, 0.5, 3e-3])
#: m^2/s^2, first value of the variance of a speed
_NOISE = 0.05**2
#: 1/s, noise of the accelerometers that is tried: variance of their integral over a second, over that of a speed
_WALKS = (1e-2, 1e-1, 1.0, 10.0, 100.0)
#: columns of what the IMU shows: integral of the specific force along nose and left, m/s, rate about the up axis,
#: rad/s, its square's integral, integrals of the directions of nose and left, s, and the direction up
_TURN, _SQUARED, _NOSE, _LEFT, _UP = 2, 3, slice(4, 7), slice(7, 10), slice(10, 13)
#: s, time constants of a low pass that are tried
_LOW_PASSES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.55, 0.7, 0.9, 1.15, 1.5, 2.0)
#: s, step of the time constants over which the likelihood is averaged
_FINE = 0.01


#: s: a body on springs, which pitches when it accelerates, looks like such a low pass. RMS over simulated cars
SPRINGS = 0.2
#: s, the largest of these
MOST_SPRINGS = 0.3


@dataclass(frozen=True)
class LowPass:
    """The low pass that a speed shows. tau, sigma: its time constant, s."""

    tau: float
    sigma: float

    @property
    def certain(self) -> bool:
        """Whether it is more than the springs of the body."""
        return self.tau - SURE * self.sigma > MOST_SPRINGS

    def left(self, declared: float) -> LowPass | None:
        """What there is of it beside one of `declared` s, the squares of whose time constants add up; None where
        nothing is certain."""
        if not self.certain or self.tau - declared <= SURE * self.sigma:
            return None
        tau = math.sqrt(self.tau**2 - declared**2)
        return LowPass(tau, self.sigma * self.tau / tau)


@dataclass(frozen=True)
class SpeedOffset:
    """lag, lag_sigma: s, as `speed.time_offset`, with the part that `low_pass` makes. scale: measured over true speed,
    by the IMU. left: m, and its sigma, from the IMU to the left to where it is measured."""

    lag: float
    lag_sigma: float
    scale: float
    left: tuple[float, float]
    low_pass: LowPass


def estimate_speed_offset(imu: ImuSamples, speeds: Speeds, rotation: np.ndarray) -> SpeedOffset | None:
    """The time offset that `imu` (SI units) and `speeds` (m/s, positive forwards) show; None with too little motion.

    rotation: (3, 3) from sensor axes to base_link, to about ten degrees. None, too, for numbers that no vehicle gives.
    """
    return attempted(_estimated, lambda: _pieces(imu, speeds, rotation))


def _estimated(raw: _Pieces) -> SpeedOffset:
    lags = np.arange(-LARGEST, LARGEST + 0.01, _STEP)
    walk, lag = 1.0, 0.0
    for _ in range(2):
        costs = np.array([raw.solved(at, walk, free=False).cost for at in lags])
        lag = float(lags[np.argmin(costs)])
        walk = min(_WALKS, key=lambda one: raw.unlikely(lag, one))
        raw = replace(raw, noise=raw.solved(lag, walk, free=False).noise)
    pieces, lag = _settled(raw, lag, walk)
    tau, (late, costs) = 0.0, _with_low_passes(raw, pieces, lag, walk)
    if best := int(np.argmin(costs)):
        tau = _LOW_PASSES[best]
        pieces, lag = _settled(replace(raw.smoothed(tau), noise=pieces.noise), float(late[best]) - tau, walk)
        late, costs = _with_low_passes(raw, pieces, lag + tau, walk)
    found = pieces.solved(lag, walk)
    sigma = moderated(found.left_out(), found.each[:, 1:, 1:], found.prior, found.noise)
    # each offset and low pass counts by its likelihood, tempered where the jackknife does not believe the model's noise
    temper = sigma[0] ** 2 / np.linalg.inv(found.normal)[0, 0]
    mean, between = _averaged(late, costs / temper)
    tau, tau_sigma = _averaged(np.array(_LOW_PASSES), costs / temper)
    low_pass = LowPass(tau, math.hypot(tau_sigma, 0.5 * SPRINGS**2 / max(tau, SPRINGS)))
    costs = np.array([pieces.solved(at, walk, free=False).cost for at in lags])
    likely = np.exp(-0.5 * (costs - costs.min()) / temper)
    spread = math.sqrt(float(likely @ (lags - lag) ** 2 / likely.sum()))
    # as much as one step of the search shows of a single minimum is no rival
    apart = spread if spread > _STEP + float(sigma[0]) else 0.0
    return SpeedOffset(mean, math.hypot(float(sigma[0]), between, apart, FLOOR), float(found.solution[1]),
                       (-float(found.solution[2]), float(sigma[2])), low_pass)


def _settled(pieces: _Pieces, lag: float, walk: float) -> tuple[_Pieces, float]:
    """`pieces` with weights, and their offset, by Gauss-Newton from `lag` on."""
    for step in range(2 * _STEPS):
        found = pieces.solved(lag, walk)
        lag += float(np.clip(found.solution[0], -_STEP, _STEP))
        pieces = pieces.weighted(found) if step >= _STEPS else replace(pieces, noise=found.noise)
    return pieces, lag + float(pieces.solved(lag, walk).solution[0])


def _with_low_passes(raw: _Pieces, pieces: _Pieces, late: float, walk: float) -> tuple[np.ndarray, np.ndarray]:
    """By how much the speed is late in all, s, and the weighted squares, with each of _LOW_PASSES. late: about that;
    pieces: with the weights."""
    found = []
    for tau in _LOW_PASSES:
        smoothed = replace(raw.smoothed(tau), weight=pieces.weight, noise=pieces.noise)
        for _ in range(2):
            late += float(np.clip(smoothed.solved(late - tau, walk).solution[0], -_STEP, _STEP))
        found.append((late, smoothed.solved(late - tau, walk, free=False).cost))
    return np.array(found)[:, 0], np.array(found)[:, 1]


def _averaged(values: np.ndarray, costs: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation over the low passes, of which each time constant is as probable before anything is
    known. costs: minus twice the logarithms of their likelihoods."""
    tried, fine = np.array(_LOW_PASSES), np.arange(0.0, _LOW_PASSES[-1], _FINE)
    left = np.searchsorted(tried, fine, side='right') - 1
    width, slopes = np.diff(tried)[left], np.gradient(costs, tried)
    part = (fine - tried[left]) / width
    costs = ((1.0 + 2.0 * part) * (1.0 - part)**2 * costs[left] + part**2 * (3.0 - 2.0 * part) * costs[left + 1]
             + width * part * (1.0 - part) * ((1.0 - part) * slopes[left] - part * slopes[left + 1]))  # cubic splines
    values = np.interp(fine, tried, values)
    likely = np.exp(-0.5 * (costs - costs.min()))
    likely /= likely.sum()
    mean = float(likely @ values)
    return mean, math.sqrt(float(likely @ (values - mean) ** 2))


@dataclass(frozen=True)
class _Solved:
    """Least squares of all pieces. solution: of what is shared, the offset as a change. cost: weighted squares. noise:
    their mean. each: (w, k, k) products of [speed, shared] of the pieces, their own unknowns free, weighted."""

    solution: np.ndarray
    cost: float
    noise: float
    normal: np.ndarray
    each: np.ndarray
    prior: np.ndarray

    def left_out(self) -> np.ndarray:
        """(w, s) solutions, each without one piece."""
        rest = self.each.sum(axis=0) - self.each
        right = rest[:, 1:, 0] + self.prior * _EXPECTED
        return np.linalg.solve(rest[:, 1:, 1:] + np.diag(self.prior), right[..., None])[..., 0]


@dataclass(frozen=True)
class _Pieces:
    """The w pieces of a drive, with as many places for speeds as the longest one has: the rest of a shorter one is not
    `used` and repeats its last time. All of them are computed at once.

    track: of the samples. shown: (n, 13) at its times, columns as _TURN to _UP say. times: (w, t) s after the track's
    origin. speeds: (w, t) m/s. weight: (w,) of each. noise: variance of a speed, m^2/s^2. whitening: by walk, what
    `_whitening` has made."""

    track: Track
    shown: np.ndarray
    times: np.ndarray
    speeds: np.ndarray
    used: np.ndarray
    weight: np.ndarray
    noise: float = _NOISE
    whitening: dict[float, tuple[np.ndarray, float]] = field(default_factory=dict)

    @cached_property
    def freedom(self) -> np.ndarray:
        """(w,) measurements of each piece beyond its own unknowns."""
        return np.maximum(self.used.sum(axis=1) - len(_OWN), 1)

    def solved(self, lag: float, walk: float, free: bool = True) -> _Solved:
        """Least squares about `lag`. free: whether the offset is a change of it; else it is exact. walk: of _WALKS."""
        each = self.weight[:, None, None] * self._reduced(lag, walk)[0]
        total, first = each.sum(axis=0), 0 if free else 1
        freedom = float(self.weight @ self.freedom)
        prior = self.noise / _SHARED**2
        normal, right = total[1:, 1:] + np.diag(prior), total[1:, 0] + prior * _EXPECTED
        solution = np.linalg.solve(normal[first:, first:], right[first:])
        cost = float(total[0, 0] + prior @ _EXPECTED**2 - right[first:] @ solution)
        return _Solved(solution, cost, cost / freedom, normal, each, prior)

    def unlikely(self, lag: float, walk: float) -> float:
        """Minus twice the logarithm of the likelihood of `walk` at that offset."""
        more = self._reduced(lag, walk)[1]
        return float(self.freedom.sum()) * math.log(self.solved(lag, walk, free=False).noise) + more

    def smoothed(self, tau: float) -> _Pieces:
        """What the IMU shows, through a low pass of the time constant `tau`, s."""
        through = self.track.through_low_pass(self.shown[:, :_UP.start], tau)
        return replace(self, shown=np.hstack([through, self.shown[:, _UP]]))

    def weighted(self, found: _Solved) -> _Pieces:
        """With less weight on the pieces that fit worse than most."""
        left = np.concatenate([[1.0], -found.solution])
        squares = np.einsum('i,wij,j->w', left, found.each, left) / self.weight / self.freedom
        usual = _SLIPPING * np.median(squares)
        return replace(self, noise=found.noise, weight=np.minimum(1.0, usual / np.maximum(squares, 1e-12)))

    def _reduced(self, lag: float, walk: float) -> tuple[np.ndarray, float]:
        """(w, k, k) products of [speed, shared] of each piece with its own unknowns free, and the sum of the logarithms
        of the determinants of its noise and of these."""
        inverse, logarithm = self._whitening(walk)
        (value, left, turn, squared), own = self._integrated(lag)
        later, sooner = (self._integrated(lag + apart)[0][0] for apart in (-_APART, _APART))
        shared = np.stack([(sooner - later) / (2.0 * _APART), value, turn, squared, left], axis=-1)
        white = inverse @ np.concatenate([self.speeds[..., None], shared, own], axis=-1)
        products, first = white.swapaxes(1, 2) @ white, 1 + shared.shape[-1]
        normal = products[:, first:, first:] + np.diag(self.noise / _OWN**2)
        back = np.linalg.solve(normal, products[:, first:, :first])
        return (products[:, :first, :first] - products[:, :first, first:] @ back,
                logarithm + float(np.linalg.slogdet(normal)[1].sum()))

    def _whitening(self, walk: float) -> tuple[np.ndarray, float]:
        """(w, t, t) inverses of the roots of the covariances of the pieces' noise, zero where nothing is used, and the
        sum of the logarithms of their determinants: the same for all offsets, of which some hundred are tried."""
        if walk not in self.whitening:
            since = self.times - self.times[:, :1]
            used = self.used[:, :, None] & self.used[:, None, :]
            root = np.linalg.cholesky(np.eye(since.shape[1]) + np.where(
                used, walk * np.minimum(since[:, :, None], since[:, None, :]), 0.0))
            self.whitening[walk] = np.where(used, np.linalg.inv(root), 0.0), 2.0 * float(
                np.log(np.diagonal(root, axis1=1, axis2=2)).sum())
        return self.whitening[walk]

    def _integrated(self, lag: float) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """Change of the speed along nose and left since the first of each piece's times, m/s, turn rate, rad/s, and the
        change of its square's integral, (w, t) each; and the derivatives of the first by what is the piece's own,
        (w, t, o)."""
        found = self.track.at(self.shown, self.times - lag)
        up = (self.used[..., None] * found[..., _UP]).sum(axis=1) / self.used.sum(axis=1)[:, None]
        down = -STANDARD_GRAVITY * (up / np.linalg.norm(up, axis=1)[:, None])[:, :, None]
        change = found - found[:, :1]
        nose, left = (change[..., pushed] + (change[..., turned] @ down)[..., 0]
                      for pushed, turned in ((0, _NOSE), (1, _LEFT)))
        since = (self.times - self.times[:, :1])[..., None]
        own = np.concatenate([np.ones_like(since), since, change[..., _NOSE], 0.5 * STANDARD_GRAVITY * since**2], -1)
        return (nose, left, found[..., _TURN], change[..., _SQUARED]), own


def _pieces(imu: ImuSamples, speeds: Speeds, rotation: np.ndarray) -> _Pieces | None:
    """The pieces of the drive in which there are samples and the speed changes; None with too few."""
    good = in_time_order(speeds.stamp, possible(speeds.speed))
    if len(good) < FEWEST_PIECES * _FEWEST or len(imu) < 100:
        return None
    origin = int(imu.stamp[0])
    time, speed = (speeds.stamp[good] - origin) * 1e-9, speeds.speed[good]
    some = slice(None, None, max(math.ceil(1.0 / (_DENSEST * float(np.median(np.diff(time)))) - 1e-6), 1))
    time, speed = time[some], speed[some]
    track = Track(imu, origin, find_standstill(imu))
    inertial = InertialIntegrals(imu, origin)
    columns = np.column_stack([inertial.velocity @ rotation.T, (inertial.rate - track.bias) @ rotation[2]])
    at = np.column_stack([np.interp(track.time, inertial.time, column) for column in columns.T])
    number = (time // _PIECE).astype(int)
    chosen = [piece for k in np.unique(number) if len(piece := np.flatnonzero(number == k)) >= _FEWEST
              and track.covers(time[piece[0]] - LARGEST - _STEP - _APART, time[piece[-1]] + LARGEST + _STEP + _APART)
              and np.ptp(speed[piece]) > _MOVED]
    if len(chosen) < FEWEST_PIECES:
        return None
    if len(chosen) > _MOST_PIECES:
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, _MOST_PIECES).astype(int)]
    places = np.array([np.pad(piece, (0, max(map(len, chosen)) - len(piece)), 'edge') for piece in chosen])
    used = np.arange(places.shape[1]) < np.array([len(piece) for piece in chosen])[:, None]
    shown = np.column_stack([at[:, :2], at[:, 3], integral(track.time, at[:, 3] ** 2), track.turned @ rotation[0],
                             track.turned @ rotation[1], track.rotation @ rotation[2]])
    return _Pieces(track, shown, time[places], speed[places], used, np.ones(len(chosen)))
