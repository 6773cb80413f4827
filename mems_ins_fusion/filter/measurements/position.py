"""GNSS fix: position of the antenna (Eq. 19), innovation in metres north, east and down."""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation.earth import radii
from ...parameters.parameter import Parameter
from ...samples import Fixes
from ..memory import Error, Event, Head, Kind, Nav, row_of
from ..trust.lag import behind
from .base import GPS_FIX, NAV_SAT_FIX, Measurement
from .geometry import add, add_attitude_error, arm_of, rotate
from .records import empty, refuse

#: m: standard deviation of a pseudorange, by which a dilution of precision is multiplied where a message has no other
#: statement of its noise
RANGE_SIGMA = 3.0
#: 95 % error over standard deviation, of a horizontal distance (two dimensions) and of a height (one)
HORIZONTAL_95, VERTICAL_95 = 2.4477, 1.96
#: `NavSatStatus.status` of each `GPSStatus.status`. RTK fixed: 2; differential corrections or RTK float, whose errors
#: are larger: 1; no corrections: 0; no fix: -1
STATUS_OF = {-1: -1, 0: 0, 1: 1, 33: 1, 18: 1, 20: 1, 2: 2, 19: 2}
FEWEST_SATELLITES = 3  # satellites below which a message that counts them has no position
SMALLEST_SIGMA = 0.001  # m: smallest standard deviation that a fix is credited with, whatever it claims
LOWEST, HIGHEST = -1000.0, 10000.0  # m above the ellipsoid: limits for a land vehicle


@njit(_nrt=False)
def _antenna_minus_fix(mem, r, at, north, east, down):
    """Position of the antenna, which is (north, east, down) m from the IMU of the state at r, minus the position in the
    record at `at`: north, east, down, m."""
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
    offset = int(mem[Head.TIME_OFFSET])
    if offset >= 0:  # the fix describes the vehicle that much before its stamp
        for k in range(3):
            mem[h + n * k + offset] = mem[r + Nav.V_N + k]
    return 3 if row_of(mem, Error.R_D) >= 0 else 2


@njit(_nrt=False)
def observe_place(mem, r, at, h, n, c):
    """A fix of a further receiver. Returns the number of components.

    The states for coloured noise, smoothing and clock belong to the main receiver. Two optional states are the error of
    this receiver's lever arm, forward and right.
    """
    x, y, z = arm_of(mem, at, Head.LEVER_X)
    north, east, down = rotate(c, x, y, z)
    mem[at + Event.Z_N], mem[at + Event.Z_E], mem[at + Event.Z_D] = _antenna_minus_fix(mem, r, at, north, east, down)
    add_attitude_error(mem, h, n, north, east, down)
    arm = int(mem[at + Event.STATE])
    for k in range(3):
        add(mem, h + n * k, Error.R_N + k, 1.0)
        if arm >= 0:
            mem[h + n * k + arm], mem[h + n * k + arm + 1] = -c[3 * k], -c[3 * k + 1]
    return 3 if row_of(mem, Error.R_D) >= 0 else 2


def is_place(latitude: np.ndarray, longitude: np.ndarray, height: np.ndarray) -> np.ndarray:
    """(n,) whether a land vehicle can be at each position, rad and m; false for NaN."""
    return ((np.abs(latitude) <= math.pi / 2) & (np.abs(longitude) <= 2 * math.pi) & (height >= LOWEST)
            & (height <= HIGHEST))


def is_fix(fixes) -> np.ndarray:
    """(n,) which of `fixes` have a position; receivers without one send latitude 0, longitude 0."""
    there = (fixes.latitude != 0) | (fixes.longitude != 0)
    return is_place(fixes.latitude, fixes.longitude, fixes.height) & there & (fixes.status >= 0)


def _refuse(reasons, fixes) -> None:
    """Set the reasons of those for which `is_fix` is false."""
    latitude, longitude, height = fixes.latitude, fixes.longitude, fixes.height

    def place(i):
        return f'{math.degrees(latitude[i])}, {math.degrees(longitude[i])}, {height[i]}'

    refuse(reasons, fixes.status < 0, lambda i: f'status {int(fixes.status[i])}: no fix')
    refuse(reasons, ~(np.isfinite(latitude) & np.isfinite(longitude) & np.isfinite(height)),
           lambda i: f'latitude, longitude, altitude {place(i)}: fix dropped')
    refuse(reasons, (np.abs(latitude) > math.pi / 2) | (np.abs(longitude) > 2 * math.pi),
           lambda i: f'latitude {math.degrees(latitude[i]):.6f}, longitude {math.degrees(longitude[i]):.6f} deg is '
                     'not on earth: fix dropped')
    refuse(reasons, (height < LOWEST) | (height > HIGHEST),
           lambda i: f'altitude {height[i]:g} m is no place for a land vehicle: fix dropped')
    refuse(reasons, (latitude == 0) & (longitude == 0),
           lambda i: 'latitude 0, longitude 0 is what receivers send without a fix: fix dropped')


def records(settings, fixes):
    """Records (n, Event.SIZE) of `fixes`, why each cannot be used ('' where it can), and a warning for each whose
    covariance is not usable ('' else). settings: `GnssSettings`."""
    n = len(fixes)
    r, reasons, warnings = empty(Kind.POSITION, n), np.full(n, '', dtype=object), np.full(n, '', dtype=object)
    latitude, longitude, height = fixes.latitude, fixes.longitude, fixes.height

    if not is_fix(fixes).all():
        _refuse(reasons, fixes)
    ee, en, nn, uu = (fixes.covariance[:, i, j] for i, j in ((0, 0), (0, 1), (1, 1), (2, 2)))
    with np.errstate(invalid='ignore', over='ignore'):
        stated = (np.isfinite(ee) & np.isfinite(en) & np.isfinite(nn) & np.isfinite(uu) & (np.minimum(ee, nn) > 0)
                  & (nn * ee > en * en) & (fixes.covariance_type != 0))
    smallest, default = SMALLEST_SIGMA**2, settings.default_sigma**2
    if settings.sigma == 0:
        for i in np.flatnonzero(~stated & (reasons == '')):
            warnings[i] = (f'position_covariance (type {int(fixes.covariance_type[i])}) [{ee[i]:g}, {en[i]:g}, .., '
                           f'{nn[i]:g}, .., {uu[i]:g}] says nothing: gnss.default_sigma '
                           f'{settings.default_sigma:g} m is used')
    r[:, Event.LATITUDE], r[:, Event.LONGITUDE], r[:, Event.HEIGHT] = latitude, longitude, height
    r[:, Event.STATUS] = fixes.status
    r[:, Event.R_NN] = np.where(stated, np.maximum(nn, smallest), default)
    r[:, Event.R_NE] = np.where(stated, en, 0.0)
    r[:, Event.R_EE] = np.where(stated, np.maximum(ee, smallest), default)
    up = np.where(uu > 0, np.maximum(uu, smallest), 4 * np.maximum(nn, ee))
    r[:, Event.R_DD] = np.where(stated, up, 4 * default)
    if settings.sigma > 0:
        r[:, Event.R_NN] = r[:, Event.R_EE] = settings.sigma**2
        r[:, Event.R_NE] = 0.0
        r[:, Event.R_DD] = np.maximum(r[:, Event.R_DD], settings.sigma**2)
    return r, reasons, warnings


def _of_gps_fix(fields) -> dict[str, np.ndarray]:
    """Status, covariance and covariance type as in NavSatFix, of GPSFix messages: their covariance, else their 95 %
    errors, else their dilutions of precision."""
    status = np.array([STATUS_OF.get(int(one), 0) for one in fields['status.status']], dtype=np.int8)
    used = fields['status.satellites_used']
    status[(used > 0) & (used < FEWEST_SATELLITES)] = -1
    covariance = np.array(fields['position_covariance'], dtype=float).reshape(-1, 9)
    kind = np.array(fields['position_covariance_type']).astype(np.uint8)
    missing = (kind == 0) | ~(covariance[:, [0, 4]] > 0).all(axis=1)
    for horizontal, vertical in ((fields['err_horz'] / HORIZONTAL_95, fields['err_vert'] / VERTICAL_95),
                                 (RANGE_SIGMA * fields['hdop'] / math.sqrt(2.0), RANGE_SIGMA * fields['vdop'])):
        filled = missing & np.isfinite(horizontal) & (horizontal > 0)
        height = np.where(np.isfinite(vertical) & (vertical > 0), vertical, 2.0 * horizontal)
        covariance[filled] = 0.0
        covariance[filled, 0] = covariance[filled, 4] = horizontal[filled]**2
        covariance[filled, 8] = height[filled]**2
        kind[filled], missing = 1, missing & ~filled
    kind[missing] = 0
    return {'status.status': status, 'position_covariance': covariance, 'position_covariance_type': kind}


class Fix(Measurement):
    """Unnamed: the fixes of the main receiver, from which the filter starts and restarts (settings: `GnssSettings`).
    Named: those of a further receiver, treated as any other measurement."""

    kind, name, samples, unit, default_sigma = Kind.POSITION, 'fix', Fixes, 'm', 3.0
    topic_text = ('Topic of the position of an antenna: sensor_msgs/NavSatFix, or, where it is installed, '
                  'gps_msgs/GPSFix')
    components = 2
    messages = {NAV_SAT_FIX: ('status.status', 'latitude', 'longitude', 'altitude', 'position_covariance',
                              'position_covariance_type'),
                GPS_FIX: ('status.status', 'status.satellites_used', 'latitude', 'longitude', 'altitude',
                          'position_covariance', 'position_covariance_type', 'err_horz', 'err_vert', 'hdop', 'vdop')}
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

    def states(self, values):
        sigma = 0.0 if self.is_plain else values[f'{self.name}.lever_arm_sigma']
        return {self.state: (sigma, 0.0), f'{self.state}_right': (sigma, 0.0)}

    def off(self, measured, innovation):
        return f'fix {math.hypot(*innovation):.1f} m off'

    def records(self, settings, fixes):
        found, reasons, warnings = records(settings, fixes)
        found[:, Event.KIND] = Kind.POSITION if self.is_plain else Kind.PLACE
        return found, reasons, warnings

    def read(self, fields, message):
        if message == GPS_FIX:
            fields = {**fields, **_of_gps_fix(fields)}
        return Fixes(stamp=fields['stamp'], received=fields['received'], latitude=np.radians(fields['latitude']),
                     longitude=np.radians(fields['longitude']), height=fields['altitude'],
                     covariance=fields['position_covariance'].reshape(-1, 3, 3), status=fields['status.status'],
                     covariance_type=fields['position_covariance_type'])

    def written(self, fixes):
        return {'latitude': np.degrees(fixes.latitude), 'longitude': np.degrees(fixes.longitude),
                'altitude': fixes.height, 'status.status': fixes.status, 'status.service': 1,  # GPS
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
