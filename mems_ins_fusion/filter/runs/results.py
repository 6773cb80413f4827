"""Results of a replay: states, innovations and verdicts as arrays."""
from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation.strapdown import to_euler
from ..config import FilterConfig
from ..memory import NAV, Error, Event, Kind, Nav, StateLayout, Verdict, covariance_index
from ..start.start import Start
from ..trust.hypotheses import Hypothesis
from ..trust.lag import Lag
from .intake import Notice
from .odometry import added_covariance, estimated, navigation_solution

#: columns kept in addition to solution and covariance: to convert angles to metres and P to the published covariance,
#: and the lag of a receiver that smooths
_SCALES = (Nav.NORTH_SCALE, Nav.EAST_SCALE, Nav.VARIANCE_FACTOR, Nav.LASTING, Nav.ARM_VARIANCE, Nav.FIX_TIME,
           *range(Hypothesis.SPREAD, Hypothesis.SPREAD + 4), Hypothesis.SPREAD_VARIANCE, Lag.UNFOLLOWED,
           Lag.UNFOLLOWED + 1)


@dataclass(frozen=True)
class Innovations:
    """Innovations of the fixes that were used, in the order of their times.

    index (f,): index in the `Fixes` given. stamp (f,): ns, at which the fix describes the vehicle. z (f, 2):
    innovation north, east, m, predicted minus measured antenna position. s (f, 3): its covariance nn, ne, ee. nis
    (f,): normalized innovation squared, 2 degrees of freedom. z_down, s_down (f,): the same for height (strapdown).
    yaw (f,), velocity (f, 2): predicted. weight (f,): factor on the inverse covariance, 1 unless weighted down.
    """

    index: np.ndarray
    stamp: np.ndarray
    z: np.ndarray
    s: np.ndarray
    nis: np.ndarray
    z_down: np.ndarray
    s_down: np.ndarray
    yaw: np.ndarray
    velocity: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class MeasurementLog:
    """Every measurement that the kernel has processed: kind (k,), number of its input; index (k,) among the samples of
    that; stamp (k,) ns; event (k, Event.SIZE)."""

    kind: np.ndarray
    index: np.ndarray
    stamp: np.ndarray
    event: np.ndarray

    def select(self, index) -> MeasurementLog:
        return MeasurementLog(*(getattr(self, f.name)[index] for f in fields(self)))

    def verdicts(self, kind: int) -> dict[int, int]:
        """How many measurements of `kind` had each verdict (of `Verdict`)."""
        values, counts = np.unique(self.event[self.kind == kind, Event.VERDICT].astype(int), return_counts=True)
        return dict(zip(values.tolist(), counts.tolist()))


@dataclass(frozen=True)
class Run:
    """One recording through the filter: its state after each IMU sample that was to be kept.

    stamp (k,) ns. index (k,): index in the `ImuSamples` given. latitude, longitude (k,) rad, height (k,) m, velocity
    (k, 3) m/s in `n`, roll, pitch, yaw (k,) rad. sensor_errors (k, channels): estimates. sigma (k, n): square roots of
    the covariance's diagonal, in the order of `config.layout.names`. extras (k, e): the optional states. covariance_ne
    (k,): of north and east position error, m^2. behind (k, 2): m north and east, by how much the receiver's smoothed
    position lags (gnss.lag_per_acceleration). memory: the kernel's memory at the end. filter_seconds: CPU time of the
    filter alone.
    """

    config: FilterConfig
    stamp: np.ndarray
    index: np.ndarray
    latitude: np.ndarray
    longitude: np.ndarray
    height: np.ndarray
    velocity: np.ndarray
    roll: np.ndarray
    pitch: np.ndarray
    yaw: np.ndarray
    sensor_errors: np.ndarray
    sigma: np.ndarray
    extras: np.ndarray
    covariance_ne: np.ndarray
    behind: np.ndarray
    innovations: Innovations
    measured: MeasurementLog
    start: Start | None
    notices: list[Notice]
    memory: np.ndarray | None
    filter_seconds: float

    def states(self, index) -> Run:
        """The run at some of its states; index: a slice or indices."""
        names = ('stamp', 'index', 'latitude', 'longitude', 'height', 'velocity', 'roll', 'pitch', 'yaw',
                 'sensor_errors', 'sigma', 'extras', 'covariance_ne', 'behind')
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return Run(**{**values, **{name: values[name][index] for name in names}})


def columns(layout: StateLayout) -> np.ndarray:
    """Columns of a row that a replay keeps: navigation solution, _SCALES, x, diagonal and north-east element of the
    covariance."""
    pairs = [(i, i) for i in range(layout.n)] + [(0, 1)]
    kept = [*range(Nav.RADII_LATITUDE), *_SCALES, *range(NAV, NAV + layout.n)]
    kept += [covariance_index(i, j, layout) for i, j in pairs]
    return np.array(kept, dtype=np.uint64)  # unsigned: the kernel need not look for negative ones


def result(config: FilterConfig, stamp, index, states, measured: MeasurementLog, **more) -> Run:
    """A `Run` from the columns `states` (k, c) of the states at the samples `index` (k,) with `stamp` (k,)."""
    layout = config.layout
    rows = np.zeros((len(states), NAV + layout.n))
    kept = columns(layout)[:Nav.RADII_LATITUDE + len(_SCALES) + layout.n].astype(np.int64)
    rows[:, kept] = states[:, :len(kept)]
    solution = _solution(rows, np.array(layout.rows, dtype=float), config.open_loop)
    x = rows[:, NAV:]
    first, p = layout.n_navigation, layout.order
    at = len(kept)
    variances = states[:, at:at + layout.n + 1] * np.maximum(rows[:, Nav.VARIANCE_FACTOR], 1.0)[:, None]
    _widen(variances, layout.index('v_n'), rows)
    return Run(config=config, stamp=stamp, index=index, latitude=solution[:, 0], longitude=solution[:, 1],
               height=solution[:, 2], velocity=solution[:, 3:6], roll=solution[:, 6], pitch=solution[:, 7],
               yaw=solution[:, 8], sensor_errors=x[:, first:first + layout.n_sensor:p],
               sigma=np.sqrt(variances[:, :-1]), extras=x[:, first + layout.n_sensor:],
               covariance_ne=variances[:, -1],
               behind=config.gnss.lag_gain * rows[:, [Lag.UNFOLLOWED, Lag.UNFOLLOWED + 1]],
               innovations=_innovations(measured), measured=measured, **more)


@njit
def _solution(states, rows, open_loop):
    """Latitude, longitude, height, v_n, v_e, v_d, roll, pitch, yaw of each state. rows (9,): `StateLayout.rows`."""
    out = np.empty((len(states), 9))
    for k in range(len(states)):
        (out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4], out[k, 5],
         q) = navigation_solution(states[k], 0, rows, open_loop)
        if rows[Error.PHI_N] < 0:
            out[k, 6] = out[k, 7] = 0.0
            out[k, 8] = states[k, Nav.YAW] - (estimated(states[k], 0, rows, Error.PHI_D) if open_loop else 0.0)
        else:
            out[k, 6], out[k, 7], out[k, 8] = to_euler(q)
    return out


@njit
def _widen(variances, velocity, rows):
    """Add the terms of `odometry.add_to_covariance` to the variances and the covariance of r_n and r_e, in place.
    velocity: index of v_n."""
    where = (0, 1, velocity, velocity + 1)
    for k in range(len(rows)):
        for i in range(4):
            variances[k, where[i]] += added_covariance(rows[k], 0, i, i)
        variances[k, -1] += added_covariance(rows[k], 0, 0, 1)


def _innovations(measured: MeasurementLog) -> Innovations:
    """Innovations of the fixes that were used, in the order of their times."""
    used = np.isin(measured.event[:, Event.VERDICT], (Verdict.USED, Verdict.WEIGHTED, Verdict.RECOVERED))
    fixes = measured.select((measured.kind == Kind.POSITION) & used)
    fixes = fixes.select(np.argsort(fixes.stamp, kind='stable'))
    r = fixes.event
    return Innovations(index=fixes.index, stamp=fixes.stamp, z=r[:, [Event.Z_N, Event.Z_E]],
                       s=r[:, [Event.S_NN, Event.S_NE, Event.S_EE]], nis=r[:, Event.NIS], z_down=r[:, Event.Z_D],
                       s_down=r[:, Event.S_DD], yaw=r[:, Event.YAW], velocity=r[:, [Event.V_N, Event.V_E]],
                       weight=r[:, Event.WEIGHT])
