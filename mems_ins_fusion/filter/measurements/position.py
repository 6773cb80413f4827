"""GNSS fix: position of the antenna (Eq. 19), innovation in metres north, east and down."""
from __future__ import annotations

import math

import numpy as np
from numba.extending import register_jitable

from mems_ins_fusion.compiled import njit

from ...navigation.earth import radii
from ...parameters.parameter import Parameter
from ...samples import Fixes
from ..memory import Error, Event, Head, Kind, Nav, row_of
from ..trust.lag import behind
from . import fix_quality
from .base import NAV_SAT_FIX, Measurement
from .events import refuse
from .geometry import add, add_attitude_error, arm_of, rotate
from .time_offset import add_time_offset

SMALLEST_SIGMA = 0.001  # m, lower limit of the standard deviation of a fix, whatever the message states
LOWEST_HEIGHT = -1000.0  # m above the ellipsoid, smallest height of a land vehicle
HIGHEST_HEIGHT = 10000.0  # m above the ellipsoid, and its largest
#: m, standard deviation of the height, 0, of a fix without altitude: so large that 10 Hz for an hour leave 500 m
NO_ALTITUDE_SIGMA = 1e5


@njit(_nrt=False)
def _antenna_minus_fix(mem, r, at, north, east, down):
    """Predicted minus measured position of the antenna: north, east, down, m.

    north, east, down: m, from the IMU to the antenna. at: position of the event with the measured position.
    """
    return ((mem[r + Nav.LATITUDE] - mem[at + Event.LATITUDE]) / mem[r + Nav.NORTH_SCALE] + north,
            (mem[r + Nav.LONGITUDE] - mem[at + Event.LONGITUDE]) / mem[r + Nav.EAST_SCALE] + east,
            mem[at + Event.HEIGHT] - mem[r + Nav.HEIGHT] + down)


@njit(_nrt=False)
def difference(mem, r, at, c):
    """Predicted minus measured position of the antenna, north, east and down, m; c: rotation from b to n."""
    north, east, down = rotate(c, mem[Head.LEVER_X], mem[Head.LEVER_Y], mem[Head.LEVER_Z])
    return _antenna_minus_fix(mem, r, at, north - behind(mem, r, 0), east - behind(mem, r, 1), down - behind(mem, r, 2))


@njit(_nrt=False)
def observe(mem, r, at, h, n, c):
    """A fix of the main receiver. Returns the number of components: the planar filter has no height."""
    mem[at + Event.Z_N], mem[at + Event.Z_E], mem[at + Event.Z_D] = difference(mem, r, at, c)
    north, east, down = rotate(c, mem[Head.LEVER_X], mem[Head.LEVER_Y], mem[Head.LEVER_Z])
    add_attitude_error(mem, h, n, north, east, down)
    for k in range(3):
        add(mem, h + n * k, Error.R_N + k, 1.0)
    coloured = int(mem[Head.COLOURED])
    if coloured >= 0:
        mem[h + coloured] = mem[h + n + coloured + 1] = -1.0
    for k in range(3):
        add_time_offset(mem, at, h + n * k, mem[r + Nav.V_N + k])
    return 3 if row_of(mem, Error.R_D) >= 0 else 2


@njit(_nrt=False)
def observe_place(mem, r, at, h, n, c, sample):
    """A fix of a further receiver. Returns the number of components.

    The states for coloured noise, smoothing and clock belong to the main receiver. Two optional states are the error of
    this receiver's lever arm, forward and right.
    """
    x, y, z = arm_of(mem, at)
    north, east, down = rotate(c, x, y, z)
    mem[at + Event.Z_N], mem[at + Event.Z_E], mem[at + Event.Z_D] = _antenna_minus_fix(mem, r, at, north, east, down)
    add_attitude_error(mem, h, n, north, east, down)
    arm = int(mem[at + Event.STATE])
    for k in range(3):
        add(mem, h + n * k, Error.R_N + k, 1.0)
        add_time_offset(mem, at, h + n * k, mem[r + Nav.V_N + k])
        if arm >= 0:
            mem[h + n * k + arm], mem[h + n * k + arm + 1] = -c[3 * k], -c[3 * k + 1]
    return 3 if row_of(mem, Error.R_D) >= 0 else 2


def without_altitude(height: np.ndarray, covariance: np.ndarray) -> None:
    """Where `NavSatFix` has no altitude (NaN, by its definition): height 0, NO_ALTITUDE_SIGMA, in place.

    height (n,) m. covariance (n, 3, 3) m^2.
    """
    missing = np.isnan(height)
    height[missing] = 0.0
    covariance[missing, 2, :] = covariance[missing, :, 2] = 0.0
    covariance[missing, 2, 2] = NO_ALTITUDE_SIGMA**2


@register_jitable
def is_without_altitude(variance):
    """Whether a fix with this variance of its height, m^2, has no altitude. Of numbers or of arrays."""
    return variance >= NO_ALTITUDE_SIGMA**2


def has_altitude(fixes) -> np.ndarray:
    """(n,) which of `fixes` came with an altitude."""
    return ~is_without_altitude(fixes.covariance[:, 2, 2])


@register_jitable
def is_place(latitude, longitude, height):
    """Whether a land vehicle can be at a position, rad and m; false for NaN. Of numbers or of arrays."""
    return ((abs(latitude) <= math.pi / 2) & (abs(longitude) <= 2 * math.pi) & (height >= LOWEST_HEIGHT)
            & (height <= HIGHEST_HEIGHT))


@register_jitable
def _is_position(latitude, longitude, height, status):
    """Whether a fix has a position; receivers without one send latitude 0, longitude 0. Of numbers or of arrays."""
    return is_place(latitude, longitude, height) & ((latitude != 0) | (longitude != 0)) & (status >= 0)


def is_fix(fixes) -> np.ndarray:
    """(n,) which of `fixes` have a position."""
    return _is_position(fixes.latitude, fixes.longitude, fixes.height, fixes.status)


@njit(_nrt=False)
def _write(events, kind, latitude, longitude, height, status, covariance, kinds, sigma, default_sigma, usable, stated):
    """Write fixes to their events, which are zero. Returns whether any of them has no position or no covariance.

    kind: of the events. covariance (n, 3, 3), kinds (n,): covariances in the messages, and their types. sigma,
    default_sigma: parameters, m. usable (n,), output: whether each fix has a position. stated (n,), output: whether its
    covariance is valid.
    """
    smallest, default, say = SMALLEST_SIGMA**2, default_sigma**2, False
    for i in range(len(events)):
        r, ee, en = events[i], covariance[i, 0, 0], covariance[i, 0, 1]
        nn, uu = covariance[i, 1, 1], covariance[i, 2, 2]
        r[Event.KIND], r[Event.STATUS] = kind, status[i]
        r[Event.LATITUDE], r[Event.LONGITUDE], r[Event.HEIGHT] = latitude[i], longitude[i], height[i]
        usable[i] = _is_position(r[Event.LATITUDE], r[Event.LONGITUDE], r[Event.HEIGHT], r[Event.STATUS])
        stated[i] = (math.isfinite(ee) and math.isfinite(en) and math.isfinite(nn) and math.isfinite(uu)
                     and min(ee, nn) > 0.0 and nn * ee > en * en and kinds[i] != 0)
        say = say or not (usable[i] and stated[i])
        r[Event.R_NN], r[Event.R_NE], r[Event.R_EE], r[Event.R_DD] = default, 0.0, default, 4.0 * default
        if stated[i]:
            r[Event.R_NN], r[Event.R_NE], r[Event.R_EE] = max(nn, smallest), en, max(ee, smallest)
            r[Event.R_DD] = max(uu, smallest) if uu > 0.0 else 4.0 * max(nn, ee, smallest)
        if sigma > 0.0:
            r[Event.R_NN], r[Event.R_NE], r[Event.R_EE] = sigma**2, 0.0, sigma**2
            r[Event.R_DD] = max(r[Event.R_DD], sigma**2)
        if is_without_altitude(uu):
            r[Event.R_DD] = uu
    return say


def _reason(latitude: float, longitude: float, height: float, status: float) -> str:
    """Why a fix has no position (`_is_position`), in words."""
    degrees = math.degrees(latitude), math.degrees(longitude)
    if status < 0:
        return 'no fix, by its status'
    if not (math.isfinite(latitude) and math.isfinite(longitude) and math.isfinite(height)):
        return f'latitude, longitude, altitude {degrees[0]}, {degrees[1]}, {height}: fix dropped'
    if not is_place(latitude, longitude, 0.0):
        return f'latitude {degrees[0]:.9g}, longitude {degrees[1]:.9g} deg is not on earth: fix dropped'
    if not is_place(latitude, longitude, height):
        return f'altitude {height:g} m is outside {LOWEST_HEIGHT:g} to {HIGHEST_HEIGHT:g} m: fix dropped'
    return 'latitude 0, longitude 0 is what receivers send without a fix: fix dropped'


class Fix(Measurement):
    """Fixes. The unnamed input is the main receiver, from which the filter starts and restarts (`GnssSettings`). A
    named input is a further receiver, and treated like any other measurement."""

    kind, name, samples, unit, default_sigma = Kind.POSITION, 'fix', Fixes, 'm', 3.0
    topic_text = ('Topic of the position of an antenna: sensor_msgs/NavSatFix, or, where they are installed, '
                  'gps_msgs/GPSFix, septentrio_gnss_driver/PVTGeodetic, ublox_msgs/NavPVT')
    components = 2
    messages = {NAV_SAT_FIX: ('status.status', 'latitude', 'longitude', 'altitude', 'position_covariance',
                              'position_covariance_type'), **fix_quality.FIELDS}
    written_to = '/gps/fix'
    of_antenna = from_satellites = has_arm = True
    #: m, white noise north and east; 1.5 times that down
    simulated_with = {'fix_rate': 0.0, 'fix_sigma': 1.5}

    def named_parameters(self):
        return (*super().named_parameters(), Parameter(
            f'{self.name}.lever_arm_sigma', 0.02, 'm', 'Standard deviation of the lever arm forward and left, whose '
            'error is estimated; the default is that of a tape measure. 0: it is exact, and so is the heading from two '
            'receivers.', minimum=0.0, maximum=10.0))

    @property
    def state(self):
        return '' if self.is_plain else f'{self.name}_arm'

    @property
    def time_offset_state(self):
        return 'time_offset' if self.is_plain else super().time_offset_state

    def states(self, values):
        sigma = 0.0 if self.is_plain else values[f'{self.name}.lever_arm_sigma']
        return {self.state: (sigma, 0.0), f'{self.state}_right': (sigma, 0.0)}

    def off(self, measured, innovation):
        return f'fix {math.hypot(*innovation):.1f} m off'

    def events(self, settings, fixes):
        """As `Measurement.events`, with a warning for each fix whose covariance is not usable."""
        n = len(fixes)
        r, reasons, warnings = np.zeros((n, Event.SIZE)), {}, {}
        latitude, longitude, height, covariance = (np.ascontiguousarray(one, dtype=float) for one in (
            fixes.latitude, fixes.longitude, fixes.height, fixes.covariance))
        status, kinds = (np.ascontiguousarray(one, dtype=np.int64) for one in (fixes.status, fixes.covariance_type))
        usable, stated = np.empty((2, n), dtype=bool)
        kind = Kind.POSITION if self.is_plain else Kind.PLACE
        if not _write(r, kind, latitude, longitude, height, status, covariance, kinds, settings.sigma,
                      settings.default_sigma, usable, stated):
            return r, reasons, warnings
        position = [Event.LATITUDE, Event.LONGITUDE, Event.HEIGHT, Event.STATUS]
        refuse(reasons, ~usable, lambda i: _reason(*r[i, position].tolist()))
        if settings.sigma == 0:
            refuse(warnings, ~stated, lambda i: (
                f'position_covariance (type {kinds[i]}) [{covariance[i, 0, 0]:g}, {covariance[i, 0, 1]:g}, .., '
                f'{covariance[i, 1, 1]:g}, .., {covariance[i, 2, 2]:g}] is not usable: gnss.default_sigma '
                f'{settings.default_sigma:g} m is used'))
        return r, reasons, warnings

    def read(self, fields, message):
        fields = fix_quality.as_nav_sat_fix(fields, message)
        height, covariance = np.array(fields['altitude']), np.array(fields['position_covariance']).reshape(-1, 3, 3)
        without_altitude(height, covariance)
        return Fixes(stamp=fields['stamp'], received=fields['received'], latitude=np.radians(fields['latitude']),
                     longitude=np.radians(fields['longitude']), height=height, covariance=covariance,
                     status=fields['status.status'], covariance_type=fields['position_covariance_type'])

    def written(self, fixes):
        return {'latitude': np.degrees(fixes.latitude), 'longitude': np.degrees(fixes.longitude),
                'altitude': np.where(has_altitude(fixes), fixes.height, np.nan),
                'status.status': fixes.status, 'status.service': 1,  # GPS
                'position_covariance': fixes.covariance.reshape(-1, 9),
                'position_covariance_type': fixes.covariance_type}

    def simulated(self, drive, errors, effects, rng, instants):
        time, stamp = instants(errors['fix_rate'], None)
        at, sigma = drive.at(time), errors['fix_sigma'] * np.array([1.0, 1.0, 1.5])
        north, east, down = (at.attitude.apply(self.arm) + sigma * rng.standard_normal((len(time), 3))).T
        meridian, prime_vertical = radii(at.latitude)
        n = len(time)
        return Fixes(stamp, stamp.copy(), at.latitude + north / (meridian + at.height),
                     at.longitude + east / ((prime_vertical + at.height) * np.cos(at.latitude)), at.height - down,
                     np.tile(np.diag(sigma**2), (n, 1, 1)), np.zeros(n, np.int8), np.full(n, 2, np.uint8))
