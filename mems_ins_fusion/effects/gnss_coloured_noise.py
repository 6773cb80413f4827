"""GNSS coloured noise: position errors (satellite orbits, atmosphere, multipath) that are correlated between fixes."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.sensor_errors.models import gauss_markov_at


class GnssColouredNoise(Effect):
    """A first-order Gauss-Markov position error, north and east independent, of standard deviation sigma."""

    name = 'gnss_coloured_noise'
    signature = ('innovations that keep their sign for longer than the filter needs to follow, whatever the '
                 'vehicle does, also at rest; small slow sensor errors look the same')
    in_words = 'the receiver\'s errors last for seconds to minutes'
    to_check = 'whether the receiver could have corrections (RTK, SBAS)'
    looks_the_same = 'several bad fixes in a row look the same'
    largest = {'sigma': 20.0}
    larger_is = 'fixes that are far off, or positions that the receiver smooths'
    smallest = {'tau': 1.0}
    smaller_is = 'white noise, as it is not correlated from one fix to the next'
    parameters = (EffectParameter('sigma', 'm', 1.0, variance=True), EffectParameter('tau', 's', 60.0, default=60.0))

    tried = ({'tau': 10.0}, {'tau': 40.0}, {'tau': 160.0})
    refined = ('tau',)
    only_scatter = True

    def distort_fixes(self, drive, time, position, values, rng):
        error = gauss_markov_at(time, values['tau'], values['sigma'] * rng.standard_normal((len(time), 2)))
        return position + np.column_stack([error, np.zeros(len(time))])

    def adjusted(self, values, theta):
        sigma = np.hypot(values['gnss.coloured_noise.sigma'], theta['sigma'])
        return {**values, 'gnss.coloured_noise.sigma': float(sigma), 'gnss.coloured_noise.tau': theta['tau']}

    def lasting(self, values):
        return values['gnss.coloured_noise.tau']
