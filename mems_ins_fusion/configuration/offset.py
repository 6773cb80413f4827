"""Time offset between fixes and IMU, and lever arm of the antenna, estimated without a filter and without constraints.

The drive is divided into pieces. Within a piece the integrated angular rate gives the attitude, and the specific force,
integrated twice, the shape of the path. Position, velocity, attitude and gyroscope biases at the begin of each piece
are unknown. The differences between the fixes and that shape are linear in these unknowns and in those that all pieces
have in common: the time offset (along the velocity), the lever arm of the antenna (turns with the vehicle), the
smoothing of the receiver (along the acceleration, low-passed as by the receiver) and the accelerometers' biases.
All are estimated together, so each sigma is a marginal one: it is large where a drive cannot tell two of them apart.
White noise and lasting errors of the fixes, and noise of the sensors, are chosen by their likelihood. Each sigma is
this model's, corrected by the jackknife over the pieces as far as that tells (`regression.moderated`).
Equations: docs/configure.md, "Time offset and antenna".

Source: T. Lupton, S. Sukkarieh, "Visual-inertial-aided navigation for high-dynamic motion in built environments without
initial conditions", IEEE Trans. Robotics 28 (2012), for integrals that know nothing of where they begin.
"""
from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mems_ins_fusion.configuration.kinematics import fix_sigma
from mems_ins_fusion.configuration.regression import moderated, weighted
from mems_ins_fusion.configuration.track import Track, cross
from mems_ins_fusion.effects.gnss_outliers import far_off
from mems_ins_fusion.filter.runs.usable import usable_fixes
from mems_ins_fusion.recordings.motion import find_standstill, positions
from mems_ins_fusion.samples import Fixes, ImuSamples

#: s, largest offset of the search, positive or negative
LARGEST = 2.0
#: s: an offset with a larger standard deviation is not known
SHOWN = 0.3
#: s, lower limit of the standard deviation: delays by filters in the sensors, interpolation between samples
FLOOR = 0.01
#: s, step of the search, and largest change of the offset in one step of Gauss-Newton
_STEP = 0.2
#: steps of Gauss-Newton from the best of the search
_STEPS = 5
#: s, shortest piece of the drive
_SHORTEST = 15.0
#: s, longest piece: longer ones hardly tell more, as errors of consumer sensors grow
_LONGEST = 60.0
#: number of pieces of a short drive: fewer are not enough for a jackknife
_PIECES = 8
#: largest number of pieces: limits the computing time
_MOST_PIECES = 60
#: smallest number of pieces for an estimate
FEWEST_PIECES = 4
#: largest number of fixes of a piece: limits the computing time
_MOST_FIXES = 60
#: smallest number of fixes of a piece
_FEWEST_FIXES = 8
#: s, correlation time of the receiver's lasting errors
_LASTING = 20.0
#: s: offsets that differ from the best by more are other minima
_OTHER = 0.3
#: s, time constants of the receiver's smoothing from which the estimate starts
_SMOOTHING = (0.0, 0.5, 1.0, 2.0)
#: s^2, largest smoothing, as `gnss.lag_per_acceleration`: receivers smooth over at most three seconds
_MOST_SMOOTHING = 9.0
#: s^2, step of the numerical derivative by the smoothing
_SMOOTHING_STEP = 0.02
#: s^2, largest change of the smoothing in one step of Gauss-Newton
_LARGEST_CHANGE = 0.5
#: robust standard deviations beyond which a fix has less weight
_FAR = 3.0
#: prior standard deviations of the unknowns that all pieces have in common: offset (s), lever arm (m, three), smoothing
#: (s^2), biases of the accelerometers (m/s^2, three)
_SHARED = np.array([3.0, 1.5, 1.0, 1.0, 1.0, 0.2, 0.2, 0.2])
#: smallest share of the final information that has to come from the drive: with less, the result is mostly the prior
#: (_SHARED)
_LEAST_OWN = 0.1
#: rad, prior standard deviation of roll and pitch at the begin of a piece
_TILT = 0.05
#: rad, the same of the heading
_HEADING = 0.2
#: twice the log odds that the vehicle goes forwards in a piece, before anything is known. Chosen: in one of a hundred
#: it does not
_FORWARDS = 2.0 * math.log(99.0)
#: rad/s, the same of the gyroscopes' biases where they were measured at a standstill
_RATE_AT_REST = 3e-4
#: rad/s, the same without a standstill
_RATE = 1e-2
#: noise that is tried, as multiples of the variance of the fixes' white noise: of the accelerometers' white noise
#: (1/s^3), of the gyroscopes' white noise times gravity (1/s^5), and of the receiver's lasting errors, which may be
#: metres where the receiver smooths its white noise down to centimetres
_NOISE = tuple((force, 0.1 * force, lasting) for lasting in (0.0, 1.0, 10.0, 100.0, 1000.0)
               for force in (1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0, 1e2, 1e3))


@dataclass(frozen=True)
class Basis:
    """What the sigmas of an offset rest on. information: (8, 8), of the unknowns in common, with the prior, for a noise
    variance of 1. sigmas: (8,) of these. noise: one of _NOISE. fix_sigma: m, white noise of the fixes. own: (10,) prior
    information on a piece's own unknowns."""

    information: np.ndarray
    sigmas: np.ndarray
    noise: tuple[float, float, float]
    fix_sigma: float
    own: np.ndarray


@dataclass(frozen=True)
class Offset:
    """lag, lag_sigma: s, as `gnss.time_offset`. arm, arm_sigma: (3,) m, from the IMU to the antenna, forward-left-up.
    smoothing, smoothing_sigma: s^2, as `gnss.lag_per_acceleration`. rivals: s, other offsets that fit nearly as well.
    undecided: s, the part of lag_sigma that comes from other values of the smoothing that are about as likely.
    by_smoothing: for each of _SMOOTHING the lag that it leads to, s, and twice the negative log likelihood of it.
    basis: of one drive.
    """

    lag: float
    lag_sigma: float
    arm: np.ndarray
    arm_sigma: np.ndarray
    smoothing: float
    smoothing_sigma: float
    rivals: tuple[float, ...] = ()
    undecided: float = 0.0
    by_smoothing: tuple[tuple[float, float], ...] = ()
    basis: Basis | None = None

    @property
    def shown(self) -> bool:
        return self.lag_sigma < SHOWN

    def arm_alone(self) -> tuple[np.ndarray, np.ndarray]:
        """The arm and its sigma, (3,) m each, by this drive alone, to compare drives: without the prior, which makes
        `arm` smaller. Zero with an infinite sigma where the drive tells hardly more than the prior."""
        known = 1.0 / self.arm_sigma**2
        own = known - 1.0 / _SHARED[1:4]**2
        shown = own > _LEAST_OWN * known
        with np.errstate(divide='ignore'):
            own = np.where(shown, own, 0.0)
            return np.where(shown, self.arm * known / np.where(shown, own, 1.0), 0.0), 1.0 / np.sqrt(own)


def estimate_offset(imu: ImuSamples, fixes: Fixes, rotation: np.ndarray) -> Offset | None:
    """The time offset and the antenna's arm that `imu` (SI units) and `fixes` show; None with too little motion.

    rotation: (3, 3) from sensor axes to base_link, to about ten degrees. None for absurd values, too.
    """
    return attempted(_estimated, lambda: _pieces(imu, fixes, rotation))


def attempted(estimate: Callable, pieces_of: Callable):
    """`estimate` of the pieces of a drive, an object with lag and lag_sigma; None where there are no pieces, or where
    absurd values lead to numbers that are not finite."""
    with np.errstate(over='ignore', invalid='ignore', divide='ignore'):
        try:
            pieces = pieces_of()
            found = estimate(pieces) if pieces is not None else None
        except np.linalg.LinAlgError:
            return None
    return found if found is not None and math.isfinite(found.lag + found.lag_sigma) else None


def _estimated(pieces: _Pieces) -> Offset:
    lags = np.arange(-LARGEST, LARGEST + 0.01, _STEP)
    noise, lag = pieces.noise(0.0), 0.0
    for _ in range(2):
        costs = np.array([pieces.solved(lag, noise, free=False).cost for lag in lags])
        lag = float(lags[np.argmin(costs)])
        pieces = pieces.headed(lag, noise)
        noise = pieces.noise(lag)
    # in turns, smoothing and a time offset look alike: the likelihood decides between them
    starts = [_stepped(pieces.smoothed(tau**2), lag, noise) for tau in _SMOOTHING]
    noises = [start.noise(at) for start, at, _ in starts]
    unlikely = np.array([start.unlikely(at, its) for (start, at, _), its in zip(starts, noises)])
    best = int(np.argmin(unlikely))
    (pieces, lag, found), noise = starts[best], noises[best]
    by_smoothing = tuple((float(at), float(its)) for (_, at, _), its in zip(starts, unlikely))
    undecided = _undecided(np.array(by_smoothing), lag)
    for _ in range(_STEPS):
        pieces, lag, found = _stepped(pieces.weighted(found), lag, noise, 1)
    noise_variance = max(found.cost / found.freedom, 1e-12)
    sigma = moderated(found.left_out(), found.each[:, 1:, 1:], found.prior, noise_variance)
    # other minima count by their likelihood, tempered where the jackknife does not believe the model's noise
    temper = max(costs.min() / found.cost, 1e-12) * sigma[0] ** 2 / np.linalg.inv(found.normal)[0, 0]
    other = np.abs(lags - lag) > _OTHER
    likely = np.exp(-0.5 * (costs - costs.min()) / temper) * other
    share = likely / max(likely.sum() + np.exp(-0.5 * (costs - costs.min()) / temper)[~other].sum(), 1e-300)
    apart = float(np.sqrt(share @ (lags - lag) ** 2))
    rivals = tuple(round(float(at), 1) for at in lags[_minima(costs) & other & (share > 0.05)])
    return Offset(lag, math.hypot(float(sigma[0]), apart, undecided, FLOOR), found.solution[1:4], sigma[1:4],
                  pieces.smoothing, float(sigma[4]), rivals, undecided, by_smoothing,
                  Basis(found.normal, sigma, noise, pieces.sigma, pieces.own))


def _undecided(by_smoothing: np.ndarray, lag: float) -> float:
    """Root mean square difference, s, of the offsets of `Offset.by_smoothing` (k, 2) from `lag`, weighted by their
    likelihood."""
    lags, unlikely = by_smoothing.T
    weight = np.exp(-0.5 * (unlikely - unlikely.min()))
    return math.sqrt(weight @ (lags - lag) ** 2 / weight.sum())


def _stepped(pieces: _Pieces, lag: float, noise, steps: int = _STEPS) -> tuple[_Pieces, float, _Solved]:
    """Steps of Gauss-Newton for offset and smoothing, from `lag` and the smoothing of `pieces` on. Returns pieces with
    the new smoothing, the new offset, and the last solution."""
    for _ in range(steps):
        found = pieces.solved(lag, noise)
        lag += float(np.clip(found.solution[0], -_STEP, _STEP))
        change = float(np.clip(found.solution[4], -_LARGEST_CHANGE, _LARGEST_CHANGE))
        pieces = pieces.smoothed(pieces.smoothing + change)
    return pieces, lag, found


def with_more(offset: Offset, imu: ImuSamples, fixes: Fixes, since: int) -> tuple[float, np.ndarray]:
    """The sigmas of `offset` of one drive, of lag (s) and arm (3,) m, if it went on as `imu` and `fixes` do from
    `since` (ns) on.

    imu, fixes: of a simulated drive, sensors in axes of base_link without errors; they count with the noise that the
    drive of `offset` has. What is no matter of samples (FLOOR, other minima) stays.
    """
    basis, pieces = offset.basis, _pieces(imu, fixes, np.eye(3))
    if pieces is None:
        return offset.lag_sigma, offset.arm_sigma
    pieces = replace(pieces, sigma=basis.fix_sigma, own=basis.own).smoothed(offset.smoothing)
    each = pieces._reduced(pieces._design(0.0), pieces._whitening(basis.noise)[0])[0][:, 1:, 1:]
    middle = (pieces.time * pieces.used).sum(axis=1) / pieces.used.sum(axis=1)
    later = each[middle >= (since - int(usable_fixes(fixes).stamp[0])) * 1e-9].sum(axis=0)
    left = np.diag(np.linalg.inv(basis.information + later)) / np.diag(np.linalg.inv(basis.information))
    lessened = basis.sigmas**2 * (1.0 - left)
    return math.sqrt(offset.lag_sigma**2 - lessened[0]), np.sqrt(offset.arm_sigma**2 - lessened[1:4])


def together(found: Sequence[Offset]) -> Offset | None:
    """One offset and arm of several drives; None of none."""
    if len(found) < 2:
        return found[0] if found else None
    parts = {}
    for name in ('lag', 'arm', 'smoothing'):
        values, sigmas = (np.array([getattr(offset, part) for offset in found]) for part in (name, f'{name}_sigma'))
        parts[name], parts[f'{name}_sigma'] = weighted(values, sigmas)
    # one receiver: what one drive cannot tell the others may
    lags, unlikely = np.moveaxis([offset.by_smoothing for offset in found], -1, 0)
    joint, _ = weighted(lags, np.array([[offset.lag_sigma] for offset in found]))
    by_smoothing = tuple(zip(joint.tolist(), unlikely.sum(axis=0).tolist()))
    return Offset(**parts, undecided=_undecided(np.array(by_smoothing), parts['lag']), by_smoothing=by_smoothing)


def _told(normal: np.ndarray, prior: np.ndarray) -> float:
    """Number of unknowns of the normal equations (k, k) that the data tell and not the prior (k,): the trace of the
    data's share of the information."""
    return len(prior) - float(prior @ np.diag(np.linalg.inv(normal)))


def _minima(costs):
    padded = np.concatenate([[np.inf], costs, [np.inf]])
    return (costs <= padded[:-2]) & (costs <= padded[2:])


@dataclass(frozen=True)
class _Solved:
    """Least squares of all pieces. solution: the unknowns in common, first the change of the offset. cost: weighted sum
    of squares. each: (w, k, k), normal equations of [values, unknowns in common] of each piece, with its own unknowns
    eliminated. prior, known: information by the prior, and by how much the present values differ from its mean.
    freedom: number of coordinates of the fixes less that of the unknowns, each as far as the fixes tell it.
    residual: (w, m, 2), north and west. Both where the offset is free."""

    solution: np.ndarray
    cost: float
    normal: np.ndarray
    each: np.ndarray
    prior: np.ndarray
    known: np.ndarray
    freedom: float = math.inf
    residual: np.ndarray | None = None

    def left_out(self) -> np.ndarray:
        """(w, s) solutions, each without one piece."""
        rest = self.each.sum(axis=0) - self.each
        right = rest[:, 1:, :1] - (self.prior * self.known)[:, None]
        return np.linalg.solve(rest[:, 1:, 1:] + np.diag(self.prior), right)[..., 0]


@dataclass(frozen=True)
class _Pieces:
    """The pieces of a drive, `w` of up to `m` fixes.

    time: (w, m) s. place: (w, m, 2) m, north and west. used: (w, m) bool, which are fixes and not padding. weight:
    (w, m). lasting: (3, w, m, m) covariances of the integrated sensor noises and of lasting errors, for a variance of
    1. own: (10,) prior information on the unknowns of each piece: position, velocity, attitude, rate. smoothing: s^2,
    of the receiver; behind: (n, 3) m, by how much its fixes lag with this smoothing; by_smoothing: the derivative of
    that, m/s^2. forwards: (w,) 1 where the vehicle goes forwards, -1 backwards. roots: results of `_whitening` by
    noise, kept as they take most of the time and each noise is tried with several offsets and smoothings.
    """

    track: Track
    rotation: np.ndarray
    sigma: float
    time: np.ndarray
    place: np.ndarray
    used: np.ndarray
    weight: np.ndarray
    lasting: np.ndarray
    own: np.ndarray
    smoothing: float
    behind: np.ndarray
    by_smoothing: np.ndarray
    forwards: np.ndarray
    roots: dict = field(default_factory=dict)

    @property
    def freedom(self) -> int:
        return max(int(2 * self.used.sum() - 4 * len(self.used)), 1)

    def weighted(self, found: _Solved) -> _Pieces:
        """The same pieces with less weight on fixes with large residuals."""
        size = np.linalg.norm(found.residual, axis=-1)
        typical = np.median(size[self.used]) / 1.18  # of a two-dimensional normal distribution
        weight = self.used * np.minimum(1.0, _FAR * typical / np.maximum(size, 1e-9)) ** 2
        return replace(self, weight=weight, roots={})

    def smoothed(self, smoothing: float) -> _Pieces:
        """The same pieces for a receiver with this smoothing, s^2; negative counts as zero."""
        at = min(max(smoothing, 0.0), _MOST_SMOOTHING)
        around = max(at - _SMOOTHING_STEP, 0.0), at, at + _SMOOTHING_STEP
        low, middle, high = (one * self.track.smoothed(math.sqrt(one)) for one in around)
        change = (high - low) / (around[2] - around[0])
        return replace(self, smoothing=smoothing, by_smoothing=change, behind=middle + (smoothing - at) * change)

    def headed(self, lag: float, noise) -> _Pieces:
        """The same pieces, each headed as is more likely by itself, with all unknowns and the size of the noise free: a
        vehicle that goes backwards in one piece would make the noise of all of them."""
        freedom = np.maximum(2.0 * self.used.sum(axis=1) - 4.0, 1.0)

        def unlikely(pieces):
            each = pieces._reduced(pieces._design(lag), pieces._whitening(noise)[0])[0]
            right, normal = each[:, 1:, :1], each[:, 1:, 1:] + np.diag(_SHARED**-2.0)
            cost = each[:, 0, 0] - (right * np.linalg.solve(normal, right)).sum(axis=(1, 2))
            return freedom * np.log(np.maximum(cost, 1e-300)) - 0.5 * _FORWARDS * pieces.forwards
        other = replace(self, forwards=-self.forwards)
        return replace(self, forwards=np.where(unlikely(other) < unlikely(self), other.forwards, self.forwards))

    def noise(self, lag: float) -> tuple[float, float, float]:
        """The most likely noise for that offset."""
        design = self._design(lag)
        return min(_NOISE, key=lambda noise: self._unlikely(design, noise))

    def unlikely(self, lag: float, noise) -> float:
        """Minus twice the log likelihood of that offset, up to a constant."""
        return self._unlikely(self._design(lag), noise)

    def _unlikely(self, design, noise) -> float:
        roots, logarithm = self._whitening(noise)
        each, _, own = self._reduced(design, roots)
        cost = self._together(each, free=False)[1]
        more = float(np.linalg.slogdet(own)[1].sum())
        return self.freedom * math.log(max(cost, 1e-300) / self.freedom) + logarithm + more

    def solved(self, lag: float, noise, free: bool = True) -> _Solved:
        """Least squares about `lag`. free: whether the offset is a change of it, too; else it is exact."""
        design = self._design(lag)
        roots, _ = self._whitening(noise)
        each, back, normal_own = self._reduced(design, roots)
        solution, cost, normal, prior, known = self._together(each, free)
        if not free:
            return _Solved(solution, cost, normal, each, prior, known)
        values, shared, own = design
        left = values - shared @ solution
        residual = left - np.einsum('wmik,wk->wmi', own, back @ np.concatenate([[1.0], -solution]))
        told = _told(normal, prior) + sum(_told(one, self.own) for one in normal_own)
        return _Solved(solution, cost, normal, each, prior, known, max(2.0 * self.used.sum() - told, 1.0), residual)

    def _together(self, each, free):
        total, first = each.sum(axis=0), 0 if free else 1
        # priors are in metres and seconds, the rest in sigmas of a fix as it turns out
        scale = max(float(total[0, 0]) / (2.0 * self.used.sum()), 1e-9)
        prior = scale / _SHARED**2
        known = np.zeros(len(_SHARED))
        known[4] = self.smoothing  # the others begin at what is expected, and the offset anywhere
        normal, right = (total[1:, 1:] + np.diag(prior))[first:, first:], (total[1:, 0] - prior * known)[first:]
        solution = np.linalg.solve(normal, right)
        return solution, float(total[0, 0] + prior @ known**2 - right @ solution), normal, prior, known

    def _whitening(self, noise):
        """(w, m, m) inverses of the roots of the fixes' covariances, and the logarithm of their determinants."""
        if noise not in self.roots:
            self.roots[noise] = self._inverse_roots(noise)
        return self.roots[noise]

    def _inverse_roots(self, noise):
        covariance = self.sigma**2 * np.einsum('k,kwij->wij', noise, self.lasting)
        covariance *= self.used[:, :, None] & self.used[:, None, :]
        diagonal = np.arange(self.time.shape[1])
        covariance[:, diagonal, diagonal] += np.where(self.used, self.sigma**2 / np.maximum(self.weight, 1e-3), 1.0)
        root = np.linalg.cholesky(covariance)
        size = np.where(self.used, root[:, diagonal, diagonal], 1.0)
        return np.linalg.inv(root), 4.0 * float(np.log(size).sum())

    def _reduced(self, design, roots):
        """(w, s, s) products of [values, shared] with a piece's own unknowns free, what these are of each, and the
        normal equations of these."""
        values, shared, own = design
        columns = np.concatenate([values[..., None], shared, own], axis=-1) * self.used[..., None, None]
        count = columns.shape[-1]
        white = (roots[:, None] @ columns.transpose(0, 2, 1, 3)).reshape(len(columns), -1, count)
        products = white.transpose(0, 2, 1) @ white
        first = 1 + shared.shape[-1]
        normal = products[:, first:, first:] + np.diag(self.own)
        back = np.linalg.solve(normal, products[:, first:, :first])
        each = products[:, :first, :first] - products[:, :first, first:] @ back
        return each, back, normal

    def _design(self, lag: float):
        """Differences between fixes and shape, (w, m, 2), and their derivatives by the unknowns in common and by those
        of each piece."""
        track, times, weight = self.track, self.time - lag, self.used[..., None]
        rotation = track.at(track.rotation, times)
        level = self._attitude(rotation)
        mean = (self.time * self.used).sum(axis=1) / self.used.sum(axis=1)
        since = (self.time - mean[:, None]) * self.used
        line = np.stack([np.ones_like(since), since], axis=-1) * weight
        inverse = np.linalg.pinv(line)

        def shape(values, horizontal=True):
            """In the frame of the earth, without a straight line over time: the unknown position and velocity."""
            flat = values.reshape(*values.shape[:2], -1) * weight
            left = (flat - line @ (inverse @ flat)).reshape(values.shape)
            turned = np.einsum('wij,wmj...->wmi...', level, left)
            return turned[:, :, :2] if horizontal else turned

        place, turned = track.at(track.place, times), track.at(track.turned, mean - lag)
        way = shape(place, horizontal=False)
        arm = np.einsum('wij,wmjk,lk->wmil', level, rotation, self.rotation)[:, :, :2]
        shared = np.concatenate([
            -np.einsum('wij,wmj->wmi', level, track.at(track.velocity, times))[:, :, :2, None], arm,
            -np.einsum('wij,wmj->wmi', level, track.at(self.by_smoothing, times))[:, :, :2, None],
            -shape(track.at(track.by_force, times))], axis=-1)
        own = np.zeros((*self.place.shape, len(self.own)))
        own[:, :, 0, 0] = own[:, :, 1, 1] = 1.0
        own[:, :, 0, 2] = own[:, :, 1, 3] = since
        own[..., 4:7] = -cross(way)[:, :, :2]
        own[..., 7:] = shape(track.at(track.by_rate, times) + cross(place) @ turned[:, None])
        behind = np.einsum('wij,wmj->wmi', level, track.at(self.behind, times))
        return self.place - (way - behind)[:, :, :2], shared, own

    def _attitude(self, rotation):
        """(w, 3, 3) from the frame of the gyroscopes to north-west-up in each piece: level on average, and headed so
        that the vehicle goes where it points, or backwards."""
        used = self.used[..., None]
        up = ((rotation @ self.rotation[2]) * used).sum(axis=1)
        up /= np.linalg.norm(up, axis=1)[:, None]
        forward = rotation @ self.rotation[0]
        forward = forward[:, 1:] + forward[:, :-1]
        some = np.where(np.abs(up[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
        first = np.cross(some, up)
        first /= np.linalg.norm(first, axis=1)[:, None]
        second = np.cross(up, first)
        step = np.diff(self.place, axis=1) * used[:, 1:]
        pointing = np.einsum('wmj,wj->wm', forward, first) + 1j * np.einsum('wmj,wj->wm', forward, second)
        gone = ((step[..., 0] + 1j * step[..., 1]) * pointing.conj() / np.maximum(np.abs(pointing), 1e-9)).sum(axis=1)
        direction = self.forwards * gone / np.maximum(np.abs(gone), 1e-9)
        cosine, sine = direction.real[:, None], direction.imag[:, None]
        return np.stack([cosine * first - sine * second, sine * first + cosine * second, up], axis=1)


def _pieces(imu: ImuSamples, fixes: Fixes, rotation) -> _Pieces | None:
    """The pieces of the drive in which there are samples and the vehicle moves; None with too few."""
    fixes = usable_fixes(fixes)
    if len(fixes) < FEWEST_PIECES * _FEWEST_FIXES or len(imu) < 100:
        return None
    off = np.zeros(len(fixes), dtype=bool)
    off[far_off(fixes)[0]] = True
    fixes = fixes.select(~off)
    if len(fixes) < FEWEST_PIECES * _FEWEST_FIXES:
        return None
    place = positions(fixes) * [1.0, -1.0]
    sigma, time = fix_sigma(fixes, place), (fixes.stamp - fixes.stamp[0]) * 1e-9
    still = find_standstill(imu, fixes)
    still &= np.isfinite(imu.angular_rate).all(axis=1)
    track = Track(imu, int(fixes.stamp[0]), still)
    length = float(np.clip(time[-1] / _PIECES, _SHORTEST, _LONGEST))
    chosen = [piece for begin, end in track.stretches + [[LARGEST + _STEP, -LARGEST - _STEP]]
              for piece in _divided(np.flatnonzero((time >= begin) & (time <= end)), time, length)
              if len(piece) >= _FEWEST_FIXES and np.ptp(place[piece], axis=0).max() > 5.0 * sigma]
    if len(chosen) < FEWEST_PIECES:
        return None
    if len(chosen) > _MOST_PIECES:
        chosen = [chosen[i] for i in np.linspace(0, len(chosen) - 1, _MOST_PIECES).astype(int)]
    most = max(len(piece) for piece in chosen)
    used = np.array([np.arange(most) < len(piece) for piece in chosen])
    at = np.array([np.append(piece, np.full(most - len(piece), piece[-1])) for piece in chosen])
    times = time[at]
    since = times - times[:, :1]
    low, high = np.minimum(since[:, :, None], since[:, None]), np.maximum(since[:, :, None], since[:, None])
    # covariances of white noise integrated twice, and three times; of a first-order Gauss-Markov process
    lasting = np.stack([low**2 * (3.0 * high - low) / 6.0,
                        low**3 * (10.0 * high**2 - 5.0 * low * high + low**2) / 120.0,
                        np.exp((low - high) / _LASTING)])
    rate = _RATE_AT_REST if still.any() else _RATE
    own = np.concatenate([np.full(4, 1e-12), np.array([_TILT, _TILT, _HEADING]) ** -2.0, np.full(3, rate**-2.0)])
    return _Pieces(track, rotation, sigma, times, place[at], used, used.astype(float), lasting, own, 0.0,
                   np.zeros_like(track.force), track.force, np.ones(len(chosen)))


def _divided(stretch: np.ndarray, time: np.ndarray, length: float) -> list[np.ndarray]:
    """Indices of the fixes of a `stretch`, in pieces of about `length` s, alike; of more than _MOST_FIXES every second,
    third ... is taken."""
    if len(stretch) < _FEWEST_FIXES:
        return []
    since = time[stretch] - time[stretch[0]]
    count = max(round(since[-1] / length), 1)
    number = np.minimum(since / since[-1] * count, count - 1).astype(int)
    pieces = [stretch[number == k] for k in range(count)]
    return [piece[::-(-len(piece) // _MOST_FIXES)] for piece in pieces if len(piece)]
