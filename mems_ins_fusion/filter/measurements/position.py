"""A fix: position of the GNSS antenna (Eq. 19), metres north, east and down."""
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
from .geometry import add, arm_of, turned
from .records import empty, refuse


@njit(_nrt=False)
def arm_in_level(mem, c):
    """From the IMU to the antenna in n, m; c: rotation from b to n."""
    x, y, z = mem[Head.LEVER_X], mem[Head.LEVER_Y], mem[Head.LEVER_Z]
    return c[0] * x + c[1] * y + c[2] * z, c[3] * x + c[4] * y + c[5] * z, c[6] * x + c[7] * y + c[8] * z


@njit(_nrt=False)
def difference(mem, r, at, c):
    """Predicted minus measured position of the antenna, north, east and down, m; c: rotation from b to n."""
    north, east, down = arm_in_level(mem, c)
    # a receiver that smooths
    north, east, down = north - behind(mem, r, 0), east - behind(mem, r, 1), down - behind(mem, r, 2)
    return ((mem[r + Nav.LATITUDE] - mem[at + Event.LATITUDE]) / mem[r + Nav.NORTH_SCALE] + north,
            (mem[r + Nav.LONGITUDE] - mem[at + Event.LONGITUDE]) / mem[r + Nav.EAST_SCALE] + east,
            mem[at + Event.HEIGHT] - mem[r + Nav.HEIGHT] + down)


@njit(_nrt=False)
def observe(mem, r, at, h, n, c):
    """`difference` and its rows of H; the number of components: the planar filter has no height."""
    mem[at + Event.Z_N], mem[at + Event.Z_E], mem[at + Event.Z_D] = difference(mem, r, at, c)
    north, east, down = arm_in_level(mem, c)
    add(mem, h, Error.R_N, 1.0)
    add(mem, h + n, Error.R_E, 1.0)
    turned(mem, h, n, north, east, down)  # an error of attitude swings the antenna
    coloured = int(mem[Head.COLOURED])
    if coloured >= 0:
        mem[h + coloured] = mem[h + n + coloured + 1] = -1.0
    offset = int(mem[Head.TIME_OFFSET])
    if offset >= 0:  # the fix is of so much earlier than its stamp says
        mem[h + offset], mem[h + n + offset] = mem[r + Nav.V_N], mem[r + Nav.V_E]
        mem[h + 2 * n + offset] = mem[r + Nav.V_D]
    add(mem, h + 2 * n, Error.R_D, 1.0)
    return 3 if row_of(mem, Error.R_D) >= 0 else 2


@njit(_nrt=False)
def observe_place(mem, r, at, h, n, c):
    """Of a further receiver: predicted minus measured position of its antenna, and the rows of H; the number of
    components. What is told of the first one's errors - coloured noise, smoothing, clock - is not of this one. Its arm
    forwards and to the right is two optional states, what is left of the one that is set."""
    x, y, z = arm_of(mem, at, Head.LEVER_X)
    along = int(mem[at + Event.STATE])
    north, east, down = (c[0] * x + c[1] * y + c[2] * z, c[3] * x + c[4] * y + c[5] * z,
                         c[6] * x + c[7] * y + c[8] * z)
    mem[at + Event.Z_N] = (mem[r + Nav.LATITUDE] - mem[at + Event.LATITUDE]) / mem[r + Nav.NORTH_SCALE] + north
    mem[at + Event.Z_E] = (mem[r + Nav.LONGITUDE] - mem[at + Event.LONGITUDE]) / mem[r + Nav.EAST_SCALE] + east
    mem[at + Event.Z_D] = mem[at + Event.HEIGHT] - mem[r + Nav.HEIGHT] + down
    turned(mem, h, n, north, east, down)
    for k in range(3):
        add(mem, h + n * k, Error.R_N + k, 1.0)
        if along >= 0:
            mem[h + n * k + along], mem[h + n * k + along + 1] = -c[3 * k], -c[3 * k + 1]
    return 3 if row_of(mem, Error.R_D) >= 0 else 2


#: of a receiver's ranges, m: what a dilution of precision is multiplied with where nothing else tells the noise
RANGE_SIGMA = 3.0
#: a 95 % error over the standard deviation: of a horizontal distance, and of a height
HORIZONTAL_95, VERTICAL_95 = 2.4477, 1.96
#: `NavSatStatus.status` by `GPSStatus.status`: each class has errors of its own, and float is not fixed. With a base
#: and fixed: 2; corrected, or a float: 1; neither: 0
STATUS_OF = {-1: -1, 0: 0, 1: 1, 33: 1, 18: 1, 20: 1, 2: 2, 19: 2}
#: satellites below which there is no position, where their number is told
FEWEST_SATELLITES = 3

#: a position is not better than this, m
SMALLEST_SIGMA = 0.001
#: where land vehicles are, m above the ellipsoid
LOWEST, HIGHEST = -1000.0, 10000.0


def is_place(latitude: np.ndarray, longitude: np.ndarray, height: np.ndarray) -> np.ndarray:
    """(n,) which positions, rad and m, can be a land vehicle's; not those with NaN."""
    return ((np.abs(latitude) <= math.pi / 2) & (np.abs(longitude) <= 2 * math.pi) & (height >= LOWEST)
            & (height <= HIGHEST))


def is_fix(fixes) -> np.ndarray:
    """(n,) which of `fixes` have a position; 0, 0 is what receivers without one send."""
    there = (fixes.latitude != 0) | (fixes.longitude != 0)
    return is_place(fixes.latitude, fixes.longitude, fixes.height) & there & (fixes.status >= 0)


def _refuse(reasons, fixes) -> None:
    """Say why those that are no `is_fix` cannot be used."""
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
    """Records of `fixes` (`samples.Fixes`), and why each cannot be used: '' where it can.

    settings: `GnssSettings`. Also a warning for each whose covariance says nothing, '' else.
    """
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
    """Status and covariance as in NavSatFix of messages that tell the quality of a fix: by the covariance, where it is
    not filled by the 95 % errors, and without these by the dilution of precision."""
    status = np.array([STATUS_OF.get(int(one), 0) for one in fields['status.status']], dtype=np.int8)
    used = fields['status.satellites_used']
    status[(used > 0) & (used < FEWEST_SATELLITES)] = -1
    covariance = np.array(fields['position_covariance'], dtype=float).reshape(-1, 9)
    kind = np.array(fields['position_covariance_type']).astype(np.uint8)
    empty_ones = (kind == 0) | ~(covariance[:, [0, 4]] > 0).all(axis=1)
    for horizontal, vertical in ((fields['err_horz'] / HORIZONTAL_95, fields['err_vert'] / VERTICAL_95),
                                 (RANGE_SIGMA * fields['hdop'] / math.sqrt(2.0), RANGE_SIGMA * fields['vdop'])):
        told = empty_ones & np.isfinite(horizontal) & (horizontal > 0)
        height = np.where(np.isfinite(vertical) & (vertical > 0), vertical, 2.0 * horizontal)
        covariance[told] = 0.0
        covariance[told, 0] = covariance[told, 4] = horizontal[told]**2
        covariance[told, 8] = height[told]**2
        kind[told], empty_ones = 1, empty_ones & ~told
    kind[empty_ones] = 0
    return {'status.status': status, 'position_covariance': covariance, 'position_covariance_type': kind}


class Fix(Measurement):
    """The fixes that the filter starts from and is reset to, whose settings are `GnssSettings`; with a name, those of a
    further receiver, which are judged as all other measurements are."""

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
    #: m, white, north and east; down is 1.5 times that
    simulated_with = {'fix_rate': 0.0, 'fix_sigma': 1.5}

    def named_parameters(self):
        return (*super().named_parameters(), Parameter(
            f'{self.name}.lever_arm_sigma', 0.02, 'm', 'Standard deviation of the arm forwards and to the left, with '
            'which what is left of it is estimated: that of a tape. 0: it is exact, and so is the heading that two '
            'receivers tell.', minimum=0.0, maximum=10.0))

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
