"""GNSS outliers: single fixes that are off by far more than they claim, as with reflected signals."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter, Sighting
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.navigation.frames import near
from mems_ins_fusion.samples import in_time_order

#: smallest distance of an outlier from the interpolation between its neighbours, in standard deviations of the receiver
SIGMAS = 5.0
#: m/s^2, largest acceleration of a car: by so much any fix may differ from the interpolation in addition
HARDEST = 3.0
#: s, longest interval between fixes that are compared
LONGEST = 5.0
#: smallest number of outliers that is reported
FEWEST = 3
#: value of gnss.robust_sigma with which the filter tolerates outliers: the default
ROBUST = 3.0
#: value of gnss.gate_probability with which the filter tolerates outliers: the default
GATE = 0.999999


class GnssOutliers(Effect):
    """A `share` of the fixes is off by `sigma`, on each axis, beyond what they claim."""

    name = 'gnss_outliers'
    signature = ('single innovations many times as large as the others; a filter that uses them has jumps in its track '
                 'and errors that decay slowly')
    in_words = 'some fixes are far off (multipath)'
    to_check = 'the view of the sky and the ground plane of the antenna'
    parameters = (EffectParameter('share', '-', 0.02), EffectParameter('sigma', 'm', 20.0, default=20.0))
    traced = ()

    def distort_fixes(self, drive, time, position, values, rng):
        wrong = rng.uniform(size=len(time)) < values['share']
        return position + wrong[:, None] * values['sigma'] * rng.standard_normal(position.shape)

    def seen(self, values, recording):
        fixes = recording.gnss
        if fixes is None:
            return None
        index, off = far_off(fixes)
        if len(index) < FEWEST:
            return None
        share, size = len(index) / len(fixes), float(np.sqrt(np.mean(off**2)))
        return Sighting({'share': (share, share / np.sqrt(len(index))),
                         'sigma': (size, size / np.sqrt(2 * off.size))},
                        f'{len(index)} of {len(fixes)} fixes ({100 * share:.2g} %) are off by {size:.2g} m (RMS of an '
                        'axis) from those before and after them: more than any vehicle moves, and more than they claim',
                        {name: value for name, value in self.adjusted(values, {}).items() if value != values[name]})

    def adjusted(self, values, theta):
        robust = values['gnss.robust_sigma']
        return {**values, 'gnss.robust_sigma': min(robust, ROBUST) if robust else ROBUST,
                'gnss.gate_probability': min(values['gnss.gate_probability'], GATE)}


def far_off(fixes) -> tuple[np.ndarray, np.ndarray]:
    """Indices (k,) of the outliers, and their distance from the line between their neighbours, north and east, (k, 2)
    m.

    An outlier is far from the lines through the two fixes before it, the two after it, and its neighbours. A fix after
    which the receiver stays at the new position is none.
    """
    good = in_time_order(fixes.stamp, (fixes.status >= 0) & np.isfinite(fixes.latitude) & np.isfinite(fixes.longitude))
    if len(good) < 5:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    time = (fixes.stamp[good] - fixes.stamp[good[0]]) * 1e-9
    latitude, longitude = fixes.latitude[good], fixes.longitude[good]
    meridian, prime_vertical = radii(latitude[0])
    path = np.column_stack([(latitude - latitude[0]) * meridian,
                            (near(longitude, longitude[0]) - longitude[0]) * prime_vertical * np.cos(latitude[0])])

    def line(a, b):
        """Distance of each fix from the line through the a-th and the b-th from it."""
        k = np.arange(2, len(good) - 2)
        share = ((time[k] - time[k + a]) / (time[k + b] - time[k + a]))[:, None]
        return path[k] - path[k + a] * (1 - share) - path[k + b] * share

    between = line(-1, 1)
    least = np.min([np.linalg.norm(r, axis=1) for r in (between, line(-2, -1), line(1, 2))], axis=0)
    variance = 0.5 * (fixes.covariance[good, 0, 0] + fixes.covariance[good, 1, 1])[2:-2]
    # scatter of the fixes, whatever they claim
    scatter = 1.4826 * np.median(np.abs(between), axis=0).mean() / np.sqrt(1.5)
    sigma = np.maximum(np.sqrt(np.where(variance > 0, variance, 0.0)), scatter)
    span = time[4:] - time[:-4]
    wrong = (span < 4 * LONGEST) & (least > SIGMAS * np.sqrt(1.5) * sigma + HARDEST * (span / 4)**2)
    return good[2:-2][wrong], between[wrong]
